"""How far apart two spectra are, and levels in short frames: what training chooses by and what the judge scores."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array

LOWEST_HZ = 20.0  # below it the high-pass rules
HIGHEST_HZ = 1000.0  # above it a hand feels nothing
POWER_FLOOR = 1e-12  # of the recorded power in a bin: a silent synthesis is 120 dB off, not infinitely
FRAME_MS = 40.0
FLOOR_DB = -30.0  # re the reference; levels below it count as it: a texture at rest is not judged by its sensor's noise


def welch(blocks: Array, rate_hz: float, n_segment: int) -> tuple[Array, Array]:
    """Return frequencies [Hz] and power densities [(m/s²)²/Hz]: blocks (…, n) → (k,), (…, k).

    Hann segments, half overlapping, the mean of each removed.
    """
    from scipy import signal

    return signal.welch(blocks, rate_hz, nperseg=n_segment, axis=-1)


def segment_length(block: int) -> int:
    """Return Welch's segment for a block of so many samples: 256, or a quarter of the block if that is less."""
    return min(256, max(8, block // 4))


def scored_bins(frequencies: Array, rate_hz: float) -> NDArray[np.bool_]:
    """Return which bins are scored: from 20 Hz to the lower of 1 kHz and 0.45 of the rate."""
    return (frequencies >= LOWEST_HZ) & (frequencies <= min(HIGHEST_HZ, 0.45 * rate_hz))


def log_spectral_distance(recorded: Array, synthesized: Array) -> Array:
    """Return the RMS over bins of 10·log₁₀(P/Q) [dB], sees gain: densities (…, k) of scored bins → (…,)."""
    floor = POWER_FLOOR * recorded.max(axis=-1, keepdims=True)
    ratio = 10 * np.log10(np.maximum(recorded, floor) / np.maximum(synthesized, floor))
    return np.sqrt(np.square(ratio).mean(axis=-1))


def frame_levels(blocks: Array, rate_hz: float, reference: float) -> Array:
    """Return the RMS in frames of 40 ms [dB re `reference`], not below −30 dB: blocks (…, n) → (…, frames).

    Samples after the last whole frame are left out.
    """
    power = frame_means(np.square(blocks), rate_hz) / reference**2
    return 10 * np.log10(np.maximum(power, 10 ** (FLOOR_DB / 10)))


def frame_means(blocks: Array, rate_hz: float) -> Array:
    """Return the mean in the same frames: blocks (…, n) → (…, frames)."""
    frame = max(1, round(FRAME_MS * rate_hz / 1000))
    n_frames = blocks.shape[-1] // frame
    return blocks[..., : n_frames * frame].reshape(*blocks.shape[:-1], n_frames, frame).mean(axis=-1)
