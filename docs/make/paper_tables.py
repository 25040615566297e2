"""Tables of *Compared systems*: Table I to III, Fig. 5 and what stands beside them, from the CSV files in docs/results."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise, product

import numpy as np
from scipy.stats import rankdata, spearmanr
from scipy.stats import t as student_t

from csv_records import (
    AR_LSD,
    BEST_AR,
    CONTACT,
    ERROR,
    EXCITED,
    LEVEL,
    LSD,
    MAIN,
    ONE_STEP,
    OURS,
    REAL_2_5,
    REAL_10,
    REAL_TABLE_1,
    RESULTS,
    SIMULATED,
    csv_rows,
    mean,
    mean_of,
    of_file,
    place_of,
    records_of,
    runs_of,
    values,
)
from foten.evaluate.warm_start import CONVERGED_MS, SILENT_DB
from foten.experiments.experiment import experiment_path, read_experiment
from foten.experiments.method_tables import (
    BY_RECIPE,
    PAPER,
    Row,
    complete,
    findings,
    holm,
    rows_of,
    same_blocks,
    signed_rank,
    summary,
    warm_start,
)
from foten.experiments.results import BEST_LINEAR, VALIDATION, WITHOUT, Record, Records, by_recipe, chosen
from foten.recording.windows import first_scored
from foten.reporting.table import Cell, Number, Table

OTHER_DATA = {MAIN[CONTACT]: CONTACT, "real recordings": REAL_TABLE_1}
"""Experiments with all systems on other data than Table I's, by what that is."""
BEHIND_LOW_PASS = "table-1-350hz"  # whose recordings docs/make/headline.py writes
SYSTEM_NAMES = {"ar": "AR", "fnn": "FNN", "dstn": "DSTN", "ldhtd": "LDHTD", "gan": "GAN", "foten": "FoTEN"}
QUICKER = 0.9  # times the seconds of another in one run of the benchmark, so that chance alone does not make an order
COMPARED = ("dstn", "ldhtd", "gan")  # in Table III
PAPER_GFC = {"ar": 86.28, "fnn": 87.83, "dstn": 90.33, "ldhtd": 91.02, "gan": 88.65, "foten": 92.15}
"""The paper's GFC [%], means over its twelve textures; Table I."""
VARIANTS_GFC = {"ten": 86.77, "ten-mfcc": 90.28, "ten-wavelet": 86.18, "foten-d": 90.64}
"""The same of its variants; Table II."""
SHORT_LINEAR, PIECEWISE = "AR(20)", "piecewise AR [12]"
LINEAR_LEVEL = "free_run_ar.level_error_db"
SILENCE = "references.zero.mae_scaled"
FAILED = 0.98  # of silence's error, from which on a network has learned nothing
PAPER_CELL = (20, "huber")  # window [samples] and loss, the paper's best, with δ = 1.6; Fig. 5
VARIANTS = {
    "ten": "TEN",
    "ten-mfcc": "TEN + MFCC",
    "ten-wavelet": "TEN + wavelets",
    "foten": "FoTEN",
    "foten-d": "FoTEN-D",
}
"""The paper's names of its variants; Table II."""
CHANGES = {
    "seed": "seed {}",
    "dropout": "no dropout",
    "batch": "batches of {}",
    "clip_norm": "clipped gradients",
    "initial_weights": "PyTorch's weights",
}
"""Settings of Fig. 5's grid beside window, loss and threshold, as its rows name them."""
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


def cost(name: str, heads: Sequence[str] = ("",)) -> Table:
    """Columns of the costs of steps and epochs, by how their headings begin; by default all."""
    with (RESULTS / f"{name}.csv").open(encoding="utf-8") as file:
        heading, *rows = csv.reader(file)
    shown = [k for head in heads for k, title in enumerate(heading) if title.startswith(head)]
    return Table.of([heading[k] for k in shown], [[row[k] for k in shown] for row in rows])


def machine(name: str) -> str:
    """Sentence on what the costs in a CSV were measured on."""
    machines = {row["machine"] for row in csv_rows(name) if row.get("machine")}
    return f"Measured on: {', '.join(sorted(machines))}." if machines else ""


def quicker() -> str:
    """Sentence on which compared systems are quicker than the paper's network, in a step and in an epoch, on a CPU and a GPU."""

    def those(name: str, of: str) -> str:
        times = {row["model"]: row[of] for row in csv_rows(name)}
        limit = QUICKER * float(times["foten"])
        quick = [SYSTEM_NAMES[key] for key in COMPARED if times[key] != "–" and float(times[key]) < limit]
        *first, last = quick or ["none"]
        return f"{', '.join(first)} and {last}" if first else last

    return (
        "In the paper no compared system is quicker than FoTEN, in a step or in an epoch. Here, in PyTorch, quicker in a step: "
        f"{those('efficiency', 'PyTorch, mean [µs]')}; in an epoch: {those('efficiency', 'epoch in PyTorch alone [s]')}. On a "
        f"GPU in a step: {those('efficiency-gpu', 'step, mean [µs]')}; in an epoch: {those('efficiency-gpu', 'epoch [s]')}. "
        f"What differs by less than {100 * (1 - QUICKER):.0f} % is not counted. {slower_on_gpu()}"
    )


