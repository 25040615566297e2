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
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

import paper_tables
from csv_records import (
    AR_LSD,
    BEST_AR,
    BOUND,
    CEILING,
    CEILING_LEVEL,
    CONTACT,
    ERROR,
    FOTEN,
    FULL_LENGTH,
    LEVEL,
    LINEAR,
    LSD,
    MAIN,
    ONE_STEP,
    OURS,
    REAL_2_5,
    REAL_10,
    REAL_TABLE_1,
    RESULTS,
    SIMULATED,
    Columns,
    average,
    core_hours,
    csv_rows,
    mean,
    mean_of,
    note_of,
    of_file,
    place_of,
    playing,
    records_of,
    runs,
    runs_of,
    table,
    values,
)
from foten.atomic_write import atomic_write
from foten.experiments.experiment import experiment_path, read_experiment
from foten.experiments.method_tables import brief, same_blocks
from foten.experiments.results import Record, Records, read_records, runs_table
from foten.reporting.table import Number, Table, mean_number
from foten.simulation import contact_mechanics, linear_family, simulate
from paper_tables import interval, over_textures

DOCS = Path(__file__).resolve().parents[1]
MAX_COLUMNS, MAX_ROWS = 8, 12  # of a table that people read, a row of means not counted; the rest is CSV
NOT_RUN = "*Not measured yet with this version.*"


def readme() -> Table:
    """The rows of the README, with what each means."""
    heads = ("one step ÷ best AR", "free run ÷ AR(20)", "free run ÷ ceiling")
    paths = ((ONE_STEP, BEST_AR), (LSD, AR_LSD), (LSD, CEILING))
    kinds = {title: records for name, title in MAIN.items() if (records := beside_foten(name))}
    rows = [
        (title, *(over_textures(records, *path, digits=2) for path in paths), meaning(title, records))
        for title, records in kinds.items()
    ]
    return Table.of(("", *heads, "what it means"), rows)


def readme_systems() -> Table:
    """One step and the free run's spectrum of foten-plus over those of the best other system, by data."""
    heads = ("one step ÷ best other system", "free run ÷ best other system", "free run ÷ piecewise AR")
    rows = [(*row[:3], *row[4:6], row[7]) for row in paper_tables.equal_tuning().rows]
    return Table.of(("", "textures", *heads, "level error ÷ piecewise AR"), rows)


def readme_notes() -> str:
    """Sentences on what the figures of the README rest on."""
    every = [one for name in MAIN for one in runs(name)]
    network = f"A rendering plays recorded innovations in {playing(every)} runs."
    if before := sum(one["random_part"] == "network" for one in every):
        network += f" In {before}, which are of the version before, it draws from a network."
    seconds = map(
        "{} table: {}".format, ("First", "Second"), map(paper_tables.seconds_of_test, (REAL_10, REAL_TABLE_1))
    )
    lines = (network, *seconds, paper_tables.levels(), *paper_tables.beside_dstn())
    return "\n".join(f"- {line}" for line in lines)


def meaning(title: str, records: Records) -> str:
    """What the figures of a kind of texture mean, in a line."""
    if title == MAIN[LINEAR]:
        above = 100 * (mean_of(records, ERROR, BOUND).value - 1)
        return f"{above:.1f} % above the least one-step error that is possible"
    if title == MAIN[SIMULATED]:
        further = 100 * (mean_of(records, LSD, CEILING).value - 1)
        return f"The free run is {further:.0f} % further away than a second realisation of the same stroke"
    one_step, free_run = interval(records, ONE_STEP, BEST_AR), interval(records, LSD, AR_LSD)
    ratios = f"One-step error {one_step} times the best linear predictor's, free run {free_run} times AR(20)'s"
    return f"{ratios} (95 %, n = {len(values(records, LSD, AR_LSD))})"


