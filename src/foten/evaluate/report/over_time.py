"""The figure of a judgement over time: spectrograms, level, speed and force."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from foten.evaluate import metrics
from foten.evaluate.evaluate import Judgement
from foten.evaluate.free_run import scored
from foten.evaluate.report.drawing import COLOURS, INK, STYLES, new_figure
from foten.evaluate.report.signals import LABELS, scored_channels, shown_blocks, shown_run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_SPECTROGRAM_MS = 64.0  # of a spectrogram's window: a texture's level changes within a few frames of 40 ms
_SPECTROGRAM_COLUMNS = 700
_SPECTROGRAM_DB = 50.0  # of the colour scale, down from the loudest recorded cell


def over_time(judgement: Judgement) -> Figure:
    """Return spectrograms, level, speed and force of the scored blocks, one after the other on one time axis.

    Both spectrograms share the colour scale, one below the other so that a moment reads straight down.
    """
    trace, part, which = judgement.trace, scored(judgement.trace.block), shown_blocks(judgement)
    rate_hz = trace.rate_hz
    recorded, speed, force = (channel[which] for channel in scored_channels(judgement))
    runs = {name: judgement.synthesized[name][:, which][:, :, part] for name in judgement.synthesized}
    name = shown_run(judgement)
    seconds = recorded.shape[1] / rate_hz
    borders = np.arange(len(which) + 1) * seconds
    pictured = {"recorded": recorded} | ({name: runs[name][0]} if name else {})
    n = len(pictured)
    figure, panels = new_figure(
        9.6, 1.6 * n + 4.0, nrows=n + 3, sharex=True, height_ratios=[1.45] * n + [1.5, 0.75, 0.75]
    )

    cells = {key: _spectrogram(samples, rate_hz) for key, samples in pictured.items()}
    loudest = float(cells["recorded"][1].max())
    for axes, (key, (edges, decibels)) in zip(panels, cells.items(), strict=False):
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
    bar = figure.colorbar(panels[0].images[0], ax=list(panels[:n]), pad=0.01, aspect=15 * n)
    bar.set_label("dB re 1 (m/s²)²/Hz", color=INK)
    bar.outline.set_visible(False)
    bar.ax.tick_params(color=INK, labelcolor=INK, labelsize=8)

    reference = float(np.sqrt(np.square(scored_channels(judgement)[0]).mean()))
    lines = {"recorded": recorded[None]} | {key: runs[key] for key in (name, "free_run_ar") if key in runs}
    frame_s = max(1, round(metrics.FRAME_MS * rate_hz / 1000)) / rate_hz
    axes = panels[n]
    for key, samples in lines.items():
        levels = metrics.frame_levels(samples, rate_hz, reference)
        times = borders[:-1, None] + (np.arange(levels.shape[-1]) + 0.5) * frame_s
        times, levels = _with_gaps(times), np.stack([_with_gaps(run) for run in levels])
        style = {"linewidth": 1.8 if key == "recorded" else 1.3, "linestyle": STYLES.get(key, "solid")}
        axes.plot(times, levels.mean(axis=0), color=COLOURS[key], label=LABELS[key], **style)
        if len(levels) > 1 and key == name:
            low, high = levels.min(axis=0), levels.max(axis=0)
            axes.fill_between(times, low, high, color=COLOURS[key], alpha=0.22, linewidth=0)
    axes.set_ylabel("level\n[dB re recorded]")
    axes.legend(
        frameon=False,
        fontsize=8.5,
        ncols=len(lines),
        loc="lower right",
        bbox_to_anchor=(1.0, 0.98),
        borderaxespad=0,
        labelcolor=INK,
    )
    times = _with_gaps(borders[:-1, None] + np.arange(recorded.shape[1]) / rate_hz)
    step = max(1, len(times) // 4000)
    for axes, channel, label in (
        (panels[n + 1], speed, "speed\n[mm/s]"),
        (panels[n + 2], force, "force\n[N]"),
    ):
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


def _spectrogram(blocks: Array, rate_hz: float) -> tuple[tuple[float, float], Array]:
    """Return the lowest and highest edge [Hz] and the density [dB] of joined blocks (b, n), shape (frequency, time).

    Each block is mirrored at its ends, so that no window reaches over a border.
    """
    from scipy import signal

    n = blocks.shape[1]
    n_segment = min(
        2 ** round(math.log2(max(16.0, _SPECTROGRAM_MS * rate_hz / 1000))), 2 ** int(math.log2(n // 4))
    )
    hop = max(n_segment // 8, -(-blocks.size // _SPECTROGRAM_COLUMNS))
    padded = np.pad(blocks, ((0, 0), (n_segment // 2, n_segment // 2 + n % 2)), mode="reflect")
    starts = np.arange(0, n, hop)
    windows = np.lib.stride_tricks.sliding_window_view(padded, n_segment, axis=1)[:, starts]
    taper = signal.get_window("hann", n_segment)
    density = (
        np.square(np.abs(np.fft.rfft(windows * taper, axis=-1))) * 2 / (rate_hz * np.square(taper).sum())
    )
    frequencies = np.fft.rfftfreq(n_segment, 1 / rate_hz)
    kept = frequencies <= min(metrics.HIGHEST_HZ, 0.45 * rate_hz)
    decibels = 10 * np.log10(np.maximum(density[..., kept], 1e-30)).reshape(-1, int(kept.sum())).T
    half = frequencies[1] / 2
    return (-half, float(frequencies[kept][-1]) + half), decibels


def _with_gaps(blocks: Array) -> Array:
    """Return blocks (b, n) in one row with a NaN after each: a line drawn through them breaks at the borders."""
    return np.concatenate([blocks, np.full((len(blocks), 1), np.nan)], axis=1).ravel()
