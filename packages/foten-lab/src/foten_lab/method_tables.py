"""Tables of runs: methods beside references and the paper's figures, and the same in sentences."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from operator import sub, truediv
from typing import Any

import numpy as np

from foten.evaluate.warm_start import SILENT_DB
from foten.reporting.table import Number, Table, mean_number
from foten_lab.aggregate import (
    FREE_RUN_REFERENCES,
    PAPER,
    REFERENCES,
    Row,
    as_in_paper,
    by_place,
    by_texture,
    compared,
    complete,
    over_textures,
    paired,
    rows_of,
    signed_rank,
)
from foten_lab.results import FIGURES, VALIDATION, WITHOUT, Figure, Records, by_recipe, chosen, mixture, title_of

CHANGES: tuple[tuple[str, str, Callable[[float, float], float], str], ...] = (
    ("validation: one step", "validation.mae_scaled", truediv, ".3f"),
    ("validation: listener", "validation_listener.area", sub, "+.3f"),
    ("test: one step", "one_step.mae_scaled", truediv, ".3f"),
    ("test: LSD", "free_run.lsd_db", truediv, ".3f"),
    ("test: level error", "free_run.level_error_db", truediv, ".3f"),
)
"""Figures in which a method is compared with the one that it stands beside: name, path in a record, comparison, format."""
OF_BLOCKS = ("references.zero.mae_scaled", "references.ar.mae_scaled")  # the second of the training blocks too
BY_RECIPE = " is shown by the recipe "  # in sentences
PAPERS = "paper's MAE, unit not stated"


def tables_of(records: Records) -> dict[str, Table]:
    """Tables of runs by the names of their files: `summary`, one of each figure by texture, `warm-start` and `ratios`."""
    shown, title = chosen(records), title_of(records)
    by_name = {"summary": summary(shown)} | {name: table(shown, name) for name in FIGURES}
    if any("warm_start.stored.mae_scaled" in record for record in shown):
        by_name["warm-start"] = warm_start(shown)
    if any(record["beside"] for record in shown):
        by_name["ratios"] = ratios(shown)
    return {name: replace(of, title=title, notes=tuple(caveats(shown, name))) for name, of in by_name.items()}


def summary(records: Records) -> Table:
    """Methods and references with their means over textures ± standard error, beside the paper's, and the seconds of training.

    `p` is of the one-step errors' differences from the best method's. A column without a cell is left out.
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
        reported = f"{PAPER[rows['mae'][name].model]:.3f}" if name in in_paper else ""
        seconds = f"{np.mean([run['training_s'] for run in runs]):.0f}" if runs else ""
        cells.append((name, mae, reported, f"{p[name]:.3f}" if name in p else "", gfc, lsd, level, seconds))
    heading = ("", "MAE [sd]", PAPERS, "p", "GFC [%]", "LSD [dB]", "level error [dB]", "training [s]")
    return Table.of(heading, cells).known()


WARM_START = (
    ("one-step MAE [sd]", "one_step.mae_scaled", 3, 1.0),
    ("free run", "warm_start.stored.mae_scaled", 3, 1.0),
    ("from a synthesised window", "warm_start.synthesised.mae_scaled", 3, 1.0),
    ("one-step GFC [%]", "one_step.gfc", 1, 100.0),
    ("free run's", "warm_start.stored.gfc", 1, 100.0),
    ("level [dB]", "warm_start.stored.level_db", 1, 1.0),
)
"""Columns of the paper's two errors in both regimes: heading, path in a record, digits, factor."""


