"""From columns of files to a Recording: which column is which channel, in what unit, at what rate.

Nothing is resampled or padded. Every conversion and every filled gap is written into the recording's history.
"""

from __future__ import annotations

import difflib
import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.datasets import DATASETS
from foten.datasets.columns import Column
from foten.datasets.wav import FULL_SCALE
from foten.recording.recording import AXES, LIMITS, UNITS, Channel, Recording

G = 9.80665  # m/s², standard gravity

FACTORS: Mapping[str, Mapping[str, float]] = {
    "acceleration": {"m/s^2": 1.0, "g": G, "mg": G / 1000, "mm/s^2": 1e-3},
    "speed": {"mm/s": 1.0, "cm/s": 10.0, "m/s": 1000.0},
    "position": {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3},
    "force": {"N": 1.0, "mN": 1e-3, "gf": G / 1000},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
}
"""For each quantity, what a number in a unit is multiplied by to give the unit of `UNITS` (time: seconds)."""

_SPELLINGS = {"m/s2": "m/s^2", "m/s²": "m/s^2", "m/s**2": "m/s^2", "mm/s2": "mm/s^2", "mm/s²": "mm/s^2"} | {
    "µm": "um",
    "μm": "um",
    "µs": "us",
    "μs": "us",
    "sec": "s",
}

_USUAL: Mapping[str, float] = {"speed": 400.0, "acceleration": 100.0, "force": 3.0, "position": 300.0}
"""What the largest value of a usual recording is about; only to guess which unit was meant."""

SHORTEST_S = 0.1
SLOWEST_HZ = 40.0  # of an acceleration: half of it is the lowest frequency that training keeps
FILLED = ("position", "speed", "force")  # the hand, which is slow; an acceleration is not invented
JITTER = 0.01  # of a period: less, and times are called regular

_GUESSES: Mapping[str, frozenset[str]] = {
    "time": frozenset({"time", "t", "times", "timestamp", "time_s", "seconds"}),
    "acceleration": frozenset({"acceleration", "accel", "acc", "a"}),
    "speed": frozenset({"speed", "velocity", "vel", "v"}),
    "force": frozenset({"force", "normal_force", "normalforce", "fn", "f"}),
} | {
    f"{quantity}_{axis}": frozenset(
        {f"{name}{mark}{axis}" for name in names for mark in ("_", "", ".")}
        | {f"{name}.{AXES.index(axis)}" for name in names if len(name) > 1}
    )
    for quantity, names in {
        "acceleration": ("acceleration", "accel", "acc", "a"),
        "position": ("position", "pos", "p"),
        "force": ("force", "f"),
    }.items()
    for axis in AXES
}


@dataclass(frozen=True)
class ImportOptions:
    """What the user says about the files.

    Attributes:
        mapping: (channel, column) pairs, column as `COLUMN` or `FILE:COLUMN`; `time` may come once per file.
            Empty: guessed from the headers.
        units: by channel (or `time`): a unit, or `*FACTOR`, or `LABEL*FACTOR`.
        rate_hz: for channels whose file states no rate and has no time column.
        rates_hz: by channel; overrides what a file states.
        fill_gaps_ms: longest run of NaN, or of rows that are missing by their times, that is filled in position, speed and
            force; 0 fills none.
        force_units: accept values beyond `LIMITS`.
        texture, tool, sensors, notes: free text.
    """

    mapping: tuple[tuple[str, str], ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    rate_hz: float | None = None
    rates_hz: Mapping[str, float] = field(default_factory=dict)
    fill_gaps_ms: float = 0.0
    force_units: bool = False
    texture: str = ""
    tool: str = ""
    sensors: str = ""
    notes: str = ""

    def __post_init__(self) -> None:
        for channel in (*(name for name, _ in self.mapping), *self.units, *self.rates_hz):
            if channel not in UNITS and channel != "time":
                close = difflib.get_close_matches(channel, [*UNITS, "time"], n=1)
                hint = f"; did you mean {close[0]}?" if close else ""
                raise ValueError(f"unknown channel {channel!r}, expected time, {', '.join(UNITS)}{hint}")
        if "time" in self.rates_hz:
            raise ValueError("time has no rate; give it to a channel, e.g. --rate force=1000")
        names = [name for name, _ in self.mapping if name != "time"]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"{name} is mapped twice")
        for channel, rate in [("", self.rate_hz), *self.rates_hz.items()]:
            if rate is not None and not (np.isfinite(rate) and rate > 0):
                raise ValueError(f"rate {channel or 'of the recording'} is {rate:g} Hz, expected above 0")
        if not np.isfinite(self.fill_gaps_ms) or self.fill_gaps_ms < 0:
            raise ValueError(f"gaps to fill are {self.fill_gaps_ms:g} ms, expected 0 or more")


