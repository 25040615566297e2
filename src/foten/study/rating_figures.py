"""Figures of a study's ratings: Fig. 9, and a panel for each texture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from foten.study.analysis import Result, stars

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#2b83cf", "#e08a1e", "#1a9c72", "#b77ab0", "#8a6d1a", "#d0527a", "#4fb3bf", "#7a7f87")
INK = "#333a42"
STEP = 4.5  # points between brackets


def bars(result: Result) -> Figure:
    """Fig. 9: bars of the mean with SD for each texture and method, and brackets with stars where Holm's p is below .05,
    between the method of the highest mean, or the reference, and each other method.
    """
    textures, methods = result.ratings.textures, result.ratings.methods
    many = len(textures) > 6
    figure, axes = _new(max(7.0, 1.15 * len(textures) + 1.5), 5.2)
    width = 0.8 / len(methods)
    best = _compared(result)
    top = 100.0
    for m, method in enumerate(methods):
        values = result.ratings.values[:, m]
        mean, sd = np.nanmean(values, 0), np.nanstd(values, 0, ddof=1)
        x = np.arange(len(textures)) + (m - (len(methods) - 1) / 2) * width
        axes.bar(x, mean, 0.92 * width, color=COLOURS[m % len(COLOURS)], label=method)
        axes.errorbar(x, mean, sd, fmt="none", ecolor=INK, elinewidth=0.9, capsize=2)
    for t, texture in enumerate(textures):
        values = result.ratings.values[:, :, t]
        height = float(np.nanmax(np.nanmean(values, 0) + np.nanstd(values, 0, ddof=1))) + 2
        for test in result.document["pairs_within_textures"][texture]:
            i, j = (methods.index(name) for name in test["pair"])
            mark = stars(test["p_holm"])
            if best not in (i, j) or not mark:
                continue
            ends = [t + (m - (len(methods) - 1) / 2) * width for m in (i, j)]
            axes.plot([ends[0], ends[0], ends[1], ends[1]], [height, height + 1, height + 1, height], color=INK, lw=0.8)
            axes.text(float(np.mean(ends)), height + 0.4, mark, ha="center", va="bottom", fontsize=8, color=INK)
            height += STEP
        top = max(top, height + 2)
    axes.set_xticks(range(len(textures)), textures, rotation=30 if many else 0, ha="right" if many else "center")
    axes.set_ylim(0, top)
    axes.set_yticks(range(0, 101, 20))
    axes.set_ylabel("similarity (0 to 100)")
    _head(
        figure, axes, result, f"mean ± SD of {len(result.ratings.values)}; * p < .05, ** p < .01, *** p < .001 (Holm)"
    )
    return figure


def panels(result: Result) -> Figure:
    """A panel for each texture: every participant's ratings, joined, and the means."""
    columns = min(4, len(result.ratings.textures))
    rows = -(-len(result.ratings.textures) // columns)
    figure, grid = _new(2.6 * columns + 0.6, 2.4 * rows + 0.7, nrows=rows, ncols=columns, sharey=True, squeeze=False)
    x = np.arange(len(result.ratings.methods))
    for t, axes in enumerate(grid.ravel()):
        if t >= len(result.ratings.textures):
            axes.set_visible(False)
            continue
        for participant in result.ratings.values[:, :, t]:
            axes.plot(x, participant, color=INK, alpha=0.18, lw=0.8)
        axes.plot(x, np.nanmean(result.ratings.values[:, :, t], 0), color=COLOURS[0], lw=2, marker="o", ms=5)
        axes.set_title(result.ratings.textures[t], fontsize=10, color=INK)
        axes.set_xticks(x, result.ratings.methods, fontsize=8, rotation=30 if len(result.ratings.methods) > 3 else 0)
        axes.set_ylim(-3, 103)
    _head(figure, None, result, "each participant, and the mean")
    return figure


def _compared(result: Result) -> int:
    """Method that the brackets of Fig. 9 start from."""
    pairs = result.document["pairs_overall"]
    first = {test["pair"][0] for test in pairs}
    if len(first) == 1 and len(result.ratings.methods) > 2:
        return result.ratings.methods.index(first.pop())
    return int(np.nanargmax(np.nanmean(result.ratings.values, (0, 2))))


def _new(width: float, height: float, **options: Any) -> tuple[Figure, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    grid = figure.subplots(**options)
    for axes in np.atleast_1d(grid).ravel():
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="y", alpha=0.25)
        axes.set_axisbelow(True)
        axes.tick_params(labelsize=9, colors=INK)
    return figure, grid


def _head(figure: Figure, axes: Any, result: Result, note: str) -> None:
    if axes is not None:
        axes.legend(
            frameon=False, ncols=len(result.ratings.methods), loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=9
        )
    figure.supxlabel(
        f"simulated ratings; {note}" if result.ratings.simulated else note,
        fontsize=8.5,
        color="#b4481e" if result.ratings.simulated else INK,
    )
