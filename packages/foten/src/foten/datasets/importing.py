"""Columns of files to a Recording, or to a stroke.

Nothing is resampled or padded. Every conversion and every filled gap is written into the recording's history.
"""

import hashlib
import shlex
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from foten.datasets.binary import read_hdf5, read_numpy, read_wav
from foten.datasets.bounds import check_channel, check_overlap
from foten.datasets.columns import MAX_NAME_CHARACTERS, Column, check_width
from foten.datasets.isolated import isolated_columns
from foten.datasets.mapping import (
    added_mapping,
    by_unit,
    columns_of,
    guessed_mapping,
    guesses_of_missing,
    names_of,
    stroke_columns,
)
from foten.datasets.options import ImportOptions
from foten.datasets.pen import PenClock, joined, pen_channels
from foten.datasets.tabular import read_delimited, stated_above
from foten.datasets.timing import filled, irregular, of_slower_sensor, rate_and_source, times_of
from foten.datasets.units import factor_of, quantity, split_header
from foten.dsp import Array
from foten.recording.capture_folder import PenEvents
from foten.recording.inspection.one_channel import check_units
from foten.recording.inspection.sampling import check_missing
from foten.recording.recording import AXES, UNITS, Channel, Recording, counted
from foten.untrusted import check_content, check_regular

DATASETS: dict[str, Callable[[Path], list[Column]]] = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat"), read_delimited),
    ".xlsx": partial(isolated_columns, ".xlsx"),
    **dict.fromkeys((".npz", ".npy"), read_numpy),
    ".mat": partial(isolated_columns, "MATLAB"),
    **dict.fromkeys((".h5", ".hdf5"), read_hdf5),
    ".tdms": partial(isolated_columns, "TDMS"),
    ".wav": read_wav,
}
"""Readers by extension."""

STROKE = "t (s), and speed (mm/s) or x, y (mm), and force (N) or pressure (0 to 1)"
"""Columns of a table of a stroke; units in its header come before these."""

MIN_ACCELERATION_HZ = 40.0  # of an acceleration: half of it is the lowest frequency that training keeps
MIN_DROPOUT_S = 0.005  # of zeros to the last digit in a sound, which no microphone gives


def read_columns(path: Path) -> list[Column]:
    """Columns of any file that `DATASETS` can read; ValueError for another extension, a pickle, or an empty or bad file."""
    check_regular(path)
    suffix = path.suffix.lower()
    if suffix in (".pkl", ".pickle"):
        raise ValueError(f"{path.name} is a pickle, which can run code when opened; save arrays as .npz or .h5 instead")
    if suffix not in DATASETS:
        hint = "; save it as .xlsx" if suffix in (".xls", ".xlsb", ".ods") else ""
        raise ValueError(f"cannot read {path.name}, expected one of {' '.join(DATASETS)}{hint}")
    check_content(path, path.stat().st_size)
    if path.stat().st_size == 0:
        raise ValueError(f"{path.name} is empty")
    columns = DATASETS[suffix](path)
    if not columns:
        raise ValueError(f"{path.name} holds no column of numbers")
    if all(column.fault for column in columns):
        raise ValueError(f"{path.name}, column {columns[0].name}: {columns[0].fault}")
    check_width(path.name, len(columns))
    return [replace(column, file=path) for column in columns]


