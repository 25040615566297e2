"""Put the tables into README.md and the pages of docs/, each between its markers, from the CSV files in docs/results.

    python docs/make/tables.py [--check] [--add DIR [--recordings DIR]]

`docs/results/EXPERIMENT.csv` is the `runs.csv` that `foten tables` writes of a sweep, `paper.csv` those of the paper's tables,
which --add puts there; the others are what benchmarks keep by `--csv`. With --check nothing is written, and the exit status is 1
where a page is not what the CSV files give. A table without a CSV says so.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tomllib
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import rankdata, spearmanr

from foten.atomic_write import atomic_write
from foten.evaluate.warm_start import CONVERGED_MS, SILENT_DB
from foten.experiments.experiment import experiment_path, read_experiment
from foten.experiments.method_tables import (
    BY_RECIPE,
    PAPER,
    Row,
    brief,
    complete,
    findings,
    holm,
    ratios,
    rows_of,
    same_blocks,
    signed_rank,
    summary,
    warm_start,
)
from foten.experiments.results import (
    BEST_LINEAR,
    VALIDATION,
    WITHOUT,
    Record,
    Records,
    by_recipe,
    chosen,
    joined,
    read_records,
    runs_table,
)
from foten.reporting.table import Cell, Number, Table, mean_number
from foten.simulation import contact_mechanics, linear_family, simulate

DOCS = Path(__file__).resolve().parents[1]
RESULTS = DOCS / "results"
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
OTHER_DATA = {MAIN[CONTACT]: CONTACT, "real recordings": REAL_TABLE_1}
"""Experiments with all systems on other data than Table I's, by what that is."""
FULL_LENGTH = {
    "recipes": "recipes",
    "table-1": "paper",
    "table-1-tuned": "paper",
    "table-1-near": "paper",
    "table-1-longer": "paper",
    "table-1-350hz": "paper",
    "table-2": "paper",
    "figure-5": "paper",
}
"""Experiments of the paper's tables, and the CSV that holds their runs."""
BEHIND_LOW_PASS = "table-1-350hz"  # whose recordings docs/make/headline.py writes
DISTINCT = 0.03  # a difference of the areas for one texture that means something
MAX_COLUMNS, MAX_ROWS = 8, 12  # of a table that people read, a row of means not counted; the rest is CSV
SYSTEM_NAMES = {"ar": "AR", "fnn": "FNN", "dstn": "DSTN", "ldhtd": "LDHTD", "gan": "GAN", "foten": "FoTEN"}
QUICKER = 0.9  # times the seconds of another in one run of the benchmark, so that chance alone does not make an order
COMPARED = ("dstn", "ldhtd", "gan")  # in Table III
PAPER_GFC = {"ar": 86.28, "fnn": 87.83, "dstn": 90.33, "ldhtd": 91.02, "gan": 88.65, "foten": 92.15}
"""The paper's GFC [%], means over its twelve textures; Table I."""
NOT_RUN = "*Not measured yet with this version.*"
ONE_STEP, BEST_AR = "one_step.mae_scaled", "references.ar_best.mae_scaled"
ERROR, BOUND = "one_step.mae_m_s2", "references.bound.mae_m_s2"
LSD, AR_LSD, CEILING = "free_run.lsd_db", "free_run_ar.lsd_db", "ceiling.lsd_db"
LEVEL, CEILING_LEVEL = "free_run.level_error_db", "ceiling.level_error_db"
ORDERS = {
    "one step [sd]": ONE_STEP,
    "one step [m/s²]": ERROR,
    "one-step GFC": "one_step.gfc",
    "free run [sd]": "warm_start.stored.mae_scaled",
    "free run's GFC": "warm_start.stored.gfc",
}
"""Figures that systems may be ordered by, and where records have them; of free runs, from the warm start."""
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
    """Runs of an experiment of the paper's tables, whose CSV holds others too."""
    title = of_file(name)["title"]
    return [record for record in records_of(FULL_LENGTH[name]) if record["experiment"] == title]


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


def average(of: Callable[[Record], float], spec: str = ".2f") -> Callable[[Records], str]:
    """Cell of a mean over runs."""
    return lambda records: format(np.mean([of(record) for record in records]), spec)


def in_loop(records: Records) -> str:
    """In how many runs a rendering uses the network."""
    return f"{sum(bool(record['network_in_loop']) for record in records)} of {len(records)}"


def readme() -> Table:
    """The rows of the README, with what each means."""
    kinds = {title: runs(name) for name, title in MAIN.items()}
    # A recording at two rates is two textures.
    every = [{**record, "texture": f"{title}/{record['texture']}"} for title, of in kinds.items() for record in of]
    used = [record for record in every if record["network_in_loop"]]
    used_in = f"A rendering uses the network in {in_loop(every)} runs, where the validation blocks say that it helps"
    columns: Columns = (
        ("one step ÷ best AR", mean(ONE_STEP, BEST_AR, 2)),
        ("free run ÷ AR(20)", mean(LSD, AR_LSD, 2)),
        ("free run ÷ ceiling", mean(LSD, CEILING, 2)),
    )
    figures = table(("",), {**kinds, "network in the loop": used}, columns)
    means = [*(meaning(title, records) for title, records in kinds.items() if records), used_in]
    rows = [(*row, words) for row, words in zip(figures.rows, means, strict=False)]
    return Table.of(("", *(head for head, _ in columns), "what it means"), rows)


