"""Findings of runs in sentences: notes, recipes, the best method in each figure, and the paper's order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from foten.experiments.aggregate import PAPER, Row, as_in_paper, compared, complete, rows_of, signed_rank
from foten.experiments.method_tables import caveats
from foten.experiments.results import FIGURES, WITHOUT, Figure, Records, by_recipe, chosen, mixture

OF_BLOCKS = ("references.zero.mae_scaled", "references.ar.mae_scaled")  # the second of the training blocks too
BY_RECIPE = " is shown by the recipe "  # in sentences


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