def slower_on_gpu() -> str:
    """Sentence on how many models take longer on a GPU than on a CPU."""
    heads = {
        "a step": ("PyTorch, mean [µs]", "step, mean [µs]"),
        "an epoch": ("epoch in PyTorch alone [s]", "epoch [s]"),
    }
    on_cpu = {row["model"]: row for row in csv_rows("efficiency")}
    counts = []
    for name, (cpu, gpu) in heads.items():
        times = [
            (float(on_cpu[row["model"]][cpu]), float(row[gpu])) for row in csv_rows("efficiency-gpu") if row[gpu] != "–"
        ]
        counts.append(f"{name} for {sum(a < b for a, b in times)} of {len(times)}")
    return f"Longer on the GPU than on the CPU take {' and '.join(counts)} models that were measured on both."


Place = tuple[str, float]


def by_place(records: Records) -> dict[str, dict[Place, Record]]:
    """Runs of each method by texture and split."""
    methods: dict[str, dict[Place, Record]] = {}
    for record in records:
        methods.setdefault(record["method"], {})[record["texture"], record["split"]] = record
    return methods


PAPERS, TUNED, OWN = "the paper's", "tuned", "its own"
TABLE_1 = {PAPERS: "table-1", TUNED: "table-1-tuned"}
"""Experiments of Table I, by what its recipes are called."""
WITH_OWN = ("ar", "gan", OURS)
"""Models that the paper's recipe is not for."""


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
    textures = [{record["texture"] for record in records if record["method"] == method} for method in methods]
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


def textures_of(records: Records) -> set[str]:
    return {record["texture"] for record in records}


def so_far() -> str:
    """How much of Table I is done."""
    planned = len(read_experiment(experiment_path("table-1")).textures)
    done = {recipe: len(textures_of(of_all_systems(recipe))) for recipe in TABLE_1}
    parts = [f"{n} of {planned} textures by {recipe} recipes" for recipe, n in done.items() if n < planned]
    return f"Done so far: {'; '.join(parts)}." if parts else f"All {planned} textures have both recipes."


def both_recipes() -> Table:
    """Errors of one step by both recipes of each system, on the textures that have both; on validation too, which chooses."""
    return side_by_side("paper's recipe, or own", "tuned", *of_sides(by_both() or table_1()))


def changed() -> Table:
    """Errors of one step by tuned recipes and with one change of each, on the recordings of the latter."""
    before = by_place(runs_of("table-1-tuned"))
    pairs = []
    for one in runs_of("table-1-changed"):
        system = one["method"].partition(", ")[0]
        if (tuned := before.get(system, {}).get((one["texture"], one["split"]))) is not None:
            pairs.append(({**tuned, "method": one["method"]}, one))
    return side_by_side("tuned", "changed", *map(list, zip(*pairs, strict=True))) if pairs else Table((), ())


ON_A_PAR = {
    "as tuned": ("", ""),
    "both with FoTEN's window": (", FoTEN's window", ""),
    "both with DSTN's window": ("", ", DSTN's window"),
    "both of FoTEN's size": (", FoTEN's size", ""),
    "both of DSTN's size": ("", ", DSTN's size"),
    "both with FoTEN's loss": (", FoTEN's loss", ""),
    "both with twice the epochs": (", twice the epochs", ", twice the epochs"),
}
"""Changes to DSTN and to FoTEN that take one difference between the two away, by what they are then."""


def difference_explained() -> str:
    """Sentence on DSTN's lead over FoTEN in one step, as tuned and with one difference less between the two."""
    changed = runs_of("table-1-changed")
    methods = by_place([*runs_of("table-1-tuned"), *changed])
    places = sorted({(record["texture"], record["split"]) for record in changed})
    parts = []
    for name, changes in ON_A_PAR.items():
        pair = [
            methods.get(f"{system}{change}", {}) for system, change in zip(("DSTN [15]", "FoTEN"), changes, strict=True)
        ]
        if not places or any(place not in runs for runs in pair for place in places):
            return ""
        ahead, behind = ([runs[place][ONE_STEP] for place in places] for runs in pair)
        lead = np.subtract(behind, ahead)
        parts.append(f"{name} {lead.mean():.3f} ({np.sum(lead > 0)})")
    of_what = (
        f"DSTN's lead over FoTEN in one step [sd], mean over the {len(places)} textures, and on how many it is ahead"
    )
    return f"{of_what}: {', '.join(parts)}."


def side_by_side(first: str, second: str, *sides: Records) -> Table:
    """Errors of one step of two sides by system, on test and validation blocks, and epochs."""
    left, right = map(by_place, sides)
    rows = []
    for method, of_left in left.items():
        both = [*of_left.values()], [*right.get(method, {}).values()]
        paths = (next((key for key in VALIDATION if values(side, key)), VALIDATION[0]) for side in both)
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


