"""Tables of runs: methods beside references and the paper's figures, each on each texture, and what they say in sentences."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from operator import sub, truediv
from typing import Any

import numpy as np

from foten.experiments.comparison import (
    FIGURES,
    PAPER,
    PERSISTENCE,
    WITHOUT,
    Figure,
    Record,
    Records,
    Row,
    as_in_paper,
    compared,
    complete,
    rows_of,
)
from foten.experiments.results import by_recipe, chosen, mixture, title_of
from foten.reporting.table import Number, Table, mean_number

CHANGES: tuple[tuple[str, str, Callable[[float, float], float]], ...] = (
    ("validation: one step", "validation.mae_scaled", truediv),
    ("validation: listener", "validation_listener.area", sub),
    ("test: one step", "one_step.mae_scaled", truediv),
    ("test: LSD", "free_run.lsd_db", truediv),
    ("test: level error", "free_run.level_error_db", truediv),
)
"""Of what a method is compared with the one that it stands beside, where that is in a record, and how."""
_NAMES = (
    *("experiment", "note", "method", "recipe", "beside", "model", "texture", "rate_hz", "split"),
    *("excitation", "network_in_loop", "recording_sha256", "split_sha256", "training_s"),
    *("measures", "code", "platform", "sources"),
)
PAPERS = "paper's MAE, unit not stated"


def tables_of(records: Records) -> dict[str, Table]:
    """All tables of runs by the names of their files: of all figures, of each by texture, and of methods beside others."""
    shown, title = chosen(records), title_of(records)
    by_name = {"summary": summary(shown)} | {name: table(shown, name) for name in FIGURES}
    if any(record["beside"] for record in shown):
        by_name["ratios"] = ratios(shown)
    return {name: replace(of, title=title, notes=tuple(caveats(shown, name))) for name, of in by_name.items()}


def summary(records: Records) -> Table:
    """Methods and references with their means over textures, beside the paper's, and the seconds of training.

    `p` is of the one-step errors' differences from the best method's. Means are ± the standard error that the splits of the
    textures give them, where there are several; of several methods the best is bold. A column without a cell is left out.
    """
    rows = {figure: {row.name: row for row in rows_of(records, figure)[1]} for figure in FIGURES}
    textures, of_mae = rows_of(records, "mae")
    best = {name: _best(list(rows[name].values()), textures, figure) for name, figure in FIGURES.items()}
    _, p = compared(of_mae, textures, FIGURES["mae"].better)
    in_paper = as_in_paper(of_mae)
    cells = []
    for name in dict.fromkeys(name for by_name in rows.values() for name in by_name):
        mae, gfc, lsd, level = (
            mean_cell(by_name.get(name), textures, FIGURES[figure].digits, name in best[figure])
            for figure, by_name in rows.items()
        )
        runs = [record for record in records if record["method"] == name.removesuffix(WITHOUT)]
        reported = f"{PAPER[rows['mae'][name].model].mae:.3f}" if name in in_paper else ""
        seconds = f"{np.mean([run['training_s'] for run in runs]):.0f}" if runs else ""
        cells.append((name, mae, reported, f"{p[name]:.3f}" if name in p else "", gfc, lsd, level, seconds))
    heading = ("", "MAE [sd]", PAPERS, "p", "GFC [%]", "LSD [dB]", "level error [dB]", "training [s]")
    return Table.of(heading, cells).without_empty_columns()


def _best(rows: Sequence[Row], textures: Sequence[str], figure: Figure) -> set[str]:
    """Methods that are best of several on the mean of the textures, as it is rounded; nothing of a single one."""
    means = {row.name: round(float(row.means(textures).mean()), figure.digits) for row in complete(rows, textures)}
    best = max((figure.better * mean for mean in means.values()), default=0.0)
    return {name for name, mean in means.items() if figure.better * mean == best} if len(means) > 1 else set()


def mean_cell(row: Row | None, textures: Sequence[str], digits: int, best: bool = False) -> Number | str:
    """Mean over textures ± its standard error by their splits; a dash where a texture has none."""
    if row is None or not np.isfinite(row.means(textures)).all():
        return Number(None) if row is not None and row.model else ""
    return mean_number([row.values[texture] for texture in textures], digits, best)


def table(records: Records, figure: str) -> Table:
    """A figure's table: textures by methods and references, means over splits, and the mean of all."""
    textures, rows = rows_of(records, figure)
    best = _best(rows, textures, FIGURES[figure])
    heading = [FIGURES[figure].name, *(row.name for row in rows)]
    cells: list[list[Number | str]] = []
    for texture in textures:
        splits = ([row.values[texture]] if texture in row.values else [] for row in rows)
        cells.append([texture, *(mean_number(groups, 3) for groups in splits)])
    means = (mean_cell(row, textures, 3, row.name in best) or Number(None) for row in rows)
    return Table.of(heading, [*cells, ["mean", *means]])