def meaning(title: str, records: Records) -> str:
    """What the figures of a kind of texture mean, in a line."""
    if title == MAIN[LINEAR]:
        above = 100 * (_mean(records, ERROR, BOUND).value - 1)
        return f"{above:.1f} % above the least one-step error that is possible"
    if title == MAIN[SIMULATED]:
        further = 100 * (_mean(records, LSD, CEILING).value - 1)
        return f"The free run is {further:.0f} % further away than a second realisation of the same stroke"
    one_step, free_run = _beside(records, ONE_STEP, BEST_AR), _beside(records, LSD, AR_LSD)
    return f"One-step error {one_step} that of the best linear predictor; free run {free_run} AR(20)'s"


def _mean(records: Records, over: str, under: str) -> Number:
    return mean_number(values(records, over, under), 3)


def beside_foten(name: str) -> list[Record]:
    """Our runs of an experiment, with the error of the paper's network in the same place where it has one."""
    errors = {(record["texture"], record["split"]): record[ONE_STEP] for record in runs(name, "foten")}
    return [{**record, FOTEN: errors.get((record["texture"], record["split"]))} for record in runs(name)]


def _beside(records: Records, over: str, under: str) -> str:
    """How a mean ratio differs from 1 beyond its standard error, in words."""
    ratio = _mean(records, over, under)
    if abs(ratio.value - 1) <= (ratio.error or 0.0):
        return "level with"
    return f"{100 * abs(ratio.value - 1):.0f} % {'below' if ratio.value < 1 else 'above'}"


def short() -> Table:
    """Main figures by kind of texture."""
    columns: Columns = (
        ("one step ÷ best AR", mean(ONE_STEP, BEST_AR)),
        ("÷ that of foten", mean(ONE_STEP, FOTEN)),
        ("÷ bound", mean(ERROR, BOUND)),
        ("LSD ÷ AR(20)", mean(LSD, AR_LSD)),
        ("LSD ÷ ceiling", mean(LSD, CEILING)),
        ("level error ÷ ceiling", mean(LEVEL, CEILING_LEVEL)),
        ("in the loop", in_loop),
    )
    return table(("",), {title: beside_foten(name) for name, title in MAIN.items()}, columns)


def by_texture(*names: str) -> Table:
    """Figures of each texture of experiments, and of a single experiment their mean."""
    columns: Columns = (
        ("one step [sd]", mean(ONE_STEP)),
        ("÷ best AR", mean(ONE_STEP, BEST_AR)),
        ("÷ foten", mean(ONE_STEP, FOTEN)),
        ("LSD ÷ AR(20)", mean(LSD, AR_LSD)),
        ("÷ ceiling", mean(LSD, CEILING)),
        ("level error ÷ ceiling", mean(LEVEL, CEILING_LEVEL)),
        ("in the loop", in_loop),
    )
    rows: dict[str, list[Record]] = {}
    for name in names:
        rate = f", {MAIN[name].split(', ')[1]}" if len(names) > 1 else ""
        for record in beside_foten(name):
            rows.setdefault(record["texture"] + rate, []).append(record)
    return table(("texture",), {**rows, "mean": beside_foten(names[0]) if len(names) == 1 else []}, columns)


def measured(measure: str) -> dict[str, Records]:
    """Figures of a measure, with the texture, of the runs that have it, by kind of texture."""

    def of(record: Record) -> Record:
        figures = {key.partition(".")[2]: value for key, value in record.items() if key.startswith(f"{measure}.")}
        return {"texture": record["texture"], **figures} if any(value is not None for value in figures.values()) else {}

    return {title: [*filter(None, map(of, runs(name)))] for name, title in MAIN.items()}


def stability() -> Table:
    """The worst of each kind of texture."""

    def worst(records: Records) -> Record:
        return max(records, key=lambda record: record["max_sd"])

    def largest(key: str, digits: int, under: str = "") -> Callable[[Records], str]:
        return lambda records: f"{max(r[key] / (r[under] if under else 1) for r in records):.{digits}f}"

    def forgets(records: Records) -> str:
        seconds = [s for record in records if (s := record.get("forgets_s")) is not None]
        return f"{max(seconds):.1f}" + (f", {len(records) - len(seconds)} never" if len(seconds) < len(records) else "")

    def saturated(records: Records) -> str:
        n, of = (sum(record[key] for record in records) for key in ("n_saturated", "n_samples"))
        return f"{n:.0f} of {of:,.0f}"

    columns: Columns = (
        ("largest sample", lambda records: f"{worst(records)['max_sd']:.1f}"),
        ("recorded", lambda records: f"{worst(records)['recorded_max_sd']:.1f}"),
        ("saturated", saturated),
        ("under attack", largest("attack_later_max_sd", 0)),
        ("÷ bound", largest("attack_later_max_sd", 2, "attack_bound_sd")),
        ("level off by [dB]", largest("attack_after_db", 2)),
        ("forgets in [s]", forgets),
    )
    kinds = {f"{title}: {len(records)}": records for title, records in measured("stability").items()}
    return table(("worst of",), kinds, columns)


def n_textures(records: Records) -> str:
    return str(len(records))


def onset() -> Table:
    """Means over the textures of each kind."""

    def size(key: str) -> Callable[[Records], str]:
        return average(lambda record: abs(record[key]))

    def clicks(records: Records) -> str:
        excess = [100 * (record["click_share"] - record["settled_share"]) for record in records]
        errors = [100 * record["click_standard_error"] for record in records]
        return f"{np.mean(excess):+.3f} ± {np.sqrt(np.square(errors).sum()) / len(records):.3f} %"

    columns: Columns = (
        ("textures", n_textures),
        ("level, 0 ms [dB]", size("level_db.0_ms")),
        ("100 ms", size("level_db.100_ms")),
        ("settled, at most", size("level_db.settled")),
        ("spectrum, 0 ms [dB]", size("spectrum_db.0_ms")),
        ("settled, at most", size("spectrum_db.settled")),
        ("clicks − settled", clicks),
    )
    return table(("mean of",), measured("onset"), columns)