def table_1_findings() -> str:
    """Sentences on Table I, but for those on recipes, which stand in a table."""
    return "\n".join(f"- {line}" for line in findings(table_1()) if BY_RECIPE not in line) if table_1() else ""


def errors_of(records: Records) -> tuple[list[str], list[Row]]:
    """Textures, and rows of one-step errors of references and of systems, each once."""
    return rows_of([record for record in records if not record["method"].endswith(EXCITED)], "mae")


def beside(reference: str, records: Records) -> dict[str, tuple[float, str, str]]:
    """Errors of one step beside a linear predictor's, by system: ratio, number of textures below, p after Holm over systems."""
    textures, rows = errors_of(records)
    linear = next((row for row in rows if row.name == reference), None)
    if linear is None:
        return {}
    systems = complete(rows, textures)
    p, cells = signed_rank(linear, systems, textures), {}
    for row in systems:
        ratios = row.means(textures) / linear.means(textures)
        below = f"{np.sum(ratios < 1)} of {ratios.size}"
        cells[row.name.removesuffix(WITHOUT)] = (float(ratios.mean()), below, f"{p[row.name]:.3f}" if p else "–")
    return cells


def beside_ar() -> Table:
    """Errors of one step by both recipes beside those of the best AR: ratio, number of textures, p after Holm over systems."""
    sides = [
        {name: (f"{ratio:.3f}", below, p) for name, (ratio, below, p) in beside(BEST_LINEAR, side).items()}
        for side in of_sides(by_both() or table_1())
    ]
    heads = ("paper's recipe, or own: ÷ best AR", "below it on", "p", "tuned: ÷ best AR", "below it on ", "p ")
    return Table.of(("", *heads), [(name, *(c for of in sides for c in of.get(name, ("–",) * 3))) for name in sides[0]])


def beside_short_ar() -> str:
    """Sentence on where systems are below AR(20), which sees as many samples as the paper's network."""
    parts = []
    recipes = ("by the paper's recipe or its own", "by the tuned one")
    for recipe, side in zip(recipes, of_sides(by_both() or table_1()), strict=True):
        groups: dict[tuple[str, str], list[str]] = {}
        for system, (_, *on) in beside(SHORT_LINEAR, side).items():
            groups.setdefault((on[0], on[1]), []).append(system)
        counts = [f"{below} for {', '.join(systems)} (p {p})" for (below, p), systems in groups.items()]
        parts += [f"{recipe}: {', '.join(counts)}"] if counts else []
    first = "AR(20) sees 20 samples, as FoTEN does; best AR may see 240. Textures on which a system is below AR(20),"
    return f"{first} {'; '.join(parts)}." if parts else ""


def neighbours(records: Records) -> str:
    """Sentence on what chance may have done to the order of systems by their errors of one step."""
    textures, rows = errors_of(records)
    systems = sorted(complete(rows, textures), key=lambda row: float(row.means(textures).mean()))
    p = [value for row, behind in pairwise(systems) for value in signed_rank(row, [behind], textures).values()]
    if not p:  # fewer than six textures
        return ""
    pairs = []
    for (first, second), value in zip(pairwise(systems), holm(p), strict=True):
        ahead = np.concatenate([first.values[texture] < second.values[texture] for texture in textures])
        pairs.append(f"{first.name} is ahead of {second.name} on {ahead.sum()} (p {value:.3f})")
    return (
        f"Neighbours in one step, best first, on {ahead.size} recordings of {len(textures)} textures; p of the textures' means, "
        f"after Holm for {len(p)} pairs: {'; '.join(pairs).replace(WITHOUT, '')}."
    )


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


def on_other_data(name: str) -> Table:
    """All systems on other data than Table I's, without the paper's figures, which are of twelve textures of its own."""
    records = tuned_on(name)
    if not records:
        return Table((), ())
    shown = compared(chosen(records))
    kept = [k for k, column in enumerate(shown.columns) if not str(column).startswith("paper's")]
    return Table.of([shown.columns[k] for k in kept], [[row[k] for k in kept] for row in shown.rows])


def ahead_of(model: str, records: Records) -> str:
    """Sentence on how many textures each other method's error of one step is below that of a model on, with p."""
    textures, rows = errors_of(records)
    own, *others = sorted(complete(rows, textures), key=lambda row: row.model != model)
    p = signed_rank(own, others, textures)
    counts = ", ".join(
        f"{row.name.removesuffix(WITHOUT)} {np.sum(row.means(textures) < own.means(textures))}"
        + (f" (p {p[row.name]:.3f})" if row.name in p else "")
        for row in others
    )
    of_p = " (p of the difference)" if p else ""
    return f"Of {len(textures)} textures, the one-step error is below that of {own.name} on{of_p}: {counts}."


