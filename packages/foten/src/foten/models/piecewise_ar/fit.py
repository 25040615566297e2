"""Recording to local linear models: pieces, a filter each, and a mesh between them."""

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.ar import MAX_POLE, burg, line_spectral_frequencies, spread_out, stabilised
from foten.dsp.lattice import polynomial
from foten.dsp.segmentation import MAX_ORDER, pieces_of
from foten.dsp.speed_force_table import MIN_TRIANGLE_AREA
from foten.models.conditions import MOVING_FORCE, MOVING_SPEED
from foten.models.piecewise_ar.local_models import LocalModels, local_texture
from foten.runtime.loops import predict_blocks
from foten.runtime.native import NativeTexture
from foten.runtime.proof import ProvedTexture
from foten.training.checkpoint import Progress
from foten.training.job import ScaledBlocks, Trained, TrainingJob, versions
from foten.training.loop import Monitor

ORDERS = (4, 6, 8, 10, 12, 14, 16, 18, 20)  # tried for all models of a texture alike
GRID_S, MAX_PIECE_S = 0.05, 1.0  # between places that a cut is tried at; of a piece, over which speed and force change
MIN_SAMPLES = 100  # of a piece that is fitted
MIN_POWER = 1e-6  # of a piece, as a share of that of the training blocks: a sensor that dropped out is no texture
MIN_RESIDUAL = 1e-9  # of a piece by its filter, as a share: one that hung, or a tone that somebody fed in
MERGE_DISTANCE = 0.02  # standard deviations between models that are one
_GRID = 50  # samples between places, at the least
_SHARES = (0.0, 0.5, 1.0)  # of the way along the trained range, where models stand around it


def fit(job: TrainingJob, monitor: Monitor) -> Trained:
    """A texture of local linear models learned from a recording, its order chosen on the validation blocks.

    Raises:
        ValueError: the recording does not fit the configuration, or holds too little to fit models to.
    """
    blocks = job.blocks()
    if blocks.trace.block < 2 * MAX_ORDER:
        block, expected = blocks.trace.block, "expected twice as many: use a longer --block"
        raise ValueError(f"a block of {block} samples is too short for filters of order {MAX_ORDER}, {expected}")
    monitor.on_stage("cutting the training blocks into pieces")
    all_pieces = list(_pieces(blocks))
    pieces = [piece for piece in all_pieces if _is_of_a_texture(piece[:, 0], blocks.scaling.sd[0])]
    if len(pieces) < 3:
        raise ValueError(
            f"the training blocks hold {len(pieces)} pieces of {MIN_SAMPLES} samples or more above {MOVING_SPEED:g} mm/s and "
            f"{MOVING_FORCE:g} N that vibrate, expected 3 or more: record longer, faster or firmer"
        )
    card = {**job.card(blocks, "cpu"), "training": {"versions": versions()}}
    del card["extrapolation_exponents"]  # those of the mesh

    def texture_of(order: int, metrics: dict[str, Any]) -> ProvedTexture:
        return local_texture(local_models(pieces, blocks, order), blocks.scaling, {**card, "metrics": metrics})

    monitor.on_stage("choosing the order")
    unscored = {"validation_mae_scaled": 0.0}
    errors = {order: _validation_error(texture_of(order, unscored).kernel, blocks) for order in ORDERS}
    best = min(errors, key=lambda order: errors[order])
    metrics = {
        "validation_mae_scaled": errors[best],
        "validation_mae_scaled_by_order": {str(order): error for order, error in errors.items()},
        "n_pieces": len(pieces),
        "n_pieces_left_out": len(all_pieces) - len(pieces),
        "recorded_peak_sd": blocks.peak_sd,
    }
    return Trained(texture_of(best, metrics).texture, blocks.trace, blocks.split, Progress())


