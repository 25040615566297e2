"""Mapping of columns to channels, by the user or by unambiguous headers."""

from __future__ import annotations

import difflib
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from foten.datasets.columns import Column
from foten.datasets.options import ImportOptions
from foten.datasets.timing import rate_of, rises
from foten.datasets.units import factor_of, quantity, split_header
from foten.recording.recording import AXES

Files = Mapping[Path, list[Column]]

# In English, German, French and Spanish.
_TIMES = "time t times timestamp time_s seconds zeit zeitstempel zeitpunkt temps horodatage tiempo"
_ACCELERATIONS = "acceleration accel acc a beschleunigung beschl. beschl accélération aceleración"
_SPEEDS = "speed velocity vel v geschwindigkeit geschw. geschw vitesse velocidad"
_FORCES = "force f kraft fuerza"
_NORMAL_FORCES = "normal_force normalforce fn normalkraft force_normale fuerza_normal"
_POSITIONS = "position pos p posición"
_GUESSES: Mapping[str, frozenset[str]] = {
    "time": frozenset(_TIMES.split()),
    "acceleration": frozenset(_ACCELERATIONS.split()),
    "speed": frozenset(_SPEEDS.split()),
    "force": frozenset(f"{_FORCES} {_NORMAL_FORCES}".split()),
} | {
    f"{quantity}_{axis}": frozenset(
        {f"{name}{mark}{axis}" for name in names.split() for mark in ("_", "", ".")}
        | {f"{name}.{AXES.index(axis)}" for name in names.split() if len(name) > 1}
    )
    for quantity, names in {"acceleration": _ACCELERATIONS, "position": _POSITIONS, "force": _FORCES}.items()
    for axis in AXES
}

_STROKE: Mapping[str, frozenset[str]] = {
    **{channel: _GUESSES[channel] for channel in ("time", "speed", "force")},
    **{f"position_{axis}": _GUESSES[f"position_{axis}"] | {axis} for axis in "xy"},
    "pressure": frozenset({"pressure"}),
}
"""Headers of a stroke's table."""


def guessed_mapping(files: Files, options: ImportOptions) -> tuple[tuple[str, str], ...]:
    """Mapping by the headers alone; ValueError where they are ambiguous."""
    places: dict[str, list[Column]] = {}
    for column in (column for columns in files.values() for column in columns if column.n_rows > 1):
        for channel, aliases in _GUESSES.items():
            if _header(column, channel) in aliases:
                places.setdefault(channel, []).append(column)
    # Sound files carry no names; beside a table they are the accelerometer.
    sounds = [columns for path, columns in files.items() if path.suffix.lower() == ".wav"]
    if len(sounds) == 1 and not any(quantity(channel) == "acceleration" for channel in places):
        names = ["acceleration"] if len(sounds[0]) == 1 else [f"acceleration_{axis}" for axis in AXES]
        if len(sounds[0]) == len(names):
            places.update({name: [column] for name, column in zip(names, sounds[0], strict=True)})
    if options.rate_hz is not None:
        for column in places.pop("time", []):
            times = column.samples * factor_of("time", column.name, column.unit, options.units.get("time"))[0]
            if times.size > 1 and (np.diff(times) > 0).all():
                rate_hz = rate_of(times)
                if abs(rate_hz - options.rate_hz) > 0.01 * rate_hz:
                    raise ValueError(
                        f"{column.file.name}: the column {column.name} says {rate_hz:g} Hz and --rate {options.rate_hz:g}; "
                        "leave out --rate, or map the other columns with --map to use it"
                    )
    for channel, candidates in places.items():
        n_allowed = len({column.file for column in candidates}) if channel == "time" else 1
        if len(candidates) > n_allowed:
            could = ", ".join(name_of(files, column) for column in candidates)
            raise ValueError(f"{channel} could be any of {could}; say which, e.g. --map {_example(files)}")
    if not set(places) - {"time"}:
        say_so = f"say so, e.g. --map {_example(files)}"
        raise ValueError(f"no header says which column is which; found {_listing(files)}; {say_so}")
    return tuple((channel, name_of(files, column)) for channel, candidates in places.items() for column in candidates)


