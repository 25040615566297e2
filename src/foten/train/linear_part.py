"""Level, tones and lattice of foten-plus: everything that is fitted before the network, in the order in which it is fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from foten.architecture import FotenPlusArchitecture
from foten.dsp.plane import Plane
from foten.models.foten_plus import FotenPlus, Scale
from foten.train.config import TrainConfig
from foten.train.excitation import fit_scale
from foten.train.fit import Data
from foten.train.lattice import FittedReflections, LatticeData, fit_lattice
from foten.train.prepared import Prepared
from foten.train.tones import FittedTones, fit_tones, played, wavelength

Array = NDArray[np.float64]

FORGETTING_S = 0.5  # in which a rendering forgets the phase it started with


@dataclass(frozen=True)
class LinearPart:
    """All of foten-plus but its network and excitation.

    Attributes:
        network: with level, lattice and tones in place.
        phase: of the fundamental at every sample, as well as the whole recording knows it [rad], shape (n_blocks, block);
            None where the surface does not repeat.
        found: what was tried on the way.
    """

    network: FotenPlus
    phase: Array | None
    found: dict[str, Any]


@dataclass(frozen=True)
class FittedLattice:
    """A level, and the reflections that go with it."""

    level: Scale
    reflections: FittedReflections


def fit_linear_parts(
    architecture: FotenPlusArchitecture,
    data: Data,
    prepared: Prepared,
    config: TrainConfig,
    on_stage: Callable[[str], None] = lambda stage: None,
) -> list[LinearPart]:
    """Return foten-plus with all but its network and excitation; once more with tones where a wavelength stands out."""
    on_stage("fitting level and lattice")
    trace, split = prepared.trace, prepared.split
    max_order = max(1, min(trace.block // 8, config.max_order))
    acceleration = data.samples[:, 0]

    def levelled(signal: Array) -> tuple[Scale, LatticeData]:
        """Return the level of a signal, shape (n,), and what a lattice of it is fitted to."""
        level = Scale(architecture.excitation_width).requires_grad_(False)
        both = np.concatenate([data.train, data.validation])
        fit_scale(level, data, prepared.scaling, signal[both], config.seed)
        scale = scale_at(level, data.samples)
        speed, force = (np.concatenate([channel[:1], channel[:-1]]) for channel in (trace.speed, trace.force))
        x, unit, speed, force = (
            values.reshape(trace.n_blocks, trace.block) for values in (signal / scale, scale, speed, force)
        )
        return level, LatticeData(x, unit, speed, force, split.train, split.validation)

    level, given = levelled(acceleration)
    reflections, tried = fit_lattice(given, max_order, config.table, config.driven)
    lattice = FittedLattice(level, reflections)
    found: dict[str, Any] = {"lattices": tried, "wavelength_mm": None}
    plain = LinearPart(assembled(architecture, lattice), None, found)
    length = wavelength(given, trace.rate_hz) if config.tones else None
    if length is None:
        return [plain]
    on_stage(f"the surface seems to repeat every {length:.3g} mm: fitting its tones")
    fitted = fit_tones(given, length, trace.rate_hz)
    # Of what the tones leave when the phase is known as well as it can be.
    rest_level, rest = levelled(
        acceleration - (played(given, fitted.table, fitted.phase) * given.unit).ravel()
    )
    reflections, tried_for_rest = fit_lattice(rest, max_order, config.table, config.driven)
    with_tones = {
        "lattices": tried,
        "lattices_of_the_rest": tried_for_rest,
        "wavelength_mm": fitted.wavelength_mm,
        "unevenness": fitted.unevenness,
    }
    rendered = FittedLattice(rest_level, reflections)
    network = assembled(architecture, lattice, fitted, rendered, trace.rate_hz)
    return [plain, LinearPart(network, fitted.phase, with_tones)]


def assembled(
    architecture: FotenPlusArchitecture,
    lattice: FittedLattice,
    tones: FittedTones | None = None,
    rest: FittedLattice | None = None,
    rate_hz: float = 0.0,
) -> FotenPlus:
    """Return a network with a fitted lattice, or tones and two of them, its own weights drawn from PyTorch's current seed."""
    order, n_speed, n_force = _sizes(lattice)
    # An untrained network adds nothing; a closed loop that heard it nevertheless was two thirds of the time before training.
    architecture = replace(
        architecture,
        order=order,
        n_speed=n_speed,
        n_force=n_force,
        level_drives=lattice.reflections.level_drives,
        network_heard=False,
    )
    if tones is not None and rest is not None:
        rest_order, n_rest_speed, n_rest_force = _sizes(rest)
        architecture = replace(
            architecture,
            n_tones=tones.table.values.shape[1] // 2,
            n_tone_speed=len(tones.table.speed_knots),
            n_tone_force=len(tones.table.force_knots),
            rest_order=rest_order,
            n_rest_speed=n_rest_speed,
            n_rest_force=n_rest_force,
            rest_level_drives=rest.reflections.level_drives,
        )
    network = FotenPlus(architecture)
    _put(network.lattice, lattice.reflections.plane, "reflections")
    network.lattice.level.load_state_dict(lattice.level.state_dict())
    if tones is not None and rest is not None:
        _put(network.tones, tones.table, "values")
        turn = 2 * np.pi / (tones.wavelength_mm * rate_hz)
        motion = np.array([turn, tones.unevenness, 1 / (FORGETTING_S * rate_hz)])
        network.tones.motion.copy_(torch.from_numpy(motion))
        _put(network.rest, rest.reflections.plane, "reflections")
        network.rest.level.load_state_dict(rest.level.state_dict())
    return network


def _sizes(lattice: FittedLattice) -> tuple[int, int, int]:
    """Return order and vertices over speed and force."""
    plane = lattice.reflections.plane
    return plane.values.shape[1], len(plane.speed_knots), len(plane.force_knots)


def _put(module: nn.Module, plane: Plane, values: str) -> None:
    for name, array in (
        ("speed_knots", plane.speed_knots),
        ("force_knots", plane.force_knots),
        (values, plane.values),
    ):
        module.get_buffer(name).copy_(torch.from_numpy(array.copy()))


def scale_at(scale: Scale, samples: Array) -> Array:
    """Return the scale of each sample, shape (n,), from the speed and force of the one before: samples (n, 3) scaled."""
    condition = np.concatenate([samples[:1, 1:], samples[:-1, 1:]])
    with torch.no_grad():
        return scale(torch.from_numpy(condition).to(scale.out.weight)).cpu().double().numpy()
