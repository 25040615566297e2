from fractions import Fraction

import numpy as np
import pytest

from foten.dsp.resample import decimate, interpolate, rate_ratio

RATES = [(10_000.0, 1000.0), (10_000.0, 2500.0), (2500.0, 1000.0), (44_100.0, 1000.0)]
STOPPED = 1e-4  # 80 dB, the design of the low-pass


def tone(hz: float, rate_hz: float, seconds: float = 1.0) -> np.ndarray:
    return np.sin(2 * np.pi * hz * np.arange(round(seconds * rate_hz)) / rate_hz + 0.4)


@pytest.mark.parametrize(("source_hz", "target_hz"), RATES)
@pytest.mark.parametrize("share", [0.02, 0.2, 0.44])
def test_a_tone_below_the_cutoff_survives_without_delay(source_hz: float, target_hz: float, share: float) -> None:
    hz = share * target_hz
    found = decimate(tone(hz, source_hz), source_hz, target_hz)
    inner = slice(60, -60)  # half the kernel: a transition of 0.1 needs about 5/0.1 samples in all
    # 3: the ripple of the passband and the images each reach the design's 80 dB.
    np.testing.assert_allclose(found[inner], tone(hz, target_hz)[inner], atol=3 * STOPPED)


@pytest.mark.parametrize(("source_hz", "target_hz"), RATES)
@pytest.mark.parametrize("share", [0.56, 0.8, 1.03, 1.2])
def test_a_tone_above_the_cutoff_vanishes(source_hz: float, target_hz: float, share: float) -> None:
    found = decimate(tone(share * target_hz, source_hz), source_hz, target_hz)
    assert np.abs(found[60:-60]).max() < 1.5 * STOPPED


@pytest.mark.parametrize(("source_hz", "target_hz"), RATES)
def test_a_constant_stays_constant_up_to_both_ends(source_hz: float, target_hz: float) -> None:
    n = round(0.7 * source_hz)
    found = decimate(np.full(n, 9.81), source_hz, target_hz)
    assert found.size == -(-n * Fraction(target_hz / source_hz).limit_denominator(1000) // 1)
    # One kernel: rounding. Several take turns, and their sums differ by no more than the design's 80 dB.
    several = rate_ratio(target_hz, source_hz).numerator > 1
    np.testing.assert_allclose(found, 9.81, rtol=STOPPED if several else 1e-12)


def test_the_same_rate_is_a_copy() -> None:
    samples = np.arange(5.0)
    found = decimate(samples, 1000.0, 1000.0)
    np.testing.assert_array_equal(found, samples)
    assert not np.shares_memory(found, samples)


def test_nothing_is_upsampled() -> None:
    with pytest.raises(ValueError, match="never upsampled"):
        decimate(np.zeros(10), 1000.0, 2500.0)


def test_an_odd_ratio_is_refused() -> None:
    with pytest.raises(ValueError, match="not a ratio of small integers"):
        decimate(np.zeros(10), 10_000.0, 1000.0 * np.sqrt(2))
    assert rate_ratio(1000.0, 44_100.0) == Fraction(10, 441)
    assert rate_ratio(2500.0, 10_000.0) == Fraction(1, 4)


@pytest.mark.parametrize("factor", [Fraction(2), Fraction(48), Fraction(441, 10), Fraction(24, 5)])
@pytest.mark.parametrize("hz", [20.0, 150.0, 400.0])
def test_interpolation_draws_the_sine_between_the_samples(factor: Fraction, hz: float) -> None:
    """Oracle: the sine itself at the new times."""
    found = interpolate(tone(hz, 1000.0, 0.3), factor)
    times_s = np.arange(found.size) / (1000.0 * float(factor))
    expected = np.sin(2 * np.pi * hz * times_s + 0.4)
    inner = (times_s > 0.03) & (times_s < 0.27)
    # A Kaiser window with β = 9 stops 90 dB; its transition of ±0.06 of the rate ends at 440 Hz.
    np.testing.assert_allclose(found[inner], expected[inner], atol=1e-4)


@pytest.mark.parametrize("factor", [Fraction(1), Fraction(3), Fraction(441, 10)])
def test_interpolation_keeps_a_constant(factor: Fraction) -> None:
    found = interpolate(np.full(100, 2.5), factor)
    assert found.size == -(-100 * factor.numerator // factor.denominator)
    # The record begins and ends in silence, 24 samples of which reach in.
    inner = found[int(25 * factor) : -int(25 * factor)]
    np.testing.assert_allclose(inner, 2.5, rtol=1e-13)  # kernels of sum 1: rounding


def test_long_signals_are_cut_without_a_seam() -> None:
    """The output is gathered in pieces of 65536."""
    samples = np.random.default_rng(0).standard_normal(1500)
    at_once = interpolate(samples, Fraction(48))
    assert at_once.size > 65536
    late = interpolate(samples[1300:], Fraction(48))
    near = slice(25 * 48, 100 * 48)  # away from the beginning of the shorter one; holds 65536 − 1300·48 = 3136
    np.testing.assert_allclose(at_once[1300 * 48 :][near], late[near], atol=1e-13)  # rounding
