"""Figures: style, panels, and the file or page element that they become; the same figure, the same bytes."""

from __future__ import annotations

import html
import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from foten.atomic_write import atomic_write

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, MAUVE = "#2b83cf", "#e08a1e", "#1a9c72", "#b77ab0"
COLOURS = (BLUE, ORANGE, GREEN, MAUVE, "#c2452d", "#7a6a10", "#4f4fb5", "#12b5cb")
"""Distinct with any colour vision, and by lightness on white and on black."""
LEGEND_LINE_PT = 2.0
TICKS_HZ = (20, 30, 50, 100, 200, 300, 500, 1000, 2000, 3000, 5000, 10_000, 20_000)


@dataclass(frozen=True)
class Style:
    """Look of axes and words."""

    ink: str = "#222222"
    axis: float = 1.0  # opacity of the axes
    grid: float = 0.0  # opacity of the grid, 0 for none
    label_pt: float = 9.0
    tick_pt: float = 8.0
    legend_pt: float = 8.0


PRINT = Style()
# Drawn in this colour and written as the page's own text colour, so that a figure is legible on light and dark.
PAGE = Style(ink="#010203", axis=0.5, grid=0.12, tick_pt=9.0, legend_pt=8.5)


def new_figure(width: float, height: float, style: Style = PRINT, **options: Any) -> tuple[Figure, Any]:
    """Figure of some inches and its panels; `options` as of `Figure.subplots`."""
    # Not pyplot: the user's backend and open figures stay as they are.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(**options)
    for axes in np.ravel(panels):
        axes.spines[["top", "right"]].set_visible(False)
        axes.spines[:].set(color=style.ink, alpha=style.axis)
        axes.tick_params(color=style.ink, labelcolor=style.ink, labelsize=style.tick_pt)
        if style.grid:
            axes.grid(color=style.ink, alpha=style.grid, linewidth=0.7)
        axes.set_axisbelow(True)
        for axis in (axes.xaxis, axes.yaxis):
            axis.label.set(color=style.ink, size=style.label_pt)
    return figure, panels


def panel_grid(names: list[str], width: float, height: float, style: Style = PRINT) -> tuple[Figure, list[Any]]:
    """Figure with a panel of some inches for each name, three or four beside each other."""
    columns = min(len(names), 3 if len(names) <= 9 else 4)
    rows = -(-len(names) // columns)
    size = max(width, 6.0 / columns) * columns, height * rows + 0.6
    figure, panels = new_figure(*size, style, nrows=rows, ncols=columns, squeeze=False)
    for axes, name in zip(panels.flat, names, strict=False):
        axes.set_title(name, fontsize=style.label_pt, loc="left")
    for axes in panels.flat[len(names) :]:
        axes.set_visible(False)
    return figure, list(panels.flat[: len(names)])


def add_legend(of: Any, style: Style = PRINT, **options: Any) -> None:
    """Add a legend to axes or a figure, its lines wide enough to show their colours; `options` as of `Axes.legend`."""
    legend = of.legend(**{"frameon": False, "fontsize": style.legend_pt, "labelcolor": style.ink, **options})
    for line in legend.get_lines():
        line.set_linewidth(max(line.get_linewidth(), LEGEND_LINE_PT))


def add_colour_bar(figure: Figure, of: Any, label: str, style: Style = PRINT, **options: Any) -> None:
    """Add the bar of a colour scale; `options` as of `Figure.colorbar`."""
    bar = figure.colorbar(of, **options)
    bar.set_label(label, color=style.ink)
    bar.outline.set_visible(False)
    bar.ax.tick_params(color=style.ink, labelcolor=style.ink, labelsize=8)


def log_hertz(axes: Any, low: float, high: float, style: Style = PRINT) -> None:
    """Make the x axis logarithmic from `low` to `high` [Hz], with ticks at round frequencies."""
    from matplotlib.ticker import NullFormatter

    axes.set_xscale("log")
    axes.set_xlim(low, high)
    ticks = [tick for tick in TICKS_HZ if low <= tick <= 1.001 * high]
    ticks += [] if ticks and high < 1.2 * ticks[-1] else [round(high)]
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(color=style.ink, alpha=0.5 * style.grid, linewidth=0.6, which="minor")


def write_figure(figure: Figure, path: Path, dpi: float = 140.0) -> None:
    """Write a figure in the form of the path's suffix, .png of a resolution or .pdf, without date and software."""
    form = path.suffix[1:]
    nothing = {"png": {"Software": None}, "pdf": {"CreationDate": None, "Creator": None, "Producer": None}}[form]
    with atomic_write(path) as part:
        figure.savefig(part, format=form, dpi=dpi, facecolor="white", metadata=nothing)


def inline_svg(figure: Figure, name: str, description: str) -> str:
    """Figure in the style `PAGE` as an SVG element whose identifiers begin with a name, with a description for screen readers."""
    import matplotlib

    # The layout alone, at the resolution of SVG: savefig would draw everything once more for it.
    figure.dpi = 72
    layout = figure.get_layout_engine()
    assert layout is not None
    layout.execute(figure)
    figure.set_layout_engine(None)
    buffer = io.StringIO()
    # Text stays text: it can be searched, takes the page's font and is a tenth of the outlines' size.
    with matplotlib.rc_context({"svg.hashsalt": name, "svg.fonttype": "none", "svg.image_inline": True}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    svg = "<svg" + buffer.getvalue().partition("<svg")[2]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    # Inside HTML the parser knows both namespaces.
    svg = re.sub(r' xmlns(?::\w+)?="[^"]*"', "", svg)
    svg = re.sub(r"(\bid=\"|url\(#|href=\"#)", rf"\g<1>{name}-", svg)
    svg = re.sub(r"font-family: [^;\"]*", "font-family: inherit", svg)
    # A style element would rule the whole page; both properties are inherited from the root as well.
    svg = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", svg, flags=re.DOTALL)
    attributes = f'role="img" aria-label="{html.escape(description)}" style="stroke-linejoin: round"'
    return svg.replace(PAGE.ink, "currentColor").replace("<svg ", f"<svg {attributes} ", 1).rstrip()