@dataclass(frozen=True)
class Import:
    """A recording, and what was decided on the way: sentences for the user."""

    recording: Recording
    decisions: tuple[str, ...]


def parse_pairs(texts: Sequence[str], option: str) -> list[tuple[str, str]]:
    """Return `A=B,C=D` texts as pairs.

    Raises:
        ValueError: a piece without `=`.
    """
    pairs = []
    for piece in (piece.strip() for text in texts for piece in text.split(",")):
        if not piece:
            continue
        key, equals, value = piece.partition("=")
        if not equals or not key.strip() or not value.strip():
            raise ValueError(
                f"{option} {piece!r} is not CHANNEL=VALUE (a column whose name holds a comma goes by its "
                "number)"
            )
        pairs.append((key.strip(), value.strip()))
    return pairs


def parse_rates(texts: Sequence[str]) -> tuple[float | None, dict[str, float]]:
    """Return `HZ` and `CHANNEL=HZ` texts as the rate for all and the rates by channel.

    Raises:
        ValueError: not a number.
    """
    overall, by_channel = None, {}
    for piece in (piece.strip() for text in texts for piece in text.split(",")):
        if not piece:
            continue
        channel, equals, number = piece.rpartition("=")
        try:
            rate = float(number)
        except ValueError:
            raise ValueError(f"--rate {piece!r} is not HZ or CHANNEL=HZ, e.g. --rate 10000") from None
        if equals:
            by_channel[channel.strip()] = rate
        else:
            overall = rate
    return overall, by_channel


def quantity(channel: str) -> str:
    """Return what a channel measures: `force_x` → `force`."""
    return channel.split("_")[0]


def read_columns(path: Path) -> list[Column]:
    """Return the columns of any file that `DATASETS` can read.

    Raises:
        FileNotFoundError: there is none.
        ValueError: unknown extension, a pickle, or a bad file.
    """
    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    if path.is_dir():
        raise ValueError(f"{path} is a folder, expected a file")
    suffix = path.suffix.lower()
    if suffix in (".pkl", ".pickle"):
        raise ValueError(
            f"{path.name} is a pickle, which can run code when opened; save plain arrays as .npz or .h5 "
            "instead"
        )
    if suffix not in DATASETS:
        hint = "; save it as .xlsx" if suffix in (".xls", ".xlsb", ".ods") else ""
        raise ValueError(f"cannot read {path.name}, expected one of {' '.join(DATASETS)}{hint}")
    return DATASETS[suffix](path)


