"""The runs of a sweep as flat records, their figures as rows over textures, and which differences are significant."""

from __future__ import annotations

import csv
import itertools
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from foten.dsp import Array
from foten.experiments.experiment import Run

Results = Sequence[Mapping[str, Any]]
"""Result files of a sweep, with the signals that figures are drawn from."""
Records = Sequence[Mapping[str, Any]]
"""Runs, a flat dictionary each: what tables are made of, and a row of `runs.csv`."""

_OF_A_RESULT = {
    *("evaluation", "foten", "versions", "recording_sha256"),
    *("seconds", "signals", "n_epochs", "validation_mae_scaled"),
}
_OF_AN_EVALUATION = {"one_step", "free_run", "references", "ceiling", "n_blocks", "split_sha256", "rate_hz"}


@dataclass(frozen=True)
class Reported:
    """One method's figures as the paper prints them; None where it prints none.

    Source: Tables I to III; no unit is stated for its errors.
    """

    mae: float  # mean over its twelve textures
    gfc: float  # the same, in %
    gpu_ms: float | None = None  # of one inference
    cpu_ms: float | None = None
    epoch_s: float | None = None  # of one epoch of training


PAPER = {
    "ar": Reported(0.400, 86.28),
    "fnn": Reported(0.378, 87.83),
    "dstn": Reported(0.201, 90.33, 1.38, 1.89, 44.35),
    "ldhtd": Reported(0.178, 91.02, 1.13, 1.26, 27.45),
    "gan": Reported(0.298, 88.65, 1.72, 2.37, 85.71),
    "foten": Reported(0.149, 92.15, 0.96, 1.11, 10.26),
    "ten": Reported(0.318, 86.77, 0.87, 1.07, 8.92),
    "ten-mfcc": Reported(0.281, 90.28),
    "ten-wavelet": Reported(0.284, 86.18),
    "foten-d": Reported(0.193, 90.64, 1.16, 1.39, 14.81),
}


@dataclass(frozen=True)
class Figure:
    """A number of a run."""

    name: str  # in headings, with its unit
    path: str  # its key in a record
    digits: int  # behind the point, of means
    better: int  # 1 where more is better, −1 where less is
    linear: str  # the linear predictor among the references, that a method is to beat
    factor: float = 1.0  # from the number in the file to the one in tables


PERSISTENCE, BEST_LINEAR, LINEAR_RUN = "persistence", "best AR", "AR(20) with white noise"
FIGURES = {
    "mae": Figure("one-step MAE [sd]", "one_step.mae_scaled", 3, -1, BEST_LINEAR),
    "gfc": Figure("one-step GFC [%]", "one_step.gfc", 1, 1, BEST_LINEAR, factor=100.0),
    "lsd": Figure("free-run log-spectral distance [dB]", "free_run.lsd_db", 2, -1, LINEAR_RUN),
    "level": Figure("free-run level error [dB]", "free_run.level_error_db", 2, -1, LINEAR_RUN),
}
REFERENCES = {
    "zero": "references.zero",
    PERSISTENCE: "references.persistence",
    "AR(20)": "references.ar",
    "AR(20) by speed and force": "references.ar_scheduled",
    BEST_LINEAR: "references.ar_best",
    "least possible": "references.bound",
}
FREE_RUN_REFERENCES = {LINEAR_RUN: "free_run_ar", "ceiling": "ceiling"}
WITHOUT = ", without excitation"
"""What is added to a method's name, in tables and figures, where its free run has no excitation."""
VALIDATION = ("validation.mae_scaled", "validation.spectrum_db")
"""What the recipe of a method is chosen by, the first that it has: a one-step error, of models of spectra a distance."""
_KEPT = (
    "one_step",
    "free_run",
    "free_run_deterministic",
    "free_run_ar",
    "ceiling",
    "listener",
    "references",
    "validation",
)


def records_of(results: Results) -> list[dict[str, Any]]:
    """Return result files as records, in their order: names, settings, and every figure by its path.

    Of lists, as errors by band, nothing is kept; of intervals those of `FIGURES`, as `.low` and `.high`.
    """
    return [_record(one) for one in results]


