"""Scales and the random part, fitted and calibrated: on recordings that the model itself made, the answer is known."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import norm

import foten.training.calibration as calibration
from conftest import CARD, PLUS, SCALING, scale, untrained, untrained_tensors
from foten.dsp.lattice import polynomial
from foten.dsp.noise import gaussian
from foten.models.definitions import model_of
from foten.models.excitation import Excitation, Scale
from foten.models.foten_plus.linear_model import LinearModel
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.stream import run
from foten.recording.scaling import Scaling
from foten.recording.split import Split
from foten.recording.trace import Trace
from foten.runtime.loops import render_streams
from foten.runtime.native import NativeTexture
from foten.runtime.proof import Tensors, proved
from foten.training.calibration import Calibrated, ClosedLoop, Residuals, constant_scale, fit_scale
from foten.training.job import ScaledBlocks

BLOCK, N_BLOCKS = 1000, 24
GAIN = 0.5  # of an innovation of 1, in acceleration


def model(before: bool = False) -> tuple[FotenPlusSizes, Tensors]:
    """A lattice that rings at 120 Hz, its gain before or after the filter, with an excitation."""
    sizes = FotenPlusSizes(**PLUS, order=2, gain_before_filter=before)
    return sizes, untrained_tensors("foten-plus", sizes, untrained("foten-plus", sizes))


def loop_of(before: bool = False, louder: float = 1.0) -> tuple[ClosedLoop, Excitation]:
    """A loop whose recording is one long free run of the model with the returned excitation, or louder by a factor."""
    sizes, tensors = model(before)
    rng, m = np.random.default_rng(7), sizes.history

    def kernel(excitation: Excitation) -> NativeTexture:
        golden = np.random.default_rng(1).standard_normal((6, m, 3))
        fitted = {**tensors, **excitation.tensors()}
        return proved("foten-plus", sizes, fitted, SCALING, golden, 0.1 * golden[0], CARD).kernel

    excitation = Excitation.of(tensors)
    n, t = N_BLOCKS * BLOCK, np.arange(N_BLOCKS * BLOCK) / 1000
    speed, force = 100 * 2.0 ** np.sin(1.1 * t), 1.0 * 1.6 ** np.sin(1.7 * t)
    stacked = SCALING.scale(np.stack([np.zeros(n), speed, force], axis=1))
    condition = np.concatenate([stacked[:, 1:], speed[:, None]], axis=1)
    noise = rng.standard_normal((1, n))
    stacked[:, 0] = louder * render_streams(kernel(excitation), np.zeros((1, m, 3)), condition[None], noise)[0]
    trace = Trace(SCALING.unscale_acceleration(stacked[:, 0]), speed, force, 1000.0, BLOCK)
    split = Split(tuple(range(16)), tuple(range(16, 20)), tuple(range(20, 24)), 24, BLOCK, "contiguous", 0)
    blocks = ScaledBlocks(trace, split, SCALING, stacked.reshape(N_BLOCKS, BLOCK, 3))
    linear = LinearModel(sizes, tensors)
    return ClosedLoop(blocks, m, kernel, linear.power, linear.response(BLOCK - m)), excitation


@pytest.mark.parametrize("before", [False, True])
def test_one_kernel_renders_any_excitation_where_it_scales_the_noise(before: bool) -> None:
    """Oracle: the excitation's own kernel, as it is and where either bound cuts most of the noise; but for float32 tensors."""
    loop, excitation = loop_of(before)
    for bounds in (excitation.innovation_limit, (0.5, 1e6), (1e6, 0.05)):
        bounded = Excitation(excitation.sigma, bounds)
        unit = loop.with_unit_sigma(16, bounds[1])
        expected, rendered = (of.free_runs(bounded, (3, 17), 5, 40, 2)[1] for of in (loop, unit))
        np.testing.assert_allclose(rendered, expected, atol=1e-5 * np.abs(expected).max())
        assert unit.kernel(excitation) is unit.kernel(bounded)


def changed(excitation: Excitation, **parts: np.ndarray) -> Excitation:
    return replace(excitation, sigma=replace(excitation.sigma, **parts))


