"""Put the tables into README.md and the pages of docs/, each between its markers, from the CSV files in docs/results.

    python docs/make/tables.py [--check]

`docs/results/EXPERIMENT.csv` is the `runs.csv` that `foten tables` writes of a sweep; the others are what benchmarks keep by
`--csv`. With --check nothing is written, and the exit status is 1 where a page is not what the CSV files give. A table without
a CSV says so.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from foten.atomic_write import atomic_write
from foten.experiments.experiment import experiment_path, read_experiment
from foten.experiments.results import chosen, read_records
from foten.experiments.tables import findings, ratios, summary, with_error, written
from foten.simulation import contact_mechanics, linear_family, simulate

DOCS = Path(__file__).resolve().parents[1]
RESULTS = DOCS / "results"
Records = Sequence[Mapping[str, Any]]
Cells = list[list[str]]
REAL_10, REAL_2_5, LINEAR, SIMULATED = "main-real-10khz", "main-real-2500hz", "main-linear", "main-simulated"
CONTACT = "main-contact"
OURS = "foten-plus"
MAIN = {
    REAL_10: "real, 10 kHz",
    REAL_2_5: "real, 2.5 kHz",
    LINEAR: "linear processes",
    SIMULATED: "simulated textures",
    CONTACT: "contact mechanics",
}
MOST_COLUMNS, MOST_ROWS = 8, 12
NOT_RUN = "*Not measured yet with this version.*"


def runs(name: str, model: str = "foten-plus") -> list[Mapping[str, Any]]:
    """Return the runs of a model in an experiment; none where it has not been run."""
    path = RESULTS / f"{name}.csv"
    return [one for one in read_records(path) if one["model"] == model] if path.exists() else []


def values(records: Records, over: str, under: str = "") -> list[np.ndarray]:
    """Return a figure, or a ratio of two, by texture: one for each split that has it."""
    by_texture: dict[str, list[float]] = {}
    for one in records:
        numbers = [one.get(path) for path in (over, under) if path]
        if None not in numbers:
            ratio = numbers[0] if len(numbers) == 1 else numbers[0] / numbers[1]
            by_texture.setdefault(one["texture"], []).append(ratio)
    return [np.array(of) for of in by_texture.values()]


def cell(records: Records, over: str, under: str = "", digits: int = 3) -> str:
    """Return the mean over textures ± its standard error, a dash where there is none."""
    of = values(records, over, under)
    return with_error(of, digits) if of else "–"


ONE_STEP, BEST_AR, LSD = "one_step.mae_scaled", "references.ar_best.mae_scaled", "free_run.lsd_db"
AR_LSD, CEILING = "free_run_ar.lsd_db", "ceiling.lsd_db"
LEVEL, CEILING_LEVEL = "free_run.level_error_db", "ceiling.level_error_db"


def in_loop(records: Records) -> str:
    """Return in how many runs a rendering uses the network."""
    return f"{sum(bool(one['network_in_loop']) for one in records)} of {len(records)}"


def readme() -> Cells:
    """Return the five rows of the README, with what each means."""
    cells = [["", "one step ÷ best AR", "free run ÷ AR(20)", "free run ÷ ceiling", "what it means"]]
    for name, title in MAIN.items():
        records = runs(name)
        if records:
            figures = [
                cell(records, ONE_STEP, BEST_AR, 2),
                cell(records, LSD, AR_LSD, 2),
                cell(records, LSD, CEILING, 2),
            ]
            cells.append([title, *figures, meaning(name, records)])
    # A recording at two rates is two textures.
    every = [{**one, "texture": f"{name}/{one['texture']}"} for name in MAIN for one in runs(name)]
    if every:
        used = [one for one in every if one["network_in_loop"]]
        shares = [cell(used, over, under, 2) for over, under in ((ONE_STEP, BEST_AR), (LSD, AR_LSD), (LSD, CEILING))]
        used_in = (
            f"A rendering uses the network in {in_loop(every)} runs, where the validation blocks say that it helps"
        )
        cells.append(["network in the loop", *shares, used_in])
    return cells


def meaning(name: str, records: Records) -> str:
    """Say in a line what the figures of a kind of texture mean."""
    if name == LINEAR:
        above = 100 * (_mean(records, "one_step.mae_m_s2", "references.bound.mae_m_s2") - 1)
        return f"{above:.1f} % above the least one-step error that is possible"
    if name == SIMULATED:
        further = 100 * (_mean(records, LSD, CEILING) - 1)
        return f"The free run is {further:.0f} % further away than a second realisation of the same stroke"
    one_step, free_run = _than(records, ONE_STEP, BEST_AR), _than(records, LSD, AR_LSD)
    return f"One-step error {one_step} that of the best linear predictor; free run {free_run} AR(20)'s"


def _mean(records: Records, over: str, under: str) -> float:
    return float(np.mean([of.mean() for of in values(records, over, under)]))


def _than(records: Records, over: str, under: str) -> str:
    """Say how a mean ratio differs from 1 beyond its standard error."""
    of = values(records, over, under)
    mean = float(np.mean([one.mean() for one in of]))
    error = float(np.sqrt(sum(one.var(ddof=1) / one.size for one in of if one.size > 1)) / len(of))
    if abs(mean - 1) <= error:
        return "level with"
    return f"{100 * abs(mean - 1):.0f} % {'below' if mean < 1 else 'above'}"


def short() -> Cells:
    """Return the main figures by kind of texture."""
    head = ["", "one step ÷ best AR", "÷ that of foten", "÷ bound", "LSD ÷ AR(20)", "LSD ÷ ceiling"]
    cells = [[*head, "level error ÷ ceiling", "in the loop"]]
    for name, title in MAIN.items():
        records, theirs = runs(name), {(o["texture"], o["split"]): o[ONE_STEP] for o in runs(name, "foten")}
        if not records:
            continue
        beside = [dict(one, foten=theirs.get((one["texture"], one["split"]))) for one in records]
        row = [title, cell(records, ONE_STEP, BEST_AR), cell(beside, ONE_STEP, "foten")]
        row.append(cell(records, "one_step.mae_m_s2", "references.bound.mae_m_s2"))
        row += [cell(records, LSD, AR_LSD), cell(records, LSD, CEILING), cell(records, LEVEL, CEILING_LEVEL)]
        cells.append([*row, in_loop(records)])
    return cells


def by_texture(*names: str) -> Cells:
    """Return the figures of each texture of experiments, and their mean."""
    head = [
        "texture",
        "one step [sd]",
        "÷ best AR",
        "LSD [dB]",
        "÷ AR(20)",
        "÷ ceiling",
        "level error ÷ ceiling",
        "in the loop",
    ]
    cells = [head]
    for name in names:
        records = runs(name)
        rate = f", {MAIN[name].split(', ')[1]}" if len(names) > 1 else ""
        for texture in dict.fromkeys(one["texture"] for one in records):
            cells.append([texture + rate, *_figures([one for one in records if one["texture"] == texture])])
        if records and len(names) == 1:
            cells.append(["mean", *_figures(records)])
    return cells


def _figures(records: Records) -> list[str]:
    return [
        cell(records, ONE_STEP),
        cell(records, ONE_STEP, BEST_AR),
        cell(records, LSD, digits=2),
        cell(records, LSD, AR_LSD),
        cell(records, LSD, CEILING),
        cell(records, LEVEL, CEILING_LEVEL),
        in_loop(records),
    ]


def measured(measure: str) -> dict[str, Records]:
    """Return the runs that have a measure, by kind of texture."""
    kinds = {title: [one for one in runs(name) if _has(one, measure)] for name, title in MAIN.items()}
    return {title: of for title, of in kinds.items() if of}


def _has(record: Mapping[str, Any], measure: str) -> bool:
    return any(key.startswith(f"{measure}.") and value is not None for key, value in record.items())


def stability() -> Cells:
    """Return the worst of each kind of texture."""
    head = ["worst of", "largest sample", "recorded", "saturated", "under attack", "÷ bound"]
    cells = [[*head, "level off by [dB]", "forgets in [s]"]]
    for title, of in measured("stability").items():
        own = [{key.removeprefix("stability."): value for key, value in one.items()} for one in of]
        worst = max(own, key=lambda one: one["max_sd"])
        row = [f"{title}: {len(own)}", f"{worst['max_sd']:.1f}", f"{worst['recorded_max_sd']:.1f}"]
        row.append(f"{sum(one['n_saturated'] for one in own):.0f} of {sum(one['n_samples'] for one in own):,.0f}")
        row.append(f"{max(one['attack_later_max_sd'] for one in own):.0f}")
        row.append(f"{max(one['attack_later_max_sd'] / one['attack_bound_sd'] for one in own):.2f}")
        row.append(f"{max(one['attack_after_db'] for one in own):.2f}")
        forgets = [one.get("forgets_s") for one in own]
        met = [one for one in forgets if one is not None]
        cells.append([*row, f"{max(met):.1f}" + (f", {len(own) - len(met)} never" if len(met) < len(own) else "")])
    return cells


def onset() -> Cells:
    """Return means over the textures of each kind."""
    head = ["mean of", "textures", "level, 0 ms [dB]", "100 ms", "settled, at most", "spectrum, 0 ms [dB]"]
    cells = [[*head, "settled, at most", "clicks − settled"]]
    for title, of in measured("onset").items():

        def mean(key: str, of: Records = of) -> float:
            return float(np.mean([abs(one[f"onset.{key}"]) for one in of]))

        shown = ("level_db.0_ms", "level_db.100_ms", "level_db.settled", "spectrum_db.0_ms", "spectrum_db.settled")
        row = [title, str(len(of)), *(f"{mean(key):.2f}" for key in shown)]
        clicks = [100 * (one["onset.click_share"] - one["onset.settled_share"]) for one in of]
        error = np.sqrt(np.square([100 * one["onset.click_standard_error"] for one in of]).sum()) / len(of)
        cells.append([*row, f"{np.mean(clicks):+.3f} ± {error:.3f} %"])
    return cells


def innovations() -> Cells:
    """Return mean negative log-likelihoods re a Gaussian's, and the largest gain, by kind of texture."""
    cells = [["mean of", "textures", "Gaussian [nat]", "Student t", "two Gaussians", "z·exp(h z²/2)", "largest gain"]]
    for title, of in measured("innovations").items():
        own = [{key.removeprefix("innovations."): value for key, value in one.items()} for one in of]
        gains = {
            kind: [one[kind] - one["gaussian"] for one in own] for kind in ("student", "two_gaussians", "heavy_tailed")
        }
        most = int(np.argmin(gains["heavy_tailed"]))
        row = [title, str(len(own)), f"{np.mean([one['gaussian'] for one in own]):.3f}"]
        row += [f"{np.mean(gain):+.3f}" for gain in gains.values()]
        cells.append([*row, f"{gains['heavy_tailed'][most]:+.3f} ({of[most]['texture']})"])
    return cells


