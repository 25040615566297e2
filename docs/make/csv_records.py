"""Runs and rows of the CSV files in docs/results, which of them each table is of, and cells that are means over them."""

import argparse
import csv
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from foten.reporting.table import Cell, Number, Table
from foten.untrusted import parse_toml
from foten_lab.aggregate import by_place, mean_of
from foten_lab.experiment import experiment_path, read_experiment
from foten_lab.results import Record, Records, read_records

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
PAPERS, TUNED, OWN = "the paper's", "tuned", "its own"
TABLE_1 = {PAPERS: "table-1", TUNED: "table-1-tuned"}
"""Experiments of Table I, by what its recipes are called."""
WITH_OWN = ("ar", "gan", OURS)
"""Models that the paper's recipe is not for."""
OTHER_DATA = {MAIN[CONTACT]: CONTACT, "real recordings": REAL_TABLE_1}
"""Experiments with all systems on other data than Table I's, by what that is."""
BEHIND_LOW_PASS = "table-1-350hz"  # whose recordings docs/make/headline.py writes
VARIANTS = {
    "ten": "TEN",
    "ten-mfcc": "TEN + MFCC",
    "ten-wavelet": "TEN + wavelets",
    "foten": "FoTEN",
    "foten-d": "FoTEN-D",
}
"""The paper's names of its variants; Table II."""
PAPER_CELL = (20, "huber")  # window [samples] and loss, the paper's best, with δ = 1.6; Fig. 5
CHANGES = {
    "seed": "seed {}",
    "dropout": "no dropout",
    "batch": "batches of {}",
    "clip_norm": "clipped gradients",
    "initial_weights": "PyTorch's weights",
}
"""Settings of Fig. 5's grid beside window, loss and threshold, as its rows name them."""
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


def parser_of(description: str | None) -> argparse.ArgumentParser:
    """Parser of a script's options, whose docstring is its help."""
    return argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)


def listing(name: str, heads: Sequence[str] = ("",)) -> Table:
    """Columns of a table that a benchmark wrote, by how their headings begin; by default all."""
    rows = csv_rows(name)
    shown = [title for head in heads for title in (rows[0] if rows else ()) if title.startswith(head)]
    return Table.of(shown, [[row[title] for title in shown] for row in rows])


def of_recipe(recipe: str) -> list[Record]:
    """Runs of Table I by the paper's recipe or by the tuned ones, with the name of their recipe."""
    return [
        {**record, "recipe": OWN if recipe == PAPERS and record["model"] in WITH_OWN else recipe}
        for record in runs_of(TABLE_1[recipe])
    ]


def of_sides(records: Records) -> list[list[Record]]:
    """Runs by the paper's recipe or a system's own, and by the tuned ones."""
    return [[record for record in records if (record["recipe"] == TUNED) == tuned] for tuned in (False, True)]


def with_all(records: Records, methods: Collection[str]) -> list[Record]:
    """Runs on the textures that all of some methods have."""
    textures = [textures_of([record for record in records if record["method"] == method]) for method in methods]
    shared = set.intersection(*textures) if textures else set()
    return [record for record in records if record["texture"] in shared]


def of_all_systems(recipe: str) -> list[Record]:
    """Runs of Table I by a recipe on the textures that all its systems have."""
    methods = read_experiment(experiment_path(TABLE_1[recipe])).methods
    return with_all(of_recipe(recipe), [method.title for method in methods])


def by_both() -> list[Record]:
    """Runs of Table I by both recipes, on the textures that have both."""
    papers, tuned = (of_all_systems(recipe) for recipe in TABLE_1)
    shared = textures_of(papers) & textures_of(tuned)
    return [record for record in (*papers, *tuned) if record["texture"] in shared]


def table_1() -> list[Record]:
    """Runs of Table I: by both recipes, of which `chosen` takes the better on validation, once the tuned ones are all done."""
    papers, both = of_all_systems(PAPERS), by_both()
    order = [method.title for method in read_experiment(experiment_path(TABLE_1[TUNED])).methods]
    runs = both if len(textures_of(both)) == len(textures_of(papers)) else papers
    return sorted(runs, key=lambda record: order.index(record["method"]))


