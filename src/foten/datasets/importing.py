"""From columns of files to a Recording, or to a stroke: which column is which channel, in what unit, at what rate.

Nothing is resampled or padded. Every conversion and every filled gap is written into the recording's history.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from foten.datasets.binary import read_hdf5, read_matlab, read_numpy, read_tdms, read_wav
from foten.datasets.bounds import check_hand, check_overlap
from foten.datasets.columns import Column
from foten.datasets.mapping import clocks_of, column_of, guessed_mapping, names_of, stroke_columns
from foten.datasets.options import ImportOptions
from foten.datasets.pen import PenClock, joined, pen_channels
from foten.datasets.table import read_delimited, read_excel
from foten.datasets.timing import bridged, filled, irregular, rate_and_source, times_of
from foten.datasets.units import factor_of, quantity, split_header
from foten.dsp import Array
from foten.recording.capture_folder import PenEvents
from foten.recording.inspection.one_channel import check_units
from foten.recording.inspection.values import counted
from foten.recording.recording import UNITS, Channel, Recording
from foten.untrusted import check_regular

DATASETS: dict[str, Callable[[Path], list[Column]]] = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat"), read_delimited),
    ".xlsx": read_excel,
    **dict.fromkeys((".npz", ".npy"), read_numpy),
    ".mat": read_matlab,
    **dict.fromkeys((".h5", ".hdf5"), read_hdf5),
    ".tdms": read_tdms,
    ".wav": read_wav,
}
"""What reads a file, by its extension."""

STROKE = "t (s), and speed (mm/s) or x, y (mm), and force (N) or pressure (0 to 1)"
"""What a table of a stroke has to hold; units in its header come before these."""

MIN_ACCELERATION_HZ = 40.0  # of an acceleration: half of it is the lowest frequency that training keeps
MIN_DROPOUT_S = 0.005  # of zeros to the last digit in a sound, which no microphone gives


def read_columns(path: Path) -> list[Column]:
    """Return the columns of any file that `DATASETS` can read.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is empty, has an unknown extension, is a pickle, or a bad file.
    """
    check_regular(path)
    suffix = path.suffix.lower()
    if suffix in (".pkl", ".pickle"):
        raise ValueError(
            f"{path.name} is a pickle, which can run code when opened; save plain arrays as .npz or .h5 instead"
        )
    if suffix not in DATASETS:
        hint = "; save it as .xlsx" if suffix in (".xls", ".xlsb", ".ods") else ""
        raise ValueError(f"cannot read {path.name}, expected one of {' '.join(DATASETS)}{hint}")
    if path.stat().st_size == 0:
        raise ValueError(f"{path.name} is empty")
    return [replace(column, file=path) for column in DATASETS[suffix](path)]


@np.errstate(over="ignore", invalid="ignore")  # infinite and absurd samples are refused, in a sentence
def import_recording(paths: Sequence[Path], options: ImportOptions) -> tuple[Recording, list[str]]:
    """Return the recording that some files hold, and what was decided on the way: sentences for the user.

    A mapped `time` column serves the channels of its own file that have as many rows; give it once per file. Times of several
    files are taken to be one clock; they count from the start of the acceleration, or else from the earliest.

    Raises:
        ValueError: one sentence on what is missing, ambiguous or impossible.
    """
    if not paths:
        raise ValueError("no file to import")
    for path in paths:
        if list(paths).count(path) > 1:
            raise ValueError(f"{path} is given twice")
    files = {path: read_columns(path) for path in paths}
    decisions: list[str] = []
    mapping = options.mapping
    if not mapping:
        mapping = guessed_mapping(files, options)
        decisions.append(f"taken from the headers: --map {','.join(f'{k}={v}' for k, v in mapping)}")
        taken = {reference for _, reference in mapping}
        left_out = [name for name in names_of(files) if name not in taken]
        decisions += [f"left out: {', '.join(left_out)}"] if left_out else []
    picked: dict[str, Column] = {}
    clocks: list[Column] = []
    for channel, reference in mapping:
        if channel == "time":
            clocks += clocks_of(files, reference)
        else:
            picked[channel] = column_of(files, channel, reference)
    if not picked:
        raise ValueError("only time is mapped, expected a channel as well, e.g. --map time=0,acceleration=1")
    options = _for_axes(options, picked)
    for channel in (*options.units, *options.rates_hz):
        if channel not in picked and channel != "time":
            raise ValueError(f"{channel} has a unit or rate but is not mapped; mapped are {', '.join(picked)}")

    history: list[str] = []
    digests = {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in {c.file for c in picked.values()}}
    channels: dict[str, Channel] = {}
    for channel, column in picked.items():
        path = column.file
        history.append(f"{channel} is column {column.name} of {path.name} (sha256 {digests[path][:16]})")
        if column.n_comments:
            passed = f"{counted(column.n_comments, 'line')} of comment in {path.name} passed over"
            history += [passed] if passed not in history else []
        if column.n_blank:
            history.append(f"{channel} ends {counted(column.n_blank, 'row')} before the table does")
        factor, on_unit = factor_of(channel, column.name, column.unit, options.units.get(channel))
        times, on_time = times_of(channel, column, clocks, options)
        rate_hz, on_rate = rate_and_source(channel, column, times, options, files[path])
        history += [said for said in (on_unit, on_time, on_rate) if said and said not in history]
        overall = options.rate_hz if channel not in options.rates_hz else None
        if overall is not None and abs(overall - rate_hz) > 1e-6 * overall:
            why = "states" if times is None else "has a time column,"
            unused = f"rate {overall:g} Hz not used: {path.name} {why} {rate_hz:g} Hz"
            decisions += [unused] if unused not in decisions else []
        if quantity(channel) == "acceleration" and rate_hz < MIN_ACCELERATION_HZ and not options.force_units:
            hint = "is the rate right?" if times is None else "was the time given in ms? Then: --unit time=ms"
            slow = f"{channel} has a rate of {rate_hz:g} Hz, too slow for any vibration"
            raise ValueError(f"{slow}; {hint} (--force-units imports it)")
        channels[channel] = Channel(column.samples if factor == 1 else column.samples * factor, rate_hz, times)

    # What becomes time 0: where the acceleration starts, which must stay on its grid.
    starts = {name: one.span_s[0] for name, one in channels.items() if one.times_s is not None}
    of_acceleration = [start for name, start in starts.items() if quantity(name) == "acceleration"]
    origin = min(of_acceleration or starts.values(), default=0.0)
    if origin:
        history.append(f"times count from {origin:.9g} s in the files")
    for channel, one in channels.items():
        on_clock = ""
        if one.times_s is not None:
            times = one.times_s - origin
            why = irregular(times, one.rate_hz)
            one = replace(one, times_s=times if why else None)
            on_clock = f"{channel} keeps its own times: {why}" if why else ""
        one, on_samples = filled(channel, one, options.fill_gaps_ms, picked[channel])
        channels[channel], on_rows = bridged(channel, one, options.fill_gaps_ms)
        history += [said for said in (on_clock, on_samples, on_rows) if said]
    check_overlap(channels)
    history += [said for name, one in channels.items() if (said := check_hand(name, one, options.force_units))]
    recording = Recording(channels, history=tuple(history))
    unstated = {
        channel: f"{channel} {UNITS.get(channel, 's')}"
        for channel, column in [*picked.items(), *(("time", clock) for clock in clocks)]
        if not (options.units.get(channel) or column.unit or split_header(column.name, quantity(channel))[1])
    }
    if unstated:
        decisions.append(f"no unit is stated: taken as {', '.join(unstated.values())}; --unit changes it")
    for name, one in channels.items():
        decisions += [finding.text for finding in check_units(name, one, recording) if finding.code == "units"]
    present = {
        "acceleration": recording.axes("acceleration"),
        "speed (or position)": recording.movement,
        "force": recording.normal_force,
    }
    missing = " and no ".join(what for what, there in present.items() if not there)
    if missing == "acceleration":
        decisions.append("there is no acceleration: strokes can be rendered from this recording, nothing learned")
    elif missing:
        names = {name.lower(): name for name in names_of(files)}
        x, y = names.get("x", ""), names.get("y", "")
        maybe = f"; {x} and {y} may be positions: --map position_x={x},position_y={y},…"
        hint = maybe if "speed" in missing and x and y else ""
        decisions.append(f"there is no {missing}: nothing can be learned from this recording{hint}")
    return recording, decisions


def import_capture(
    sound: Path, pen: Path, options: ImportOptions, force: Callable[[Array], Array]
) -> tuple[Recording, PenClock, list[str]]:
    """Return what a microphone on a pen and the pen's events hold, what joined them, and what was decided, in sentences.

    Without a unit for the acceleration it is in relative units: 1 is its RMS while the pen strokes.

    Args:
        sound: a file with one channel, or several of which the first counts.
        pen: a table of t, x, y and pressure.
        force: of pressures 0 … 1, shape (n,) → (n,).

    Raises:
        ValueError: one sentence on what is missing or impossible.
    """
    columns = [column for column in read_columns(sound) if column.rate_hz]
    if not columns:
        raise ValueError(f"{sound.name} is no sound with a rate, expected a .wav beside --pen")
    column, decisions, rate_hz = columns[0], [], float(columns[0].rate_hz or 0)
    if len(columns) > 1:
        decisions.append(f"the first of {len(columns)} channels of {sound.name} is taken")
    events = read_stroke(pen, {name: unit for name, unit in options.units.items() if name != "acceleration"})
    if not {"position_x", "position_y", "pressure"} <= events.keys():
        raise ValueError(f"{pen.name} has no x, y and pressure, expected those of a pen")
    lost_s = [n / rate_hz for n in _runs_of_zeros(column.samples) if n >= MIN_DROPOUT_S * rate_hz]
    if lost_s:
        decisions.append(
            f"the sound is zero to the last digit for {1000 * sum(lost_s):.0f} ms in {counted(len(lost_s), 'place')}: "
            "parts of it were lost as it was recorded, and are learned as silence"
        )
    touching = PenEvents(events["time"], events["position_x"], events["position_y"], events["pressure"])
    clock = joined(touching, column.samples, rate_hz)
    channels = pen_channels(touching, clock, force)
    given = options.units.get("acceleration")
    history = [
        f"acceleration is column {column.name} of {sound.name}",
        f"position and force are those of {pen.name}",
        str(clock),
    ]
    if given is None:
        strokes = channels["force"]
        touches = np.interp(np.arange(column.samples.size) / rate_hz, strokes.times, strokes.samples, 0.0, 0.0) > 0
        level = float(np.sqrt(np.square(column.samples[touches] - column.samples[touches].mean()).mean()))
        if not level > 0:
            raise ValueError(f"{sound.name} is silent while the pen strokes: is it the right input?")
        said = f"acceleration is in relative units: 1 is its RMS while the pen strokes, {level:.3g} of full scale"
        factor = 1.0 / level
    else:
        factor, said = factor_of("acceleration", column.name, column.unit, given)
    channels["acceleration"] = Channel(column.samples * factor, rate_hz)
    history.append(said)
    check_overlap(channels)
    history += [said for name, one in channels.items() if (said := check_hand(name, one, options.force_units))]
    return Recording(channels, history=tuple(history), calibrated=given is not None), clock, decisions


def _runs_of_zeros(samples: Array) -> list[int]:
    """Return how long each run of zeros between other samples is [samples]."""
    other = np.flatnonzero(samples)
    return (np.diff(other) - 1).tolist()


def read_stroke(path: Path, units: Mapping[str, str]) -> dict[str, Array]:
    """Return the columns of a stroke's table, shape (n,) each, without its blank lines.

    They are time [s], which increases, speed [mm/s] or position_x and position_y [mm], and force [N] or pressure [0 … 1].

    Args:
        units: by channel, before those of the file.

    Raises:
        ValueError: it is no table, a column is missing, a unit unknown, a value no finite number, or time does not increase.
    """
    if DATASETS.get(path.suffix.lower()) not in (read_delimited, read_excel):
        raise ValueError(f"{path.name} is no table (.csv, .tsv, .txt, .dat, .xlsx), expected one of {STROKE}")
    there = read_columns(path)
    columns = stroke_columns(there)
    if "time" not in columns or not (
        ("speed" in columns or {"position_x", "position_y"} <= columns.keys())
        and ("force" in columns or "pressure" in columns)
    ):
        raise ValueError(f"{path.name} has the columns {', '.join(c.name for c in there)}; expected {STROKE}")
    for channel in ImportOptions(units=units).units:
        if channel not in columns:
            raise ValueError(f"{channel} has a unit, and {path.name} has no column of it")
    stroke: dict[str, Array] = {}
    for channel, column in columns.items():
        if column.fault:
            raise ValueError(f"{path.name}: {channel}, column {column.name}: {column.fault}")
        is_share = channel == "pressure"
        factor = _share(column) if is_share else factor_of(channel, column.name, column.unit, units.get(channel))[0]
        stroke[channel] = factor * np.append(column.samples, np.full(column.n_blank, np.nan))
    kept = ~np.all([np.isnan(samples) for samples in stroke.values()], axis=0)
    rows = np.array(columns["time"].row_numbers)[kept]
    stroke = {channel: samples[kept] for channel, samples in stroke.items()}
    if rows.size < 2:
        raise ValueError(f"{path.name} has {counted(rows.size, 'row')} below its header, expected two or more")
    for channel, samples in stroke.items():
        bad = np.flatnonzero(~np.isfinite(samples))
        if bad.size:
            given = "blank or NaN" if np.isnan(samples[bad[0]]) else "infinite"
            raise ValueError(f"{path.name}: {channel} at row {rows[bad[0]]} is {given}, expected a finite number")
    back = np.flatnonzero(np.diff(stroke["time"]) <= 0)
    if back.size:
        raise ValueError(f"{path.name}: the time does not increase at row {rows[back[0] + 1]}; are the rows sorted?")
    return stroke


def _share(column: Column) -> float:
    """Return what to multiply a pressure by to get a share from 0 to 1, where it is one."""
    unit = column.unit or split_header(column.name, "force")[1]
    if any(map(str.isalpha, unit)):
        raise ValueError(f"the pressure is in {unit}, expected a share, 0 to 1 or in %; is it a force?")
    return 0.01 if "%" in unit else 1.0


def _for_axes(options: ImportOptions, picked: Mapping[str, object]) -> ImportOptions:
    """Return the options with the unit and rate of a quantity given to its axes, where those are mapped and it is not."""

    def spread(given: Mapping[str, Any]) -> dict[str, Any]:
        axes = {name: given[kind] for name in picked if (kind := quantity(name)) in given and kind not in picked}
        served = set(map(quantity, axes))
        return axes | {channel: value for channel, value in given.items() if channel not in served}

    return replace(options, units=spread(options.units), rates_hz=spread(options.rates_hz))