def contact_findings() -> str:
    """Sentences on contact mechanics: where others are ahead of ours in one step, with p, and the best of each figure."""
    shown = chosen(tuned_on(CONTACT))
    if not shown:
        return ""
    lines = [
        line for line in findings(shown) if line.startswith(("one-step MAE", "free-run")) and "none of" not in line
    ]
    return "\n".join(f"- {line}" for line in (ahead_of(OURS, shown), *lines))


def on_real() -> str:
    """Sentences on which splits of the real recordings are compared, and which of them are the same blocks."""
    records, shared = records_of(REAL_TABLE_1), tuned_on(REAL_TABLE_1)
    n, of = (len({(record["texture"], record["split"]) for record in some}) for some in (shared, records))
    return " ".join([f"Means over the {n} of {of} splits that all systems have.", *same_blocks(shared)]) if n else ""


def means_of(records: Records, path: str) -> dict[str, float]:
    """Means over textures of a figure of the paper's systems, by model, but for those that lack it in a run."""
    means = {}
    for model in PAPER_GFC:
        runs = [record for record in records if record["model"] == model and not record["method"].endswith(EXCITED)]
        by_texture = values(runs, path)
        if runs and sum(map(len, by_texture)) == len(runs):
            means[model] = float(np.mean([np.mean(splits) for splits in by_texture]))
    return means


EARLY_AND_LATE = [f"warm_start.{{}}.error_to_silence_{part}_ms" for part in ("0_100", "100_400")]


def convergence() -> Table:
    """When free runs from two windows are the same, and their error over silence's before and after 100 ms, Sec. V-a.

    Of Table I's systems, and of those by the paper's recipe, which the claim is about.
    """
    shown = [*chosen(table_1()), *(record for record in table_1() if record["recipe"] == PAPERS)]
    shown += ({**record, "recipe": PAPERS} for record in of_variants() if record["model"] == "ten")
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
        name = f"{method}, the paper's recipe" if recipe == PAPERS else method
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
    if not table_1():
        return Table((), ())
    figures = [("one step, the paper's recipe for all [sd]", of_all_systems(PAPERS), ONE_STEP)]
    figures += [(figure, chosen(table_1()), path) for figure, path in ORDERS.items()]
    figures += [(f"one step, {title} [sd]", chosen(tuned_on(name)), ONE_STEP) for title, name in OTHER_DATA.items()]
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
    records = table_1()
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
        name, paper = (VARIANTS | SYSTEM_NAMES)[model], PAPER[model]
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
    smooth = [{**run, "texture": run["texture"].rpartition("-")[0]} for run in runs_of(BEHIND_LOW_PASS)]
    tuned = runs_of("table-1-tuned")
    behind = by_place(smooth)
    methods = {name for name in behind if len(behind[name]) == max(map(len, behind.values()))}
    methods &= {run["method"] for run in tuned}
    both = [with_all([run for run in part if run["method"] in methods], methods) for part in (tuned, smooth)]
    shared = set.intersection(*map(textures_of, both))
    columns: dict[str, list[Cell]] = {}
    for part in both if shared else ():
        systems = by_place([run for run in part if run["texture"] in shared])
        errors = [mean_of([*of.values()], ONE_STEP, "").value or 0.0 for of in systems.values()]
        for (method, of), rank in zip(systems.items(), in_order(errors), strict=True):
            runs = [*of.values()]
            columns.setdefault(method, []).extend((mean(ONE_STEP)(runs), mean(ONE_STEP, BEST_AR)(runs), rank))
    heads = ("MAE [sd]", "÷ best AR", "rank", "behind 350 Hz: MAE [sd]", "÷ best AR ", "rank ")
    return Table.of(("", *heads), [(method, *cells) for method, cells in columns.items()])


def near() -> list[Record]:
    """Runs of systems that are near one another, by their tuned recipes, on the textures whose three recordings all have."""
    more = runs_of("table-1-near")
    methods, splits = ({record[key] for record in more} for key in ("method", "split"))
    n_done = Counter(record["texture"] for record in more)
    shown = [r for r in (*runs_of("table-1-tuned"), *more) if r["method"] in methods]
    done = [record for record in shown if n_done[record["texture"]] == len(methods) * len(splits)]
    return done if len(textures_of(done)) >= 6 else []  # as a p needs


def near_neighbours() -> str:
    """Sentences on the order of near systems: of textures with three recordings, and with the others, which have one."""
    if not (shown := near()):
        return ""
    methods, textures = ({record[key] for record in shown} for key in ("method", "texture"))
    single = [r for r in runs_of("table-1-tuned") if r["method"] in methods and r["texture"] not in textures]
    of_all = [*shown, *with_all(single, methods)]
    lines = [neighbours(records) for records in ((shown, of_all) if len(of_all) > len(shown) else (shown,))]
    return "\n".join(f"- {line}" for line in lines)