def import_recording(paths: Sequence[Path], options: ImportOptions) -> Import:
    """Return the recording that some files hold, and what was decided on the way.

    A mapped `time` column serves the channels of its own file that have as many rows; give it once per file.
    Times of several files are taken to be one clock; they count from the start of the acceleration, or else
    from the earliest.

    Raises:
        ValueError: one sentence on what is missing, ambiguous or impossible.
    """
    _unique_names(paths)
    files = {path: read_columns(path) for path in paths}
    decisions: list[str] = []
    mapping = options.mapping
    if not mapping:
        mapping = _guess(files, options)
        decisions += [f"taken from the headers: --map {','.join(f'{k}={v}' for k, v in mapping)}"]
        taken = {reference for _, reference in mapping}
        rest = [_reference(files, path, c) for path, columns in files.items() for c in columns]
        decisions += (
            [f"left out: {', '.join(name for name in rest if name not in taken)}"]
            if set(rest) - taken
            else []
        )
    picked: dict[str, tuple[Path, Column]] = {}
    clocks: list[tuple[Path, Column]] = []
    for channel, reference in mapping:
        if channel == "time":
            clocks += _find_clocks(files, reference)
        else:
            picked[channel] = _find(files, channel, reference)
    if not picked:
        raise ValueError("only time is mapped, expected a channel as well, e.g. --map time=0,acceleration=1")
    options = _for_axes(options, picked)
    for channel in (*options.units, *options.rates_hz):
        if channel not in picked and channel != "time":
            raise ValueError(
                f"{channel} has a unit or rate but is not mapped; mapped are {', '.join(picked)}"
            )

    history: list[str] = []
    digests = {
        path: hashlib.sha256(path.read_bytes()).hexdigest() for path in {p for p, _ in picked.values()}
    }
    samples: dict[str, NDArray[np.float64]] = {}
    times: dict[str, NDArray[np.float64] | None] = {}
    rates: dict[str, float] = {}
    for channel, (path, column) in picked.items():
        history.append(f"{channel} is column {column.name} of {path.name} (sha256 {digests[path][:16]})")
        if column.n_blank:
            history.append(f"{channel} ends {column.n_blank} rows before the table does")
        factor, said = _factor(channel, column, options.units.get(channel))
        history += [said] if said else []
        samples[channel] = column.samples if factor == 1 else column.samples * factor
        times[channel] = _times(channel, path, column, clocks, options)
        rates[channel], said = _rate(channel, path, column, times[channel], options, files[path])
        history += [said] if said else []
        overall = options.rate_hz if channel not in options.rates_hz else None
        if overall is not None and abs(overall - rates[channel]) > 1e-6 * overall:
            why = "states" if times[channel] is None else "has a time column,"
            unused = f"rate {overall:g} Hz not used: {path.name} {why} {rates[channel]:g} Hz"
            decisions += [unused] if unused not in decisions else []

    origin = _origin(times)
    if origin:
        history.append(f"times count from {origin:.9g} s in the files")
    channels: dict[str, Channel] = {}
    for channel in picked:
        clock = times[channel]
        if clock is not None:
            clock = clock - origin
            kept = _irregular(clock, rates[channel])
            if kept:
                history.append(f"{channel} keeps its own times: {kept}")
            else:
                clock = None
        values, filled = _filled(channel, samples[channel], clock, rates[channel], options.fill_gaps_ms)
        history += [filled] if filled else []
        channels[channel], filled = _bridged(
            channel, Channel(values, rates[channel], clock), options.fill_gaps_ms
        )
        history += [filled] if filled else []
    for channel, one in channels.items():
        if quantity(channel) == "acceleration" and one.rate_hz < SLOWEST_HZ and not options.force_units:
            slow = f"{channel} has a rate of {one.rate_hz:g} Hz, too slow for any vibration"
            in_ms = "was the time given in ms? Then: --unit time=ms"
            hint = "is the rate right?" if times[channel] is None else in_ms
            raise ValueError(f"{slow}; {hint} (--force-units imports it)")
    _check_overlap(channels)
    for channel, one in channels.items():
        said = _check_size(channel, one, options.force_units)
        history += [said] if said else []
        if one.duration_s < SHORTEST_S:
            raise ValueError(
                f"{channel} is too short: {one.samples.size} samples at {one.rate_hz:g} Hz last "
                f"{one.duration_s * 1000:.3g} ms, expected {SHORTEST_S * 1000:g} ms or more; is the rate "
                "right?"
            )
    kinds = {quantity(channel) for channel in channels}
    if "acceleration" not in kinds:
        decisions.append(
            "there is no acceleration: strokes can be rendered from this recording, nothing learned"
        )
    elif not {"speed", "position"} & kinds or "force" not in kinds:
        decisions.append("without speed (or position) and force nothing can be learned from this recording")
    recording = Recording(
        channels, options.texture, options.tool, options.sensors, options.notes, history=tuple(history)
    )
    return Import(recording, tuple(decisions))