def listened(name: str) -> dict[tuple[str, str], Records]:
    """Return the runs of an experiment with listeners, by what the textures are and method."""
    path, title = RESULTS / "listener.csv", read_experiment(experiment_path(name)).title
    records = [one for one in read_records(path) if one["experiment"] == title] if path.exists() else []
    titles = (MAIN[LINEAR], MAIN[SIMULATED], MAIN[CONTACT])
    kinds = dict(zip(titles, (linear_family.LINEAR_FAMILY, simulate.TEXTURES, contact_mechanics.CONTACT), strict=True))
    found = {
        (title, method): [one for one in records if one["texture"] in keys and one["method"] == method]
        for (title, keys), method in product(kinds.items(), dict.fromkeys(one["method"] for one in records))
    }
    return {key: of for key, of in found.items() if of}


def mean_of(records: Records, key: str) -> str:
    """Return a mean over textures."""
    return f"{np.mean([one[f'listener.{key}'] for one in records]):.2f}"


def on_the_same(listened: dict[tuple[str, str], Records]) -> list[tuple[str, str, Records]]:
    """Return what to compare: after a method that was asked about some of the textures alone, foten-plus on the same ones."""
    rows = []
    for (title, method), of in listened.items():
        rows.append((title, method, of))
        keys, ours = {one["texture"] for one in of}, listened.get((title, OURS), [])
        if len(of) < len(ours):
            rows.append((title, OURS, [one for one in ours if one["texture"] in keys]))
    return rows


