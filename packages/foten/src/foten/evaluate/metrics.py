"""Figures of merit on arrays, and their intervals."""

import math
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.distance import MIN_SCORED_HZ, POWER_FLOOR, max_scored_hz
from foten.dsp.inference import student_quantile

N_BANDS = 9


def goodness_of_fit(recorded: Array, synthesized: Array) -> Array:
    """Cosine similarity of DFT amplitude spectra (GFC, Eq. 13) of accelerations, (…, n) → (…): 1 where they are proportional.

    Blind to gain and phase: report it beside an absolute error. Two realisations of one noise reach π/4.
    """
    return cosine(np.abs(np.fft.rfft(recorded)), np.abs(np.fft.rfft(synthesized)))


def cosine(a: Array, b: Array) -> Array:
    """Cosine similarity of amplitudes (…, k) → (…), 0 where one is all zero."""
    norm = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    return np.asarray((a * b).sum(axis=-1) / np.maximum(norm, np.finfo(np.float64).tiny))


def moments(samples: Array) -> Array:
    """Means of the first to fourth powers of samples: (…, n) → (4, …)."""
    return np.stack([np.power(samples, k).mean(axis=-1) for k in range(1, 5)])


def kurtosis(moments: Array) -> float:
    """Pearson's kurtosis from such moments, shape (4,): 3 for a Gaussian, more for a spiky vibration; 0 for silence."""
    mean, second, third, fourth = (float(moment) for moment in moments)
    variance = second - mean**2
    central = fourth - 4 * mean * third + 6 * mean**2 * second - 3 * mean**4
    return central / variance**2 if variance > 0 else 0.0


def band_edges(rate_hz: float) -> Array:
    """Edges of nine bands, equal in log frequency, over the scored range [Hz], shape (10,)."""
    return np.geomspace(MIN_SCORED_HZ, max_scored_hz(rate_hz), N_BANDS + 1)


def band_errors(recorded: Array, synthesized: Array, frequencies: Array, edges: Array) -> list[float | None]:
    """Errors of the energy of each band between edges [Hz], in dB, from pooled densities (k,); None without a bin."""
    starts = np.searchsorted(frequencies, edges)
    starts[-1] = np.searchsorted(frequencies, edges[-1], side="right")  # the last band includes both edges
    errors: list[float | None] = []
    for first, stop in pairwise(starts):
        p, q = float(recorded[first:stop].sum()), float(synthesized[first:stop].sum())
        errors.append(10 * math.log10(max(q, POWER_FLOOR * p) / p) if p > 0 else None)
    return errors


def modulation_spectra(blocks: Array, rate_hz: float) -> tuple[Array, Array] | None:
    """Frequencies [Hz], 1 to 50, and spectra of envelopes over their mean: blocks (…, n) → (k,), (…, k); None below 1 s."""
    if blocks.shape[-1] < rate_hz:
        return None
    from scipy import signal

    envelope = np.abs(signal.hilbert(blocks, axis=-1))
    envelope = envelope / np.maximum(envelope.mean(axis=-1, keepdims=True), 1e-12)
    frequencies, density = signal.welch(envelope, rate_hz, nperseg=int(rate_hz), axis=-1)
    inside = (frequencies >= 1.0) & (frequencies <= 50.0)
    return frequencies[inside], density[..., inside]


def band_correlations(energies: Array) -> Array:
    """Correlations of the envelopes of each pair of bands: energies (n_blocks, bands, frames) → (pairs,).

    Over all frames of all blocks, of amplitudes to the power of 0.3; 0 where one does not vary. Impacts raise all bands at once.
    Source: McDermott & Simoncelli, "Sound texture perception via statistics of the auditory periphery", Neuron 71 (2011).
    """
    envelopes = np.moveaxis(energies, 1, 0).reshape(energies.shape[1], -1) ** 0.15
    envelopes -= envelopes.mean(axis=1, keepdims=True)
    norms = np.linalg.norm(envelopes, axis=1)
    correlations = (envelopes @ envelopes.T) / np.maximum(np.outer(norms, norms), np.finfo(float).tiny)
    return np.asarray(correlations[np.triu_indices(len(envelopes), 1)])


def with_intervals(figures: Callable[[NDArray[np.int64]], Mapping[str, Any]], n_blocks: int) -> dict[str, Any]:
    """Figures of all blocks, and `intervals`: 95 % confidence, [low, high] each, by Student's t and the jackknife.

    `figures` are of block numbers; those that are a number have an interval, from 4 blocks on. Resampling blocks with replacement
    would cover the mean of 4 normal blocks in 80 %. Source: Efron & Stein (1981), the standard error.
    """
    all_blocks, bounds = np.arange(n_blocks), dict[str, list[float]]()
    of_all = figures(all_blocks)
    if n_blocks < 4:
        return {**of_all, "intervals": bounds}
    left_out = [figures(np.delete(all_blocks, i)) for i in all_blocks]
    t = student_quantile(n_blocks)
    for name, figure in of_all.items():
        others = [without[name] for without in left_out]
        if isinstance(figure, float) and None not in others:
            error = t * float(np.sqrt((n_blocks - 1) * np.var(others)))
            bounds[name] = [figure - error, figure + error]
    return {**of_all, "intervals": bounds}
