import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from foten.dsp.filters import Biquads, Sections, butterworth, delay_s, filter_recorded

RATE_HZ = 1000.0
DESIGNS = [
    (kind, cutoff_hz, rate_hz, order)
    for kind in ("lowpass", "highpass")
    for cutoff_hz, rate_hz in ((20.0, 1000.0), (20.0, 10_000.0), (300.0, 1000.0))
    for order in (2, 4, 6)
]


def sos(sections: Sections) -> np.ndarray:
    return np.array([[b0, b1, b2, 1.0, a1, a2] for b0, b1, b2, a1, a2 in sections])


def tone(hz: float, n: int = 4000) -> np.ndarray:
    return np.sin(2 * np.pi * hz * np.arange(n) / RATE_HZ)


@pytest.mark.parametrize(("kind", "cutoff_hz", "rate_hz", "order"), DESIGNS)
def test_the_response_is_that_of_scipys_butterworth(kind: str, cutoff_hz: float, rate_hz: float, order: int) -> None:
    """Oracle: scipy.signal.butter."""
    frequencies = np.geomspace(1.0, 0.49 * rate_hz, 200)
    _, streamed = signal.sosfreqz(sos(butterworth(kind, cutoff_hz, rate_hz, order)), frequencies, fs=rate_hz)
    reference = signal.butter(order, cutoff_hz, kind, fs=rate_hz, output="sos")
    _, expected = signal.sosfreqz(reference, frequencies, fs=rate_hz)
    # Order 6 at 20 Hz of 10 kHz: poles 0.01 from z = 1 amplify rounding by 1e4.
    np.testing.assert_allclose(streamed, expected, atol=1e-9)


@pytest.mark.parametrize("zero_phase", [False, True])
def test_a_tone_above_a_low_pass_vanishes_and_one_below_survives(zero_phase: bool) -> None:
    lowpass = butterworth("lowpass", 20.0, RATE_HZ)
    highpass = butterworth("highpass", 20.0, RATE_HZ)

    def amplitude(sections: Sections, hz: float) -> float:
        settled = filter_recorded(sections, tone(hz), zero_phase=zero_phase)[1000:-1000]
        return float(np.sqrt(2 * np.square(settled).mean()))

    assert amplitude(lowpass, 300.0) < (20 / 300) ** 2  # 12 dB an octave; the bilinear transform falls faster
    assert amplitude(lowpass, 2.0) == pytest.approx(1.0, abs=1e-3)  # 1 / √(1 + (2/20)⁴) = 0.99995
    assert amplitude(highpass, 2.0) < 1.05 * (2 / 20) ** 2
    assert amplitude(highpass, 200.0) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("zero_phase", [False, True])
def test_a_constant_passes_a_low_pass_and_not_a_high_pass(zero_phase: bool) -> None:
    gravity = np.full(500, 9.81)
    # Settled on the first sample: no transient at all, only rounding.
    passed = filter_recorded(butterworth("lowpass", 20.0, RATE_HZ, 4), gravity, zero_phase=zero_phase)
    stopped = filter_recorded(butterworth("highpass", 20.0, RATE_HZ, 4), gravity, zero_phase=zero_phase)
    np.testing.assert_allclose(passed, 9.81, atol=1e-9)
    np.testing.assert_allclose(stopped, 0.0, atol=1e-9)


@pytest.mark.parametrize("order", [2, 4])
def test_a_ramp_comes_out_late_by_the_delay(order: int) -> None:
    lowpass = butterworth("lowpass", 20.0, RATE_HZ, order)
    ramp = 0.3 * np.arange(4000.0)
    late = filter_recorded(lowpass, ramp)[-1]
    # A ramp is answered by itself, late by the group delay at 0 Hz exactly, once the poles have died out.
    assert (ramp[-1] - late) / 0.3 / RATE_HZ == pytest.approx(delay_s(lowpass, RATE_HZ), abs=1e-9)


def test_zero_phase_has_no_delay() -> None:
    lowpass = butterworth("lowpass", 20.0, RATE_HZ)
    n = np.arange(2000)
    bump = np.exp(-0.5 * ((n - 1000) / 40.0) ** 2)
    out = filter_recorded(lowpass, bump, zero_phase=True)
    np.testing.assert_allclose(out[1:], out[:0:-1], atol=1e-9)  # symmetric about 1000, as the input


@given(cuts=st.lists(st.integers(0, 300), max_size=6), order=st.sampled_from([2, 4]), seed=st.integers(0, 99))
@settings(max_examples=20, deadline=None)
def test_any_block_sizes_give_what_one_call_gives(cuts: list[int], order: int, seed: int) -> None:
    samples = np.random.default_rng(seed).standard_normal(300)
    at_once = Biquads(butterworth("highpass", 20.0, RATE_HZ, order)).process(samples)
    pieces = Biquads(butterworth("highpass", 20.0, RATE_HZ, order))
    out = np.concatenate([pieces.process(piece) for piece in np.split(samples, sorted(cuts))])
    np.testing.assert_array_equal(out, at_once)


@pytest.mark.parametrize(("kind", "cutoff_hz", "rate_hz", "order"), DESIGNS)
def test_streaming_is_the_offline_filter(kind: str, cutoff_hz: float, rate_hz: float, order: int) -> None:
    """Oracle: scipy.signal.sosfilt, settled on the first sample."""
    samples = 3.0 + np.random.default_rng(0).standard_normal(500)
    sections = butterworth(kind, cutoff_hz, rate_hz, order)
    streaming = Biquads(sections)
    streaming.reset(samples[0])
    # Both sum the same products; what differs is rounding of the start, amplified as above.
    np.testing.assert_allclose(streaming.process(samples), filter_recorded(sections, samples), atol=1e-9)


@pytest.mark.parametrize(
    ("cutoff_hz", "order"), [(0.0, 2), (500.0, 2), (float("nan"), 2), (20.0, 0), (20.0, 3), (20.0, -2)]
)
def test_what_is_no_filter_is_refused(cutoff_hz: float, order: int) -> None:
    with pytest.raises(ValueError, match=r"half the rate, 500 Hz|expected 2, 4, 6"):
        butterworth("lowpass", cutoff_hz, RATE_HZ, order)
