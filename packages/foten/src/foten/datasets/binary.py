"""NumPy, HDF5 and WAV files as columns; ValueError where one is truncated, foreign, or holds pickled objects."""

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
from foten.datasets.isolated import read_isolated
from foten.datasets.units import FULL_SCALE
from foten.untrusted import check_content

_PICKLE = "holds pickled objects, which can run code when opened; save plain arrays of numbers instead"


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
