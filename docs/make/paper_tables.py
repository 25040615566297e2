"""Tables of *Compared systems*: Table I to III, Fig. 5 and what stands beside them, from the CSV files in docs/results."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
from scipy.stats import rankdata, spearmanr

import csv_records as data
import paper_findings as findings
from csv_records import BEST_AR, ERROR, LEVEL, LSD, ONE_STEP, OURS, mean
from foten.evaluate.warm_start import CONVERGED_MS, SILENT_DB
from foten.reporting.table import Cell, Table
from foten_lab.aggregate import PAPER, Place, by_place, by_texture, mean_of, over_textures
from foten_lab.experiment import experiment_path, read_experiment
from foten_lab.method_tables import summary, warm_start
from foten_lab.results import BEST_LINEAR, VALIDATION, WITHOUT, Record, Records, by_recipe, chosen
from paper_findings import PIECEWISE, SHORT_LINEAR, SYSTEM_NAMES, beside, ours_over_others

PAPER_GFC = {"ar": 86.28, "fnn": 87.83, "dstn": 90.33, "ldhtd": 91.02, "gan": 88.65, "foten": 92.15}
"""The paper's GFC [%], means over its twelve textures; Table I."""
VARIANTS_GFC = {"ten": 86.77, "ten-mfcc": 90.28, "ten-wavelet": 86.18, "foten-d": 90.64}
"""The same of its variants; Table II."""
ORDERS = {
    "one step [sd]": ONE_STEP,
    "one step [m/s²]": ERROR,
    "one-step GFC": "one_step.gfc",
    "free run [sd]": "warm_start.stored.mae_scaled",
    "free run's GFC": "warm_start.stored.gfc",
}
"""Figures that systems may be ordered by, and where records have them; of free runs, from the warm start."""


def compared(records: Records) -> Table:
    """Summary of an experiment without the references that a better one stands for, or that nothing is worse than."""
    left_out = ("zero", "persistence", SHORT_LINEAR, f"{SHORT_LINEAR} by speed and force")
    of_all = summary(records)
    return replace(of_all, rows=tuple(row for row in of_all.rows if row[0] not in left_out))


def both_recipes() -> Table:
    """Errors of one step by both recipes of each system, on the textures that have both; on validation too, which chooses."""
    return side_by_side("paper's recipe, or own", "tuned", *data.of_sides(data.by_both() or data.table_1()))


def changed() -> Table:
    """Errors of one step by tuned recipes and with one change of each, on the recordings of the latter."""
    pairs = data.changed_pairs()
    return side_by_side("tuned", "changed", [before for before, _ in pairs], [after for _, after in pairs])


def side_by_side(first: str, second: str, *sides: Records) -> Table:
    """Errors of one step of two sides by system, on test and validation blocks, and epochs."""
    left, right = map(by_place, sides)
    rows = []
    for method, of_left in left.items():
        both = [*of_left.values()], [*right.get(method, {}).values()]
        paths = (next((key for key in VALIDATION if by_texture(side, key)), VALIDATION[0]) for side in both)
        chosen_by = [mean(path)(side) for path, side in zip(paths, both, strict=True)]
        lowest = min(number.value or np.inf for number in chosen_by)
        cells: list[Cell] = []
        for side, validation in zip(both, chosen_by, strict=True):
            epochs = [record["epochs"] for record in side if record.get("epochs") is not None]
            cells += [mean(ONE_STEP)(side), replace(validation, best=validation.value == lowest)]
            cells.append(f"{np.mean(epochs):.0f}" if epochs else "–")
        if any(record.get("epochs") for side in both for record in side):
            rows.append((method, str(len(of_left)), *cells))
    columns = (f"{first}: MAE [sd]", "validation", "epochs", f"{second}: MAE [sd]", "validation ", "epochs ")
    return Table.of(("", "textures", *columns), rows)


def beside_ar() -> Table:
    """Errors of one step by both recipes beside those of the best AR: ratio, number of textures, p after Holm over systems."""
    sides = [
        {name: (f"{ratio:.3f}", below, p) for name, (ratio, below, p) in beside(BEST_LINEAR, side).items()}
        for side in data.of_sides(data.by_both() or data.table_1())
    ]
    heads = ("paper's recipe, or own: ÷ best AR", "below it on", "p", "tuned: ÷ best AR", "below it on ", "p ")
    return Table.of(("", *heads), [(name, *(c for of in sides for c in of.get(name, ("–",) * 3))) for name in sides[0]])