def of_variants() -> list[Record]:
    """Runs of the network's variants, and of the network itself, whose runs are those of Table I by the published recipe."""
    variants = [record for record in runs_of("table-2") if record["model"] != "foten"]
    done = {(record["texture"], record["split"]) for record in variants}
    network = [
        {**record, "experiment": variants[0]["experiment"]}
        for record in runs_of("table-1")
        if record["method"] == VARIANTS["foten"] and (record["texture"], record["split"]) in done
    ]
    return [
        {**record, "method": name}
        for key, name in VARIANTS.items()
        for record in (*variants, *network)
        if record["model"] == key
    ]


def table_2() -> Table:
    """Variants of the network beside the network, on the textures that all have so far; none has an excitation."""
    if not (records := with_all(of_variants(), VARIANTS.values())):
        return Table((), ())
    shown = compared(records)
    return replace(shown, rows=tuple((str(name).removesuffix(WITHOUT), *cells) for name, *cells in shown.rows))


def table_2_findings() -> str:
    """Sentences on the variants: where they are ahead of the network in one step, with p, and their order."""
    if not (records := with_all(of_variants(), VARIANTS.values())):
        return ""
    lines = [line for line in findings(records) if line.startswith(("one-step", "By one-step error"))]
    lines = [ahead_of("foten", records), *lines, *failed(records)]
    return "\n".join(f"- {line}" for line in lines).replace(WITHOUT, "")


def failed(records: Records) -> list[str]:
    """Sentences on trainings that predict no better than silence, and on the figures of the textures without one."""
    fails = [record for record in records if record[ONE_STEP] > FAILED * record[SILENCE]]
    if not fails:
        return []
    textures = textures_of(fails)
    rest = [record for record in records if record["texture"] not in textures]
    figures = (
        f"{name} {mean_of([*of.values()], ONE_STEP)}, {100 * (mean_of([*of.values()], 'one_step.gfc').value or 0.0):.1f} %"
        for name, of in by_place(rest).items()
    )
    runs = ", ".join(f"{record['method']} on {record['texture']}" for record in fails)
    return [
        f"Within {100 * (1 - FAILED):.0f} % of silence's one-step error, or above: {runs}.",
        f"Without {' and '.join(sorted(textures))}: {ahead_of('foten', rest)} MAE [sd] and GFC: {'; '.join(figures)}.",
    ]


def cell_of(record: Record) -> dict[str, str]:
    """Settings of a run's cell in the grid, by the name of its row."""
    return dict(item.rsplit(" ", 1) for item in record["method"].removeprefix(f"{record['model']} ").split(", "))


def in_textures(records: Records) -> list[Record]:
    """Runs in the order of their textures' names."""
    return sorted(records, key=lambda record: record["texture"])


def of_grid() -> tuple[list[Record], list[str]]:
    """Runs of the grid on the textures that are done, and the textures that are not."""
    planned = Counter(run.place[2] for run in read_experiment(experiment_path("figure-5")).runs())
    done = Counter(record["texture"] for record in runs_of("figure-5"))
    missing = [texture for texture, n in planned.items() if done[texture] < n]
    return [record for record in runs_of("figure-5") if record["texture"] not in missing], missing


def grid_so_far() -> str:
    """How much of the grid is done."""
    records, missing = of_grid()
    done = ", ".join(sorted(textures_of(records))) or "no texture"
    return f"Done so far: {done}; not yet: {', '.join(missing)}." if missing else f"Means over {done}."


def by_window() -> dict[tuple[int, str], list[Record]]:
    """Runs of the grid by window and loss; the Huber loss is that of 1.6."""
    cells: dict[tuple[int, str], list[Record]] = {}
    for record in of_grid()[0]:
        if "window" in (cell := cell_of(record)):
            cells.setdefault((int(cell["window"]), cell["loss"]), []).append(record)
    return cells


def of_huber() -> dict[str, list[Record]]:
    """Runs of the grid at the paper's window with the Huber loss: by its threshold, by another seed, and with one change."""
    cells = {"1.6": by_window().get(PAPER_CELL, [])}
    for record in of_grid()[0]:
        cell = cell_of(record)
        if "delta" in cell:
            cells.setdefault(f"{float(cell['delta']):.1f}", []).append(record)
        elif "window" not in cell:
            ((name, value),) = cell.items()
            cells.setdefault(f"1.6, {CHANGES[name].format(value)}", []).append(record)
    return {name: cells[name] for name in sorted(cells) if cells[name]}


def of_seeds() -> list[list[Record]]:
    """Runs of the paper's best cell, by seed."""
    return [in_textures(records) for name, records in of_huber().items() if name == "1.6" or "seed" in name]


def windows_by_loss() -> Table:
    """Errors of one step by window and loss, means over the textures: test and validation."""
    cells, losses = by_window(), ("mae", "mse", "huber")
    columns = [*product((ONE_STEP, VALIDATION[0]), losses)]
    rows = [
        (str(window), *(mean(path, digits=4)(cells.get((window, loss), [])) for path, loss in columns))
        for window in sorted({window for window, _ in cells})
    ]
    heads = (
        f"{part}: {losses[0]}" if loss == losses[0] else loss + " " * k
        for k, part in enumerate(("test", "validation"))
        for loss in losses
    )
    return Table.of(("window [samples]", *heads), rows)


