"""Tables of runs: methods beside references and the paper's figures, each on each texture, and what they say in sentences."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import sub, truediv
from typing import Any

import numpy as np

from foten.dsp import Array
from foten.experiments.results import (
    FIGURES,
    PAPER,
    PERSISTENCE,
    WITHOUT,
    Figure,
    Records,
    Row,
    as_in_paper,
    by_recipe,
    chosen,
    compared,
    complete,
    rows_of,
)

CHANGES: tuple[tuple[str, str, Callable[[float, float], float]], ...] = (
    ("validation: one step", "validation.mae_scaled", truediv),
    ("validation: listener", "validation_listener.area", sub),
    ("test: one step", "one_step.mae_scaled", truediv),
    ("test: LSD", "free_run.lsd_db", truediv),
    ("test: level error", "free_run.level_error_db", truediv),
)
"""Of what a method is compared with the one that it stands beside, where that is in a record, and how."""
_NAMED = (
    *("experiment", "note", "method", "recipe", "beside", "model", "texture", "rate_hz", "split"),
    *("excitation", "network_in_loop", "recording_sha256", "split_sha256", "training_s"),
)
FORMATS = ("md", "csv", "tex")
PAPERS = "paper's MAE, unit not stated"
_LATEX = str.maketrans(
    {
        **{character: "\\" + character for character in "&%_#${}"},
        **{"\\": r"\textbackslash{}", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}"},
        **{"±": r"$\pm$", "–": "--", "÷": r"$\div$"},
    }
)


def summary(records: Records) -> list[list[str]]:
    """Return the methods and references with their means over textures, beside the paper's, and the seconds of training.

    `p` is of the one-step errors' differences from the best method's. Means are ± the standard error that the splits of the
    textures give them, where there are several. A column without a cell is left out.
    """
    rows = {figure: {row.name: row for row in rows_of(records, figure)[1]} for figure in FIGURES}
    textures, of_mae = rows_of(records, "mae")
    _, p = compared(of_mae, textures, FIGURES["mae"].better)
    in_paper = as_in_paper(of_mae)
    cells = [["", "MAE [sd]", PAPERS, "p", "GFC [%]", "LSD [dB]", "level error [dB]", "training [s]"]]
    for name in dict.fromkeys(name for by_name in rows.values() for name in by_name):
        mae, gfc, lsd, level = (
            mean_cell(by_name.get(name), textures, FIGURES[figure].digits) for figure, by_name in rows.items()
        )
        own = [one for one in records if one["method"] == name.removesuffix(WITHOUT)]
        reported = f"{PAPER[rows['mae'][name].model].mae:.3f}" if name in in_paper else ""
        seconds = f"{np.mean([one['training_s'] for one in own]):.0f}" if own else ""
        cells.append([name, mae, reported, f"{p[name]:.3f}" if name in p else "", gfc, lsd, level, seconds])
    kept = [k for k in range(len(cells[0])) if k == 0 or any(row[k] for row in cells[1:])]
    return [[row[k] for k in kept] for row in cells]


def mean_cell(row: Row | None, textures: Sequence[str], digits: int) -> str:
    """Return the mean over textures ± its standard error by their splits; a dash where a texture has none."""
    if row is None or not np.isfinite(row.means(textures)).all():
        return "–" if row is not None and row.model else ""
    return with_error([row.values[texture] for texture in textures], digits)


def with_error(by_texture: Sequence[Array], digits: int) -> str:
    """Return the mean over textures of their means over splits, ± its standard error where each has several."""
    mean = f"{np.mean([of.mean() for of in by_texture]):.{digits}f}"
    if min(of.size for of in by_texture) < 2:
        return mean
    error = np.sqrt(sum(of.var(ddof=1) / of.size for of in by_texture)) / len(by_texture)
    return f"{mean} ± {error:.{digits}f}"


def table(records: Records, figure: str) -> list[list[str]]:
    """Return a table of one figure: textures by methods and references, means over splits, and the mean of all."""
    textures, rows = rows_of(records, figure)
    cells = [[FIGURES[figure].name, *(row.name for row in rows)]]
    for texture in textures:
        values = [row.values.get(texture) for row in rows]
        cells.append([texture, *("–" if of is None else with_error([of], 3) for of in values)])
    return [*cells, ["mean", *(mean_cell(row, textures, 3) or "–" for row in rows)]]


def brief(records: Records) -> list[dict[str, Any]]:
    """Return of each run what says which it was, and the figures that methods are compared by."""
    paths = {figure.path for figure in FIGURES.values()} | {path for _, path, _ in CHANGES}
    listening = {key for one in records for key in one if key.startswith(("listener.", "validation_listener."))}
    kept = {*_NAMED, *paths, *listening}
    return [{key: value for key, value in one.items() if key in kept} for one in records]


def ratios(records: Records) -> list[list[str]]:
    """Return the figures of each method that stands beside another, over the other's on the same textures and splits.

    Ratios, of areas under a listener's curve differences; of validation and of test: choose by the former. Means over textures ±
    their standard error; a dash where there is no such figure.
    """
    cells = [["", "beside", "pairs", *(title for title, *_ in CHANGES)]]
    for name, beside in dict.fromkeys((one["method"], one["beside"]) for one in records if one["beside"]):
        others = {(one["texture"], one["split"]): one for one in records if one["method"] == beside}
        own = [one for one in records if one["method"] == name]
        pairs = [(one, others[key]) for one in own if (key := (one["texture"], one["split"])) in others]
        cells.append([name, beside, str(len(pairs)), *(_change(pairs, path, change) for _, path, change in CHANGES)])
    return cells


def _change(
    pairs: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]], path: str, change: Callable[[float, float], float]
) -> str:
    by_texture: dict[str, list[float]] = {}
    for one, other in pairs:
        if one.get(path) is not None and other.get(path):
            by_texture.setdefault(one["texture"], []).append(change(one[path], other[path]))
    if not by_texture:
        return "–"
    values = np.array([np.mean(of) for of in by_texture.values()])
    error = f" ± {values.std(ddof=1) / np.sqrt(values.size):.3f}" if values.size > 1 else ""
    return f"{values.mean():{'+' if change is sub else ''}.3f}{error}"


def caveats(records: Records, name: str = "summary") -> list[str]:
    """Return what a reader of a table has to know: what the experiment reduced, and what a figure is blind to."""
    notes = list(dict.fromkeys(one["note"] for one in records if one.get("note")))
    textures, rows = rows_of(records, "gfc")
    for row in rows:
        if row.name == PERSISTENCE and name in ("summary", "gfc"):
            blind = "The GFC of a one-step prediction is blind to delay and gain"
            notes.append(
                f"{blind}: {PERSISTENCE}, which repeats the last sample, has {row.means(textures).mean():.1f} %."
            )
    return notes


def written(cells: Sequence[Sequence[str]], form: str, title: str = "", notes: Sequence[str] = ()) -> str:
    """Return a table as Markdown, CSV or LaTeX.

    Title and notes stand above it, in LaTeX as comments; a CSV has none.
    """
    if form == "csv":
        out = io.StringIO()
        csv.writer(out, lineterminator="\n").writerows(cells)
        return out.getvalue()
    if form == "md":
        lines = ["| " + " | ".join(cell.replace("|", r"\|") for cell in row) + " |" for row in cells]
        above = "".join(f"{text}\n\n" for text in [*([f"# {title}"] if title else []), *notes])
        return above + "\n".join([lines[0], "|" + "---|" * len(cells[0]), *lines[1:]]) + "\n"
    rows = [" & ".join(cell.translate(_LATEX) for cell in row) + r" \\" for row in cells]
    columns = "l" + "r" * (len(cells[0]) - 1)
    body = "\n".join([rows[0], r"\midrule", *rows[1:]])
    above = "".join(f"% {text}\n" for text in [*([title] if title else []), *notes])
    return f"{above}\\begin{{tabular}}{{{columns}}}\n\\toprule\n{body}\n\\bottomrule\n\\end{{tabular}}\n"


def findings(records: Records) -> Iterator[str]:
    """Yield what to know first, which recipe and which method is best in each figure, beside a linear predictor and the paper.

    Args:
        records: those of all recipes.
    """
    yield from caveats(records)
    yield from _several_versions(records)
    yield from _same_blocks(records)
    for method, errors in by_recipe(records).items():
        (best, lowest), *others = errors.items()
        yield (
            f"{method} is shown by the recipe {best!r}, whose validation error is {lowest:.4f}; "
            f"{', '.join(f'{name!r} has {error:.4f}' for name, error in others)}."
        )
    shown = chosen(records)
    for figure in FIGURES:
        yield from _best_method(shown, figure)
    yield from _order(shown)


def _several_versions(records: Records) -> Iterator[str]:
    versions: dict[str, set[str]] = {}
    for one in records:
        for key, version in one.items():
            if key.startswith("version.") and version:
                versions.setdefault(key.removeprefix("version."), set()).add(version)
    several = [f"{package} {', '.join(sorted(of))}" for package, of in versions.items() if len(of) > 1]
    if several:
        yield f"The results were made with several versions, of {'; '.join(several)}: run them again with one."


def _same_blocks(records: Records) -> Iterator[str]:
    """Yield which splits of a recording have the same test blocks: they differ only by training."""
    seeds: dict[tuple[str, str, str], set[int]] = {}
    for one in records:
        seeds.setdefault((one["texture"], one["recording_sha256"], one["split_sha256"]), set()).add(int(one["split"]))
    for (texture, *_), same in seeds.items():
        numbers = ", ".join(map(str, sorted(same)))
        if len(same) > 1:
            yield f"{texture} is short: splits {numbers} are the same blocks, and differ by training alone."


def _best_method(records: Records, figure: str) -> Iterator[str]:
    judged_by = FIGURES[figure]
    textures, rows = rows_of(records, figure)
    methods = [row for row in rows if row.model]
    without = [row.name for row in methods if not row.values]
    if without:
        yield f"{judged_by.name}: there is none of {', '.join(without)}."
    lacking = [row.name for row in methods if row.values and row not in complete(rows, textures)]
    if lacking:
        yield f"{judged_by.name}: not compared, for want of textures or splits: {', '.join(lacking)}."
    best, p = compared(rows, textures, judged_by.better)
    if best:
        means = {row.name: float(row.means(textures).mean()) for row in complete(rows, textures)}
        chance = ", ".join(other for other, value in p.items() if value >= 0.05)
        differ = (
            f"; the difference may be chance for {chance}" if chance else "; all others differ (p < 0.05)" if p else ""
        )
        is_best = f"is best on the mean of {len(means)} trained methods, with" if len(means) > 1 else "has"
        shown = f"{judged_by.name}: {best} {is_best} {means[best]:.{judged_by.digits}f}{differ}."
        linear = next((row for row in rows if row.name == judged_by.linear), None)
        yield shown + ("" if linear is None else _beside_linear(judged_by, means, float(linear.means(textures).mean())))


def _beside_linear(figure: Figure, means: Mapping[str, float], linear: float) -> str:
    """Say how many of the methods a linear predictor loses to; nothing where it lacks a texture (NaN)."""
    if not np.isfinite(linear):
        return ""
    n, n_better = len(means), sum(figure.better * (mean - linear) > 0 for mean in means.values())
    those = f"{n_better} of {n} trained methods are better"
    if n_better in (0, n):
        every = next(iter(means)) if n == 1 else "every trained method"
        those = f"{every} {'is better' if n_better else 'loses to it'}"
    return f" A linear predictor, {figure.linear}, has {linear:.{figure.digits}f}: {those}."


def _order(records: Records) -> Iterator[str]:
    textures, rows = rows_of(records, "mae")
    known = as_in_paper(rows)
    ours = {row.model: float(row.means(textures).mean()) for row in complete(rows, textures) if row.name in known}
    if len(ours) > 1:
        here, there = sorted(ours, key=ours.__getitem__), sorted(ours, key=lambda model: PAPER[model].mae)
        same = "the same order" if here == there else "another order"
        yield (
            f"By one-step error, best first: {', '.join(here)} here; {', '.join(there)} in the paper, whose regime and unit "
            f"are not stated: {same}."
        )
