"""How pictures of the documents look: colours, sizes, a palette of few colours, sounds."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
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