def listener() -> Cells:
    """Return areas under listeners' curves, means over the textures of each kind, beside those of two true vibrations."""
    cells = [["mean of", "textures", "method", "band energies", "worst", "control", "and waveform", "control"]]
    for title, method, of in on_the_same(listened("listener")):
        worst = max(of, key=lambda one: one["listener.listener_auc"])
        row = [title, str(len(of)), method, mean_of(of, "listener_auc")]
        row += [f"{worst['listener.listener_auc']:.2f} ({worst['texture']})", mean_of(of, "listener_auc_control")]
        cells.append([*row, mean_of(of, "listener_auc_waveform"), mean_of(of, "listener_auc_waveform_control")])
    return cells


def recorded_longer() -> Cells:
    """Return the same of foten-plus for recordings of two lengths, of the textures that both have."""
    cells = [["mean of", "textures", "recorded", "band energies", "worst", "control", "and waveform"]]
    short = listened("listener")
    for (title, method), long in listened("listener-256s").items():
        keys = {one["texture"] for one in long}
        for seconds, records in (("64 s", short.get((title, method), [])), ("256 s", long)):
            of = [one for one in records if one["texture"] in keys]
            if not of:
                continue
            worst = max(of, key=lambda one: one["listener.listener_auc"])
            row = [title, str(len(of)), seconds, mean_of(of, "listener_auc")]
            row += [f"{worst['listener.listener_auc']:.2f} ({worst['texture']})", mean_of(of, "listener_auc_control")]
            cells.append([*row, mean_of(of, "listener_auc_waveform")])
    return cells


