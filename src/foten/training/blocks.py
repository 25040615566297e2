"""A trace ready to be learned from: its split, and its samples in units of the training blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.models.conditions import FADE_FORCE, FADE_SPEED
from foten.recording.scaling import Scaling, fit_scaling
from foten.recording.split import Split
from foten.recording.trace import Trace
from foten.recording.windows import targets


@dataclass(frozen=True)
class ScaledBlocks:
    """What every stage of training is given."""

    trace: Trace
    split: Split
    scaling: Scaling  # of the training blocks
    samples: Array  # acceleration, speed and force, scaled, shape (n_blocks, block, 3)

    @property
    def known(self) -> tuple[int, ...]:
        """The numbers of the blocks that training may look at."""
        return (*self.split.train, *self.split.validation)

    @property
    def flat(self) -> Array:
        """The samples one after the other, shape (n, 3)."""
        return self.samples.reshape(-1, 3)

    @property
    def peak_sd(self) -> float:
        """The largest sample of the training blocks, in standard deviations."""
        return float(np.abs(self.samples[list(self.split.train), :, 0]).max())

    @property
    def saturation(self) -> float:
        """What samples are cut to, for safety only: well beyond what was recorded, in standard deviations."""
        return max(12.0, 1.5 * self.peak_sd)

    def training_blocks(self) -> Array:
        """The training blocks in m/s², mm/s and N: (n_train, block, 3)."""
        return self.trace.stacked().reshape(self.samples.shape)[list(self.split.train)]

    def moving(self) -> NDArray[np.bool_]:
        """Where a rendering does not fade, shape (n_blocks, block)."""
        moving = (self.trace.speed >= FADE_SPEED) & (self.trace.force >= FADE_FORCE)
        return moving.reshape(self.samples.shape[:2])

    def targets(self, m: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The indices of the training and the validation samples that m samples of their block lie before."""
        block = self.trace.block
        return targets(self.split.train, block, m), targets(self.split.validation, block, m)

    def condition_before(self) -> tuple[Array, Array, Array]:
        """The condition of the sample before, which a prediction knows; of a block's first, never predicted, its own.

        Speed [mm/s] and force [N], (n_blocks, block) each, and both scaled, one sample after the other, (n, 2).
        """
        channels = self.trace.blocks(self.trace.speed), self.trace.blocks(self.trace.force), self.samples[..., 1:]
        speed, force, scaled = (np.concatenate([one[:, :1], one[:, :-1]], axis=1) for one in channels)
        return speed, force, scaled.reshape(-1, 2)

    def path_conditions(self) -> Array:
        """Speed and force, scaled, and the speed [mm/s], as the kernel's loop takes them: (n_blocks, block, 3)."""
        speed = self.trace.blocks(self.trace.speed)
        return np.concatenate([self.samples[..., 1:], speed[..., None]], axis=2)


def scaled_blocks(trace: Trace, split: Split) -> ScaledBlocks:
    """A trace scaled by its training blocks."""
    scaling = fit_scaling(trace, split.train)
    samples = scaling.scale(trace.stacked())
    return ScaledBlocks(trace, split, scaling, samples.reshape(trace.n_blocks, trace.block, 3))
