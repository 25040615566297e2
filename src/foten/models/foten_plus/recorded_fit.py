"""Recorded innovations of a linear model, as a texture file holds them: those of the training and validation blocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.models.excitation import Scale
from foten.models.foten_plus.linear_model import LinearModel
from foten.models.foten_plus.recorded_innovations import (
    CANDIDATE,
    FORCE_FLOOR,
    FORCE_ORIGIN,
    LEVEL_ORIGIN,
    LEVELS_IN_OCTAVE,
    MAX_CANDIDATES,
    N_AHEAD,
    N_GROWTH,
    RUN_START,
    SPEED_FLOOR,
    SPEED_ORIGIN,
    STORED_SHIFT,
    RecordedInnovations,
    control_step,
    encoded,
    logarithm,
    runs_of,
)
from foten.training.job import ScaledBlocks

OUTLIER_SHARE = 2e-5  # of innovations that are cut off
LEVEL_MS = (8.0, 40.0)
MIN_SPEED = 1.0  # mm/s of a candidate
NEIGHBOUR_S = (
    1.25  # from a block that is judged: what is recorded there is not played: a second, and the longest stretch
)


def recorded_innovations(model: LinearModel, sigma: Scale, blocks: ScaledBlocks) -> RecordedInnovations | None:
    """Innovations over σ of the training and validation blocks; None where no run of them is long enough for a candidate."""
    step = control_step(blocks.trace.rate_hz)
    innovations, moments = [], []
    for run in runs_of(blocks.split):
        e, x, speed, force = _analysed(model, sigma, blocks, run)
        n = len(e) // step
        at = np.arange(n) * step
        levels = [_levels(x, at, round(ms * blocks.trace.rate_hz / 1000)) for ms in LEVEL_MS]
        flags = np.zeros(n, dtype=np.int64)
        j = np.arange(n)
        first = N_GROWTH - (-model.excited_lattice.order // step)  # after which the lattice has forgotten its beginning
        flags[(j >= first) & (n - j >= N_AHEAD) & (speed[at] > MIN_SPEED)] = CANDIDATE
        flags[:1] |= RUN_START
        logs = [
            _byte(logarithm(channel[at], floor) - origin >> STORED_SHIFT)
            for channel, floor, origin in ((speed, SPEED_FLOOR, SPEED_ORIGIN), (force, FORCE_FLOOR, FORCE_ORIGIN))
        ]
        innovations.append(e[: n * step].reshape(n, step))
        moments.append(np.stack([*logs, *levels, flags.astype(np.uint8)], axis=1))
    joined, moment = np.concatenate(innovations), _thinned(np.concatenate(moments))
    if not (moment[:, 4] & CANDIDATE).any():
        return None
    return encoded(joined, moment, float(np.quantile(np.abs(joined), 1 - OUTLIER_SHARE)))


def _analysed(
    model: LinearModel, sigma: Scale, blocks: ScaledBlocks, run: NDArray[np.int64]
) -> tuple[Array, Array, Array, Array]:
    """Innovations over σ, the signal over its level, and the speed and force before each sample, of a run, (n,) each."""
    x, e, _ = model.innovations(blocks, residual=True, run=run)
    condition = blocks.samples[run, :, 1:].reshape(-1, 2)
    before = np.concatenate([condition[:1], condition[:-1]])
    speed, force = model.level.physical(before).T
    return e[0] / sigma(before), x[0], speed, force


def _levels(x: Array, at: NDArray[np.int64], n: int) -> NDArray[np.uint8]:
    """Stored levels of x over the n samples before each place."""
    sums = np.concatenate([[0.0], np.cumsum(np.square(x))])
    first = np.maximum(at - n, 0)
    power = (sums[at] - sums[first]) / np.maximum(at - first, 1) + 1e-6
    return _byte(np.round(LEVELS_IN_OCTAVE * 0.5 * np.log2(power)) + LEVEL_ORIGIN)


def _byte(values: Array | NDArray[np.int64]) -> NDArray[np.uint8]:
    return np.clip(values, 0, 255).astype(np.uint8)


def _thinned(moments: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """At most `MAX_CANDIDATES`: where more lie in a cell of speed, force and level, they are taken at even distances."""
    candidates = np.flatnonzero(moments[:, 4] & CANDIDATE)
    if candidates.size <= MAX_CANDIDATES:
        return moments
    cells = (moments[candidates, :3].astype(np.int64) >> [3, 4, 4]) @ [1 << 16, 1 << 8, 1]
    _, cell, counts = np.unique(cells, return_inverse=True, return_counts=True)
    low, high = 0, int(counts.max())
    while high - low > 1:  # the largest number that a cell may keep
        middle = (low + high) // 2
        low, high = (middle, high) if np.minimum(counts, middle).sum() <= MAX_CANDIDATES else (low, middle)
    order = np.argsort(cell, kind="stable")
    rank = np.arange(cell.size) - np.repeat(np.cumsum(counts) - counts, counts)
    size = counts[cell[order]]
    dropped = candidates[order[(size > low) & (rank * low // size == (rank + 1) * low // size)]]
    thinned = moments.copy()
    thinned[dropped, 4] &= RUN_START
    return thinned
