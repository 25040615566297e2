"""Figures of a study: Fig. 9 of ratings, strengths and sensitivities of choices, and a panel for each texture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from foten.reporting.figure import COLOURS, PAGE, add_legend, new_figure, panel_grid
from foten_study.results import CORRECTIONS, stars
from foten_study.tasks.kind import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STEP = 4.5  # points between brackets
SIMULATED = "#b4481e"


def figures_of(result: Result) -> dict[str, tuple[Figure, str]]:
    """Figures of a result, each with what it shows, by name."""
    panels_of = f"{result.ratings.quantity.capitalize()} of each participant, a panel for each texture"
    main = f"Mean {result.ratings.quantity} of each method on each texture"
    name, draw, shows = "ratings", bars, main
    if "strengths" in result.document:
        name, draw, shows = "strengths", strengths, "Strength of each method, with 95 % intervals"
    elif "sensitivity" in result.document:
        name, draw, shows = "sensitivity", sensitivity, "d′ of each pair of methods, with 95 % intervals"
    return {name: (draw(result), shows), "textures": (panels(result), panels_of)}


def strengths(result: Result) -> Figure:
    """Log-odds of each method with 95 % intervals, over all textures and, smaller, of each."""
    document = result.document
    within = [one["methods"] for one in document["strengths_within_textures"].values()]
    figure, axes = _intervals(document["strengths"]["methods"], within, "log_odds", result.ratings.methods)
    axes.axvline(0.0, color=PAGE.ink, lw=0.8, alpha=0.4)
    axes.set_xlabel("strength [log-odds, mean 0]")
    _add_note(figure, result, "chosen more often to the right; 95 % over participants; ticks: each texture")
    return figure


def sensitivity(result: Result) -> Figure:
    """d′ of each pair with 95 % intervals, over all textures and, smaller, of each."""
    rows, within = result.document["sensitivity"], [*result.document["sensitivity_within_textures"].values()]
    figure, axes = _intervals(rows, within, "d_prime", [", ".join(row["pair"]) for row in rows])
    axes.set_xlim(left=-0.05)
    axes.set_xlabel("d′ (0: nobody can tell)")
    _add_note(figure, result, "95 % over participants; ticks: each texture")
    return figure


def _intervals(rows: list[dict[str, Any]], within: list[Any], key: str, names: list[str]) -> tuple[Figure, Any]:
    """A point and its interval for each row, with ticks of each texture's; an end that is not known is left open."""
    figure, axes = new_figure(7.0, 0.5 * len(rows) + 1.6, PAGE)
    for k in range(len(rows)):
        colour = COLOURS[k % len(COLOURS)]
        axes.plot([one[k][key] for one in within], np.full(len(within), k) + 0.22, "|", color=colour, ms=7, alpha=0.7)
    for k, row in enumerate(rows):
        ends, colour = [row[f"ci95_{end}"] for end in ("low", "high")], COLOURS[k % len(COLOURS)]
        axes.plot([row[key] if end is None else end for end in ends], [k, k], color=colour, lw=2)
        axes.plot(row[key], k, "o", color=colour, ms=7)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_yticks(range(len(rows)), names)
    return figure, axes


