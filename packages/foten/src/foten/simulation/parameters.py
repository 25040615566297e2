"""Tables of simulated textures: a row for each, a column for each parameter, and the lowest and highest value of each."""

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from foten.untrusted import printable

MAX_NUMBERS, MAX_PARAMETER = 64, 1e5
POSITIVE = (1e-6, MAX_PARAMETER)

Ranges = Mapping[str, tuple[float, float]]


def parameter_table(name: str, lists: tuple[str, ...] = ()) -> tuple[Ranges, dict[str, dict[str, Any]]]:
    """Ranges of the parameters of a table beside this module, where it states them, and the parameters by texture.

    `lists` are the columns that have several numbers, with blanks between them.
    """
    with Path(__file__).with_name(name).open(encoding="utf-8", newline="") as file:
        rows = {row.pop("key"): row for row in csv.DictReader(file)}
    lowest, highest = rows.pop("lowest"), rows.pop("highest")
    ranges = {field: (float(low), float(highest[field])) for field, low in lowest.items() if low}

    def value(field: str, cell: str) -> Any:
        if field in lists:
            return tuple(map(float, cell.split()))
        return cell if field == "description" else float(cell)

    return ranges, {key: {field: value(field, cell) for field, cell in row.items()} for key, row in rows.items()}


def check_parameters(parameters: Any, ranges: Ranges) -> None:
    """Check that the fields of a simulated texture, but for `description`, are numbers, or short rows of them, in their range."""
    for name, value in vars(parameters).items():
        if name == "description":
            continue
        numbers = value if isinstance(value, tuple) else (value,)
        if not 0 < len(numbers) <= MAX_NUMBERS:
            raise ValueError(f"{name} has {len(numbers)} numbers, expected 1 to {MAX_NUMBERS}")
        low, high = ranges.get(name, (-MAX_PARAMETER, MAX_PARAMETER))
        if not all(type(number) in (int, float) and low <= number <= high for number in numbers):
            raise ValueError(f"{name} is {printable(str(value)[:40])}, expected {low:g} to {high:g}")
