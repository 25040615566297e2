"""Level, tones and lattice of foten-plus: everything that is fitted before the network, in the order in which it is fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from foten.dsp import Array
from foten.dsp.lattice import analyse, polynomial
from foten.dsp.speed_force_table import SpeedForceTable
from foten.dsp.tones import tone
from foten.models.excitation import Scale as LevelOf
from foten.models.foten_plus.definition import Lattice, Tones
from foten.models.foten_plus.lattice_fit import FittedReflections, LatticeData, fit_lattice
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.foten_plus.tones_fit import fit_tones, wavelength
from foten.training.blocks import ScaledBlocks
from foten.training.config import TrainConfig
from foten.training.excitation_fit import fit_scale
from foten.training.scale import Scale
from foten.training.texture_builder import Tensors, tensors_of
from foten.training.window_fit import TrainingWindows

DRAWN_BACK_S = 0.5  # in which a rendering forgets the phase that it started with
_AT_ONCE = 8_000_000  # reflection coefficients held in memory


@dataclass(frozen=True)
class LinearPart:
    """All of foten-plus but its network and excitation."""

    sizes: FotenPlusSizes  # of lattices and tones; the network is not in the loop
    tensors: Tensors  # theirs, by the names in a texture file
    # Of the fundamental at every sample [rad], (n_blocks, block); None where the surface does not repeat.
    phase: Array | None
    tried: dict[str, Any]  # on the way

    @property
    def _excited(self) -> tuple[str, bool]:
        if self.phase is None:
            return "lattice.", self.sizes.gain_before_filter
        return "residual.", self.sizes.residual_gain_before_filter

    @property
    def excited_lattice(self) -> Lattice:
        """Return the lattice that a rendering excites."""
        return Lattice(self.tensors, *self._excited)

    def innovations(self, blocks: ScaledBlocks, residual: bool = False) -> tuple[Array, Array, Array]:
        """Return x, the innovations, and what a unit of them is worth in scaled acceleration, (n_blocks, block) each.

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
        x, e, unit = (np.pad(np.concatenate(part), ((0, 0), (1, 0))) for part in zip(*parts, strict=True))
        return x, e, unit

    def power(self, condition: Array) -> tuple[Array, Array]:
        """Return the mean squares of what a unit of σ adds and of the tones, under conditions (k, 2) scaled: (k,) each."""
        unit = np.square(self.excited_lattice.level(condition))
        if self.phase is None:
            return unit, np.zeros_like(unit)
        level = LevelOf(self.tensors, "lattice.level.")
        path = level.physical(condition)[:, :1]
        coefficients = Tones(self.tensors, level).coefficients(np.concatenate([condition, path], axis=1))
        return unit, 0.5 * np.square(coefficients).sum(axis=1)

    def response(self, n: int) -> Array | None:
        """Return squares of the first n samples of the impulse response, that of the mean reflection coefficients.

        None with the gain after the filter, where a change of level shows at once.
        """
        prefix, before = self._excited
        if not before:
            return None
        k = self.tensors[f"{prefix}reflections"].mean(axis=0)
        return np.square(lfilter([1.0], polynomial(k), np.eye(1, n)[0]))


