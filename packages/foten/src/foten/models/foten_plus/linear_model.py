"""Level and lattice of foten-plus, fitted in closed form: section by section, shrunk by their own evidence."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from ctypes import byref
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from foten.dsp import Array
from foten.dsp.lattice import LEAK, MAX_REFLECTION, polynomial
from foten.dsp.shrinkage import wiener_gain
from foten.dsp.speed_force_table import SpeedForceTable, spanning
from foten.dsp.tones import tone
from foten.models.excitation import Scale
from foten.models.foten_plus.config import FotenPlusConfig
from foten.models.foten_plus.definition import Lattice, Tones, lattice_tensors
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.runtime.proof import Tensors
from foten.training.calibration import fit_scale
from foten.training.job import ScaledBlocks
from foten.training.training_kernel import Deviations, LatticeBlocks, pointer, run_in_c, structure_of

ORDERS = (10, 20, 40, 80, 160, 240)  # tried, as far as a block allows
# Longer orders are tried of the best kinds alone, and where the last step up to SHORT_ORDER lowers the error by MIN_FALL: by
# 1.1 % or more where 240 was best, by 0.6 % elsewhere (simulated textures).
SHORT_ORDER, MIN_FALL = 80, 0.008
MIN_SAMPLES_PER_SECTION = 8  # the longest order that is tried is a block divided by this
N_SPEED, N_FORCE = 12, 3  # knots
CORRELATION_LENGTH = 0.5  # length of the prior's correlation, as a share of the range of speed and of log force
SCALES = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0)  # prior standard deviations of a reflection, tried over speed and force
N_FOLDS = 8  # of the cross-validation over training and validation blocks, at most one for each block
N_FOLDS_OF_MANY, MANY_BLOCKS = 4, 16  # folds where there are more blocks than that
LEVEL_SAMPLES = 241  # samples that a level is averaged over for the gain before the filter
NEAR = 0.015  # share by which the error of a kind may be larger for it to be tried in the closed loop
MIN_GAIN = 1e-3  # share by which a longer order, the gain before the filter or a table must lower the error
# Least share of the amplitude that a knot leaves to the innovation. A knot of ribbed plastic, where next to nothing was recorded,
# left 1e-13, by which innovations are divided; of 130 other simulated recordings none comes near.
MIN_INNOVATION = 1e-6
_SCALES = np.array(SCALES)


@dataclass(frozen=True)
class LatticeData:
    """Arrays (n_blocks, block), to whose training blocks a lattice is fitted."""

    x: Array  # what the lattice is of: acceleration over its level, or acceleration
    gain: Array  # what an x of 1 is in the acceleration that is scored
    speed: Array  # that each prediction may know: of the sample before [mm/s]
    force: Array  # and [N]
    train: tuple[int, ...]  # numbers of blocks
    validation: tuple[int, ...]
    weight: Array | None = None  # of each sample's squared errors; None for all alike

    def with_gain_before_filter(self) -> LatticeData:
        """The same for a lattice of the acceleration itself.

        Errors are weighted by 1/level², the level² averaged over `LEVEL_SAMPLES`: weights that change within the memory bias
        Burg's method towards longer ringing.
        """
        weight = 1 / uniform_filter1d(np.square(self.gain), LEVEL_SAMPLES, axis=1)
        return replace(self, x=self.x * self.gain, gain=np.ones_like(self.gain), weight=weight)


@dataclass(frozen=True)
class FittedReflections:
    """Table of reflection coefficients, where the gain enters, and the errors of all that was tried."""

    table: SpeedForceTable
    gain_before_filter: bool
    tried: list[dict[str, float]]


def select_lattices(
    data: LatticeData, max_order: int, table: bool = True, both_gains: bool = True
) -> list[FittedReflections]:
    """Lattices of the training blocks: the kind of the least absolute one-step error, then those that are within `NEAR` of it.

    Tried are the `ORDERS` up to `max_order`, with one set of reflections and, where `table`, with a table of them, the gain
    after the filter and, where `both_gains`, before it. Training and validation blocks are cross-validated.

    Differs from the paper: it has no linear part.
    """
    orders = [order for order in ORDERS if order <= max_order] or [max_order]
    sizes, gains = ((1, 1), (N_SPEED, N_FORCE))[: 1 + table], (False, True)[: 1 + both_gains]
    of_gain = {gain: data.with_gain_before_filter() if gain else data for gain in gains}
    folds = {gain: _folds(of_gain[gain]) for gain in gains}
    weights = [len(fold.validation) for fold in folds[gains[0]]]
    kinds = list(product(sizes, gains))

    def errors_of(among: list[tuple[tuple[int, int], bool]], longest: int) -> list[list[float]]:
        shorter = [order for order in orders if order <= longest]

        def of_fold(number: int) -> list[list[float]]:
            fold = {gain: of_gain[number] for gain, of_gain in folds.items()}
            shares = {gain: reflection_gains(fold[gain], longest) for gain in {gain for _, gain in among}}
            return [
                validation_errors(fit_reflections(fold[gain], longest, *knots, shares[gain]), fold[gain], shorter)
                for knots, gain in among
            ]

        with ThreadPoolExecutor() as pool:  # NumPy's loops and those in C release the interpreter's lock
            each = np.array(list(pool.map(of_fold, range(len(weights)))))
        return np.average(each, axis=0, weights=weights).tolist()

    errors = dict(zip(kinds, errors_of(kinds, min(SHORT_ORDER, orders[-1])), strict=True))
    if orders[-1] > SHORT_ORDER:
        lowest_errors = min(errors.values(), key=lambda of_kind: of_kind[-1])
        if lowest_errors[-1] < lowest_errors[-2] * (1 - MIN_FALL):
            near = [kind for kind in kinds if errors[kind][-1] <= lowest_errors[-1] * (1 + MIN_GAIN)]
            errors |= zip(near, errors_of(near, orders[-1]), strict=True)
    tried: list[dict[str, float]] = []
    best: dict[tuple[tuple[int, int], bool], tuple[float, int]] = {}  # of each kind: its error and its order
    for (knots, gain), of_kind in errors.items():
        n_knots = len(spanning(data.speed, data.force, *knots).values)
        for order, error in zip(orders, of_kind, strict=False):
            tried.append({"order": order, "vertices": n_knots, "gain_before_filter": gain, "mae_scaled": error})
            if error < best.get((knots, gain), (np.inf, 0))[0] * (1 - MIN_GAIN):
                best[knots, gain] = error, order
    chosen = kinds[0]
    for kind, (error, _) in best.items():
        if error < best[chosen][0] * (1 - MIN_GAIN):
            chosen = kind
    near = [kind for kind, (error, _) in best.items() if error <= best[chosen][0] * (1 + NEAR)]
    return [
        FittedReflections(fit_reflections(of_gain[gain], best[knots, gain][1], *knots), gain, tried)
        for knots, gain in sorted(near, key=lambda kind: (kind != chosen, best[kind][0]))
    ]


def _folds(data: LatticeData) -> list[LatticeData]:
    known = sorted((*data.train, *data.validation))
    n = min(N_FOLDS if len(known) <= MANY_BLOCKS else N_FOLDS_OF_MANY, len(known))
    parts = [tuple(known[first::n]) for first in range(n)]
    return [replace(data, train=tuple(b for b in known if b not in part), validation=part) for part in parts]


def validation_errors(reflections: SpeedForceTable, data: LatticeData, orders: Sequence[int]) -> list[float]:
    """Mean absolute one-step errors [scaled] by order, on the validation blocks without their first `orders[-1]` samples."""
    scored = slice(min(orders[-1], data.x.shape[1] // 2), None)
    sections = Sections(data, data.validation, reflections)
    error = np.zeros(len(orders))
    for i in range(orders[-1]):
        sections.rotate_back(reflections.values[:, i])
        if i + 1 in orders:
            error[orders.index(i + 1)] = np.abs(sections.forward * sections.gain)[:, scored].mean()
    return error.tolist()


def fit_reflections(
    data: LatticeData, order: int, n_speed: int, n_force: int, shares: Array | None = None
) -> SpeedForceTable:
    """Reflections of the least forward and backward errors of each section, over the training blocks.

    Section i minimises Σ w ((f_{i−1} + k b)² + (b + k f_{i−1})²) over k at the knots: Burg's method. Differences of knots
    have a Gaussian prior in three parts, over speed, over force and over both, exponentially correlated, whose standard
    deviations maximise the evidence. `shares` are those of `reflection_gains`, where they are known.

    Source: Burg's criterion; the time-varying extension after Grenier, IEEE Trans. ASSP 31 (1983); the prior is ours.
    """
    chosen = list(data.train)
    table = spanning(data.speed[chosen], data.force[chosen], n_speed, n_force)
    parts = _covariances(len(table.speed_knots), len(table.force_knots))
    shares = reflection_gains(data, order) if shares is None else shares
    sections = Sections(data, chosen, table)
    reflections = np.zeros((len(table.values), order))
    left = np.ones(len(table.values))  # to the innovation
    for i in range(order):
        gram, correlation = sections.vertex_sums(i + 1)  # before that a section still fills
        moment = -correlation
        everywhere = shares[i] * moment.sum() / gram.sum()
        # In units of a section's own error: a reflection is known to within √((1 − k²)/n).
        noise = max(1e-4, 1 - everywhere**2) * gram.sum() / sections.forward[:, i + 1 :].size
        k = everywhere + posterior_deviations(gram / noise, (moment - gram.sum(axis=1) * everywhere) / noise, parts)
        largest = np.sqrt(np.maximum(0.0, 1 - np.square(MIN_INNOVATION / left))).clip(max=MAX_REFLECTION)
        reflections[:, i] = np.clip(k, -largest, largest)
        left *= np.sqrt(1 - np.square(reflections[:, i]))
        sections.rotate_back(reflections[:, i])
    return replace(table, values=reflections)


class Sections:
    """Blocks of a signal on their way through a lattice over a table, section by section: `dsp.lattice.rotate_back` in C."""

    def __init__(self, data: LatticeData, blocks: Sequence[int], table: SpeedForceTable) -> None:
        chosen = list(blocks)
        self.forward = np.array(data.x[chosen], dtype=np.float64)  # f, (n_blocks, block)
        self.gain = np.array(data.gain[chosen], dtype=np.float64)  # times the cosines of the sections so far
        places = table.place(data.speed[chosen].ravel(), data.force[chosen].ravel())
        vertex, faster, firmer = (np.ascontiguousarray(part) for part in places)
        self._blocks = structure_of(
            LatticeBlocks,
            **dict(zip(("n_blocks", "n"), self.forward.shape, strict=True)),
            **dict(zip(("to_faster", "to_firmer"), table.steps, strict=True)),
            **{"n_vertices": len(table.values), "leak": LEAK, "vertex": vertex, "faster": faster, "firmer": firmer},
            error_weight=np.ones_like(self.forward) if data.weight is None else data.weight[chosen],
            **{"forward": self.forward, "backward": self.forward.copy(), "gain": self.gain},
        )

    def block_sums(self, first: int) -> tuple[Array, Array]:
        """Sums of w (f² + b²) / 2 and of w f b of each block's next section from a sample on, b delayed: (n_blocks,) each."""
        power, correlation = np.empty((2, len(self.forward)))
        run_in_c("foten_train_block_sums", byref(self._blocks), first, pointer(power), pointer(correlation))
        return power, correlation

    def vertex_sums(self, first: int) -> tuple[Array, Array]:
        """The same of all blocks by pairs of the table's vertices (k, k), and by vertex (k,)."""
        k = self._blocks.n_vertices
        if k == 1:
            power, correlation = (part.sum(keepdims=True) for part in self.block_sums(first))
            return power[None], correlation
        power, correlation = np.zeros((k, k)), np.zeros(k)
        run_in_c("foten_train_vertex_sums", byref(self._blocks), first, pointer(power), pointer(correlation))
        return power, correlation

    def rotate_back(self, reflections: Array) -> None:
        """Run the next section from output to innovation, by its reflections at the vertices (k,)."""
        of_vertices = np.ascontiguousarray(reflections, dtype=np.float64)  # held until the call returns
        run_in_c("foten_train_section", byref(self._blocks), pointer(of_vertices))


