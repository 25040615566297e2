"""Result files of a sweep as flat records, and records as `runs.csv`: read, joined, chosen, refused."""

import csv
import io
import itertools
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from foten.reporting.table import Table
from foten.untrusted import MAX_PROFILE, check_numbers, parse_json, read_whole
from foten_lab.experiment import MAX_RUNS, Run

Results = Sequence[Mapping[str, Any]]  # result files of a sweep, with the signals that figures are drawn from
Record = Mapping[str, Any]  # a run: names, settings, and figures by their paths; a row of `runs.csv`
Records = Sequence[Record]


@dataclass(frozen=True)
class Figure:
    """A number of a run."""

    name: str  # in headings, with its unit
    path: str  # its key in a record
    digits: int  # behind the point, of means
    better: int  # 1 where more is better, −1 where less is
    linear: str  # the linear predictor among the references, that a method is to beat
    factor: float = 1.0  # from the number in the file to the one in tables


BEST_LINEAR, LINEAR_RUN = "best AR", "AR(20) with white noise"
FIGURES = {
    "mae": Figure("one-step MAE [sd]", "one_step.mae_scaled", 3, -1, BEST_LINEAR),
    "gfc": Figure("one-step GFC [%]", "one_step.gfc", 1, 1, BEST_LINEAR, factor=100.0),
    "lsd": Figure("free-run log-spectral distance [dB]", "free_run.lsd_db", 2, -1, LINEAR_RUN),
    "level": Figure("free-run level error [dB]", "free_run.level_error_db", 2, -1, LINEAR_RUN),
}
OF_MODEL = "code (of "  # how what runs of one model differ in begins
DIGEST = re.compile("[0-9a-f]{16}|")  # code of a run of before git's trees, or none
WITHOUT = ", without excitation"  # after a method's name, where its free run has none
_SCORES = (
    *("one_step", "free_run", "free_run_deterministic", "free_run_ar", "ceiling", "warm_start"),
    *("listener", "references", "validation"),
)
_ONCE = ("note", "platform", "code")  # in `runs.csv`: empty where an experiment's run before has the same
VALIDATION = ("validation.mae_scaled", "validation.spectrum_db")  # what a recipe is chosen by, the first that it has
MAX_FIGURE = 1e12
_NEEDED = ("split", "rate_hz", "recording_sha256", "training_s")  # for tables
_TEXTS = (
    "random_part",
    *("experiment", "note", "method", "recipe", "beside", "model", "texture"),
    *("excitation", "measures", "code", "platform"),
)


def read_result(path: Path) -> dict[str, Any] | None:
    """Result in a file; None where no record can be made of it."""
    try:
        result: dict[str, Any] = parse_json(read_whole(path, MAX_PROFILE))
        check_numbers(result, path.name)
        hash(tuple(_record(result).values()))  # by which runs are told apart
    except (AttributeError, ValueError, KeyError, TypeError, OSError):
        return None
    return result


def read_results(folder: Path, mixed: bool = False) -> list[dict[str, Any]]:
    """Results in a folder, in the order of their experiment.

    Args:
        mixed: allow results of different code or platform.

    Raises:
        ValueError: there is none, a file is no result, two are of one place of the tables, or of different code or platform.
    """
    results: list[dict[str, Any]] = []
    paths: dict[tuple[str, str, str, int], str] = {}
    for path in sorted(folder.glob("*.json")):
        result = read_result(path)
        if result is None:
            raise ValueError(f"{path.name} is no result of foten sweep, or damaged")
        method, _, texture, split = place = Run(**result["run"]).place
        if place in paths:
            both = f"{paths[place]} and {path.name} are both of {method} on {texture}, split {split}"
            raise ValueError(f"{both}: are results of other settings left in the folder? Move one away")
        paths[place] = path.name
        results.append(result)
    if not results:
        raise ValueError(f"there is no result of foten sweep in {folder}")
    results.sort(key=lambda result: int(result["index"]))
    if not mixed:
        check_alike(records_of(results))
    return results


def records_of(results: Results) -> list[dict[str, Any]]:
    """Records of result files, in their order, without lists (errors by band) and intervals."""
    return [_record(result) for result in results]


def _record(result: Mapping[str, Any]) -> dict[str, Any]:
    run, evaluation, provenance = Run(**result["run"]), result["evaluation"], result["provenance"]
    method, recipe, texture, split = run.place
    int(result["index"])  # of which results are put in order
    record: dict[str, Any] = {
        "experiment": result["experiment"]["title"],
        "note": result["experiment"]["note"],
        "method": method,
        "recipe": recipe,
        "beside": run.beside,
        "model": run.model,
        "texture": texture,
        "rate_hz": evaluation["rate_hz"],
        "split": split,
        "n_blocks": evaluation["n_blocks"],
        "excitation": _excitation(evaluation),
        "random_part": result["random_part"],
        "recording_sha256": result["recording_sha256"][:12],
        "split_sha256": (evaluation["split_sha256"] or "")[:12],
        "epochs": result["n_epochs"],
        "training_s": result["seconds"]["training"],
        "evaluation_s": result["seconds"]["evaluation"],
        "file_bytes": result["file_bytes"],
        "measures": " ".join(run.measures),
        "code": provenance["code"],
        "platform": ", ".join(f"{name} {value}" for name, value in provenance["platform"].items()),
    }
    scores = {name: evaluation[name] for name in _SCORES if evaluation.get(name) is not None}
    return record | dict(_flat(scores | result["measures"]))


