"""Figures of merit on arrays, and their intervals. Each docstring says whether it depends on gain, phase or the spectrum."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.distance import HIGHEST_HZ, LOWEST_HZ, POWER_FLOOR

N_BANDS = 9
N_RESAMPLES = 400  # of a bootstrap


def goodness_of_fit(recorded: Array, synthesized: Array) -> Array:
    """Return the cosine similarity of DFT amplitude spectra (GFC).

    Blind to gain and phase: report it beside an absolute error. On raw bins two independent realisations of one noise
    reach π/4, not 1.

    Accelerations [m/s²], shapes (…, n), give scores in [0, 1], shape (…): 1 when the spectra are proportional, 0 when one is all
    zero.

    Source: Eq. 13.
    """
    return cosine(np.abs(np.fft.rfft(recorded)), np.abs(np.fft.rfft(synthesized)))


def cosine(a: Array, b: Array) -> Array:
    """Return the cosine similarity of amplitudes (…, k) → (…), 0 where one is all zero."""
    norm = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    return np.asarray((a * b).sum(axis=-1) / np.maximum(norm, np.finfo(np.float64).tiny))


def level_slopes(levels: Array, speed: Array, force: Array) -> tuple[float, float] | None:
    """Return how the level grows with speed and with force [dB per decade], by least squares over frames, any equal shape.

    None where speed or force spans less than a factor of 1.2 (10th to 90th percentile), over which a slope is noise.
    """
    moving = (speed > 1.0) & (force > 0.01)
    logs = np.log10(speed[moving]), np.log10(force[moving])
    if moving.sum() < 20 or any(np.subtract(*np.percentile(log, [90, 10])) < math.log10(1.2) for log in logs):
        return None
    design = np.stack([np.ones(moving.sum()), *logs], axis=1)
    coefficients = np.linalg.lstsq(design, levels[moving], rcond=None)[0]
    return float(coefficients[1]), float(coefficients[2])


def kurtosis(samples: Array) -> float:
    """Return Pearson's kurtosis over all samples: 3 for a Gaussian, more for a spiky vibration; 0 for silence."""
    squares = np.square(samples - samples.mean())
    variance = float(squares.mean())
    return float(np.square(squares).mean()) / variance**2 if variance > 0 else 0.0


def band_edges(rate_hz: float) -> Array:
    """Return the edges of nine bands, equal in log frequency, over the scored range [Hz], shape (10,)."""
    return np.geomspace(LOWEST_HZ, min(HIGHEST_HZ, 0.45 * rate_hz), N_BANDS + 1)


def band_errors(recorded: Array, synthesized: Array, frequencies: Array, rate_hz: float) -> list[float | None]:
    """Return the error of each band's energy [dB], from pooled densities (k,); None where a band holds no bin."""
    edges = band_edges(rate_hz)
    starts = np.searchsorted(frequencies, edges)
    starts[-1] = np.searchsorted(frequencies, edges[-1], side="right")  # the last band includes both edges
    errors: list[float | None] = []
    for first, stop in pairwise(starts):
        p, q = float(recorded[first:stop].sum()), float(synthesized[first:stop].sum())
        errors.append(10 * math.log10(max(q, POWER_FLOOR * p) / p) if p > 0 else None)
    return errors


def modulation_spectra(blocks: Array, rate_hz: float) -> tuple[Array, Array] | None:
    """Return frequencies [Hz], 2 to 50, and the power spectrum of each block's envelope: blocks (…, n) → (k,), (…, k).

    The envelope is the magnitude of the analytic signal, divided by its mean in each block. None for blocks under 1 s.
    """
    if blocks.shape[-1] < rate_hz:
        return None
    from scipy import signal

    envelope = np.abs(signal.hilbert(blocks, axis=-1))
    envelope = envelope / np.maximum(envelope.mean(axis=-1, keepdims=True), 1e-12)
    frequencies, density = signal.welch(envelope, rate_hz, nperseg=int(0.5 * rate_hz), axis=-1)
    inside = (frequencies >= 2.0) & (frequencies <= 50.0)
    return frequencies[inside], density[..., inside]


def intervals(
    figures: Callable[[NDArray[np.int64]], Mapping[str, Any]], n_blocks: int, seed: int = 0
) -> dict[str, Any]:
    """Return the 95 % percentile interval of each figure, resampling blocks with replacement.

    Samples within a block are correlated and do not count as independent. With fewer than 4 blocks there are too few different
    resamples, and the result is empty.

    Args:
        figures: block numbers → figures, each a number, a list of numbers, or None where a resample has none.

    Returns:
        By figure [low, high]; for a list one such pair for each entry, None where no resample has a number.
    """
    if n_blocks < 4:
        return {}
    rng = np.random.default_rng(seed)
    drawn = [figures(rng.integers(0, n_blocks, n_blocks)) for _ in range(N_RESAMPLES)]
    bounds = {name: _interval([draw[name] for draw in drawn]) for name in drawn[0]}
    return {name: bound for name, bound in bounds.items() if bound is not None}


def _interval(values: Sequence[Any]) -> list[Any] | None:
    known = [value for value in values if value is not None]
    if known and isinstance(known[0], list | tuple):
        return [_interval(entry) for entry in zip(*known, strict=True)]
    return [float(bound) for bound in np.percentile(known, [2.5, 97.5])] if known else None