def reflection_gains(data: LatticeData, order: int) -> Array:
    """Factor of each section's common reflection by its variance between blocks, (order,).

    Unshrunk, far sections draw ripples into the spectrum of a free run.
    """
    common, spread = np.zeros(order), np.zeros(order)
    sections = Sections(data, data.train, SpeedForceTable(np.zeros(1), np.zeros(1), np.zeros((1, 0))))
    n_blocks = len(data.train)
    for i in range(order):
        power, correlation = sections.block_sums(i + 1)
        moment = -correlation
        k = moment.sum() / power.sum()
        share_of = power / power.sum()
        each = moment / np.maximum(power, 1e-300)
        common[i] = np.clip(k, -MAX_REFLECTION, MAX_REFLECTION)
        spread[i] = (share_of**2 * (each - k) ** 2).sum() * n_blocks / max(1, n_blocks - 1)
        sections.rotate_back(common[i : i + 1])
    return wiener_gain(common, spread)


def _covariances(n_speed: int, n_force: int) -> Array:
    """Prior covariances, of unit variance, of what k knots differ by: over speed, force and both, (3, k, k); none of one."""
    if n_speed * n_force == 1:
        return np.zeros((0, 1, 1))
    at = (np.arange(n) / max(1, n - 1) for n in (n_speed, n_force))
    speed, force = (np.exp(-np.abs(np.subtract.outer(x, x)) / CORRELATION_LENGTH) for x in at)
    return np.stack([np.kron(speed, np.ones_like(force)), np.kron(np.ones_like(speed), force), np.kron(speed, force)])