def fit_linear_parts(
    sizes: FotenPlusSizes,
    blocks: ScaledBlocks,
    config: TrainConfig,
    on_stage: Callable[[str], None] = lambda stage: None,
) -> list[LinearPart]:
    """Return foten-plus with all but its network and excitation; once more with tones where a wavelength stands out."""
    on_stage("fitting level and lattice")
    rate, acceleration = blocks.trace.rate_hz, blocks.flat[:, 0]
    fitted, data, tensors = _levelled_lattice("lattice.", acceleration, sizes, blocks, config)
    counts = _counts(fitted.table, "order", "n_speed", "n_force")
    sizes = replace(sizes, **counts, gain_before_filter=fitted.gain_before_filter, network_in_loop=False)
    plain = LinearPart(sizes, tensors, None, {"lattices": fitted.tried, "wavelength_mm": None})
    length = wavelength(data, rate) if config.tones else None
    if length is None:
        return [plain]
    on_stage(f"the surface seems to repeat every {length:.3g} mm: fitting its tones")
    tones = fit_tones(data, length, rate)
    # Of what the tones leave when the phase is known as well as it can be.
    residual = acceleration - (tones.played * data.unit).ravel()
    beside, _, own = _levelled_lattice("residual.", residual, sizes, blocks, config)
    counts = _counts(beside.table, "residual_order", "n_residual_speed", "n_residual_force")
    counts |= _counts(tones.table, "n_tones", "n_tone_speed", "n_tone_force")
    counts["n_tones"] //= 2  # of which each has two coefficients
    sizes = replace(sizes, **counts, residual_gain_before_filter=beside.gain_before_filter)
    motion = np.array([2 * np.pi / (tones.wavelength_mm * rate), tones.unevenness, 1 / (DRAWN_BACK_S * rate)])
    tensors = {**tensors, **_table_tensors("tones.", tones.table, "values"), "tones.motion": motion, **own}
    report = {
        "lattices": fitted.tried,
        "lattices_of_the_residual": beside.tried,
        "wavelength_mm": tones.wavelength_mm,
        "unevenness": tones.unevenness,
    }
    return [plain, LinearPart(sizes, tensors, tones.phase, report)]


def phase_alone(plain: LinearPart, tonal: LinearPart) -> LinearPart:
    """Return the part without tones with the phase of those: silent tones, for a network that is given where it is.

    Tones of one amplitude everywhere are none of a surface whose periods differ; where one begins and ends is known all the same.
    """
    residual = {
        f"residual.{name.removeprefix('lattice.')}": tensor
        for name, tensor in plain.tensors.items()
        if name.startswith("lattice.")
    }
    speed, force = (plain.tensors[f"lattice.{name}"][:1] for name in ("speed_knots", "force_knots"))
    silent = {"tones.speed_knots": speed, "tones.force_knots": force, "tones.values": np.zeros((1, 2), np.float32)}
    tensors = {**plain.tensors, **residual, **silent, "tones.motion": tonal.tensors["tones.motion"]}
    own = plain.sizes
    sizes = replace(
        own,
        n_tones=1,
        n_tone_speed=1,
        n_tone_force=1,
        residual_order=own.order,
        n_residual_speed=own.n_speed,
        n_residual_force=own.n_force,
        residual_gain_before_filter=own.gain_before_filter,
    )
    return LinearPart(sizes, tensors, tonal.phase, tonal.tried)


def _levelled_lattice(
    prefix: str, signal: Array, sizes: FotenPlusSizes, blocks: ScaledBlocks, config: TrainConfig
) -> tuple[FittedReflections, LatticeData, Tensors]:
    """Return the lattice of a signal, (n,), what it was fitted to, and its tensors with those of its level."""
    windows = TrainingWindows(blocks.flat, *blocks.targets(sizes.window), sizes.window)
    scale = Scale(sizes.excitation_width).requires_grad_(False)
    both = np.concatenate([windows.train, windows.validation])
    fit_scale(scale, windows, blocks.scaling, signal[both], config.seed)
    of_level, (speed, force, before) = tensors_of(scale, f"{prefix}level."), blocks.condition_before()
    level = LevelOf(of_level, f"{prefix}level.")(before)
    x, unit = (signal / level).reshape(speed.shape), level.reshape(speed.shape)
    data = LatticeData(x, unit, speed, force, blocks.split.train, blocks.split.validation)
    max_order = max(1, min(blocks.trace.block // 8, config.max_order))
    fitted = fit_lattice(data, max_order, config.table, config.gain_before_filter)
    return fitted, data, _table_tensors(prefix, fitted.table, "reflections") | of_level


def _counts(table: SpeedForceTable, *names: str) -> dict[str, Any]:
    """Return how many values a vertex has, and how many vertices there are over speed and over force."""
    counts = table.values.shape[1], len(table.speed_knots), len(table.force_knots)
    return dict(zip(names, counts, strict=True))


def _table_tensors(prefix: str, table: SpeedForceTable, values: str) -> Tensors:
    tensors = {"speed_knots": table.speed_knots, "force_knots": table.force_knots, values: table.values}
    return {f"{prefix}{name}": tensor.astype(np.float32) for name, tensor in tensors.items()}  # as networks are