def on_other_data(name: str) -> Table:
    """All systems on other data than Table I's, without the paper's figures, which are of twelve textures of its own."""
    shown = compared(chosen(data.tuned_on(name)))
    kept = [k for k, column in enumerate(shown.columns) if not str(column).startswith("paper's")]
    return Table.of([shown.columns[k] for k in kept], [[row[k] for k in kept] for row in shown.rows])


def means_of(records: Records, path: str) -> dict[str, float]:
    """Means over textures of a figure of the paper's systems, by model, but for those that lack it in a run."""
    means = {}
    for model in PAPER_GFC:
        runs = data.of_model(records, model)
        splits = by_texture(runs, path).values()
        if runs and sum(map(len, splits)) == len(runs):
            means[model] = float(np.mean([of_texture.mean() for of_texture in splits]))
    return means


EARLY_AND_LATE = [f"warm_start.{{}}.error_to_silence_{part}_ms" for part in ("0_100", "100_400")]


def convergence() -> Table:
    """When free runs from two windows are the same, and their error over silence's before and after 100 ms, Sec. V-a.

    Of Table I's systems, and of those by the paper's recipe, which the claim is about.
    """
    shown = [*chosen(data.table_1()), *(record for record in data.table_1() if record["recipe"] == data.PAPERS)]
    shown += ({**record, "recipe": data.PAPERS} for record in data.of_variants() if record["model"] == "ten")
    methods: dict[str, dict[str, dict[Place, Record]]] = {}
    for record in shown:
        by_recipes = methods.setdefault(record["method"], {})
        by_recipes.setdefault(record["recipe"], {})[record["texture"], record["split"]] = record
    rows = []
    for method, recipe, of_recipe in ((name, *each) for name, recipes in methods.items() for each in recipes.items()):
        runs = [*of_recipe.values()]
        if not any(record.get("warm_start.synthesised.mae_scaled") for record in runs):
            continue  # has no window to begin from
        silent = [record for record in runs if (record["warm_start.stored.level_db"] or 0.0) < SILENT_DB]
        times = [record.get("warm_start.forgotten_ms") for record in runs if record not in silent]
        within = sum(ms is not None and ms <= CONVERGED_MS for ms in times)
        counts = (within, len(times) - within - times.count(None), times.count(None), len(silent))
        errors = (mean(path.format("stored"), digits=2)(runs) for path in EARLY_AND_LATE)
        name = f"{method}, the paper's recipe" if recipe == data.PAPERS else method
        rows.append((name, *map(str, counts), *errors))
    if rows:
        once = list({(record["texture"], record["split"]): record for record in shown}.values())
        rows.append(("ceiling", *[""] * 4, *(mean(path.format("ceiling"), digits=2)(once) for path in EARLY_AND_LATE)))
    heads = (
        "within 100 ms",
        "later",
        "not in the block's 2 s",
        "silent",
        "error ÷ silence's, first 100 ms",
        "next 300 ms",
    )
    return Table.of(("", *heads), rows)


def orders() -> Table:
    """Ranks of the paper's systems by unit, regime and data, and their correlation with the paper's (Spearman)."""
    figures = [("one step, the paper's recipe for all [sd]", data.of_all_systems(data.PAPERS), ONE_STEP)]
    figures += [(figure, chosen(data.table_1()), path) for figure, path in ORDERS.items()]
    figures += [
        (f"one step, {title} [sd]", chosen(data.tuned_on(name)), ONE_STEP) for title, name in data.OTHER_DATA.items()
    ]
    rows = [["the paper's MAE", *in_order(PAPER[model] for model in PAPER_GFC), ""]]
    for figure, records, path in figures:
        means = means_of(records, path)
        if len(means) > 2:
            here = [-mean if path.endswith("gfc") else mean for mean in means.values()]
            by_model = dict(zip(means, in_order(here), strict=True))
            agreement = spearmanr(here, [PAPER[model] for model in means]).statistic
            rows.append([figure, *(by_model.get(model, "–") for model in PAPER_GFC), f"{agreement:+.1f}"])
    return Table.of(("", *(SYSTEM_NAMES[model] for model in PAPER_GFC), "with the paper"), rows)


def in_order(values: Iterable[float]) -> list[str]:
    """Rank of each value, from 1 for the lowest; those that tie share the mean of theirs."""
    return [f"{rank:g}" for rank in rankdata(list(values))]


