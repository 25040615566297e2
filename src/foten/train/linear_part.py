"""Level, tones and lattice of foten-plus: everything that is fitted before the network, in the order in which it is fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from foten.architecture import FotenPlusArchitecture
from foten.dsp.plane import Plane
from foten.models.foten_plus import FotenPlus, Scale
from foten.recording.scaling import Scaling
from foten.recording.split import Split
from foten.recording.trace import Trace
from foten.render.engine import NumpyFotenPlus
from foten.train.config import TrainConfig
from foten.train.excitation import fit_scale
from foten.train.fit import Data
from foten.train.lattice import LatticeData, fit_lattice, fit_lattice_of
from foten.train.tones import fit_tones, played, wavelength

Array = NDArray[np.float64]

JITTERS = (3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1)  # rad²/mm, tried
FORGETTING_S = 0.5  # in which a rendering forgets the phase it started with
TONES_MUST_GAIN = 0.01  # of the validation error, to be kept


@dataclass(frozen=True)
class Tones:
    """The tones of a surface that repeats.

    Attributes:
        wavelength_mm: that it repeats after.
        table: coefficients over speed and force, scaled.
        jitter: by how much the phase's variance grows on the way [rad²/mm].
    """

    wavelength_mm: float
    table: Plane
    jitter: float


def fit_linear_part(
    architecture: FotenPlusArchitecture,
    data: Data,
    trace: Trace,
    split: Split,
    scaling: Scaling,
    config: TrainConfig,
    on_stage: Callable[[str], None] = lambda stage: None,
) -> tuple[FotenPlus, dict[str, Any]]:
    """Return foten-plus with all but its network and excitation, and what was tried on the way.

    Tones are tried where a wavelength stands out, and kept where they lower the validation error.
    """
    on_stage("fitting level and lattice")
    max_order = max(1, min(trace.block // 8, config.max_order))
    acceleration = data.samples[:, 0]

    def levelled(signal: Array) -> tuple[Scale, LatticeData]:
        """Return the level of a signal, shape (n,), and what a lattice of it is fitted to."""
        level = Scale(architecture.excitation_width).requires_grad_(False)
        both = np.concatenate([data.train, data.validation])
        fit_scale(level, data, scaling, signal[both], config.seed)
        scale = scale_at(level, data.samples)
        speed, force = (np.concatenate([channel[:1], channel[:-1]]) for channel in (trace.speed, trace.force))
        x, unit, speed, force = (
            values.reshape(trace.n_blocks, trace.block) for values in (signal / scale, scale, speed, force)
        )
        return level, LatticeData(x, unit, speed, force, split.train, split.validation)

    def error(network: FotenPlus) -> float:
        blocks = data.samples.reshape(trace.n_blocks, trace.block, 3)[list(split.validation)]
        first = max(network.architecture.history, trace.block // 4)
        expected = engine_of(network).follow(blocks, corrected=False).sample
        missed = np.abs(blocks[:, network.architecture.history :, 0] - expected)
        return float(missed[:, first - network.architecture.history :].mean())

    level, given = levelled(acceleration)
    reflections, tried = fit_lattice(given, max_order, config.table)
    plain = assembled(architecture, level, reflections, None, trace.rate_hz)
    found: dict[str, Any] = {"lattices": tried, "validation_mae_scaled": error(plain), "wavelength_mm": None}
    length = wavelength(given, trace.rate_hz) if config.tones else None
    if length is None:
        return plain, found
    on_stage(f"the surface seems to repeat every {length:.3g} mm: fitting its tones")
    table, phase = fit_tones(given, length, trace.rate_hz)
    rest = acceleration - played(given, table, phase)[0].ravel()
    level, without = levelled(rest)
    n_speed, n_force = len(reflections.speed_knots), len(reflections.force_knots)
    reflections = fit_lattice_of(without, reflections.values.shape[1], n_speed, n_force)
    jitters = []
    for jitter in JITTERS:
        tones = Tones(length, table, jitter)
        jitters.append((error(assembled(architecture, level, reflections, tones, trace.rate_hz)), tones))
    _, tones = min(jitters, key=lambda pair: pair[0])
    # Once more for what is left when the phase is known from the past alone.
    network = assembled(architecture, level, reflections, tones, trace.rate_hz)
    x, _, _ = engine_of(network).innovations(data.samples.reshape(trace.n_blocks, trace.block, 3))
    level, without = levelled(x.ravel() * scale_at(level, data.samples))
    reflections, tried = fit_lattice(without, max_order, config.table)
    network = assembled(architecture, level, reflections, tones, trace.rate_hz)
    found |= {
        "tones_validation_mae_scaled": error(network),
        "jitters": [
            {"jitter_rad2_per_mm": t.jitter, "validation_mae_scaled": missed} for missed, t in jitters
        ],
        "tones_tried_mm": length,
    }
    if found["tones_validation_mae_scaled"] > (1 - TONES_MUST_GAIN) * found["validation_mae_scaled"]:
        return plain, found
    return network, {**found, "wavelength_mm": length, "lattices": tried}


def assembled(
    architecture: FotenPlusArchitecture,
    level: Scale,
    reflections: Plane,
    tones: Tones | None,
    rate_hz: float,
) -> FotenPlus:
    """Return a network with a fitted level, lattice and tones, its own weights drawn from PyTorch's current seed."""
    sizes: dict[str, Any] = {
        "order": reflections.values.shape[1],
        "n_speed": len(reflections.speed_knots),
        "n_force": len(reflections.force_knots),
    }
    buffers = {
        "speed_knots": reflections.speed_knots,
        "force_knots": reflections.force_knots,
        "reflections": reflections.values,
    }
    if tones is not None:
        table = tones.table
        sizes |= {
            "n_tones": table.values.shape[1] // 2,
            "n_tone_speed": len(table.speed_knots),
            "n_tone_force": len(table.force_knots),
        }
        motion = (
            2 * np.pi / (tones.wavelength_mm * rate_hz),
            tones.jitter / rate_hz,
            1 / (FORGETTING_S * rate_hz),
        )
        buffers |= {
            "tone_speed_knots": table.speed_knots,
            "tone_force_knots": table.force_knots,
            "tones": table.values,
            "tone_motion": np.array(motion),
        }
    network = FotenPlus(replace(architecture, **sizes))
    network.level.load_state_dict(level.state_dict())
    for name, values in buffers.items():
        getattr(network, name).copy_(torch.from_numpy(values.copy()))
    return network


def engine_of(network: FotenPlus) -> NumpyFotenPlus:
    """Return what renders a network that is not in a file yet."""
    return NumpyFotenPlus(
        network.architecture, {name: t.cpu().numpy() for name, t in network.state_dict().items()}
    )


def scale_at(scale: Scale, samples: Array) -> Array:
    """Return the scale of each sample, shape (n,), from the speed and force of the one before: samples (n, 3) scaled."""
    condition = np.concatenate([samples[:1, 1:], samples[:-1, 1:]])
    with torch.no_grad():
        return scale(torch.from_numpy(condition).to(scale.out.weight)).cpu().double().numpy()
