"""How far apart two spectra are: what training chooses by and what the judge scores."""

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array

MIN_SCORED_HZ = 20.0  # below it the high-pass rules
MAX_SCORED_HZ = 1000.0  # above it a hand feels nothing
POWER_FLOOR = 1e-12  # of the recorded power in a bin: a silent synthesis is 120 dB off, not infinitely
_AT_ONCE = 2_000_000  # samples of segments in memory


def welch(blocks: Array, rate_hz: float, n_segment: int) -> tuple[Array, Array]:
    """Frequencies [Hz] and power densities [(m/s²)²/Hz] of half overlapping Hann segments: blocks (…, n) → (k,), (…, k).

    Each segment is taken about its mean.
    """
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(n_segment) / n_segment)
    segments = np.lib.stride_tricks.sliding_window_view(blocks, n_segment, axis=-1)
    segments = segments[..., :: n_segment - n_segment // 2, :]
    n = segments.shape[-2]
    at_once = max(1, _AT_ONCE * n // segments.size)
    power = np.zeros((*blocks.shape[:-1], n_segment // 2 + 1))
    for first in range(0, n, at_once):
        some = segments[..., first : first + at_once, :]
        spectra = np.fft.rfft(window * (some - some.mean(axis=-1, keepdims=True)))
        power += (np.square(spectra.real) + np.square(spectra.imag)).sum(axis=-2)
    power *= 2 / (n * rate_hz * np.square(window).sum())
    power[..., 0] /= 2  # zero and, of an even number, half of the rate have no negative twin
    if n_segment % 2 == 0:
        power[..., -1] /= 2
    return np.asarray(np.fft.rfftfreq(n_segment, 1 / rate_hz), dtype=np.float64), power


def segment_length(block: int) -> int:
    """Welch's segment for a block of so many samples: 256, or a quarter of the block if that is less."""
    return min(256, max(8, block // 4))


def max_scored_hz(rate_hz: float) -> float:
    """Highest frequency at which spectra are scored [Hz]: the lower of 1 kHz and 0.45 of the rate."""
    return min(MAX_SCORED_HZ, 0.45 * rate_hz)


def scored_bins(frequencies: Array, rate_hz: float) -> NDArray[np.bool_]:
    """Mask of the scored bins, from 20 Hz on."""
    return (frequencies >= MIN_SCORED_HZ) & (frequencies <= max_scored_hz(rate_hz))


def highest_with_power(frequencies: Array, density: Array, rate_hz: float) -> float:
    """Frequency [Hz] below which 99.9 % of the power lies: densities (k,); never lower than what is scored."""
    power = np.cumsum(density)
    reached = float(frequencies[np.searchsorted(power, 0.999 * power[-1])])
    return min(max(reached, max_scored_hz(rate_hz)), rate_hz / 2)


def log_spectral_distance(recorded: Array, synthesized: Array) -> Array:
    """RMS over bins of 10·log₁₀(P/Q) [dB], sees gain: densities (…, k) of scored bins → (…,)."""
    floor = POWER_FLOOR * recorded.max(axis=-1, keepdims=True)
    ratio = 10 * np.log10(np.maximum(recorded, floor) / np.maximum(synthesized, floor))
    return np.sqrt(np.square(ratio).mean(axis=-1))


def earth_mover_octaves(frequencies: Array, recorded: Array, synthesized: Array) -> Array:
    """Distance over which power has to move along log frequency to make one spectrum the other [octave], blind to gain.

    Frequencies [Hz], shape (k,), and densities (…, k) of scored bins → (…,); 0 where one is silent.
    A just noticeable difference is about 0.25 to 0.3 octave (Israr & Tan, 2006).
    """
    totals = recorded.sum(axis=-1), synthesized.sum(axis=-1)
    shares = [
        np.cumsum(density, axis=-1) / np.maximum(total, np.finfo(float).tiny)[..., None]
        for density, total in zip((recorded, synthesized), totals, strict=True)
    ]
    distance = (np.abs(shares[0] - shares[1])[..., :-1] * np.diff(np.log2(frequencies))).sum(axis=-1)
    return np.asarray(np.where((totals[0] > 0) & (totals[1] > 0), distance, 0.0))


def area_under_curve(first: Array, second: Array) -> float:
    """Share of pairs in which the score of the second is the larger, ties by half: shapes (n,) and (k,)."""
    order = np.sort(first)
    below, up_to = (np.searchsorted(order, second, side) for side in ("left", "right"))
    return float((below + up_to).mean() / (2 * len(first)))