def warm_start(records: Records) -> Table:
    """MAE and GFC of one step beside those of a free run from the warm start, of silence and of the ceiling; Sec. VI-a.

    Means over textures ± standard error; of a free run whole blocks are scored. `start forgotten`: the median time until runs
    from two windows are the same, of those runs where that is ever so, and in how many it is; not of a silent run.
    """
    textures = {record["texture"] for record in records}

    def cell(runs: Records, path: str, digits: int, factor: float) -> Number:
        values = by_texture(runs, path, factor=factor)
        return mean_number([*values.values()], digits) if len(values) == len(textures) else Number(None)

    rows: list[list[Number | str]] = []
    for method in dict.fromkeys(record["method"] for record in records):
        runs = [record for record in records if record["method"] == method]
        heard = [run for run in runs if (run.get("warm_start.stored.level_db") or 0.0) >= SILENT_DB]
        times = [run["warm_start.forgotten_ms"] for run in heard if run.get("warm_start.forgotten_ms") is not None]
        forgotten = f"{np.median(times):.0f}, {len(times)} of {len(runs)}" if times else "never" if heard else "silent"
        if not any(run.get("warm_start.synthesised.mae_scaled") for run in runs):
            forgotten = "–"
        rows.append([method, *(cell(runs, *column[1:]) for column in WARM_START), forgotten])
    # The same whatever was trained beside them: once for each recording and split.
    once = list({(record["texture"], record["split"]): record for record in records}.values())
    none, one = Number(None), ("references.zero.mae_scaled", 3, 1.0)
    silence = cell(once, "warm_start.silence_mae_scaled", 3, 1.0)
    rows.append(["silence", cell(once, *one), silence, silence, none, none, none, ""])
    mae, gfc, level = (
        cell(once, f"warm_start.ceiling.{name}", digits, factor)
        for name, digits, factor in (("mae_scaled", 3, 1.0), ("gfc", 1, 100.0), ("level_db", 1, 1.0))
    )
    rows.append(["ceiling", none, mae, none, none, gfc, level, ""])
    return Table.of(("", *(heading for heading, *_ in WARM_START), "start forgotten [ms]"), rows)


def _best(rows: Sequence[Row], textures: Sequence[str], figure: Figure) -> set[str]:
    """Methods of several that are best on the rounded mean of the textures."""
    means = {row.name: round(float(row.means(textures).mean()), figure.digits) for row in complete(rows, textures)}
    best = max((figure.better * mean for mean in means.values()), default=0.0)
    return {name for name, mean in means.items() if figure.better * mean == best} if len(means) > 1 else set()


def mean_cell(row: Row | None, textures: Sequence[str], digits: int, best: bool = False) -> Number | str:
    """Mean over textures ± its standard error; a dash where a texture has none."""
    if row is None or not np.isfinite(row.means(textures)).all():
        return Number(None) if row is not None and row.model else ""
    return mean_number([row.values[texture] for texture in textures], digits, best)


def table(records: Records, figure: str) -> Table:
    """Table of a figure: textures by methods and references, means over splits, and the mean of all."""
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
    """Records with their names and the figures that methods and references are compared by."""
    paths = {figure.path for figure in FIGURES.values()} | {path for _, path, *_ in CHANGES} | set(VALIDATION)
    paths |= {"one_step.mae_m_s2", "references.bound.mae_m_s2"}  # in which loud textures weigh more
    places = {*REFERENCES.values(), *FREE_RUN_REFERENCES.values(), "free_run_deterministic"}
    paths |= {f"{place}.{figure.path.rpartition('.')[2]}" for place in places for figure in FIGURES.values()}
    paths |= {f"{place}.lsd_long_db" for place in ("free_run", *FREE_RUN_REFERENCES.values())}  # of all blocks together
    heads = ("listener.", "warm_start.", "stability.", "onset.")
    keys = paths | {key for record in records for key in record if key.startswith(heads)}
    return [{key: value for key, value in record.items() if "." not in key or key in keys} for record in records]


def ratios(records: Records) -> Table:
    """Figures of each method that stands beside another, over the other's on the same textures and splits.

    Ratios, of areas under a listener's curve differences; means over textures ± their standard error.
    """
    rows, methods = [], by_place(records)
    for name, beside in dict.fromkeys((record["method"], record["beside"]) for record in records if record["beside"]):
        runs, others = methods[name], methods.get(beside, {})
        pairs = (paired(runs, others, path, change) for _, path, change, _ in CHANGES)
        cells = (over_textures(p, "ratio", spec=spec) for p, (*_, spec) in zip(pairs, CHANGES, strict=True))
        rows.append((name, beside, str(len(runs.keys() & others.keys())), *cells))
    return Table.of(("", "beside", "pairs", *(title for title, *_ in CHANGES)), rows)


def caveats(records: Records, name: str = "summary") -> list[str]:
    """Notes of a table: what the experiment reduced, and what a figure is blind to."""
    notes = list(dict.fromkeys(record["note"] for record in records if record.get("note")))
    if name == "warm-start":
        notes.append("The GFC is blind to gain: a run that dies away may have that of a true vibration.")
    if name in ("summary", "gfc"):
        repeated = [gfc for record in records if (gfc := record.get("references.persistence.gfc")) is not None]
        shown = f": repeating the last sample has {100 * np.mean(repeated):.2f} %" if repeated else ""
        notes.append(f"The GFC of a one-step prediction is blind to delay and gain{shown}.")
    return notes


