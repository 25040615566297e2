"""Figures of a judgement: waveform, spectrum, errors by band and by condition, and all over time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from foten.dsp import Array
from foten.dsp.distance import MIN_SCORED_HZ, highest_with_power, max_scored_hz
from foten.dsp.level import FRAME_MS, decibels, frame_levels, frame_means, rms
from foten.evaluate.evaluate import Judgement
from foten.evaluate.metrics import band_edges
from foten.evaluate.report import signals
from foten.evaluate.report.signals import LABELS, scored_conditions, scored_runs, shown_blocks, shown_run
from foten.models.conditions import (
    EXTRAPOLATION_LIMIT,
    FADE_FORCE,
    FADE_SPEED,
    MOVING_FORCE,
    MOVING_SPEED,
    REACH_FORCE,
    REACH_SPEED,
)
from foten.models.texture_file import Texture
from foten.reporting.figure import BLUE, GREEN, MAUVE, ORANGE, PAGE, add_colour_bar, add_legend, log_hertz, new_figure
from foten.runtime.renderer import Renderer

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK = PAGE.ink
COLOURS = {"recorded": INK, "free_run": BLUE, "free_run_deterministic": ORANGE, "free_run_ar": GREEN, "ceiling": MAUVE}
STYLES = {"free_run_deterministic": (0, (4, 2)), "free_run_ar": (0, (6, 1.5, 1.5, 1.5)), "ceiling": (0, (1.5, 1.5))}
_SPECTROGRAM_MS = 64.0  # of a spectrogram's window: a texture's level changes within a few frames of 40 ms
_SPECTROGRAM_COLUMNS = 700
REACH_NEAR = math.log(1.4)  # of speed or force to the other's median
N_REACH = 16  # speeds, or forces, that are rendered
_SPECTROGRAM_DB = 50.0  # of the colour scale, down from the loudest recorded cell


def waveform(judgement: Judgement) -> Figure:
    """First 400 scored samples of the typical block: recorded, the texture's run, AR(20); one scale."""
    runs, block = scored_runs(judgement), signals.typical_block(judgement)
    names = [name for name in ("recorded", shown_run(judgement), "free_run_ar") if name in runs]
    rows = {name: runs[name][0, block, : signals.N_WAVEFORM] for name in names}
    figure, panels = new_figure(
        9.6, 0.55 + 1.15 * len(rows), PAGE, nrows=len(rows), sharex=True, sharey=True, squeeze=False
    )
    times = np.arange(len(rows["recorded"])) / judgement.trace.rate_hz * 1000
    for axes, (name, samples) in zip(panels[:, 0], rows.items(), strict=True):
        axes.plot(times, samples, color=COLOURS[name], linewidth=1.0)
        axes.axhline(0, color=INK, alpha=0.25, linewidth=0.6)
        axes.set_title(LABELS[name], loc="left", color=COLOURS[name], fontsize=10)
        axes.set_xlim(0, len(times) / judgement.trace.rate_hz * 1000)
    limit = 1.08 * max(float(np.abs(samples).max()) for samples in rows.values())
    panels[0, 0].set_ylim(-limit, limit)
    panels[-1, 0].set_xlabel("time since the scored part began [ms]")
    figure.supylabel(f"acceleration [{judgement.document['unit']}]", fontsize=9, color=INK)
    return figure


def spectrum(judgement: Judgement) -> Figure:
    """Pooled power spectral densities [dB re 1 (m/s²)²/Hz] of every run over log frequency, up to half the rate."""
    frequencies, pooled = signals.densities(judgement, unscored=True)
    rate_hz = judgement.trace.rate_hz
    in_db = {name: decibels(density) for name, density in pooled.items()}
    figure, axes = new_figure(9.6, 3.7, PAGE)
    top = max(float(line.max()) for line in in_db.values())
    lowest = min(float(line.min()) for name, line in in_db.items() if name != "free_run_deterministic")
    # Neither a silent run nor what a low-pass left above the scored range may flatten the others.
    scored = float(in_db["recorded"][frequencies <= max_scored_hz(rate_hz)].min())
    bottom = max(lowest, min(float(in_db["recorded"].min()) - 20, scored - 20), scored - 40) - 4
    for name, line in in_db.items():
        style = {
            "linewidth": 2.2 if name == "recorded" else 1.5,
            "linestyle": STYLES.get(name, "solid"),
            "marker": "o" if len(frequencies) < 12 else None,
            "zorder": 3 if name in ("recorded", "free_run") else 2,
        }
        hidden = " (below the axis)" if line.max() < bottom else ""
        axes.plot(frequencies, line, color=COLOURS[name], markersize=3, label=LABELS[name] + hidden, **style)
    axes.set_ylim(bottom, top + 3)
    log_hertz(axes, MIN_SCORED_HZ, rate_hz / 2, PAGE)
    axes.axvspan(max_scored_hz(rate_hz), rate_hz / 2, color=INK, alpha=0.06, linewidth=0)
    scored_hz = f"scored from {MIN_SCORED_HZ:g} to {max_scored_hz(rate_hz):g} Hz"
    axes.set_xlabel(f"frequency [Hz], up to half the rate; {scored_hz}")
    axes.set_ylabel(f"density [dB re 1 ({judgement.document['unit']})²/Hz]")
    add_legend(axes, PAGE, fontsize=9)
    return figure


