import math
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.special import polygamma

from conftest import PLUS, SCALING, exported, resonance
from foten.evaluate.free_run import free_run, nearest_training_blocks, scored, synthesize, synthesize_linear
from foten.evaluate.one_step import Linear, fit_linear
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import ONE_STEP_TOLERANCE, Texture
from foten.recording.scaling import Scaling
from foten.recording.trace import Trace
from foten.runtime.loops import predict_blocks
from foten.runtime.native import NativeTexture

RATE_HZ, BLOCK = 1000.0, 2000


def resonant(*shape: int, seed: int) -> np.ndarray:
    """Realisations of one AR(2) process, settled."""
    noise = np.random.default_rng(seed).standard_normal((*shape[:-1], shape[-1] + 500))
    return np.asarray(lfilter([1.0], [1.0, *-resonance(120.0, 0.9, 2)[::-1]], noise))[..., 500:]


def hand(n_blocks: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    speed = np.repeat(rng.uniform(20, 200, (n_blocks, BLOCK // 40)), 40, axis=1)
    force = np.repeat(rng.uniform(0.4, 2.4, (n_blocks, BLOCK // 40)), 40, axis=1)
    return speed, force


def figures(recorded: np.ndarray, synthesized: np.ndarray) -> dict[str, Any]:
    return free_run(recorded, synthesized, RATE_HZ, float(recorded.std()))


def test_two_realisations_of_one_process_are_as_far_as_chance_sets_them() -> None:
    """Oracle: the spread of the logarithm of Welch's estimate, a χ² with 2K/(1 + 2(K−1)/(36K)) degrees of freedom."""
    found = figures(resonant(12, BLOCK, seed=0), resonant(3, 12, BLOCK, seed=1))
    k = (1600 - 256) // 128 + 1  # Hann segments, half overlapping, over the scored 1600 samples
    freedom = 2 * k / (1 + 2 * (k - 1) / (36 * k))
    sd_db = 10 / math.log(10) * math.sqrt(2 * polygamma(1, freedom / 2))
    # The RMS over about 110 bins, a third of them independent, lies 2 % below that; 36 of them scatter by 2 %.
    assert found["lsd_db"] == pytest.approx(sd_db, rel=0.06)
    assert found["lsd_long_db"] < found["lsd_db"] / 2  # pooled over blocks and runs chance shrinks
    # Frames of 40 samples with poles at 0.9 hold 40·(1 − 0.9⁴)/… ≈ 10 independent values: levels scatter by 2 dB.
    assert found["level_bias_db"] == pytest.approx(0.0, abs=0.3)
    assert found["gfc_raw"] == pytest.approx(math.pi / 4, abs=0.03)  # Rayleigh amplitudes; the spectrum's shape
    assert found["gfc_welch"] > 0.97
    assert found["kurtosis"] == pytest.approx(3.0, abs=0.15)
    assert abs(found["level_corr"]) < 0.15  # 4/√480 independent frames each, three runs


@pytest.mark.parametrize("gain", [1.0, 2.0, 0.5])
def test_a_gain_shows_as_level_and_as_nothing_else(gain: float) -> None:
    recorded = resonant(4, BLOCK, seed=0)
    found = figures(recorded, gain * np.stack([recorded, recorded]))
    gain_db = 20 * math.log10(gain)
    expected = {"level_bias_db": gain_db, "level_jnd": abs(gain_db) / 2.3}
    expected |= dict.fromkeys(("level_error_db", "lsd_db", "lsd_long_db"), abs(gain_db))
    expected |= dict.fromkeys(("emd_octaves", "band_correlation_error", "modulation_db"), 0.0)
    expected |= dict.fromkeys(("gfc_raw", "gfc_welch", "level_corr"), 1.0)
    assert {key: found[key] for key in expected} == pytest.approx(expected, abs=1e-9)
    np.testing.assert_allclose(found["band_errors_db"], gain_db, atol=1e-9)
    assert found["kurtosis"] == pytest.approx(found["kurtosis_recorded"], rel=1e-12)
    assert found["max_sd"] == pytest.approx(gain * np.abs(recorded).max() / recorded.std(), rel=1e-9)


def test_bands_that_rise_in_step_are_seen_where_each_rises_by_itself() -> None:
    """Impacts, and noise of their spectrum: correlations of all pairs of bands differ by 0.3 and more, by chance by 0.05."""
    rng = np.random.default_rng(0)

    def impacts() -> np.ndarray:
        hits = np.where(rng.random((8, BLOCK)) < 0.005, 14.0, 0.0)
        return lfilter([1.0], [1.0, *-resonance(120.0, 0.9, 2)[::-1]], hits)

    recorded = impacts()
    apart, alike = figures(recorded, resonant(2, 8, BLOCK, seed=1)), figures(recorded, np.stack([impacts(), impacts()]))
    assert apart["band_correlation_error"] > 0.3 > 0.15 > alike["band_correlation_error"]


def test_silence_is_judged_and_not_divided_by() -> None:
    recorded = resonant(4, BLOCK, seed=0)
    found = figures(recorded, np.zeros((1, 4, BLOCK)))
    assert found["lsd_db"] > 60
    assert found["level_bias_db"] < -25  # the floor is 30 dB below the recorded level
    assert found["gfc_raw"] == 0.0
    assert found["level_corr"] is None
    assert found["max_sd"] == 0.0


def test_settling_is_not_scored() -> None:
    recorded = resonant(4, BLOCK, seed=0)
    started = recorded[None].copy()
    started[..., : BLOCK // 5] = 1e3
    found, expected = figures(recorded, started), figures(recorded, recorded[None])
    # But a burst at the start is a burst.
    assert found.pop("max_sd") > 100 > expected.pop("max_sd")
    assert found == expected
    assert scored(BLOCK) == slice(400, None)


def test_a_level_that_follows_the_hand_is_told_from_one_that_does_not() -> None:
    speed, force = hand(8)
    level = (speed / 100) ** 0.7 * force**0.35
    recorded = level * resonant(8, BLOCK, seed=0)
    faithful, dull = level * resonant(2, 8, BLOCK, seed=1), 1.5 * resonant(2, 8, BLOCK, seed=2)
    good, bad = (free_run(recorded, s, RATE_HZ, 1.0) for s in (faithful, dull))
    assert good["level_corr"] > 0.75 > 0.2 > abs(bad["level_corr"])


def trace(n_blocks: int, block: int = 300, seed: int = 0) -> Trace:
    rng = np.random.default_rng(seed)
    return Trace(
        SCALING.mean[0] + SCALING.sd[0] * resonant(n_blocks * block, seed=seed) / 4,
        np.repeat(rng.uniform(20, 200, n_blocks), block),
        np.repeat(rng.uniform(0.4, 2.4, n_blocks), block),
        RATE_HZ,
        block,
    )


def test_a_texture_starts_from_each_blocks_own_window(texture: Texture) -> None:
    recorded = trace(4)
    out, n_saturated = synthesize(NativeTexture(texture.to_bytes()), recorded, (1, 3), excitation=True, n_seeds=3)
    assert out.shape == (3, 2, 300)
    assert n_saturated == 0
    expected = recorded.blocks(recorded.acceleration)[[1, 3], : texture.window]
    m = texture.window
    np.testing.assert_array_equal(out[:, :, :m], np.broadcast_to(expected, (3, 2, m)))
    flat = out[:, :, m:].reshape(6, -1)
    assert np.abs(np.corrcoef(flat) - np.eye(6)).max() < 0.9  # six streams of noise, all different
    again, _ = synthesize(NativeTexture(texture.to_bytes()), recorded, (1, 3), excitation=True, n_seeds=3)
    np.testing.assert_array_equal(again, out)
    other, _ = synthesize(NativeTexture(texture.to_bytes()), recorded, (1, 3), excitation=True, seed=1, n_seeds=3)
    assert not np.array_equal(other, out)


def test_the_first_free_sample_is_the_one_step_prediction() -> None:
    """Where σ is 1, as it is before the level is settled."""
    unscaled = ("excitation.out.weight", "excitation.out.bias", "excitation.exponents")
    sizes = FotenPlusSizes(**PLUS, order=6)
    shapes = sizes.tensor_shapes()
    texture = exported("foten-plus", sizes, {name: np.zeros(shapes[name]) for name in unscaled})
    recorded = trace(3)
    out, _ = synthesize(NativeTexture(texture.to_bytes()), recorded, (0, 1, 2), excitation=False)
    windows = texture.scaling.scale(recorded.stacked()).reshape(3, 300, 3)[:, : texture.window]
    padded = np.pad(windows, ((0, 0), (0, 1), (0, 0)))  # what is predicted is not looked at
    predicted = predict_blocks(NativeTexture(texture.to_bytes()), padded, "linear").sample[:, 0]
    expected = texture.scaling.unscale_acceleration(predicted)
    np.testing.assert_allclose(out[0, :, texture.window], expected, atol=ONE_STEP_TOLERANCE * SCALING.sd[0])


def test_a_linear_predictor_with_noise_gives_its_process_back() -> None:
    process = resonant(30_000, seed=5)
    rest = np.zeros(30_000)
    recorded = Trace(3 + 2 * process, rest, rest, RATE_HZ, 1000)
    scaling = Scaling((3.0, 0.0, 0.0), (2.0, 1.0, 1.0))
    fitted = fit_linear(scaling.scale(recorded.stacked()), tuple(range(20)), 1000, 5)
    assert fitted is not None
    out = synthesize_linear(fitted, recorded, tuple(range(20, 30)), scaling, n_seeds=4)
    assert out.shape == (4, 10, 1000)
    np.testing.assert_allclose(out[0, :, :5], recorded.blocks(recorded.acceleration)[20:, :5], rtol=1e-12)
    # Poles at 0.9 leave 0.2 independent values a sample: the recorded RMS is known to 1/√(2·0.2·20 000) = 1.1 %.
    assert out.std() == pytest.approx(recorded.acceleration.std(), rel=0.04)
    assert out.mean() == pytest.approx(3.0, abs=0.1)


def test_a_linear_predictor_without_noise_settles_on_its_mean() -> None:
    # y = 0.5 + 0.6 y + 0.2 y has the mean 0.5/(1 − 0.8) = 2.5; its pole of 0.86 forgets its start in 250 samples.
    predictor = Linear(np.array([0.6, 0.2, 0.5]), noise_sd=0.0)
    out = synthesize_linear(predictor, trace(3), (0, 2), SCALING, n_seeds=1)
    np.testing.assert_allclose(out[0, :, -20:], SCALING.mean[0] + 2.5 * SCALING.sd[0], rtol=1e-12)


def test_the_nearest_training_block_is_nearest_in_speed_and_force() -> None:
    block = 50
    speed, force = (np.repeat([10.0, 100.0, 100.0, 52.0, 15.0], block), np.repeat([1.0, 1.0, 2.0, 1.9, 1.1], block))
    recorded = Trace(np.repeat(np.arange(5.0), block), speed, force, RATE_HZ, block)
    found = nearest_training_blocks(recorded, (3, 4), (0, 1, 2))  # 52 mm/s is nearer to 10, by less than 1.9 N is to 2
    assert found.shape == (1, 2, block)
    np.testing.assert_array_equal(found[0, :, 0], [2, 0])
    still = Trace(recorded.acceleration, np.full(250, 80.0), force, RATE_HZ, block)
    np.testing.assert_array_equal(nearest_training_blocks(still, (3,), (0, 1, 2))[0, :, 0], [2])


def test_blocks_without_a_frame_have_no_level() -> None:
    rng = np.random.default_rng(0)
    found = free_run(rng.standard_normal((3, 400)), rng.standard_normal((2, 3, 400)), 10_000.0, 1.0)
    assert found["level_bias_db"] is found["level_error_db"] is found["level_corr"] is None
    assert np.isfinite(found["lsd_db"])


def test_the_largest_sample_is_a_synthesized_one() -> None:
    recorded = np.random.default_rng(0).standard_normal((2, 2000))
    synthesized = 0.1 * recorded[None]
    synthesized[:, 0, 5] = 40.0  # of the recorded window
    synthesized[:, 1, 300] = -7.0
    assert free_run(recorded, synthesized, 1000.0, 1.0, n_history=20)["max_sd"] == pytest.approx(7.0)
    assert free_run(recorded, synthesized, 1000.0, 1.0)["max_sd"] == pytest.approx(40.0)
