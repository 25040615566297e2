"""NumPy, MATLAB and HDF5 files as columns. Nothing here unpickles: a pickle runs code when it is opened."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.datasets.columns import MOST_SAMPLES, Column, columns_of_array, with_units
from foten.datasets.isolated import read_isolated
from foten.untrusted import brief, check_regular

_PICKLE = "holds pickled objects, which can run code when opened; save plain arrays of numbers instead"


def read_numpy(path: Path) -> list[Column]:
    """Return the arrays of an .npz, or the columns of an .npy.

    Raises:
        ValueError: empty, truncated, foreign, or pickled objects within.
    """
    check_regular(path)
    size = path.stat().st_size
    if size == 0:
        raise ValueError(f"{path.name} is empty")
    columns: list[Column] = []
    texts: dict[str, Any] = {}
    left = MOST_SAMPLES
    try:
        with path.open("rb") as file:
            if not zipfile.is_zipfile(file):
                file.seek(0)
                array = _array(file, size, left)
                columns = columns_of_array("" if array.ndim == 2 else "0", array)
                return [Column(c.name.lstrip("."), c.samples, fault=c.fault) for c in columns]
            with zipfile.ZipFile(file) as archive:
                for entry in archive.infolist():
                    with archive.open(entry) as inner:
                        array = _array(inner, entry.file_size, left)
                    left -= array.size
                    name = entry.filename.removesuffix(".npy")
                    if array.dtype.kind == "U" and array.size <= 64:
                        texts[name] = array.ravel().tolist() if array.size > 1 else "".join(array.ravel())
                    columns += columns_of_array(name, array)
    except MemoryError:
        raise ValueError(f"{path.name} says that it holds more than the memory does") from None
    except Exception as error:  # a damaged file raises a dozen kinds, zlib.error and NotImplementedError among them
        if _PICKLE in str(error):
            raise ValueError(f"{path.name} {_PICKLE}") from None
        raise ValueError(f"{path.name} is truncated or is no NumPy file ({brief(error)})") from None
    if not columns:
        raise ValueError(f"{path.name} holds no array")
    return with_units(columns, texts)


def _array(file: Any, size: int, left: int) -> NDArray[Any]:
    """Return the array in the .npy format of a file of so many bytes, if it holds what its header says.

    NumPy makes room for what a header says before it reads.
    """
    version = np.lib.format.read_magic(file)
    header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    shape, by_columns, dtype = header[min(version, (2, 0))](file)
    if dtype.hasobject:
        raise ValueError(_PICKLE)
    count = math.prod(shape)
    if count * dtype.itemsize != size - file.tell():
        raise ValueError(f"its header says {count:,} numbers, and it has {size - file.tell():,} bytes")
    if count > left:
        raise ValueError(f"it holds {count:,} numbers, expected {left:,} at most")
    array = np.frombuffer(file.read(count * dtype.itemsize), dtype=dtype)
    return array.reshape(shape[::-1]).T if by_columns else array.reshape(shape)


def read_matlab(path: Path) -> list[Column]:
    """Return the variables of a .mat file, v5 to v7.3; fields of structs are `struct.field`.

    Raises:
        ValueError: empty, truncated, foreign.
    """
    contents, arrays = read_isolated("MATLAB", path)
    columns = [
        Column(entry["name"], samples, fault=entry["fault"])
        for entry, samples in zip(contents["columns"], arrays, strict=True)
    ]
    if not columns:
        raise ValueError(f"{path.name} holds no variable")
    return with_units(columns, contents["texts"])


def read_hdf5(path: Path) -> list[Column]:
    """Return every dataset of a foreign HDF5 file, by its path in the file.

    Raises:
        ValueError: empty, truncated, or a recording of ours, which needs no import.
    """
    from foten.datasets.hdf5 import is_recording

    contents, arrays = read_isolated("HDF5", path)
    if is_recording(contents["attributes"]):
        raise ValueError(f"{path.name} is a foten recording already; nothing to import")
    columns: list[Column] = []
    texts: dict[str, Any] = {
        f"{entry['name']}/{key}".lstrip("/"): value
        for entry in [{"name": "", "attributes": contents["attributes"]}, *contents["objects"]]
        for key, value in entry.get("attributes", {}).items()
        if isinstance(value, str | list)
    }
    for entry in contents["objects"]:
        name = entry["name"]
        if "array" in entry:
            columns += columns_of_array(name, arrays[entry["array"]].reshape(entry["shape"]))
        elif "texts" in entry:
            texts[name] = entry["texts"] if len(entry["texts"]) > 1 else entry["texts"][0]
            columns.append(Column(name, np.zeros(0), fault="holds no plain numbers"))
        elif "fault" in entry:
            columns.append(Column(name, np.zeros(0), fault=entry["fault"]))
    if not columns:
        raise ValueError(f"{path.name} holds no dataset")
    return with_units(columns, texts)
