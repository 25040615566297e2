"""Contents of HDF5, MATLAB and TDMS files, as plain values and arrays; `isolated` runs this in a process of its own."""

import contextlib
import logging
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from foten.datasets.columns import Column, check_width, columns_of_array, reading, with_units
from foten.datasets.isolated import Contents, contents_of
from foten.dsp import Array
from foten.untrusted import check_content, max_content, printable, too_much

MAX_OBJECTS, MAX_DEPTH = 10_000, 32  # groups and datasets of a file; groups in one another
MAX_TEXTS = 64  # of an attribute or a dataset; those of units have one for each column
_UNITS = ("unit_string", "NI_UnitDescription", "NI_Unit", "unit", "units", "Unit", "Units")
"""Properties in which programs state the unit of a TDMS channel; LabVIEW's waveforms have the first."""


def hdf5_contents(path: Path) -> Contents:
    """Contents of an HDF5 file, `{"attributes": …, "objects": […]}`, objects in the order of their names.

    An object has a name, attributes, and, where it is a dataset, the index of its array, its texts, or a fault. Links are left
    out and samples in other files not read: they could lead to any file of this machine.
    """
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        fault = "truncated: its end is missing" if "truncated" in str(error) else "not an HDF5 file, or is damaged"
        raise ValueError(f"{path.name} is {fault}") from None
    arrays: list[Array] = []
    objects: list[dict[str, Any]] = []
    content = 0  # bytes
    with file:
        for name in _names(file, path):
            item = file[name]
            entry: dict[str, Any] = {"name": printable(name), "attributes": _attributes(item)}
            objects.append(entry)
            if isinstance(item, h5py.Dataset):
                entry |= _unread(item, content, max_content(path))
                if not {"fault", "texts"} & entry.keys():
                    array = np.asarray(item[()], dtype=np.float64)
                    entry["array"] = len(arrays)
                    arrays.append(array)
                    content += array.nbytes
        return {"attributes": _attributes(file), "objects": objects}, arrays


def _names(file: h5py.File, path: Path) -> list[str]:
    """Names of the groups and datasets of a file, each once, whatever groups hold each other; ValueError beyond a bound."""
    names: list[str] = []

    def listed(name: str) -> bool | None:
        names.append(name)
        return True if len(names) > MAX_OBJECTS or name.count("/") > MAX_DEPTH else None  # which ends the visit

    if file.visit(listed):
        what = f"{MAX_OBJECTS} groups and datasets, or {MAX_DEPTH} groups in one another"
        raise ValueError(f"{path.name} holds more than {what}; copy what you import into another file")
    return names


def _unread(item: Any, content: int, limit: int) -> dict[str, Any]:
    """Fault for which a dataset is not read, or its texts; nothing where it holds numbers."""
    if item.is_virtual or item.id.get_create_plist().get_external_count():
        return {"fault": "keeps its samples in another place, which is not opened"}
    try:
        kind, is_text = item.dtype.kind, h5py.check_string_dtype(item.dtype) is not None
    except TypeError:  # a type that NumPy does not have
        kind, is_text = "O", False
    if is_text and item.shape is not None and item.size <= MAX_TEXTS:
        return {"texts": [_plain(text) for text in np.atleast_1d(item[()]).ravel()]}
    if kind not in "biuf" or item.shape is None:
        return {"fault": "holds no plain numbers"}
    if content + 8 * item.size > limit:
        return {"fault": too_much(content + 8 * item.size, limit)}
    return {}


def _attributes(item: Any) -> dict[str, Any]:
    """Texts and numbers among the attributes of an object."""
    plain = {}
    for name in item.attrs:
        if item.attrs.get_id(name).get_storage_size() <= 1 << 20:
            with contextlib.suppress(TypeError, OverflowError, ValueError):  # a type that NumPy does not have
                plain[printable(name)] = _plain(item.attrs[name])
    return {name: value for name, value in plain.items() if value is not None}


def _plain(value: Any) -> Any:
    """An attribute as text, a number, or a list of a few texts; None for anything else."""
    if isinstance(value, np.ndarray):
        if value.size > 1 and value.dtype.kind in "OSU":
            return [text for text in map(_plain, value.ravel()[:MAX_TEXTS]) if isinstance(text, str)]
        return _plain(value.ravel()[0]) if value.size else ""
    if isinstance(value, bytes):
        value = value.decode("utf-8", errors="replace").rstrip("\0")
    if isinstance(value, str):
        return "\n".join(printable(line) for line in value.split("\n"))
    if isinstance(value, np.number | bool | int | float) and np.isrealobj(value):
        return float(value)
    return None


def matlab_contents(path: Path) -> Contents:
    """Variables of a .mat file, v5 to v7.3, as `contents_of` columns; fields of structs are `struct.field`."""
    from pymatreader import read_mat
    from scipy.io import whosmat

    columns: list[Column] = []
    texts: dict[str, Any] = {}
    if h5py.is_hdf5(path):
        with h5py.File(path, "r") as file:
            sizes = [file[name].size or 0 for name in _names(file, path) if isinstance(file[name], h5py.Dataset)]
    else:
        sizes = [np.prod(shape, dtype=object) for _, shape, _ in whosmat(path)]
    check_content(path, 8 * sum(sizes))
    waiting: list[tuple[str, Any]] = [("", read_mat(str(path)))]
    while waiting:
        name, value = waiting.pop()
        if isinstance(value, dict):
            # Of HDF5 they come in the order of a set, which differs from run to run.
            names = sorted(value) if h5py.is_hdf5(path) else value
            fields = [key for key in names if not key.startswith(("__", "#"))]
            waiting += [(f"{name}.{key}" if name else key, value[key]) for key in reversed(fields)]
            continue
        if isinstance(value, bytes | str) or (isinstance(value, list) and all(isinstance(v, str) for v in value)):
            texts[printable(name)] = _plain(np.array(value))
        if isinstance(value, list | str | bytes) or value is None:
            columns.append(Column(name, fault="holds text or cells, expected numbers"))
        else:
            columns += columns_of_array(name, np.asarray(value))
            check_width(path.name, len(columns))
    check_content(path, sum(column.samples.nbytes for column in columns))  # of structs too, whose sizes are not listed
    return contents_of(with_units(columns, texts))


def tdms_contents(path: Path) -> Contents:
    """Channels of a TDMS file as `contents_of` columns: by their names, or `GROUP/CHANNEL` where two groups share a name."""
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
