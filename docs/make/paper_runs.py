"""Runs that the tables of *Compared systems* are of: Table I by each recipe, other data, variants, and the grid of Fig. 5."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping
from functools import partial

from csv_records import CONTACT, MAIN, OURS, REAL_TABLE_1, SIMULATED, of_file, records_of, runs_of, textures_of
from foten.experiments.aggregate import by_place
from foten.experiments.experiment import experiment_path, read_experiment
from foten.experiments.results import Record, Records

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
