"""Runs and rows of the CSV files in docs/results, and cells of tables that are means over them."""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from foten.experiments.experiment import experiment_path
from foten.experiments.results import Record, Records, read_records
from foten.reporting.table import Cell, Number, Table, mean_number

RESULTS = Path(__file__).resolve().parents[1] / "results"
REAL_10, REAL_2_5, LINEAR, SIMULATED = "main-real-10khz", "main-real-2500hz", "main-linear", "main-simulated"
CONTACT, REAL_TABLE_1 = "main-contact", "table-1-real"
FOTEN = "foten"  # where a record of ours has the error of the paper's network
OURS, EXCITED = "foten-plus", "with excitation"  # how the names of systems begin, or end
MAIN = {
    REAL_10: "real, 10 kHz",
    REAL_2_5: "real, 2.5 kHz",
    LINEAR: "linear processes",
    SIMULATED: "simulated textures",
    CONTACT: "contact mechanics",
}
FULL_LENGTH = {
    "recipes": "recipes",
    "table-1": "paper",
    "table-1-tuned": "paper",
    "table-1-near": "paper",
    "table-1-changed": "paper",
    "table-1-350hz": "paper",
    "table-2": "paper",
    "figure-5": "paper",
}
"""Experiments of the paper's tables, and the CSV that holds their runs; other experiments have one of their own name."""
ONE_STEP, BEST_AR = "one_step.mae_scaled", "references.ar_best.mae_scaled"
ERROR, BOUND = "one_step.mae_m_s2", "references.bound.mae_m_s2"
LSD, AR_LSD, CEILING = "free_run.lsd_db", "free_run_ar.lsd_db", "ceiling.lsd_db"
LEVEL, CEILING_LEVEL = "free_run.level_error_db", "ceiling.level_error_db"
Columns = Sequence[tuple[str, Callable[[Records], Cell]]]
"""Headings, and what stands below of the runs of a row."""
Rows = Mapping[str, Records] | Mapping[tuple[str, ...], Records]
"""Runs of each row, by its name or names."""


def table(heads: tuple[str, ...], rows: Rows, columns: Columns) -> Table:
    """Table with a row for each group of runs, but for those without."""
    cells = [
        (*((names,) if isinstance(names, str) else names), *(cell(records) for _, cell in columns))
        for names, records in rows.items()
        if records
    ]
    return Table.of((*heads, *(head for head, _ in columns)), cells)


@cache
def records_of(name: str) -> list[Record]:
    """Runs of an experiment; none where it has not been run."""
    path = RESULTS / f"{name}.csv"
    return list(read_records(path)) if path.exists() else []


def of_file(name: str) -> dict[str, Any]:
    """What an experiment's file says; its recordings need not be here."""
    return tomllib.loads(experiment_path(name).read_text(encoding="utf-8"))


def runs_of(name: str) -> list[Record]:
    """Runs of an experiment, whose CSV may hold others too."""
    title = of_file(name)["title"]
    return [record for record in records_of(FULL_LENGTH.get(name, name)) if record["experiment"] == title]


def runs(name: str, model: str = OURS) -> list[Record]:
    """Runs of a model in an experiment, those with an excitation that it has not by itself left out."""
    records = records_of(name)
    return [record for record in records if record["model"] == model and not record["method"].endswith(EXCITED)]


def values(records: Records, over: str, under: str = "") -> list[np.ndarray]:
    """A figure, or a ratio of two, by texture: a number for each split that has it."""
    by_texture: dict[str, list[float]] = {}
    for record in records:
        numbers = [record.get(path) for path in (over, under) if path]
        if None not in numbers:
            ratio = numbers[0] if len(numbers) == 1 else numbers[0] / numbers[1]
            by_texture.setdefault(record["texture"], []).append(ratio)
    return [np.array(splits) for splits in by_texture.values()]


def mean(over: str, under: str = "", digits: int = 3) -> Callable[[Records], Number]:
    """Cell of a mean over textures ± its standard error, a dash where there is none."""
    return lambda records: mean_number(values(records, over, under), digits)


def mean_of(records: Records, over: str, under: str = "") -> Number:
    """A mean over textures ± its standard error."""
    return mean_number(values(records, over, under), 3)


def average(of: Callable[[Record], float], spec: str = ".2f") -> Callable[[Records], str]:
    """Cell of a mean over runs."""
    return lambda records: format(np.mean([of(record) for record in records]), spec)


def playing(records: Records) -> str:
    """In how many runs a rendering plays recorded innovations."""
    return f"{sum(record['random_part'] == 'recorded' for record in records)} of {len(records)}"


def place_of(record: Record) -> tuple[Any, ...]:
    """Where a run stands in its experiment: method, recipe, texture and split."""
    return record["method"], record.get("recipe") or "", record["texture"], record["split"]


def core_hours(records: Records) -> str:
    """Hours of training and evaluation, a dash where the CSV lacks them."""
    seconds = [record.get(key) for record in records for key in ("training_s", "evaluation_s")]
    return "–" if None in seconds else f"{sum(seconds) / 3600:.1f}"


def note_of(name: str, runs: Records) -> str:
    """Note of an experiment: that of when it was run, where the CSV has it."""
    return str((runs[0]["note"] if runs else "") or of_file(name)["note"]).rstrip(".")


def csv_rows(name: str) -> list[dict[str, str]]:
    """Rows of a CSV file by its headings; none where there is no file."""
    path = RESULTS / f"{name}.csv"
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines())) if path.exists() else []
