import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from foten.dsp import distance, level
from foten.evaluate import metrics
from foten.evaluate.metrics import with_intervals

RATE_HZ = 1000.0
Draw = Callable[[np.random.Generator, int], np.ndarray]


def noise(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


def tone(hz: float, n: int = 4000, rate_hz: float = RATE_HZ) -> np.ndarray:
    return np.sin(2 * np.pi * hz * np.arange(n) / rate_hz)


def gfc_by_eq_13(measured: np.ndarray, reconstructed: np.ndarray) -> float:
    """Eq. 13 as sums over bins of a direct transform."""
    n = measured.size
    turn = np.exp(-2j * np.pi * np.outer(np.arange(n // 2 + 1), np.arange(n)) / n)
    a_d, a_m = np.abs(turn @ measured), np.abs(turn @ reconstructed)
    return abs(sum(a_d * a_m)) / (math.sqrt(abs(sum(a_d**2))) * math.sqrt(abs(sum(a_m**2))))


def test_gfc_is_eq_13() -> None:
    """Oracle: Eq. 13 by direct sums."""
    a, b = noise(2, 200)
    assert metrics.goodness_of_fit(a, b) == pytest.approx(gfc_by_eq_13(a, b), abs=1e-12)  # rounding


def test_gfc_is_blind_to_gain_sign_and_phase() -> None:
    a = noise(500)
    for twin in (a, 3.7 * a, -a, a[::-1], np.roll(a, 123)):
        assert metrics.goodness_of_fit(a, twin) == pytest.approx(1.0, abs=1e-12)  # rounding


def test_gfc_of_tones_apart_is_zero_and_of_silence_too() -> None:
    assert metrics.goodness_of_fit(tone(50.0), tone(120.0)) < 1e-12  # whole periods: no leakage, only rounding
    assert metrics.goodness_of_fit(tone(50.0), np.zeros(4000)) == 0.0
    assert metrics.goodness_of_fit(np.zeros(4000), tone(50.0)) == 0.0


def test_welch_keeps_the_power() -> None:
    """Parseval: the density integrates to the variance."""
    frequencies, density = distance.welch(noise(20, 2000), RATE_HZ, 256)
    assert density.shape == (20, 129)
    total = density.mean(axis=0).sum() * (frequencies[1] - frequencies[0])
    # The variance of 40 000 samples is known to √(2/40000) = 0.7 %; each segment loses its mean, 1/256 of it.
    assert total == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("gain", [0.1, 0.5, 1.0, 2.0, 10.0])
def test_the_spectral_distance_of_a_gain_is_the_gain(gain: float) -> None:
    p = np.abs(noise(4, 60)) + 0.01
    apart = distance.log_spectral_distance(p, gain**2 * p)
    np.testing.assert_allclose(apart, abs(20 * math.log10(gain)), atol=1e-9)  # rounding


def test_the_spectral_distance_is_the_rms_over_bins() -> None:
    p = np.ones(4)
    q = 10 ** (np.array([0.3, -0.3, 0.0, 0.4]))  # 3, −3, 0 and 4 dB
    assert distance.log_spectral_distance(p, q) == pytest.approx(math.sqrt((9 + 9 + 16) / 4), rel=1e-9)
    assert distance.log_spectral_distance(p, q) == pytest.approx(distance.log_spectral_distance(q, p), rel=1e-9)


def test_silence_is_far_and_not_infinitely() -> None:
    assert distance.log_spectral_distance(np.full(9, 3.0), np.zeros(9)) == pytest.approx(120.0, abs=1e-9)


@pytest.mark.parametrize(("rate_hz", "highest_hz"), [(1000.0, 450.0), (2500.0, 1000.0), (10_000.0, 1000.0)])
def test_the_scored_range(rate_hz: float, highest_hz: float) -> None:
    frequencies = np.arange(0.0, rate_hz / 2, 0.5)
    scored = frequencies[distance.scored_bins(frequencies, rate_hz)]
    assert (scored.min(), scored.max()) == (20.0, highest_hz)
    edges = metrics.band_edges(rate_hz)
    assert edges.shape == (10,)
    assert (edges[0], edges[-1]) == pytest.approx((20.0, highest_hz), rel=1e-12)
    np.testing.assert_allclose(edges[1:] / edges[:-1], (highest_hz / 20) ** (1 / 9), rtol=1e-12)  # equal in log


@pytest.mark.parametrize("rate_hz", [1000.0, 10_000.0])
def test_levels_of_a_sine(rate_hz: float) -> None:
    n = round(2.03 * rate_hz)
    levels = level.frame_levels(3.0 * tone(100.0, n, rate_hz), rate_hz, 1.5)
    assert levels.shape == (50,)  # 40 ms each; 30 ms are left over
    # Four whole periods in each frame: RMS 3/√2 against 1.5.
    np.testing.assert_allclose(levels, 20 * math.log10(3 / math.sqrt(2) / 1.5), atol=1e-9)


def test_levels_have_a_floor_and_follow_a_burst() -> None:
    blocks = np.zeros((2, 400))
    blocks[1, 200:] = 1.0
    levels = level.frame_levels(blocks, RATE_HZ, 1.0)
    np.testing.assert_allclose(levels, [[-30.0] * 10, [-30.0] * 5 + [0.0] * 5], atol=1e-9)  # rounding


def kurtosis(samples: np.ndarray) -> float:
    return metrics.kurtosis(metrics.moments(samples))


def test_kurtosis_of_known_shapes() -> None:
    n = 400_000
    rng = np.random.default_rng(0)
    assert kurtosis(tone(50.0)) == pytest.approx(1.5, abs=1e-9)
    # Standard errors: √(24/n) for a normal; for Laplace, whose eighth moment is 8!, about √(8!/4·/n) = 0.16.
    assert kurtosis(5 + 3 * rng.standard_normal(n)) == pytest.approx(3.0, abs=4 * math.sqrt(24 / n))
    assert kurtosis(rng.laplace(size=n)) == pytest.approx(6.0, abs=0.65)
    assert kurtosis(np.full(9, 2.0)) == 0.0


def test_a_band_that_is_louder_shows_in_its_band_alone() -> None:
    frequencies = np.arange(0.0, 501.0)
    edges = metrics.band_edges(RATE_HZ)
    p = np.ones(frequencies.size)
    q = np.where((frequencies >= edges[4]) & (frequencies < edges[5]), 4.0, 1.0)
    errors = metrics.band_errors(p, q, frequencies, edges)
    expected = [0.0] * 9
    expected[4] = 10 * math.log10(4)
    np.testing.assert_allclose(np.array(errors, dtype=float), expected, atol=1e-9)  # rounding
    silent = metrics.band_errors(p, 0 * p, frequencies, edges)
    np.testing.assert_allclose(np.array(silent, dtype=float), -120.0, atol=1e-9)


def test_a_band_without_a_bin_is_unknown() -> None:
    frequencies = np.arange(0.0, 501.0, 50.0)
    errors = metrics.band_errors(np.ones(11), np.ones(11), frequencies, metrics.band_edges(RATE_HZ))
    assert errors[0] is None  # 20 to 28 Hz
    assert errors[-1] == pytest.approx(0.0)
    highest = np.where(frequencies == 450, 4.0, 0.0)  # the upper edge belongs to the last band
    assert metrics.band_errors(highest, highest, frequencies, metrics.band_edges(RATE_HZ))[-1] == pytest.approx(0.0)


def test_the_modulation_of_a_tone_is_at_its_frequency() -> None:
    times_s = np.arange(8000) / RATE_HZ
    blocks = (tone(200.0, 8000) * (1 + 0.5 * np.sin(2 * np.pi * 10.0 * times_s)))[None]
    spectra = metrics.modulation_spectra(blocks, RATE_HZ)
    assert spectra is not None
    frequencies, density = spectra
    (density,) = density
    assert frequencies[density.argmax()] == pytest.approx(10.0, abs=0.5)  # bins of 1 Hz
    assert (frequencies.min(), frequencies.max()) == (1.0, 50.0)
    # The envelope is 1 + 0.5 sin: its variance is 0.125, all of it in 2 to 50 Hz.
    assert density.sum() * (frequencies[1] - frequencies[0]) == pytest.approx(0.125, rel=0.02)  # ends of the record
    louder = metrics.modulation_spectra(7 * blocks, RATE_HZ)
    assert louder is not None
    np.testing.assert_allclose(louder[1][0], density, atol=1e-12)  # blind to gain


def mean_of(values: np.ndarray) -> Any:
    return lambda index: {"mean": float(values[index].mean())}


def test_the_interval_of_a_mean_is_students() -> None:
    """Oracle: SciPy's t-test."""
    values = np.random.default_rng(0).standard_normal(7)
    expected = ttest_1samp(values, 0.0).confidence_interval(0.95)
    assert with_intervals(mean_of(values), 7)["intervals"]["mean"] == pytest.approx(
        [expected.low, expected.high], rel=1e-12
    )


@pytest.mark.parametrize("n_blocks", [4, 6, 11])
@pytest.mark.parametrize(
    ("draw", "mean", "least"),
    [
        (lambda rng, n: rng.standard_normal(n), 0.0, 0.94),
        # Distances of spectra, mean errors of a block: skewed by a long tail. Sample means of so few cover less whatever is done.
        (lambda rng, n: rng.gamma(4.0, 0.25, n), 1.0, 0.92),
    ],
    ids=["normal", "skewed"],
)
def test_it_covers_the_truth_as_often_as_it_says(draw: Draw, mean: float, least: float, n_blocks: int) -> None:
    rng, n_draws = np.random.default_rng(n_blocks), 4000
    covered = 0
    for _ in range(n_draws):
        low, high = with_intervals(mean_of(draw(rng, n_blocks)), n_blocks)["intervals"]["mean"]
        covered += low <= mean <= high
    assert least <= covered / n_draws <= 0.96  # a share of 4000 is known to 0.0034


def test_few_blocks_and_what_is_no_number_have_no_interval() -> None:
    assert [with_intervals(mean_of(np.ones(n)), n)["intervals"] for n in (1, 2, 3)] == [{}] * 3

    def figures(index: np.ndarray) -> dict[str, Any]:
        return {"unknown": None, "bands": [1.0], "sometimes": 1.0 if 2 in index else None, "constant": 4.0}

    assert with_intervals(figures, 5)["intervals"] == {"constant": [4.0, 4.0]}
