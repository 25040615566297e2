"""NumPy, MATLAB, HDF5, TDMS and WAV files as columns; ValueError where one is truncated, foreign, or holds pickled objects."""

from __future__ import annotations

import logging
import math
import warnings
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.datasets.columns import Column, check_width, columns_of_array, reading, with_units
from foten.datasets.hdf5 import FORMAT
from foten.datasets.isolated import Contents, contents_of, isolated_columns, read_isolated
from foten.datasets.units import FULL_SCALE
from foten.untrusted import check_content

_PICKLE = "holds pickled objects, which can run code when opened; save plain arrays of numbers instead"
_UNITS = ("unit_string", "NI_UnitDescription", "NI_Unit", "unit", "units", "Unit", "Units")
"""Properties in which programs state the unit of a TDMS channel; LabVIEW's waveforms have the first."""


def read_numpy(path: Path) -> list[Column]:
    """Arrays of an .npz, or the columns of an .npy."""
    columns: list[Column] = []
    texts: dict[str, Any] = {}
    content = 0  # bytes
    with reading(path, "NumPy file"), path.open("rb") as file:
        if not zipfile.is_zipfile(file):
            file.seek(0)
            array = _array(file, path.stat().st_size, content, path)
            columns = columns_of_array("" if array.ndim == 2 else "0", array)
            return [replace(column, name=column.name.lstrip(".")) for column in columns]
        with zipfile.ZipFile(file) as archive:
            check_width(path.name, len(archive.infolist()))
            for entry in archive.infolist():
                with archive.open(entry) as inner:
                    array = _array(inner, entry.file_size, content, path)
                content += array.size * _item_bytes(array.dtype)
                name = entry.filename.removesuffix(".npy")
                if array.dtype.kind == "U" and array.size <= 64:
                    texts[name] = array.ravel().tolist() if array.size > 1 else "".join(array.ravel())
                columns += columns_of_array(name, array)
    return with_units(columns, texts)


def _array(file: Any, size: int, content: int, path: Path) -> NDArray[Any]:
    """Array in an .npy file of `size` bytes, after `content` of others, if its header says so: NumPy allocates, then reads."""
    version = np.lib.format.read_magic(file)
    header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    shape, by_columns, dtype = header[min(version, (2, 0))](file)
    if dtype.hasobject:
        raise ValueError(f"{path.name} {_PICKLE}")
    count = math.prod(shape)
    if count * dtype.itemsize != size - file.tell():
        raise ValueError(f"its header says {count:,} numbers, and it has {size - file.tell():,} bytes")
    check_content(path, content + count * _item_bytes(dtype))
    array = np.frombuffer(file.read(count * dtype.itemsize), dtype=dtype)
    return array.reshape(shape[::-1]).T if by_columns else array.reshape(shape)


def _item_bytes(dtype: np.dtype[Any]) -> int:
    """Bytes of an item, whose numbers become float64."""
    fields = [_item_bytes(dtype.base[name]) for name in dtype.base.names or ()]
    return math.prod(dtype.shape) * (sum(fields) or max(8, dtype.base.itemsize))


def read_matlab(path: Path) -> list[Column]:
    """Variables of a .mat file, v5 to v7.3; fields of structs are `struct.field`."""
    contents, arrays = read_isolated("MATLAB", path)
    columns = [Column(samples=samples, **of_file) for of_file, samples in zip(contents["columns"], arrays, strict=True)]
    return with_units(columns, contents["texts"])


def read_hdf5(path: Path) -> list[Column]:
    """Datasets of a foreign HDF5 file, by their paths in it; a recording of ours is refused."""
    contents, arrays = read_isolated("HDF5", path)
    if contents["attributes"].get("format") == FORMAT:
        raise ValueError(f"{path.name} is a foten recording already; nothing to import")
    columns: list[Column] = []
    texts: dict[str, Any] = {}
    for entry in [{"name": "", "attributes": contents["attributes"]}, *contents["objects"]]:
        name, attributes = entry["name"], entry.get("attributes", {}).items()
        texts |= {f"{name}/{key}".lstrip("/"): value for key, value in attributes if isinstance(value, str | list)}
        if "array" in entry:
            columns += columns_of_array(name, arrays[entry["array"]])
        elif "texts" in entry:
            texts[name] = entry["texts"] if len(entry["texts"]) > 1 else entry["texts"][0]
            columns.append(Column(name, fault="holds no plain numbers"))
        elif "fault" in entry:
            columns.append(Column(name, fault=entry["fault"]))
    return with_units(columns, texts)


def read_tdms(path: Path) -> list[Column]:
    """Channels of a TDMS file: by their names, or `GROUP/CHANNEL` where two groups share a name.

    The rate is the waveform's (`wf_increment`), the unit the channel's (`unit_string` or the like).
    """
    return isolated_columns("TDMS", path)


def tdms_contents(path: Path) -> Contents:
    """Channels of a TDMS file, as `contents_of` columns."""
    from nptdms import TdmsFile
    from nptdms.log import log_manager

    log_manager.set_level(logging.CRITICAL)  # what it warns of is refused below, in one line
    with reading(path, "TDMS file"):
        file = TdmsFile.read(path)
    status = file.file_status
    lengths = (status.channel_statuses or {}).values()
    if status.incomplete_final_segment or any(status.read_length < status.expected_length for status in lengths):
        raise ValueError(f"{path.name} is truncated: its last segment is incomplete")
    channels = [channel for group in file.groups() for channel in group.channels()]
    check_width(path.name, len(channels))
    names = [channel.name for channel in channels]
    columns = []
    for channel in channels:
        name = channel.name if names.count(channel.name) == 1 else f"{channel.group_name}/{channel.name}"
        samples, stated = np.asarray(channel[:]), channel.properties
        if samples.dtype.kind in "biuf":
            unit = next((str(stated[key]) for key in _UNITS if stated.get(key)), "").strip()
            columns.append(Column(name, samples.astype(np.float64), _rate(stated.get("wf_increment")), unit))
        else:
            columns.append(Column(name, fault="holds text or times, expected numbers"))
    return contents_of(columns)


def _rate(increment_s: Any) -> float | None:
    """Rate of a waveform [Hz]; none where the file states no step or an absurd one."""
    if not isinstance(increment_s, int | float | np.number) or not 1e-12 < increment_s < 1e12:
        return None
    rate = 1 / float(increment_s)
    # The increment is a rounded double: 1/(1/10000) need not be 10000.
    return float(round(rate)) if abs(rate - round(rate)) < 1e-9 * rate else rate


def read_wav(path: Path) -> list[Column]:
    """Tracks of a WAV file, named by number, with its rate; integers become fractions of full scale."""
    from scipy.io import wavfile

    with reading(path, "WAV file"), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Chunk .*not understood", category=wavfile.WavFileWarning)
        warnings.filterwarnings("error", message=".*EOF", category=wavfile.WavFileWarning)
        rate, samples = wavfile.read(path)
        check_content(path, 8 * samples.size)
    unit = FULL_SCALE if samples.dtype.kind in "iu" else ""
    if samples.dtype.kind == "u":
        samples = (samples.astype(np.float64) - 128) / 128
    elif samples.dtype.kind == "i":
        # 24-bit files come left-justified in 32 bits, so the type alone gives full scale.
        samples = samples / -float(np.iinfo(samples.dtype).min)
    tracks = samples.reshape(samples.shape[0], -1)
    if not tracks.size:
        raise ValueError(f"{path.name} has no samples")
    return [Column(str(k), track.astype(np.float64), float(rate), unit) for k, track in enumerate(tracks.T)]