def tuned_on(name: str) -> list[Record]:
    """Runs of an experiment on the splits that all its systems have, once all are done but for AR that was refused."""
    experiment, records = of_file(name), records_of(name)
    n_done = Counter((record["method"], record.get("recipe") or "") for record in records)
    n_textures = len(experiment["textures"])
    for one in experiment["methods"]:
        # AR may find too few pieces in a split.
        n = n_textures if one["model"] == "ar" else n_textures * len(one.get("split_seeds", experiment["split_seeds"]))
        if min(n_done[one.get("name", one["model"]), recipe] for recipe in one.get("recipes", [""])) < n:
            return []
    places = [{*of} for of in by_place(records).values()]
    shared = set.intersection(*places) if places else set()
    return [record for record in records if (record["texture"], record["split"]) in shared]


EQUAL: Mapping[str, Callable[[], Records]] = {
    MAIN[SIMULATED]: by_both,
    **{title: partial(tuned_on, name) for title, name in OTHER_DATA.items()},
}
"""Runs in which the other systems have the best of at least as many recipes as ours."""


def near() -> list[Record]:
    """Runs of systems that are near one another, by their tuned recipes, on the textures whose three recordings all have."""
    more = runs_of("table-1-near")
    methods, splits = ({record[key] for record in more} for key in ("method", "split"))
    n_done = Counter(record["texture"] for record in more)
    shown = [r for r in (*runs_of("table-1-tuned"), *more) if r["method"] in methods]
    done = [record for record in shown if n_done[record["texture"]] == len(methods) * len(splits)]
    return done if len(textures_of(done)) >= 6 else []  # as a p needs


def changed_pairs() -> list[tuple[Record, Record]]:
    """Runs by tuned recipes under the name of a change of each, and those with the change, on the same recordings."""
    before = by_place(runs_of("table-1-tuned"))
    pairs = []
    for one in runs_of("table-1-changed"):
        system = one["method"].partition(", ")[0]
        if (tuned := before.get(system, {}).get((one["texture"], one["split"]))) is not None:
            pairs.append(({**tuned, "method": one["method"]}, one))
    return pairs


def of_variants() -> list[Record]:
    """Runs of the network's variants, and of the network itself, whose runs are those of Table I by the published recipe."""
    variants = [record for record in runs_of("table-2") if record["model"] != "foten"]
    done = {(record["texture"], record["split"]) for record in variants}
    network = [
        {**record, "experiment": variants[0]["experiment"]}
        for record in runs_of("table-1")
        if record["method"] == VARIANTS["foten"] and (record["texture"], record["split"]) in done
    ]
    every = (*variants, *network)
    return [{**one, "method": name} for key, name in VARIANTS.items() for one in every if one["model"] == key]


def table_2() -> list[Record]:
    """Runs of Table II, on the textures that all variants have."""
    return with_all(of_variants(), VARIANTS.values())


def of_grid() -> tuple[list[Record], list[str]]:
    """Runs of the grid on the textures that are done, and the textures that are not."""
    planned = Counter(run.place[2] for run in read_experiment(experiment_path("figure-5")).runs())
    done = Counter(record["texture"] for record in runs_of("figure-5"))
    missing = [texture for texture, n in planned.items() if done[texture] < n]
    return [record for record in runs_of("figure-5") if record["texture"] not in missing], missing


def by_cell() -> tuple[dict[tuple[int, str], list[Record]], dict[str, list[Record]]]:
    """Runs of the grid by window and loss; and those at the paper's window with the Huber loss, by what their row is called.

    Rows are of a threshold, of which windows and losses have 1.6, of another seed, and of one change.
    """
    windows: dict[tuple[int, str], list[Record]] = {}
    others: dict[str, list[Record]] = {}
    for record in of_grid()[0]:
        settings = record["method"].removeprefix(f"{record['model']} ").split(", ")
        cell = dict(item.rsplit(" ", 1) for item in settings)
        if "window" in cell:
            windows.setdefault((int(cell["window"]), cell["loss"]), []).append(record)
        elif "delta" in cell:
            others.setdefault(f"{float(cell['delta']):.1f}", []).append(record)
        else:
            ((name, value),) = cell.items()
            others.setdefault(f"1.6, {CHANGES[name].format(value)}", []).append(record)
    others["1.6"] = windows.get(PAPER_CELL, []) + others.get("1.6", [])
    return windows, {name: others[name] for name in sorted(others) if others[name]}


def in_textures(records: Records) -> list[Record]:
    """Runs in the order of their textures' names."""
    return sorted(records, key=lambda record: record["texture"])


def of_seeds() -> list[list[Record]]:
    """Runs of the paper's best cell, by seed."""
    return [in_textures(records) for name, records in by_cell()[1].items() if name == "1.6" or "seed" in name]
