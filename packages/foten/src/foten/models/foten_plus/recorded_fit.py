"""Recorded innovations of a linear model: those of the training and validation blocks."""

import numpy as np
from numpy.typing import NDArray

from foten.models.excitation import Scale
from foten.models.foten_plus.linear_model import LinearModel
from foten.models.foten_plus.recorded_innovations import RecordedInnovations, runs_of
from foten.models.foten_plus.recorded_store import Run, stored
from foten.training.job import ScaledBlocks

# Near rest the recording is the hand's and the sensor's, and not as weak as σ. Innovations below this speed [mm/s] are over σ at
# it, or a hand that leaves rest would play them many times as loud as they were.
SLOW_SPEED = 10.0
SPREAD_MS = 64.0  # as far as filters and DFT321 carry a block into the next: of test blocks nothing is to be stored


def recorded_innovations(model: LinearModel, sigma: Scale, blocks: ScaledBlocks) -> RecordedInnovations | None:
    """Innovations over σ of the training and validation blocks; None where no run of them is long enough for a candidate."""
    return stored(
        [_analysed(model, sigma, blocks, run) for run in runs_of(blocks.split, blocks.trace)], blocks.trace.rate_hz
    )


def _analysed(model: LinearModel, sigma: Scale, blocks: ScaledBlocks, run: NDArray[np.int64]) -> Run:
    """A run of blocks, with the speed and force before each sample."""
    x, e, _ = model.innovations(blocks, residual=True, run=run)
    condition = blocks.samples[run, :, 1:].reshape(-1, 2)
    before = np.concatenate([condition[:1], condition[:-1]])
    speed, force = model.level.physical(before).T
    sd, mean, lattice = model.level.sd[0], model.level.mean[0], model.excited_lattice
    raised = np.stack([np.maximum(before[:, 0], (SLOW_SPEED - mean) / sd), before[:, 1]], axis=1)
    gain, raised_gain = (lattice.level(at) * sigma(at) for at in (before, raised))
    spread_ms = max(SPREAD_MS, blocks.trace.preprocess.get("dft321_ms", 0.0))
    n_apart = max(lattice.order, round(spread_ms * blocks.trace.rate_hz / 1000))
    return Run(e[0] / sigma(before) * np.minimum(1.0, gain / raised_gain), x[0], speed, force, n_apart)
