"""NumPy, MATLAB and HDF5 files as columns. Nothing here unpickles: a pickle runs code when it is opened."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from foten.datasets.columns import Column, columns_of_array

_PICKLE = "holds pickled objects, which can run code when opened; save plain arrays of numbers instead"


def read_numpy(path: Path) -> list[Column]:
    """Return the arrays of an .npz, or the columns of an .npy.

    Raises:
        ValueError: empty, truncated, foreign, or pickled objects within.
    """
    if path.stat().st_size == 0:
        raise ValueError(f"{path.name} is empty")
    columns: list[Column] = []
    try:
        with path.open("rb") as file:
            loaded = np.load(file, allow_pickle=False)
            if isinstance(loaded, np.ndarray):
                found = columns_of_array("", loaded) if loaded.ndim == 2 else columns_of_array("0", loaded)
                return [Column(c.name.lstrip("."), c.samples, fault=c.fault) for c in found]
            for name in loaded.files:
                columns += columns_of_array(name, loaded[name])
    except (ValueError, EOFError, OSError, KeyError, zipfile.BadZipFile) as error:
        if "pickle" in str(error):
            raise ValueError(f"{path.name} {_PICKLE}") from None
        raise ValueError(f"{path.name} is truncated or is no NumPy file ({error})") from None
    if not columns:
        raise ValueError(f"{path.name} holds no array")
    return columns


def read_matlab(path: Path) -> list[Column]:
    """Return the variables of a .mat file, v5 to v7.3; fields of structs are `struct.field`.

    Raises:
        ValueError: empty, truncated, foreign.
    """
    if path.stat().st_size == 0:
        raise ValueError(f"{path.name} is empty")
    from pymatreader import read_mat

    try:
        variables = read_mat(str(path))
    except ImportError:
        raise
    except Exception as error:  # a damaged file raises a dozen kinds, zlib.error and TypeError among them
        raise ValueError(f"{path.name} is truncated or is no MATLAB file ({error})") from None
    columns = _flatten(variables, "")
    if not columns:
        raise ValueError(f"{path.name} holds no variable")
    return columns


def _flatten(value: Any, name: str) -> list[Column]:
    if isinstance(value, dict):
        return [
            column
            for key, inner in value.items()
            if not key.startswith(("__", "#"))
            for column in _flatten(inner, f"{name}.{key}" if name else key)
        ]
    if isinstance(value, (list, str, bytes)) or value is None:
        return [Column(name, np.zeros(0), fault="holds text or cells, expected numbers")]
    return columns_of_array(name, np.asarray(value))


def read_hdf5(path: Path) -> list[Column]:
    """Return every dataset of a foreign HDF5 file, by its path in the file.

    Raises:
        ValueError: empty, truncated, or a recording of ours, which needs no import.
    """
    from foten.datasets.hdf5 import is_recording, open_hdf5

    if is_recording(path):
        raise ValueError(f"{path.name} is a foten recording already; nothing to import")
    import h5py

    columns: list[Column] = []
    with open_hdf5(path) as file:

        def visit(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset):
                if item.dtype.kind in "biuf" and item.shape is not None:
                    columns.extend(columns_of_array(name, item[()]))
                else:
                    columns.append(Column(name, np.zeros(0), fault="holds no plain numbers"))

        try:
            file.visititems(visit)
        except OSError as error:
            raise ValueError(f"{path.name} is damaged ({error})") from None
    if not columns:
        raise ValueError(f"{path.name} holds no dataset")
    return columns