def posterior_deviations(information: Array, score: Array, parts: Array) -> Array:
    """Posterior mean of deviations with likelihood exp(score·d − d·information·d/2), prior scales by evidence."""
    mean = np.zeros_like(score)
    if len(parts):
        counts = {"n": len(score), "n_parts": len(parts), "n_scales": len(SCALES)}
        given = {"parts": parts, "information": information, "score": score}
        run_in_c(
            "foten_train_deviations", byref(structure_of(Deviations, scales=_SCALES, **counts, **given, mean=mean))
        )
    return mean


@dataclass(frozen=True)
class LinearModel:
    """All of foten-plus but its network and excitation."""

    sizes: FotenPlusSizes  # of lattices and tones
    tensors: Tensors  # theirs, by the names in a texture file
    # Of the fundamental at every sample [rad], (n_blocks, block); None where the surface does not repeat.
    phase: Array | None = None
    report: dict[str, Any] = field(default_factory=dict)  # what was tried on the way

    @property
    def n_transient(self) -> int:
        """Samples of a block before the first whose innovation is known well."""
        return self.sizes.history - self.sizes.window

    @property
    def _excited(self) -> tuple[str, bool]:
        if self.phase is None:
            return "lattice.", self.sizes.gain_before_filter
        return "residual.", self.sizes.residual_gain_before_filter

    @property
    def excited_lattice(self) -> Lattice:
        """The lattice that a rendering excites."""
        return Lattice(self.tensors, *self._excited)

    @property
    def level(self) -> Scale:
        """The level of the vibration."""
        return Scale.of(self.tensors, "lattice.level.")

    def innovations(
        self, blocks: ScaledBlocks, residual: bool = False, run: NDArray[np.int64] | None = None
    ) -> tuple[Array, Array, Array]:
        """x, the innovations, and what an innovation of 1 is in scaled acceleration, (n_blocks, block) each.

        Each sample's level and reflection coefficients are those of the condition before it (Eq. 1), and a block's first sample
        gives zeros. A `residual` is what the tones leave of the acceleration, where there are tones. The blocks of a `run`
        alone are taken as one, (1, n) each.
        """
        samples, before, phase = blocks.samples[..., 0], blocks.conditions_with_speed(), self.phase
        if run is not None:
            samples, before = samples[run].reshape(1, -1), before[run].reshape(1, -1, 3)
            phase = None if phase is None else phase[run].reshape(1, -1)
        samples, before = samples[:, 1:], before[:, :-1]
        lattice = Lattice(self.tensors, "lattice.", self.sizes.gain_before_filter)
        if residual and phase is not None:
            tones = Tones(self.tensors, lattice.level)
            coefficients = tones.coefficients(before.reshape(-1, 3)).reshape(*samples.shape, -1)
            samples, lattice = samples - tone(coefficients, phase[:, 1:]), self.excited_lattice
        level = lattice.level(before[..., :2].reshape(-1, 2)).reshape(samples.shape)
        gain, after = lattice.gains(level)
        speed, force = np.moveaxis(lattice.level.physical(before[..., :2]), 2, 0)
        data = LatticeData(samples / after, np.ones_like(level), speed, force, (), ())
        sections = Sections(data, range(len(samples)), lattice.table)
        for i in range(lattice.order):
            sections.rotate_back(lattice.table.values[:, i])
        parts = samples / level, sections.forward / gain, sections.gain * level
        x, e, gain = (np.pad(part, ((0, 0), (1, 0))) for part in parts)
        return x, e, gain

    def power(self, condition: Array) -> tuple[Array, Array]:
        """Mean squares of what an innovation of 1 adds and of the tones, under conditions (k, 2) scaled: (k,) each."""
        innovation = np.square(self.excited_lattice.level(condition))
        if self.phase is None:
            return innovation, np.zeros_like(innovation)
        path = self.level.physical(condition)[:, :1]
        coefficients = Tones(self.tensors, self.level).coefficients(np.concatenate([condition, path], axis=1))
        return innovation, 0.5 * np.square(coefficients).sum(axis=1)

    def response(self, n: int) -> Array | None:
        """Squares of the impulse response (n,) of the mean reflections; None with the gain after the filter."""
        prefix, before = self._excited
        if not before:
            return None
        k = self.tensors[f"{prefix}reflections"].mean(axis=0)
        return np.square(lfilter([1.0], polynomial(k), np.eye(1, n)[0]))