def beside_foten(name: str) -> list[Record]:
    """Our runs of an experiment, with the error of the paper's network in the same place where it has one.

    Without the ceiling of real recordings, a training block: a ratio to it means little.
    """
    errors = {(record["texture"], record["split"]): record[ONE_STEP] for record in runs(name, "foten")}
    left_out = dict.fromkeys((CEILING, CEILING_LEVEL) if name in (REAL_10, REAL_2_5) else ())
    return [{**record, **left_out, FOTEN: errors.get((record["texture"], record["split"]))} for record in runs(name)]


def short() -> Table:
    """Main figures by kind of texture."""
    columns: Columns = (
        ("one step ÷ best AR", mean(ONE_STEP, BEST_AR)),
        ("÷ that of foten", mean(ONE_STEP, FOTEN)),
        ("÷ bound", mean(ERROR, BOUND)),
        ("LSD ÷ AR(20)", mean(LSD, AR_LSD)),
        ("LSD ÷ ceiling", mean(LSD, CEILING)),
        ("level error ÷ ceiling", mean(LEVEL, CEILING_LEVEL)),
        ("plays recorded", playing),
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
        ("plays recorded", playing),
    )
    rows: dict[str, list[Record]] = {}
    for name in names:
        rate = f", {MAIN[name].split(', ')[1]}" if len(names) > 1 else ""
        for record in beside_foten(name):
            rows.setdefault(record["texture"] + rate, []).append(record)
    return table(("texture",), {**rows, "mean": beside_foten(names[0]) if len(names) == 1 else []}, columns).known()


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


def chaotic() -> str:
    """Sentence on the textures whose renderings from two windows are still apart when they are no longer watched."""
    never = [
        f"{record['texture']} ({record['random_part']})"
        for name in MAIN
        for record in runs(name)
        if record.get("stability.max_sd") is not None and record.get("stability.forgets_s") is None
    ]
    return f"Still apart at the end: {', '.join(never)}." if never else "All renderings forget within that time."


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


def listened() -> dict[str, Records]:
    """Runs with listeners, by what the textures are."""
    kinds = {LINEAR: linear_family.LINEAR_FAMILY, SIMULATED: simulate.TEXTURES, CONTACT: contact_mechanics.CONTACT}
    records = records_of("listener")
    return {MAIN[name]: [record for record in records if record["texture"] in keys] for name, keys in kinds.items()}


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


def listener() -> Table:
    """Areas under listeners' curves, means over the textures of each kind, beside those of two true vibrations."""
    person = average(lambda record: record["listener.listener_auc_person"])
    return table(
        ("mean of",),
        {(title,): records for title, records in listened().items()},
        (*AREAS, ("a person's limits", person)),
    )


def listener_notes() -> str:
    """Sentence on what the controls lie between."""
    records = [record for of in listened().values() for record in of]
    kinds = ("listener_auc", "listener_auc_waveform", "listener_auc_person")
    controls = [record[f"listener.{kind}_control"] for record in records for kind in kinds]
    return (
        f"One recording and one fit of each texture; controls lie between {min(controls):.2f} and {max(controls):.2f}."
    )


def trials() -> Table:
    """Mean areas of approaches that were tried on all surfaces of other physics of one half, beside controls."""
    rows = [row for row in csv_rows("trials") if row["person"]]
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


OTHER_HANDS = {
    f"what stands, hand of {factor:g} times the speed{suffix}": (f"{factor:g} times as quick", joined)
    for factor in (0.6, 1.7)
    for suffix, joined in (("", "blocks of 2 s"), (", DFT321 in windows of 64 ms", "windows of 64 ms"))
}
"""Approaches of the trials under other hands than the one that was learned from; how quick they are, and how axes became one."""