@np.errstate(over="ignore", invalid="ignore")  # infinite and absurd samples are refused, in a sentence
def import_recording(paths: Sequence[Path], options: ImportOptions) -> tuple[Recording, list[str]]:
    """Recording in some files, and sentences on what was decided; ValueError on what is missing, ambiguous or impossible.

    A mapped `time` column serves the channels of its file that have as many rows. Times of several files are of one clock; they
    count from the start of the acceleration, or else from the earliest.
    """
    if not paths:
        raise ValueError("no file to import")
    for path in paths:
        if list(paths).count(path) > 1:
            raise ValueError(f"{path} is given twice")
    files = {path: read_columns(path) for path in paths}
    added = added_mapping(files, options.mapping) if options.mapping else guessed_mapping(files, options)
    mapping = (*options.mapping, *added)
    above = "; ".join({column.preamble: "" for there in files.values() for column in there if column.preamble})
    decisions = list(_on_mapping(files, options.mapping, added, above))
    guesses = guesses_of_missing(files, mapping)
    options = replace(options, mapping=mapping)
    clocks = [clock for channel, name in mapping if channel == "time" for clock in columns_of(files, channel, name)]
    columns = {channel: columns_of(files, channel, name)[0] for channel, name in mapping if channel != "time"}
    options = _for_axes(options, columns)
    _check_mapped(columns, options)
    digests = {}
    for path in {column.file for column in columns.values()}:
        with path.open("rb") as file:
            digests[path] = hashlib.file_digest(file, "sha256").hexdigest()
    history: list[str] = []
    channels: dict[str, Channel] = {}
    slower: dict[str, list[str]] = {}
    for name, column in columns.items():
        path = column.file
        history.append(f"{name} is column {column.name} of {path.name} (sha256 {digests[path][:16]})")
        channels[name], on_column, on_rate, on_rows = _converted(name, column, clocks, files[path], options)
        history += on_column
        decisions += on_rate
        if on_rows:
            slower.setdefault(on_rows, []).append(name)
    for sentence, names in slower.items():
        decisions.append(sentence.format(", ".join(names), "sensors" if len(names) > 1 else "a sensor"))
    channels = _on_one_clock(channels, columns, {clock.file for clock in clocks}, options.fill_gaps_ms, history)
    if options.normal is not None:
        channels["force"] = along_normal(channels, options.normal)
        history.append(f"force is force_x, force_y, force_z along the surface's normal {options.normal}")
    elif "force" not in channels and {f"force_{axis}" for axis in AXES} <= channels.keys():
        decisions.append("the normal force is force_z; --normal x,y,z states another normal of the surface")
    recording = _checked(channels, history, options.force_units)
    decisions += _on_units(recording, columns, clocks, options)
    sounds = _sounds(columns)
    if sounds:
        asked = "unless foten train --recorded-innovations always asks for them"
        decisions.append(f"{min(sounds)} may hold speech: above 2 kHz a texture stores no innovations of it, {asked}")
    for finding in check_missing(recording):
        guess = guesses.get(finding.channel, "") if finding.code == "missing" else ""
        decisions.append(f"{finding.text}{'; ' * bool(guess)}{guess}")
    recording = replace(recording, **dict[str, Any](stated_above(above)), microphone=bool(sounds))
    return recording, list(dict.fromkeys(decisions))


def _on_mapping(
    files: Mapping[Path, list[Column]], stated: Sequence[Any], added: Sequence[tuple[str, str]], above: str
) -> Iterator[str]:
    """Sentences on what was taken from the headers, and on what was not."""
    if added:
        pairs = shlex.quote(",".join(f"{channel}={name}" for channel, name in added))
        units = f" ({', '.join(measured)} by unit)" if (measured := by_unit(files, added)) else ""
        yield f"{'also ' * bool(stated)}taken from the headers{units}: --map {pairs}"
    if not stated:
        left_out = [name for name in names_of(files) if name not in {reference for _, reference in added}]
        if left_out:
            yield f"left out: {', '.join(left_out)}"
        if above:
            yield f"above the table: {above[:MAX_NAME_CHARACTERS]}; --tool, --sensors and --notes keep such things"


def _sounds(columns: Mapping[str, Column]) -> set[str]:
    """Names of the files of sound that accelerations are from."""
    of_acceleration = [column.file for name, column in columns.items() if quantity(name) == "acceleration"]
    return {file.name for file in of_acceleration if file.suffix.lower() == ".wav"}


def _check_mapped(columns: Mapping[str, Column], options: ImportOptions) -> None:
    if not columns:
        raise ValueError("only time is mapped, expected a channel as well, e.g. --map time=0,acceleration=1")
    for channel, column in columns.items():
        if twice := [other for other in columns if other != channel and columns[other] is column]:
            raise ValueError(f"{channel} and {twice[0]} are both mapped to {column.name}, expected a column each")
    for channel in (*options.units, *options.rates_hz):
        if channel not in columns and channel != "time":
            raise ValueError(f"{channel} has a unit or rate but is not mapped; mapped are {', '.join(columns)}")


def _converted(
    name: str, column: Column, clocks: Sequence[Column], beside: Sequence[Column], options: ImportOptions
) -> tuple[Channel, list[str], list[str], str]:
    """Channel of a column, its history, sentences on a rate that is not used, and one on a sensor slower than the rows."""
    path = column.file
    history = []
    factor, on_unit = factor_of(name, column.name, column.unit, options.units.get(name))
    times, on_time = times_of(name, column, clocks, options)
    rate_hz, on_rate = rate_and_source(name, column, times, options, beside)
    history += [sentence for sentence in (on_unit, on_time, on_rate) if sentence]
    overall, unused = options.rate_hz if name not in options.rates_hz else None, []
    if overall is not None and abs(overall - rate_hz) > 1e-6 * overall:
        why = "states" if times is None else "has a time column,"
        unused.append(f"rate {overall:g} Hz not used: {path.name} {why} {rate_hz:g} Hz")
    samples = column.samples if factor == 1 else column.samples * factor
    channel, n_rows = of_slower_sensor(Channel(samples, rate_hz, times))
    if n_rows > 1 and name in options.rates_hz:  # given of the sensor, not of the rows
        channel = Channel(channel.samples, rate_hz)
    if column.n_blank >= n_rows:
        history.append(f"{name} ends {counted(column.n_blank, 'row')} before the table does")
    on_rows = f"{{}}: a value every {n_rows:.3g} rows, taken as {{}} at {channel.rate_hz:.6g} Hz" if n_rows > 1 else ""
    history += [on_rows.format(name, "a sensor")] if on_rows else []
    rate_hz = channel.rate_hz
    if quantity(name) == "acceleration" and rate_hz < MIN_ACCELERATION_HZ and not options.force_units:
        hint = "is the rate right?" if times is None else "was the time given in ms? Then: --unit time=ms"
        slow = f"{name} has a rate of {rate_hz:g} Hz, too slow for any vibration"
        raise ValueError(f"{slow}; {hint} (--force-units imports it)")
    return channel, history, unused, on_rows


