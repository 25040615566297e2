"""A benchmark's table: printed as Markdown, and kept as CSV where it is asked for."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

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
