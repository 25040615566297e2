"""One-step figures: errors of predictions, how well an excitation describes them, and the linear predictor beside them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from conftest import PLUS, SCALING, SMALL, exported, resonance
from foten.dsp.ar import spectral_radius
from foten.evaluate.metrics import goodness_of_fit
from foten.evaluate.one_step import (
    MAX_POLE,
    ORDERS,
    Linear,
    best_linear,
    excitation_scores,
    fit_linear,
    one_step,
    predict,
)
from foten.models.definitions import model_of
from foten.models.foten.sizes import FotenSizes
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import ONE_STEP_TOLERANCE
from foten.recording.windows import first_scored, windows
from foten.runtime.loops import predict_blocks, render_streams
from foten.runtime.native import NativeTexture


def test_figures_are_those_of_the_errors_by_hand() -> None:
    rng = np.random.default_rng(0)
    samples = rng.standard_normal((5000, 3))
    n = np.array([[10], [2000]]) + np.arange(2500)
    figures = one_step(samples[n, 0], samples[n - 1, 0], SCALING.sd[0])
    error = np.abs(samples[n, 0] - samples[n - 1, 0])
    assert figures["mae_scaled"] == pytest.approx(error.mean())
    assert figures["mae_m_s2"] == pytest.approx(error.mean() * SCALING.sd[0])
    fits = [goodness_of_fit(samples[row, 0], samples[row - 1, 0]) for row in n]
    assert figures["gfc"] == pytest.approx(np.mean(fits))


def test_a_texture_predicts_each_sample_from_its_history() -> None:
    """Seam: the reference, window by window; its own windows are longer than the samples before a row need be."""
    sizes = FotenSizes(**SMALL)
    texture = exported("foten", sizes)
    samples = np.random.default_rng(1).standard_normal((300, 3))
    n = np.array([[60], [180]]) + np.arange(50)
    predicted = predict(NativeTexture(texture.to_bytes()), samples, n).sample
    some = windows(samples, n.ravel(), texture.window)
    expected = model_of(sizes, texture.tensors).predict(some).reshape(n.shape)
    np.testing.assert_allclose(predicted, expected, rtol=ONE_STEP_TOLERANCE, atol=ONE_STEP_TOLERANCE)


@pytest.mark.parametrize(
    "sizes",
    [
        FotenPlusSizes(**{**PLUS, "order": 6}),
        FotenPlusSizes(**{**PLUS, "order": 6, "gain_before_filter": True}),
        FotenSizes(**SMALL, excitation=True),
    ],
)
def test_scores_of_a_texture_on_its_own_loop_are_those_of_the_noise(sizes: FotenPlusSizes | FotenSizes) -> None:
    """Recovery: the errors of the prediction that a rendering uses, taken back through the scale, are what was drawn."""
    texture = exported("foten" if isinstance(sizes, FotenSizes) else "foten-plus", sizes)
    native, rng = NativeTexture(texture.to_bytes()), np.random.default_rng(2)
    m, k = texture.window, 3000
    condition = np.cumsum(0.02 * rng.standard_normal((1, k, 3)), axis=1).clip(-1, 1)
    noise = rng.standard_normal((1, k))
    window = rng.standard_normal((1, m, 3))
    looped = render_streams(native, window, condition, noise)
    samples = np.concatenate([window[0], np.concatenate([looped[0][:, None], condition[0, :, :2]], axis=1)])
    n = (m + np.arange(k)).reshape(1, k)
    counted = np.ones(n.shape, dtype=bool)
    scores = excitation_scores(native, samples, n, counted)
    # What is drawn is known to the float32 of the paper's network; the noise is within what no distribution cuts.
    assert scores["standardised_sd"] == pytest.approx(np.sqrt(np.square(noise).mean()), rel=1e-3)
    assert scores["coverage_50"] == pytest.approx((np.abs(noise) < 0.67449).mean(), abs=2e-3)
    assert scores["coverage_90"] == pytest.approx((np.abs(noise) < 1.64485).mean(), abs=2e-3)
    half = counted & (np.arange(k) < k // 2)
    some = excitation_scores(native, samples, n, half)
    assert some["standardised_sd"] == pytest.approx(np.sqrt(np.square(noise[half]).mean()), rel=1e-3)
    none = excitation_scores(native, samples, n, np.zeros_like(counted))
    assert none["nll"] is none["coverage_90"] is None


def test_scores_are_of_the_prediction_that_a_rendering_uses() -> None:
    """The excitation of a rendering without the network says nothing of the errors of a prediction with it."""
    samples = np.random.default_rng(0).standard_normal((240, 3))
    n = np.array([[60], [180]]) + np.arange(50)
    texture = exported("foten-plus", FotenPlusSizes(**PLUS))
    native = NativeTexture(texture.to_bytes())
    scores = excitation_scores(native, samples, n, np.ones(n.shape, dtype=bool))
    rows = np.stack([samples[row[0] - texture.window : row[-1] + 1] for row in n])
    predicted = predict_blocks(native, rows, "linear")
    assert np.abs(predict(native, samples, n, "model").sample - predicted.sample).max() > 1e-3
    assert scores["nll"] == pytest.approx(predicted.nll.mean())


def test_where_a_rendering_has_tones_the_error_is_not_known() -> None:
    texture = exported("foten-plus", FotenPlusSizes(**PLUS, n_tones=2))
    samples = np.random.default_rng(0).standard_normal((120, 3))
    n = 70 + np.arange(40)[None]
    scores = excitation_scores(NativeTexture(texture.to_bytes()), samples, n, np.ones(n.shape, dtype=bool))
    assert scores == {**dict.fromkeys(("nll", "coverage_50", "coverage_90", "standardised_sd")), "intervals": {}}


BLOCK = 400


def process(taps: np.ndarray, n_blocks: int, sd: float = 0.5, seed: int = 0) -> np.ndarray:
    """Scaled samples (n, 3) of an AR process (taps oldest first) under a wandering hand."""
    rng = np.random.default_rng(seed)
    n = n_blocks * BLOCK
    x = lfilter([sd], np.concatenate([[1.0], -taps[::-1]]), rng.standard_normal(n + 500))[500:]
    return np.column_stack([x, rng.standard_normal((n, 2))])


def test_a_known_process_and_its_noise_are_recovered() -> None:
    taps = resonance(120.0, 0.95, 5)
    samples = process(taps, 100)
    samples[:, 0] += 0.4 * (1 - taps.sum())  # a constant input, which a constant mean of 0.4 needs
    fitted = fit_linear(samples - [0.4 * (1 - taps.sum()) - 0.4, 0, 0], tuple(range(100)), BLOCK, 5)
    assert fitted is not None
    # Standard errors are at most about 1/√n = 0.005 a tap; four of them.
    error = 4 / np.sqrt(len(samples))
    np.testing.assert_allclose(fitted.coefficients[:-1], taps, atol=error)
    assert fitted.coefficients[-1] == pytest.approx(0.4 * (1 - taps.sum()), abs=error)
    assert fitted.noise_sd == pytest.approx(0.5, rel=4 / np.sqrt(2 * len(samples)))


def scheduled_process(n_blocks: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Samples whose taps are affine in the speed and force of the sample before, and those coefficients."""
    rng = np.random.default_rng(seed)
    coefficients = np.array([[-0.6, 0.9, 0.1], [0.1, -0.15, 0.0], [-0.05, 0.05, 0.2]])
    n = n_blocks * BLOCK
    condition = rng.uniform(-1, 1, (n, 2))
    x = np.zeros(n)
    noise = 0.3 * rng.standard_normal(n)
    for i in range(2, n):
        now = coefficients[0] + condition[i - 1] @ coefficients[1:]
        x[i] = now[0] * x[i - 2] + now[1] * x[i - 1] + now[2] + noise[i]
    return np.column_stack([x, condition]), coefficients


