"""Band energies: tones are in their band with their power; figures that are made of them."""

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfilt

from foten.dsp.bands import N_BANDS, band_energies, envelope_edges
from foten.dsp.distance import earth_mover_octaves
from foten.evaluate.metrics import band_correlations

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
    assert earth_mover_octaves(hz, low, np.zeros_like(low)) == 0.0
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
    assert np.isfinite(lfilter([1.0], [1.0, -0.9], energies, axis=1)).all()