def _for_axes(options: ImportOptions, picked: Mapping[str, object]) -> ImportOptions:
    """Return the options with the unit and rate of a quantity given to its axes, where those are mapped and it is not."""

    def spread(given: Mapping[str, Any]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for channel, value in given.items():
            axes = [name for name in picked if quantity(name) == channel and name != channel]
            found.update(dict.fromkeys(axes if axes and channel not in picked else [channel], value))
        return found | {channel: value for channel, value in given.items() if channel in picked}

    return replace(options, units=spread(options.units), rates_hz=spread(options.rates_hz))


def _origin(times: Mapping[str, NDArray[np.float64] | None]) -> float:
    """Return the file time [s] that becomes 0: where the acceleration starts, which must stay on its grid."""
    starts = {channel: float(clock[0]) for channel, clock in times.items() if clock is not None}
    fast = [start for channel, start in starts.items() if quantity(channel) == "acceleration"]
    return min(fast or starts.values(), default=0.0)


def _unique_names(paths: Sequence[Path]) -> None:
    if not paths:
        raise ValueError("no file to import")
    seen = set()
    for path in paths:
        if path in seen:
            raise ValueError(f"{path} is given twice")
        seen.add(path)


def _guess(files: Mapping[Path, list[Column]], options: ImportOptions) -> tuple[tuple[str, str], ...]:
    """Return the mapping that the headers alone leave no doubt about."""
    found: dict[str, list[tuple[Path, Column]]] = {}
    for path, columns in files.items():
        for column in columns:
            for channel, aliases in _GUESSES.items():
                if _bare(column.name, quantity(channel)) in aliases and column.n_rows > 1:
                    found.setdefault(channel, []).append((path, column))
    # Sound files carry no names; beside a table they are the accelerometer.
    sounds = {path: columns for path, columns in files.items() if path.suffix.lower() == ".wav"}
    if len(sounds) == 1 and not any(quantity(channel) == "acceleration" for channel in found):
        [(path, columns)] = sounds.items()
        names = ["acceleration"] if len(columns) == 1 else [f"acceleration_{axis}" for axis in AXES]
        if len(columns) == len(names):
            found.update({name: [(path, column)] for name, column in zip(names, columns, strict=True)})
    if options.rate_hz is not None:
        for path, column in found.pop("time", []):
            times = column.samples * _factor("time", column, options.units.get("time"))[0]
            if times.size > 1 and (np.diff(times) > 0).all():
                own = _rate_of(times)
                if abs(own - options.rate_hz) > 0.01 * own:
                    raise ValueError(
                        f"{path.name}: the column {column.name} says {own:g} Hz and --rate {options.rate_hz:g}; "
                        "leave out --rate, or map the other columns with --map to use it"
                    )
    for channel, places in found.items():
        per_file = [path for path, _ in places]
        if channel == "time" and len(set(per_file)) == len(per_file):
            continue
        if len(places) > 1:
            could = ", ".join(_reference(files, *place) for place in places)
            raise ValueError(f"{channel} could be any of {could}; say which, e.g. --map {_example(files)}")
    if not set(found) - {"time"}:
        raise ValueError(
            f"no header says which column is which; found {_listing(files)}; say so, e.g. --map "
            f"{_example(files)}"
        )
    return tuple(
        (channel, _reference(files, *place)) for channel, places in found.items() for place in places
    )


def _bare(name: str, kind: str) -> str:
    """Return a header without its unit: `Acc [g]`, `acc_g` → `acc`."""
    name = re.sub(r"\s*[\[(].*[\])]\s*$", "", name).strip()
    head, _, tail = name.rpartition("_")
    if head and _spelled(tail) in FACTORS[kind]:
        name = head
    return name.lower().replace(" ", "_")


def _reference(files: Mapping[Path, list[Column]], path: Path, column: Column) -> str:
    return column.name if len(files) == 1 else f"{path.name}:{column.name}"


def _listing(files: Mapping[Path, list[Column]]) -> str:
    names = [_reference(files, path, c) for path, columns in files.items() for c in columns]
    return ", ".join(names[:20]) + (f" and {len(names) - 20} more" if len(names) > 20 else "")


def _example(files: Mapping[Path, list[Column]]) -> str:
    """Return a mapping that could be meant: a clock by how it runs, the rest by words in file and column names, else in order."""
    left = {
        _reference(files, path, c): (path, c)
        for path, columns in files.items()
        for c in columns
        if c.n_rows > 1 and not c.fault
    }
    pairs = []
    clock = next((name for name, (_, column) in left.items() if _runs_steadily(column)), None)
    if clock is not None:
        pairs.append(f"time={clock}")
        del left[clock]
    words_of = {
        "acceleration": ("acc", "besch"),
        "speed": ("speed", "vel", "gesch"),
        "force": ("force", "kraft"),
    }
    for channel, words in words_of.items():
        if left:
            place = next(
                (one for one in left if any(word in one.lower() for word in words)), next(iter(left))
            )
            del left[place]
            pairs.append(f"{channel}={place}")
    return ",".join(pairs)


def _runs_steadily(column: Column) -> bool:
    """Return whether a column looks like a clock: always rising, by steps that are nearly alike."""
    steps = np.diff(column.samples)
    return bool(steps.size > 10 and (steps > 0).all() and steps.std() < 0.2 * steps.mean())


def _split(files: Mapping[Path, list[Column]], reference: str) -> tuple[list[Path], str]:
    """Return the files that `FILE:COLUMN` or `COLUMN` may mean, and the column."""
    for path in files:
        for name in (str(path), path.name, path.stem):
            if reference.startswith(f"{name}:"):
                same = [other for other in files if name in (str(other), other.name, other.stem)]
                if len(same) > 1:
                    raise ValueError(f"{name} is the name of {len(same)} files, write out their paths")
                return [path], reference[len(name) + 1 :]
    return list(files), reference


def _lookup(columns: Sequence[Column], name: str) -> Column | None:
    """Return a column by header, else by number from 0, else none."""
    exact = [column for column in columns if column.name == name]
    if len(exact) > 1:
        raise ValueError(f"{len(exact)} columns are called {name!r}; give the column's number from 0")
    if exact:
        return exact[0]
    if name.isdecimal() and int(name) < len(columns):
        return columns[int(name)]
    return None


def _find(files: Mapping[Path, list[Column]], channel: str, reference: str) -> tuple[Path, Column]:
    paths, name = _split(files, reference)
    hits = [(path, column) for path in paths if (column := _lookup(files[path], name)) is not None]
    if len(hits) > 1:
        options = " or ".join(f"{path.name}:{name}" for path, _ in hits)
        raise ValueError(f"{channel}={reference} is in {len(hits)} files; write {options}")
    if not hits:
        there = {path: files[path] for path in paths}
        close = difflib.get_close_matches(
            name, [c.name for cs in there.values() for c in cs], n=1, cutoff=0.5
        )
        hint = f"; did you mean {close[0]}?" if close else ""
        where = paths[0].name if len(paths) == 1 else "the files"
        raise ValueError(f"{channel}: no column {name!r} in {where}, which has {_listing(there)}{hint}")
    path, column = hits[0]
    if column.fault:
        raise ValueError(f"{channel}: {path.name}, column {column.name}: {column.fault}")
    if not column.samples.size:
        raise ValueError(f"{channel}: {path.name}, column {column.name} is empty")
    return path, column


def _find_clocks(files: Mapping[Path, list[Column]], reference: str) -> list[tuple[Path, Column]]:
    """Return the time columns that a reference means: without `FILE:`, that of each file which has it."""
    paths, name = _split(files, reference)
    if name.isdecimal():
        paths = [_find(files, "time", reference)[0]]
    hits = [path for path in paths if _lookup(files[path], name) is not None]
    if not hits:
        _find(files, "time", reference)  # raises
    return [_find({path: files[path]}, "time", name) for path in hits]


def _factor(channel: str, column: Column, given: str | None) -> tuple[float, str]:
    """Return what to multiply a column by to get the unit of `UNITS`, and a sentence where that is not 1."""
    kind = quantity(channel)
    known = FACTORS[kind]
    target = UNITS.get(channel, "s")
    text = given if given is not None else column.unit
    if not text:
        bracket = re.search(r"[\[(]([^\])]+)[\])]\s*$", column.name)
        text = bracket.group(1).strip() if bracket and _spelled(bracket.group(1)) in known else ""
        head, _, tail = column.name.rpartition("_")
        if not text and head and _spelled(tail) in known:
            text = tail
    if not text:
        return 1.0, ""
    label, star, number = text.partition("*") if "**" not in text else (text, "", "")
    label = _spelled(label)
    if star:
        try:
            factor = float(number)
        except ValueError:
            factor = float("nan")
        if not np.isfinite(factor) or factor == 0:
            raise ValueError(f"{channel}: unit {text!r}: {number!r} is not a factor, e.g. {channel}=V*4.9")
        if label in known and label != target:
            raise ValueError(
                f"{channel}: {label} is a known unit and takes no factor; write {channel}={label}, or "
                f"{channel}=*{known[label] * factor:g} to get {target}"
            )
        return factor, f"{channel} was multiplied by {factor:g} to get {target}" + (
            f" from {label}" * bool(label)
        )
    if label == FULL_SCALE:
        raise ValueError(
            f"{channel}: the samples of {column.name} are fractions of full scale; say how many {target} "
            f"full scale is, e.g. --unit {channel}=*50"
        )
    if label not in known:
        raise ValueError(
            f"{channel}: unit {text!r} is not one of {', '.join(known)}; for a sensitivity write e.g. "
            f"--unit {channel}=V*4.9 (4.9 {target} per volt)"
        )
    factor = known[label]
    return factor, "" if factor == 1 else f"{channel} was converted from {label} to {target}"


def _spelled(unit: str) -> str:
    unit = unit.strip()
    return _SPELLINGS.get(unit, unit)


def _times(
    channel: str, path: Path, column: Column, clocks: Sequence[tuple[Path, Column]], options: ImportOptions
) -> NDArray[np.float64] | None:
    """Return the times [s] of a channel's samples from the time column beside it, or None."""
    own = [clock for place, clock in clocks if place == path]
    fitting = [clock for clock in own if clock.n_rows == column.n_rows]
    if not own:
        return None
    if len(fitting) != 1:
        rows = ", ".join(f"{clock.name} {clock.n_rows}" for clock in own)
        if channel in options.rates_hz and not fitting:
            return None
        raise ValueError(
            f"{path.name}: {channel} has {column.n_rows} rows and time has {rows}; expected one time column "
            f"of equal length, or a rate: --rate {channel}=HZ"
        )
    if channel in options.rates_hz:
        raise ValueError(f"{channel} has a time column ({fitting[0].name}) and a --rate; give one of them")
    clock = fitting[0]
    times = clock.samples[: column.samples.size]
    if times.size < column.samples.size or not np.isfinite(times).all():
        bad = int(np.flatnonzero(~np.isfinite(times))[0]) if not np.isfinite(times).all() else times.size
        raise ValueError(f"{path.name}: the time is blank or NaN at sample {bad}")
    factor, _ = _factor("time", clock, options.units.get("time"))
    steps = np.diff(times)
    bad_steps = np.flatnonzero(steps <= 0)
    if bad_steps.size:
        i = int(bad_steps[0])
        what = "repeats" if steps[i] == 0 else "goes back"
        hint = (
            "are the times rounded? Leave time out and give --rate"
            if steps[i] == 0
            else "are the rows sorted?"
        )
        raise ValueError(
            f"{path.name}: the time {what} at sample {i + 1}: {times[i + 1]:.9g} after {times[i]:.9g} "
            f"({bad_steps.size} such places); {hint}"
        )
    return times * factor


def _rate(
    channel: str,
    path: Path,
    column: Column,
    times: NDArray[np.float64] | None,
    options: ImportOptions,
    columns: Sequence[Column],
) -> tuple[float, str]:
    """Return a channel's rate [Hz], and a sentence where it overrides what the file states."""
    if channel in options.rates_hz:
        rate = options.rates_hz[channel]
        if column.rate_hz is not None and abs(rate - column.rate_hz) > 1e-6 * rate:
            return (
                rate,
                f"{channel} has the rate given, {rate:g} Hz; {path.name} states {column.rate_hz:g} Hz",
            )
        return rate, ""
    if times is not None:
        if times.size < 2:
            raise ValueError(f"{channel} has 1 sample, expected a recording")
        return _rate_of(times), ""
    if column.rate_hz is not None:
        return column.rate_hz, ""
    if options.rate_hz is not None:
        return options.rate_hz, ""
    scalars = [
        c
        for c in columns
        if c.samples.size == 1 and re.search(r"(^|[._])(fs|rate|sample_?rate|hz)$", c.name.lower())
    ]
    guess = f"{scalars[0].samples[0]:g}" if scalars else "10000"
    hint = f" (the file has {scalars[0].name} = {guess})" if scalars else ""
    raise ValueError(
        f"{channel}: {path.name} does not say how fast it was sampled; give --rate {guess} or --rate "
        f"{channel}={guess}{hint}, or map its time column: --map time=COLUMN"
    )


def _rate_of(times: NDArray[np.float64]) -> float:
    """Return the rate of regular times, whole where their rounding allows it; else 1 / median step."""
    even = (times.size - 1) / (times[-1] - times[0])
    slack = 2 * _last_digit(times) / (times[-1] - times[0]) + 1e-9
    if _irregular(times - times[0], even):
        even = 1 / float(np.median(np.diff(times)))
        slack = 1e-6
    return float(round(even)) if round(even) and abs(round(even) / even - 1) <= slack else float(even)


def _last_digit(times: NDArray[np.float64]) -> float:
    """Return the power of ten that all times are multiples of, 0 where there is none down to 1 ns."""
    for digits in range(10):
        scaled = times * 10.0**digits
        # Half a unit in the last place of a double grows with the number itself.
        if np.abs(scaled - np.round(scaled)).max() <= 1e-6 + 4e-16 * np.abs(scaled).max():
            return 10.0**-digits
    return float(np.spacing(np.float32(np.abs(times).max())))  # single precision somewhere on the way


def _irregular(times: NDArray[np.float64], rate_hz: float) -> str:
    """Return why times that count from the recording's start are not i / rate, or nothing."""
    period = 1 / rate_hz
    tolerance = max(JITTER * period, min(_last_digit(times), period / 2))
    if abs(times[0]) > tolerance:
        return f"it starts at {times[0] * 1000:.4g} ms"
    if times.size > 1:
        even = np.arange(times.size) * ((times[-1] - times[0]) / (times.size - 1)) + times[0]
        worst = float(np.abs(times - even).max())
        if worst > tolerance:
            return f"samples stray up to {worst * 1000:.4g} ms from an even grid of {rate_hz:g} Hz"
    return ""


def _filled(
    channel: str,
    samples: NDArray[np.float64],
    times: NDArray[np.float64] | None,
    rate_hz: float,
    gap_ms: float,
) -> tuple[NDArray[np.float64], str]:
    """Return samples without NaN, marker drop-outs filled with straight lines if asked, and a sentence."""
    infinite = np.flatnonzero(np.isinf(samples))
    if infinite.size:
        raise ValueError(f"{channel}: {infinite.size} samples are infinite, the first at {infinite[0]}")
    missing = np.isnan(samples)
    if not missing.any():
        return samples, ""
    first, count = int(np.flatnonzero(missing)[0]), int(missing.sum())
    if quantity(channel) not in FILLED:
        raise ValueError(
            f"{channel}: {count} samples are NaN or blank, the first at {first}; only position, speed and force "
            "may have gaps filled"
        )
    edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]]).astype(np.int8)))
    starts, ends = edges[0::2], edges[1::2]
    clock = np.arange(samples.size) / rate_hz if times is None else times
    # A gap is as long as its lost samples: three of them at 100 Hz are 30 ms.
    lengths = (ends - starts) / rate_hz if times is None else _lengths(clock, starts, ends)
    if gap_ms == 0:
        raise ValueError(
            f"{channel}: {count} samples are NaN or blank in {starts.size} gaps, the first at {first}, the "
            f"longest {lengths.max() * 1000:.4g} ms; --fill-gaps "
            f"{max(1, int(np.ceil(lengths.max() * 1000)))} would fill them"
        )
    if missing[0] or missing[-1]:
        raise ValueError(
            f"{channel}: NaN or blank at the {'start' if missing[0] else 'end'}: nothing to draw a line "
            "from; cut the file there"
        )
    long = np.flatnonzero(lengths > gap_ms / 1000 * (1 + 1e-9))
    if long.size:
        i = int(long[0])
        raise ValueError(
            f"{channel}: {long.size} of {starts.size} gaps are longer than {gap_ms:g} ms, the first at "
            f"sample {starts[i]} ({clock[starts[i]]:.4g} s) lasts {lengths[i] * 1000:.4g} ms"
        )
    filled = samples.copy()
    filled[missing] = np.interp(clock[missing], clock[~missing], samples[~missing])
    return filled, (
        f"{channel}: {starts.size} gaps ({count} samples, the longest {lengths.max() * 1000:.4g} ms) were "
        f"filled with straight lines, up to {gap_ms:g} ms allowed"
    )