def test_coefficients_that_follow_the_hand_are_recovered() -> None:
    samples, coefficients = scheduled_process(60)
    fitted = fit_linear(samples, tuple(range(60)), BLOCK, 2, scheduled=True)
    assert fitted is not None
    assert fitted.scheduled
    assert fitted.window == 2
    # 24 000 samples; the condition's variance of 1/3 and the noise's 0.3 against a unit signal: 0.011 at most each.
    np.testing.assert_allclose(fitted.coefficients, coefficients, atol=4 * np.sqrt(3) / np.sqrt(len(samples)))
    assert fitted.noise_sd == pytest.approx(0.3, rel=0.02)  # 4/√(2n)


def test_a_linear_predictor_looks_at_the_samples_before() -> None:
    samples, coefficients = scheduled_process(2)
    n = np.array([[9], [300]]) + np.arange(91)
    by_hand = [
        [
            (coefficients[0] + w[-1, 1] * coefficients[1] + w[-1, 2] * coefficients[2]) @ [w[-2, 0], w[-1, 0], 1.0]
            for w in (samples[i - 2 : i] for i in row)
        ]
        for row in n
    ]
    np.testing.assert_allclose(Linear(coefficients, 0.3).predict(samples, n), by_hand, atol=1e-12)  # rounding
    constant = [[coefficients[0] @ [samples[i - 2, 0], samples[i - 1, 0], 1.0] for i in row] for row in n]
    np.testing.assert_allclose(Linear(coefficients[0], 0.3).predict(samples, n), constant, atol=1e-12)