def bars(result: Result) -> Figure:
    """Fig. 9: the mean with SD for each texture and method, as bars where the scale has a zero, and brackets with stars where the
    corrected p is below .05, between the method of the highest mean, or the reference, and each other method.
    """
    textures, methods, on_scale = result.ratings.textures, result.ratings.conditions, not result.ratings.unit
    correction = result.document["correction"]
    many = len(textures) > 6
    figure, axes = new_figure(max(7.0, 1.15 * len(textures) + 1.5), 5.2, PAGE)
    width = 0.8 / len(methods)
    best = _compared(result)
    top = 100.0 if on_scale else -np.inf
    step = STEP if on_scale else 0.05 * float(np.ptp(result.ratings.values[np.isfinite(result.ratings.values)]) or 1.0)
    for m, method in enumerate(methods):
        values = result.ratings.values[:, m]
        mean, sd = np.nanmean(values, 0), np.nanstd(values, 0, ddof=1)
        x = np.arange(len(textures)) + (m - (len(methods) - 1) / 2) * width
        if on_scale:
            axes.bar(x, mean, 0.92 * width, color=COLOURS[m % len(COLOURS)], label=method)
        else:
            axes.plot(x, mean, "o", ms=7, color=COLOURS[m % len(COLOURS)], label=method)
        axes.errorbar(x, mean, sd, fmt="none", ecolor=PAGE.ink, elinewidth=0.9, capsize=2)
    for t, texture in enumerate(textures):
        values = result.ratings.values[:, :, t]
        height = float(np.nanmax(np.nanmean(values, 0) + np.nanstd(values, 0, ddof=1))) + step / 2
        for test in result.document.get("pairs_within_textures", {}).get(texture, ()):
            i, j = (methods.index(name) for name in test["pair"])
            mark = stars(test[f"p_{correction}"])
            if best not in (i, j) or not mark:
                continue
            ends = [t + (m - (len(methods) - 1) / 2) * width for m in (i, j)]
            up, middle = height + step / 4, float(np.mean(ends))
            axes.plot([ends[0], ends[0], ends[1], ends[1]], [height, up, up, height], color=PAGE.ink, lw=0.8)
            axes.text(middle, height + step / 10, mark, ha="center", va="bottom", fontsize=8, color=PAGE.ink)
            height += step
        top = max(top, height + step / 2)
    axes.set_xticks(range(len(textures)), textures, rotation=30 if many else 0, ha="right" if many else "center")
    if on_scale:
        axes.set_ylim(0, top)
        axes.set_yticks(range(0, 101, 20))
    else:
        axes.set_ylim(top=top + step)
    axes.set_ylabel(result.ratings.label)
    add_legend(axes, PAGE, ncols=len(methods), loc="lower center", bbox_to_anchor=(0.5, 1.0))
    note = f"mean ± SD of {len(result.ratings.values)}; * p < .05, ** p < .01, *** p < .001 ({CORRECTIONS[correction]})"
    _add_note(figure, result, note)
    return figure


def panels(result: Result) -> Figure:
    """A panel for each texture: every participant's ratings, joined, and the means."""
    methods = result.ratings.conditions
    figure, grid = panel_grid(result.ratings.textures, 2.6, 2.4, PAGE)
    x = np.arange(len(methods))
    for t, axes in enumerate(grid):
        ratings = result.ratings.values[:, :, t]
        axes.plot(x, ratings.T, color=PAGE.ink, alpha=0.18, lw=0.8, marker="o" if len(x) == 1 else None)
        axes.plot(x, np.nanmean(ratings, 0), color=COLOURS[0], lw=2, marker="o", ms=5)
        axes.set_xticks(x, methods, fontsize=8, rotation=30 if len(methods) > 3 else 0)
        if not result.ratings.unit.startswith("dB"):
            axes.set_ylim(-3, 103)
    if "sensitivity" in result.document:
        for axes in grid:
            axes.axhline(100 * result.document["chance"], color=PAGE.ink, lw=0.8, ls="--")
    figure.supylabel(result.ratings.label, fontsize=8.5, color=PAGE.ink)
    chance = "; dashed: chance" * ("sensitivity" in result.document)
    _add_note(figure, result, f"each participant, and the mean{chance}")
    return figure


def _compared(result: Result) -> int:
    """Method that the brackets of Fig. 9 start from."""
    first = {test["pair"][0] for test in result.document.get("pairs_overall", ())}
    if len(first) == 1 and len(result.ratings.conditions) > 2:
        return result.ratings.conditions.index(first.pop())
    return int(np.nanargmax(np.nanmean(result.ratings.values, (0, 2))))


def _add_note(figure: Figure, result: Result, note: str) -> None:
    """Write below a figure what it shows, and that ratings are simulated."""
    if result.ratings.simulated:
        figure.supxlabel(f"simulated; {note}", fontsize=8.5, color=SIMULATED)
    else:
        figure.supxlabel(note, fontsize=8.5, color=PAGE.ink)
