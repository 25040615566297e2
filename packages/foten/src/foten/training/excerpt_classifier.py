"""A linear classifier of half seconds: how well it tells free runs from the recording, on blocks that it was not fitted to.

It sees statistics of band envelopes (McDermott & Simoncelli, 2011) beside speed and force, and is fitted by ridge regression.
Errors of mean levels that differ from block to block, as 64 s leave them, are of no use to it; a wrong structure in time is.

Source: the classifier two-sample test (Lopez-Paz & Oquab, 2017), with a linear classifier.
"""

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.distance import area_under_curve
from foten.dsp.level import BAND_FRAME_MS, ENERGY_FLOOR, N_BANDS, band_energies, framed
from foten.models.excitation import Excitation
from foten.training.calibration import ERROR_STREAM, FLOOR, ClosedLoop

EXCERPT, MIN_EXCERPT = 62, 24  # frames of 8 ms: half seconds, which overlap by half; less where blocks are shorter
LAGS = (1, 2, 4, 8)  # frames, of autocorrelations
N_RUNS = 4  # free runs of each block
N_FOLDS = 8  # of blocks
PENALTY = (
    100.0  # of squared weights of standardised features, in excerpts; 10 and 1000 gave the same order of candidates
)
MIN_EXCERPTS = 16  # recorded
MOVING_SHARE = 0.9  # of an excerpt's frames in which a rendering does not fade, at least


def classified_area(loop: ClosedLoop, excitation: Excitation, seed: int) -> float | None:
    """Share of pairs of a recorded and a rendered excerpt that the classifier tells apart; None where there are too few.

    Of the training and validation blocks, in folds.
    """
    trace, known, first = loop.blocks.trace, list(loop.blocks.known), loop.first_scored
    recorded, runs = loop.free_runs(excitation, loop.blocks.known, seed, ERROR_STREAM, N_RUNS)
    signals = np.concatenate([recorded[None], runs])
    energies = band_energies(signals, trace.rate_hz)
    logs = np.log(energies + ENERGY_FLOOR * energies[0].mean(axis=(0, 2))[:, None])
    speed, force = (
        np.log(framed(trace.blocks(x)[known, first:], BAND_FRAME_MS, trace.rate_hz).mean(axis=-1) + floor)
        for x, floor in zip((trace.speed, trace.force), FLOOR, strict=True)
    )
    moving = np.asarray(framed(loop.blocks.moving()[known, first:], BAND_FRAME_MS, trace.rate_hz).all(axis=-1))
    features, block, length = [], [], min(EXCERPT, logs.shape[-1])
    if length < MIN_EXCERPT:
        return None
    for k in range(len(known)):
        for start in range(0, logs.shape[-1] - length + 1, length // 2):
            at = slice(start, start + length)
            if moving[k, at].mean() >= MOVING_SHARE:
                hand = _hand(speed[k, at], force[k, at])
                features.append([np.concatenate([_statistics(run[k][:, at]), hand]) for run in logs])
                block.append(k)
    if len(features) < MIN_EXCERPTS or len(set(block)) < N_FOLDS:
        return None
    return area_under_curve(*_scores(np.array(features), np.array(block)))


def _hand(speed: Array, force: Array) -> Array:
    """Statistics of log speed and log force of an excerpt (n,) each."""
    x, y = speed.mean(), force.mean()
    return np.array([x, y, x * x, speed[-1] - speed[0], speed.std()])


def _statistics(logs: Array) -> Array:
    """Of log energies (N_BANDS, n): means, spreads, shapes, autocorrelations, correlations of bands, and of changes."""
    mean = logs.mean(axis=1)
    spread = logs.std(axis=1) + 1e-6
    unit = (logs - mean[:, None]) / spread[:, None]
    change = np.diff(logs, axis=1)
    change_spread = change.std(axis=1) + 1e-6
    return np.concatenate(
        [
            *(mean, np.log(spread), (unit**3).mean(axis=1), np.sqrt((unit**4).mean(axis=1))),
            *((unit[:, lag:] * unit[:, :-lag]).mean(axis=1) for lag in LAGS),
            (unit @ unit.T / logs.shape[1])[np.triu_indices(N_BANDS, 1)],
            *(np.log(change_spread), ((change / change_spread[:, None]) ** 3).mean(axis=1)),
        ]
    )


def _scores(features: Array, block: NDArray[np.int64]) -> tuple[Array, Array]:
    """Scores of recorded and of rendered excerpts, from features (n, 1 + N_RUNS, p) and the blocks (n,) of each: 1-D, two."""
    n, m, p = features.shape
    x = features.reshape(n * m, p)
    x = (x - x.mean(axis=0)) / (x.std(axis=0) + 1e-9)
    rendered = np.arange(n * m) % m > 0
    weight = np.where(rendered, 1.0, m - 1)
    fold = np.repeat(block, m) % N_FOLDS
    score = np.empty(n * m)
    for k in range(N_FOLDS):
        fitted = fold != k
        weighted = x[fitted].T * weight[fitted]
        gram = weighted @ x[fitted] + PENALTY * (m - 1) * np.eye(p)
        score[~fitted] = x[~fitted] @ np.linalg.solve(gram, weighted @ np.where(rendered[fitted], 1.0, -1.0))
    return score[~rendered], score[rendered]
