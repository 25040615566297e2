"""Checks of the vibration's spectrum: whiteness, exactly repeated patterns, narrow lines."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from foten.recording.inspection.hand import HAND_HZ
from foten.recording.inspection.values import NOTE, PROBLEM, Finding
from foten.recording.recording import Channel

Array = NDArray[np.float64]


def density(channel: Channel) -> tuple[Array, Array]:
    """Return frequencies [Hz] without 0 and the power spectral density there, shape (k,) each; bins of about 4 Hz."""
    from scipy.signal import welch

    wanted = 2 ** round(np.log2(channel.rate_hz / 4))
    n = int(max(16, min(wanted, channel.samples.size // 4)))
    frequency, power = welch(channel.samples, channel.rate_hz, nperseg=n, detrend="constant")
    return frequency[1:], power[1:]


def check_whiteness(name: str, channel: Channel) -> Iterable[Finding]:
    """Yield findings on a vibration without autocorrelation, or with a pattern that repeats exactly."""
    x = channel.samples[:200_000]
    x = x - x.mean()
    power = float(np.mean(x**2))
    if x.size < 1000 or power == 0:
        return
    explained = {}
    for period in range(2, min(250, x.size // 40)):
        # Noise alone explains 1/n of the power in each of its period−1 free means; what exceeds that is the pattern.
        pattern = _pattern(x, period)
        explained[period] = float(np.mean(pattern**2)) / power - 1 / (x.size // period)
    largest = max(explained.values())
    patterned = largest > 0.05
    without = x
    if patterned:
        period = next(p for p, part in explained.items() if part >= 0.9 * largest)
        n = x.size // period
        without = x[: n * period] - np.tile(_pattern(x, period), n)
    mean_square = np.mean(without**2)
    lagged = [float(np.mean(without[:-k] * without[k:]) / mean_square) for k in range(1, 6)]
    largest_lag = max(lagged, key=abs)
    white = abs(largest_lag) < 0.12
    if patterned:
        hz = channel.rate_hz / period
        mains = not white and min(abs(hz / m - round(hz / m)) for m in (50, 60)) < 1e-6
        text = (
            f"{name}: one pattern repeats exactly every {period} samples ({hz:.4g} Hz) throughout and holds "
            f"{largest:.0%} of the power: {'mains hum?' if mains else 'a processed or generated signal?'}"
        )
        yield Finding(PROBLEM if white else NOTE, "pattern", name, text)
    if white:
        text = (
            f"{name} has next to no autocorrelation (at lags 1 to 5 at most {abs(largest_lag):.2f}"
            f"{', the pattern aside' if patterned else ''}): was it shuffled, or generated, or is it noise alone?"
        )
        yield Finding(PROBLEM, "white", name, text)


def _pattern(x: Array, period: int) -> Array:
    """Return the mean of all whole periods of a signal, shape (period,)."""
    n = x.size // period
    return np.asarray(x[: n * period].reshape(n, period).mean(axis=0))


def check_lines(name: str, frequency: Array, power: Array) -> Iterable[Finding]:
    """Yield a note on narrow lines, of an instrument or mains: 15 dB above the median of the bins around."""
    from scipy.ndimage import median_filter

    if power.size < 64:
        return
    ratio = power / np.maximum(median_filter(power, 31, mode="nearest"), 1e-30)
    peaks = np.flatnonzero((ratio[1:-1] > 30) & (ratio[1:-1] >= ratio[:-2]) & (ratio[1:-1] > ratio[2:])) + 1
    peaks = peaks[frequency[peaks] > HAND_HZ]
    if peaks.size:
        strongest = np.sort(peaks[np.argsort(ratio[peaks])[::-1][:6]])
        text = (
            f"{name}: narrow lines at {', '.join(f'{frequency[i]:.4g}' for i in strongest)} Hz"
            f"{' and elsewhere' if peaks.size > strongest.size else ''}, up to "
            f"{10 * np.log10(ratio[peaks].max()):.0f} dB above their surroundings: instruments or mains?"
        )
        yield Finding(NOTE, "lines", name, text)
