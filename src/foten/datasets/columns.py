"""What a file holds before anyone says which column is which channel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Column:
    """One column of numbers, as the file has it.

    Attributes:
        name: its header, or its number from 0 where there is none.
        samples: shape (n,), float64, in the file's own unit; NaN where a cell within the column was blank.
        rate_hz: where the file states it, else None.
        unit: where the file states it, else empty.
        n_blank: blank cells after the last value, which are not in `samples`.
        fault: why this column cannot be a channel (a word among the numbers), else empty.
    """

    name: str
    samples: NDArray[np.float64]
    rate_hz: float | None = None
    unit: str = ""
    n_blank: int = 0
    fault: str = ""

    @property
    def n_rows(self) -> int:
        """Return the rows of the table that the column came from; columns with equal rows belong together."""
        return self.samples.size + self.n_blank


def columns_of_array(name: str, array: NDArray[Any]) -> list[Column]:
    """Return an array as columns: `name` for one, `name.0`, `name.1`, … for several.

    The longer axis of a matrix is taken as time, as both layouts are common; scalars come back as columns of
    one sample. Arrays that hold no numbers, or have more than two axes of length above 1, come back with a
    fault.
    """
    array = np.asarray(array)
    if array.dtype.names:
        return [c for field in array.dtype.names for c in columns_of_array(f"{name}.{field}", array[field])]
    if array.dtype.kind not in "biuf":
        what = "complex numbers" if array.dtype.kind == "c" else "text or objects"
        return [Column(name, np.zeros(0), fault=f"holds {what}, expected real numbers")]
    array = np.atleast_1d(np.squeeze(array))
    if array.ndim > 2:
        return [Column(name, np.zeros(0), fault=f"has shape {array.shape}, expected one or two axes")]
    if array.ndim == 1:
        return [Column(name, array.astype(np.float64))]
    if array.shape[0] < array.shape[1]:
        array = array.T
    return [Column(f"{name}.{k}", array[:, k].astype(np.float64)) for k in range(array.shape[1])]
