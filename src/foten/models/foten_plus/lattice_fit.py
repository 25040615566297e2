"""The linear part of foten-plus: a lattice over speed and force, fitted section by section, shrunk by its own evidence."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.ndimage import uniform_filter1d

from foten.dsp import Array
from foten.dsp.lattice import MAX_REFLECTION, delayed, rotate_back
from foten.dsp.speed_force_table import SpeedForceTable, spanning

ORDERS = (10, 20, 40, 80, 160, 240)  # tried, as far as a block allows
SHORT_ORDER = 80  # longer ones take three times as long, and are tried of the kinds that are best up to this one,
# where the error falls by this share up to it: in trials it fell by 1.1 % or more where 240 were best, by 0.6 % elsewhere.
MIN_FALL = 0.008
N_SPEED, N_FORCE = 12, 3  # vertices
CORRELATION = 0.5  # of the range of speed, and of log force, over which reflections are alike beforehand
SCALES = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0)  # standard deviations that a reflection may be given over speed and force
N_FOLDS = 8  # into which training and validation blocks are divided to choose a kind, or as many as there are blocks
N_FOLDS_OF_MANY, MANY_BLOCKS = 4, 16  # of so many blocks fewer folds tell kinds apart as well
LEVEL_SAMPLES = 241  # samples that a level is averaged over for the gain before the filter
NEIGHBOURS = 10  # sections on each side that say how much of a reflection is chance
# Share by which a longer lattice, one with the gain before the filter or one with a table must lower the error.
MIN_GAIN = 1e-3


@dataclass(frozen=True)
class LatticeData:
    """What a lattice is fitted to; all arrays of shape (n_blocks, block)."""

    x: Array  # what the lattice is of: acceleration over its level, or acceleration
    gain: Array  # what an x of 1 is in the acceleration that is scored
    speed: Array  # that each prediction may know: of the sample before [mm/s]
    force: Array  # and [N]
    train: tuple[int, ...]  # numbers of blocks
    validation: tuple[int, ...]
    weight: Array | None = None  # of each sample's squared errors; None for all alike

    def with_gain_before_filter(self) -> LatticeData:
        """The same for a lattice of the acceleration itself.

        Weighted by 1/level², its mean over `LEVEL_SAMPLES`: unweighted, soft strokes would count nothing, and weights that
        change within the memory bias Burg's method towards too long a ringing. One-step error of one lattice for all speeds,
        linear cloth, hum and twin, seed 0, validation, re the levelled one: 0.986, 0.995, 0.998; weighted block by block 0.989,
        0.999, 1.001.
        """
        weight = 1 / uniform_filter1d(np.square(self.gain), LEVEL_SAMPLES, axis=1)
        return replace(self, x=self.x * self.gain, gain=np.ones_like(self.gain), weight=weight)


@dataclass(frozen=True)
class FittedReflections:
    """A table of reflection coefficients; whether of the acceleration, or of the acceleration over its level; what was tried."""

    table: SpeedForceTable
    gain_before_filter: bool
    tried: list[dict[str, float]]


def fit_lattice(data: LatticeData, max_order: int, tables: bool = True, both_gains: bool = True) -> FittedReflections:
    """The lattice of the training blocks whose kind predicts best, in absolute one-step error.

    Tried: the `ORDERS` up to `max_order`, with one set of reflections for all speeds and forces and, unless `tables` is
    False, with a table of them; of the acceleration over its level and, unless `both_gains` is False, of the acceleration itself.
    Which kind is chosen by cross-validation over training and validation blocks: two validation blocks of 200 ms are too few. In
    a trial on the real four at 2.5 kHz, six splits, the kind so chosen had a test error of 1.033 of the best kind's on the mean,
    with cross-validation 1.023; at 10 kHz both found the best within 0.1 %.

    Differs from the paper: it has no linear part.
    """
    orders = [order for order in ORDERS if order <= max_order] or [max_order]
    sizes, gains = ((1, 1), (N_SPEED, N_FORCE))[: 1 + tables], (False, True)[: 1 + both_gains]
    of_gain = {gain: data.with_gain_before_filter() if gain else data for gain in gains}
    folds = {gain: _folds(of_gain[gain]) for gain in gains}
    weights = [len(fold.validation) for fold in folds[False]]
    kinds = list(product(sizes, gains))

    def errors_of(among: list[tuple[tuple[int, int], bool]], longest: int) -> list[list[float]]:
        """The errors of some kinds, of each by order."""
        shorter = [order for order in orders if order <= longest]

        def of_fold(vertices: tuple[int, int], fold: LatticeData) -> list[float]:
            return validation_errors(fit_lattice_of(fold, longest, *vertices), fold, shorter)

        tasks = [(vertices, fold) for vertices, gain in among for fold in folds[gain]]
        with ThreadPoolExecutor() as pool:  # NumPy's and SciPy's loops release the interpreter's lock
            each = np.array(list(pool.map(of_fold, *zip(*tasks, strict=True))))
        return np.average(each.reshape(len(among), len(weights), -1), axis=1, weights=weights).tolist()

    errors = dict(zip(kinds, errors_of(kinds, min(SHORT_ORDER, orders[-1])), strict=True))
    if orders[-1] > SHORT_ORDER:
        lowest_errors = min(errors.values(), key=lambda of_kind: of_kind[-1])
        if lowest_errors[-1] < lowest_errors[-2] * (1 - MIN_FALL):
            near = [kind for kind in kinds if errors[kind][-1] <= lowest_errors[-1] * (1 + MIN_GAIN)]
            errors |= zip(near, errors_of(near, orders[-1]), strict=True)
    tried: list[dict[str, float]] = []
    lowest, best = np.inf, (orders[0], *kinds[0])
    for (vertices, gain), of_kind in errors.items():
        n_vertices = len(spanning(data.speed, data.force, *vertices).values)
        for order, error in zip(orders, of_kind, strict=False):
            tried.append({"order": order, "vertices": n_vertices, "gain_before_filter": gain, "mae_scaled": error})
            if error < lowest * (1 - MIN_GAIN):
                lowest, best = error, (order, vertices, gain)
    order, vertices, gain = best
    return FittedReflections(fit_lattice_of(of_gain[gain], order, *vertices), gain, tried)


def _folds(data: LatticeData) -> list[LatticeData]:
    """The training and validation blocks divided anew, so that each of them is in one validation set."""
    known = sorted((*data.train, *data.validation))
    n = min(N_FOLDS if len(known) <= MANY_BLOCKS else N_FOLDS_OF_MANY, len(known))
    parts = [tuple(known[first::n]) for first in range(n)]
    return [replace(data, train=tuple(b for b in known if b not in part), validation=part) for part in parts]


def validation_errors(reflections: SpeedForceTable, data: LatticeData, orders: Sequence[int]) -> list[float]:
    """The mean absolute one-step errors of the first sections alone, by their number, on the validation blocks [scaled].

    The first samples of each block are left out, of the longest order, for all alike.
    """
    scored = slice(min(orders[-1], data.x.shape[1] // 2), None)
    error = np.zeros(len(orders))
    for block in data.validation:  # one by one: reflections of a minute at 10 kHz would take gigabytes
        k = reflections.at(data.speed[block], data.force[block])
        f = b = data.x[block]
        gain = data.gain[block]
        for i in range(orders[-1]):
            f, b, cosine = rotate_back(f, delayed(b), k[:, i])
            gain = gain * cosine
            if i + 1 in orders:
                error[orders.index(i + 1)] += np.abs(f * gain)[scored].mean()
    return (error / len(data.validation)).tolist()


def fit_lattice_of(data: LatticeData, order: int, n_speed: int, n_force: int) -> SpeedForceTable:
    """The reflections that make forward and backward errors of each section least, over the training blocks.

    Section i minimises Σ w ((f_{i−1} + k b)² + (b + k f_{i−1})²) over k at the vertices: Burg's method, a least-squares
    problem in as many unknowns as there are vertices. What the vertices differ by has a Gaussian prior in three parts,
    over speed, over force and over both, exponentially correlated, whose standard deviations are those of the greatest
    evidence. So a section that speed and force do not change stays one number. On real recordings of two seconds at 10 kHz the
    table is still 0.4 to 7 % worse than a single filter of 160 sections, hence the choice by validation.

    Source: Burg's criterion; the time-varying extension after Grenier, IEEE Trans. ASSP 31 (1983); the prior is ours.
    """
    chosen = list(data.train)
    speed, force, x = data.speed[chosen], data.force[chosen], data.x[chosen]
    table = spanning(speed, force, n_speed, n_force)
    near = vertex_weights(table, speed, force)
    n_vertices = near.by_vertex.shape[0]
    parts = _covariances(len(table.speed_knots), len(table.force_knots))
    weight = np.ones_like(speed) if data.weight is None else data.weight[chosen]
    shares = _share_beyond_chance(x, weight, order)
    f = b = x
    reflections = np.zeros((n_vertices, order))
    for i in range(order):
        b = delayed(b)
        power, correlation = weight * (f * f + b * b) / 2, weight * f * b
        power[:, : i + 1] = correlation[:, : i + 1] = 0.0  # before that a section still fills
        upper = (near.by_pair @ power.ravel()).reshape(n_vertices, n_vertices)
        gram = upper + upper.T - np.diag(np.diag(upper))
        moment = -(near.by_vertex @ correlation.ravel())
        everywhere = shares[i] * moment.sum() / gram.sum()
        # In units of a section's own error: a reflection is known to within √((1 − k²)/n).
        noise = max(1e-4, 1 - everywhere**2) * power[:, i + 1 :].mean()
        k = everywhere + _shrunk(gram / noise, (moment - gram.sum(axis=1) * everywhere) / noise, parts)
        reflections[:, i] = np.clip(k, -MAX_REFLECTION, MAX_REFLECTION)
        f, b, _ = rotate_back(f, b, (near.by_vertex.T @ reflections[:, i]).reshape(f.shape))
    return replace(table, values=reflections)


@dataclass(frozen=True)
class VertexWeights:
    """How much each vertex of a table counts at samples, and each pair of vertices i ≤ j, in row i·k + j: (k, n) and (k², n).

    Four vertices count at a sample, and ten pairs of them: all 36 would take several times the memory and time.
    """

    by_vertex: sparse.csc_array
    by_pair: sparse.csc_array


def vertex_weights(table: SpeedForceTable, speed: Array, force: Array) -> VertexWeights:
    """What the vertices of a table count at the samples of blocks, speed and force (n_blocks, block) each."""
    by_block = [sparse.csr_array(table.weights(*block)) for block in zip(speed, force, strict=True)]
    by_pair = [_pairs(block) for block in by_block]
    return VertexWeights(sparse.vstack(by_block, format="csr").T, sparse.vstack(by_pair, format="csr").T)


def _pairs(weights: sparse.csr_array) -> sparse.csr_array:
    """The products of each row's weights, (n, k) → (n, k²): of vertices i ≤ j, in column i·k + j."""
    n, k = weights.shape
    counts = np.diff(weights.indptr)
    rows = np.repeat(np.arange(n), counts)
    place = np.arange(weights.nnz) - weights.indptr[rows]
    vertex, weight = np.zeros((2, n, int(counts.max())))
    vertex[rows, place], weight[rows, place] = weights.indices, weights.data
    first, second = np.triu_indices(vertex.shape[1])
    columns = vertex[:, first] * k + vertex[:, second]
    products = weight[:, first] * weight[:, second]
    nonzero = products != 0
    at = np.repeat(np.arange(n), nonzero.sum(axis=1))
    return sparse.csr_array((products[nonzero], (at, columns[nonzero].astype(np.int64))), shape=(n, k * k))


