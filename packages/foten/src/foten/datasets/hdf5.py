"""Our own recording file: HDF5 that MATLAB, LabVIEW or Python can also write; its layout is in docs/tutorials/recordings.md.

The same recording always gives the same bytes.
"""

import contextlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.atomic_write import atomic_write
from foten.datasets.bounds import check_length, check_size
from foten.datasets.isolated import read_isolated
from foten.recording.recording import RELATIVE, UNITS, Channel, Recording, counted, joined_takes
from foten.untrusted import check_numbers, parse_json

FORMAT = "foten-recording"
VERSION = 1
MAX_OBJECTS = 10_000  # groups and datasets that a reader takes
MAX_TEXT_BYTES = 60_000  # bytes; HDF5 has room for 65,536 in an attribute and its name
_TEXTS = ("texture", "tool", "sensors", "notes")


def write_recording(recording: Recording, path: Path) -> None:
    """Write a recording, whole or not at all; ValueError where a text is too long."""
    import h5py

    texts = {key: getattr(recording, key) for key in _TEXTS} | {"history": "\n".join(recording.history)}
    if recording.simulation is not None:
        texts["simulation"] = json.dumps(dict(recording.simulation), sort_keys=True)
    for key, text in texts.items():
        if len(text.encode()) > MAX_TEXT_BYTES:
            raise ValueError(f"{key} has {len(text.encode()):,} bytes, expected {MAX_TEXT_BYTES:,} at most")
    if (n := sum(2 * len(take.channels) + 3 for take in recording.takes)) > MAX_OBJECTS:
        raise ValueError(f"{len(recording.takes)} takes are too many, about {n} groups of {MAX_OBJECTS} at most")
    # Made in memory, since HDF5 does not survive a full disk.
    with h5py.File("in memory", "w", driver="core", backing_store=False) as file:
        file.attrs.update(
            {"format": FORMAT, "version": VERSION} | texts | ({"microphone": 1} if recording.microphone else {})
        )
        for i, take in enumerate(recording.takes, 1):
            group = file if i == 1 else file.create_group(f"takes/{i}")
            if i > 1:
                group.attrs["history"] = "\n".join(take.history)
            if take.name:
                group.attrs["name"] = take.name
            for name, channel in sorted(take.channels.items()):
                dataset = _store(group, f"channels/{name}", channel.samples)
                dataset.attrs["rate_hz"], dataset.attrs["unit"] = float(channel.rate_hz), recording.unit(name)
                if channel.times_s is not None:
                    _store(group, f"times_s/{name}", channel.times_s)
        file.flush()
        image = bytes(file.id.get_file_image())
    with atomic_write(path) as part:
        part.write_bytes(image)


def _store(file: Any, name: str, samples: NDArray[Any]) -> Any:
    options = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "track_times": False}
    return file.create_dataset(name, data=samples, **options)


def load_recording(path: Path) -> Recording:
    """Recording in a file of ours; ValueError for another format or version, a damaged file, or absurd content."""
    name = path.name
    if path.exists() and path.suffix.lower() not in (".h5", ".hdf5"):
        raise ValueError(
            f"{name} is not a foten recording (.h5); first run: foten import {quote(str(path))} -o {quote(path.stem + '.h5')}"
        )
    contents, arrays = read_isolated("HDF5", path)
    attributes = contents["attributes"]
    if attributes.get("format") != FORMAT:
        run = f"first run: foten import {quote(str(path))} -o {quote(path.stem + '-foten.h5')}"
        raise ValueError(f"{name} is HDF5 but not a foten recording (attribute format is not {FORMAT!r}); {run}")
    version = _number(attributes.get("version"))
    if version != VERSION:
        raise ValueError(f"{name} has version {version:g}, expected {VERSION}; a newer foten may read it")
    objects = {entry["name"]: entry for entry in contents["objects"]}
    names = {place.split("/")[1] for place in objects if place.startswith("takes/")}
    numbers = list(range(2, len(names) + 2))
    if names != set(map(str, numbers)):
        raise ValueError(f"{name}: takes are {', '.join(sorted(names))[:60]}, expected 2, 3 and so on without a gap")
    channels, calibrated = _channels(objects, arrays, name)
    texts = {key: str(attributes.get(key, "")) for key in (*_TEXTS, "name")}
    later = []
    for number in numbers:
        of_take, same_unit = _channels(objects, arrays, f"{name}, take {number}", f"takes/{number}/")
        about = objects.get(f"takes/{number}", {}).get("attributes", {})
        take = Recording(of_take, texts["texture"], history=_lines(about), calibrated=same_unit)
        later.append(replace(take, name=str(about.get("name", ""))))
    recording = Recording(channels, **texts, history=_lines(attributes), calibrated=calibrated)  # type: ignore[arg-type]
    microphone = not calibrated or bool(attributes.get("microphone"))  # relative units are a microphone's
    return replace(recording, simulation=_simulation(attributes, name), later_takes=tuple(later), microphone=microphone)


