"""How innovations are stored: in runs, with a moment every 4 ms, of which some are candidates to begin a stretch with."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.noise import gaussian
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
)

OUTLIER_SHARE = 2e-5  # of innovations that are cut off
LEVEL_MS = (8.0, 40.0)
MIN_SPEED = 1.0  # mm/s of a candidate
NOISE_S, SWEEP_S = 16.0, 4.0  # of noise that is stored in place of a recording, and of its sweep over the trained range


@dataclass(frozen=True)
class Run:
    """Innovations without a gap, and what they were recorded under: arrays of n samples."""

    innovations: Array  # over σ
    signal: Array  # what they excite, over the level
    speed: Array  # [mm/s]
    force: Array  # [N]
    n_apart: int = 0  # samples at either end that are not stored: not known well, or not of this run alone


def stored(runs: Sequence[Run], rate_hz: float) -> RecordedInnovations | None:
    """Runs as a texture file holds them; None where none of them is long enough for a candidate."""
    step = control_step(rate_hz)
    joined = np.concatenate([_innovations(run, step) for run in runs])
    moments = thinned(np.concatenate([_moments(run, step, rate_hz) for run in runs]))
    if not (moments[:, 4] & CANDIDATE).any():
        return None
    return encoded(joined, moments, float(np.quantile(np.abs(joined), 1 - OUTLIER_SHARE)))


def _innovations(run: Run, step: int) -> Array:
    n = len(run.innovations)
    kept = np.zeros(n)
    kept[run.n_apart : n - run.n_apart] = run.innovations[run.n_apart : n - run.n_apart]
    return kept[: n // step * step].reshape(-1, step)


def _moments(run: Run, step: int, rate_hz: float) -> NDArray[np.uint8]:
    n, n_apart = len(run.innovations) // step, -(-run.n_apart // step)
    j, at, end = np.arange(n), np.arange(n) * step, n - n_apart
    flags = np.zeros(n, dtype=np.uint8)
    flags[(j >= n_apart + N_GROWTH) & (end - j >= N_AHEAD) & (run.speed[at] > MIN_SPEED)] = CANDIDATE
    flags[[0, max(end, 0)] if n_apart and n else slice(1)] |= RUN_START  # no stretch reads on into the end
    logs = [
        _byte(logarithm(channel[at], floor) - origin >> STORED_SHIFT)
        for channel, floor, origin in ((run.speed, SPEED_FLOOR, SPEED_ORIGIN), (run.force, FORCE_FLOOR, FORCE_ORIGIN))
    ]
    levels = [_levels(run.signal, at, round(ms * rate_hz / 1000)) for ms in LEVEL_MS]
    return np.stack([*logs, *levels, flags], axis=1)


def _levels(x: Array, at: NDArray[np.int64], n: int) -> NDArray[np.uint8]:
    """Stored levels of x over the n samples before each place."""
    sums = np.concatenate([[0.0], np.cumsum(np.square(x))])
    first = np.maximum(at - n, 0)
    power = (sums[at] - sums[first]) / np.maximum(at - first, 1) + 1e-6
    return _byte(np.round(LEVELS_IN_OCTAVE * 0.5 * np.log2(power)) + LEVEL_ORIGIN)


def _byte(values: Array | NDArray[np.int64]) -> NDArray[np.uint8]:
    return np.clip(values, 0, 255).astype(np.uint8)


def thinned(moments: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """At most `MAX_CANDIDATES`: where more lie in a cell of speed, force and level, they are taken at even distances."""
    candidates = np.flatnonzero(moments[:, 4] & CANDIDATE)
    if candidates.size <= MAX_CANDIDATES:
        return moments
    cells = (moments[candidates, :3].astype(np.int64) >> [3, 4, 4]) @ [1 << 16, 1 << 8, 1]
    _, cell, counts = np.unique(cells, return_inverse=True, return_counts=True)
    order = np.argsort(cell, kind="stable")
    low, high = 0, int(counts.max())
    while high - low > 1:  # the largest number that a cell may keep
        middle = (low + high) // 2
        low, high = (middle, high) if np.minimum(counts, middle).sum() <= MAX_CANDIDATES else (low, middle)
    rank = np.arange(cell.size) - np.repeat(np.cumsum(counts) - counts, counts)
    size = counts[cell[order]]
    dropped = candidates[order[(size > low) & (rank * low // size == (rank + 1) * low // size)]]
    return without(moments, dropped)


def evenly_thinned(moments: NDArray[np.uint8], n_candidates: int) -> NDArray[np.uint8]:
    """So many candidates, at even distances in their order."""
    candidates = np.flatnonzero(moments[:, 4] & CANDIDATE)
    return without(moments, np.delete(candidates, np.arange(n_candidates) * candidates.size // n_candidates))


def without(moments: NDArray[np.uint8], dropped: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Moments of which some are no candidates any more."""
    out = moments.copy()
    out[dropped, 4] &= RUN_START
    return out


def stored_noise(rate_hz: float, speed: tuple[float, float], force: tuple[float, float]) -> RecordedInnovations:
    """White noise as if recorded under sweeps of speed [mm/s] and force [N] over their ranges, to be blended with a recording."""
    n = round(NOISE_S * rate_hz)
    turns = np.arange(n) / (SWEEP_S * rate_hz)

    def swept(ends: tuple[float, float], turns: Array) -> Array:
        low, high = np.log(np.maximum(ends, 1e-3))
        return np.asarray(np.exp(low + (high - low) * (0.5 - 0.5 * np.cos(2 * np.pi * turns))))

    e = gaussian(0, 0, 0, n)
    recorded = stored(
        [Run(e, e, np.maximum(swept(speed, turns), 2 * MIN_SPEED), swept(force, np.sqrt(2) * turns))], rate_hz
    )
    assert recorded is not None
    return recorded