def by_threshold() -> Table:
    """Errors of one step by the threshold of the Huber loss, another seed, and a change of the recipe: test and validation."""
    cells = of_huber()
    rows = [(name, *(mean(path, digits=4)(cells[name]) for path in (ONE_STEP, VALIDATION[0]))) for name in cells]
    return Table.of(("δ [sd]", "test: MAE [sd]", "validation"), rows)


def grid_findings() -> str:
    """Sentences on the grid: its best cell by validation, windows and losses, and what one change of the recipe does."""
    if not of_grid()[0]:
        return ""

    def error(records: Records, path: str = ONE_STEP) -> float:
        return mean_of(records, path).value or 0.0

    def ratios(of: Mapping[str, Records], to: Records) -> str:
        """Ratios of errors to others of the same textures, in their order, and how many are below 1."""
        texts = []
        for name, records in of.items():
            ratio = np.array([record[ONE_STEP] for record in records]) / [record[ONE_STEP] for record in to]
            texts.append(f"{name} {ratio.mean():.3f} ({np.sum(ratio < 1)} of {ratio.size})")
        return ", ".join(texts)

    def joined(part: int, name: int | str) -> list[Record]:
        return [record for cell in sorted(cells) if cell[part] == name for record in in_textures(cells[cell])]

    cells = by_window()
    thresholds = {name: in_textures(records) for name, records in of_huber().items()}
    changes = {name.removeprefix("1.6, "): records for name, records in thresholds.items() if name.startswith("1.6, ")}
    window, loss = best = min(cells, key=lambda cell: error(cells[cell], VALIDATION[0]))
    seeds = [*map(error, of_seeds())]
    paper_window, paper_loss = PAPER_CELL
    windows, losses = ({cell[part] for cell in cells} - {PAPER_CELL[part]} for part in (0, 1))
    lines = (
        f"Best on validation: {window} samples and loss {loss}, with {error(cells[best]):.4f} on test. The paper's best, "
        f"{PAPER_CELL[0]} samples and loss {PAPER_CELL[1]} with δ = 1.6, has {error(cells[PAPER_CELL]):.4f}; "
        f"its {len(seeds)} seeds range from {min(seeds):.4f} to {max(seeds):.4f}.",
        f"Error ÷ that of the loss {paper_loss} on the same textures with the same windows, and how many are below: "
        f"{ratios({name: joined(1, name) for name in sorted(losses)}, joined(1, paper_loss))}.",
        f"Error ÷ that of {paper_window} samples with the same losses: "
        f"{ratios({f'{name} samples': joined(0, name) for name in sorted(windows)}, joined(0, paper_window))}.",
        f"Error ÷ that of the paper's best with δ = 1.6: {ratios(changes, thresholds['1.6'])}.",
    )
    return "\n".join(f"- {line}" for line in lines)


Methods = Mapping[str, Mapping[Place, Record]]


def over_others(methods: Methods, path: str) -> dict[str, list[Record]]:
    """A figure of foten-plus over that of each other system, as records of `texture` and `ratio`."""
    ours = next(of for name, of in methods.items() if name.startswith(OURS))
    ratios: dict[str, list[Record]] = {}
    for name, of in methods.items():
        if of is not ours:
            pairs = {place: (ours[place].get(path), of[place].get(path)) for place in ours if place in of}
            ratios[name] = [{"texture": place[0], "ratio": a / b} for place, (a, b) in pairs.items() if a and b]
    return ratios


def over_best(methods: Methods, path: str) -> str:
    """Mean of a figure of foten-plus over that of the other system beside which it is worst on the test blocks."""
    ratios = over_others(methods, path)
    textures = {texture for name, of in methods.items() if name.startswith(OURS) for texture, _ in of}
    of_all = [name for name, of in ratios.items() if {record["texture"] for record in of} == textures]
    worst = max(of_all, key=lambda name: mean_of(ratios[name], "ratio", "").value or 0.0, default="")
    return f"{over_textures(ratios[worst], 'ratio')} ({worst})" if worst else "–"


def over_textures(records: Records, over: str, under: str = "", digits: int = 3) -> Number:
    """Mean over textures ± its standard error, which is that of textures here and not of splits."""
    means = np.array([np.mean(splits) for splits in values(records, over, under)])
    error = float(means.std(ddof=1) / np.sqrt(means.size)) if means.size > 1 else None
    return Number(float(means.mean()) if means.size else None, f".{digits}f", error)


def interval(records: Records, over: str, under: str = "") -> str:
    """Student's interval of 95 % of a mean over textures."""
    ratio, n = over_textures(records, over, under), len(values(records, over, under))
    reach = student_t.ppf(0.975, n - 1) * (np.nan if ratio.error is None else ratio.error)
    return f"{(ratio.value or 0.0) - reach:.2f} to {(ratio.value or 0.0) + reach:.2f}"


