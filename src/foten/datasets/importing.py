"""From columns of files to a Recording: which column is which channel, in what unit, at what rate.

Nothing is resampled or padded. Every conversion and every filled gap is written into the recording's history.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.datasets import DATASETS
from foten.datasets.bounds import check_length, check_size
from foten.datasets.columns import Column
from foten.datasets.gaps import bridged, filled
from foten.datasets.mapping import clocks_of, column_of, guessed_mapping, name_of
from foten.datasets.options import ImportOptions, parse_pairs, parse_rates
from foten.datasets.timing import irregular, rate_and_source, times_of
from foten.datasets.units import FACTORS, factor_of, quantity
from foten.recording.recording import LIMITS, UNITS, Channel, Recording
from foten.untrusted import check_regular

__all__ = ["Import", "ImportOptions", "import_recording", "parse_pairs", "parse_rates", "read_columns"]

_USUAL: Mapping[str, float] = {"speed": 400.0, "acceleration": 100.0, "force": 3.0, "position": 300.0}
"""What the largest value of a usual recording is about; only to guess which unit was meant."""
_OFTEN = ("mg", "mm/s^2", "um", "um/s", "mN", "gf")
"""Units in which numbers come out too large; of them too it is guessed."""

SHORTEST_S = 0.1
SLOWEST_HZ = 40.0  # of an acceleration: half of it is the lowest frequency that training keeps


@dataclass(frozen=True)
class Import:
    """A recording, and what was decided on the way: sentences for the user."""

    recording: Recording
    decisions: tuple[str, ...]


def read_columns(path: Path) -> list[Column]:
    """Return the columns of any file that `DATASETS` can read.

    Raises:
        FileNotFoundError: there is none.
        ValueError: unknown extension, a pickle, or a bad file.
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
    return DATASETS[suffix](path)


@np.errstate(over="ignore", invalid="ignore")  # infinite and absurd samples are refused, in a sentence
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
        mapping = guessed_mapping(files, options)
        decisions += [f"taken from the headers: --map {','.join(f'{k}={v}' for k, v in mapping)}"]
        taken = {reference for _, reference in mapping}
        names = [name_of(files, path, c) for path, columns in files.items() for c in columns]
        decisions += (
            [f"left out: {', '.join(name for name in names if name not in taken)}"] if set(names) - taken else []
        )
    picked: dict[str, tuple[Path, Column]] = {}
    clocks: list[tuple[Path, Column]] = []
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
    digests = {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in {p for p, _ in picked.values()}}
    samples: dict[str, NDArray[np.float64]] = {}
    times: dict[str, NDArray[np.float64] | None] = {}
    rates: dict[str, float] = {}
    for channel, (path, column) in picked.items():
        history.append(f"{channel} is column {column.name} of {path.name} (sha256 {digests[path][:16]})")
        if column.n_blank:
            history.append(f"{channel} ends {column.n_blank} rows before the table does")
        factor, said = factor_of(channel, column.name, column.unit, options.units.get(channel))
        history += [said] if said else []
        samples[channel] = column.samples if factor == 1 else column.samples * factor
        times[channel], said = times_of(channel, path, column, clocks, options)
        history += [said] if said and said not in history else []
        rates[channel], said = rate_and_source(channel, path, column, times[channel], options, files[path])
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
            kept = irregular(clock, rates[channel])
            if kept:
                history.append(f"{channel} keeps its own times: {kept}")
            else:
                clock = None
        values, said = filled(channel, samples[channel], clock, rates[channel], options.fill_gaps_ms)
        history += [said] if said else []
        channels[channel], said = bridged(channel, Channel(values, rates[channel], clock), options.fill_gaps_ms)
        history += [said] if said else []
    for channel, one in channels.items():
        if quantity(channel) == "acceleration" and one.rate_hz < SLOWEST_HZ and not options.force_units:
            slow = f"{channel} has a rate of {one.rate_hz:g} Hz, too slow for any vibration"
            in_ms = "was the time given in ms? Then: --unit time=ms"
            hint = "is the rate right?" if times[channel] is None else in_ms
            raise ValueError(f"{slow}; {hint} (--force-units imports it)")
    _check_overlap(channels)
    for channel, one in channels.items():
        check_size(channel, one.samples)
        check_length(channel, one)
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
        decisions.append("there is no acceleration: strokes can be rendered from this recording, nothing learned")
    elif not {"speed", "position"} & kinds or "force" not in kinds:
        decisions.append("without speed (or position) and force nothing can be learned from this recording")
    recording = Recording(
        channels, options.texture, options.tool, options.sensors, options.notes, history=tuple(history)
    )
    return Import(recording, tuple(decisions))


def _for_axes(options: ImportOptions, picked: Mapping[str, object]) -> ImportOptions:
    """Return the options with the unit and rate of a quantity given to its axes, where those are mapped and it is not."""

    def spread(given: Mapping[str, Any]) -> dict[str, Any]:
        by_axis: dict[str, Any] = {}
        for channel, value in given.items():
            axes = [name for name in picked if quantity(name) == channel and name != channel]
            by_axis.update(dict.fromkeys(axes if axes and channel not in picked else [channel], value))
        return by_axis | {channel: value for channel, value in given.items() if channel in picked}

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


def _check_overlap(channels: Mapping[str, Channel]) -> None:
    spans = {
        name: (float(c.times_s[0]) if c.times_s is not None else 0.0, c.duration_s) for name, c in channels.items()
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
        return f"{what}; {beyond.size} samples beyond {LIMITS[kind]:g} {unit} were let through (--force-units)"
    if beyond.size <= 0.01 * size.size:
        raise ValueError(
            f"{what}, beyond any hand ({LIMITS[kind]:g} {unit}), in {beyond.size} of {size.size} samples: "
            "spikes? --force-units imports them as they are, and foten inspect shows where"
        )
    large = float(np.quantile(size, 0.99))
    usual = {unit: factor for unit, factor in FACTORS[kind].items() if unit in _OFTEN or unit == UNITS[channel]}
    likely = min(usual.items(), key=lambda item: abs(np.log(large * item[1] / _USUAL[kind])))
    guess = (
        f"was it given in {likely[0]}? Then: --unit {channel}={likely[0]}"
        if likely[1] != 1
        else f"a raw sensor reading? Give its sensitivity: --unit {channel}=V*FACTOR"
    )
    raise ValueError(f"{what}, expected below {LIMITS[kind]:g} {unit}; {guess} (--force-units imports it all the same)")
