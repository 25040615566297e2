"""Figures of a study's ratings: Fig. 9, and a panel for each texture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from foten.reporting.figure import COLOURS, PAGE, add_legend, new_figure, panel_grid
from foten.study.analysis import Result, stars

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STEP = 4.5  # points between brackets
SIMULATED = "#b4481e"


def bars(result: Result) -> Figure:
    """Fig. 9: bars of the mean with SD for each texture and method, and brackets with stars where Holm's p is below .05,
    between the method of the highest mean, or the reference, and each other method.
    """
    textures, methods = result.ratings.textures, result.ratings.methods
    many = len(textures) > 6
    figure, axes = new_figure(max(7.0, 1.15 * len(textures) + 1.5), 5.2, PAGE)
    width = 0.8 / len(methods)
    best = _compared(result)
    top = 100.0
    for m, method in enumerate(methods):
        values = result.ratings.values[:, m]
        mean, sd = np.nanmean(values, 0), np.nanstd(values, 0, ddof=1)
        x = np.arange(len(textures)) + (m - (len(methods) - 1) / 2) * width
        axes.bar(x, mean, 0.92 * width, color=COLOURS[m % len(COLOURS)], label=method)
        axes.errorbar(x, mean, sd, fmt="none", ecolor=PAGE.ink, elinewidth=0.9, capsize=2)
    for t, texture in enumerate(textures):
        values = result.ratings.values[:, :, t]
        height = float(np.nanmax(np.nanmean(values, 0) + np.nanstd(values, 0, ddof=1))) + 2
        for test in result.document["pairs_within_textures"][texture]:
            i, j = (methods.index(name) for name in test["pair"])
            mark = stars(test["p_holm"])
            if best not in (i, j) or not mark:
                continue
            ends = [t + (m - (len(methods) - 1) / 2) * width for m in (i, j)]
            axes.plot(
                [ends[0], ends[0], ends[1], ends[1]], [height, height + 1, height + 1, height], color=PAGE.ink, lw=0.8
            )
            axes.text(float(np.mean(ends)), height + 0.4, mark, ha="center", va="bottom", fontsize=8, color=PAGE.ink)
            height += STEP
        top = max(top, height + 2)
    axes.set_xticks(range(len(textures)), textures, rotation=30 if many else 0, ha="right" if many else "center")
    axes.set_ylim(0, top)
    axes.set_yticks(range(0, 101, 20))
    axes.set_ylabel("similarity (0 to 100)")
    add_legend(axes, PAGE, ncols=len(methods), loc="lower center", bbox_to_anchor=(0.5, 1.0))
    note = f"mean ± SD of {len(result.ratings.values)}; * p < .05, ** p < .01, *** p < .001 (Holm)"
    _add_note(figure, result, note)
    return figure


def panels(result: Result) -> Figure:
    """A panel for each texture: every participant's ratings, joined, and the means."""
    methods = result.ratings.methods
    figure, grid = panel_grid(result.ratings.textures, 2.6, 2.4, PAGE)
    x = np.arange(len(methods))
    for t, axes in enumerate(grid):
        ratings = result.ratings.values[:, :, t]
        axes.plot(x, ratings.T, color=PAGE.ink, alpha=0.18, lw=0.8)
        axes.plot(x, np.nanmean(ratings, 0), color=COLOURS[0], lw=2, marker="o", ms=5)
        axes.set_xticks(x, methods, fontsize=8, rotation=30 if len(methods) > 3 else 0)
        axes.set_ylim(-3, 103)
    _add_note(figure, result, "each participant, and the mean")
    return figure


def _compared(result: Result) -> int:
    """Method that the brackets of Fig. 9 start from."""
    pairs = result.document["pairs_overall"]
    first = {test["pair"][0] for test in pairs}
    if len(first) == 1 and len(result.ratings.methods) > 2:
        return result.ratings.methods.index(first.pop())
    return int(np.nanargmax(np.nanmean(result.ratings.values, (0, 2))))


def _add_note(figure: Figure, result: Result, note: str) -> None:
    """Write below a figure what it shows, and that ratings are simulated."""
    if result.ratings.simulated:
        figure.supxlabel(f"simulated ratings; {note}", fontsize=8.5, color=SIMULATED)
    else:
        figure.supxlabel(note, fontsize=8.5, color=PAGE.ink)