def hands() -> Table:
    """Bias of level by quarter of speed under another hand, mean and standard error over surfaces."""
    lines = []
    for approach, labels in OTHER_HANDS.items():
        of_it = [row for row in csv_rows("trials") if row["approach"] == approach]
        if of_it:
            biases = ([float(row[f"bias_{k}_db"]) for row in of_it] for k in range(1, 5))
            errors = ((np.mean(each), np.std(each, ddof=1) / np.sqrt(len(each))) for each in biases)
            lines.append((*labels, *(f"{bias:+.2f} ± {error:.2f}" for bias, error in errors)))
    quarters = [f"{name} [dB]" for name in ("slowest", "second", "third", "fastest")]
    return Table.of(("hand that listens", "DFT321 in", *quarters), lines)


WITH = "recorded, no network in the loop"
PARTS = {
    "network in the loop, trained there": ("recorded innovations", WITH),
    "distance of band envelopes that chooses the linear part": (WITH, "recorded, linear part by its errors"),
    "equaliser": (WITH, "recorded, no equaliser"),
    "table of reflection coefficients": (WITH, "recorded, one filter"),
    "tones": (WITH, "recorded, no tones"),
    "orders above 40": (WITH, "recorded, orders up to 40"),
    "level before the filter": (WITH, "recorded, level after the filter"),
}
"""Parts, and the approaches of the trials with and without them; a fit without a row is the same without the part."""


def parts() -> Table:
    """What each part takes off the area of the ideal listener, on fits of the choosing half and the simulated textures."""
    by_approach: dict[str, dict[tuple[str, ...], float]] = {}
    for row in csv_rows("trials"):
        place = row["half"], row["surface"], row["fit"]
        by_approach.setdefault(row["approach"], {})[place] = float(row["ideal"])

    def gain(each: Sequence[float]) -> str:
        error = np.std(each, ddof=1) / np.sqrt(len(each)) if len(each) > 1 else 0.0
        return f"{np.mean(each):+.3f} ± {error:.3f}" if each else "–"

    cells = []
    for part, (with_part, without) in PARTS.items():
        known, changed = by_approach[with_part], by_approach[without]
        if without == WITH:
            known = {place: area for place, area in known.items() if place in changed}
        gains = {place: changed.get(place, area) - area for place, area in known.items()}
        kinds = [
            [g for place, g in gains.items() if place[1].startswith("linear-") == linear] for linear in (False, True)
        ]
        n_changed = f"{sum(gain_of != 0 for gain_of in gains.values())} of {len(known)}"
        cells.append((part, n_changed, *map(gain, kinds)))
    return Table.of(("part", "fits that it changes", "gain, other surfaces", "gain, linear processes"), cells)


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
    rows = [row for row in csv_rows("few-strokes") if (row["lsd_db"] == "") == real]

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
    return [row for row in csv_rows("abrupt") if all(row[name] == value for name, value in of.items())]


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


def experiments() -> Table:
    """What the other experiments are of, and what the runs in their CSV files took."""
    rows = []
    for name in (*MAIN, "listener"):
        runs = records_of(name)
        rows.append((f"`{name}`", note_of(name, runs), str(len(runs)), core_hours(runs)))
    return Table.of(("experiment", "what", "runs", "core-hours"), rows)


VERSIONS = {
    "cc4c4292": {"69404639f09a9196", "0c720e2e7db4e48b", "07ba0a3fa116e97d", "f05e4aa1c77ccf15"},
    "2f0f0d6e": {"7e5f9516d6af35bf", "396feffc46c5c2bb", "daed59569aa57f0e", "7a51214710a5daa5", "44f1efb5c1cd1f53"},
    "2a974bd7": {"29401e15b6d05a20", "7d77f7c7239854cc"},
    "214eeaf5": {"738830bef19dd066", "0ace9ef399e18463"},
    "7f9c20f6": {"41cfd2eadd7b0421", "0eb6489a5b1c9a5e"},
    "de196384": {"76b8bfeda814ed1e", "6b16428f170112c5", "9ba591cf4608b851"},
}
"""Commits that runs are of, and their digests; a digest covers what a model's runs import, so commits may share some."""


