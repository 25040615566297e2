"""Energies of eight bands, equal in log frequency, in frames of 8 ms: the envelopes of a vibration without its waveform.

A band is about as wide as a just noticeable difference of frequency on the skin (Israr & Tan, 2006).
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np

from foten.dsp import Array
from foten.dsp.level import framed

N_BANDS = 8
MIN_BAND_HZ, MAX_BAND_HZ = 20.0, 450.0
BAND_FRAME_MS = 8.0
BAND_FLOOR = 1e-4  # of the mean energy of a band: what is 40 dB below it counts as that


def envelope_edges(rate_hz: float) -> Array:
    """Edges of the bands [Hz], shape (N_BANDS + 1,): from 20 to 450 Hz, or to 0.45 of a lower rate."""
    return np.geomspace(MIN_BAND_HZ, min(MAX_BAND_HZ, 0.45 * rate_hz), N_BANDS + 1)


def band_energies(signals: Array, rate_hz: float) -> Array:
    """Mean square of each band in each frame: signals (…, n) → (…, N_BANDS, n_frames), in their unit squared.

    Butterworth band-passes of order 2, causal, from rest; a last part that fills no frame is left out.
    """
    from scipy.signal import sosfilt

    bands = [sosfilt(sections, signals, axis=-1) for sections in _band_passes(rate_hz)]
    return np.stack([np.square(framed(band, BAND_FRAME_MS, rate_hz)).mean(axis=-1) for band in bands], axis=-2)


@lru_cache(maxsize=4)
def _band_passes(rate_hz: float) -> list[Array]:
    from scipy.signal import butter

    return [butter(2, edges, "bandpass", fs=rate_hz, output="sos") for edges in pairwise(envelope_edges(rate_hz))]