def _on_one_clock(
    channels: Mapping[str, Channel],
    columns: Mapping[str, Column],
    clocked: Collection[Path],
    fill_gaps_ms: float,
    history: list[str],
) -> dict[str, Channel]:
    """Channels whose times count from where the acceleration starts, which must stay on its grid; gaps are filled if asked.

    Times of a file without a clock, not among `clocked`, are those of its rows, which count from 0.
    """
    starts = {name: channel.span_s[0] for name, channel in channels.items() if columns[name].file in clocked}
    of_acceleration = [start for name, start in starts.items() if quantity(name) == "acceleration"]
    origin = min(of_acceleration or starts.values(), default=0.0)
    if origin:
        history.append(f"times count from {origin:.9g} s in the files")
    shifted = {}
    for name, channel in channels.items():
        if channel.times_s is not None:
            times = channel.times_s - (origin if columns[name].file in clocked else 0.0)
            why = irregular(times, channel.rate_hz)
            channel = replace(channel, times_s=times if why else None)
            history += [f"{name} keeps its own times: {why}"] if why else []
        shifted[name], on_gaps = filled(name, channel, fill_gaps_ms, columns[name])
        history += [on_gaps] if on_gaps else []
    return shifted


def along_normal(channels: Mapping[str, Channel], normal: tuple[float, float, float]) -> Channel:
    """Force along the surface's normal, of the three axes of a sensor; ValueError where they are not all there (Sec. III-c)."""
    names = [f"force_{axis}" for axis in AXES]
    missing = [name for name in names if name not in channels]
    if missing or "force" in channels:
        have = ", ".join(name for name in channels if quantity(name) == "force") or "none"
        raise ValueError(f"--normal is of a force in three axes, force_x, force_y and force_z, found {have}")
    first, *others = (channels[name] for name in names)
    if any(not np.array_equal(other.times, first.times) for other in others):
        raise ValueError("the axes of the force have other times: --normal needs those of one sensor")
    unit = np.array(normal) / np.linalg.norm(normal)
    return replace(first, samples=unit @ np.stack([channels[name].samples for name in names]))


def _checked(
    channels: Mapping[str, Channel], history: list[str], force_units: bool, calibrated: bool = True
) -> Recording:
    """Recording of channels that share some time and that a hand could have made."""
    check_overlap(channels)
    notes = [check_channel(name, channel, force_units) for name, channel in channels.items()]
    history = list(dict.fromkeys([*history, *filter(None, notes)]))
    return Recording(channels, history=tuple(history), calibrated=calibrated)


def _on_units(
    recording: Recording, columns: Mapping[str, Column], clocks: Sequence[Column], options: ImportOptions
) -> list[str]:
    """Sentences on units that nobody states, and on those that the samples speak against."""
    unstated = {
        name: f"{name} {UNITS.get(name, 's')}"
        for name, column in [*columns.items(), *(("time", clock) for clock in clocks)]
        if not (options.units.get(name) or column.unit or split_header(column.name, quantity(name))[1])
    }
    sentences = [f"no unit is stated: taken as {', '.join(unstated.values())}; --unit changes it"] if unstated else []
    for name, channel in recording.channels.items():
        sentences += [finding.text for finding in check_units(name, channel, recording) if finding.code == "units"]
    return sentences