def bands(judgement: Judgement) -> Figure | None:
    """Energy error of the nine bands that are scored: of the texture's run, AR(20) and the ceiling; None without any."""
    names = [name for name in (shown_run(judgement), "free_run_ar", "ceiling") if name is not None]
    errors_of = {name: judgement.document[name].get("band_errors_db") for name in names}
    drawn = {name: errors for name, errors in errors_of.items() if errors}
    if not drawn:
        return None
    edges = band_edges(judgement.trace.rate_hz)
    figure, axes = new_figure(4.9, 3.4, PAGE)
    width = 0.8 / len(drawn)
    for k, (name, errors) in enumerate(drawn.items()):
        known = [i for i, error in enumerate(errors) if error is not None]
        left, heights = np.array(known) - 0.4 + k * width, [errors[i] for i in known]
        axes.bar(left, heights, 0.92 * width, align="edge", color=COLOURS[name], label=LABELS[name])
    axes.axhline(0, color=INK, linewidth=0.8)
    for i, error in enumerate(next(iter(drawn.values()))):
        if error is None:
            axes.text(i, 0, " no bin", rotation=90, ha="center", va="bottom", fontsize=8, color=INK, alpha=0.6)
    axes.set_xticks(np.arange(len(edges)) - 0.5, [f"{edge:.0f}" for edge in edges])
    axes.tick_params(axis="x", labelsize=8)
    axes.grid(visible=False, axis="x")
    low, high = axes.get_ylim()
    axes.set(xlabel="band edges [Hz]", ylabel="energy error [dB]")
    axes.set(xlim=(-0.55, len(edges) - 1.45), ylim=(low, high + 0.16 * (high - low)))
    add_legend(axes, PAGE, ncols=3, loc="upper center", columnspacing=1.2)
    return figure


def conditions(judgement: Judgement, texture: Texture) -> Figure | None:
    """Judged blocks at their speed and force, coloured by level error; None without a run."""
    name = shown_run(judgement)
    if name is None:
        return None
    errors = signals.frame_errors(judgement, name).mean(axis=(0, 2))
    figure, axes = new_figure(4.9, 3.4, PAGE)
    if judgement.document["split"] != "foreign":
        _, *speed_force = judgement.trace.picked(texture.card["split"]["train"])
        means = (channel.mean(axis=1) for channel in speed_force)
        axes.plot(*means, "x", color=INK, alpha=0.45, markersize=4, label="training")
    limit = max(1.0, float(np.abs(errors).max()))
    colours = {"c": errors, "cmap": "RdBu_r", "vmin": -limit, "vmax": limit, "edgecolors": INK}
    means = (channel.mean(axis=1) for channel in scored_conditions(judgement))
    points = axes.scatter(*means, s=52, linewidths=0.8, zorder=3, label="judged", **colours)
    (slow, fast), (light, heavy) = (texture.trained_range(channel) for channel in ("speed", "force"))
    corners = [slow, fast, fast, slow, slow], [light, light, heavy, heavy, light]
    axes.plot(*corners, color=INK, alpha=0.6, linewidth=0.8, linestyle=(0, (4, 3)), label="trained range")
    add_colour_bar(figure, points, "level error [dB]", PAGE, ax=axes, pad=0.02, aspect=28)
    axes.set(xlabel="mean speed [mm/s]", ylabel="mean force [N]")
    axes.margins(0.08, 0.12)
    add_legend(axes, PAGE, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), columnspacing=1.2)
    return figure