def of_experiment(name: str, table: Callable[[Records], Cells]) -> Cells:
    """Return a table of an experiment's runs, empty where it has not been run."""
    path = RESULTS / f"{name}.csv"
    return table(chosen(read_records(path))) if path.exists() else []


def compared(records: Records) -> Cells:
    """Return the summary of an experiment without the references that a better one stands for, or that nothing is worse than."""
    left_out = ("zero", "persistence", "AR(20)", "AR(20) by speed and force")
    return [row for row in summary(records) if row[0] not in left_out]


def kept(name: str) -> Cells:
    """Return what a benchmark kept."""
    path = RESULTS / f"{name}.csv"
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return [row for row in csv.reader(file) if row]


def said(name: str) -> str:
    """Return what an experiment's runs say, as a list."""
    path = RESULTS / f"{name}.csv"
    return "\n".join(f"- {line}" for line in findings(read_records(path))) if path.exists() else ""


def listed(*names: str) -> str:
    """Return links to the runs of experiments that have been run."""
    lines = []
    for name in names:
        if (RESULTS / f"{name}.csv").exists():
            experiment = tomllib.loads(experiment_path(name).read_text(encoding="utf-8"))
            lines.append(f"- [{name}](results/{name}.csv): {experiment['note'].rstrip('.')}")
    return "\n".join(lines)


MEASURED = ("step", "contacts", "soak", "install", "studio-page", "studio-load", "study")
TABLES: dict[str, dict[str, Callable[[], Cells | str]]] = {
    "../README.md": {"readme": readme},
    "results.md": {
        "short": short,
        "real": lambda: by_texture(REAL_10, REAL_2_5),
        "linear": lambda: by_texture(LINEAR),
        "simulated": lambda: by_texture(SIMULATED),
        "stability": stability,
        "onset": onset,
        "innovations": innovations,
        "ingredients": lambda: of_experiment("ingredients", ratios),
        "csv": lambda: listed(*MAIN, "listener", "ingredients"),
    },
    "listener.md": {"listener": listener, "recorded-longer": recorded_longer},
    "model.md": {"random-part": lambda: kept("random-part")},
    "compared.md": {
        "table-1-small": lambda: of_experiment("table-1-small", compared),
        "findings": lambda: said("table-1-small"),
        "table-1-real": lambda: of_experiment("table-1-real", compared),
        "efficiency": lambda: kept("efficiency"),
        "csv": lambda: listed("recipes", "table-1-small", "table-1-real"),
    },
    "runtime.md": {
        name: (lambda name=name: kept(name))
        for name in ("step", "contacts", "soak", "install", "studio-page", "studio-load", "study")
    },
}


def checked(name: str, cells: Cells) -> str:
    """Return a table as Markdown, unless people cannot read it.

    Raises:
        ValueError: it has more columns or rows than people read.
    """
    rows = [row for row in cells[1:] if row[0] != "mean"]
    if len(cells[0]) > MOST_COLUMNS or len(rows) > MOST_ROWS:
        raise ValueError(
            f"{name}: {len(cells[0])} columns and {len(rows)} rows, expected {MOST_COLUMNS} and {MOST_ROWS} at most"
        )
    return written(cells, "md")


def pages() -> Iterator[tuple[Path, str, str]]:
    """Yield each page, what it says, and what it should."""
    for page, tables in TABLES.items():
        path = (DOCS / page).resolve()
        before = text = path.read_text(encoding="utf-8")
        for name, make in tables.items():
            begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
            head, _, rest = text.partition(begin)
            _, closed, tail = rest.partition(end)
            if not closed:
                raise ValueError(f"{path.name}: has no {begin} … {end} to put a table between")
            content = make()
            body = content if isinstance(content, str) else checked(name, content) if len(content) > 1 else ""
            text = f"{head}{begin}\n{body.rstrip() or NOT_RUN}\n{end}{tail}"
        yield path, before, text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="exit 1 where a page is not what the CSV files give")
    arguments = parser.parse_args()
    stale = [(path, text) for path, before, text in pages() if before != text]
    if arguments.check and stale:
        sys.exit(f"{', '.join(path.name for path, _ in stale)}: run 'python docs/make/tables.py' and commit it")
    for path, text in stale:
        with atomic_write(path) as part:
            part.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