def under(loop: ClosedLoop) -> np.ndarray:
    """Speed and force that go with the training samples."""
    return np.asarray(loop.blocks.flat[loop.blocks.targets(loop.history)[0] - 1, 1:])


def test_free_runs_are_those_of_the_definition() -> None:
    """Oracle: the model in NumPy, under the same noise; float64 against float64 but for the lattice's float32 tensors."""
    loop, excitation = loop_of()
    recorded, rendered = loop.free_runs(excitation, (3, 17), 5, 40, 2)
    assert recorded.shape == (2, BLOCK - loop.first_scored)
    assert rendered.shape == (2, 2, BLOCK - loop.first_scored)
    np.testing.assert_array_equal(recorded, loop.blocks.samples[[3, 17], loop.first_scored :, 0])
    definition, m = model_of(*model()), loop.history
    for which, (stream, number) in enumerate([(40, 3), (41, 17), (42, 3), (43, 17)]):
        start = definition.start(loop.blocks.samples[[number], :m])
        condition = loop.blocks.conditions_with_speed()[[number], m:]
        expected = run(start, condition, gaussian(5, stream, 0, BLOCK - m)[None])[0, loop.first_scored - m :]
        np.testing.assert_allclose(rendered[which // 2, which % 2], expected, atol=1e-9)


@pytest.mark.parametrize("before", [False, True])
def test_a_level_is_calibrated_in_the_closed_loop(before: bool) -> None:
    """An excitation twice too strong is 6 dB too loud, since the lattice is linear; two adjustments later it is not.

    σ stays within its range over the training blocks.
    """
    loop, true = loop_of(before)
    chance = calibration.calibrate_level(loop, true, 0)[1][0]
    louder = changed(true, out_bias=true.sigma.out_bias + math.log(2))
    excitation, errors = calibration.calibrate_level(loop, louder, 0)
    assert errors[0] - chance == pytest.approx(6.02, abs=0.05)
    # What is left is less than twenty seconds tell: half a dB.
    assert abs(errors[-1]) < 0.5
    assert 20 / math.log(10) * (excitation.sigma.out_bias - true.sigma.out_bias) == pytest.approx([0.0], abs=0.5)
    assert excitation.innovation_limit == true.innovation_limit
    free = replace(excitation.sigma, sigma_max=np.array([1e6]))(under(loop))
    assert excitation.sigma.sigma_max == pytest.approx([np.quantile(free, 0.97)], rel=1e-5)


def test_a_slope_over_speed_is_calibrated_too() -> None:
    """σ that does not follow speed where the recording's does: most of the slope comes back, and the level is right."""
    loop, true = loop_of()
    level = changed(true, exponents=true.sigma.exponents * [0, 1, 1, 1, 1])
    excitation = calibration.calibrate_level(loop, level, 0)[0]
    assert excitation.sigma.exponents[0] == pytest.approx(true.sigma.exponents[0], abs=0.25)
    assert loop.free_run_errors(excitation, 0)[1] < loop.free_run_errors(level, 0)[1] - 0.5


def test_a_free_run_is_as_far_as_it_is_too_loud() -> None:
    near, louder = (loop.free_run_errors(excitation, 0) for loop, excitation in (loop_of(), loop_of(louder=2.0)))
    # Of what the model itself made: chance alone. In a frame of 40 ms a resonance 16 Hz wide is known to 3 dB.
    assert near[0] < 3.0
    assert near[1] < 3.5
    assert louder[1] == pytest.approx(6.02, abs=0.7)
    assert louder[0] > near[0] + 2


def residuals_of(loop: ClosedLoop, excitation: Excitation, share: float) -> Residuals:
    """Innovations a share as large as those that the recording was made of; a third of them at rest."""
    n = np.concatenate(loop.blocks.targets(loop.history))
    condition = loop.blocks.flat[n - 1, 1:]
    innovation = share * excitation.sigma(condition) * np.random.default_rng(4).standard_normal(n.size)
    n_train = len(loop.blocks.targets(loop.history)[0])
    return Residuals(condition, innovation, np.full(n.size, GAIN), n_train, np.arange(n.size) % 3 > 0)


Halved = tuple[ClosedLoop, Residuals, Calibrated]


@pytest.fixture(scope="module")
def halved() -> Halved:
    """An excitation fitted to innovations half as large as those of the recording."""
    loop, excitation = loop_of()
    residuals = residuals_of(loop, excitation, 0.5)
    return loop, residuals, calibration.calibrate_excitation(16, residuals, loop, 0)


def test_the_closed_loop_has_the_last_word_on_the_level(halved: Halved) -> None:
    """By likelihood alone it would be 6 dB too soft."""
    loop, _, calibrated = halved
    assert calibrated.level_errors_db[0] == pytest.approx(-6.02, abs=1.0)
    assert abs(calibrated.level_errors_db[-1]) < 0.5
    recorded, runs = loop.free_runs(calibrated.excitation, loop.blocks.known, 9, 77, 4)
    # Four runs of 16 s, 16 Hz wide: known to 0.15 dB, the recording to 0.3.
    assert 10 * math.log10(np.square(runs).mean() / np.square(recorded).mean()) == pytest.approx(0, abs=0.8)
    assert calibrated.free_run == pytest.approx(loop.free_run_errors(calibrated.excitation, 0), rel=1e-5)


def test_no_excitation_is_larger_than_what_was_left_to_explain(halved: Halved) -> None:
    """At the training samples, in σ and in acceleration, whichever is less; the definition draws none that is."""
    _, residuals, calibrated = halved
    in_sigma, in_acceleration = calibrated.excitation.innovation_limit
    left = np.abs(residuals.innovation[: residuals.n_train])
    assert in_acceleration == pytest.approx(GAIN * left.max(), rel=1e-6)
    assert 3 < in_sigma < 6
    condition = np.array([[-1.0, 0.0], [1.0, 0.0]])
    for gain in (0.05, 10.0):
        prediction = calibrated.excitation.added_to(np.zeros(2), np.full(2, gain), condition)
        assert prediction.scale is not None
        shocks = np.abs([prediction.excited(np.full(2, z)) for z in (9.0, -9.0)])
        limit = np.minimum(in_sigma * prediction.scale, in_acceleration)
        np.testing.assert_allclose(shocks, [limit, limit], rtol=1e-9)


def test_the_nll_is_that_of_the_validation_samples_where_the_hand_moves(halved: Halved) -> None:
    """Oracle: SciPy's normal density."""
    loop, residuals, calibrated = halved
    of = slice(residuals.n_train, None)
    condition, e, moving = residuals.condition[of], residuals.innovation[of], residuals.moving[of]
    sigma = calibrated.excitation.sigma(condition)
    expected = -norm.logpdf(GAIN * e, scale=GAIN * sigma)[moving].mean()
    assert calibrated.acceleration_nll == pytest.approx(expected, rel=1e-6)
    rested = calibration.calibrate_excitation(16, replace(residuals, moving=np.zeros_like(residuals.moving)), loop, 0)
    assert rested.acceleration_nll is None
    for name, tensor in calibrated.excitation.tensors().items():  # and the same seed gives the same excitation
        np.testing.assert_array_equal(rested.excitation.tensors()[name], tensor, name)


def test_the_jackknife_of_a_mean_is_its_standard_error() -> None:
    values = np.random.default_rng(0).standard_normal(30)
    result = calibration._jackknifed(np.stack([values, np.ones(30)]), np.divide)
    assert result == pytest.approx((values.mean(), values.std(ddof=1) / math.sqrt(30)), rel=1e-9)


def test_a_still_hand_or_one_in_the_air_does_not_count() -> None:
    n = np.arange(4000).reshape(4, 1000)
    speed, force = 5.0 + 0 * n, 0.1 + 0 * n
    speed[1, 900:], force[3, 950:] = 4.9, 0.09
    trace = Trace(np.zeros(4000), speed.ravel(), force.ravel(), 1000.0, 1000)
    split = Split((0, 1), (2,), (3,), 4, 1000, "contiguous", 0)
    moving = ScaledBlocks(trace, split, SCALING, np.zeros((4, 1000, 3))).moving()
    at_rest = np.zeros((4, 1000), dtype=bool)
    at_rest[1, 900:] = at_rest[3, 950:] = True
    np.testing.assert_array_equal(moving, ~at_rest)


@pytest.mark.parametrize("before", [False, True])
def test_power_that_enters_a_lattice_rings_on(before: bool) -> None:
    """Oracle: the mean square of what a lattice makes of noise whose power jumps, over 4000 runs."""
    k = np.array([-0.9, 0.95])
    sizes = FotenPlusSizes(**PLUS, order=2, gain_before_filter=before)
    response = LinearModel(sizes, {"lattice.reflections": k[None]}).response(200)
    power = np.concatenate([np.full(100, 4.0), np.full(100, 0.01)])
    leaving = calibration._filtered(power[None, :, None], response)[0, :, 0]
    if not before:
        np.testing.assert_array_equal(leaving, power)
        return
    noise = np.sqrt(power) * np.random.default_rng(0).standard_normal((4000, 200))
    gain = math.sqrt((1 - k * k).prod())
    expected = np.square(lfilter([gain], polynomial(k), noise, axis=1)).mean(axis=0)
    # From the jump on, and once what came before the first sample, which `_filtered` holds, no longer rings. A mean over 4000 of
    # squares that ring alike is known to √(2/4000) = 2.2 %; four standard errors.
    np.testing.assert_allclose(leaving[90:], expected[90:], rtol=0.09)
    assert leaving[105] > 100 * power[105]
    assert leaving[0] == pytest.approx(4.0, rel=0.02)  # what is left of the answer after 200 samples


def scaled_by_itself(speed: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, Scaling]:
    """Conditions (n, 2), scaled by what they are."""
    scaling = Scaling((0.0, speed.mean(), force.mean()), (1.0, speed.std() or 1.0, force.std() or 1.0))
    return scaling.scale(np.stack([0 * speed, speed, force], axis=1))[:, 1:], scaling


def test_a_power_law_is_recovered() -> None:
    rng = np.random.default_rng(2)
    n = 12_000
    speed, force = rng.uniform(5, 300, n), rng.uniform(0.2, 4, n)
    condition, scaling = scaled_by_itself(speed, force)
    true = 0.3 * (speed / 100) ** 0.8 * force**0.4
    residual = true * rng.standard_normal(n)
    sigma = fit_scale(16, condition, residual, n - 2000, scaling, seed=0)
    # 10 000 residuals estimate a scale within 1/√(2·10000) = 0.7 %; a flexible σ costs some of it.
    assert np.abs(np.log(sigma(condition) / true)).mean() < 0.04
    again = fit_scale(16, condition, residual, n - 2000, scaling, seed=0)
    for name, tensor in again.tensors("").items():  # in float32, as the file has it
        np.testing.assert_array_equal(getattr(sigma, name.replace(".", "_")), tensor, name)


def test_bins_of_condition_say_what_their_samples_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: a fit to every sample, of a level that bends; and each bin is a mean of what lies near."""
    rng = np.random.default_rng(7)
    n = 12_000
    speed, force = rng.uniform(5, 300, n), rng.uniform(0.2, 4, n)
    condition, scaling = scaled_by_itself(speed, force)
    residual = np.exp(np.sin(speed / 40)) * force**0.4 * rng.standard_normal(n)
    start = constant_scale(16, scaling)
    means, squared, share = calibration._binned(start, condition, residual**2)
    assert len(share) < 0.3 * n
    assert share.sum() == pytest.approx(1.0)
    assert share @ squared == pytest.approx(np.square(residual).mean())
    np.testing.assert_allclose(share @ means, condition.mean(axis=0), atol=1e-9)
    assert np.ptp(start.logarithms(means[[0, -1]]), axis=0).min() > 2  # in order of speed, then of force

    binned = fit_scale(16, condition, residual, n - 2000, scaling, seed=0)(condition)
    alone = calibration._binned(start, condition[:1], residual[:1])
    assert [part.shape for part in alone] == [(1, 2), (1,), (1,)]
    monkeypatch.setattr(calibration, "_binned", lambda scale, c, q: (c, q, np.full(len(q), 1 / len(q))))
    exact = fit_scale(16, condition, residual, n - 2000, scaling, seed=0)(condition)
    # Neither is at its optimum after sixty steps; 10 000 residuals know a flexible scale to about 3 %.
    assert np.abs(np.log(binned / exact)).mean() < 0.02


def test_no_shape_is_taken_that_validation_contradicts() -> None:
    """Loud where speed is high in training, and the other way round in validation: one scale for all."""
    rng = np.random.default_rng(5)
    speed = rng.uniform(50, 150, 4000)
    condition, scaling = scaled_by_itself(speed, np.ones(4000))
    slope = np.where(np.arange(4000) < 2000, 1.0, -1.0)
    residual = np.exp(slope * (speed - 100) / 50) * rng.standard_normal(4000)
    sigma = fit_scale(16, condition, residual, 2000, scaling, seed=0)(condition)
    assert np.ptp(np.log(sigma)) < 1e-5
    assert sigma[0] == pytest.approx(np.sqrt(np.square(residual[:2000]).mean()), rel=1e-5)


def test_its_gradient_is_that_of_finite_differences(monkeypatch: pytest.MonkeyPatch) -> None:
    """Away from where the fit begins, at which the network's last layer is zero; in float64, by central differences."""
    fitted: list[tuple[Callable[[np.ndarray], tuple[float, np.ndarray]], np.ndarray]] = []

    def captured(loss: Any, x: np.ndarray, **_: object) -> SimpleNamespace:
        fitted.append((loss, x))
        return SimpleNamespace(x=x)

    monkeypatch.setattr(calibration, "minimize", captured)
    rng = np.random.default_rng(3)
    condition, scaling = scaled_by_itself(rng.uniform(5, 300, 300), rng.uniform(0.2, 4, 300))
    fit_scale(3, condition, rng.standard_normal(300), 200, scaling, seed=0)
    ((loss, x),) = fitted
    at = x + 0.3 * rng.standard_normal(x.size)
    numerical = [(loss(at + step)[0] - loss(at - step)[0]) / 2e-6 for step in 1e-6 * np.eye(x.size)]
    np.testing.assert_allclose(loss(at)[1], numerical, rtol=1e-6, atol=1e-8)


def silent(exponents: list[float]) -> Scale:
    """A power law about 100 mm/s and 1 N whose network is silent."""
    parts = {"out_weight": np.zeros((1, 4)), "mean": np.array([100.0, 1.0]), "sd": np.array([60.0, 0.5])}
    return replace(scale(4, 0.0, 0), exponents=np.array(exponents), **parts)


def test_it_is_a_power_law_where_its_network_is_silent() -> None:
    speed, force = np.array([0.0, 10.0, 100.0, 300.0]), np.array([0.0, 0.1, 1.0, 4.0])
    scaled = np.stack([(speed - 100) / 60, (force - 1) / 0.5], axis=1)
    expected = ((speed + 2) / 102) ** 0.7 * ((force + 0.05) / 1.05) ** 0.4
    np.testing.assert_allclose(silent([0.7, 0.4, 0.0, 0.0, 0.0])(scaled), expected, rtol=1e-12)
    constant = constant_scale(5, Scaling((0.0, 100.0, 1.0), (1.0, 60.0, 0.5)))
    assert constant(scaled).tolist() == [1.0] * 4
    assert constant.sigma_max.tolist() == [1.0]


def test_speed_and_force_below_zero_count_as_zero() -> None:
    sigma = silent([0.7, 0.4, 0.1, 0.1, 0.1])
    below, at_rest = (replace(sigma, hidden_weight=0 * sigma.hidden_weight)(np.array([c])) for c in REST)
    assert np.isfinite(below).all()
    np.testing.assert_allclose(below, at_rest, rtol=1e-12)


REST = ([-50.0, -50.0], [-100 / 60, -2.0])  # scaled, far below rest and at it


def test_it_nowhere_exceeds_the_97th_percentile_of_where_it_was_trained() -> None:
    sigma = replace(silent([1.0, 0.0, 0.0, 0.0, 0.0]), sigma_max=np.array([1e-3]))  # of an earlier fit
    within = np.linspace(-1.5, 2.0, 1001)[:, None].repeat(2, axis=1)
    bounded = sigma.bounded(within)
    expected = np.quantile((within[:, 0] * 60 + 102) / 102, 0.97)
    assert bounded.sigma_max == pytest.approx([expected], rel=1e-9)
    np.testing.assert_allclose(bounded(np.array([[3.0, 0.0], [50.0, 0.0]])), expected, rtol=1e-9)
