"""A benchmark's table: printed as Markdown, and kept as CSV where it is asked for."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from foten.atomic_write import atomic_write
from foten.experiments.tables import written


def add_csv(parser: argparse.ArgumentParser) -> None:
    """Add the option that keeps the table."""
    parser.add_argument("--csv", type=Path, metavar="FILE", help="keep the table as CSV there")


def report(cells: Sequence[Sequence[str]], path: Path | None) -> None:
    """Print a table, its heading first, and write it to a path where one is given."""
    print(written(cells, "md"), end="")
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as part:
            part.write_text(written(cells, "csv"), encoding="utf-8")
