from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import signal
from scipy.signal import butter, sosfilt

from foten.dsp import distance
from foten.dsp.dft321 import dft321
from foten.dsp.distance import earth_mover_octaves, welch
from foten.dsp.level import N_BANDS, band_energies, envelope_edges
from foten.dsp.perception import (
    JND_CORRECT,
    LEVEL_JND_DB,
    THRESHOLD_M_S2,
    band_thresholds,
    carried,
    in_words,
    internal_noise_db,
    sensitivity,
    smallest_rate,
)
from foten.dsp.spectrum import dft_matrices, last_sample_row, position_encoding
from foten.evaluate.metrics import band_correlations

SIZES = [2, 3, 4, 5, 10, 15, 20, 25, 30]


@pytest.mark.parametrize(("n", "n_segment"), [(1000, 256), (1000, 255), (64, 64), (300, 17)])
@pytest.mark.parametrize("at_once", [1, 5000, 10**9])
def test_a_power_density_is_scipys(n: int, n_segment: int, at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: scipy.signal.welch, however many segments are in memory."""
    monkeypatch.setattr(distance, "_AT_ONCE", at_once)
    x = 3 + np.random.default_rng(n).standard_normal((2, 5, n))
    for ours, expected in zip(welch(x, 500.0, n_segment), signal.welch(x, 500.0, nperseg=n_segment), strict=True):
        np.testing.assert_allclose(ours, expected, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("m", SIZES)
def test_the_matrices_are_the_transform(m: int) -> None:
    """Oracle: numpy.fft.fft."""
    a = np.random.default_rng(m).standard_normal((7, m))
    real, imaginary = dft_matrices(m)
    np.testing.assert_allclose(a @ real + 1j * (a @ imaginary), np.fft.fft(a), atol=1e-12)  # m roundings


@pytest.mark.parametrize("m", SIZES)
def test_what_is_zero_is_exactly_zero(m: int) -> None:
    real, imaginary = dft_matrices(m)
    for matrix in (real, imaginary):
        assert not np.any((matrix != 0) & (np.abs(matrix) < 0.05))  # sin(2π/120) is the least that can be
    assert not imaginary[:, 0].any()
    if m % 2 == 0:
        assert not imaginary[:, m // 2].any()


@pytest.mark.parametrize("m", SIZES)
def test_the_last_row_is_the_inverse_transforms_last_sample(m: int) -> None:
    """Oracle: numpy.fft.ifft of M̂·e^{iφ̂} (Eq. 8, 9)."""
    rng = np.random.default_rng(m)
    magnitude, phase = rng.standard_normal((2, 9, m))  # encoded ones are any real number
    expected = np.fft.ifft(magnitude * np.exp(1j * phase)).real[:, -1]
    cosine, sine = last_sample_row(m)
    found = (magnitude * (cosine * np.cos(phase) + sine * np.sin(phase))).sum(axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-14)  # m roundings over m


@pytest.mark.parametrize(("m", "d_model"), [(20, 32), (5, 8), (4, 5)])
def test_positions_are_eq_2(m: int, d_model: int) -> None:
    """Oracle: Eq. 2, term by term; an odd width ends with a sine."""
    waves = (math.sin, math.cos)
    expected = [[waves[i % 2](pos * 10000 ** (-(i - i % 2) / d_model)) for i in range(d_model)] for pos in range(m)]
    np.testing.assert_allclose(position_encoding(m, d_model), expected, atol=1e-13)  # rounding of the angle


@pytest.mark.parametrize("m", [5, 8, 9, 20])
def test_half_of_the_bins_is_the_hermitian_inverse(m: int) -> None:
    rng = np.random.default_rng(m)
    magnitude, phase = rng.standard_normal((2, m // 2 + 1))
    cosine, sine = last_sample_row(m, half=True)
    found = (magnitude * (cosine * np.cos(phase) + sine * np.sin(phase))).sum()
    # NumPy's irfft ignores the imaginary part of the bins that are real, as taking the real part does.
    assert found == pytest.approx(np.fft.irfft(magnitude * np.exp(1j * phase), n=m)[-1], abs=1e-12)


HERTZ = np.arange(1.0, 5000.0)


def lines(*at: float) -> tuple[np.ndarray, np.ndarray]:
    density = np.zeros_like(HERTZ)
    for hertz in at:
        density[int(hertz) - 1] = 1.0
    return HERTZ, density


def test_acceleration_counts_evenly_up_to_250_hertz_and_less_above() -> None:
    np.testing.assert_array_equal(sensitivity(np.array([20.0, 40.0, 100.0, 250.0])), 1.0)
    # An octave above the best frequency 24 dB less; outside of touch nothing.
    assert sensitivity(np.array([500.0]))[0] == pytest.approx(2.0**-8)
    np.testing.assert_array_equal(sensitivity(np.array([0.0, 19.0, 1001.0])), 0.0)


@pytest.mark.parametrize("n", [1, 3, 8])
def test_whoever_weighs_noisy_bands_best_notices_a_step_in_one_of_them_and_in_all_alike(n: int) -> None:
    """Oracle: the likelihood ratio of two Gaussians of the noise's covariance, by its inverse."""
    sd = internal_noise_db(n)
    precision = np.linalg.inv(sd**2 * (np.eye(n) + 1.0))
    for step in (LEVEL_JND_DB * np.eye(n)[0], np.full(n, LEVEL_JND_DB)):
        d_prime = math.sqrt(step @ precision @ step)
        right = 0.5 * (1 + math.erf(d_prime / 2))  # Φ(d'/√2), of two intervals
        assert right == pytest.approx(JND_CORRECT, abs=1e-12)


def test_thresholds_of_bands_are_those_of_acceleration_where_skin_is_most_sensitive() -> None:
    thresholds = band_thresholds(envelope_edges(1000.0))
    np.testing.assert_allclose(thresholds[:6], THRESHOLD_M_S2**2)
    assert thresholds[7] == pytest.approx(THRESHOLD_M_S2**2 * (305 * 450 / 250**2) ** 4, rel=0.01)  # 24 dB per octave


def test_a_rate_carries_what_lies_below_nearly_half_of_it() -> None:
    shares = carried({"x": lines(200.0), "y": lines(200.0, 240.0), "z": lines(600.0)}, 10_000.0)
    assert shares == pytest.approx({1000.0: 1.0, 2500.0: 1.0, 10_000.0: 1.0}, abs=1e-3)
    shares = carried({"x": lines(600.0, 700.0)}, 5000.0)
    assert shares == pytest.approx({1000.0: 0.0, 2500.0: 1.0, 5000.0: 1.0}, abs=1e-12)
    assert smallest_rate(shares) == 2500.0
    assert in_words(shares) == "1 kHz carries 0 %, 2.5 kHz 100 %, 5 kHz 100 %"


def test_without_perceived_power_there_are_no_shares() -> None:
    assert carried({"x": lines(3000.0)}, 10_000.0) == {}
    assert carried({}, 10_000.0) == {}


RATE_HZ = 1000.0


@pytest.mark.parametrize("rate_hz", [1000.0, 2500.0, 10_000.0])
@pytest.mark.parametrize("band", range(N_BANDS))
def test_a_tone_is_in_its_band_with_its_power(rate_hz: float, band: int) -> None:
    """A Butterworth band-pass has unit gain at the geometric mean of its edges, but for the bilinear warping."""
    edges = envelope_edges(rate_hz)
    hz = np.sqrt(edges[band] * edges[band + 1])
    t = np.arange(round(2 * rate_hz)) / rate_hz
    energies = band_energies(3.0 * np.sin(2 * np.pi * hz * t), rate_hz)
    assert energies.shape == (N_BANDS, 250)
    settled = energies[:, 60:].mean(axis=1)
    assert settled.argmax() == band
    assert settled[band] == pytest.approx(4.5, rel=0.06)  # warping near 450 Hz at 1 kHz moves the centre by a tenth
    # Twelve dB an octave on each side: bands two further on, of 0.56 octave each, are 15 dB down.
    assert all(settled[k] < 0.1 * settled[band] for k in range(N_BANDS) if abs(k - band) > 2)


def test_bands_end_below_half_of_a_low_rate() -> None:
    assert envelope_edges(500.0)[-1] == pytest.approx(225.0)
    assert envelope_edges(10_000.0)[-1] == pytest.approx(450.0)


def test_each_signal_is_by_itself_and_a_rest_of_samples_is_left_out() -> None:
    both = np.random.default_rng(0).standard_normal((2, 3, 1005))
    energies = band_energies(both, RATE_HZ)
    assert energies.shape == (2, 3, N_BANDS, 125)
    np.testing.assert_array_equal(energies[1, 2], band_energies(both[1, 2], RATE_HZ))


def test_power_moved_by_an_octave_is_an_octave() -> None:
    hz = np.arange(10.0, 1000.0, 2.0)
    low, high = (np.where(hz == at, 5.0, 0.0) for at in (100.0, 200.0))
    assert earth_mover_octaves(hz, low, high) == pytest.approx(1.0, abs=1e-9)
    assert earth_mover_octaves(hz, low, 7.0 * low) == pytest.approx(0.0, abs=1e-9)  # blind to gain
    assert earth_mover_octaves(hz, low, (low + high) / 2) == pytest.approx(0.5, abs=1e-9)
    assert earth_mover_octaves(hz, low, 0 * low) == earth_mover_octaves(hz, 0 * low, low) == 0.0
    assert earth_mover_octaves(hz, np.stack([low, high]), high).tolist() == pytest.approx([1.0, 0.0], abs=1e-9)


def test_impacts_raise_all_bands_at_once_and_a_hiss_each_by_itself() -> None:
    rng = np.random.default_rng(1)
    hiss = rng.standard_normal((4, 4000))
    impacts = np.where(rng.random((4, 4000)) < 0.005, 14.0, 0.0) * rng.standard_normal((4, 4000))
    apart, in_step = (band_correlations(band_energies(one, RATE_HZ)) for one in (hiss, impacts))
    assert apart.shape == (N_BANDS * (N_BANDS - 1) // 2,)
    # Neighbours overlap, so that even those of a hiss correlate somewhat; all 28 pairs of impacts do.
    assert np.median(apart) < 0.15
    assert in_step.min() > 0.3


def test_correlations_are_numpys() -> None:
    """Oracle: numpy.corrcoef of all frames of all blocks."""
    energies = np.random.default_rng(2).gamma(2.0, size=(3, N_BANDS, 50))
    expected = np.corrcoef(np.concatenate(list(energies), axis=1) ** 0.15)[np.triu_indices(N_BANDS, 1)]
    np.testing.assert_allclose(band_correlations(energies), expected, atol=1e-12)  # rounding
    assert band_correlations(np.ones((2, N_BANDS, 5))).tolist() == [0.0] * 28


def test_slow_modulation_is_seen_and_a_filter_is_causal() -> None:
    carrier = sosfilt(butter(2, [80, 120], "bandpass", fs=RATE_HZ, output="sos"), np.eye(1, 2000, 1000)[0])
    energies = band_energies(carrier, RATE_HZ)
    assert energies[:, :125].sum() == 0.0
    assert energies[:, 125:130].sum() > 0.0


def dft321_by_definition(axes: np.ndarray) -> np.ndarray:
    """DFT321 by its definition: sums over n and k, no fast transform."""
    n = axes.shape[1]
    turn = np.exp(-2j * np.pi * np.outer(np.arange(n), np.arange(n)) / n)
    spectra = [turn @ axis for axis in axes]
    magnitude = np.sqrt(sum(np.abs(spectrum) ** 2 for spectrum in spectra))
    phase = np.angle(sum(spectra))
    return np.real(turn.conj() @ (magnitude * np.exp(1j * phase))) / n


@pytest.mark.parametrize("n", [64, 63])
@pytest.mark.parametrize("n_axes", [2, 3])
def test_dft321_is_the_direct_sum(n: int, n_axes: int) -> None:
    """Oracle: the O(n²) definition."""
    axes = np.random.default_rng(n).standard_normal((n_axes, n))
    np.testing.assert_allclose(dft321(axes), dft321_by_definition(axes), atol=1e-11)  # 64² roundings of order one


@pytest.mark.parametrize("n", [2000, 1999, 5, 2, 1])
def test_dft321_keeps_the_energy_of_all_axes(n: int) -> None:
    axes = np.random.default_rng(n).standard_normal((3, n))
    assert np.square(dft321(axes)).sum() == pytest.approx(np.square(axes).sum(), rel=1e-12)  # Parseval; rounding


@pytest.mark.parametrize(("n", "window"), [(2000, 64), (1999, 63), (5, 64), (64, 2)])
def test_windows_give_one_axis_back(n: int, window: int) -> None:
    axis = np.random.default_rng(n).standard_normal(n)
    np.testing.assert_allclose(dft321(np.stack([axis, 0 * axis, 0 * axis]), window), axis, atol=1e-12)  # rounding


def test_short_windows_keep_energy_where_it_was() -> None:
    """A quiet second beside a loud one, whose energy one transform of both spreads over it."""
    axes = np.random.default_rng(1).standard_normal((3, 2000)) * np.repeat([0.1, 1.0], 1000)
    truth = np.square(axes).sum(axis=0)[100:900].mean()
    of_windows, of_whole = (np.square(dft321(axes, window))[100:900].mean() / truth for window in (64, None))
    assert 10 * np.log10(of_windows) == pytest.approx(-0.3, abs=0.1)  # where windows disagree in phase they cancel
    assert 10 * np.log10(of_whole) > 6.0


def test_axes_that_cancel_do_not_vanish() -> None:
    axis = np.random.default_rng(0).standard_normal(200)
    found = dft321(np.stack([axis, -axis, np.zeros(200)]))
    assert np.square(found).sum() == pytest.approx(2 * np.square(axis).sum(), rel=1e-12)
    # The phase is one axis's own: the signal itself, not rounding noise.
    assert np.abs(np.corrcoef(found, axis)[0, 1]) == pytest.approx(1.0, abs=1e-9)


def test_blocks_of_axes_are_taken_one_by_one() -> None:
    blocks = np.random.default_rng(0).standard_normal((4, 3, 100))
    at_once = dft321(blocks)
    for block, found in zip(blocks, at_once, strict=True):
        np.testing.assert_array_equal(dft321(block), found)
