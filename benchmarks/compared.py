"""The tables of the reduced comparison: results of `foten sweep table-1-small` between their markers in a page.

    foten sweep table-1-small -o benchmarks/results/table-1-small
    python benchmarks/compared.py [--results DIR] [--page docs/compared.md]

They are those of `foten tables`, and how long each method was trained and judged.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from foten.experiments.results import FIGURES, label_of, read_results, title_of
from foten.experiments.tables import findings, table, written
from main_table import between

RESULTS = Path(__file__).parent / "results" / "table-1-small"


def page(results: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Give what the results say, then their tables, paragraph by paragraph."""
    hours = sum(sum(one["seconds"].values()) for one in results) / 3600
    yield f"**{title_of(results)}**: {len(results)} runs, {hours:.1f} hours of one core. {next(said := findings(results))}"
    yield "\n".join(f"- {line}" for line in said)
    for name in FIGURES:
        yield written(table(results, name), "md").rstrip()
    yield written(list(_times(results)), "md").rstrip()


def _times(results: Sequence[Mapping[str, Any]]) -> Iterator[list[str]]:
    yield ["mean of the textures", "training [s]", "judging [s]", "epochs", "file [kB]"]
    for method in dict.fromkeys(map(label_of, results)):
        of = [one for one in results if label_of(one) == method]
        seconds = (statistics.mean(one["seconds"][part] for one in of) for part in ("training", "evaluation"))
        epochs = [one["n_epochs"] for one in of if one["n_epochs"] is not None]
        kilobytes = statistics.mean(one["file_bytes"] for one in of) / 1000
        yield [
            method,
            *(f"{value:.0f}" for value in seconds),
            f"{statistics.mean(epochs):.1f}" if epochs else "–",
            f"{kilobytes:.0f}",
        ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--page", type=Path, help="put the tables between their markers in this file")
    arguments = parser.parse_args()
    between(arguments.page, "compared", "\n\n".join(page(read_results(arguments.results))))


if __name__ == "__main__":
    main()