def findings(records: Records) -> Iterator[str]:
    """Yield sentences on runs of all recipes: notes, recipes, and the best method in each figure."""
    yield from caveats(records)
    if differing := mixture(records):
        yield f"The results are mixed: {differing}."
    yield from same_blocks(records)
    for method, errors in by_recipe(records).items():
        (best, lowest), *others = errors.items()
        if lowest == others[-1][1]:  # of a method without settings to choose
            continue
        yield (
            f"{method}{BY_RECIPE}{best!r}, whose validation error is {lowest:.4f}; "
            f"{', '.join(f'{name!r} has {error:.4f}' for name, error in others)}."
        )
    shown = chosen(records)
    for figure in FIGURES:
        yield from _best_method(shown, figure)
    yield from _order(shown)


def same_blocks(records: Records) -> Iterator[str]:
    """Yield a sentence for each recording of which splits are the same blocks: silence and a fitted AR have the same errors."""
    seeds: dict[tuple[str, str, str], set[int]] = {}
    for record in records:
        blocks = record["texture"], record["recording_sha256"], *(record.get(path) for path in OF_BLOCKS)
        if None in blocks:
            continue
        seeds.setdefault(blocks, set()).add(int(record["split"]))
    for (texture, *_), same in seeds.items():
        numbers = ", ".join(map(str, sorted(same)))
        if len(same) > 1:
            yield f"{texture} is short: splits {numbers} are the same blocks, and differ by training alone."


def _best_method(records: Records, name: str) -> Iterator[str]:
    figure = FIGURES[name]
    textures, rows = rows_of(records, name)
    with_all = complete(rows, textures)
    lacking = [row.name for row in rows if row.model and row.values and row not in with_all]
    if none := [row.name for row in rows if row.model and not row.values]:
        yield f"{figure.name}: there is none of {', '.join(none)}."
    if lacking:
        yield f"{figure.name}: not compared, for want of textures or splits: {', '.join(lacking)}."
    if not with_all:
        return
    first: dict[tuple[float, ...], Row] = {}  # of equal figures: an excitation changes no one-step prediction
    for row in with_all:
        first.setdefault(tuple(row.means(textures)), row)
    distinct = [*first.values()]
    best, p = compared(distinct, textures, figure.better)
    mean = next(float(row.means(textures).mean()) for row in distinct if row.name == best)
    chance = ", ".join(other.removesuffix(WITHOUT) for other, value in p.items() if value >= 0.05)
    differ = f"; the difference may be chance for {chance}" if chance else ""
    differ = "; all others differ (p < 0.05)" if p and not chance else differ
    is_best = f"is best on the mean of {len(distinct)} trained methods, with" if len(distinct) > 1 else "has"
    beside = _beside_linear(rows, distinct, textures, figure)
    yield f"{figure.name}: {best} {is_best} {mean:.{figure.digits}f}{differ}.{beside}"


def _beside_linear(rows: Sequence[Row], methods: Sequence[Row], textures: Sequence[str], figure: Figure) -> str:
    """Which methods are better than the linear predictor, and of which that may be chance."""
    linear = next((row for row in rows if row.name == figure.linear), None)
    if linear is None or not np.isfinite(linear.means(textures)).all():
        return ""
    better = [
        row for row in methods if figure.better * float((row.means(textures) - linear.means(textures)).mean()) > 0
    ]
    sentence = f" A linear predictor, {figure.linear}, has {float(linear.means(textures).mean()):.{figure.digits}f}: better are "
    sentence += ", ".join(row.name.removesuffix(WITHOUT) for row in better) or "none"
    p = signed_rank(linear, methods, textures)
    if better and not p:
        return f"{sentence}; the textures are too few to say that it is no chance."
    chance = [row.name.removesuffix(WITHOUT) for row in better if p[row.name] >= 0.05]
    return sentence + (f"; that may be chance for {', '.join(chance)}." if chance else ".")


def _order(records: Records) -> Iterator[str]:
    textures, rows = rows_of(records, "mae")
    known = as_in_paper(rows)
    shown = {row.model: row for row in complete(rows, textures) if row.name in known}
    if len(shown) > 1:
        here = [row.name for row in sorted(shown.values(), key=lambda row: float(row.means(textures).mean()))]
        there = [shown[model].name for model in sorted(shown, key=PAPER.__getitem__)]
        same = "the same order" if here == there else "another order"
        yield (
            f"By one-step error, best first: {', '.join(here)} here; {', '.join(there)} in the paper, whose regime and unit "
            f"are not stated: {same}.".replace(WITHOUT, "")
        )