def _record(result: Mapping[str, Any]) -> dict[str, Any]:
    run, judged = Run(**result["run"]), result["evaluation"]
    record: dict[str, Any] = {
        "experiment": result.get("experiment", {}).get("title", ""),
        "note": result.get("experiment", {}).get("note", ""),
        "method": run.label,
        "recipe": run.recipe,
        "beside": run.beside,
        "model": run.model,
        "texture": name_of(run.texture),
        "rate_hz": judged["rate_hz"],
        "split": run.split_seed,
        "n_blocks": judged["n_blocks"],
        "excitation": _excitation(judged),
        "network_in_loop": result.get("network_in_loop"),
        "recording_sha256": result["recording_sha256"][:12],
        "split_sha256": (judged["split_sha256"] or "")[:12],
        "epochs": result["n_epochs"],
        "training_s": result["seconds"]["training"],
        "evaluation_s": result["seconds"]["evaluation"],
        "file_bytes": result.get("file_bytes"),
        "version.foten": result["foten"],
        **{f"version.{package}": version for package, version in result["versions"].items()},
    }
    scores = {name: judged[name] for name in _KEPT if judged.get(name) is not None} | result.get("measures", {})
    record |= dict(_flat(scores))
    for figure in FIGURES.values():
        head, _, key = figure.path.rpartition(".")
        low, high = (judged[head].get("intervals") or {}).get(key) or (None, None)
        record |= {f"{figure.path}.low": low, f"{figure.path}.high": high}
    return record


def _excitation(judged: Mapping[str, Any]) -> str:
    """Return whether a free run has the random excitation, "yes" or "no"; empty where there is no free run."""
    if judged["free_run"]["lsd_db"] is not None:
        return "yes"
    return "no" if judged["free_run_deterministic"]["lsd_db"] is not None else ""


