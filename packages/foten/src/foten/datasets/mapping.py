"""Mapping of columns to channels, by the user or by unambiguous headers."""

import difflib
import re
import shlex
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from foten.datasets.columns import Column
from foten.datasets.options import ImportOptions
from foten.datasets.timing import rate_of, rises
from foten.datasets.units import CLOCK, FACTORS, WORDS, canonical, factor_of, quantity, split_header
from foten.recording.recording import AXES, UNITS

Files = Mapping[Path, list[Column]]

_HEADERS = {kind: words.split() for kind, words in WORDS["headers"].items()}
_AXES = {axis: words.split() for axis, words in WORDS["axes"].items()}
_OF_AXIS = re.compile(
    rf"(?P<name>|.*[ _.-]|.*[a-z](?=[XYZ]$))(?P<axis>(?i:{'|'.join(map(re.escape, chain(*_AXES.values())))}))"
)
_NOT_NORMAL = ("fric", "reib", "frott", "tang", "shear", "scher", "later", "quer")
"""Beginnings of words, of a force that is not the normal one."""
_IN_ORDER = (("acceleration", 3), ("position", 2))
"""Columns of a quantity that are its axes in order where none names an axis."""

_GUESSES: Mapping[str, frozenset[str]] = {
    **{kind: frozenset(_HEADERS[kind]) for kind in ("time", "acceleration", "speed")},
    "force": frozenset(_HEADERS["force"] + _HEADERS["normal_force"]),
    **{
        f"{kind}_{axis}": frozenset(
            {f"{name}{mark}{word}" for name in _HEADERS[kind] for mark in ("_", "", ".") for word in _AXES[axis]}
            | {f"{name}.{AXES.index(axis)}" for name in _HEADERS[kind] if len(name) > 1}
        )
        for kind in ("acceleration", "position", "force")
        for axis in AXES
    },
}
"""Headers in small letters, by channel."""

_STROKE: Mapping[str, frozenset[str]] = {
    **{channel: _GUESSES[channel] for channel in ("time", "speed", "force")},
    **{f"position_{axis}": _GUESSES[f"position_{axis}"] | {axis} for axis in "xy"},
    "pressure": frozenset({"pressure"}),
}
"""Headers of a stroke's table."""


def guessed_mapping(files: Files, options: ImportOptions) -> tuple[tuple[str, str], ...]:
    """Mapping by the headers alone; ValueError where they are ambiguous."""
    places = _by_headers(files)
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


