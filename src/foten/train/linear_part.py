"""Level, tones and lattice of foten-plus: everything that is fitted before the network, in the order in which it is fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp.lattice import analyse, polynomial
from foten.dsp.speed_force_table import SpeedForceTable
from foten.dsp.tones import tone
from foten.families.foten_plus import FotenPlusSizes
from foten.networks.scale import Scale
from foten.reference.excitation import Scale as LevelOf
from foten.reference.foten_plus import Lattice, Tones
from foten.train.blocks import ScaledBlocks
from foten.train.config import TrainConfig
from foten.train.excitation import fit_scale
from foten.train.export import Tensors, tensors_of
from foten.train.fit import TrainingWindows
from foten.train.lattice import FittedReflections, LatticeData, fit_lattice
from foten.train.tones import FittedTones, fit_tones, played, wavelength

Array = NDArray[np.float64]

DRAWN_BACK_S = 0.5  # in which a rendering forgets the phase that it started with
_AT_ONCE = 8_000_000  # reflection coefficients held in memory


@dataclass(frozen=True)
class LinearPart:
    """All of foten-plus but its network and excitation.

    Attributes:
        sizes: of lattices and tones; the network is not in the loop.
        tensors: theirs, by the names in a texture file.
        phase: of the fundamental at every sample, as well as the recording determines it [rad], shape (n_blocks, block);
            None where the surface does not repeat.
        tried: on the way.
    """

    sizes: FotenPlusSizes
    tensors: Tensors
    phase: Array | None
    tried: dict[str, Any]

    @property
    def excited_lattice(self) -> Lattice:
        """Return the lattice that a rendering excites."""
        if self.phase is None:
            return Lattice(self.tensors, "lattice.", self.sizes.gain_before_filter)
        return Lattice(self.tensors, "residual.", self.sizes.residual_gain_before_filter)

    def innovations(self, blocks: ScaledBlocks, residual: bool = False) -> tuple[Array, Array, Array]:
        """Return x, the innovations, and what a unit of them is worth in scaled acceleration, (n_blocks, block) each.

        The first sample of each block gives zeros: nothing comes before it. A sample's level and reflection coefficients are
        those of the condition before it: a prediction knows no others (Eq. 1).

        Args:
            blocks: recorded.
            residual: of what the tones leave, where there are tones, and not of the acceleration.
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
            reflections = lattice.reflections(flat).T.reshape(*some.shape, -1)
            e, cosines, _ = analyse(some / after, reflections)
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
        plain = self.phase is None
        if not (self.sizes.gain_before_filter if plain else self.sizes.residual_gain_before_filter):
            return None
        from scipy.signal import lfilter

        k = self.tensors["lattice.reflections" if plain else "residual.reflections"].mean(axis=0)
        return np.square(lfilter([1.0], polynomial(k), np.eye(1, n)[0]))


@dataclass(frozen=True)
class _FittedLattice:
    """A level, and the reflection coefficients that go with it."""

    level: Scale
    fitted: FittedReflections

    def tensors(self, prefix: str) -> Tensors:
        table = _table_tensors(prefix, self.fitted.table, "reflections")
        return table | tensors_of(self.level, f"{prefix}level.")

    @property
    def counts(self) -> tuple[int, int, int]:
        """Return order and vertices over speed and force."""
        table = self.fitted.table
        return table.values.shape[1], len(table.speed_knots), len(table.force_knots)


def fit_linear_parts(
    sizes: FotenPlusSizes,
    windows: TrainingWindows,
    blocks: ScaledBlocks,
    config: TrainConfig,
    on_stage: Callable[[str], None] = lambda stage: None,
) -> list[LinearPart]:
    """Return foten-plus with all but its network and excitation; once more with tones where a wavelength stands out."""
    on_stage("fitting level and lattice")
    trace, split = blocks.trace, blocks.split
    max_order = max(1, min(trace.block // 8, config.max_order))
    speed, force = blocks.condition_before()
    acceleration = blocks.flat[:, 0]

    def levelled(signal: Array) -> tuple[Scale, LatticeData]:
        """Return the level of a signal, shape (n,), and what a lattice of it is fitted to."""
        level = Scale(sizes.excitation_width).requires_grad_(False)
        both = np.concatenate([windows.train, windows.validation])
        fit_scale(level, windows, blocks.scaling, signal[both], config.seed)
        scale = LevelOf(tensors_of(level), "")(blocks.scaled_condition_before())
        x, unit = ((values).reshape(speed.shape) for values in (signal / scale, scale))
        return level, LatticeData(x, unit, speed, force, split.train, split.validation)

    level, data = levelled(acceleration)
    fitted, tried = fit_lattice(data, max_order, config.table, config.gain_before_filter)
    lattice = _FittedLattice(level, fitted)
    order, n_speed, n_force = lattice.counts
    sizes = replace(
        sizes,
        order=order,
        n_speed=n_speed,
        n_force=n_force,
        gain_before_filter=fitted.gain_before_filter,
        network_in_loop=False,
    )
    report: dict[str, Any] = {"lattices": tried, "wavelength_mm": None}
    plain = LinearPart(sizes, lattice.tensors("lattice."), None, report)
    length = wavelength(data, trace.rate_hz) if config.tones else None
    if length is None:
        return [plain]
    on_stage(f"the surface seems to repeat every {length:.3g} mm: fitting its tones")
    tones = fit_tones(data, length, trace.rate_hz)
    # Of what the tones leave when the phase is known as well as it can be.
    without = acceleration - (played(data, tones.table, tones.phase) * data.unit).ravel()
    residual_level, residual_data = levelled(without)
    fitted, tried_for_residual = fit_lattice(residual_data, max_order, config.table, config.gain_before_filter)
    report = {
        "lattices": tried,
        "lattices_of_the_residual": tried_for_residual,
        "wavelength_mm": tones.wavelength_mm,
        "unevenness": tones.unevenness,
    }
    residual = _FittedLattice(residual_level, fitted)
    return [plain, _with_tones(plain, tones, residual, trace.rate_hz, report)]


def _with_tones(
    plain: LinearPart, tones: FittedTones, residual: _FittedLattice, rate_hz: float, report: dict[str, Any]
) -> LinearPart:
    order, n_speed, n_force = residual.counts
    sizes = replace(
        plain.sizes,
        n_tones=tones.table.values.shape[1] // 2,
        n_tone_speed=len(tones.table.speed_knots),
        n_tone_force=len(tones.table.force_knots),
        residual_order=order,
        n_residual_speed=n_speed,
        n_residual_force=n_force,
        residual_gain_before_filter=residual.fitted.gain_before_filter,
    )
    increment = 2 * np.pi / (tones.wavelength_mm * rate_hz)
    tensors = {
        **plain.tensors,
        **_table_tensors("tones.", tones.table, "values"),
        "tones.motion": np.array([increment, tones.unevenness, 1 / (DRAWN_BACK_S * rate_hz)]),
        **residual.tensors("residual."),
    }
    return LinearPart(sizes, tensors, tones.phase, report)


def _table_tensors(prefix: str, table: SpeedForceTable, values: str) -> Tensors:
    return {
        f"{prefix}speed_knots": table.speed_knots.copy(),
        f"{prefix}force_knots": table.force_knots.copy(),
        f"{prefix}{values}": table.values.copy(),
    }