def reach(judgement: Judgement, texture: Texture) -> Figure | None:
    """Level that is rendered over speed and over force, in the trained range and outside, where it follows a law or is held.

    Dots are frames of the recording at about the other's median. None where a hand cannot be simulated: without an excitation.
    """
    renderer = Renderer(texture)
    if not texture.has_excitation or renderer.native_texture.info.asks_predictor:
        return None
    trace = judgement.trace
    recorded = np.stack([frame_means(channel, trace.rate_hz) for channel in (trace.speed, trace.force)], axis=1)
    level = decibels(frame_means(np.square(trace.acceleration), trace.rate_hz), 1e-12)
    moving = (recorded > (MOVING_SPEED, MOVING_FORCE)).all(axis=1)
    centre = np.median(recorded[moving], axis=0) if moving.any() else np.array([100.0, 0.7])
    figure, panels = new_figure(9.6, 3.2, PAGE, ncols=2, sharey=True)
    reaches = (REACH_SPEED, FADE_SPEED), (REACH_FORCE, FADE_FORCE)
    for i, (axes, channel, unit, (most, least)) in enumerate(
        zip(panels, ("speed", "force"), ("mm/s", "N"), reaches, strict=True)
    ):
        low, high = texture.trained_range(channel)
        low = max(low, least)
        other = centre[1 - i]
        near = moving & (np.abs(np.log(np.maximum(recorded[:, 1 - i], 1e-9) / other)) < REACH_NEAR)
        axes.plot(recorded[near, i], level[near], ".", color=INK, alpha=0.3, markersize=3, label="recorded")
        values = np.geomspace(0.5 * least, max(most, EXTRAPOLATION_LIMIT * high), N_REACH)
        values = np.unique(np.concatenate([values, [low, high]]))
        condition = [(value, other) if i == 0 else (other, value) for value in values]
        levels = np.array([_steady_level(renderer, *pair) for pair in condition])
        inside = (values >= low) & (values <= high)
        axes.plot(values, levels, color=BLUE, linewidth=1.6, linestyle=(0, (3, 2)), label="free run, beyond")
        axes.plot(values[inside], levels[inside], color=BLUE, linewidth=2.4, label="free run")
        axes.axvspan(low, high, color=BLUE, alpha=0.08, linewidth=0)
        at = f"{other:.2g} N" if i == 0 else f"{other:.0f} mm/s"
        axes.set(xscale="log", xlabel=f"{channel} [{unit}], at {at}", xlim=(values[0], values[-1]))
        axes.xaxis.set_major_formatter("{x:g}")
    panels[0].set_ylabel(f"level [dB re 1 {judgement.document['unit']}]")
    add_legend(panels[0], PAGE, loc="lower right")
    return figure


def _steady_level(renderer: Renderer, speed_mm_s: float, force_n: float) -> float:
    """RMS of what is rendered under a steady hand [dB]."""
    renderer.reset(0)
    n, settle = round(2.0 * renderer.rate), round(0.5 * renderer.rate)
    samples = renderer.render(speed_mm_s, force_n, settle + n)[settle:].astype(np.float64)
    return float(decibels(np.square(samples).mean(), 1e-12))


