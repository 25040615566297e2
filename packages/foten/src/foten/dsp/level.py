"""Levels in short frames, and energies of eight bands, equal in log frequency: the envelopes of a vibration without its waveform.

A band is about as wide as a just noticeable difference of frequency on the skin (Israr & Tan, 2006).
"""

from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array

FRAME_MS = 40.0
FLOOR_DB = -30.0  # re the reference; levels below it count as it: a texture at rest is not judged by its sensor's noise
N_BANDS = 8
MIN_BAND_HZ, MAX_BAND_HZ = 20.0, 450.0
BAND_FRAME_MS = 8.0
ENERGY_FLOOR = 1e-4  # of the mean energy of a band: what is 40 dB below it counts as that


def rms(samples: Array) -> float:
    """Root mean square of all samples."""
    return float(np.sqrt(np.square(samples).mean()))


def decibels(power: Array, lowest: float = 1e-30) -> Array:
    """Powers in dB re 1, those below the lowest as that."""
    return 10 * np.log10(np.maximum(power, lowest))


def frame_levels(blocks: Array, rate_hz: float, reference: float) -> Array:
    """RMS in whole frames of 40 ms [dB re `reference`], not below −30 dB: blocks (…, n) → (…, frames)."""
    return decibels(frame_means(np.square(blocks), rate_hz) / reference**2, 10 ** (FLOOR_DB / 10))


def frame_means(blocks: Array, rate_hz: float) -> Array:
    """Mean in the same frames: blocks (…, n) → (…, frames)."""
    return framed(blocks, FRAME_MS, rate_hz).mean(axis=-1)


def framed(signal: NDArray[Any], frame_ms: float, rate_hz: float) -> NDArray[Any]:
    """Signal in frames, without what fills none: (…, n) → (…, n_frames, frame)."""
    frame = max(1, round(frame_ms * rate_hz / 1000))
    n = signal.shape[-1] // frame
    return signal[..., : n * frame].reshape(*signal.shape[:-1], n, frame)


def envelope_edges(rate_hz: float) -> Array:
    """Edges of the bands [Hz], shape (N_BANDS + 1,): from 20 to 450 Hz, or to 0.45 of a lower rate."""
    return np.geomspace(MIN_BAND_HZ, min(MAX_BAND_HZ, 0.45 * rate_hz), N_BANDS + 1)


def band_energies(signals: Array, rate_hz: float) -> Array:
    """Mean square of each band in each frame, by causal Butterworth band-passes: signals (…, n) → (…, N_BANDS, n_frames)."""
    from scipy.signal import sosfilt

    bands = [sosfilt(sections, signals, axis=-1) for sections in _band_passes(rate_hz)]
    return np.stack([np.square(framed(band, BAND_FRAME_MS, rate_hz)).mean(axis=-1) for band in bands], axis=-2)


@lru_cache(maxsize=4)
def _band_passes(rate_hz: float) -> list[Array]:
    from scipy.signal import butter

    return [butter(2, edges, "bandpass", fs=rate_hz, output="sos") for edges in pairwise(envelope_edges(rate_hz))]
