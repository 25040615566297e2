"""Runs and rows of the CSV files in docs/results, and cells of tables that are means over them."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from foten.experiments.aggregate import mean_of
from foten.experiments.experiment import experiment_path
from foten.experiments.results import Record, Records, read_records
from foten.reporting.table import Cell, Number, Table
from foten.untrusted import parse_toml

DOCS = Path(__file__).resolve().parents[1]
RESULTS = DOCS / "results"
REAL_10, REAL_2_5, LINEAR, SIMULATED = "main-real-10khz", "main-real-2500hz", "main-linear", "main-simulated"
CONTACT, REAL_TABLE_1 = "main-contact", "table-1-real"
REAL = ("copper", "fabric", "leather", "wood")
FOTEN = "foten"  # where a record of ours has the error of the paper's network
OURS, EXCITED = "foten-plus", "with excitation"  # how the names of systems begin, or end
MAIN = {
    REAL_10: "real, 10 kHz",
    REAL_2_5: "real, 2.5 kHz",
    LINEAR: "linear processes",
    SIMULATED: "simulated textures",
    CONTACT: "contact mechanics",
}
OF_PAPER = ("table-1", "table-1-tuned", "table-1-near", "table-1-changed", "table-1-350hz", "table-2", "figure-5")
FULL_LENGTH = {"recipes": "recipes", **dict.fromkeys(OF_PAPER, "paper")}
"""Experiments of the paper's tables, and the CSV that holds their runs; other experiments have one of their own name."""
ONE_STEP, BEST_AR = "one_step.mae_scaled", "references.ar_best.mae_scaled"
ERROR, BOUND = "one_step.mae_m_s2", "references.bound.mae_m_s2"
LSD, AR_LSD, CEILING = "free_run.lsd_db", "free_run_ar.lsd_db", "ceiling.lsd_db"
LEVEL, CEILING_LEVEL = "free_run.level_error_db", "ceiling.level_error_db"
Columns = Sequence[tuple[str, Callable[[Records], Cell]]]
"""Headings, and what stands below of the runs of a row."""
Row = Mapping[str, str]
"""Row of a CSV file that is no table of runs, by its headings."""


def table(heads: tuple[str, ...], rows: Mapping[str, Records], columns: Columns) -> Table:
    """Table with a row for each group of runs, but for those without."""
    cells = [(name, *(cell(records) for _, cell in columns)) for name, records in rows.items() if records]
    return Table.of((*heads, *(head for head, _ in columns)), cells)


def mean(over: str, under: str = "", digits: int = 3) -> Callable[[Records], Number]:
    """Cell of a mean over textures ± its standard error, a dash where there is none."""
    return lambda records: mean_of(records, over, under, digits)


def average(of: Callable[[Record], float], spec: str = ".2f") -> Callable[[Records], str]:
    """Cell of a mean over runs."""
    return lambda records: format(np.mean([of(record) for record in records]), spec)


def playing(records: Records) -> str:
    """In how many runs a rendering plays recorded innovations."""
    return f"{sum(record['random_part'] == 'recorded' for record in records)} of {len(records)}"


@cache
def records_of(name: str) -> list[Record]:
    """Runs of an experiment; none where it has not been run."""
    path = RESULTS / f"{name}.csv"
    return list(read_records(path)) if path.exists() else []


def of_file(name: str) -> dict[str, Any]:
    """What an experiment's file says; its recordings need not be here."""
    return parse_toml(experiment_path(name).read_bytes())


def runs_of(name: str) -> list[Record]:
    """Runs of an experiment, whose CSV may hold others too."""
    title = of_file(name)["title"]
    return [record for record in records_of(FULL_LENGTH.get(name, name)) if record["experiment"] == title]


def of_model(records: Records, model: str = OURS) -> list[Record]:
    """Runs of a model, those with an excitation that it has not by itself left out."""
    return [record for record in records if record["model"] == model and not record["method"].endswith(EXCITED)]


def runs(name: str, model: str = OURS) -> list[Record]:
    """Runs of a model in an experiment, those with an excitation that it has not by itself left out."""
    return of_model(records_of(name), model)


def place_of(record: Record) -> tuple[Any, ...]:
    """Where a run stands in its experiment: method, recipe, texture and split."""
    return record["method"], record.get("recipe") or "", record["texture"], record["split"]


def textures_of(records: Records) -> set[str]:
    return {record["texture"] for record in records}


def csv_rows(name: str) -> list[Row]:
    """Rows of a CSV file by its headings; none where there is no file."""
    return _rows(RESULTS / f"{name}.csv")


@cache
def _rows(path: Path) -> list[Row]:
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines())) if path.exists() else []


def rows_with(rows: Sequence[Row], **cells: str) -> list[Row]:
    """Rows that have some cells."""
    return [row for row in rows if all(row[name] == cell for name, cell in cells.items())]


def numbers(rows: Sequence[Row], name: str) -> np.ndarray:
    """Numbers of a column, (n,)."""
    return np.array([float(row[name]) for row in rows])


def with_error(row: Row, name: str, error: str, spec: str = ".2f") -> str:
    """Cell of a number in one column and its error in another."""
    return f"{float(row[name]):{spec}} ± {float(row[error]):{spec}}"


def listing(name: str, heads: Sequence[str] = ("",)) -> Table:
    """Columns of a table that a benchmark wrote, by how their headings begin; by default all."""
    rows = csv_rows(name)
    shown = [title for head in heads for title in (rows[0] if rows else ()) if title.startswith(head)]
    return Table.of(shown, [[row[title] for title in shown] for row in rows])
