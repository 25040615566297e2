"""What training takes from a model's own closed loop: on recordings that the model itself made, the answer is known."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch
from foten.training.scale import Excitation
from scipy.signal import lfilter

from conftest import CARD, PLUS, SCALING, untrained, untrained_tensors
from foten.dsp.lattice import polynomial
from foten.dsp.noise import gaussian
from foten.models.definitions import model_of
from foten.models.foten_plus.linear_model import LinearModel
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.stream import run
from foten.recording.split import Split
from foten.recording.trace import Trace
from foten.runtime.loops import run_loops
from foten.runtime.native import NativeTexture
from foten.training import calibration as closed_loop
from foten.training.blocks import ScaledBlocks
from foten.training.calibration import (
    N_RUNS,
    ClosedLoop,
    _filtered,
    _jackknifed,
    _lasts_s,
    _level_variance,
    calibrate_level,
    calibrate_network_gain,
    distance,
    fit_volatility,
)
from foten.training.config import TrainConfig
from foten.training.texture_builder import Tensors, proved, tensors_of

BLOCK, N_BLOCKS = 1000, 24


def model(before: bool = False) -> tuple[FotenPlusSizes, Tensors]:
    """Return a lattice that rings at 120 Hz, its gain before or after the filter, with an excitation that is Gaussian."""
    sizes = FotenPlusSizes(**PLUS, order=2, network_in_loop=False, gain_before_filter=before)
    tensors = untrained_tensors("foten-plus", sizes, untrained("foten-plus", sizes))
    tensors["excitation.volatility"] = np.zeros(2, dtype=np.float32)
    return sizes, tensors


def excitation_of(tensors: Tensors) -> Excitation:
    excitation = Excitation(len(tensors["excitation.hidden.bias"])).requires_grad_(False)
    state = {name: torch.from_numpy(tensors[f"excitation.{name}"]).clone() for name in excitation.state_dict()}
    excitation.load_state_dict(state)
    return excitation


def loop_of(before: bool = False, louder: float = 1.0) -> tuple[ClosedLoop, Excitation]:
    """Return a loop whose recording is one long free run of the model with the returned excitation, or louder by a factor."""
    sizes, tensors = model(before)
    rng, m = np.random.default_rng(7), sizes.history

    def kernel(excitation: Excitation) -> NativeTexture:
        given = {**tensors, **tensors_of(excitation, "excitation.")}
        golden = np.random.default_rng(1).standard_normal((6, m, 3))
        return proved("foten-plus", sizes, given, SCALING, golden, 0.1 * golden[0], CARD).kernel

    excitation = excitation_of(tensors)
    n, t = N_BLOCKS * BLOCK, np.arange(N_BLOCKS * BLOCK) / 1000
    speed, force = 100 * 2.0 ** np.sin(1.1 * t), 1.0 * 1.6 ** np.sin(1.7 * t)
    stacked = SCALING.scale(np.stack([np.zeros(n), speed, force], axis=1))
    condition = np.concatenate([stacked[:, 1:], speed[:, None]], axis=1)
    noise = rng.standard_normal((1, n))
    stacked[:, 0] = louder * run_loops(kernel(excitation), np.zeros((1, m, 3)), condition[None], noise)[0]
    trace = Trace(SCALING.unscale_acceleration(stacked[:, 0]), speed, force, 1000.0, BLOCK)
    split = Split(tuple(range(16)), tuple(range(16, 20)), tuple(range(20, 24)), 24, BLOCK, "contiguous", 0)
    blocks = ScaledBlocks(trace, split, SCALING, stacked.reshape(N_BLOCKS, BLOCK, 3))
    part = LinearModel(sizes, tensors, None, {})
    return ClosedLoop(blocks, m, kernel, part.power, part.response(BLOCK - m)), excitation


def test_free_runs_are_those_of_the_reference() -> None:
    """Oracle: the model in NumPy, under the same noise; float64 against float64 but for the lattice's float32 tensors."""
    loop, excitation = loop_of()
    sizes, tensors = model()
    recorded, rendered = loop.free_runs(excitation, (3, 17), 5, 40, 2)
    assert recorded.shape == (2, BLOCK - loop.settled)
    assert rendered.shape == (2, 2, BLOCK - loop.settled)
    np.testing.assert_array_equal(recorded, loop.blocks.samples[[3, 17], loop.settled :, 0])
    reference, m = model_of(sizes, tensors), loop.history
    for which, (stream, number) in enumerate([(40, 3), (41, 17), (42, 3), (43, 17)]):
        start = reference.start(loop.blocks.samples[[number], :m])
        condition = loop.blocks.path_conditions()[[number], m:]
        expected = run(start, condition, gaussian(5, stream, 0, BLOCK - m)[None])[0, loop.settled - m :]
        np.testing.assert_allclose(rendered[which // 2, which % 2], expected, atol=1e-9)


@pytest.mark.parametrize("before", [False, True])
def test_a_level_is_settled_in_the_closed_loop(before: bool) -> None:
    """An excitation twice too strong is 6 dB too loud, since the lattice is linear; two adjustments later it is not."""
    loop, excitation = loop_of(before)
    true = float(excitation.out.bias)
    chance = calibrate_level(loop, excitation_of(model(before)[1]), 0)[0]
    excitation.out.bias += math.log(2)
    errors = calibrate_level(loop, excitation, 0)
    assert errors[0] - chance == pytest.approx(6.02, abs=0.05)
    # What is left is less than twenty seconds tell: half a dB.
    assert abs(errors[-1]) < 0.5
    assert 20 / math.log(10) * (float(excitation.out.bias) - true) == pytest.approx(0.0, abs=0.5)


def test_a_slope_over_speed_is_settled_too() -> None:
    """σ that does not follow speed where the recording's does: most of the slope comes back, and the level is right."""
    loop, excitation = loop_of()
    true = excitation.power_law.weight[0, 0].item()
    excitation.power_law.weight[0, 0] = 0.0
    before = distance(loop, excitation, 0)[1]
    calibrate_level(loop, excitation, 0)
    assert excitation.power_law.weight[0, 0].item() == pytest.approx(true, abs=0.25)
    assert distance(loop, excitation, 0)[1] < before - 0.5


def test_the_scale_stays_within_that_of_the_trained_range() -> None:
    loop, excitation = loop_of()
    calibrate_level(loop, excitation, 0)
    n, _ = loop.blocks.targets(loop.history)
    within = torch.from_numpy(loop.blocks.flat[n - 1, 1:]).float()
    with torch.no_grad():
        free = excitation.highest.clone()
        excitation.highest.fill_(1e6)
        assert float(free) == pytest.approx(float(torch.quantile(excitation(within), 0.97)), rel=1e-5)


@pytest.mark.parametrize("settled", [False, True])
def test_a_network_s_innovations_are_bounded_by_no_more_than_they_need(settled: bool) -> None:
    """σ of a network that settled its own level had a limit of 10⁶, and so had the bound that is proven of its file."""
    loop, _ = loop_of()
    fitted = calibrate_network_gain(16, [5.0, 3.0], loop, TrainConfig(), None, settled).excitation
    n, _ = loop.blocks.targets(loop.history)
    with torch.no_grad():
        sigma = fitted(torch.from_numpy(loop.blocks.flat[n - 1, 1:]).float())
    assert float(fitted.highest) < 1.5 * float(sigma.max())
    assert not settled or set(sigma.tolist()) == {1.0}


def test_a_free_run_is_as_far_as_it_is_too_loud() -> None:
    near, louder = (distance(*loop_of(louder=factor), seed=0) for factor in (1.0, 2.0))
    # Of what the model itself made: chance alone. In a frame of 40 ms a resonance 16 Hz wide is known to 3 dB.
    assert near[0] < 3.0
    assert near[1] < 3.5
    assert louder[1] == pytest.approx(6.02, abs=0.7)
    assert louder[0] > near[0] + 2


def test_volatility_is_given_to_a_recording_that_is_spikier_than_its_free_run() -> None:
    """The same blocks, and the same with a quarter of each eight times louder: kurtosis 3 and about 12."""
    loop, excitation = loop_of()
    given = []
    for louder in (0.0, 0.25):
        samples = loop.blocks.samples.copy()
        samples[:, BLOCK - round(louder * BLOCK) :, 0] *= 8
        blocks = dataclasses.replace(loop.blocks, samples=samples)
        fit_volatility(dataclasses.replace(loop, blocks=blocks), excitation, 0)
        given.append(excitation.volatility.numpy().copy())
        excitation.volatility.zero_()
    assert given[0][1] < 0.15
    assert given[1][1] > 0.3


@pytest.mark.parametrize(
    ("spikier", "varied", "sd"),
    [
        (0.4, (1.0, 0.0), 0.5 * math.sqrt(0.4 * 0.75)),
        (0.15, (1.0, 0.0), 0.0),
        (-0.3, (1.0, 0.0), 0.0),
        (0.4, (0.03, 0.0), 0.2),
        (0.4, (0.04, 0.02), 0.2),
        (0.4, (0.01, 0.0), 0.0),
        (0.4, (-0.02, 0.01), 0.0),
        (9.0, (9.0, 0.0), 0.6),
    ],
)
def test_volatility_is_as_large_as_what_is_beyond_chance(
    monkeypatch: pytest.MonkeyPatch, spikier: float, varied: tuple[float, float], sd: float
) -> None:
    """Known to within 0.2, a logarithm of 0.4 counts three quarters: 1 − (0.2/0.4)². Of varying levels 0.01 is the level's."""
    monkeypatch.setattr(closed_loop, "_spikier", lambda recorded, rendered: (spikier, 0.2))
    monkeypatch.setattr(closed_loop, "_level_variance", lambda *signals: varied)
    monkeypatch.setattr(closed_loop, "_lasts_s", lambda *signals: 0.05)
    shape = (len(KNOWN.known), BLOCK - 200)
    runs = np.zeros(shape), np.zeros((N_RUNS, *shape))
    monkeypatch.setattr(ClosedLoop, "free_runs", lambda *_: runs)
    excitation = Excitation(2).requires_grad_(False)
    fit_volatility(ClosedLoop(KNOWN, 3, None, None), excitation, 0)  # type: ignore[arg-type]
    assert excitation.volatility.numpy() == pytest.approx([math.exp(-1 / 50), sd], rel=1e-6)


def still_blocks(n: int, block: int, known: tuple[int, ...]) -> ScaledBlocks:
    """Return blocks under a steady hand, of which some may be looked at."""
    trace = Trace(np.zeros(n * block), np.full(n * block, 50.0), np.full(n * block, 1.0), 1000.0, block)
    others = tuple(k for k in range(n) if k not in known)
    split = Split(known[:-1], known[-1:], others, n, block, "contiguous", 0)
    return ScaledBlocks(trace, split, SCALING, np.zeros((n, block, 3)))


KNOWN = still_blocks(4, BLOCK, (0, 1, 3))


@pytest.mark.parametrize("lasts", [0.005, 0.02, 0.1])
def test_how_long_volatility_lasts_is_read_from_frames(lasts: float) -> None:
    """White noise at 10 kHz whose log loudness is an exponentially correlated Gaussian of standard deviation 0.35."""
    rng = np.random.default_rng(11)
    rate, shape = 10_000.0, (20, 10_000)
    kept = math.exp(-1 / (lasts * rate))
    shocks = rng.standard_normal(shape) * math.sqrt(1 - kept * kept)
    shocks[:, 0] /= math.sqrt(1 - kept * kept)
    loudness = lfilter([1.0], [1.0, -kept], shocks, axis=1)
    recorded = np.exp(0.35 * loudness) * rng.standard_normal(shape)
    estimate = _lasts_s(recorded, rng.standard_normal(shape), rate)
    assert lasts / 2 <= estimate <= 2 * lasts


@pytest.mark.parametrize("sd", [0.0, 0.35])
def test_levels_vary_by_the_volatility_alone(sd: float) -> None:
    """Heavy-tailed noise under a hand that makes it ten times as loud; volatility of 100 ms; frames at rest do not count."""
    rng = np.random.default_rng(3)
    rate, shape, kept = 1000.0, (30, 2000), math.exp(-0.01)
    hand = 10 ** np.sin(np.arange(shape[1]) / 100)
    shocks = rng.standard_normal(shape) * math.sqrt(1 - kept * kept)
    shocks[:, 0] /= math.sqrt(1 - kept * kept)
    loudness = np.exp(sd * lfilter([1.0], [1.0, -kept], shocks, axis=1))
    recorded = loudness * hand * rng.standard_t(4, shape)
    recorded[:, :195] *= 50
    moving = np.ones(shape, dtype=bool)
    moving[:, :195] = False  # half of a frame
    variance, doubt = _level_variance(recorded, hand * rng.standard_t(4, (5, *shape)), moving, rate)
    # The mean over 10 of 100 ms leaves 0.967 of the variance.
    assert abs(variance - 0.967 * sd**2) < 4 * doubt
    assert doubt < 0.01


def test_the_jackknife_of_a_mean_is_its_standard_error() -> None:
    values = np.random.default_rng(0).standard_normal(30)
    result = _jackknifed(np.stack([values, np.ones(30)]), np.divide)
    assert result == pytest.approx((values.mean(), values.std(ddof=1) / math.sqrt(30)), rel=1e-9)


def test_a_still_hand_or_one_in_the_air_does_not_count() -> None:
    n = np.arange(4000).reshape(4, 1000)
    speed, force = 5.0 + 0 * n, 0.1 + 0 * n
    speed[1, 900:], force[3, 950:] = 4.9, 0.09
    trace = Trace(np.zeros(4000), speed.ravel(), force.ravel(), 1000.0, 1000)
    moving = dataclasses.replace(KNOWN, trace=trace).moving()
    assert moving.shape == (4, 1000)
    assert moving[[0, 2]].all()
    assert list(np.flatnonzero(~moving[1])) == list(range(900, 1000))
    assert list(np.flatnonzero(~moving[3])) == list(range(950, 1000))


@pytest.mark.parametrize("before", [False, True])
def test_power_that_enters_a_lattice_rings_on(before: bool) -> None:
    """Oracle: the mean square of what a lattice makes of noise whose power jumps, over 4000 runs."""
    k = np.array([-0.9, 0.95])
    sizes = FotenPlusSizes(**PLUS, order=2, gain_before_filter=before)
    response = LinearModel(sizes, {"lattice.reflections": k[None]}, None, {}).response(200)
    power = np.concatenate([np.full(100, 4.0), np.full(100, 0.01)])
    leaving = _filtered(power[None, :, None], response)[0, :, 0]
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
