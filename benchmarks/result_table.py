"""A benchmark's table: printed as Markdown, and kept as CSV where it is asked for."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

from foten.atomic_write import atomic_write
from foten.reporting.table import Table


def add_csv(parser: argparse.ArgumentParser) -> None:
    """Add the option that keeps the table."""
    parser.add_argument("--csv", type=Path, metavar="FILE", help="keep the table as CSV there")


def report(cells: Sequence[Sequence[str]], path: Path | None) -> None:
    """Print a table, its heading first, and write it to a path where one is given."""
    table = Table.of(cells[0], cells[1:])
    print(table.markdown(), end="")
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        table.write(path, "csv")


def write_rows(rows: Sequence[Mapping[str, str]], path: Path) -> None:
    """Write rows that may lack some of the columns, at once."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as part, part.open("w", newline="") as file:
        table = csv.DictWriter(file, columns, restval="", lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