def _share_beyond_chance(x: Array, weight: Array, order: int) -> Array:
    """The share of each section's common reflection that is kept, shape (order,).

    Reflections of far sections are mostly chance; unshrunk, 160 of them from a second at 10 kHz draw ripples into the
    spectrum that a free run plays back. The share is Wiener's, τ²/(τ² + v), with v the variance between blocks and τ² what
    the squares of ten neighbours on each side have above it. In a trial on the real four at 10 kHz, 160 sections, two splits,
    it lowered the one-step error by 0.15 %, the log-spectral distance of the free run by 1.5 % and that of the pooled spectra by
    2.5 %.
    """
    common, spread = np.zeros(order), np.zeros(order)
    f = b = x
    for i in range(order):
        b = delayed(b)
        filled = slice(i + 1, None)
        power = (weight * (f * f + b * b) / 2)[:, filled].sum(axis=1)
        moment = -(weight * f * b)[:, filled].sum(axis=1)
        k = moment.sum() / power.sum()
        share_of = power / power.sum()
        each = moment / np.maximum(power, 1e-300)
        common[i] = np.clip(k, -MAX_REFLECTION, MAX_REFLECTION)
        spread[i] = (share_of**2 * (each - k) ** 2).sum() * len(x) / max(1, len(x) - 1)
        f, b, _ = rotate_back(f, b, np.full_like(f, common[i]))
    share = np.ones(order)
    for i in range(NEIGHBOURS, order):  # the first sections are the shape of the spectrum, and none of them chance
        near = slice(i - NEIGHBOURS, i + NEIGHBOURS + 1)
        # The median of squares, since one strong reflection says nothing of its neighbours; 0.455 is that of χ² of one.
        noise = spread[near].mean()
        if noise > 0:
            signal = max(0.0, np.median(np.square(common[near])) / 0.455 - noise)
            share[i] = signal / (signal + noise)
    return share