def fit_level(
    signal: Array, sizes: FotenPlusSizes, blocks: ScaledBlocks, config: FotenPlusConfig
) -> tuple[Scale, LatticeData]:
    """The level of a signal (n,) over speed and force, by likelihood, and the signal over it."""
    train, validation = blocks.targets(sizes.window)
    both = np.concatenate([train, validation])
    condition = blocks.flat[both - 1, 1:]
    level = fit_scale(sizes.excitation_width, condition, signal[both], len(train), blocks.scaling, config.seed)
    speed, force, before = blocks.condition_before()
    gain = level(before)
    x, gain = (signal / gain).reshape(speed.shape), gain.reshape(speed.shape)
    return level, LatticeData(x, gain, speed, force, blocks.split.train, blocks.split.validation)


def fit_linear_models(
    level: Scale, data: LatticeData, sizes: FotenPlusSizes, config: FotenPlusConfig
) -> list[LinearModel]:
    """Level and lattices of the vibration: that of the least one-step error, then those that are near it."""
    models = []
    for fitted in selected_lattices(data, config):
        counts = counts_of(fitted.table, "order", "n_speed", "n_force")
        of_this = replace(sizes, **counts, gain_before_filter=fitted.gain_before_filter)
        tensors = lattice_tensors("lattice.", level, fitted.table)
        models.append(LinearModel(of_this, tensors, report={"lattices": fitted.tried, "wavelength_mm": None}))
    return models


def selected_lattices(data: LatticeData, config: FotenPlusConfig) -> list[FittedReflections]:
    """Lattices of levelled data, of the kinds that a configuration allows: `select_lattices`."""
    max_order = max(1, min(data.x.shape[1] // MIN_SAMPLES_PER_SECTION, config.max_order))
    return select_lattices(data, max_order, config.table, config.gain_before_filter)


def counts_of(table: SpeedForceTable, *names: str) -> dict[str, Any]:
    """Numbers of values at a knot, and of knots over speed and over force, by the names of sizes."""
    counts = table.values.shape[1], len(table.speed_knots), len(table.force_knots)
    return dict(zip(names, counts, strict=True))
