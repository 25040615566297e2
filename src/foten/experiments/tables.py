"""Result files to tables: methods by textures, beside the references and the paper's own figures, none typed by hand."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.experiments.experiment import Run
from foten.experiments.paper import PAPER

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Figure:
    """A number in the result files.

    Attributes:
        name: in headings, with its unit.
        path: where it lies in `evaluation`.
        reported: the attribute of `paper.Reported` that it stands beside, and how many digits of that are printed; None for none.
        better: 1 where more is better, −1 where less is.
    """

    name: str
    path: str
    reported: tuple[str, int] | None
    better: int


FIGURES = {
    "mae": Figure("one-step MAE [sd]", "one_step.mae_scaled", ("mae", 3), -1),
    "gfc": Figure("one-step GFC [%]", "one_step.gfc", ("gfc", 2), 1),
    "lsd": Figure("free-run log-spectral distance [dB]", "free_run.lsd_db", None, -1),
    "level": Figure("free-run level error [dB]", "free_run.level_error_db", None, -1),
}
PERCENT = {"gfc"}
REFERENCES = {
    "zero": "references.zero",
    "persistence": "references.persistence",
    "AR(20)": "references.ar",
    "AR(20) by speed and force": "references.ar_scheduled",
    "best AR": "references.ar_best",
    "least possible": "references.bound",
}
FREE_RUN_REFERENCES = {"AR(20) with white noise": "free_run_ar", "ceiling": "ceiling"}
FORMATS = ("md", "csv", "tex")
BAR = r"\|"  # Markdown's, within a cell
_OF_A_RESULT = {
    "evaluation",
    "foten",
    "versions",
    "recording_sha256",
    "seconds",
    "signals",
    "n_epochs",
    "validation_mae_scaled",
}
_OF_AN_EVALUATION = {"one_step", "free_run", "references", "ceiling", "n_blocks", "split_sha256", "rate_hz"}


@dataclass(frozen=True)
class Row:
    """One method or reference over textures.

    Attributes:
        name: of it.
        model: key, "" for a reference.
        values: by texture, one for each split, NaN where there is none.
        intervals: by texture, 95 % over test blocks, of its first split.
        excited: whether it was given the excitation of `foten-plus`, which no one-step figure depends on.
    """

    name: str
    model: str
    values: Mapping[str, Array]
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    excited: bool = False

    def means(self, textures: Sequence[str]) -> Array:
        """Return the mean over splits for each texture, NaN where there is none."""
        return np.array(
            [self.values[t].mean() if len(self.values.get(t, ())) else math.nan for t in textures]
        )


def read_results(folder: Path) -> list[dict[str, Any]]:
    """Return the results in a folder, in the order of their experiment.

    Raises:
        ValueError: there is none, a file is no result, two are of one method on one texture and split, or two recordings have
            one name.
    """
    found: list[dict[str, Any]] = []
    seen: dict[tuple[str, str, int], str] = {}
    digests: dict[str, str] = {}
    for path in sorted(folder.glob("*.json")):
        result, run = _read(path)
        cell = (run.label, name_of(run.texture), run.split_seed)
        if cell in seen:
            raise ValueError(
                f"{seen[cell]} and {path.name} are both of {cell[0]} on {cell[1]}, split {cell[2]}: are results of other "
                "settings or of an earlier version left in the folder? Move one away"
            )
        seen[cell] = path.name
        recorded = run.seconds is None
        if recorded and digests.setdefault(cell[1], result["recording_sha256"]) != result["recording_sha256"]:
            raise ValueError(f"two recordings are called {cell[1]}, which a table cannot tell apart")
        found.append(result)
    if not found:
        raise ValueError(f"there is no result of foten sweep in {folder}")
    return sorted(found, key=lambda result: result.get("index", 0))


def is_whole(result: Any) -> bool:
    """Return whether JSON is a result with all that tables and figures are made of."""
    return (
        isinstance(result, dict)
        and set(result) >= _OF_A_RESULT
        and isinstance(result["evaluation"], dict)
        and set(result["evaluation"]) >= _OF_AN_EVALUATION
    )


def _read(path: Path) -> tuple[dict[str, Any], Run]:
    try:
        result = json.loads(path.read_bytes())
        run = Run(**result["run"])
        whole = isinstance(run.texture, str) and is_whole(result)
    except (ValueError, KeyError, TypeError, OSError):
        whole = False
    if not whole:
        raise ValueError(f"{path.name} is no result of foten sweep, or damaged")
    return result, run


def label_of(result: Mapping[str, Any]) -> str:
    """Return what the row of a result is called."""
    return Run(**result["run"]).label


def name_of(texture: str) -> str:
    """Return what a texture is called, wherever its recording lies."""
    return Path(texture).stem


def rows_of(results: Sequence[Mapping[str, Any]], figure: str) -> tuple[list[str], list[Row]]:
    """Return the textures, and a row for each reference and each method, references first."""
    textures = list(dict.fromkeys(name_of(one["run"]["texture"]) for one in results))
    methods = {label_of(one): one["run"]["model"] for one in results}
    head, _, key = FIGURES[figure].path.rpartition(".")
    factor = 100.0 if figure in PERCENT else 1.0

    def row(name: str, model: str, where: str, of: Sequence[Mapping[str, Any]], excited: bool = False) -> Row:
        by_texture: dict[str, list[float]] = {}
        intervals: dict[str, tuple[float, float]] = {}
        for one in of:
            texture = name_of(one["run"]["texture"])
            value = _at(one["evaluation"], f"{where}.{key}")
            interval = _at(one["evaluation"], f"{where}.intervals.{key}")
            if value is not None:
                by_texture.setdefault(texture, []).append(factor * value)
            if interval is not None:
                intervals.setdefault(texture, (factor * interval[0], factor * interval[1]))
        values = {texture: np.array(found) for texture, found in by_texture.items()}
        return Row(name, model, values, intervals, excited)

    # A reference is the same whatever was trained beside it: once for each recording, split and preprocessing.
    distinct = {
        (one["recording_sha256"], one["run"]["split_seed"], json.dumps(one["run"]["preprocess"])): one
        for one in results
    }
    references = FREE_RUN_REFERENCES if head == "free_run" else REFERENCES
    rows = [row(name, "", where, list(distinct.values())) for name, where in references.items()]
    for name, model in methods.items():
        of_method = [one for one in results if label_of(one) == name]
        found = row(name, model, head, of_method, of_method[0]["run"]["sizes"].get("excitation", False))
        if not found.values and head == "free_run":
            found = row(f"{name}, without excitation", model, "free_run_deterministic", of_method)
        rows.append(found)
    return textures, [one for one in rows if one.values or one.model]


def _at(document: Mapping[str, Any], path: str) -> Any:
    """Return what lies at a path of keys, None where nothing does."""
    found: Any = document
    for key in path.split("."):
        found = found.get(key) if isinstance(found, Mapping) else None
    return found


def holm(p: Sequence[float]) -> list[float]:
    """Return p-values corrected for that several were asked for, after Holm (1979), in the order given."""
    order = np.argsort(p, kind="stable")
    corrected, worst = [0.0] * len(p), 0.0
    for rank, i in enumerate(order):
        worst = max(worst, min(1.0, (len(p) - rank) * p[i]))
        corrected[i] = worst
    return corrected


def complete(rows: Sequence[Row], textures: Sequence[str]) -> list[Row]:
    """Return the methods that have as many splits of each texture as any has."""
    methods = [row for row in rows if row.model]
    most = {texture: max(len(row.values.get(texture, ())) for row in methods) for texture in textures}
    return [row for row in methods if all(len(row.values.get(t, ())) == most[t] > 0 for t in textures)]


def compared(rows: Sequence[Row], textures: Sequence[str], better: int) -> tuple[str, dict[str, float]]:
    """Return the best method on the mean of the textures, and for each other one how likely it is to differ by chance.

    Methods that have not every split of every texture are left out: another split of a simulated texture is another recording.
    Wilcoxon's signed-rank test over the textures (means of splits), two-sided, Holm-corrected; empty with fewer than six
    textures, of which no p below 0.05 can come.
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