def brief(records: Records) -> list[dict[str, Any]]:
    """Of each run its names, and the figures that methods are compared by."""
    paths = {figure.path for figure in FIGURES.values()} | {path for _, path, _ in CHANGES}
    listening = {key for record in records for key in record if key.startswith(("listener.", "validation_listener."))}
    keys = {*_NAMES, *paths, *listening}
    return [{key: value for key, value in record.items() if key in keys} for record in records]


def ratios(records: Records) -> Table:
    """Figures of each method that stands beside another, over the other's on the same textures and splits.

    Ratios, of areas under a listener's curve differences; of validation and of test: choose by the former. Means over textures ±
    their standard error; a dash where there is no such figure.
    """
    rows = []
    for name, beside in dict.fromkeys((record["method"], record["beside"]) for record in records if record["beside"]):
        others = {(record["texture"], record["split"]): record for record in records if record["method"] == beside}
        runs = [record for record in records if record["method"] == name]
        pairs = [(run, others[key]) for run in runs if (key := (run["texture"], run["split"])) in others]
        changes = (_change(pairs, path, change) for _, path, change in CHANGES)
        rows.append((name, beside, str(len(pairs)), *changes))
    return Table.of(("", "beside", "pairs", *(title for title, *_ in CHANGES)), rows)


def _change(pairs: Sequence[tuple[Record, Record]], path: str, change: Callable[[float, float], float]) -> Number:
    by_texture: dict[str, list[float]] = {}
    for run, other in pairs:
        if run.get(path) is not None and other.get(path):
            by_texture.setdefault(run["texture"], []).append(change(run[path], other[path]))
    if not by_texture:
        return Number(None)
    values = np.array([np.mean(splits) for splits in by_texture.values()])
    error = float(values.std(ddof=1) / np.sqrt(values.size)) if values.size > 1 else None
    return Number(float(values.mean()), "+.3f" if change is sub else ".3f", error)


def caveats(records: Records, name: str = "summary") -> list[str]:
    """What a reader of a table has to know: what the experiment reduced, and what a figure is blind to."""
    notes = list(dict.fromkeys(record["note"] for record in records if record.get("note")))
    textures, rows = rows_of(records, "gfc")
    for row in rows:
        if row.name == PERSISTENCE and name in ("summary", "gfc"):
            blind = "The GFC of a one-step prediction is blind to delay and gain"
            notes.append(
                f"{blind}: {PERSISTENCE}, which repeats the last sample, has {row.means(textures).mean():.1f} %."
            )
    return notes


def findings(records: Records) -> Iterator[str]:
    """Yield what to know first, which recipe and which method is best in each figure, beside a linear predictor and the paper.

    Args:
        records: those of all recipes.
    """
    yield from caveats(records)
    if differing := mixture(records):
        yield f"The results are mixed: {differing}."
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


def _same_blocks(records: Records) -> Iterator[str]:
    """Yield which splits of a recording have the same test blocks: they differ only by training."""
    seeds: dict[tuple[str, str, str], set[int]] = {}
    for record in records:
        blocks = record["texture"], record["recording_sha256"], record["split_sha256"]
        seeds.setdefault(blocks, set()).add(int(record["split"]))
    for (texture, *_), same in seeds.items():
        numbers = ", ".join(map(str, sorted(same)))
        if len(same) > 1:
            yield f"{texture} is short: splits {numbers} are the same blocks, and differ by training alone."


def _best_method(records: Records, name: str) -> Iterator[str]:
    figure = FIGURES[name]
    textures, rows = rows_of(records, name)
    methods = [row for row in rows if row.model]
    without = [row.name for row in methods if not row.values]
    if without:
        yield f"{figure.name}: there is none of {', '.join(without)}."
    lacking = [row.name for row in methods if row.values and row not in complete(rows, textures)]
    if lacking:
        yield f"{figure.name}: not compared, for want of textures or splits: {', '.join(lacking)}."
    best, p = compared(rows, textures, figure.better)
    if best:
        means = {row.name: float(row.means(textures).mean()) for row in complete(rows, textures)}
        chance = ", ".join(other for other, value in p.items() if value >= 0.05)
        differ = (
            f"; the difference may be chance for {chance}" if chance else "; all others differ (p < 0.05)" if p else ""
        )
        is_best = f"is best on the mean of {len(means)} trained methods, with" if len(means) > 1 else "has"
        shown = f"{figure.name}: {best} {is_best} {means[best]:.{figure.digits}f}{differ}."
        linear = next((row for row in rows if row.name == figure.linear), None)
        yield shown + ("" if linear is None else _beside_linear(figure, means, float(linear.means(textures).mean())))


def _beside_linear(figure: Figure, means: Mapping[str, float], linear: float) -> str:
    """How many of the methods a linear predictor loses to; nothing where it lacks a texture (NaN)."""
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