def load_takes(paths: Sequence[Path]) -> Recording:
    """Recording in one file, or in several that are takes of the same surface, each named as its file is."""
    recordings = [load_recording(path) for path in paths]
    if len(recordings) > 1:
        named = zip(recordings, paths, strict=True)
        recordings = [replace(of, name=of.name or path.name) for of, path in named]
    return joined_takes(recordings)


def _channels(
    objects: Mapping[str, Any], arrays: list[NDArray[np.float64]], name: str, place: str = ""
) -> tuple[dict[str, Channel], bool]:
    """Channels of a take, and whether its acceleration is calibrated."""
    channels, calibrated = {}, True
    for path, entry in objects.items():
        folder, _, channel = path.rpartition("/")
        if folder != f"{place}channels":
            continue
        where = f"{name}, channel {channel}"
        if channel not in UNITS:
            raise ValueError(f"{where}: unknown, expected one of {', '.join(UNITS)}")
        of_channel = entry.get("attributes", {})
        unit = of_channel.get("unit", "")
        if unit == RELATIVE and channel.startswith("acceleration"):
            calibrated = False
        elif unit != UNITS[channel] and "fault" not in entry:
            raise ValueError(f"{where}: unit is {unit!r}, expected {UNITS[channel]!r}; convert the samples")
        samples = _vector(entry, arrays, where)
        rate_hz = _number(of_channel.get("rate_hz"))
        if not np.isfinite(rate_hz) or rate_hz <= 0:
            raise ValueError(f"{where}: attribute rate_hz is missing or is not a positive number")
        times = None
        if (of_times := f"{place}times_s/{channel}") in objects:
            times = _vector(objects[of_times], arrays, f"{where}, times_s")
            if times.size != samples.size:
                raise ValueError(f"{where}: {times.size} times for {samples.size} samples")
            back = np.flatnonzero(np.diff(times) <= 0)
            if back.size:
                raise ValueError(f"{where}: the time does not increase at sample {back[0] + 1}")
        channels[channel] = Channel(samples, rate_hz, times)
        check_length(where, channels[channel])
    if not channels:
        raise ValueError(f"{name} has no channel: the group /{place}channels is missing or empty")
    return channels, calibrated


def _lines(attributes: Mapping[str, Any]) -> tuple[str, ...]:
    """History in attributes, a sentence each."""
    return tuple(line for line in str(attributes.get("history", "")).split("\n") if line)


def _simulation(attributes: Mapping[str, Any], name: str) -> dict[str, Any] | None:
    if "simulation" not in attributes:
        return None
    with contextlib.suppress(ValueError):
        simulation = parse_json(str(attributes["simulation"]))
        check_numbers(simulation, "it")
        if isinstance(simulation, dict):
            return simulation
    raise ValueError(f"{name}: attribute simulation is not a JSON object")


def _vector(entry: Mapping[str, Any], arrays: list[NDArray[np.float64]], where: str) -> NDArray[np.float64]:
    if "fault" in entry:
        raise ValueError(f"{where}: {entry['fault']}")
    if "array" not in entry:
        raise ValueError(f"{where}: expected a dataset of numbers")
    samples = arrays[entry["array"]]
    if samples.size == 0 or samples.size != max(samples.shape, default=0):
        raise ValueError(f"{where}: has shape {samples.shape}, expected (n,) with n > 0")
    samples = samples.ravel()
    bad = np.flatnonzero(~np.isfinite(samples))
    if bad.size:
        raise ValueError(f"{where}: {counted(bad.size, 'sample')} NaN or infinite, the first is sample {bad[0]}")
    check_size(where, samples)
    return samples


def _number(value: Any) -> float:
    return value if isinstance(value, float) else float("nan")