def table(results: Sequence[Mapping[str, Any]], figure: str) -> list[list[str]]:
    """Return a table of one figure: its heading, then a row for each reference and method."""
    of = FIGURES[figure]
    textures, rows = rows_of(results, figure)
    _, p = compared(rows, textures, of.better)
    n_splits = max((len(values) for row in rows for values in row.values.values()), default=1)
    within = any(row.intervals for row in rows)
    spread = f"mean ± sd of {n_splits} splits" if n_splits > 1 else "one split"
    spread += " [95 % over its blocks]" if n_splits == 1 and within else ""
    once = _once(rows)
    reported = of.reported is not None and bool(once)
    heading = [f"{of.name}, {spread}", *textures, "mean"]
    heading += ["p"] if p else []
    heading += ["paper's mean"] if reported else []
    cells = [heading]
    for row in rows:
        means = row.means(textures)
        whole = f"{means.mean():.3f}" if np.isfinite(means).all() else "–"
        line = [row.name, *(_cell(row, texture, n_splits) for texture in textures), whole]
        if p:
            line.append(f"{p[row.name]:.3f}" if row.name in p else "")
        if reported and of.reported is not None:
            attribute, digits = of.reported
            value = getattr(PAPER[row.model], attribute) if row.name in once else None
            line.append("" if value is None else f"{value:.{digits}f}")
        cells.append(line)
    return cells