def pairs() -> Table:
    """Errors of one step that go with the paper's GFC here, by least squares of logarithms over all systems and textures."""
    records = data.table_1()
    places = ("one_step", *(f"references.{name}" for name in ("ar", "ar_scheduled", "ar_best")))
    both = {  # a linear predictor's once for all runs on a recording
        (record[f"{place}.mae_scaled"], 1 - record[f"{place}.gfc"])
        for record, place in product(records, places)
        if record.get(f"{place}.gfc") is not None
    }
    if not both:
        return Table((), ())
    error, lack = np.log(np.array(sorted(both))).T
    slope, constant = np.polyfit(lack, error, 1)
    spread = float(np.std(error - constant - slope * lack))
    rows = []
    for model, gfc in (PAPER_GFC | VARIANTS_GFC).items():
        here = float(np.exp(constant + slope * np.log(1 - gfc / 100)))
        name, paper = (data.VARIANTS | SYSTEM_NAMES)[model], PAPER[model]
        rows.append((name, f"{paper:.3f}", f"{gfc:.2f}", f"{here:.2f}", f"{paper / here:.2f}"))
    heads = (
        "paper's MAE, unit not stated",
        "its GFC [%]",
        f"MAE at that GFC here [sd], ± {100 * spread:.0f} %",
        "ratio",
    )
    return Table.of(("", *heads), rows)


def bands() -> Table:
    """Errors of one step of tuned systems with the whole band and behind a low-pass, on the textures of both, and ranks.

    Of the systems that have all textures behind it.
    """
    smooth = [{**run, "texture": run["texture"].rpartition("-")[0]} for run in data.runs_of(data.BEHIND_LOW_PASS)]
    tuned = data.runs_of("table-1-tuned")
    behind = by_place(smooth)
    methods = {name for name in behind if len(behind[name]) == max(map(len, behind.values()))}
    methods &= {run["method"] for run in tuned}
    both = [data.with_all([run for run in part if run["method"] in methods], methods) for part in (tuned, smooth)]
    shared = set.intersection(*map(data.textures_of, both))
    columns: dict[str, list[Cell]] = {}
    for part in both if shared else ():
        systems = by_place([run for run in part if run["texture"] in shared])
        errors = [mean_of([*of.values()], ONE_STEP, "").value or 0.0 for of in systems.values()]
        for (method, of), rank in zip(systems.items(), in_order(errors), strict=True):
            runs = [*of.values()]
            columns.setdefault(method, []).extend((mean(ONE_STEP)(runs), mean(ONE_STEP, BEST_AR)(runs), rank))
    heads = ("MAE [sd]", "÷ best AR", "rank", "behind 350 Hz: MAE [sd]", "÷ best AR ", "rank ")
    return Table.of(("", *heads), [(method, *cells) for method, cells in columns.items()])


def by_variant() -> Table:
    """Variants of the network beside the network, on the textures that all have so far; none has an excitation."""
    shown = compared(data.table_2())
    return replace(shown, rows=tuple((str(name).removesuffix(WITHOUT), *cells) for name, *cells in shown.rows))


def windows_by_loss() -> Table:
    """Errors of one step by window and loss, means over the textures: test and validation."""
    cells, losses = data.by_cell()[0], ("mae", "mse", "huber")
    columns = [*product((ONE_STEP, VALIDATION[0]), losses)]
    rows = [
        (str(window), *(mean_of(cells.get((window, loss), []), path, digits=4) for path, loss in columns))
        for window in sorted({window for window, _ in cells})
    ]
    heads = ("test: mae", "mse", "huber", "validation: mae", "mse ", "huber ")
    return Table.of(("window [samples]", *heads), rows)


def by_threshold() -> Table:
    """Errors of one step by the threshold of the Huber loss, another seed, and a change of the recipe: test and validation."""
    paths = (ONE_STEP, VALIDATION[0])
    rows = [(name, *(mean_of(runs, path, digits=4) for path in paths)) for name, runs in data.by_cell()[1].items()]
    return Table.of(("δ [sd]", "test: MAE [sd]", "validation"), rows)


def over_best(others: Mapping[str, Records], n_textures: int) -> str:
    """Mean of a figure of foten-plus over that of the other system beside which it is worst on the test blocks."""
    of_all = [name for name, ratios in others.items() if len(data.textures_of(ratios)) == n_textures]
    worst = max(of_all, key=lambda name: mean_of(others[name], "ratio").value or 0.0, default="")
    return f"{over_textures(others[worst], 'ratio')} ({worst})" if worst else "–"


def equal_tuning() -> Table:
    """foten-plus over the other systems at equally many recipes, over the best AR and over piecewise AR: means over textures."""
    rows = []
    for title, records in data.EQUAL.items():
        runs = chosen(records())
        ours = [record for record in runs if record["method"].startswith(OURS)]
        if ours:
            n = len(data.textures_of(ours))
            cells: list[Cell] = [over_best(ours_over_others(runs, ONE_STEP), n), over_textures(ours, ONE_STEP, BEST_AR)]
            for path in (LSD, LEVEL):
                others = ours_over_others(runs, path)
                cells += [over_best(others, n), over_textures(others.get(PIECEWISE, []), "ratio")]
            rows.append((title, str(n), *cells))
    heads = ("one step ÷ best system", "÷ best AR", "LSD ÷ best system", "÷ piecewise AR")
    return Table.of(("", "textures", *heads, "level error ÷ best system", "÷ piecewise AR "), rows)


