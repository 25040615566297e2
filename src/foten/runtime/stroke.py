"""Strokes to render: from a table, from constants, or from a trace."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.kinematics import at_rate, velocity
from foten.recording.preprocess import condition, hand_of
from foten.recording.recording import LIMITS, Recording
from foten.runtime.stylus import PressureCalibration

LONGEST_S = 3600.0
COLUMNS = "t (s), and speed (mm/s) or x, y (mm), and force (N) or pressure (0 to 1)"


@dataclass(frozen=True)
class Stroke:
    """A hand at a rate, as it was given: not yet low-passed."""

    moved: Array  # velocity of each axis [mm/s], shape (n_axes, n); one axis where only the speed is known
    force: Array  # [N], shape (n,)
    rate_hz: float
    gap_s: float = 0.0  # the longest hole between given samples that was bridged, of ten times the usual step; else 0
    n_lifted: int = 0  # holes and jumps between positions that were taken as lifting the pen

    def conditioned(self, lowpass_hz: float) -> tuple[Array, Array]:
        """Return speed [mm/s] and force [N] through the causal low-pass of rendering, shapes (n,)."""
        return condition(self.moved, self.force, self.rate_hz, lowpass_hz)


def constant_stroke(speed: float, force: float, seconds: float, rate_hz: float) -> Stroke:
    """Return a stroke at one speed [mm/s] and force [N].

    Raises:
        ValueError: something is negative, not finite, or lasts less than a sample.
    """
    for name, value in (("speed", speed), ("force", force), ("seconds", seconds)):
        if not (math.isfinite(value) and value >= 0):
            raise ValueError(f"{name} is {value}, expected a finite number, 0 or more")
    if seconds > LONGEST_S:
        raise ValueError(f"seconds is {seconds:g}, expected at most {LONGEST_S:g}, an hour")
    n = round(seconds * rate_hz)
    if n < 1:
        raise ValueError(f"{seconds:g} s are less than one sample at {rate_hz:g} Hz")
    return Stroke(np.full((1, n), float(speed)), np.full(n, float(force)), rate_hz)


def recorded_stroke(recording: Recording, rate_hz: float) -> Stroke:
    """Return the hand of a recording at a model's rate, whole; an acceleration is not needed."""
    moved, pressed = hand_of(recording, rate_hz)
    return Stroke(moved, np.maximum(pressed, 0.0), rate_hz)


def read_stroke(path: Path, rate_hz: float, calibration: PressureCalibration | None = None) -> Stroke:
    """Return the stroke in a CSV file at a model's rate: as many samples as it lasts × rate, rounded.

    The header names `t` [s], and `speed` [mm/s] or `x`, `y` [mm], and `force` [N] or `pressure` [0 … 1]; other columns are
    ignored. Values between rows are interpolated linearly, as positions of a recording are. Where positions are given, the
    pen is lifted in holes of ten times the usual step, since tablets tell nothing of a pen in the air, and where it jumps
    faster than 5 m/s from or to a row without force: no force, no movement.

    Raises:
        ValueError: a column is missing, a value is no finite number, or time does not increase.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if any(cell.strip() for cell in row)]
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path.name} is no CSV text ({error}), expected a header with {COLUMNS}") from error
    if not rows:
        raise ValueError(f"{path.name} is empty, expected a header with {COLUMNS}")
    header = [cell.strip().lower() for cell in rows[0]]
    known = [name for name in header if name in ("t", "speed", "x", "y", "force", "pressure")]
    columns = {name: _column(path, rows[1:], header.index(name), name) for name in known}
    if "t" not in columns or not (
        ("speed" in columns or {"x", "y"} <= columns.keys()) and ("force" in columns or "pressure" in columns)
    ):
        raise ValueError(f"{path.name} has the columns {', '.join(rows[0])}; expected {COLUMNS}")
    times = columns["t"]
    if times.size < 2:
        raise ValueError(f"{path.name} has {times.size} rows below its header, expected two or more")
    wrong = np.flatnonzero(np.diff(times) <= 0)
    if wrong.size:
        raise ValueError(f"{path.name}: t does not increase at row {int(wrong[0]) + 3}")
    times = times - times[0]
    if "force" in columns:
        force = columns["force"]
    else:
        pressure = columns["pressure"]
        if pressure.min() < 0 or pressure.max() > 1:
            raise ValueError(f"{path.name}: pressure runs to {pressure.max():g}, expected 0 to 1")
        force = (calibration or PressureCalibration()).force(pressure)
    if force.min() < 0 or ("speed" in columns and columns["speed"].min() < 0):
        raise ValueError(f"{path.name}: speed and force are magnitudes, found one below zero")
    if times[-1] > LONGEST_S or (times.size > 50 and np.median(np.diff(times)) >= 0.5):
        span = f"{path.name} has {times.size} rows over {times[-1]:g} s"
        raise ValueError(f"{span}, expected at most an hour; is t in ms?")
    n_lifted = 0
    if "speed" not in columns:
        times, positions, force, n_lifted = _lifted(times, np.stack([columns["x"], columns["y"]]), force)
    n = round(times[-1] * rate_hz)
    if n < 1:
        raise ValueError(f"{path.name} lasts {times[-1]:g} s, less than one sample at {rate_hz:g} Hz; is t in seconds?")
    if "speed" in columns:
        moved = at_rate(columns["speed"], times, rate_hz, n)[None]
    else:
        moved = velocity(np.stack([at_rate(axis, times, rate_hz, n) for axis in positions]), rate_hz)
    fastest = float(np.abs(moved).max())
    if fastest > LIMITS["speed"]:
        raise ValueError(f"{path.name}: speed reaches {fastest:g} mm/s; is it, or t, in another unit?")
    if force.max() > 100:
        raise ValueError(f"{path.name}: force reaches {force.max():g} N; is it in mN or grams?")
    gap = 0.0 if n_lifted else float(np.diff(times)[_holes(times)].max(initial=0.0))
    return Stroke(moved, at_rate(force, times, rate_hz, n), rate_hz, gap, n_lifted)


def _holes(times: Array) -> NDArray[np.int64]:
    """Return the rows after which there is a hole in the times."""
    steps = np.diff(times)
    return np.flatnonzero(steps > 10 * np.median(steps))


def _lifted(times: Array, positions: Array, force: Array) -> tuple[Array, Array, Array, int]:
    """Return times, positions (2, n) and force with the pen in the air in holes and jumps, and how many there are.

    Movement in the air is taken out of all positions after it, so that no speed comes of it.
    """
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
    pressed = np.concatenate([force, np.zeros_like(added)])[order]
    return merged[order], np.stack(rows), pressed, int(lifts.size)


def _column(path: Path, rows: list[list[str]], index: int, name: str) -> Array:
    values = np.empty(len(rows))
    for i, row in enumerate(rows):
        try:
            values[i] = float(row[index])
        except (ValueError, IndexError) as error:
            given = repr(row[index]) if index < len(row) else "nothing"
            raise ValueError(f"{path.name}: {name} at row {i + 2} is {given}, expected a number") from error
        if not math.isfinite(values[i]):
            raise ValueError(f"{path.name}: {name} at row {i + 2} is {values[i]}, expected a finite number")
    return values