def _covariances(n_speed: int, n_force: int) -> list[NDArray[Any]]:
    """The prior covariances, of unit variance, of what vertices differ by: over speed, over force, over both."""
    if n_speed * n_force == 1:
        return []
    at = (np.arange(n) / max(1, n - 1) for n in (n_speed, n_force))
    speed, force = (np.exp(-np.abs(np.subtract.outer(x, x)) / CORRELATION) for x in at)
    return [np.kron(speed, np.ones_like(force)), np.kron(np.ones_like(speed), force), np.kron(speed, force)]


def _shrunk(information: Array, score: Array, parts: list[NDArray[Any]]) -> NDArray[Any]:
    """The posterior mean of deviations with likelihood exp(score·d − d·information·d/2), prior scales by evidence."""
    if not parts:
        return np.zeros_like(score)
    identity = np.eye(len(score))

    def solved(scales: list[float]) -> tuple[float, NDArray[Any]]:
        prior = sum((scale**2 * part for scale, part in zip(scales, parts, strict=True)), 0 * identity)
        system = identity + prior @ information
        mean = np.linalg.solve(system, prior @ score)
        return -0.5 * float(np.linalg.slogdet(system)[1]) + 0.5 * float(score @ mean), mean

    scales = [0.0] * len(parts)
    best = solved(scales)
    for _ in range(2):
        before = scales
        for number, scale in product(range(len(parts)), SCALES):
            tried = [*scales[:number], scale, *scales[number + 1 :]]
            if tried != scales:
                candidate = solved(tried)
                if candidate[0] > best[0] + 1e-9:
                    best, scales = candidate, tried
        if scales == before:
            break
    return best[1]
