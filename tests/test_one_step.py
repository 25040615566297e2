"""One-step figures: the errors of predictions, and how well an excitation describes them."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import PLUS, SCALING, SMALL, exported
from foten.evaluate.metrics import goodness_of_fit
from foten.evaluate.one_step import excitation_scores, one_step, predict
from foten.models.definitions import model_of
from foten.models.foten.sizes import FotenSizes
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import ONE_STEP_TOLERANCE, Texture
from foten.recording.windows import windows
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


def unscaled(sizes: FotenPlusSizes | FotenSizes) -> Texture:
    """A texture whose network's innovations, where one is in the loop, are not scaled."""
    tensors: dict[str, np.ndarray] = {}
    if isinstance(sizes, FotenPlusSizes) and sizes.network_in_loop:
        shapes = sizes.tensor_shapes()
        tensors = {
            f"excitation.{name}": np.zeros(shapes[f"excitation.{name}"])
            for name in ("out.weight", "out.bias", "exponents")
        }
    return exported("foten" if isinstance(sizes, FotenSizes) else "foten-plus", sizes, tensors)


@pytest.mark.parametrize(
    "sizes",
    [
        FotenPlusSizes(**{**PLUS, "order": 6}),
        FotenPlusSizes(**{**PLUS, "order": 6, "network_in_loop": False, "gain_before_filter": True}),
        FotenSizes(**SMALL, excitation=True),
    ],
)
def test_scores_of_a_texture_on_its_own_loop_are_those_of_the_noise(sizes: FotenPlusSizes | FotenSizes) -> None:
    """Recovery: the errors of the prediction that a rendering uses, taken back through the scale, are what was drawn."""
    texture = unscaled(sizes)
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
    nlls = []
    for in_loop in (False, True):
        texture = unscaled(FotenPlusSizes(**{**PLUS, "network_in_loop": in_loop}))
        native = NativeTexture(texture.to_bytes())
        scores = excitation_scores(native, samples, n, np.ones(n.shape, dtype=bool))
        rows = np.stack([samples[row[0] - texture.window : row[-1] + 1] for row in n])
        predicted = predict_blocks(native, rows, "rendering")
        other = predict(native, samples, n, "linear" if in_loop else "model").sample
        assert np.abs(other - predicted.sample).max() > 1e-3
        assert scores["nll"] == pytest.approx(predicted.nll.mean())
        nlls.append(scores["nll"])
    assert nlls[0] != nlls[1]


def test_where_a_rendering_has_tones_the_error_is_not_known() -> None:
    texture = exported("foten-plus", FotenPlusSizes(**PLUS, n_tones=2))
    samples = np.random.default_rng(0).standard_normal((120, 3))
    n = 70 + np.arange(40)[None]
    scores = excitation_scores(NativeTexture(texture.to_bytes()), samples, n, np.ones(n.shape, dtype=bool))
    assert scores == {**dict.fromkeys(("nll", "coverage_50", "coverage_90", "standardised_sd")), "intervals": {}}