def _flat(scores: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield numbers and answers by their paths."""
    for key, value in scores.items():
        if isinstance(value, Mapping) and key != "intervals":
            yield from _flat(value, f"{prefix}{key}.")
        elif value is None or isinstance(value, int | float):
            yield f"{prefix}{key}", value


def joined(parts: Sequence[Records]) -> list[dict[str, Any]]:
    """Return the runs of several sweeps as one, in order; of a run that several have, the first.

    Raises:
        ValueError: they are of several experiments.
    """
    titles = list(dict.fromkeys(one["experiment"] for part in parts for one in part))
    if len(titles) > 1:
        raise ValueError(f"results of {' and of '.join(map(repr, titles))}, expected those of one experiment")
    names = ("method", "recipe", "texture", "split", "recording_sha256")
    runs: dict[tuple[Any, ...], dict[str, Any]] = {}
    for one in itertools.chain.from_iterable(parts):
        runs.setdefault(tuple(one[name] for name in names), dict(one))
    return list(runs.values())


def read_records(path: Path) -> list[dict[str, Any]]:
    """Return the runs of a sweep: of its folder, or of the `runs.csv` that `foten tables` wrote of it.

    Raises:
        ValueError: there is none, or a file is no result, or the CSV is not of that kind.
    """
    if path.suffix != ".csv":
        return records_of(read_results(path))
    if not path.is_file():
        raise ValueError(f"there is no {path}")
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    if not rows or not {"method", "texture", "split", *(figure.path for figure in FIGURES.values())} <= set(rows[0]):
        raise ValueError(f"{path.name} is no runs.csv of foten tables")
    for key in _SHARED:
        texts = {row[key] for row in rows if row.get(key)}
        shared = texts.pop() if len(texts) == 1 else ""
        for row in rows:
            row[key] = row.get(key) or shared
    try:
        return [dict.fromkeys(_TEXTS, "") | {key: _parsed(key, text) for key, text in row.items()} for row in rows]
    except ValueError as error:
        raise ValueError(f"{path.name} is no runs.csv of foten tables: {error}") from error


_SHARED = ("experiment", "note")
_TEXTS = (*_SHARED, "method", "recipe", "beside", "model", "texture", "excitation")


def _parsed(key: str, text: str) -> Any:
    """Return a cell of `runs.csv`: a text, a number, or None."""
    if key in _TEXTS or key.endswith("_sha256") or key.startswith("version."):
        return text
    return {"": None, "yes": True, "no": False}[text] if text in ("", "yes", "no") else float(text)


def written_records(records: Records, digits: int = 6) -> list[list[str]]:
    """Return records as the cells of `runs.csv`, its heading first, empty where there is no figure.

    A title or a note that all have stands in the first row alone, and one that is alone in a file is that of all its rows.

    Args:
        digits: significant ones, of figures that are no whole numbers.
    """
    keys = list(dict.fromkeys(key for one in records for key in one))
    keys = [key for key in keys if any(one.get(key) not in (None, "") for one in records)]
    shared = [key for key in _SHARED if len({one.get(key) for one in records}) == 1]

    def cell(key: str, value: Any, first: bool) -> str:
        if key in shared and not first:
            return ""
        if isinstance(value, bool):
            return "yes" if value else "no"
        if isinstance(value, float):
            return f"{value:.0f}" if value.is_integer() else f"{value:.{digits}g}"
        return "" if value is None else str(value)

    return [keys, *([cell(key, one.get(key), not k) for key in keys] for k, one in enumerate(records))]


def chosen(records: Records) -> list[Mapping[str, Any]]:
    """Return the records of one recipe for each method: of several the one with the least validation error.

    The mean over the textures and splits that all recipes have. Which it is depends on validation blocks alone.
    """
    recipe_of = {method: next(iter(errors)) for method, errors in by_recipe(records).items()}
    return [one for one in records if one["recipe"] == recipe_of.get(one["method"], one["recipe"])]


def chosen_results(results: Results) -> list[Mapping[str, Any]]:
    """Return the result files of the recipes that are `chosen`."""
    kept = {(one["method"], one["recipe"]) for one in chosen(records_of(results))}
    runs = [Run(**one["run"]) for one in results]
    return [one for one, run in zip(results, runs, strict=True) if (run.label, run.recipe) in kept]


def by_recipe(records: Records) -> dict[str, dict[str, float]]:
    """Return the mean validation errors of the recipes of each method that has several, the least first."""
    errors: dict[str, dict[str, dict[tuple[Any, ...], float]]] = {}
    for one in records:
        error = next((one[key] for key in VALIDATION if one.get(key) is not None), math.inf)
        cell = errors.setdefault(one["method"], {}).setdefault(one["recipe"], {})
        cell[one["texture"], one["split"]] = error
    means = {}
    for method, of in errors.items():
        shared = set.intersection(*(set(cells) for cells in of.values()))
        if len(of) > 1 and shared:
            each = {recipe: float(np.mean([cells[key] for key in sorted(shared)])) for recipe, cells in of.items()}
            means[method] = dict(sorted(each.items(), key=lambda item: item[1]))
    return means


def read_results(folder: Path) -> list[dict[str, Any]]:
    """Return the results in a folder, in the order of their experiment.

    Raises:
        ValueError: there is none, a file is no result, two are of one method on one texture and split, or two recordings have
            one name.
    """
    if not folder.is_dir():
        raise ValueError(f"there is no folder {folder}")
    results: list[dict[str, Any]] = []
    seen: dict[tuple[str, str, str, int], str] = {}
    digests: dict[str, str] = {}
    for path in sorted(folder.glob("*.json")):
        result = read_result(path)
        if result is None:
            raise ValueError(f"{path.name} is no result of foten sweep, or damaged")
        run = Run(**result["run"])
        texture, digest = name_of(run.texture), result["recording_sha256"]
        cell = run.label, run.recipe, texture, run.split_seed
        if cell in seen:
            raise ValueError(
                f"{seen[cell]} and {path.name} are both of {run.label} on {texture}, split {run.split_seed}: are results of "
                "other settings or of an earlier version left in the folder? Move one away"
            )
        seen[cell] = path.name
        if run.seconds is None and digests.setdefault(texture, digest) != digest:
            raise ValueError(f"two recordings are called {texture}, which a table cannot tell apart")
        results.append(result)
    if not results:
        raise ValueError(f"there is no result of foten sweep in {folder}")
    return sorted(results, key=lambda result: result.get("index", 0))


def read_result(path: Path) -> dict[str, Any] | None:
    """Return the result in a file, with all that tables and figures need; None where there is none, or it is damaged."""
    try:
        result = json.loads(path.read_bytes())
        complete = isinstance(Run(**result["run"]).texture, str) and isinstance(result["evaluation"], dict)
    except (ValueError, KeyError, TypeError, OSError):
        return None
    complete = complete and set(result) >= _OF_A_RESULT and set(result["evaluation"]) >= _OF_AN_EVALUATION
    return result if complete else None


def label_of(result: Mapping[str, Any]) -> str:
    """Return the name of a result's row in tables, and of its line in figures."""
    return Run(**result["run"]).label + (WITHOUT if _excitation(result["evaluation"]) == "no" else "")


def name_of(texture: str) -> str:
    """Return the name of a texture: of a recording, its file's without folder and suffix."""
    return Path(texture).stem


def title_of(records: Records) -> str:
    """Return the titles of the experiments that runs are of."""
    return "; ".join(dict.fromkeys(one["experiment"] for one in records if one["experiment"]))


@dataclass(frozen=True)
class Row:
    """One method or reference over textures."""

    name: str  # in tables
    model: str  # key, "" for a reference
    values: Mapping[str, Array]  # by texture, one for each split that has one, shape (n_splits,)
    excited: bool = False  # whether it has the random excitation, on which no one-step figure depends

    def means(self, textures: Sequence[str]) -> Array:
        """Return the mean over splits for each texture, NaN where there is none, shape (n_textures,)."""
        return np.array([self.values[t].mean() if len(self.values.get(t, ())) else math.nan for t in textures])


def rows_of(records: Records, figure: str) -> tuple[list[str], list[Row]]:
    """Return the textures, and a row for each reference and each method, references first."""
    textures = list(dict.fromkeys(one["texture"] for one in records))
    head, _, key = FIGURES[figure].path.rpartition(".")
    factor = FIGURES[figure].factor

    def row(name: str, model: str, where: str, own: Iterable[Mapping[str, Any]], excited: bool = False) -> Row:
        values: dict[str, list[float]] = {}
        for one in own:
            value = one.get(f"{where}.{key}")
            if value is not None:
                values.setdefault(one["texture"], []).append(factor * value)
        return Row(name, model, {texture: np.array(own) for texture, own in values.items()}, excited)

    # A reference is the same whatever was trained beside it: once for each recording and split.
    distinct = {(one["texture"], one["recording_sha256"], one["split"], one["rate_hz"]): one for one in records}
    references = FREE_RUN_REFERENCES if head == "free_run" else REFERENCES
    rows = [row(name, "", where, distinct.values()) for name, where in references.items()]
    rows = [one for one in rows if one.values]
    for name in dict.fromkeys(one["method"] for one in records):
        own = [one for one in records if one["method"] == name]
        model, excitation = own[-1]["model"], {one["excitation"] for one in own}
        if "no" in excitation and "yes" not in excitation:
            where = "free_run_deterministic" if head == "free_run" else head
            rows.append(row(name + WITHOUT, model, where, own))
        else:
            rows.append(row(name, model, head, own, "yes" in excitation))
    return textures, rows


def holm(p: Sequence[float]) -> list[float]:
    """Return p-values corrected for multiple comparisons, after Holm (1979), in the order given."""
    order = np.argsort(p, kind="stable")
    corrected = np.empty(len(p))
    corrected[order] = np.maximum.accumulate(np.arange(len(p), 0, -1) * np.asarray(p)[order]).clip(max=1.0)
    return corrected.tolist()


def complete(rows: Sequence[Row], textures: Sequence[str]) -> list[Row]:
    """Return the methods that have as many splits of each texture as any has."""
    methods = [row for row in rows if row.model]
    most = {texture: max(len(row.values.get(texture, ())) for row in methods) for texture in textures}
    return [row for row in methods if all(len(row.values.get(t, ())) == most[t] > 0 for t in textures)]


def compared(rows: Sequence[Row], textures: Sequence[str], better: int) -> tuple[str, dict[str, float]]:
    """Return the method that is best on the mean of the textures, and p-values of the others' differences from it.

    Methods that lack a split of a texture are left out: another split of a simulated texture is another recording.
    Wilcoxon's signed-rank test over the textures (means of splits), two-sided, Holm-corrected. Empty with fewer than six
    textures, where no p can be below 0.05.
    """
    from scipy.stats import wilcoxon

    methods = complete(rows, textures)
    if not methods:
        return "", {}
    best = max(methods, key=lambda row: better * float(row.means(textures).mean()))
    others = [row for row in methods if row is not best]
    if len(textures) < 6 or not others:
        return best.name, {}
    differences = [row.means(textures) - best.means(textures) for row in others]
    p = [float(wilcoxon(one).pvalue) if one.any() else 1.0 for one in differences]
    return best.name, dict(zip((row.name for row in others), holm(p), strict=True))


def as_in_paper(rows: Sequence[Row]) -> set[str]:
    """Return the names of the methods that the paper has a figure of.

    A model with several settings is left out: none of them is the paper's. With and without excitation count as one, because
    their one-step figures are the same.
    """
    names = set()
    for model in PAPER:
        with_model = [row for row in rows if row.model == model]
        plain = [row for row in with_model if not row.excited]
        if len(with_model) == 1 or len(plain) == 1:
            names.add((plain or with_model)[0].name)
    return names