def _bridged(channel: str, one: Channel, gap_ms: float) -> tuple[Channel, str]:
    """Return a channel with the rows that its times say are missing filled in, if asked, and a sentence."""
    holes = one.holes()
    if not holes.size or one.times_s is None or quantity(channel) not in FILLED:
        return one, ""  # an acceleration at irregular times is refused before it is used
    steps = np.diff(one.times_s)
    period = float(np.median(steps))
    lengths = steps[holes] - period  # as long as what was lost
    longest = int(lengths.argmax())
    places = f"{holes.size} place{'s' * (holes.size > 1)}"
    worst, since = lengths[longest] * 1000, one.times_s[holes[longest]]
    what = f"{channel}: rows are missing in {places}, the longest {worst:.4g} ms after {since:.4g} s"
    if worst > gap_ms + 1e-6:
        would = max(1, int(np.ceil(worst - 1e-6)))
        raise ValueError(f"{what}; --fill-gaps {would} would draw straight lines there, or cut the file")
    added = [
        np.linspace(one.times_s[i], one.times_s[i + 1], round(steps[i] / period), endpoint=False)[1:]
        for i in holes
    ]
    times = np.sort(np.concatenate([one.times_s, *added]))
    samples = np.interp(times, one.times_s, one.samples)
    return Channel(samples, one.rate_hz, times), (
        f"{what}; {times.size - one.times_s.size} samples on straight lines were put there, up to {gap_ms:g} ms allowed"
    )