def stroke_columns(columns: Sequence[Column]) -> dict[str, Column]:
    """Columns of a stroke by channel: time, speed, position_x, position_y, force, pressure; others are left out."""
    by_channel: dict[str, Column] = {}
    for channel, headers in _STROKE.items():
        candidates = [column for column in columns if _header(column, channel) in headers]
        if len(candidates) > 1:
            raise ValueError(f"{channel} could be any of {', '.join(column.name for column in candidates)}; keep one")
        if candidates:
            by_channel[channel] = candidates[0]
    return by_channel


def _header(column: Column, channel: str) -> str:
    """Header of a column that is taken for a channel, without its unit, in small letters."""
    kind = "force" if channel == "pressure" else quantity(channel)
    return split_header(column.name, kind)[0].lower().replace(" ", "_")


def name_of(files: Files, column: Column) -> str:
    """Name of a column, with several files `FILE:COLUMN`."""
    return column.name if len(files) == 1 else f"{column.file.name}:{column.name}"


def names_of(files: Files) -> list[str]:
    """Names of all columns."""
    return [name_of(files, column) for columns in files.values() for column in columns]


def _listing(files: Files) -> str:
    names = names_of(files)
    return ", ".join(names[:20]) + (f" and {len(names) - 20} more" if len(names) > 20 else "")


def _example(files: Files) -> str:
    """Example of a mapping: columns whose headers say what they are, one that always rises as time, then in their order."""
    usable = {name_of(files, c): c for columns in files.values() for c in columns if c.n_rows > 1 and not c.fault}
    named = {
        channel: name
        for name, column in usable.items()
        for channel in _GUESSES
        if _header(column, channel) in _GUESSES[channel]
    }
    others = [name for name in usable if name not in named.values()]
    clocks = [name for name in others if rises(usable[name])]
    if "time" not in named and clocks:
        named["time"] = clocks[0]
        others.remove(clocks[0])
    there = set(map(quantity, named))
    unknown = [channel for channel in ("acceleration", "speed", "force") if channel not in there]
    unknown = [channel for channel in unknown if channel != "speed" or "position" not in there]
    pairs = {channel: named[channel] for channel in _GUESSES if channel in named}
    pairs |= dict(zip(unknown, others, strict=False))
    return shlex.quote(",".join(f"{channel}={name}" for channel, name in pairs.items()))


def columns_of(files: Files, channel: str, reference: str) -> list[Column]:
    """Columns of a reference, by their header or else by their number from 0; several only of `time` without `FILE:`."""
    every = [(path, k, column) for path, columns in files.items() for k, column in enumerate(columns)]
    hits = [hit for hit in every if reference in _references(hit[0], hit[2].name)]
    hits = hits or [hit for hit in every if reference in _references(hit[0], str(hit[1]))]
    n_allowed = len({path for path, _, _ in hits}) if channel == "time" and not reference.isdecimal() else 1
    if len(hits) > n_allowed:
        options = " or ".join(f"{path}:{k}" for path, k, _ in hits)
        raise ValueError(f"{channel}={reference} could be any of {len(hits)} columns; write {options}")
    if not hits:
        close = difflib.get_close_matches(reference, names_of(files), n=1, cutoff=0.5)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise ValueError(f"{channel}: there is no column {reference!r} among {_listing(files)}{hint}")
    for _, _, column in hits:
        if column.fault or not column.samples.size:
            fault = f": {column.fault}" if column.fault else " is empty"
            raise ValueError(f"{channel}: {column.file.name}, column {column.name}{fault}")
    return [column for _, _, column in hits]


def _references(path: Path, name: str) -> set[str]:
    return {name, f"{path}:{name}", f"{path.name}:{name}", f"{path.stem}:{name}"}