def commit_of(code: object) -> str:
    """Commit that a digest of code, of 16 hexadecimal digits, is of; `other` where `VERSIONS` does not have it."""
    return next((commit for commit, codes in VERSIONS.items() if code in codes), "other")


def versions() -> Table:
    """How many runs of the paper's and the main tables are of which commit; of none that is known: others, older ones too."""
    runs: dict[str, list[str]] = {commit: [] for commit in (*VERSIONS, "other")}
    for name in JOINED:
        records = runs_of(name)
        for commit, n in Counter(commit_of(record["code"]) for record in records).items():
            runs[commit].append(f"`{name}`" + (f" ({n} of {len(records)})" if n < len(records) else ""))
    for commit in dict.fromkeys(commit_of(row["code"]) for row in csv_rows("efficiency")):
        runs[commit].append("Table III on the CPU")
    return Table.of(("commit", "runs of"), [(commit, ", ".join(of)) for commit, of in runs.items() if of])


def spent() -> Table:
    """Runs of the paper's tables at full length and of the main tables that are done, and what they took."""
    rows = []
    for name in (*FULL_LENGTH, REAL_TABLE_1):
        records = runs_of(name)
        done = str(len(records))
        if name not in (paper_tables.BEHIND_LOW_PASS, REAL_TABLE_1):  # which need recordings
            runs = read_experiment(experiment_path(name)).runs()
            # Those of the network in Table II are runs of Table I.
            done += f" of {sum((name, run.model) != ('table-2', 'foten') for run in runs)}"
        rows.append((f"`{name}`", done, core_hours(records)))
    main = [record for name in MAIN for record in runs_of(name)]
    every = main + [record for name in (*FULL_LENGTH, REAL_TABLE_1) for record in runs_of(name)]
    rows.append(("main tables", str(len(main)), core_hours(main)))
    rows.append(("**all**", str(len(every)), f"**{core_hours(every)}**"))
    return Table.of(("experiment", "runs done", "core-hours"), rows)


def made_anew() -> Table:
    """Cells of the paper's tables made again on another instruction set: one-step errors [sd] beside those of the tables."""
    published = {(record["experiment"], *place_of(record)): record for record in records_of("paper")}
    titles = {of_file(name)["title"]: name for name in FULL_LENGTH}
    rows = []
    for record in records_of("made-anew"):
        cell = published[(record["experiment"], *place_of(record))]
        if record["platform"] != cell["platform"]:
            here, there = record[ONE_STEP], cell[ONE_STEP]
            method = paper_tables.VARIANTS.get(record["method"], record["method"])
            shown = f"`{titles[record['experiment']]}`", f"{method}, {record['texture']}"
            rows.append((*shown, f"{there:.4f}", f"{here:.4f}", f"{100 * (here / there - 1):+.1f}"))
    return Table.of(("experiment", "cell", "MAE [sd]", "again", "difference [%]"), rows)


def words_worth() -> Table:
    """What names are worth over a library, by method."""
    figures = {"lsd": "_db", "level": "_error_db", "emd": "_octaves"}
    cells = [
        (
            row["method"],
            *(
                f"{float(row[name + unit]):.2f} ± {float(row[f'{name}_interval']):.2f}"
                for name, unit in figures.items()
            ),
        )
        for row in csv_rows("words")
    ]
    heads = ("", "log-spectral distance [dB]", "level error [dB]", "earth mover's [octave]")
    return Table.of(heads, cells)


def tools_worth() -> Table:
    """What a tool's filter is worth, by method."""
    pairs = (("level_error_db", "level_se"), ("lsd_db", "lsd_se"))
    cells = [
        (row["tools"], row["method"], *(f"{float(row[name]):.1f} ± {float(row[error]):.1f}" for name, error in pairs))
        for row in csv_rows("tools")
    ]
    return Table.of(("", "", "level error [dB]", "log-spectral distance [dB]"), cells)