def _lengths(
    clock: NDArray[np.float64], starts: NDArray[np.int64], ends: NDArray[np.int64]
) -> NDArray[np.float64]:
    after = np.minimum(ends, clock.size - 1)
    return np.asarray(clock[after] - clock[starts], dtype=np.float64)


def _check_overlap(channels: Mapping[str, Channel]) -> None:
    spans = {
        name: (float(c.times_s[0]) if c.times_s is not None else 0.0, c.duration_s)
        for name, c in channels.items()
    }
    late = max(spans, key=lambda name: spans[name][0])
    early = min(spans, key=lambda name: spans[name][0] + spans[name][1])
    if spans[late][0] >= sum(spans[early]):
        raise ValueError(
            f"{late} starts at {spans[late][0]:.6g} s, when {early} has ended ({sum(spans[early]):.6g} s); "
            "were their clocks different? Leave time out and give --rate if they were started together"
        )


def _check_size(channel: str, one: Channel, force_units: bool) -> str:
    """Return a sentence where absurd values were let through; refuse them otherwise."""
    kind, unit = quantity(channel), UNITS[channel]
    size = np.abs(one.samples)
    beyond = np.flatnonzero(size > LIMITS[kind])
    if not beyond.size:
        return ""
    largest = int(np.argmax(size))
    what = f"{channel} reaches {one.samples[largest]:.6g} {unit} at sample {largest}"
    if force_units:
        return (
            f"{what}; {beyond.size} samples beyond {LIMITS[kind]:g} {unit} were let through (--force-units)"
        )
    if beyond.size <= 0.01 * size.size:
        raise ValueError(
            f"{what}, beyond any hand ({LIMITS[kind]:g} {unit}), in {beyond.size} of {size.size} samples: "
            "spikes? --force-units imports them as they are, and foten inspect shows where"
        )
    large = float(np.quantile(size, 0.99))
    likely = min(FACTORS[kind].items(), key=lambda item: abs(np.log(large * item[1] / _USUAL[kind])))
    guess = (
        f"was it given in {likely[0]}? Then: --unit {channel}={likely[0]}"
        if likely[1] != 1
        else f"a raw sensor reading? Give its sensitivity: --unit {channel}=V*FACTOR"
    )
    raise ValueError(
        f"{what}, expected below {LIMITS[kind]:g} {unit}; {guess} (--force-units imports it all the same)"
    )
