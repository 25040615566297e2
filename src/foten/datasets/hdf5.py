"""Our own recording file: HDF5 that MATLAB, LabVIEW or Python can also write.

Layout, version 1::

    /                       attributes  format = "foten-recording", version = 1
                                        texture, tool, sensors, notes   text, may be absent
                                        history     text, one sentence a line, may be absent
                                        simulation  JSON text, only in simulated recordings
    /channels/NAME          dataset of n numbers (float32 or float64; n×1 and 1×n are read too)
                            attributes  rate_hz, and unit: that of the table below, spelled so
    /times_s/NAME           dataset of n float64, seconds, only where the capture was irregular

NAME and unit are one of: acceleration, acceleration_x, _y, _z [m/s^2]; speed [mm/s]; position_x, _y, _z [mm];
force, force_x, _y, _z [N]; z is the surface normal. In MATLAB::

    h5create('denim.h5', '/channels/force', numel(f));  h5write('denim.h5', '/channels/force', f(:));
    h5writeatt('denim.h5', '/channels/force', 'rate_hz', 1000);
    h5writeatt('denim.h5', '/channels/force', 'unit', 'N');
    h5writeatt('denim.h5', '/', 'format', 'foten-recording');  h5writeatt('denim.h5', '/', 'version', 1);

The same recording always gives the same bytes.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.atomic_write import atomic_write
from foten.recording.recording import UNITS, Channel, Recording

FORMAT = "foten-recording"
VERSION = 1
_TEXTS = ("texture", "tool", "sensors", "notes")


def write_recording(recording: Recording, path: Path) -> None:
    """Write a recording, under a temporary name until it is whole."""
    import h5py

    with atomic_write(path) as part, h5py.File(part, "w") as file:
        file.attrs["format"], file.attrs["version"] = FORMAT, VERSION
        for key in _TEXTS:
            file.attrs[key] = getattr(recording, key)
        file.attrs["history"] = "\n".join(recording.history)
        if recording.simulation is not None:
            file.attrs["simulation"] = json.dumps(dict(recording.simulation), sort_keys=True)
        # Attributes of an HDF5 object are limited to 64 KiB, of which texts use little.
        for name, channel in sorted(recording.channels.items()):
            dataset = _store(file, f"channels/{name}", _smallest(channel.samples))
            dataset.attrs["rate_hz"], dataset.attrs["unit"] = float(channel.rate_hz), UNITS[name]
            if channel.times_s is not None:
                _store(file, f"times_s/{name}", channel.times_s)


def _store(file: Any, name: str, samples: NDArray[Any]) -> Any:
    return file.create_dataset(
        name, data=samples, compression="gzip", compression_opts=1, shuffle=True, track_times=False
    )


def _smallest(samples: NDArray[np.float64]) -> NDArray[Any]:
    with np.errstate(over="ignore"):
        single = samples.astype(np.float32)
    return single if np.array_equal(single.astype(np.float64), samples) else samples.astype(np.float64)


def open_hdf5(path: Path) -> Any:
    """Return an HDF5 file opened for reading.

    Raises:
        FileNotFoundError: there is none.
        ValueError: empty, truncated, or another format.
    """
    import h5py

    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    if path.is_file() and path.stat().st_size == 0:
        raise ValueError(f"{path.name} is empty")
    try:
        return h5py.File(path, "r")
    except OSError as error:
        if "truncated" in str(error):
            raise ValueError(f"{path.name} is truncated: its end is missing") from None
        raise ValueError(f"{path.name} is not an HDF5 file, or is damaged") from None


def is_recording(path: Path) -> bool:
    """Return whether an HDF5 file says that it is one of our recordings."""
    with open_hdf5(path) as file:
        return _text(file.attrs.get("format", "")) == FORMAT


def load_recording(path: Path) -> Recording:
    """Return the recording in a file: what every command that takes one calls.

    Raises:
        ValueError: another format, with the command that imports it; or a bad file, as `read_recording`.
    """
    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    if path.suffix.lower() not in (".h5", ".hdf5"):
        raise ValueError(
            f"{path.name} is not a foten recording (.h5); first run: foten import {path} -o {path.stem}.h5"
        )
    return read_recording(path)


def read_recording(path: Path) -> Recording:
    """Return the recording that `write_recording`, or a program that keeps to the layout above, wrote.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: another format or version, truncated, a channel, unit, rate, time or sample that cannot
            be.
    """
    with open_hdf5(path) as file:
        try:
            return _read(file, path)
        except OSError as error:  # a damaged chunk shows only when it is read
            raise ValueError(f"{path.name} is damaged ({' '.join(str(error).split())})") from None


def _read(file: Any, path: Path) -> Recording:
    import h5py

    name = path.name
    if _text(file.attrs.get("format", "")) != FORMAT:
        raise ValueError(
            f"{name} is HDF5 but not a foten recording (attribute format is not {FORMAT!r}); "
            f"first run: foten import {path} -o {path.stem}-foten.h5"
        )
    version = _number(file.attrs.get("version"))
    if version != VERSION:
        raise ValueError(f"{name} has version {version:g}, expected {VERSION}; a newer foten may read it")
    group = file.get("channels")
    if not isinstance(group, h5py.Group) or not len(group):
        raise ValueError(f"{name} has no channel: the group /channels is missing or empty")
    channels = {}
    for channel, item in group.items():
        where = f"{name}, channel {channel}"
        if channel not in UNITS:
            raise ValueError(f"{where}: unknown, expected one of {', '.join(UNITS)}")
        unit = _text(item.attrs.get("unit", ""))
        if unit != UNITS[channel]:
            raise ValueError(f"{where}: unit is {unit!r}, expected {UNITS[channel]!r}; convert the samples")
        samples = _vector(item, where)
        rate_hz = _number(item.attrs.get("rate_hz"))
        if not np.isfinite(rate_hz) or rate_hz <= 0:
            raise ValueError(f"{where}: attribute rate_hz is missing or is not a positive number")
        times = None
        if f"times_s/{channel}" in file:
            times = _vector(file[f"times_s/{channel}"], f"{where}, times_s")
            if times.size != samples.size:
                raise ValueError(f"{where}: {times.size} times for {samples.size} samples")
            back = np.flatnonzero(np.diff(times) <= 0)
            if back.size:
                raise ValueError(f"{where}: the time does not increase at sample {back[0] + 1}")
        channels[channel] = Channel(samples, rate_hz, times)
    texts = {key: _text(file.attrs.get(key, "")) for key in _TEXTS}
    history = tuple(line for line in _text(file.attrs.get("history", "")).split("\n") if line)
    simulation = None
    if "simulation" in file.attrs:
        try:
            simulation = json.loads(_text(file.attrs["simulation"]))
        except json.JSONDecodeError:
            simulation = None
        if not isinstance(simulation, dict):
            raise ValueError(f"{name}: attribute simulation is not a JSON object")
    return Recording(channels, **texts, simulation=simulation, history=history)


def _vector(item: Any, where: str) -> NDArray[np.float64]:
    import h5py

    if not isinstance(item, h5py.Dataset) or item.dtype.kind not in "iuf" or item.shape is None:
        raise ValueError(f"{where}: expected a dataset of numbers")
    if item.size == 0 or item.size != max(item.shape, default=0):
        raise ValueError(f"{where}: has shape {item.shape}, expected (n,) with n > 0")
    samples = item[()].astype(np.float64).reshape(-1)
    bad = np.flatnonzero(~np.isfinite(samples))
    if bad.size:
        raise ValueError(f"{where}: {bad.size} samples are NaN or infinite, the first at {bad[0]}")
    return samples


def _text(value: Any) -> str:
    """Return an HDF5 text attribute as str; MATLAB and C write bytes or arrays of one."""
    if isinstance(value, np.ndarray):
        value = value.reshape(-1)[0] if value.size else ""
    if isinstance(value, bytes):
        return value.decode("utf-8", errors="replace").rstrip("\0")
    return str(value)


def _number(value: Any) -> float:
    try:
        return float(np.asarray(value).reshape(-1)[0])
    except (TypeError, ValueError, IndexError):
        return float("nan")