@pytest.mark.parametrize(("lag", "order"), [(4, 5), (9, 10), (17, 20), (33, 40)])
def test_the_best_order_is_the_least_that_sees_the_process(lag: int, order: int) -> None:
    taps = np.zeros(lag)
    taps[0], taps[-1] = 0.6, 0.3
    samples = process(taps, 64)
    # Each coefficient too many costs half a 1600th of the error; paired, 14 400 samples tell five of them apart.
    fitted = best_linear(samples, (0, 1, 2, 3), tuple(range(4, 64)), BLOCK)
    assert fitted is not None
    assert (fitted.window, fitted.scheduled) == (order, False)


def test_the_best_is_scheduled_where_the_hand_matters() -> None:
    samples, _ = scheduled_process(30)
    fitted = best_linear(samples, tuple(range(20)), tuple(range(20, 30)), BLOCK)
    assert fitted is not None
    assert (fitted.window, fitted.scheduled) == (ORDERS[0], True)


def test_too_few_windows_are_no_fit() -> None:
    samples = process(resonance(120.0, 0.9, 5), 4)
    assert fit_linear(samples[:100], (0,), 40, 20) is None  # 20 windows for 21 coefficients
    assert fit_linear(samples, (0,), 20, 20) is None
    assert fit_linear(samples, (0,), BLOCK, 160, scheduled=True) is None
    assert best_linear(samples[:120], (0, 1, 2), (3,), 10) is None  # blocks shorter than what is not scored


def test_no_order_is_longer_than_what_every_method_is_spared() -> None:
    """Lag 70 in blocks of 100: an order of 80 would look back beyond a block from its fiftieth sample on."""
    taps = np.zeros(70)
    taps[0], taps[-1] = 0.5, 0.45
    samples = process(taps, 20)[:2000]
    fitted = best_linear(samples, tuple(range(14)), tuple(range(14, 20)), 100)
    assert fitted is not None
    assert fitted.window <= first_scored(100) == 50
    assert (first_scored(30), first_scored(2000)) == (20, 320)
    taps[32], taps[-1] = 0.45, 0.0  # an order of 40 is as long as that of blocks of 80
    fitted = best_linear(process(taps, 20)[:1600], tuple(range(14)), tuple(range(14, 20)), 80)
    assert fitted is not None
    assert fitted.window == first_scored(80) == 40


def test_an_unstable_fit_is_made_stable_for_the_closed_loop() -> None:
    taps = resonance(120.0, 1.02, 6)
    stable = Linear(np.append(taps, 0.1), 0.5).stable()
    assert spectral_radius(stable.coefficients[:-1]) == pytest.approx(MAX_POLE, rel=1e-9)
    assert (stable.coefficients[-1], stable.noise_sd) == (0.1, 0.5)
    poles = np.roots(np.concatenate([[1.0], -stable.coefficients[-2::-1]]))
    assert np.abs(np.angle(poles[np.abs(poles) > 0.5])) == pytest.approx(2 * np.pi * 0.12, rel=1e-9)
