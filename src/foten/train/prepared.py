"""What every stage of training is given: a trace, its split, and its samples in units of the training blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.recording.scaling import Scaling, fit_scaling
from foten.recording.split import Split
from foten.recording.trace import Trace
from foten.recording.windows import targets

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prepared:
    """A trace ready to be learned from.

    Attributes:
        trace: as it was preprocessed.
        split: its blocks for training, validation and test.
        scaling: mean and standard deviation of the training blocks.
        samples: acceleration, speed and force, scaled, shape (n_blocks, block, 3).
    """

    trace: Trace
    split: Split
    scaling: Scaling
    samples: Array

    @property
    def known(self) -> tuple[int, ...]:
        """Return the numbers of the blocks that training may look at."""
        return (*self.split.train, *self.split.validation)

    def targets(self, m: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the indices of the training and the validation samples that m samples of their block lie before."""
        train, validation = (
            targets(blocks, self.trace.block, m) for blocks in (self.split.train, self.split.validation)
        )
        return train, validation


def prepare(trace: Trace, split: Split) -> Prepared:
    """Return a trace scaled by its training blocks."""
    scaling = fit_scaling(trace, split.train)
    samples = scaling.scale(trace.stacked())
    return Prepared(trace, split, scaling, samples.reshape(trace.n_blocks, trace.block, 3))