def listened(name: str) -> dict[tuple[str, str], Records]:
    """Runs of an experiment with listeners, by what the textures are and method."""
    title = read_experiment(experiment_path(name)).title
    records = [record for record in records_of("listener") if record["experiment"] == title]
    titles = (MAIN[LINEAR], MAIN[SIMULATED], MAIN[CONTACT])
    kinds = dict(zip(titles, (linear_family.LINEAR_FAMILY, simulate.TEXTURES, contact_mechanics.CONTACT), strict=True))
    methods = dict.fromkeys(record["method"] for record in records)
    groups = {
        (title, method): [record for record in records if record["texture"] in keys and record["method"] == method]
        for (title, keys), method in product(kinds.items(), methods)
    }
    return {key: group for key, group in groups.items() if group}


def of_textures(records: Records, like: Records) -> Records:
    """Runs of the textures that other runs are of."""
    keys = {record["texture"] for record in like}
    return [record for record in records if record["texture"] in keys]


def worst_auc(records: Records) -> str:
    worst = max(records, key=lambda record: record["listener.listener_auc"])
    return f"{worst['listener.listener_auc']:.2f} ({worst['texture']})"


AREAS: Columns = (
    ("textures", n_textures),
    ("band energies", average(lambda record: record["listener.listener_auc"])),
    ("worst", worst_auc),
    ("control", average(lambda record: record["listener.listener_auc_control"])),
    ("and waveform", average(lambda record: record["listener.listener_auc_waveform"])),
)


def person(records: Records) -> str:
    """Area with a person's limits, a dash where it was not asked for."""
    areas = [record.get("listener.listener_auc_person") for record in records]
    return "–" if None in areas else format(np.mean(areas), ".2f")


def listener() -> Table:
    """Areas under listeners' curves, means over the textures of each kind, beside those of two true vibrations."""
    by_method, control = listened("listener"), average(lambda record: record["listener.listener_auc_waveform_control"])
    rows: dict[tuple[str, ...], Records] = {}
    for (title, method), records in by_method.items():
        ours = by_method.get((title, OURS), [])
        rows[title, method] = records
        if len(records) < len(ours):  # a method that was asked about some textures alone: ours on the same
            rows[title, f"{OURS} on these"] = of_textures(ours, records)
    asked = any("listener.listener_auc_person" in record for record in records_of("listener"))
    last = ("a person's limits", person) if asked else ("control", control)
    return table(("mean of", "method"), rows, (*AREAS, last))


def listener_notes() -> str:
    """Sentences on what the controls vary by, and on textures that are told apart more often with the network."""
    records = [record for of in listened("listener").values() for record in of]
    kinds = {
        "listener_auc": "by band energies",
        "listener_auc_waveform": "by waveform too",
        "listener_auc_person": "by a person",
    }
    controls = [record[f"listener.{kind}_control"] for record in records for kind in kinds]
    within = f"controls lie between {min(controls):.2f} and {max(controls):.2f}"
    by_place = {(record["texture"], record["method"]): record for record in records}
    worse = []
    for texture, method in by_place:
        for kind, way in kinds.items():
            with_network, without = (by_place[texture, name][f"listener.{kind}"] for name in (OURS, method))
            if with_network >= without + DISTINCT:
                worse.append(f"{texture} {way} ({with_network:.2f}, without {without:.2f})")
    more = f"Told apart more often with the network, by {DISTINCT} or more: {'; '.join(worse) or 'none'}."
    return (
        f"One recording and one fit of each texture, and {within}: a difference below {DISTINCT} for one texture means "
        f"little. {more}"
    )


def recorded_longer() -> Table:
    """The same of foten-plus for recordings of two lengths, of the textures that both have."""
    short_of = listened("listener")
    rows: dict[tuple[str, ...], Records] = {}
    for (title, method), long in listened("listener-256s").items():
        rows[title, "64 s"] = of_textures(short_of.get((title, method), []), long)
        rows[title, "256 s"] = long
    return table(("mean of", "recorded"), rows, AREAS)


