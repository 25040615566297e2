"""The figure of a judgement over time: spectrograms, level, speed and force."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from foten.evaluate import metrics
from foten.evaluate.evaluate import Judgement
from foten.evaluate.free_run import scored
from foten.evaluate.report.drawing import COLOURS, INK, STYLES, new_figure, style_colorbar
from foten.evaluate.report.signals import LABELS, scored_channels, shown_blocks, shown_run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_SPECTROGRAM_MS = 64.0  # of a spectrogram's window: a texture's level changes within a few frames of 40 ms
_SPECTROGRAM_COLUMNS = 700
_SPECTROGRAM_DB = 50.0  # of the colour scale, down from the loudest recorded cell


def over_time(judgement: Judgement) -> Figure:
    """Return spectrograms, level, speed and force of the scored blocks, joined on one time axis."""
    part, which, rate_hz = scored(judgement.trace.block), shown_blocks(judgement), judgement.trace.rate_hz
    every, *_ = scored_channels(judgement)
    recorded, speed, force = (channel[which] for channel in scored_channels(judgement))
    runs = {name: signal[:, which][:, :, part] for name, signal in judgement.synthesized.items()}
    name = shown_run(judgement)
    seconds = recorded.shape[1] / rate_hz
    borders = np.arange(len(which) + 1) * seconds
    pictured = {"recorded": recorded} | ({name: runs[name][0]} if name else {})
    n = len(pictured)
    figure, panels = new_figure(
        9.6, 1.6 * n + 4.0, nrows=n + 3, sharex=True, height_ratios=[1.45] * n + [1.5, 0.75, 0.75]
    )
    _draw_spectrograms(panels[:n], pictured, rate_hz, borders)
    style_colorbar(
        figure.colorbar(panels[0].images[0], ax=list(panels[:n]), pad=0.01, aspect=15 * n), "dB re 1 (m/s²)²/Hz"
    )
    lines = {"recorded": recorded[None]} | {key: runs[key] for key in (name, "free_run_ar") if key in runs}
    _draw_levels(panels[n], lines, rate_hz, borders, float(np.sqrt(np.square(every).mean())))
    times = _with_gaps(borders[:-1, None] + np.arange(recorded.shape[1]) / rate_hz)
    step = max(1, len(times) // 4000)
    for axes, channel, label in zip(panels[n + 1 :], (speed, force), ("speed\n[mm/s]", "force\n[N]"), strict=True):
        axes.plot(times[::step], _with_gaps(channel)[::step], color=INK, linewidth=1.1)
        axes.set_ylabel(label)
        axes.margins(y=0.15)
    for axes in panels[n:]:
        for border in borders[1:-1]:
            axes.axvline(border, color=INK, alpha=0.45, linewidth=0.8)
    for border, index in zip(borders, which, strict=False):
        panels[-1].annotate(
            f"block {judgement.blocks[index]}",
            (border + seconds / 2, 0.04),
            xycoords=("data", "axes fraction"),
            ha="center",
            fontsize=7.5,
            alpha=0.75,
            color=INK,
        )
    panels[0].set_xlim(0, borders[-1])
    panels[-1].set_xlabel("scored time, blocks joined [s]")
    figure.align_ylabels()
    return figure


def _draw_spectrograms(panels: Any, signals: Mapping[str, Array], rate_hz: float, borders: Array) -> None:
    """Draw a spectrogram of each signal (n_blocks, n) on the colour scale of the recorded one."""
    cells = {key: _spectrogram(blocks, rate_hz) for key, blocks in signals.items()}
    loudest = float(cells["recorded"][1].max())
    for axes, (key, (edges, decibels)) in zip(panels, cells.items(), strict=True):
        axes.imshow(
            decibels,
            origin="lower",
            aspect="auto",
            interpolation="none",
            extent=(0, borders[-1], *edges),
            cmap="magma",
            vmin=loudest - _SPECTROGRAM_DB,
            vmax=loudest,
        )
        axes.grid(visible=False)
        axes.set_ylabel("frequency\n[Hz]")
        axes.set_title(LABELS[key], loc="left", color=COLOURS[key], fontsize=10)
        for border in borders[1:-1]:
            axes.axvline(border, color="white", linewidth=1.2)


def _draw_levels(axes: Any, signals: Mapping[str, Array], rate_hz: float, borders: Array, reference: float) -> None:
    """Draw the frame levels of each signal (n_seeds, n_blocks, n), and the range of the seeds of the texture's run."""
    frame_s = max(1, round(metrics.FRAME_MS * rate_hz / 1000)) / rate_hz
    for key, samples in signals.items():
        levels = metrics.frame_levels(samples, rate_hz, reference)
        times = borders[:-1, None] + (np.arange(levels.shape[-1]) + 0.5) * frame_s
        times, levels = _with_gaps(times), np.stack([_with_gaps(run) for run in levels])
        style = {"linewidth": 1.8 if key == "recorded" else 1.3, "linestyle": STYLES.get(key, "solid")}
        axes.plot(times, levels.mean(axis=0), color=COLOURS[key], label=LABELS[key], **style)
        if len(levels) > 1 and key != "free_run_ar":
            low, high = levels.min(axis=0), levels.max(axis=0)
            axes.fill_between(times, low, high, color=COLOURS[key], alpha=0.22, linewidth=0)
    axes.set_ylabel("level\n[dB re recorded]")
    axes.legend(
        frameon=False,
        fontsize=8.5,
        ncols=len(signals),
        loc="lower right",
        bbox_to_anchor=(1.0, 0.98),
        borderaxespad=0,
        labelcolor=INK,
    )


def _spectrogram(blocks: Array, rate_hz: float) -> tuple[tuple[float, float], Array]:
    """Return the lowest and highest edge [Hz] and the density [dB], shape (k, time), of joined blocks (n_blocks, n).

    Each block is mirrored at its ends, so that no window crosses a border.
    """
    from scipy import signal

    n = blocks.shape[1]
    n_segment = min(2 ** round(math.log2(max(16.0, _SPECTROGRAM_MS * rate_hz / 1000))), 2 ** int(math.log2(n // 4)))
    hop = max(n_segment // 8, -(-blocks.size // _SPECTROGRAM_COLUMNS))
    padded = np.pad(blocks, ((0, 0), (n_segment // 2, n_segment // 2 + n % 2)), mode="reflect")
    starts = np.arange(0, n, hop)
    windows = np.lib.stride_tricks.sliding_window_view(padded, n_segment, axis=1)[:, starts]
    taper = signal.get_window("hann", n_segment)
    density = np.square(np.abs(np.fft.rfft(windows * taper, axis=-1))) * 2 / (rate_hz * np.square(taper).sum())
    frequencies = np.fft.rfftfreq(n_segment, 1 / rate_hz)
    kept = frequencies <= min(metrics.HIGHEST_HZ, 0.45 * rate_hz)
    decibels = 10 * np.log10(np.maximum(density[..., kept], 1e-30)).reshape(-1, int(kept.sum())).T
    half = frequencies[1] / 2
    return (-half, float(frequencies[kept][-1]) + half), decibels


def _with_gaps(blocks: Array) -> Array:
    """Return blocks (n_blocks, n) in one row with a NaN after each, which interrupts a drawn line."""
    return np.concatenate([blocks, np.full((len(blocks), 1), np.nan)], axis=1).ravel()
