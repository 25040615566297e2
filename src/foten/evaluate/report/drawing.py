"""How the report's figures look: colours, axes, and SVG that follows the page's text colour."""

from __future__ import annotations

import html
import io
import re
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Drawn in this colour and written as the page's own text colour, so that a figure is legible on light and dark.
INK = "#010203"
# Distinct with any colour vision, and by lightness on white and on black.
COLOURS = {
    "recorded": INK,
    "free_run": "#2b83cf",
    "free_run_deterministic": "#e08a1e",
    "free_run_ar": "#1a9c72",
    "ceiling": "#b77ab0",
}
STYLES = {"free_run_deterministic": (0, (4, 2)), "free_run_ar": (0, (6, 1.5, 1.5, 1.5)), "ceiling": (0, (1.5, 1.5))}


def new_figure(width: float, height: float, **options: Any) -> tuple[Figure, Any]:
    """Return a figure of some inches and its panels, in the report's style; `options` as of `Figure.subplots`."""
    # Not pyplot: the user's backend and open figures stay as they are.
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasSVG(figure)
    panels = figure.subplots(**options)
    for axes in np.atleast_1d(panels).ravel():
        axes.spines[["top", "right"]].set_visible(False)
        axes.spines[:].set(color=INK, alpha=0.5)
        axes.tick_params(color=INK, labelcolor=INK, labelsize=9)
        axes.grid(color=INK, alpha=0.12, linewidth=0.7)
        axes.set_axisbelow(True)
        for axis in (axes.xaxis, axes.yaxis):
            axis.label.set(color=INK, size=9)
    return figure, panels


def add_legend(axes: Any, fontsize: float = 8.5, **options: Any) -> None:
    """Add a legend, in the report's style; `options` as of `Axes.legend`."""
    axes.legend(frameon=False, fontsize=fontsize, labelcolor=INK, **options)


def log_hertz(axes: Any, low: float, high: float) -> None:
    """Make the x axis logarithmic from `low` to `high` [Hz], with ticks at round frequencies."""
    from matplotlib.ticker import NullFormatter

    axes.set_xscale("log")
    axes.set_xlim(low, high)
    ticks = [
        tick
        for tick in (20, 30, 50, 100, 200, 300, 500, 1000, 2000, 3000, 5000, 10_000, 20_000)
        if low <= tick <= 1.001 * high
    ]
    ticks += [] if ticks and high < 1.2 * ticks[-1] else [round(high)]
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(color=INK, alpha=0.06, linewidth=0.6, which="minor")


def style_colorbar(bar: Any, label: str) -> None:
    """Label a colour bar, in the report's style."""
    bar.set_label(label, color=INK)
    bar.outline.set_visible(False)
    bar.ax.tick_params(color=INK, labelcolor=INK, labelsize=8)


def inline_svg(figure: Figure, name: str, description: str) -> str:
    """Return a figure as an SVG element for an HTML page; the same figure gives the same text.

    The name, of letters and unique on the page, is the prefix of its identifiers; the description is for those who do not see it.
    """
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
    return svg.replace(INK, "currentColor").replace("<svg ", f"<svg {attributes} ", 1).rstrip()
