"""Levels in short frames."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array

FRAME_MS = 40.0
FLOOR_DB = -30.0  # re the reference; levels below it count as it: a texture at rest is not judged by its sensor's noise


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
