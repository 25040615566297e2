"""How much of the perceived power a rate keeps."""

import numpy as np
import pytest

from foten.dsp.perception import carried, in_words, sensitivity, smallest_rate

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