def levels() -> str:
    """Sentences on silent free runs of the network, and on level errors of it, of linear predictors and of ours."""
    papers, tuned = ([one for one in side if one["method"] == VARIANTS["foten"]] for side in of_sides(by_both()))
    silent, by_papers = (sum(one["warm_start.stored.level_db"] < SILENT_DB for one in side) for side in (tuned, papers))
    methods = {name: [*of.values()] for name, of in by_place(chosen(by_both())).items()}
    errors = (
        ("FoTEN, tuned,", tuned, "free_run_deterministic.level_error_db"),
        ("AR(20), whose noise is constant,", tuned, LINEAR_LEVEL),
        ("piecewise AR", methods[PIECEWISE], LEVEL),
        ("FoTEN with our excitation", methods[f"FoTEN {EXCITED}"], LEVEL),
        (OURS, methods[f"{OURS} (ours)"], LEVEL),
        ("a second realisation", tuned, "ceiling.level_error_db"),
    )
    return (
        f"FoTEN has no random part, and its free run is silent ({-SILENT_DB:.0f} dB or more below the recording) on {silent} of "
        f"{len(tuned)} simulated textures by its tuned recipe, on {by_papers} by the paper's. Level errors there [dB]: "
        f"{'; '.join(f'{name} {mean(path, digits=1)(runs)}' for name, runs, path in errors)}."
    )


def beside_dstn() -> list[str]:
    """Sentences on our error of one step over DSTN's: an interval, and which textures carry the mean."""
    both = [over_others(by_place(chosen(EQUAL[MAIN[name]]())), ONE_STEP) for name in (SIMULATED, CONTACT)]
    simulated, contact = (of["DSTN [15]"] for of in both)
    ordered = sorted(((one["ratio"], one["texture"]) for one in contact), reverse=True)
    percents, names = np.array([100 * (ratio - 1) for ratio, _ in ordered]), [name for _, name in ordered[:3]]
    return [
        f"One step ÷ DSTN's on simulated textures: {interval(simulated, 'ratio')} (95 %, n = {len(simulated)}).",
        f"On contact mechanics, the one-step error of {OURS} is {percents.mean():.0f} % above DSTN's, a mean of ratios whose "
        f"median is {np.median(percents):.0f} %; {', '.join(names)} carry it: without them it is {percents[3:].mean():.0f} %.",
    ]


def seconds_of_test(name: str) -> str:
    """Sentence on how many seconds of test blocks the figures of real recordings rest on."""
    blocks: dict[str, set[object]] = {}
    if name == REAL_TABLE_1:  # one block for each split; silence's error tells two apart
        for record in records_of(name):
            blocks.setdefault(record["texture"], set()).add(record[SILENCE])
    for row in () if blocks else csv_rows("limits"):
        blocks.setdefault(row["texture"], set()).update(row["test blocks"].split())
    block_s = of_file(name)["preprocess"]["block_ms"] / 1000
    low, *_, high = sorted(block_s * len(numbers) for numbers in blocks.values())
    of_split = (
        f"{block_s * records_of(name)[0]['n_blocks']:.1f} s in each of {len(of_file(name)['split_seeds'])} splits"
    )
    rates = [of_file(one)["preprocess"]["rate_hz"] for one in ((REAL_10, REAL_2_5) if name == REAL_10 else (name,))]
    scored = (1 - first_scored(round(block_s * rate)) / (block_s * rate) for rate in rates)
    shares = (f"{100 * share:.0f} % at {rate / 1000:g} kHz" for share, rate in zip(scored, rates, strict=True))
    in_all = f"The test blocks of a real recording hold {low:.1f} to {high:.1f} s in all, {of_split}, which share them."
    return f"{in_all} One step is scored on part of each: {', '.join(shares)}."


def real_intervals() -> str:
    """Sentence on ours beside linear predictors on real recordings."""
    ours = [record for record in chosen(tuned_on(REAL_TABLE_1)) if record["model"] == OURS]
    return (
        f"{OURS} beside linear predictors (95 %, n = {len(textures_of(ours))}): one step ÷ best AR "
        f"{interval(ours, ONE_STEP, BEST_AR)}, LSD ÷ AR(20) {interval(ours, LSD, AR_LSD)}, level error ÷ AR(20) "
        f"{interval(ours, LEVEL, LINEAR_LEVEL)}."
    )