def over_time(judgement: Judgement) -> Figure:
    """Spectrograms, level, speed and force of the scored blocks, joined on one time axis."""
    which, rate_hz, name = shown_blocks(judgement), judgement.trace.rate_hz, shown_run(judgement)
    every = scored_runs(judgement)
    runs = {key: run[:, which] for key, run in every.items()}
    seconds = runs["recorded"].shape[2] / rate_hz
    borders = np.arange(len(which) + 1) * seconds
    pictured = {key: runs[key][0] for key in ("recorded", name) if key in runs}
    n = len(pictured)
    ratios = [1.45] * n + [1.5, 0.75, 0.75]
    figure, panels = new_figure(9.6, 1.6 * n + 4.0, PAGE, nrows=n + 3, sharex=True, height_ratios=ratios)
    frequencies, pooled = signals.densities(judgement, unscored=True)
    highest_hz = max(highest_with_power(frequencies, pooled[key], rate_hz) for key in pictured)
    _draw_spectrograms(panels[:n], pictured, rate_hz, borders, highest_hz)
    label, beside = f"dB re 1 ({judgement.document['unit']})²/Hz", list(panels[:n])
    add_colour_bar(figure, panels[0].images[0], label, PAGE, ax=beside, pad=0.01, aspect=15 * n)
    lines = {key: runs[key] for key in ("recorded", name, "free_run_ar") if key in runs}
    _draw_levels(panels[n], lines, rate_hz, borders, rms(every["recorded"]))
    times = _with_gaps(borders[:-1, None] + np.arange(runs["recorded"].shape[2]) / rate_hz)
    step = max(1, len(times) // 4000)
    labels = "speed\n[mm/s]", "force\n[N]"
    for axes, channel, label in zip(panels[n + 1 :], scored_conditions(judgement), labels, strict=True):
        axes.plot(times[::step], _with_gaps(channel[which])[::step], color=INK, linewidth=1.1)
        axes.set_ylabel(label)
        axes.margins(y=0.15)
    for axes in panels[n:]:
        for border in borders[1:-1]:
            axes.axvline(border, color=INK, alpha=0.45, linewidth=0.8)
    for middle, index in zip(borders[:-1] + seconds / 2, which, strict=True):
        place = {"xy": (middle, 0.04), "xycoords": ("data", "axes fraction"), "ha": "center"}
        panels[-1].annotate(f"block {judgement.blocks[index]}", **place, fontsize=7.5, alpha=0.75, color=INK)
    panels[0].set_xlim(0, borders[-1])
    panels[-1].set_xlabel("scored time, blocks joined [s]")
    figure.align_ylabels()
    return figure


def _draw_spectrograms(
    panels: Any, blocks_of: Mapping[str, Array], rate_hz: float, borders: Array, highest_hz: float
) -> None:
    """Draw a spectrogram of each signal (n_blocks, n) up to a frequency, on the colour scale of the recorded one."""
    cells = {key: _spectrogram(blocks, rate_hz, highest_hz) for key, blocks in blocks_of.items()}
    limit = "half the rate" if highest_hz == rate_hz / 2 else f"{highest_hz:.0f} Hz: 99.9 % of the power or more"
    panels[0].set_title(f"drawn up to {limit}", loc="right", color=INK, fontsize=8.5)
    loudest = float(cells["recorded"][1].max())
    scale = {"cmap": "magma", "vmin": loudest - _SPECTROGRAM_DB, "vmax": loudest}
    for axes, (key, (edges, density)) in zip(panels, cells.items(), strict=True):
        extent = (0, borders[-1], *edges)
        axes.imshow(density, origin="lower", aspect="auto", interpolation="none", extent=extent, **scale)
        axes.grid(visible=False)
        axes.set_ylabel("frequency\n[Hz]")
        axes.set_title(LABELS[key], loc="left", color=COLOURS[key], fontsize=10)
        for border in borders[1:-1]:
            axes.axvline(border, color="white", linewidth=1.2)


def _draw_levels(axes: Any, runs: Mapping[str, Array], rate_hz: float, borders: Array, reference: float) -> None:
    """Draw the frame levels of each signal (n_seeds, n_blocks, n), and the range of the seeds of the texture's run."""
    frame_s = max(1, round(FRAME_MS * rate_hz / 1000)) / rate_hz
    for key, samples in runs.items():
        levels = frame_levels(samples, rate_hz, reference)
        times = _with_gaps(borders[:-1, None] + (np.arange(levels.shape[-1]) + 0.5) * frame_s)
        levels = np.stack([_with_gaps(run) for run in levels])
        style = {"linewidth": 1.8 if key == "recorded" else 1.3, "linestyle": STYLES.get(key, "solid")}
        axes.plot(times, levels.mean(axis=0), color=COLOURS[key], label=LABELS[key], **style)
        if len(levels) > 1 and key != "free_run_ar":
            low, high = levels.min(axis=0), levels.max(axis=0)
            axes.fill_between(times, low, high, color=COLOURS[key], alpha=0.22, linewidth=0)
    axes.set_ylabel("level\n[dB re recorded]")
    add_legend(axes, PAGE, ncols=len(runs), loc="lower right", bbox_to_anchor=(1.0, 0.98), borderaxespad=0)


def _spectrogram(blocks: Array, rate_hz: float, highest_hz: float) -> tuple[tuple[float, float], Array]:
    """Lowest and highest edge [Hz] and the density [dB], shape (k, time), of joined blocks (n_blocks, n)."""
    from scipy import signal

    n = blocks.shape[1]
    n_segment = min(2 ** round(math.log2(max(16.0, _SPECTROGRAM_MS * rate_hz / 1000))), 2 ** int(math.log2(n // 4)))
    hop = max(n_segment // 8, -(-blocks.size // _SPECTROGRAM_COLUMNS))
    # Each block is mirrored at its ends, so that no window crosses a border.
    padded = np.pad(blocks, ((0, 0), (n_segment // 2, n_segment // 2 + n % 2)), mode="reflect")
    frequencies, _, density = signal.spectrogram(padded, rate_hz, "hann", n_segment, n_segment - hop, detrend=False)
    shown = frequencies <= highest_hz
    density = density[:, shown, : -(-n // hop)].swapaxes(0, 1).reshape(int(shown.sum()), -1)
    half = frequencies[1] / 2
    return (-half, float(frequencies[shown][-1]) + half), decibels(density)


def _with_gaps(blocks: Array) -> Array:
    """Blocks (n_blocks, n) in one row with a NaN after each, which interrupts a drawn line."""
    return np.pad(blocks, ((0, 0), (0, 1)), constant_values=np.nan).ravel()