def recipes() -> Table:
    """Best recipes on validation of each system whose runs are all done: error of scaled samples, of the GAN of spectra [dB]."""
    records, rows = data.records_of("recipes"), []
    runs = read_experiment(experiment_path("recipes")).runs()
    caps = {run.place: run.train["epochs"] for run in runs}
    planned, done = (Counter(place[0] for place in places) for places in (caps, map(data.place_of, records)))
    complete = [record for record in records if done[record["method"]] == planned[record["method"]]]
    for method, errors in by_recipe(complete).items():
        (best, lowest), (second, next_lowest), *_, (_, highest) = errors.items()
        of_method = [record for record in complete if record["method"] == method]
        at_cap = sum(record["epochs"] == caps[data.place_of(record)] for record in of_method)
        figures = (best, f"{lowest:.4f}", second, f"{next_lowest:.4f}", f"{highest:.4f}")
        stops = any(run.train["patience"] < run.train["epochs"] for run in runs if run.method == method)
        rows.append([method, str(len(errors)), *figures, f"{at_cap} of {len(of_method)}" if stops else "–"])
    return Table.of(("", "tried", "best", "its error", "second", "its error ", "worst error", "ran to the cap"), rows)


def headline() -> Table:
    """AR(20)'s errors by band and regime, beside silence and a second realisation: means over the textures."""
    rows = data.csv_rows("headline")
    digits = {"silence [sd]": 3, "one step [sd]": 3, "one-step GFC [%]": 1, "free run [sd]": 3, "free run's GFC [%]": 1}
    digits |= {"second realisation [sd]": 3, "second realisation's GFC [%]": 1}
    bands = {band: data.rows_with(rows, band=band) for band in dict.fromkeys(row["band"] for row in rows)}
    cells = [
        (band, *(f"{data.numbers(of, name).mean():.{n}f}" for name, n in digits.items())) for band, of in bands.items()
    ]
    return Table.of(("acceleration", *digits), cells)


TABLES: dict[str, Callable[[], Table | str]] = {
    "so-far": findings.so_far,
    "table-1": lambda: compared(chosen(data.table_1())),
    "findings": findings.of_table_1,
    "both-recipes": both_recipes,
    "beside-ar": beside_ar,
    "beside-short-ar": findings.beside_short_ar,
    "neighbours": lambda: findings.neighbours(chosen(data.table_1())),
    "neighbours-papers": lambda: findings.neighbours(data.of_all_systems(data.PAPERS)),
    "near": lambda: compared(data.near()),
    "near-neighbours": findings.near_neighbours,
    "changed": changed,
    "difference-explained": findings.difference_explained,
    "convergence": convergence,
    "levels": findings.levels,
    "beside-dstn": lambda: " ".join(findings.beside_dstn()),
    "seconds": partial(findings.seconds_of_test, data.REAL_TABLE_1),
    "real-intervals": findings.real_intervals,
    "warm-start": lambda: warm_start(chosen(data.table_1())),
    "equal-tuning": equal_tuning,
    "table-2": by_variant,
    "table-2-findings": findings.of_table_2,
    "grid-so-far": findings.grid_so_far,
    "windows-by-loss": windows_by_loss,
    "thresholds": by_threshold,
    "grid-findings": findings.of_the_grid,
    "recipes": recipes,
    "orders": orders,
    "headline": headline,
    "pairs": pairs,
    "bands": bands,
    "on-contact": partial(on_other_data, data.CONTACT),
    "contact-findings": findings.on_contact,
    "table-1-real": partial(on_other_data, data.REAL_TABLE_1),
    "on-real": findings.on_real,
    "efficiency": partial(
        data.listing, "efficiency", ("model", "input", "PyTorch", "median", "ONNX", "kernel", "paper's mean")
    ),
    "machine": partial(findings.machine, "efficiency"),
    "gpu-machine": partial(findings.machine, "efficiency-gpu"),
    "gpu": partial(data.listing, "efficiency-gpu", ("model", "step", "median", "the paper's", "epoch", "foten's")),
    "epochs": partial(
        data.listing, "efficiency", ("model", "param", "epoch [s]", "of it", "epoch in", "foten's", "the paper's")
    ),
    "quicker": findings.quicker,
}
"""Tables of the page by the names of their markers."""
