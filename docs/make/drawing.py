"""How pictures of the documents look: colours, sizes, a palette of few colours, sounds; and block diagrams."""

import argparse
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from PIL import Image

from foten.dsp.resample import interpolate
from foten.reporting.figure import BLUE, GREEN, MAUVE, ORANGE, Style, add_legend, new_figure
from foten.runtime.live.sinks import pcm_wav

DOCS = Path(__file__).resolve().parents[1]
INK, OURS, PAPER, LINEAR, CEILING = "#333333", BLUE, ORANGE, GREEN, MAUVE
SOUND_HZ = 3000
STYLE = Style(INK, label_pt=10, tick_pt=9)
DPI = 110
N_COLOURS = 32  # of a picture's palette


def image_of(figure: Figure) -> Image.Image:
    figure.set_dpi(DPI)
    canvas = figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def save(figure: Figure | Image.Image, name: str, n_colours: int = N_COLOURS) -> None:
    """Write a picture of few colours, without loss but for these: none is far from that of a line, rare or frequent."""
    (DOCS / "pictures").mkdir(exist_ok=True)
    image = figure if isinstance(figure, Image.Image) else image_of(figure)
    palette = image.quantize(n_colours, Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE).convert("RGB")
    palette.save(DOCS / "pictures" / f"{name}.webp", lossless=True, quality=100, method=6)
    print(name)


def drawn(width: float, height: float, n_rows: int = 1, n_columns: int = 1, **options: Any) -> tuple[Figure, Any]:
    return new_figure(width, height, STYLE, nrows=n_rows, ncols=n_columns, **options)


def legend_of(figure: Figure, axes: Any, **options: Any) -> None:
    """Put a legend of what one of the axes shows beside all of them."""
    handles, labels = axes.get_legend_handles_labels()
    add_legend(figure, STYLE, handles=handles, labels=labels, **options)


def write_sound(name: str, signals: Sequence[np.ndarray], rate_hz: float) -> None:
    """Write signals after each other, at one gain."""
    loudest, pause = max(float(np.abs(signal).max()) for signal in signals), np.zeros(round(0.4 * rate_hz))
    row = np.concatenate([part for signal in signals for part in (0.9 / loudest * signal, pause)])
    (DOCS / "audio").mkdir(exist_ok=True)
    sound = pcm_wav(interpolate(row, Fraction(SOUND_HZ, round(rate_hz))), SOUND_HZ)
    (DOCS / "audio" / f"{name}.wav").write_bytes(sound)


SOFT, WARM, COOL, PLAIN = "#dcebf7", "#fbe8cf", "#d9efe5", "#f2f2f2"


def boxes(placed: Mapping[str, tuple[float, float, float, str]], arrows: list[tuple[Any, ...]]) -> Figure:
    """Draw a block diagram: text → x, y, width, colour; and arrows between points, with what they carry."""
    figure, axes = drawn(9, 3.4)
    for text, (x, y, width, colour) in placed.items():
        style = "round,pad=0.02,rounding_size=0.12"
        axes.add_patch(FancyBboxPatch((x - width / 2, y - 0.32), width, 0.64, style, fc=colour, ec=INK, lw=0.8))
        axes.text(x, y, text, ha="center", va="center", fontsize=8.5, color=INK)
    for begin, end, carried_by in arrows:
        axes.annotate("", end, begin, arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 0.9})
        middle = ((begin[0] + end[0]) / 2, (begin[1] + end[1]) / 2)
        beneath = {"fc": "white", "ec": "none", "pad": 1.0} if carried_by else None
        axes.text(*middle, carried_by, ha="center", va="center", fontsize=8, color=INK, bbox=beneath)
    axes.set(xlim=(-0.1, 12.1), ylim=(0.2, 4.4))
    axes.axis("off")
    return figure


def foten_diagram(arguments: argparse.Namespace) -> Figure:
    """The paper's network."""
    placed = {
        "window\na, v, f": (0.7, 2.1, 1.2, PLAIN),
        "embedding,\npositions": (3.0, 3.3, 1.6, SOFT),
        "3 encoder layers": (5.5, 3.3, 1.9, SOFT),
        "DFT": (2.6, 1.5, 0.9, WARM),
        "magnitude:\nencoder layer": (4.7, 1.95, 1.7, WARM),
        "phase:\nencoder layer": (4.7, 0.75, 1.7, WARM),
        "inverse\nDFT": (6.9, 1.35, 1.2, WARM),
        "last tokens\nof both": (8.4, 2.5, 1.5, PLAIN),
        "head\n256, 64, 1": (10.3, 2.5, 1.4, COOL),
    }
    arrows = [
        ((1.35, 2.3), (2.15, 3.2), "a"),
        ((3.85, 3.3), (4.5, 3.3), ""),
        ((6.5, 3.3), (7.6, 2.7), ""),
        ((1.35, 1.95), (2.1, 1.6), "a"),
        ((3.1, 1.6), (3.8, 1.9), ""),
        ((3.1, 1.4), (3.8, 0.9), ""),
        ((5.6, 1.9), (6.25, 1.5), ""),
        ((5.6, 0.8), (6.25, 1.2), ""),
        ((7.5, 1.5), (8.1, 2.1), "a_spec"),
        ((9.2, 2.5), (9.55, 2.5), ""),
        ((10.3, 1.3), (10.3, 2.1), "v, f"),
        ((11.05, 2.5), (11.75, 2.5), "â"),
    ]
    return boxes(placed, arrows)


def foten_plus_diagram(arguments: argparse.Namespace) -> Figure:
    """Our model in its own loop."""
    placed = {
        "speed, force": (0.9, 3.9, 1.5, PLAIN),
        "level, tables\nover v and f": (3.4, 3.9, 1.9, SOFT),
        "noise": (0.9, 2.4, 1.2, PLAIN),
        "Gaussian, or a\nrecorded stretch": (3.4, 2.4, 2.1, WARM),
        "lattice": (6.6, 2.4, 1.4, SOFT),
        "tones of the path": (6.6, 3.9, 1.9, SOFT),
        "+": (9.0, 2.4, 0.5, PLAIN),
        "equaliser": (10.5, 2.4, 1.3, SOFT),
        "saturator": (10.5, 0.7, 1.3, PLAIN),
    }
    arrows = [
        ((1.7, 3.9), (2.4, 3.9), ""),
        ((1.55, 2.4), (2.3, 2.4), "z"),
        ((3.4, 3.5), (3.4, 2.8), "v, f"),
        ((4.4, 3.9), (5.6, 3.9), ""),
        ((4.4, 3.65), (5.85, 2.75), ""),
        ((4.5, 2.4), (5.85, 2.4), "e"),
        ((7.35, 2.4), (8.7, 2.4), "x"),
        ((7.6, 3.9), (8.9, 2.75), ""),
        ((9.3, 2.4), (9.85, 2.4), ""),
        ((10.5, 2.0), (10.5, 1.05), "a"),
        ((11.2, 0.7), (11.8, 0.7), ""),
    ]
    return boxes(placed, arrows)
