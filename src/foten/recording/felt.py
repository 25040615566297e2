"""What a rate carries of a vibration, as a hand feels it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LOWEST_HZ, HIGHEST_HZ = 20.0, 1000.0  # where texture begins, and where touch ends
MOST_SENSITIVE_HZ = 250.0
USABLE_BAND = 0.45  # of a rate
RATES_HZ = (1000.0, 2500.0, 10_000.0)
ENOUGH = 0.95


def sensitivity(hertz: Array) -> Array:
    """Return how much acceleration power counts at each frequency: the inverse square of the threshold, 1 up to 250 Hz.

    The threshold of displacement falls by 12 dB an octave from 40 Hz to its lowest near 250 Hz, so that acceleration counts
    evenly there; above it rises, how steeply is taken to be as below: 24 dB an octave of acceleration. Below 40 Hz it is flat
    and acceleration would count for more, but much of what lies there is the hand's own, and it counts for 1.

    Source: Verrillo, J. Acoust. Soc. Am. 35 (1963), for large contactors; the rise above 250 Hz is our reading of a U.
    """
    steep = np.minimum(MOST_SENSITIVE_HZ / np.maximum(hertz, 1e-9), 1.0) ** 8
    return np.where((hertz >= LOWEST_HZ) & (hertz <= HIGHEST_HZ), steep, 0.0)


def carried(densities: Mapping[str, tuple[Array, Array]], rate_hz: float) -> dict[float, float]:
    """Return the share of what a hand feels that each rate [Hz] carries: those of `RATES_HZ` up to the recording's, and it.

    Args:
        densities: frequency [Hz] and power density of each axis of the acceleration.
        rate_hz: that the acceleration was captured at.

    Returns:
        Shares from 0 to 1, of what the recording itself carries; empty where it holds nothing that is felt.
    """
    felt = [(hertz, density * sensitivity(hertz)) for hertz, density in densities.values()]
    total = sum(float(np.trapezoid(power, hertz)) for hertz, power in felt)
    if not total > 0:
        return {}
    rates = sorted({*(rate for rate in RATES_HZ if rate <= rate_hz), rate_hz})
    return {
        rate: sum(
            float(np.trapezoid(np.where(hertz <= USABLE_BAND * rate, power, 0.0), hertz))
            for hertz, power in felt
        )
        / total
        for rate in rates
    }


def smallest_rate(shares: Mapping[float, float]) -> float:
    """Return the lowest rate that carries 95 % of what the highest carries [Hz]."""
    most = max(shares.values())
    return min(rate for rate, share in shares.items() if share >= ENOUGH * most)


def in_words(shares: Mapping[float, float]) -> str:
    """Return the shares as a clause: "1 kHz carries 81 %, 2.5 kHz 99 %"."""
    first, *rest = (f"{rate / 1000:g} kHz {{}}{100 * share:.3g} %" for rate, share in shares.items())
    return ", ".join([first.format("carries "), *(text.format("") for text in rest)])