def trials() -> Table:
    """Mean areas of approaches that were tried on all surfaces of other physics of one half, beside controls."""
    with (RESULTS / "trials.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row.get("person")]
    lines = []
    for approach, half in dict.fromkeys((row["approach"], row["half"]) for row in rows):
        of_it = [row for row in rows if (row["approach"], row["half"]) == (approach, half)]
        contact, linear = (
            [row for row in of_it if row["surface"].startswith("linear-") == kind] for kind in (False, True)
        )
        if len(contact) < N_CONTACT_TRIALS:
            continue

        def area(some: Sequence[Mapping[str, str]], name: str) -> str:
            return format(np.mean([float(row[name]) for row in some]), ".3f") if some else "–"

        worst = max(contact, key=lambda row: float(row["ideal"]))
        lines.append(
            (
                *(approach, half, area(contact, "ideal"), f"{float(worst['ideal']):.2f} ({worst['surface']})"),
                *(area(contact, "person"), area(linear, "ideal"), area(linear, "person"), area(of_it, "ideal_control")),
            )
        )
    heads = (
        "what was changed",
        "half",
        "contact: ideal",
        "worst",
        "person's limits",
        "linear: ideal",
        "person's limits ",
        "control",
    )
    return Table.of(heads, lines)


def compared(records: Records) -> Table:
    """Summary of an experiment without the references that a better one stands for, or that nothing is worse than."""
    left_out = ("zero", "persistence", "AR(20)", "AR(20) by speed and force")
    of_all = summary(records)
    return replace(of_all, rows=tuple(row for row in of_all.rows if row[0] not in left_out))


def of_experiment(name: str, make: Callable[[Records], Table]) -> Table:
    """Table of an experiment's runs, empty where it has not been run."""
    records = records_of(name)
    return make(chosen(records)) if records else Table((), ())


def benchmark(name: str) -> Table:
    """Table that a benchmark wrote."""
    path = RESULTS / f"{name}.csv"
    if not path.exists():
        return Table((), ())
    with path.open(encoding="utf-8", newline="") as file:
        head, *rows = (row for row in csv.reader(file) if row)
    return Table.of(head, rows)


N_CONTACT_TRIALS = 10  # five surfaces, two fits of each
FEW_STROKES: Mapping[str, str] = {
    "before": "before: fade below, hold above",
    "held": "held",
    "law": "law",
    "ours": "ours",
    "full": "64 s of a moving hand",
}
"""Policies of docs/make/few_strokes.py, as people read them."""


def few_strokes(real: bool) -> Table:
    """Errors at speeds and forces that were not recorded, by policy."""
    path = RESULTS / "few-strokes.csv"
    rows = list(csv.DictReader(path.open(encoding="utf-8"))) if path.exists() else []
    rows = [row for row in rows if (row["lsd_db"] == "") == real]

    def figure(policy: str, name: str, texture: str = "") -> Number:
        of = [float(row[name]) for row in rows if row["policy"] == policy and texture in ("", row["texture"])]
        return mean_number([np.array(of)], 2)

    if real:
        textures = dict.fromkeys(row["texture"] for row in rows)
        heads = ("level error [dB]", *textures)
        return Table.of(
            heads, [(p, *(figure(p, "level_error_db", t) for t in textures)) for p in ("held", "law") if rows]
        )
    heads = ("", "level error [dB]", "log-spectral distance [dB]")
    named = FEW_STROKES.items() if rows else ()
    return Table.of(heads, [(words, figure(p, "level_error_db"), figure(p, "lsd_db")) for p, words in named])


def abrupt_rows(**of: str) -> list[dict[str, str]]:
    """Rows of abrupt changes with some values."""
    path = RESULTS / "abrupt.csv"
    rows = list(csv.DictReader(path.open(encoding="utf-8"))) if path.exists() else []
    return [row for row in rows if all(row[name] == value for name, value in of.items())]


SECOND = "second realisation"
HANDS = ("live", "aligned", "unfiltered")
GROUPS = {
    "steps of speed, reversal": ("speed 40", "speed 200", "reversal"),
    "steps of force": ("force 0.5", "force 2"),
    "taps": ("tap",),
    "out of range": ("speed 100", "force 1"),
}
"""Kinds of changes, by how their names begin."""


def abrupt() -> Table:
    """Level and spectrum in the 100 ms after each change, medians over the surfaces that both models learned."""
    both = {row["surface"] for row in abrupt_rows(rendering="foten")}

    def figure(name: str, rendering: str, **of: str) -> Number:
        rows = abrupt_rows(rendering=rendering, hand="" if rendering == SECOND else "live", **of)
        values = [float(row[name]) for row in rows if row["surface"] in both]
        return Number(float(np.median(values)) if values else None, ".1f")

    def cells(**of: str) -> tuple[Number, ...]:
        judged = product(("level_error_db", "lsd_db"), (SECOND, OURS, "foten"))
        return (*(figure(*each, **of) for each in judged), figure("settled_level_error_db", OURS, **of))

    heads = ("", "level: second realisation [dB]", OURS, "foten", "spectrum: second realisation [dB]", OURS, "foten")
    changes = dict.fromkeys(row["change"] for row in abrupt_rows())
    rows = [(change, *cells(change=change)) for change in changes]
    return Table.of((*heads, f"level later: {OURS} [dB]"), [*rows, ("all", *cells())] if rows else [])


def abrupt_filter() -> Table:
    """What the low-pass of speed and force costs after each change: level error and time of arrival, medians over surfaces."""

    def median(name: str, change: str, hand: str, spec: str) -> Number:
        rows = abrupt_rows(change=change, rendering=OURS, hand=hand)
        value = float(np.median([float(row[name] or "inf") for row in rows])) if rows else np.inf
        return Number(value if np.isfinite(value) else None, spec)

    columns = (*product(["level_error_db"], HANDS, [".1f"]), *product(["arrives_ms"], HANDS, [".0f"]))
    changes = dict.fromkeys(row["change"] for row in abrupt_rows())
    cells = [(change, *(median(name, change, hand, spec) for name, hand, spec in columns)) for change in changes]
    return Table.of(("", "level error: live [dB]", *HANDS[1:], "arrives: live [ms]", *HANDS[1:]), cells)


def abrupt_surfaces() -> Table:
    """Level errors in the 100 ms after changes of a kind, by surface: live, unfiltered, of a second realisation."""

    def figure(surface: str, kinds: Sequence[str], rendering: str, hand: str = "") -> str:
        rows = abrupt_rows(surface=surface, rendering=rendering, hand=hand)
        errors = [float(r["level_error_db"]) for r in rows if r["change"].startswith(tuple(kinds))]
        return f"{np.mean(errors):.1f}" if errors else "–"

    cells = []
    for surface in dict.fromkeys(row["surface"] for row in abrupt_rows(rendering=OURS)):
        row = [surface]
        for kinds in GROUPS.values():
            live, unfiltered = (figure(surface, kinds, OURS, hand) for hand in ("live", "unfiltered"))
            row.append(f"{live} → {unfiltered} ({figure(surface, kinds, SECOND)})")
        cells.append((*row, figure(surface, (*GROUPS["steps of force"], *GROUPS["taps"]), "flat surface")))
    return Table.of(("", *GROUPS, "a flat surface, force and taps"), cells)


def cost(name: str, heads: Sequence[str] = ("",)) -> Table:
    """Columns of the costs of steps and epochs, by how their headings begin; by default all."""
    with (RESULTS / f"{name}.csv").open(encoding="utf-8") as file:
        heading, *rows = csv.reader(file)
    shown = [k for head in heads for k, title in enumerate(heading) if title.startswith(head)]
    return Table.of([heading[k] for k in shown], [[row[k] for k in shown] for row in rows])


def quicker() -> str:
    """Sentence on which compared systems are quicker than the paper's network, in a step and in an epoch, on a CPU and a GPU."""

    def those(name: str, of: str) -> str:
        with (RESULTS / f"{name}.csv").open(encoding="utf-8") as file:
            times = {row["model"]: row[of] for row in csv.DictReader(file)}
        limit = QUICKER * float(times["foten"])
        quick = [SYSTEM_NAMES[key] for key in COMPARED if times[key] != "–" and float(times[key]) < limit]
        *first, last = quick or ["none"]
        return f"{', '.join(first)} and {last}" if first else last

    return (
        "In the paper no compared system is quicker than FoTEN, in a step or in an epoch. Here, in PyTorch, quicker in a step: "
        f"{those('efficiency', 'PyTorch, mean [µs]')}; in an epoch: {those('efficiency', 'epoch in PyTorch alone [s]')}. On a "
        f"GPU in a step: {those('efficiency-gpu', 'step, mean [µs]')}; in an epoch: {those('efficiency-gpu', 'epoch [s]')}. "
        f"What differs by less than {100 * (1 - QUICKER):.0f} % is not counted."
    )


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


def longer() -> Table:
    """Errors of one step by tuned recipes and by the same for twice as long, on the recordings of the latter."""
    twice = by_place(runs_of("table-1-longer"))
    once = by_place(runs_of("table-1-tuned"))
    pairs = [(once[method][place], one) for method, of in twice.items() for place, one in of.items() if method in once]
    return side_by_side("tuned", "twice as long", *map(list, zip(*pairs, strict=True))) if pairs else Table((), ())


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


def beside_ar() -> Table:
    """Errors of one step by both recipes beside those of the best AR: ratio, number of textures, p after Holm over systems."""
    sides: list[dict[str, tuple[Cell, ...]]] = []
    for side in of_sides(by_both() or table_1()):
        textures, rows = errors_of(side)
        linear, systems = next((row for row in rows if row.name == BEST_LINEAR), None), complete(rows, textures)
        p = signed_rank(linear, systems, textures) if linear else {}
        cells: dict[str, tuple[Cell, ...]] = {}
        for row in systems if linear else ():
            ratios = row.means(textures) / linear.means(textures)
            below = f"{np.sum(ratios < 1)} of {ratios.size}"
            cells[row.name.removesuffix(WITHOUT)] = (f"{ratios.mean():.3f}", below, f"{p[row.name]:.3f}" if p else "–")
        sides.append(cells)
    heads = ("paper's recipe, or own: ÷ best AR", "below it on", "p", "tuned: ÷ best AR", "below it on ", "p ")
    return Table.of(("", *heads), [(name, *(c for of in sides for c in of.get(name, ("–",) * 3))) for name in sides[0]])


def neighbours() -> str:
    """Sentence on what chance may have done to the order of systems by their errors of one step."""
    textures, rows = errors_of(chosen(table_1()))
    systems = sorted(complete(rows, textures), key=lambda row: float(row.means(textures).mean()))
    p = [value for row, behind in pairwise(systems) for value in signed_rank(row, [behind], textures).values()]
    if not p:  # fewer than six textures
        return ""
    pairs = (f"{a.name} and {b.name} {value:.3f}" for (a, b), value in zip(pairwise(systems), holm(p), strict=True))
    return (
        f"Neighbours in one step on the {len(textures)} textures, best first, and p of their difference, after Holm for "
        f"{len(p)} pairs: {'; '.join(pairs).replace(WITHOUT, '')}."
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
    """When free runs from two windows are the same, and their error over silence's before and after 100 ms, Sec. V-a."""
    shown = [*chosen(table_1()), *(record for record in runs_of("table-2") if record["model"] == "ten")]
    rows = []
    for method in dict.fromkeys(record["method"] for record in shown):
        runs = [record for record in shown if record["method"] == method]
        if not any(record.get("warm_start.synthesised.mae_scaled") for record in runs):
            continue  # has no window to begin from
        silent = [record for record in runs if (record["warm_start.stored.level_db"] or 0.0) < SILENT_DB]
        times = [record.get("warm_start.forgotten_ms") for record in runs if record not in silent]
        within = sum(ms is not None and ms <= CONVERGED_MS for ms in times)
        counts = (within, len(times) - within - times.count(None), times.count(None), len(silent))
        errors = (mean(path.format("stored"), digits=2)(runs) for path in EARLY_AND_LATE)
        rows.append((method, *map(str, counts), *errors))
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
    for model, gfc in PAPER_GFC.items():
        here = float(np.exp(constant + slope * np.log(1 - gfc / 100)))
        rows.append(
            (SYSTEM_NAMES[model], f"{PAPER[model]:.3f}", f"{gfc:.2f}", f"{here:.2f}", f"{PAPER[model] / here:.2f}")
        )
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
        errors = [_mean([*of.values()], ONE_STEP, "").value or 0.0 for of in systems.values()]
        for (method, of), rank in zip(systems.items(), in_order(errors), strict=True):
            runs = [*of.values()]
            columns.setdefault(method, []).extend((mean(ONE_STEP)(runs), mean(ONE_STEP, BEST_AR)(runs), rank))
    heads = ("MAE [sd]", "÷ best AR", "rank", "behind 350 Hz: MAE [sd]", "÷ best AR ", "rank ")
    return Table.of(("", *heads), [(method, *cells) for method, cells in columns.items()])


def near() -> Table:
    """Systems that are near one another, by their best recipes, on three recordings of each texture."""
    more = runs_of("table-1-near")
    textures, methods = ({record[key] for record in more} for key in ("texture", "method"))
    first = [r for r in runs_of("table-1-tuned") if r["texture"] in textures and r["method"] in methods]
    return compared([*first, *more]) if more else Table((), ())


def table_2() -> Table:
    """Variants of the network beside the network, whose runs are those of Table I by the published recipe."""
    variants = [record for record in runs_of("table-2") if record["model"] != "foten"]
    done = {(record["texture"], record["split"]) for record in variants}
    network = [
        {**record, "method": "foten", "experiment": variants[0]["experiment"]}
        for record in runs_of("table-1")
        if record["method"] == "FoTEN" and (record["texture"], record["split"]) in done
    ]
    return compared([*variants, *network]) if variants else Table((), ())


def cell_of(record: Record) -> dict[str, str]:
    """Settings of a run's cell in the grid, by the name of its row."""
    return dict(item.rsplit(" ", 1) for item in record["method"].removeprefix(f"{record['model']} ").split(", "))


def windows_by_loss() -> Table:
    """Errors of one step by window and loss, means over the textures: test and validation."""
    cells: dict[tuple[int, str], list[Record]] = {}
    for record in runs_of("figure-5"):
        cell = cell_of(record)
        if "window" in cell:
            cells.setdefault((int(cell["window"]), cell["loss"]), []).append(record)
    losses = ("mae", "mse", "huber")
    columns = [*product((ONE_STEP, "validation.mae_scaled"), losses)]
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
    """Errors of one step by the threshold of the Huber loss, by another seed and without dropout: test and validation."""
    cells: dict[str, list[Record]] = {}
    for record in runs_of("figure-5"):
        cell = cell_of(record)
        if "delta" in cell:
            cells.setdefault(f"{float(cell['delta']):.1f}", []).append(record)
        elif "window" not in cell:
            ((name, value),) = cell.items()
            cells.setdefault(f"1.6, {name} {value}" if name == "seed" else "1.6, no dropout", []).append(record)
        elif (cell["window"], cell["loss"]) == ("20", "huber"):
            cells.setdefault("1.6", []).append(record)
    columns = (ONE_STEP, "validation.mae_scaled")
    rows = [(delta, *(mean(path, digits=4)(cells[delta]) for path in columns)) for delta in sorted(cells)]
    return Table.of(("δ [sd]", "test: MAE [sd]", "validation"), rows)


def over_best(methods: Mapping[str, Mapping[Place, Record]], path: str) -> str:
    """Mean of a figure of foten-plus over that of the other system beside which it is worst on the test blocks."""
    ours = next(of for name, of in methods.items() if name.startswith(OURS))
    ratios: dict[str, list[Record]] = {}
    for name, of in methods.items():
        if of is not ours:
            pairs = {place: (ours[place].get(path), of[place].get(path)) for place in ours if place in of}
            ratios[name] = [{"texture": place[0], "ratio": a / b} for place, (a, b) in pairs.items() if a and b]
    textures = {texture for texture, _ in ours}
    of_all = [name for name, of in ratios.items() if {record["texture"] for record in of} == textures]
    worst = max(of_all, key=lambda name: _mean(ratios[name], "ratio", "").value or 0.0, default="")
    return f"{over_textures(ratios[worst], 'ratio')} ({worst})" if worst else "–"


def over_textures(records: Records, over: str, under: str = "") -> Number:
    """Mean over textures ± its standard error, which is that of textures here and not of splits."""
    means = np.array([np.mean(splits) for splits in values(records, over, under)])
    error = float(means.std(ddof=1) / np.sqrt(means.size)) if means.size > 1 else None
    return Number(float(means.mean()) if means.size else None, ".3f", error)


def equal_tuning() -> Table:
    """foten-plus over the other systems at equally many recipes, and over linear predictors: means over textures."""
    rows = []
    for title, records in EQUAL.items():
        methods = by_place(chosen(records()))
        ours = [record for name, of in methods.items() if name.startswith(OURS) for record in of.values()]
        if ours:
            textures = str(len({record["texture"] for record in ours}))
            pairs = ((over_best(methods, path), over_textures(ours, path, linear)) for path, linear in EQUALLY_TUNED)
            rows.append((title, textures, *(cell for pair in pairs for cell in pair)))
    heads = (
        "one step ÷ best system",
        "÷ best AR",
        "LSD ÷ best system",
        "÷ AR(20)",
        "level error ÷ best system",
        "÷ AR(20) ",
    )
    return Table.of(("", "textures", *heads), rows)


EQUALLY_TUNED = ((ONE_STEP, BEST_AR), (LSD, AR_LSD), (LEVEL, "free_run_ar.level_error_db"))
"""Figures that systems are compared by at equally many recipes, and those of the linear predictor."""
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


def place_of(record: Record) -> tuple[Any, ...]:
    """Where a run stands in its experiment: method, recipe, texture and split."""
    return record["method"], record.get("recipe") or "", record["texture"], record["split"]


def core_hours(records: Records) -> str:
    """Hours of training and evaluation, a dash where the CSV lacks them."""
    seconds = [record.get(key) for record in records for key in ("training_s", "evaluation_s")]
    return "–" if None in seconds else f"{sum(seconds) / 3600:.1f}"


LISTENERS = {"listener": "listener", "listener-256s": "listener"}
"""Experiments with listeners, and the CSV that holds their runs."""


def experiments() -> Table:
    """What the other experiments are of, and what the runs in their CSV files took."""
    rows = []
    for name in (*MAIN, *LISTENERS, "ingredients"):
        title, every = of_file(name)["title"], records_of(LISTENERS.get(name, name))
        runs = [record for record in every if name not in LISTENERS or record["experiment"] == title]
        rows.append((f"`{name}`", note_of(name, runs), str(len(runs)), core_hours(runs)))
    return Table.of(("experiment", "what", "runs", "core-hours"), rows)


def note_of(name: str, runs: Records) -> str:
    """Note of an experiment: that of when it was run, where the CSV has it."""
    return str((runs[0]["note"] if runs else "") or of_file(name)["note"]).rstrip(".")


def spent() -> Table:
    """Runs of the paper's tables at full length that are done, and what they took."""
    rows = []
    for name in (*FULL_LENGTH, REAL_TABLE_1):
        records = runs_of(name) if name in FULL_LENGTH else records_of(name)
        planned = (
            None if name in (BEHIND_LOW_PASS, REAL_TABLE_1) else len(read_experiment(experiment_path(name)).runs())
        )
        done = f"{len(records)} of {planned}" if planned else str(len(records))
        rows.append((f"`{name}`", done, core_hours(records)))
    return Table.of(("experiment", "runs done", "core-hours"), rows)


def headline() -> Table:
    """AR(20)'s errors by band and regime, beside silence and a second realisation: means over the textures."""
    rows = list(csv.DictReader((RESULTS / "headline.csv").open(encoding="utf-8")))
    digits = {"silence [sd]": 3, "one step [sd]": 3, "one-step GFC [%]": 1, "free run [sd]": 3, "free run's GFC [%]": 1}
    digits |= {"second realisation [sd]": 3, "second realisation's GFC [%]": 1}

    def cells(band: str) -> list[str]:
        of_band = [row for row in rows if row["band"] == band]
        return [band, *(f"{np.mean([float(row[name]) for row in of_band]):.{n}f}" for name, n in digits.items())]

    return Table.of(("acceleration", *digits), [cells(band) for band in dict.fromkeys(row["band"] for row in rows)])


def words_worth() -> Table:
    """What names are worth over a library, by method."""
    path = RESULTS / "words.csv"
    rows = list(csv.DictReader(path.open(encoding="utf-8"))) if path.exists() else []
    figures = {"lsd": "_db", "level": "_error_db", "emd": "_octaves"}
    cells = [
        (
            row["method"],
            *(
                f"{float(row[name + unit]):.2f} ± {float(row[f'{name}_interval']):.2f}"
                for name, unit in figures.items()
            ),
        )
        for row in rows
    ]
    heads = ("", "log-spectral distance [dB]", "level error [dB]", "earth mover's [octave]")
    return Table.of(heads, cells)


def tools_worth() -> Table:
    """What a tool's filter is worth, by method."""
    path = RESULTS / "tools.csv"
    rows = list(csv.DictReader(path.open(encoding="utf-8"))) if path.exists() else []
    pairs = (("level_error_db", "level_se"), ("lsd_db", "lsd_se"))
    cells = [
        (row["tools"], row["method"], *(f"{float(row[name]):.1f} ± {float(row[error]):.1f}" for name, error in pairs))
        for row in rows
    ]
    return Table.of(("", "", "level error [dB]", "log-spectral distance [dB]"), cells)


def users_rows() -> list[dict[str, str]]:
    """Rows of the simulated people."""
    path = RESULTS / "users.csv"
    return list(csv.DictReader(path.open(encoding="utf-8"))) if path.exists() else []


def users_known() -> Table:
    """How well simulated people are known after how many answers."""
    rows = [row for row in users_rows() if not row["what"].startswith("session")]
    answers = sorted({int(row["answers"]) for row in rows} - {0})

    def cell(what: str, procedure: str, n: int) -> str:
        of = (row for row in rows if (row["what"], row["procedure"], row["answers"]) == (what, procedure, f"{n}"))
        row = next(of)
        return f"{float(row['distance']):.1f} ± {float(row['distance_se']):.1f}"

    kinds = dict.fromkeys((row["what"], row["procedure"]) for row in rows if row["answers"] != "0")
    return Table.of(
        ("", "", *(f"{n} answers" for n in answers)), [(*kind, *(cell(*kind, n) for n in answers)) for kind in kinds]
    )


def users_session() -> Table:
    """What the session of `foten adapt` takes and gives."""
    rows = [row for row in users_rows() if row["what"].startswith("session")]
    cells = [
        (
            row["what"].removeprefix("session: "),
            row["answers"],
            f"{float(row['bias']):+.1f}" if row["bias"] else "",
            f"{float(row['spread']):.1f}" if row["spread"] else "",
            f"{float(row['distance']):.1f}",
        )
        for row in rows
    ]
    return Table.of(("the whole session", "answers", "bias", "spread", "mean"), cells)


def listed(*names: str) -> str:
    """Links to the runs of experiments that have been run."""
    lines = []
    for name in names:
        if records := runs_of(name) if name in FULL_LENGTH else records_of(name):
            lines.append(f"- [{name}](results/{FULL_LENGTH.get(name, name)}.csv): {note_of(name, records)}")
    return "\n".join(lines)


BENCHMARKS = ("step", "contacts", "soak", "install", "studio-page", "studio-load", "study")
TABLES: dict[str, dict[str, Callable[[], Table | str]]] = {
    "../README.md": {"readme": readme},
    "results.md": {
        "short": short,
        "real": partial(by_texture, REAL_10, REAL_2_5),
        "linear": partial(by_texture, LINEAR),
        "simulated": partial(by_texture, SIMULATED),
        "contact": partial(by_texture, CONTACT),
        "stability": stability,
        "onset": onset,
        "abrupt": abrupt,
        "abrupt-filter": abrupt_filter,
        "abrupt-surfaces": abrupt_surfaces,
        "ingredients": partial(of_experiment, "ingredients", ratios),
        "csv": partial(listed, *MAIN, "listener", "ingredients"),
    },
    "listener.md": {
        "listener": listener,
        "listener-notes": listener_notes,
        "recorded-longer": recorded_longer,
        "trials": trials,
    },
    "less-than-a-recording.md": {
        "few-strokes": partial(few_strokes, real=False),
        "few-strokes-real": partial(few_strokes, real=True),
        "tools": tools_worth,
        "users": users_known,
        "session": users_session,
        "words": words_worth,
    },
    "model.md": {"random-part": partial(benchmark, "random-part")},
    "compared.md": {
        "so-far": so_far,
        "table-1": lambda: compared(chosen(table_1())) if table_1() else Table((), ()),
        "findings": table_1_findings,
        "both-recipes": both_recipes,
        "beside-ar": beside_ar,
        "neighbours": neighbours,
        "near": near,
        "longer": longer,
        "convergence": convergence,
        "warm-start": lambda: warm_start(chosen(table_1())) if table_1() else Table((), ()),
        "equal-tuning": equal_tuning,
        "table-2": table_2,
        "windows-by-loss": windows_by_loss,
        "thresholds": by_threshold,
        "recipes": recipes,
        "orders": orders,
        "headline": headline,
        "pairs": pairs,
        "bands": bands,
        "table-1-real": lambda: compared(chosen(tuned_on(REAL_TABLE_1))) if tuned_on(REAL_TABLE_1) else Table((), ()),
        "on-real": on_real,
        "efficiency": partial(
            cost, "efficiency", ("model", "input", "PyTorch", "median", "ONNX", "kernel", "paper's mean")
        ),
        "gpu": partial(cost, "efficiency-gpu"),
        "epochs": partial(
            cost, "efficiency", ("model", "param", "epoch [s]", "of it", "epoch in", "foten's", "the paper's")
        ),
        "quicker": quicker,
        "csv": partial(listed, *FULL_LENGTH, "table-1-real"),
    },
    "reproduce.md": {"experiments": experiments, "spent": spent},
    "runtime.md": {name: partial(benchmark, name) for name in BENCHMARKS},
}


def pages() -> Iterator[tuple[Path, str, str]]:
    """Yield each page, what it says, and what it should."""
    for page, tables in TABLES.items():
        path = (DOCS / page).resolve()
        before = text = path.read_text(encoding="utf-8")
        for name, make in tables.items():
            begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
            head, _, after = text.partition(begin)
            _, closed, tail = after.partition(end)
            if not closed:
                raise ValueError(f"{path.name}: has no {begin} … {end} to put a table between")
            content = make()
            if isinstance(content, Table):
                n_rows = sum(str(row[0]) != "mean" for row in content.rows)
                if len(content.columns) > MAX_COLUMNS or n_rows > MAX_ROWS:
                    size = f"{len(content.columns)} columns and {n_rows} rows"
                    raise ValueError(f"{name}: {size}, expected {MAX_COLUMNS} and {MAX_ROWS} at most")
                content = content.markdown() if content.rows else ""
            text = f"{head}{begin}\n{content.rstrip() or NOT_RUN}\n{end}{tail}"
        yield path, before, text


def add(folder: Path, recordings: Path | None) -> None:
    """Put the results of a sweep, all or a part, into the CSV of their experiment, beside what the CSV has of others."""
    records = brief(read_records(folder))
    name = next(name for name in FULL_LENGTH if of_file(name)["title"] == records[0]["experiment"])
    file = FULL_LENGTH[name]
    parts = {other: runs_of(other) for other in FULL_LENGTH if FULL_LENGTH[other] == file}
    places = [run.place for run in read_experiment(experiment_path(name), recordings).runs()]
    parts[name] = sorted(joined([records, parts[name]], mixed=True), key=lambda one: places.index(place_of(one)))
    runs_table([record for part in parts.values() for record in part], 4).write(RESULTS / f"{file}.csv")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="exit 1 where a page is not what the CSV files give")
    parser.add_argument("--add", type=Path, metavar="DIR", help="first put the results of a sweep into their CSV")
    parser.add_argument(
        "--recordings", type=Path, metavar="DIR", help="recordings that the sweep is of, where they are files"
    )
    arguments = parser.parse_args()
    if arguments.add:
        add(arguments.add, arguments.recordings)
        records_of.cache_clear()
    stale = [(path, text) for path, before, text in pages() if before != text]
    if arguments.check and stale:
        sys.exit(f"{', '.join(path.name for path, _ in stale)}: run 'python docs/make/tables.py' and commit it")
    for path, text in stale:
        with atomic_write(path) as part:
            part.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