def _once(rows: Sequence[Row]) -> set[str]:
    """Return the methods that the paper has a figure of: of several settings of a model none is the paper's.

    With and without excitation count as one, as one step ahead they are the same.
    """
    found = set()
    for model in PAPER:
        of = [row.name for row in rows if row.model == model]
        plain = [row.name for row in rows if row.model == model and not row.excited]
        if len(of) == 1 or len(plain) == 1:
            found.add((plain or of)[0])
    return found


def _cell(row: Row, texture: str, n_splits: int) -> str:
    values, interval = row.values.get(texture), row.intervals.get(texture)
    if values is None or not len(values):
        return "–"
    if n_splits == 1 and interval is not None:
        return f"{values[0]:.3f} [{interval[0]:.3f}, {interval[1]:.3f}]"
    fewer = f" ({len(values)} of {n_splits})" if len(values) < n_splits else ""
    if len(values) == 1:
        return f"{values[0]:.3f}{fewer}"
    return f"{values.mean():.3f} ± {values.std(ddof=1):.3f}{fewer}"


def each_run(results: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Return a row for each run, for a statistics program: a column a number, with its 95 % interval over test blocks.

    Intervals are left empty where fewer than four blocks were judged. The free run is the one without excitation, and says so, of
    what carries none.
    """
    heading = ["method", "model", "texture", "split", "test_blocks", "excitation"]
    heading += [f"{name}{end}" for name in FIGURES for end in ("", "_low", "_high")]
    heading += ["validation_mae", "epochs", "training_s", "evaluation_s"]
    rows = [heading]
    for one in results:
        run, judged = one["run"], one["evaluation"]
        excited = judged["free_run"]["lsd_db"] is not None
        row = [label_of(one), run["model"], name_of(run["texture"]), run["split_seed"], judged["n_blocks"]]
        silent = judged["free_run_deterministic"]["lsd_db"] is None
        row.append("yes" if excited else None if silent else "no")
        for name, figure in FIGURES.items():
            head, _, key = figure.path.rpartition(".")
            of = judged[head if excited or head != "free_run" else "free_run_deterministic"]
            interval = (of.get("intervals") or {}).get(key) or (None, None)
            factor = 100.0 if name in PERCENT else 1.0
            row += [None if value is None else factor * value for value in (of[key], *interval)]
        row += [
            one["validation_mae_scaled"],
            one["n_epochs"],
            *(one["seconds"][k] for k in ("training", "evaluation")),
        ]
        rows.append(
            ["" if value is None else f"{value:.6g}" if type(value) is float else str(value) for value in row]
        )
    return rows


def written(cells: Sequence[Sequence[str]], form: str) -> str:
    """Return a table as Markdown, CSV or LaTeX."""
    if form == "csv":
        out = io.StringIO()
        csv.writer(out, lineterminator="\n").writerows(cells)
        return out.getvalue()
    if form == "md":
        lines = [f"| {' | '.join(cell.replace('|', BAR) for cell in row)} |" for row in cells]
        return "\n".join([lines[0], "|" + "---|" * len(cells[0]), *lines[1:]]) + "\n"
    rows = [" & ".join(_escaped(cell) for cell in row) + r" \\" for row in cells]
    columns = "l" + "r" * (len(cells[0]) - 1)
    body = "\n".join([rows[0], r"\midrule", *rows[1:]])
    return f"\\begin{{tabular}}{{{columns}}}\n\\toprule\n{body}\n\\bottomrule\n\\end{{tabular}}\n"


_LATEX = {
    **{character: "\\" + character for character in "&%_#${}"},
    "\\": r"\textbackslash{}",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "±": r"$\pm$",
    "–": "--",
    "÷": r"$\div$",
}


def _escaped(cell: str) -> str:
    return "".join(_LATEX.get(character, character) for character in cell)


def _experiments(results: Sequence[Mapping[str, Any]]) -> list[dict[str, str]]:
    """Return titles and notes of the experiments that the results are of."""
    found = {json.dumps(one.get("experiment", {"title": "", "note": ""}), sort_keys=True) for one in results}
    return [json.loads(one) for one in sorted(found)]


def title_of(results: Sequence[Mapping[str, Any]]) -> str:
    """Return what the results are of."""
    return "; ".join(about["title"] for about in _experiments(results) if about["title"])


def _alike(results: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Say which splits of a recording are the same blocks: their spread is of training alone."""
    seeds: dict[tuple[str, str, str], set[int]] = {}
    for one in results:
        key = (name_of(one["run"]["texture"]), one["recording_sha256"], one["evaluation"]["split_sha256"])
        seeds.setdefault(key, set()).add(one["run"]["split_seed"])
    for (texture, _, _), same in seeds.items():
        if len(same) > 1:
            numbers = ", ".join(map(str, sorted(same)))
            yield f"{texture} is short: splits {numbers} are the same blocks, and differ by training alone."


def findings(results: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Say what was reduced, which method is best in each figure, and whether the paper's order is found."""
    yield from dict.fromkeys(about["note"] for about in _experiments(results) if about["note"])
    versions: dict[str, set[str]] = {}
    for one in results:
        for package, version in {"foten": one["foten"], **one["versions"]}.items():
            versions.setdefault(package, set()).add(version)
    several = [
        f"{package} {', '.join(sorted(found))}" for package, found in versions.items() if len(found) > 1
    ]
    if several:
        yield f"The results were made with several versions, of {'; '.join(several)}: run them again with one."
    yield from _alike(results)
    for name, of in FIGURES.items():
        textures, rows = rows_of(results, name)
        methods = [row for row in rows if row.model]
        without = [row.name for row in methods if not row.values]
        if without:
            yield f"{of.name}: there is none of {', '.join(without)}."
        lacking = [row.name for row in methods if row.values and row not in complete(rows, textures)]
        if lacking:
            yield f"{of.name}: not compared, for want of textures or splits: {', '.join(lacking)}."
        best, p = compared(rows, textures, of.better)
        if not best:
            continue
        chance = [other for other, value in p.items() if value >= 0.05]
        said = f"{of.name}: {best} is best on the mean"
        if p:
            said += (
                f"; the difference may be chance for {', '.join(chance)}"
                if chance
                else "; all others differ (p < 0.05)"
            )
        yield said + "."
    textures, rows = rows_of(results, "mae")
    once = _once(rows)
    ours = {
        row.model: float(row.means(textures).mean()) for row in complete(rows, textures) if row.name in once
    }
    known = {model: PAPER[model].mae for model in ours}
    if len(ours) > 1 and all(math.isfinite(value) for value in ours.values()):
        here = sorted(ours, key=lambda model: ours[model])
        there = sorted(known, key=lambda model: known[model] or math.inf)
        same = "the same order" if here == there else "another order"
        yield (
            f"By one-step error, best first: {', '.join(here)} here; {', '.join(there)} in the paper, whose regime and unit "
            f"are not stated: {same}."
        )