def _excitation(evaluation: Mapping[str, Any]) -> str:
    """Whether a free run has the random excitation, "yes" or "no"; empty where there is no free run."""
    if evaluation["free_run"]["lsd_db"] is not None:
        return "yes"
    return "no" if evaluation["free_run_deterministic"]["lsd_db"] is not None else ""


def _flat(scores: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield numbers and answers by their paths."""
    for key, value in scores.items():
        if isinstance(value, Mapping) and key != "intervals":
            yield from _flat(value, f"{prefix}{key}.")
        elif value is None or isinstance(value, int | float):
            yield f"{prefix}{key}", value


def check_alike(records: Records) -> None:
    """Check that runs are of the same code and platform.

    Raises:
        ValueError: two are not; the message names them.
    """
    if differing := mixture(records):
        raise ValueError(f"{differing}: run the sweep again, or allow it by --mixed")


def mixture(records: Records) -> str:
    """Runs of different code or platform, in words; nothing where all are alike.

    A version of before is a digest of what runs of one model and the same measures import: it is compared with theirs alone.
    """
    first: dict[str, tuple[str, str]] = {}
    others: dict[str, list[str]] = {}
    counts: dict[str, Counter[str]] = {}  # of values
    by_model = any(DIGEST.fullmatch(record.get("code") or "") for record in records)
    for record in records:
        name = f"{record['method']} on {record['texture']}, split {record['split']:g}"
        of_model = f"{OF_MODEL}{record['model']} {record.get('measures', '')}".rstrip() + ")"
        compared = {of_model if by_model else "code": record.get("code"), "platform": record.get("platform")}
        for what, value in ((what, value or "") for what, value in compared.items()):
            counts.setdefault(what, Counter())[value] += 1
            known, _ = first.setdefault(what, (value, name))
            if value != known:
                others.setdefault(what, []).append(name)
    differences: dict[tuple[str, ...], str] = {}  # of the same runs the first of what they differ in
    for what, names in others.items():
        differences.setdefault((first[what][1], *names), what)
    models = [what for what in differences.values() if what.startswith(OF_MODEL)]
    clauses = [
        f"{name!r} and {other!r}{f' and {len(more)} more' if more else ''} differ in {what}"
        for (name, other, *more), what in differences.items()
        if len(models) < 2 or what not in models
    ]
    if len(models) > 1:
        totals = {what: (counts[what].total(), counts[what].most_common(1)[0][1]) for what in models}
        shares = (f"{what.removeprefix(OF_MODEL).rstrip(')')} {n - most} of {n}" for what, (n, most) in totals.items())
        clauses.append(f"runs of other code than most of their model: {', '.join(shares)}")
    return "; ".join(clauses)


def joined(parts: Sequence[Records], mixed: bool = False) -> list[dict[str, Any]]:
    """Runs of several sweeps in order; of a run that several have, the first.

    Args:
        mixed: allow runs of different code or platform.

    Raises:
        ValueError: they are of several experiments, of different code or platform, or of two recordings in one place; a run lacks
            what tables need.
    """
    titles = list(dict.fromkeys(record["experiment"] for part in parts for record in part))
    if len(titles) > 1:
        raise ValueError(f"results of {' and of '.join(map(repr, titles))}, expected those of one experiment")
    names = ("method", "recipe", "texture", "split")
    runs: dict[tuple[Any, ...], dict[str, Any]] = {}
    for record in itertools.chain.from_iterable(parts):
        if missing := [name for name in _NEEDED if record.get(name) in (None, "")]:
            what = f"{record['method']} on {record['texture']} has no {' and no '.join(missing)}"
            raise ValueError(f"{what}: is this the whole runs.csv that foten tables wrote?")
        first = runs.setdefault(tuple(record[name] for name in names), dict(record))
        if first["recording_sha256"] != record["recording_sha256"]:
            what = f"{record['method']} on {record['texture']}, split {record['split']:g}"
            raise ValueError(f"{what}, is there of two recordings, as after a change of the simulator: leave one out")
    records = list(runs.values())
    if len(records) > MAX_RUNS:
        raise ValueError(f"there are {len(records)} runs, expected {MAX_RUNS} at most")
    if not mixed:
        check_alike(records)
    return records


def read_records(path: Path) -> list[dict[str, Any]]:
    """Runs of a sweep, alike or not: of its folder, or of the `runs.csv` that `foten tables` wrote of it.

    Raises:
        ValueError: there is none, or a file is no result, or the CSV is not of that kind.
    """
    if path.suffix != ".csv":
        return records_of(read_results(path, mixed=True))
    data = read_whole(path)
    try:  # a spreadsheet writes a mark before the first name
        rows = list(csv.DictReader(io.StringIO(data.decode("utf-8-sig"), newline="")))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path.name} is no CSV file in UTF-8 ({error})") from error
    # A figure that no run has is no column: before the first run with an excitation is done, for example.
    names = set(rows[0] if rows else ())
    if not ({"method", "texture", "split"} <= names and {f.path for f in FIGURES.values()} & names):
        raise ValueError(f"{path.name} is no runs.csv of foten tables")
    above: dict[tuple[str, str], str] = {}
    experiment, records = "", []
    for n, row in enumerate(rows, 2):  # as a spreadsheet counts
        if None in row or None in row.values():
            raise ValueError(f"{path.name}, row {n}: it has not as many cells as row 1 has names; is it cut off?")
        experiment = row["experiment"] = row.get("experiment") or experiment
        for name in _ONCE:
            of = row.get("experiment", ""), name
            row[name] = above[of] = row.get(name) or above.get(of, "")
        records.append(dict.fromkeys(_TEXTS, ""))
        for key, text in row.items():
            try:
                records[-1][key] = _parsed(key, text)
            except ValueError as error:
                raise ValueError(f"{path.name}, row {n}: {key} is {text!r}, expected a number below 1e12") from error
    return records


def _parsed(key: str, text: str) -> Any:
    """Cell of `runs.csv`: a text, a number, or None."""
    if key in _TEXTS or key.endswith("_sha256") or key.startswith("version."):  # which earlier versions wrote
        return text
    if text in ("", "yes", "no"):
        return {"": None, "yes": True, "no": False}[text]
    if not abs(number := float(text)) < MAX_FIGURE:
        raise ValueError
    return number


def runs_table(records: Records, digits: int | None = None) -> Table:
    """Table `runs.csv`, a row for each run, empty where there is no figure.

    Experiment, note, platform and code are empty where they are those above.

    Args:
        digits: significant ones; None for all, so that a mean of them is rounded once.
    """
    every_key = dict.fromkeys(key for record in records for key in record)
    keys = [key for key in every_key if any(record.get(key) not in (None, "") for record in records)]

    def cell(value: Any) -> str:
        if isinstance(value, bool):
            return "yes" if value else "no"
        if isinstance(value, float):
            return f"{value:.0f}" if value.is_integer() else repr(value) if digits is None else f"{value:.{digits}g}"
        return "" if value is None else str(value)

    previous: dict[str, Record] = {}  # run of an experiment
    experiment = ""
    rows: list[list[str]] = []
    for record in records:
        above = previous.get(record["experiment"])
        names = {} if above is None else {k: "" if above[k] == record[k] else record[k] or "unknown" for k in _ONCE}
        title = record["experiment"]
        again = {"experiment": ""} if rows and title == experiment else {}
        rows.append([cell({**record, **names, **again}.get(key)) for key in keys])
        experiment = title
        previous[title] = record
    return Table.of(keys, rows)


def chosen(records: Records) -> list[Record]:
    """Records of one recipe for each method: of several the one with the lowest mean validation error."""
    recipe_of = {method: next(iter(errors)) for method, errors in by_recipe(records).items()}
    return [record for record in records if record["recipe"] == recipe_of.get(record["method"], record["recipe"])]


def chosen_results(results: Results) -> list[Mapping[str, Any]]:
    """Result files of the recipes that are `chosen`."""
    shown = {(record["method"], record["recipe"]) for record in chosen(records_of(results))}
    return [result for result in results if Run(**result["run"]).place[:2] in shown]


def by_recipe(records: Records) -> dict[str, dict[str, float]]:
    """Mean validation errors of the recipes of each method that has several, the lowest first.

    Over the textures and splits that all recipes have.
    """
    errors: dict[str, dict[str, dict[tuple[Any, ...], float]]] = {}
    for record in records:
        error = next((record[key] for key in VALIDATION if record.get(key) is not None), math.inf)
        recipe = errors.setdefault(record["method"], {}).setdefault(record["recipe"], {})
        recipe[record["texture"], record["split"]] = error
    means = {}
    for method, recipes in errors.items():
        shared = set.intersection(*map(set, recipes.values()))
        if len(recipes) > 1 and shared:
            each = {name: float(np.mean([cells[key] for key in sorted(shared)])) for name, cells in recipes.items()}
            means[method] = dict(sorted(each.items(), key=lambda item: item[1]))
    return means


def label_of(result: Mapping[str, Any]) -> str:
    """Name of a result's row in tables, and of its line in figures."""
    return Run(**result["run"]).label + (WITHOUT if _excitation(result["evaluation"]) == "no" else "")


def title_of(records: Records) -> str:
    """Titles of the experiments that runs are of."""
    return "; ".join(dict.fromkeys(record["experiment"] for record in records if record["experiment"]))