def local_models(pieces: list[Array], blocks: ScaledBlocks, order: int) -> LocalModels:
    """A model for each piece (n, 3) of acceleration [m/s²], speed [mm/s] and force [N], merged, and others around.

    Each stands at the medians of its piece; those nearer than `MERGE_DISTANCE` are merged. Around the trained range stand models
    as loud as the nearest, and silent ones at rest and without force, all with the angles of the nearest.
    """
    angles, variances = [], []
    for piece in pieces:
        reflections, variance = burg(piece[:, 0] - piece[:, 0].mean(), order)
        # Burg's poles may lie as near to the unit circle as a tone that never ends.
        taps = stabilised(-polynomial(reflections, leak=1.0)[:0:-1], MAX_POLE)
        angles.append(spread_out(line_spectral_frequencies(np.append(1.0, -taps[::-1]))))
        variances.append(variance)
    points = np.array([np.median(piece[:, 1:], axis=0) for piece in pieces])
    scale = np.maximum(points.std(axis=0), 1e-3 * points.max(axis=0))
    model = _merged(points, scale)
    share = np.zeros((model.max() + 1, len(model)))
    share[model, np.arange(len(model))] = [len(piece) for piece in pieces]
    share /= share.sum(axis=1, keepdims=True)
    centres = share @ points
    # Of the training blocks, where a rendering does not fade.
    trained, fading = blocks.training_blocks()[..., 1:], [MOVING_SPEED, MOVING_FORCE]
    low, high = (np.maximum(end(trained, axis=(0, 1)), fading) for end in (np.min, np.max))
    high = np.maximum(high, 1.01 * low)
    loud = np.array([low + (high - low) * shares for shares in product(_SHARES, _SHARES)])
    silent = np.array([[v * high[0], 0.0] for v in _SHARES] + [[0.0, f * high[1]] for f in _SHARES[1:]])
    edge = np.concatenate([loud[(loud == low).any(axis=1) | (loud == high).any(axis=1)], silent])
    nearest = np.square((edge[:, None] - centres) / scale).sum(axis=2).argmin(axis=1)
    lsf, variance = share @ np.array(angles), share @ np.array(variances)
    return _meshed(
        np.concatenate([centres, edge]),
        np.concatenate([lsf, lsf[nearest]]),
        np.concatenate([variance, np.where((edge > 0).all(axis=1), variance[nearest], 0.0)]),
        scale,
    )


def _is_of_a_texture(x: Array, sd: float) -> bool:
    power = float(np.square(x - x.mean()).mean())
    if power <= MIN_POWER * sd * sd:
        return False
    _, left = burg(x - x.mean(), max(ORDERS))
    return left > MIN_RESIDUAL * power


def _pieces(blocks: ScaledBlocks) -> Iterator[Array]:
    """The pieces of the training blocks that are fitted, each of shape (n, 3)."""
    trace, rate = blocks.trace, blocks.trace.rate_hz
    stacked = trace.stacked()
    train = np.array(sorted(blocks.split.train))
    grid, longest = max(_GRID, round(GRID_S * rate)), round(MAX_PIECE_S * rate)
    follows = np.array([trace.follows(number) for number in train[1:].tolist()], dtype=bool)
    for run in np.split(train, np.flatnonzero((np.diff(train) > 1) | ~follows) + 1):
        samples = stacked[run[0] * trace.block : (run[-1] + 1) * trace.block]
        x = samples[:, 0] - blocks.scaling.mean[0]
        cuts = pieces_of(x, MAX_ORDER, min(grid, len(x) // 2), longest)[0]
        for piece in np.split(samples, cuts):
            speed, force = np.median(piece[:, 1:], axis=0)
            if len(piece) >= MIN_SAMPLES and speed >= MOVING_SPEED and force >= MOVING_FORCE:
                yield piece


def _merged(points: Array, scale: Array) -> NDArray[np.int64]:
    """The number of each piece's model: the nearest within `MERGE_DISTANCE`, or a new one."""
    seeds: list[Array] = []
    numbers = []
    for point in points / scale:
        near = int(np.argmin([*(float(np.hypot(*(point - seed))) for seed in seeds), MERGE_DISTANCE]))
        if near == len(seeds):
            seeds.append(point)
        numbers.append(near)
    return np.array(numbers)


def _meshed(points: Array, lsf: Array, variance: Array, scale: Array) -> LocalModels:
    """Models with Delaunay's triangles over the scaled points, those left out that no triangle has a corner at."""
    from scipy.spatial import Delaunay

    triangles = Delaunay(points / scale).simplices.astype(np.int64)
    corners = (points / scale)[triangles]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    triangles = triangles[np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) > 2 * MIN_TRIANGLE_AREA]
    n = len(points)
    return LocalModels(points, lsf, variance, triangles, scale, np.empty((n, 0)), np.ones(n)).of_mesh()


def _validation_error(kernel: NativeTexture, blocks: ScaledBlocks) -> float:
    """The one-step error on the validation blocks, the same samples whatever the order, scaled."""
    recorded = blocks.samples[list(blocks.split.validation)]
    first = MAX_ORDER + 1
    predicted = predict_blocks(kernel, recorded).sample[:, first - kernel.info.window :]
    return float(np.abs(predicted - recorded[:, first:, 0]).mean())