def import_capture(
    sound: Path, pen: Path, options: ImportOptions, force: Callable[[Array], Array]
) -> tuple[Recording, PenClock, list[str]]:
    """Recording of a microphone on a pen and the pen's events, the clock that joins them, and sentences on what was decided.

    Of several channels of the sound the first counts; the pen's table has t, x, y and pressure. `force` is of pressures 0 … 1,
    shape (n,) → (n,) [N]. Without a unit for the acceleration it is in relative units: 1 is its RMS while the pen strokes.
    """
    columns = [column for column in read_columns(sound) if column.rate_hz]
    if not columns:
        raise ValueError(f"{sound.name} is no sound with a rate, expected a .wav beside --pen")
    column, decisions, rate_hz = columns[0], [], float(columns[0].rate_hz or 0)
    if len(columns) > 1:
        decisions.append(f"the first of {len(columns)} channels of {sound.name} is taken")
    stroke = read_stroke(pen, {name: unit for name, unit in options.units.items() if name != "acceleration"})
    if not {"position_x", "position_y", "pressure"} <= stroke.keys():
        raise ValueError(f"{pen.name} has no x, y and pressure, expected those of a pen")
    lost_s = (np.diff(np.flatnonzero(column.samples)) - 1) / rate_hz  # of zeros between other samples
    lost_s = lost_s[lost_s >= MIN_DROPOUT_S]
    if lost_s.size:
        zero = f"zero to the last digit for {1000 * lost_s.sum():.0f} ms in {counted(lost_s.size, 'place')}"
        decisions.append(f"the sound is {zero}: parts of it were lost as it was recorded, and are learned as silence")
    events = PenEvents(stroke["time"], stroke["position_x"], stroke["position_y"], stroke["pressure"])
    clock = joined(events, column.samples, rate_hz)
    channels = pen_channels(events, clock, force)
    unit = options.units.get("acceleration")
    if unit is None:
        sound_s, force_channel = np.arange(column.samples.size) / rate_hz, channels["force"]
        force_at = np.interp(sound_s, force_channel.times, force_channel.samples, 0, 0)
        level = float(column.samples[force_at > 0].std())
        if not level > 0:
            raise ValueError(f"{sound.name} is silent while the pen strokes: is it the right input?")
        on_unit = f"acceleration is in relative units: 1 is its RMS while the pen strokes, {level:.3g} of full scale"
        factor = 1.0 / level
    else:
        factor, on_unit = factor_of("acceleration", column.name, column.unit, unit)
    channels["acceleration"] = Channel(column.samples * factor, rate_hz)
    source = f"acceleration is column {column.name} of {sound.name}"
    history = [source, f"position and force are those of {pen.name}", str(clock), on_unit]
    recording = _checked(channels, history, options.force_units, calibrated=unit is not None)
    return replace(recording, microphone=True), clock, decisions


def read_stroke(path: Path, units: Mapping[str, str]) -> dict[str, Array]:
    """Columns of a stroke's table, shape (n,) each, without its blank lines; `units`, by channel, go before the file's.

    They are time [s], which increases, speed [mm/s] or position_x and position_y [mm], and force [N] or pressure [0 … 1].
    """
    if path.suffix.lower() not in (".csv", ".tsv", ".txt", ".dat", ".xlsx"):
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
    filled_rows = ~np.all([np.isnan(samples) for samples in stroke.values()], axis=0)
    rows = np.array(columns["time"].row_numbers)[filled_rows]
    stroke = {channel: samples[filled_rows] for channel, samples in stroke.items()}
    if rows.size < 2:
        raise ValueError(f"{path.name} has {counted(rows.size, 'row')} below its header, expected two or more")
    for channel, samples in stroke.items():
        bad = np.flatnonzero(~np.isfinite(samples))
        if bad.size:
            what = "blank or NaN" if np.isnan(samples[bad[0]]) else "infinite"
            raise ValueError(f"{path.name}: {channel} at row {rows[bad[0]]} is {what}, expected a finite number")
    back = np.flatnonzero(np.diff(stroke["time"]) <= 0)
    if back.size:
        raise ValueError(f"{path.name}: the time does not increase at row {rows[back[0] + 1]}; are the rows sorted?")
    return stroke


def _share(column: Column) -> float:
    """Factor from a pressure to a share from 0 to 1."""
    unit = column.unit or split_header(column.name, "force")[1]
    if any(map(str.isalpha, unit)):
        raise ValueError(f"the pressure is in {unit}, expected a share, 0 to 1 or in %; is it a force?")
    return 0.01 if "%" in unit else 1.0


def _for_axes(options: ImportOptions, picked: Mapping[str, object]) -> ImportOptions:
    """Options with the unit and rate of a quantity given to its axes, where those are mapped and it is not."""

    def spread(by_user: Mapping[str, Any]) -> dict[str, Any]:
        axes = {name: by_user[kind] for name in picked if (kind := quantity(name)) in by_user and kind not in picked}
        served = set(map(quantity, axes))
        return axes | {channel: value for channel, value in by_user.items() if channel not in served}

    return replace(options, units=spread(options.units), rates_hz=spread(options.rates_hz))