def users_known() -> Table:
    """How well simulated people are known after how many answers."""
    rows = [row for row in csv_rows("users") if not row["what"].startswith("session")]
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
    rows = [row for row in csv_rows("users") if row["what"].startswith("session")]
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
    return Table.of(("the session", "answers", "bias", "spread", "mean error, or time"), cells)


def listed(*names: str) -> str:
    """Links to the runs of experiments that have been run."""
    lines = []
    for name in names:
        if records := runs_of(name):
            lines.append(f"- [{name}](results/{FULL_LENGTH.get(name, name)}.csv): {note_of(name, records)}")
    return "\n".join(lines)


BENCHMARKS = ("step", "contacts", "soak", "install", "studio-page", "studio-load", "study")
TABLES: dict[str, dict[str, Callable[[], Table | str]]] = {
    "../README.md": {"readme": readme, "readme-systems": readme_systems, "readme-notes": readme_notes},
    "results.md": {
        "short": short,
        "levels": paper_tables.levels,
        "seconds": partial(paper_tables.seconds_of_test, REAL_10),
        "real": partial(by_texture, REAL_10, REAL_2_5),
        "real-same": lambda: " ".join(dict.fromkeys(same_blocks([*runs(REAL_10), *runs(REAL_2_5)]))),
        "linear": partial(by_texture, LINEAR),
        "simulated": partial(by_texture, SIMULATED),
        "contact": partial(by_texture, CONTACT),
        "stability": stability,
        "chaotic": chaotic,
        "onset": onset,
        "abrupt": abrupt,
        "abrupt-filter": abrupt_filter,
        "abrupt-surfaces": abrupt_surfaces,
        "parts": parts,
        "csv": partial(listed, *MAIN, "listener"),
    },
    "listener.md": {"listener": listener, "listener-notes": listener_notes, "hands": hands, "trials": trials},
    "less-than-a-recording.md": {
        "few-strokes": partial(few_strokes, real=False),
        "few-strokes-real": partial(few_strokes, real=True),
        "tools": tools_worth,
        "users": users_known,
        "session": users_session,
        "words": words_worth,
    },
    "compared.md": {**paper_tables.TABLES, "csv": partial(listed, *FULL_LENGTH, REAL_TABLE_1)},
    "reproduce.md": {"experiments": experiments, "versions": versions, "made-anew": made_anew, "spent": spent},
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


JOINED = (*FULL_LENGTH, REAL_TABLE_1, *MAIN, "listener")
"""Experiments that are run in parts, in the order of their versions."""
KEPT_FIGURES = {"figure-5": ("one_step", "validation"), "recipes": ("one_step", "references", "validation")}
"""Figures that are kept of an experiment of many runs."""


def add(folder: Path, recordings: Path | None) -> None:
    """Put the results of a sweep, all or a part, into the CSV of their experiment, beside what the CSV has of its other runs."""
    records = brief(read_records(folder))
    title = records[0]["experiment"]
    name = next((name for name in JOINED if of_file(name)["title"] == title), None)
    if name is None:
        sys.exit(f"{title!r} is none of {', '.join(JOINED)}: write its CSV by foten tables, as docs/reproduce.md says")
    if name in KEPT_FIGURES:
        records = [
            {key: one[key] for key in one if key.partition(".")[0] in KEPT_FIGURES[name] or "." not in key}
            for one in records
        ]
    file = FULL_LENGTH.get(name, name)
    parts = {other: runs_of(other) for other in JOINED if FULL_LENGTH.get(other, other) == file}
    experiment = read_experiment(experiment_path(name), recordings)
    places = [run.place for run in experiment.runs()]
    others = {*places} - {*map(place_of, records)}
    kept = [record for record in parts[name] if place_of(record) in others]  # not what the experiment has no more
    described = [one | {"note": experiment.note} for one in (*records, *kept)]  # as it is now, of earlier runs too
    parts[name] = sorted(described, key=lambda one: places.index(place_of(one)))
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