def equal_tuning() -> Table:
    """foten-plus over the other systems at equally many recipes, over the best AR and over piecewise AR: means over textures."""
    rows = []
    for title, records in EQUAL.items():
        methods = by_place(chosen(records()))
        ours = [record for name, of in methods.items() if name.startswith(OURS) for record in of.values()]
        if ours:
            textures = str(len({record["texture"] for record in ours}))
            cells: list[Cell] = [over_best(methods, ONE_STEP), over_textures(ours, ONE_STEP, BEST_AR)]
            for path in (LSD, LEVEL):
                piecewise = over_others(methods, path).get(PIECEWISE, [])
                cells += [over_best(methods, path), over_textures(piecewise, "ratio")]
            rows.append((title, textures, *cells))
    heads = ("one step ÷ best system", "÷ best AR", "LSD ÷ best system", "÷ piecewise AR")
    return Table.of(("", "textures", *heads, "level error ÷ best system", "÷ piecewise AR "), rows)


EQUAL: Mapping[str, Callable[[], Records]] = {
    MAIN[SIMULATED]: by_both,
    **{title: partial(tuned_on, name) for title, name in OTHER_DATA.items()},
}
"""Runs in which the other systems have the best of at least as many recipes as ours."""


def recipes() -> Table:
    """Best recipes on validation of each system whose runs are all done: error of scaled samples, of the GAN of spectra [dB]."""
    records, rows = records_of("recipes"), []
    runs = read_experiment(experiment_path("recipes")).runs()
    caps = {run.place: run.train["epochs"] for run in runs}
    planned, done = (Counter(place[0] for place in places) for places in (caps, map(place_of, records)))
    complete = [record for record in records if done[record["method"]] == planned[record["method"]]]
    for method, errors in by_recipe(complete).items():
        (best, lowest), (second, next_lowest), *_, (_, highest) = errors.items()
        of_method = [record for record in complete if record["method"] == method]
        at_cap = sum(record["epochs"] == caps[place_of(record)] for record in of_method)
        figures = (best, f"{lowest:.4f}", second, f"{next_lowest:.4f}", f"{highest:.4f}")
        stops = any(run.train["patience"] < run.train["epochs"] for run in runs if run.method == method)
        rows.append([method, str(len(errors)), *figures, f"{at_cap} of {len(of_method)}" if stops else "–"])
    return Table.of(("", "tried", "best", "its error", "second", "its error ", "worst error", "ran to the cap"), rows)


def headline() -> Table:
    """AR(20)'s errors by band and regime, beside silence and a second realisation: means over the textures."""
    rows = csv_rows("headline")
    digits = {"silence [sd]": 3, "one step [sd]": 3, "one-step GFC [%]": 1, "free run [sd]": 3, "free run's GFC [%]": 1}
    digits |= {"second realisation [sd]": 3, "second realisation's GFC [%]": 1}

    def cells(band: str) -> list[str]:
        of_band = [row for row in rows if row["band"] == band]
        return [band, *(f"{np.mean([float(row[name]) for row in of_band]):.{n}f}" for name, n in digits.items())]

    return Table.of(("acceleration", *digits), [cells(band) for band in dict.fromkeys(row["band"] for row in rows)])


TABLES: dict[str, Callable[[], Table | str]] = {
    "so-far": so_far,
    "table-1": lambda: compared(chosen(table_1())) if table_1() else Table((), ()),
    "findings": table_1_findings,
    "both-recipes": both_recipes,
    "beside-ar": beside_ar,
    "beside-short-ar": beside_short_ar,
    "neighbours": lambda: neighbours(chosen(table_1())),
    "neighbours-papers": lambda: neighbours(of_all_systems(PAPERS)),
    "near": lambda: compared(near()) if near() else Table((), ()),
    "near-neighbours": near_neighbours,
    "changed": changed,
    "difference-explained": difference_explained,
    "convergence": convergence,
    "levels": levels,
    "beside-dstn": lambda: " ".join(beside_dstn()),
    "seconds": partial(seconds_of_test, REAL_TABLE_1),
    "real-intervals": real_intervals,
    "warm-start": lambda: warm_start(chosen(table_1())) if table_1() else Table((), ()),
    "equal-tuning": equal_tuning,
    "table-2": table_2,
    "table-2-findings": table_2_findings,
    "grid-so-far": grid_so_far,
    "windows-by-loss": windows_by_loss,
    "thresholds": by_threshold,
    "grid-findings": grid_findings,
    "recipes": recipes,
    "orders": orders,
    "headline": headline,
    "pairs": pairs,
    "bands": bands,
    "on-contact": partial(on_other_data, CONTACT),
    "contact-findings": contact_findings,
    "table-1-real": partial(on_other_data, REAL_TABLE_1),
    "on-real": on_real,
    "efficiency": partial(
        cost, "efficiency", ("model", "input", "PyTorch", "median", "ONNX", "kernel", "paper's mean")
    ),
    "machine": partial(machine, "efficiency"),
    "gpu-machine": partial(machine, "efficiency-gpu"),
    "gpu": partial(cost, "efficiency-gpu", ("model", "step", "median", "the paper's", "epoch", "foten's")),
    "epochs": partial(
        cost, "efficiency", ("model", "param", "epoch [s]", "of it", "epoch in", "foten's", "the paper's")
    ),
    "quicker": quicker,
}
"""Tables of the page by the names of their markers."""