def added_mapping(files: Files, mapping: Sequence[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    """What the headers say without doubt of the quantities that a mapping leaves out."""
    mapped = {quantity(channel) for channel, _ in mapping}
    mapped |= {"speed", "position"} if mapped & {"speed", "position"} else set()
    taken = {id(column) for channel, reference in mapping for column in columns_of(files, channel, reference)}
    places = {
        channel: [column for column in columns if id(column) not in taken]
        for channel, columns in _by_headers(files).items()
        if quantity(channel) not in mapped and (channel != "time" or len(files) == 1)
    }
    doubtful = {quantity(channel) for channel, columns in places.items() if len(columns) != 1}
    return tuple(
        (channel, name_of(files, columns[0]))
        for channel, columns in places.items()
        if quantity(channel) not in doubtful
    )


def guesses_of_missing(files: Files, mapping: Sequence[tuple[str, str]]) -> dict[str, str]:
    """Columns that may be acceleration, speed or force by their units or else names, by quantity, each with the --map to add."""
    taken = {id(column) for channel, reference in mapping for column in columns_of(files, channel, reference)}
    others = [c for columns in files.values() for c in columns if id(c) not in taken and c.n_rows > 1 and not c.fault]
    guesses = {}
    for kind in ("acceleration", "speed", "force"):
        could = _candidates(others, kind)
        if kind == "speed":
            could += _candidates(others, "position")
            named = {column.name.lower(): column for column in others if not column.unit}
            could += [{f"position_{axis}": named[axis] for axis in "xy"}] if {"x", "y"} <= named.keys() else []
        known = tuple(word for word in _GUESSES[kind] if len(word) > 1 or kind == "force")
        normal = [c for c in others if not any(word in c.name.lower() for word in _NOT_NORMAL)]
        could = could or [{kind: column} for column in normal if column.name.lower().startswith(known)]
        if could:
            names = (" and ".join(name_of(files, column) for column in channels.values()) for channels in could[:3])
            guesses[kind] = f"it may be {' or '.join(names)}: add {' or '.join(_option(files, c) for c in could[:3])}"
    return guesses


def _option(files: Files, channels: Mapping[str, Column]) -> str:
    """Option --map of some channels, to copy."""
    return f"--map {shlex.quote(','.join(f'{name}={name_of(files, column)}' for name, column in channels.items()))}"


def _axis(column: Column, kind: str) -> tuple[str, str]:
    """Name without its axis, and x, y or z: `Load X [gf]`, `LoadX`, `load_x` → `load`, `x`; no axis where the name has none."""
    name = split_header(column.name, kind)[0]
    match = _OF_AXIS.fullmatch(name)
    axis = match and next((axis for axis in AXES if match["axis"].lower() in _AXES[axis]), None)
    return (match["name"].strip(" _.-").lower(), axis) if match and axis else (name.lower(), "")


def _candidates(columns: Sequence[Column], kind: str) -> list[dict[str, Column]]:
    """Columns in units of a quantity by channel: the axes of one name together, others each by itself."""
    groups: dict[str, dict[str, Column]] = {}
    for column in columns:
        if _is(column, kind):
            name, axis = ("", "") if kind == "speed" else _axis(column, kind)
            key = name if axis and f"{kind}_{axis}" not in groups.get(name, {}) else f"{name} {id(column)}"
            groups.setdefault(key, {})[f"{kind}_{axis}" if axis else kind] = column
    channels = [{channel: group[channel] for channel in UNITS if channel in group} for group in groups.values()]
    return [group for group in channels if kind != "position" or {"position_x", "position_y"} <= group.keys()]


def _by_headers(files: Files) -> dict[str, list[Column]]:
    """Columns by the channel that their headers name, and those whose unit leaves no doubt where no header names its quantity."""
    usable = [column for columns in files.values() for column in columns if column.n_rows > 1]
    places: dict[str, list[Column]] = {}
    for column in usable:
        for channel, aliases in _GUESSES.items():
            if _header(column, channel) in aliases:
                places.setdefault(channel, []).append(column)
    named = {id(column) for columns in places.values() for column in columns}
    others = [column for column in usable if not column.fault and id(column) not in named]
    there = set(map(quantity, places))
    if (
        "time" not in there
        and len(clocks := [c for c in others if c.unit == CLOCK or (_is(c, "time") and rises(c))]) == 1
    ):
        places["time"] = clocks
    for kind in ("acceleration", "force", "speed", "position"):
        if kind in there or ("speed" in places and kind == "position") or ("position" in there and kind == "speed"):
            continue
        candidates = _candidates(others, kind)
        measured = [column for column in others if _is(column, kind)]
        if len(candidates) == 1:
            places |= {channel: [column] for channel, column in candidates[0].items()}
        elif (kind, len(measured)) in _IN_ORDER and not any(_axis(column, kind)[1] for column in measured):
            places |= {f"{kind}_{axis}": [column] for axis, column in zip(AXES, measured, strict=False)}
    return places


def by_unit(files: Files, mapping: Sequence[tuple[str, str]]) -> list[str]:
    """Names of the columns of a mapping of which no header says what they are, but their unit."""
    columns = [(name, channel, columns_of(files, channel, name)[0]) for channel, name in mapping]
    return [
        name
        for name, channel, column in columns
        if _is(column, quantity(channel)) and _header(column, channel) not in _GUESSES[channel]
    ]


def _is(column: Column, kind: str) -> bool:
    """Whether a column's unit is of a quantity; not a force that is not the normal one."""
    unit = canonical(column.unit or split_header(column.name, kind)[1])
    if kind == "force" and any(word in column.name.lower() for word in _NOT_NORMAL):
        return False
    return unit in FACTORS[kind]


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
    """Example of a mapping: columns whose headers or units say what they are, then those of which nothing is known."""
    usable = {name_of(files, c): c for columns in files.values() for c in columns if c.n_rows > 1 and not c.fault}
    places = _by_headers(files)
    named = {channel: name_of(files, columns[0]) for channel, columns in places.items()}
    known = {name_of(files, column) for columns in places.values() for column in columns}
    others = [name for name in usable if name not in known]
    clocks = [name for name in others if rises(usable[name]) and not _unit(usable[name])]
    if "time" not in named and clocks:
        named["time"] = clocks[0]
        others.remove(clocks[0])
    there = set(map(quantity, named))
    for kind in ("acceleration", "speed", "force"):
        if kind not in there and (kind, "position") != ("speed", *there & {"position"}):
            unknown = [name for name in others if not _unit(usable[name]) or _is(usable[name], kind)]
            named[kind] = unknown[0] if unknown else "COLUMN"
            others = [name for name in others if name != named[kind]]
    pairs = [(channel, named[channel]) for channel in _GUESSES if channel in named]
    return shlex.quote(",".join(f"{channel}={name}" for channel, name in pairs))


def _unit(column: Column) -> str:
    """Unit that a column states of itself, of whatever quantity."""
    return column.unit or next((unit for kind in FACTORS if (unit := split_header(column.name, kind)[1])), "")


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
