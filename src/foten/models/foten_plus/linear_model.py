"""Level, lattice and tones of foten-plus: all that is fitted before the network, in closed form."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from foten.dsp import Array
from foten.dsp.lattice import analyse, polynomial
from foten.dsp.speed_force_table import SpeedForceTable
from foten.dsp.tones import tone
from foten.models.excitation import Scale
from foten.models.foten_plus.definition import Lattice, Tones
from foten.models.foten_plus.lattice_fit import FittedReflections, LatticeData, fit_lattice
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.foten_plus.tones_fit import FittedTones, fit_tones, wavelength
from foten.training.blocks import ScaledBlocks
from foten.training.config import TrainConfig
from foten.training.scale_fit import fit_scale
from foten.training.texture_builder import Tensors

PHASE_LEAK_S = 0.5  # in which a rendering forgets the phase that it started with
MAX_ORDER_SHARE = 8  # of a block, as 1 in so many samples, is the longest lattice that is tried
_AT_ONCE = 8_000_000  # reflection coefficients held in memory


@dataclass(frozen=True)
class LinearModel:
    """All of foten-plus but its network and excitation."""

    sizes: FotenPlusSizes  # of lattices and tones; the network is not in the loop
    tensors: Tensors  # theirs, by the names in a texture file
    # Of the fundamental at every sample [rad], (n_blocks, block); None where the surface does not repeat.
    phase: Array | None = None
    report: dict[str, Any] = field(default_factory=dict)  # what was tried on the way

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

    def innovations(self, blocks: ScaledBlocks, residual: bool = False) -> tuple[Array, Array, Array]:
        """x, the innovations, and what an innovation of 1 is in scaled acceleration, (n_blocks, block) each.

        The first sample of each block gives zeros: nothing comes before it. A sample's level and reflection coefficients are
        those of the condition before it: a prediction knows no others (Eq. 1).
        A `residual` is what the tones leave of the acceleration, where there are tones.
        """
        samples, before = blocks.samples[:, 1:, 0], blocks.path_conditions()[:, :-1]
        lattice = Lattice(self.tensors, "lattice.", self.sizes.gain_before_filter)
        if residual and self.phase is not None:
            tones = Tones(self.tensors, lattice.level)
            coefficients = tones.coefficients(before.reshape(-1, 3)).reshape(*samples.shape, -1)
            samples, lattice = samples - tone(coefficients, self.phase[:, 1:]), self.excited_lattice
        n_at_once = max(1, _AT_ONCE // (samples.shape[1] * lattice.order))
        parts = []
        for i in range(0, len(samples), n_at_once):
            some, flat = samples[i : i + n_at_once], before[i : i + n_at_once, :, :2].reshape(-1, 2)
            level = lattice.level(flat).reshape(some.shape)
            gain, after = lattice.gains(level)
            e, cosines, _ = analyse(some / after, lattice.reflections(flat).T.reshape(*some.shape, -1))
            parts.append((some / level, e / gain, cosines * level))
        x, e, gain = (np.pad(np.concatenate(part), ((0, 0), (1, 0))) for part in zip(*parts, strict=True))
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
        """Squares of the first n samples of the impulse response, that of the mean reflection coefficients.

        None with the gain after the filter, where a change of level shows at once.
        """
        prefix, before = self._excited
        if not before:
            return None
        k = self.tensors[f"{prefix}reflections"].mean(axis=0)
        return np.square(lfilter([1.0], polynomial(k), np.eye(1, n)[0]))


@dataclass(frozen=True)
class Levelled:
    """A signal over its level, as a lattice is fitted to it."""

    level: Scale
    data: LatticeData


def fit_level(signal: Array, sizes: FotenPlusSizes, blocks: ScaledBlocks, config: TrainConfig) -> Levelled:
    """The level of a signal (n,) over speed and force, by likelihood."""
    train, validation = blocks.targets(sizes.window)
    both = np.concatenate([train, validation])
    condition = blocks.flat[both - 1, 1:]
    level = fit_scale(sizes.excitation_width, condition, signal[both], len(train), blocks.scaling, config.seed)
    speed, force, before = blocks.condition_before()
    gain = level(before)
    x, gain = (signal / gain).reshape(speed.shape), gain.reshape(speed.shape)
    return Levelled(level, LatticeData(x, gain, speed, force, blocks.split.train, blocks.split.validation))


def fit_linear_model(
    levelled: Levelled, sizes: FotenPlusSizes, blocks: ScaledBlocks, config: TrainConfig
) -> LinearModel:
    """Level and lattice of the vibration."""
    fitted = _fitted_lattice(levelled, blocks, config)
    counts = _counts(fitted.table, "order", "n_speed", "n_force")
    sizes = replace(sizes, **counts, gain_before_filter=fitted.gain_before_filter, network_in_loop=False)
    tensors = _lattice_tensors("lattice.", levelled.level, fitted)
    return LinearModel(sizes, tensors, report={"lattices": fitted.tried, "wavelength_mm": None})


def fit_tonal_model(
    linear: LinearModel, levelled: Levelled, blocks: ScaledBlocks, config: TrainConfig
) -> LinearModel | None:
    """The same with tones of the path, and a lattice of what they leave; None where no wavelength stands out."""
    rate = blocks.trace.rate_hz
    length = wavelength(levelled.data, rate) if config.tones else None
    if length is None:
        return None
    tones = fit_tones(levelled.data, length, rate)
    # Of what the tones leave when the phase is known as well as it can be.
    residual = blocks.flat[:, 0] - (tones.played * levelled.data.gain).ravel()
    beside = fit_level(residual, linear.sizes, blocks, config)
    fitted = _fitted_lattice(beside, blocks, config)
    counts = _counts(fitted.table, "residual_order", "n_residual_speed", "n_residual_force")
    counts |= _counts(tones.table, "n_tones", "n_tone_speed", "n_tone_force")
    counts["n_tones"] //= 2  # of which each has two coefficients
    sizes = replace(linear.sizes, **counts, residual_gain_before_filter=fitted.gain_before_filter)
    tensors = {**linear.tensors, **_tone_tensors(tones, rate), **_lattice_tensors("residual.", beside.level, fitted)}
    report = {
        "lattices": linear.report["lattices"],
        "lattices_of_the_residual": fitted.tried,
        "wavelength_mm": tones.wavelength_mm,
        "period_jitter": tones.period_jitter,
    }
    return LinearModel(sizes, tensors, tones.phase, report)


def silent_tones(linear: LinearModel, tonal: LinearModel) -> LinearModel:
    """The model without tones with the phase of those: silent tones, for a network that is given where it is.

    Tones of one amplitude everywhere are none of a surface whose periods differ; where one begins and ends is known all the same.
    """
    residual = {
        f"residual.{name.removeprefix('lattice.')}": tensor
        for name, tensor in linear.tensors.items()
        if name.startswith("lattice.")
    }
    speed, force = (linear.tensors[f"lattice.{name}"][:1] for name in ("speed_knots", "force_knots"))
    silent = {"tones.speed_knots": speed, "tones.force_knots": force, "tones.values": np.zeros((1, 2), np.float32)}
    phase = {"tones.phase_params": tonal.tensors["tones.phase_params"]}
    sizes = linear.sizes
    sizes = replace(
        sizes,
        n_tones=1,
        n_tone_speed=1,
        n_tone_force=1,
        residual_order=sizes.order,
        n_residual_speed=sizes.n_speed,
        n_residual_force=sizes.n_force,
        residual_gain_before_filter=sizes.gain_before_filter,
    )
    return LinearModel(sizes, {**linear.tensors, **residual, **silent, **phase}, tonal.phase, tonal.report)


def _fitted_lattice(levelled: Levelled, blocks: ScaledBlocks, config: TrainConfig) -> FittedReflections:
    max_order = max(1, min(blocks.trace.block // MAX_ORDER_SHARE, config.max_order))
    return fit_lattice(levelled.data, max_order, config.table, config.gain_before_filter)


def _counts(table: SpeedForceTable, *names: str) -> dict[str, Any]:
    """How many values a vertex has, and how many vertices there are over speed and over force."""
    counts = table.values.shape[1], len(table.speed_knots), len(table.force_knots)
    return dict(zip(names, counts, strict=True))


def _lattice_tensors(prefix: str, level: Scale, fitted: FittedReflections) -> Tensors:
    return {**_table_tensors(prefix, fitted.table, "reflections"), **level.tensors(f"{prefix}level.")}


def _tone_tensors(tones: FittedTones, rate_hz: float) -> Tensors:
    increment = 2 * np.pi / (tones.wavelength_mm * rate_hz)  # [rad] a sample at 1 mm/s
    phase = np.array([increment, tones.period_jitter, 1 / (PHASE_LEAK_S * rate_hz)])
    return {**_table_tensors("tones.", tones.table, "values"), "tones.phase_params": phase}


def _table_tensors(prefix: str, table: SpeedForceTable, values: str) -> Tensors:
    tensors = {"speed_knots": table.speed_knots, "force_knots": table.force_knots, values: table.values}
    return {f"{prefix}{name}": tensor.astype(np.float32) for name, tensor in tensors.items()}  # as networks are
