"""Tables of README.md, *Results* and *A trained listener* from the CSV files of the main experiments and of `listener`."""

from collections.abc import Callable

import numpy as np

import csv_records as data
import paper_findings
import paper_tables
from csv_records import (
    AR_LSD,
    BEST_AR,
    BOUND,
    CEILING,
    CEILING_LEVEL,
    ERROR,
    LEVEL,
    LSD,
    MAIN,
    ONE_STEP,
    Columns,
    average,
    mean,
    runs,
    table,
)
from foten.reporting.table import Table
from foten.simulation import contact_mechanics, linear_family, simulate
from foten_lab.aggregate import mean_of, over_textures
from foten_lab.results import Record, Records
from paper_findings import interval


def readme() -> Table:
    """The rows of the README, with what each means."""
    columns: Columns = [
        (head, lambda records, path=path: over_textures(records, *path, spec=".2f"))
        for head, *path in (
            ("one step ÷ best AR", ONE_STEP, BEST_AR),
            ("free run ÷ AR(20)", LSD, AR_LSD),
            ("free run ÷ ceiling", LSD, CEILING),
        )
    ]
    return table(("",), by_kind(), [*columns, ("what it means", meaning)])


def readme_systems() -> Table:
    """One step and the free run's spectrum of foten-plus over those of the best other system, by data."""
    heads = ("one step ÷ best other system", "free run ÷ best other system", "free run ÷ piecewise AR")
    rows = [(*row[:3], *row[4:6], row[7]) for row in paper_tables.equal_tuning().rows]
    return Table.of(("", "textures", *heads, "level error ÷ piecewise AR"), rows)


def readme_notes() -> str:
    """Sentences on what the figures of the README rest on."""
    every = [one for name in MAIN for one in runs(name)]
    network = f"A rendering plays recorded innovations in {data.playing(every)} runs."
    if before := sum(one["random_part"] == "network" for one in every):
        network += f" In {before}, which are of the version before, it draws from a network."
    first, second = map(paper_findings.seconds_of_test, (data.REAL_10, data.REAL_TABLE_1))
    lines = (network, f"First table: {first}", f"Second table: {second}", paper_findings.levels())
    return paper_findings.listed((*lines, *paper_findings.beside_dstn()))


def meaning(records: Records) -> str:
    """What the figures of a kind of texture mean, in a line."""
    kind = records[0]["kind"]
    if kind == data.LINEAR:
        above = 100 * ((mean_of(records, ERROR, BOUND).value or 0.0) - 1)
        return f"{above:.1f} % above the least one-step error that is possible"
    if kind == data.SIMULATED:
        further = 100 * ((mean_of(records, LSD, CEILING).value or 0.0) - 1)
        return f"The free run is {further:.0f} % further away than a second realisation of the same stroke"
    one_step, free_run = interval(records, ONE_STEP, BEST_AR), interval(records, LSD, AR_LSD)
    ratios = f"One-step error {one_step} times the best linear predictor's, free run {free_run} times AR(20)'s"
    return f"{ratios} (95 %, n = {len(data.textures_of(records))})"


def beside_foten(name: str) -> list[Record]:
    """Our runs of an experiment, with the error of the paper's network in the same place where it has one.

    Without the ceiling of real recordings, a training block: a ratio to it means little.
    """
    errors = {(record["texture"], record["split"]): record[ONE_STEP] for record in runs(name, "foten")}
    left_out = dict.fromkeys((CEILING, CEILING_LEVEL) if name in (data.REAL_10, data.REAL_2_5) else ())
    places = ((record, (record["texture"], record["split"])) for record in runs(name))
    return [{**record, **left_out, data.FOTEN: errors.get(place), "kind": name} for record, place in places]


def by_kind() -> dict[str, Records]:
    """Our runs of the main experiments by the kind of texture."""
    return {title: beside_foten(name) for name, title in MAIN.items()}


OF_TEXTURE: Columns = (
    ("LSD ÷ AR(20)", mean(LSD, AR_LSD)),
    ("÷ ceiling", mean(LSD, CEILING)),
    ("level error ÷ ceiling", mean(LEVEL, CEILING_LEVEL)),
    ("plays recorded", data.playing),
)


def short() -> Table:
    """Main figures by kind of texture."""
    columns: Columns = (
        ("one step ÷ best AR", mean(ONE_STEP, BEST_AR)),
        ("÷ that of foten", mean(ONE_STEP, data.FOTEN)),
        ("÷ bound", mean(ERROR, BOUND)),
        ("LSD ÷ AR(20)", mean(LSD, AR_LSD)),
        ("LSD ÷ ceiling", mean(LSD, CEILING)),
        *OF_TEXTURE[2:],
    )
    return table(("",), by_kind(), columns)


def of_each_texture(*names: str) -> Table:
    """Figures of each texture of experiments, and of a single experiment their mean."""
    columns: Columns = (
        ("one step [sd]", mean(ONE_STEP)),
        ("÷ best AR", mean(ONE_STEP, BEST_AR)),
        ("÷ foten", mean(ONE_STEP, data.FOTEN)),
        *OF_TEXTURE,
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

    def worst(key: str) -> Callable[[Records], str]:
        return lambda records: f"{max(records, key=lambda record: record['max_sd'])[key]:.1f}"

    def largest(key: str, digits: int, under: str = "") -> Callable[[Records], str]:
        return lambda records: f"{max(r[key] / (r[under] if under else 1) for r in records):.{digits}f}"

    def forgets(records: Records) -> str:
        seconds = [s for record in records if (s := record.get("forgets_s")) is not None]
        return f"{max(seconds):.1f}" + (f", {len(records) - len(seconds)} never" if len(seconds) < len(records) else "")

    def saturated(records: Records) -> str:
        n, of = (sum(record[key] for record in records) for key in ("n_saturated", "n_samples"))
        return f"{n:.0f} of {of:,.0f}"

    columns: Columns = (
        ("largest sample", worst("max_sd")),
        ("recorded", worst("recorded_max_sd")),
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
    kinds = {
        data.LINEAR: linear_family.LINEAR_FAMILY,
        data.SIMULATED: simulate.TEXTURES,
        data.CONTACT: contact_mechanics.CONTACT,
    }
    records = data.records_of("listener")
    return {MAIN[name]: [record for record in records if record["texture"] in keys] for name, keys in kinds.items()}


def listener() -> Table:
    """Areas under listeners' curves, means over the textures of each kind, beside those of two true vibrations."""

    def area(kind: str) -> Callable[[Records], str]:
        return average(lambda record: record[f"listener.listener_auc{kind}"])

    def worst(records: Records) -> str:
        worst = max(records, key=lambda record: record["listener.listener_auc"])
        return f"{worst['listener.listener_auc']:.2f} ({worst['texture']})"

    columns: Columns = (
        ("textures", n_textures),
        ("band energies", area("")),
        ("worst", worst),
        ("control", area("_control")),
        ("and waveform", area("_waveform")),
        ("a person's limits", area("_person")),
    )
    return table(("mean of",), listened(), columns)


def listener_notes() -> str:
    """Sentence on what the controls lie between."""
    kinds = ("listener_auc", "listener_auc_waveform", "listener_auc_person")
    controls = [
        record[f"listener.{kind}_control"] for records in listened().values() for record in records for kind in kinds
    ]
    return (
        f"One recording and one fit of each texture; controls lie between {min(controls):.2f} and {max(controls):.2f}."
    )
