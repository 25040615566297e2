"""Standardising: zero mean and unit standard deviation over the training blocks."""

from dataclasses import dataclass

import numpy as np

from foten.dsp import Array
from foten.recording.trace import CHANNELS, Trace


@dataclass(frozen=True)
class Scaling:
    """Mean and standard deviation of acceleration [m/s²], speed [mm/s] and force [N] over the training blocks."""

    mean: tuple[float, float, float]
    sd: tuple[float, float, float]

    def __post_init__(self) -> None:
        for name, mean, sd in zip(CHANNELS, self.mean, self.sd, strict=True):
            if not np.isfinite(mean) or not np.isfinite(sd) or sd <= 0:
                raise ValueError(f"{name} has mean {mean} and standard deviation {sd}, expected finite and > 0")

    def scale(self, samples: Array) -> Array:
        """Samples (…, 3) in their units as scaled samples (…, 3)."""
        return (samples - np.array(self.mean)) / np.array(self.sd)

    def scale_channel(self, channel: int, samples: Array) -> Array:
        """One channel (0 acceleration, 1 speed, 2 force), any shape, scaled."""
        return (samples - self.mean[channel]) / self.sd[channel]

    def unscale_acceleration(self, scaled: Array) -> Array:
        """Scaled acceleration, any shape, in m/s²."""
        return scaled * self.sd[0] + self.mean[0]


def fit_scaling(trace: Trace, blocks: tuple[int, ...]) -> Scaling:
    """Scaling of the training blocks, a constant speed or force by its size; ValueError where the acceleration is constant."""
    picked = trace.stacked().reshape(trace.n_blocks, trace.block, 3)[list(blocks)].reshape(-1, 3)
    mean, sd = picked.mean(axis=0), picked.std(axis=0)
    if sd[0] <= 1e-12 * max(1.0, abs(float(mean[0]))):
        raise ValueError("the acceleration is constant, expected a vibration; is the right column mapped?")
    magnitude = np.maximum(1.0, np.abs(mean[1:]))
    sd[1:] = np.where(sd[1:] <= 1e-9 * magnitude, magnitude, sd[1:])
    return Scaling(tuple(mean.tolist()), tuple(sd.tolist()))
