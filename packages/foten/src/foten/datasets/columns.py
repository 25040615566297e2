"""Columns of a file, before they are mapped to channels."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.untrusted import brief, printable

MAX_COLUMNS = 1000  # of a file
MAX_NAME_CHARACTERS = 200  # of what a message repeats
MAX_PREAMBLE_CHARACTERS = 2000  # of the lines above a table


@dataclass(frozen=True)
class Column:
    """One column of numbers, as the file has it."""

    name: str  # its header, or its number from 0 where there is none
    samples: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    """Shape (n,), in the file's own unit; NaN where a cell within the column was blank."""
    rate_hz: float | None = None  # where the file states it
    unit: str = ""  # where the file states it
    n_blank: int = 0  # blank cells after the last value, which are not in `samples`
    fault: str = ""  # why this column cannot be a channel: a word among the numbers, for example
    file: Path = Path()  # that it was imported from
    preamble: str = ""  # what stands above the table
    row_numbers: Sequence[int] = ()  # of each sample and of the blank cells, from 1, where the file is a table

    def __post_init__(self) -> None:
        for text in ("name", "unit", "fault", "preamble"):
            at_most = MAX_PREAMBLE_CHARACTERS if text == "preamble" else MAX_NAME_CHARACTERS
            object.__setattr__(self, text, printable(getattr(self, text)[:at_most]))

    @property
    def n_rows(self) -> int:
        """Rows of the table that the column came from; columns with equal rows belong together."""
        return self.samples.size + self.n_blank

    def row_of(self, sample: int) -> str:
        """Row that a sample stands in, as " (row 12)"; nothing where the file has no rows."""
        return f" (row {self.row_numbers[sample]})" if sample < len(self.row_numbers) else ""


@contextmanager
def reading(path: Path, what: str) -> Iterator[None]:
    """Refuse in a line what a library raises on a damaged file: any kind, zlib.error and TypeError among them."""
    try:
        yield
    except MemoryError:
        raise ValueError(f"{path.name} says that it holds more than the memory does") from None
    except Exception as error:
        if isinstance(error, ValueError) and str(error).startswith(path.name):  # a sentence of ours
            raise
        raise ValueError(f"{path.name} is truncated or is no {what} ({brief(error)})") from None


def check_width(name: str, n_columns: int) -> None:
    """Check that a file has at most `MAX_COLUMNS`."""
    if n_columns > MAX_COLUMNS:
        at_most = f"expected {MAX_COLUMNS:,} at most"
        raise ValueError(f"{name} has {n_columns:,} columns, {at_most}; do its samples lie along a row? Transpose it")


def columns_of_array(name: str, array: NDArray[Any]) -> list[Column]:
    """Array as columns: `name` for one, `name.0`, `name.1`, … for several.

    The longer axis of a matrix is taken as time; scalars are columns of one sample. Arrays of no numbers, or with more than two
    axes of length above 1, have a fault.
    """
    if array.dtype.names:
        return [c for field in array.dtype.names for c in columns_of_array(f"{name}.{field}", array[field])]
    kind, array = array.dtype.kind, np.atleast_1d(np.squeeze(array))
    fault = ""
    if kind not in "biuf":
        fault = f"holds {'complex numbers' if kind == 'c' else 'text or objects'}, expected real numbers"
    elif array.ndim > 2:
        fault = f"has shape {array.shape}, expected one or two axes"
    elif array.ndim == 2 and min(array.shape) > MAX_COLUMNS:
        fault = f"has shape {array.shape}, expected {MAX_COLUMNS} columns at most"
    if fault:
        return [Column(name, fault=fault)]
    if array.ndim == 1:
        return [Column(name, array.astype(np.float64, copy=False))]
    columns = array if array.shape[0] < array.shape[1] else array.T
    return [Column(f"{name}.{k}", column.astype(np.float64)) for k, column in enumerate(columns)]


def with_units(columns: list[Column], texts: Mapping[str, str | list[str]]) -> list[Column]:
    """Columns with the units that texts beside them state.

    A text `force_unit`, `force.units` or `units.force` is the unit of `force`, `unit` alone that of everything beside it; `.` or
    `/` lead into a struct or a group. A list of texts has one for each column of a matrix.
    """
    by_name = {name.lower(): text for name, text in texts.items()}
    return [replace(column, unit=_unit_beside(column.name.lower(), by_name)) for column in columns]


def _unit_beside(name: str, texts: Mapping[str, str | list[str]]) -> str:
    index = re.search(r"\.(\d+)$", name)
    name = name[: index.start()] if index else name
    leaf = re.split("[./]", name)[-1]
    parent = name.removesuffix(leaf)
    words = ("unit", "units")
    candidates = [f"{parent}{leaf}{mark}{word}" for word in words for mark in "_./"]
    candidates += [f"{parent}{word}{mark}{leaf}" for word in words for mark in "_./"]
    candidates += [f"{parent}{word}" for word in words]
    text = next((texts[name] for name in candidates if name in texts), "")
    if isinstance(text, list):
        k = int(index[1]) if index else 0
        text = text[k] if k < len(text) else ""
    return text.strip()
