"""Strokes to render: from a table, from constants, or from a trace."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.kinematics import at_rate, velocity
from foten.recording.inspection.one_channel import unit_doubt
from foten.recording.preprocess import condition, velocity_and_force
from foten.recording.recording import LIMITS, UNITS, Recording
from foten.runtime.stylus import PressureCalibration

MAX_STROKE_S = 3600.0
LONG_S, SLOW_STEP_S = 60.0, 0.5  # a stroke as long as that, in steps as long as that, may have its times in ms


@dataclass(frozen=True)
class Stroke:
    """Velocity and force at a rate, not yet low-passed."""

    velocity: Array  # of each axis [mm/s], shape (n_axes, n); one axis where only the speed is known
    force: Array  # [N], shape (n,)
    rate_hz: float
    gap_s: float = 0.0  # longest hole of ten times the usual step that was interpolated; else 0
    n_lifted: int = 0  # holes and jumps between positions taken as lifting the pen
    doubts: tuple[str, ...] = ()  # sentences on units that were perhaps not meant

    def conditioned(self, lowpass_hz: float) -> tuple[Array, Array]:
        """Speed [mm/s] and force [N] through the causal low-pass of rendering, shapes (n,)."""
        return condition(self.velocity, self.force, self.rate_hz, lowpass_hz)


def constant_stroke(speed: float, force: float, seconds: float, rate_hz: float) -> Stroke:
    """Stroke at one speed [mm/s] and force [N]; ValueError for what is negative, not finite or shorter than a sample."""
    for name, value in (("speed", speed), ("force", force), ("seconds", seconds)):
        if not (math.isfinite(value) and value >= 0):
            raise ValueError(f"{name} is {value}, expected a finite number, 0 or more")
    if seconds > MAX_STROKE_S:
        raise ValueError(f"seconds is {seconds:g}, expected at most {MAX_STROKE_S:g}, an hour")
    n = round(seconds * rate_hz)
    if n < 1:
        raise ValueError(f"{seconds:g} s are less than one sample at {rate_hz:g} Hz")
    doubts = (*doubts_of("speed", speed), *doubts_of("force", force))
    return Stroke(np.full((1, n), float(speed)), np.full(n, float(force)), rate_hz, doubts=doubts)


def recorded_stroke(recording: Recording, rate_hz: float) -> Stroke:
    """Stroke of a recording at a model's rate; it needs no acceleration."""
    velocities, force = velocity_and_force(recording, rate_hz)
    return Stroke(velocities, np.maximum(force, 0.0), rate_hz)


def tabled_stroke(
    columns: Mapping[str, Array], rate_hz: float, calibration: PressureCalibration | None = None
) -> Stroke:
    """Stroke in columns at a model's rate, interpolated linearly.

    Of positions, the pen is lifted, without force and movement, in holes of ten times the usual step, since tablets do not
    report a pen in the air, and where it jumps faster than 5 m/s from or to a row without force.

    Args:
        columns: `time` [s], which increases, `speed` [mm/s] or `position_x` and `position_y` [mm], and `force` [N] or
            `pressure` [0 … 1]; two finite numbers or more each, shape (n,).
        calibration: of the pressure; the paper's tablet's by default, and refused beside a force.

    Raises:
        ValueError: it lasts too long or too short, or a value is impossible.
    """
    times = columns["time"] - columns["time"][0]
    lasts = f"the stroke lasts {times[-1]:g} s"
    force = _force_in(columns, calibration)
    if force.min() < 0 or ("speed" in columns and columns["speed"].min() < 0):
        raise ValueError("speed and force of a stroke are magnitudes, found one below zero")
    if times[-1] > MAX_STROKE_S:
        raise ValueError(f"{lasts} in {times.size} rows, expected at most an hour; is t in ms?")
    doubts = [doubt for name in ("speed", "force") if name in columns for doubt in doubts_of(name, columns[name].max())]
    if times[-1] >= LONG_S and np.median(np.diff(times)) >= SLOW_STEP_S:
        doubts.append(f"{lasts} in {times.size} rows; is t in ms? It is taken as s")
    n_lifted = 0
    if "speed" not in columns:
        positions = np.stack([columns["position_x"], columns["position_y"]])
        doubts += doubts_of("position", np.ptp(positions, axis=1).max())
        times, positions, force, n_lifted = _lifted(times, positions, force)
    n = round(times[-1] * rate_hz)
    if n < 1:
        raise ValueError(f"{lasts}, less than one sample at {rate_hz:g} Hz; is t in seconds?")
    if "speed" in columns:
        velocities = at_rate(columns["speed"], times, rate_hz, n)[None]
    else:
        velocities = velocity(np.stack([at_rate(axis, times, rate_hz, n) for axis in positions]), rate_hz)
    fastest = float(np.abs(velocities).max())
    if fastest > LIMITS["speed"]:
        raise ValueError(f"the stroke's speed reaches {fastest:g} mm/s; is it, or t, in another unit?")
    if force.max() > 100:
        raise ValueError(f"the stroke's force reaches {force.max():g} N; is it in mN or grams?")
    gap = 0.0 if n_lifted else float(np.diff(times)[_holes(times)].max(initial=0.0))
    return Stroke(velocities, at_rate(force, times, rate_hz, n), rate_hz, gap, n_lifted, tuple(doubts))


def _force_in(columns: Mapping[str, Array], calibration: PressureCalibration | None) -> Array:
    """Force [N] of the column of forces or of pressures."""
    if "force" in columns:
        if calibration is not None:
            raise ValueError("the stroke has forces, and a pressure's curve is given: leave one of them out")
        return columns["force"]
    pressure = columns["pressure"]
    if pressure.min() < 0 or pressure.max() > 1:
        raise ValueError(f"pressure runs from {pressure.min():g} to {pressure.max():g}, expected 0 to 1")
    return (calibration or PressureCalibration()).force(pressure)


def doubts_of(kind: str, largest: float) -> list[str]:
    """Sentences on the unit of the largest speed [mm/s], force [N] or movement [mm], where another one is likely."""
    doubt = unit_doubt(kind, largest) if largest > 0 else ""
    return [f"{kind} {doubt} It is taken as {UNITS.get(kind, 'mm')}"] if doubt else []


def _holes(times: Array) -> NDArray[np.int64]:
    steps = np.diff(times)
    return np.flatnonzero(steps > 10 * np.median(steps))


def _lifted(times: Array, positions: Array, force: Array) -> tuple[Array, Array, Array, int]:
    """Times, positions (2, n) and force with the pen lifted in holes and jumps, without their movement, and how many."""
    steps, moves, holes = np.diff(times), np.diff(positions, axis=1), _holes(times)
    airborne = np.minimum(force[:-1], force[1:]) <= 0
    jumps = np.flatnonzero(airborne & (np.hypot(*moves) > LIMITS["speed"] * steps))
    lifts = np.union1d(holes, jumps)
    in_air = np.zeros_like(positions)
    in_air[:, lifts + 1] = moves[:, lifts]
    positions = positions - np.cumsum(in_air, axis=1)
    # The pen leaves within a usual step after the last row before a hole, and lands within one before the next.
    step = float(np.median(steps))
    added = np.concatenate([times[holes] + step, times[holes + 1] - step])
    merged = np.concatenate([times, added])
    order = np.argsort(merged, kind="stable")
    rows = [np.concatenate([axis, np.interp(added, times, axis)])[order] for axis in positions]
    all_forces = np.concatenate([force, np.zeros_like(added)])[order]
    return merged[order], np.stack(rows), all_forces, int(lifts.size)
