"""Figures of a judgement: waveform, spectrum, bands, conditions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from foten.evaluate import metrics
from foten.evaluate.evaluate import Judgement
from foten.evaluate.free_run import scored
from foten.evaluate.report.drawing import COLOURS, INK, STYLES, log_hertz, new_figure, style_colorbar
from foten.evaluate.report.signals import (
    LABELS,
    N_WAVEFORM,
    densities,
    level_errors,
    scored_channels,
    shown_run,
    typical_block,
)
from foten.families.texture_file import Texture

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def waveform(judgement: Judgement) -> Figure:
    """Return the first 400 scored samples of the typical block: recorded, the texture's run, AR(20); one scale."""
    block, part = typical_block(judgement), scored(judgement.trace.block)
    rows = {"recorded": scored_channels(judgement)[0][block, :N_WAVEFORM]}
    for name in (shown_run(judgement), "free_run_ar"):
        if name is not None and name in judgement.synthesized:
            rows[name] = judgement.synthesized[name][0, block, part][:N_WAVEFORM]
    figure, panels = new_figure(9.6, 0.55 + 1.15 * len(rows), nrows=len(rows), sharex=True, sharey=True, squeeze=False)
    times = np.arange(len(rows["recorded"])) / judgement.trace.rate_hz * 1000
    for axes, (name, samples) in zip(panels[:, 0], rows.items(), strict=True):
        axes.plot(times, samples, color=COLOURS[name], linewidth=1.0)
        axes.axhline(0, color=INK, alpha=0.25, linewidth=0.6)
        axes.set_title(LABELS[name], loc="left", color=COLOURS[name], fontsize=10)
        axes.set_xlim(0, len(times) / judgement.trace.rate_hz * 1000)
    limit = 1.08 * max(float(np.abs(samples).max()) for samples in rows.values())
    panels[0, 0].set_ylim(-limit, limit)
    panels[-1, 0].set_xlabel("time since the scored part began [ms]")
    figure.supylabel("acceleration [m/s²]", fontsize=9, color=INK)
    return figure


def spectrum(judgement: Judgement) -> Figure:
    """Return the pooled power spectral densities [dB re 1 (m/s²)²/Hz] of every run over log frequency."""
    frequencies, pooled = densities(judgement)
    in_db = {name: 10 * np.log10(np.maximum(density, 1e-30)) for name, density in pooled.items()}
    figure, axes = new_figure(9.6, 3.7)
    top = max(float(line.max()) for line in in_db.values())
    lowest = min(float(line.min()) for name, line in in_db.items() if name != "free_run_deterministic")
    bottom = max(lowest, float(in_db["recorded"].min()) - 20) - 4  # a silent run may not flatten the others
    for name, line in in_db.items():
        hidden = " (below the axis)" if line.max() < bottom else ""
        axes.plot(
            frequencies,
            line,
            color=COLOURS[name],
            linewidth=2.2 if name == "recorded" else 1.5,
            linestyle=STYLES.get(name, "solid"),
            marker="o" if len(frequencies) < 12 else None,
            markersize=3,
            zorder=3 if name in ("recorded", "free_run") else 2,
            label=LABELS[name] + hidden,
        )
    axes.set_ylim(bottom, top + 3)
    log_hertz(axes, metrics.LOWEST_HZ, min(metrics.HIGHEST_HZ, 0.45 * judgement.trace.rate_hz))
    axes.set_ylabel("density [dB re 1 (m/s²)²/Hz]")
    axes.set_xlabel("frequency [Hz]")
    axes.legend(frameon=False, fontsize=9, labelcolor=INK)
    return figure


def bands(judgement: Judgement) -> Figure | None:
    """Return the energy error of the nine bands for the texture's run, AR(20) and the ceiling; None without any."""
    document = judgement.document
    shown = {
        name: document[name]["band_errors_db"]
        for name in (shown_run(judgement), "free_run_ar", "ceiling")
        if name is not None and document[name].get("band_errors_db")
    }
    if not shown:
        return None
    figure, axes = new_figure(4.9, 3.4)
    width = 0.8 / len(shown)
    for k, (name, errors) in enumerate(shown.items()):
        known = [i for i, error in enumerate(errors) if error is not None]
        left = np.array(known) - 0.4 + k * width
        heights = [errors[i] for i in known]
        axes.bar(left, heights, 0.92 * width, align="edge", color=COLOURS[name], label=LABELS[name])
    axes.axhline(0, color=INK, linewidth=0.8)
    for i, error in enumerate(next(iter(shown.values()))):
        if error is None:
            axes.text(i, 0, " no bin", rotation=90, ha="center", va="bottom", fontsize=8, color=INK, alpha=0.6)
    edges = metrics.band_edges(judgement.trace.rate_hz)
    axes.set_xticks(np.arange(len(edges)) - 0.5, [f"{edge:.0f}" for edge in edges])
    axes.tick_params(axis="x", labelsize=8)
    axes.set_xlim(-0.55, len(edges) - 1.45)
    axes.grid(visible=False, axis="x")
    axes.set_xlabel("band edges [Hz]")
    axes.set_ylabel("energy error [dB]")
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.16 * (high - low))
    axes.legend(frameon=False, fontsize=8.5, ncols=3, loc="upper center", columnspacing=1.2, labelcolor=INK)
    return figure


def conditions(judgement: Judgement, texture: Texture) -> Figure | None:
    """Return the judged blocks at their speed and force, coloured by level error; None without a run."""
    name = shown_run(judgement)
    if name is None:
        return None
    trace = judgement.trace
    _, speed, force = scored_channels(judgement)
    errors = level_errors(judgement, name)
    figure, axes = new_figure(4.9, 3.4)
    if judgement.document["split"] != "foreign":
        train = list(texture.card["split"]["train"])
        means = (trace.blocks(channel)[train].mean(axis=1) for channel in (trace.speed, trace.force))
        axes.plot(*means, "x", color=INK, alpha=0.45, markersize=4, label="training")
    limit = max(1.0, float(np.abs(errors).max()))
    points = axes.scatter(
        speed.mean(axis=1),
        force.mean(axis=1),
        c=errors,
        s=52,
        cmap="RdBu_r",
        vmin=-limit,
        vmax=limit,
        edgecolors=INK,
        linewidths=0.8,
        zorder=3,
        label="judged",
    )
    (low, high), (least, most) = (texture.trained_range(channel) for channel in ("speed", "force"))
    axes.plot(
        [low, high, high, low, low],
        [least, least, most, most, least],
        color=INK,
        alpha=0.6,
        linewidth=0.8,
        linestyle=(0, (4, 3)),
        label="trained range",
    )
    style_colorbar(figure.colorbar(points, ax=axes, pad=0.02, aspect=28), "level error [dB]")
    axes.set_xlabel("mean speed [mm/s]")
    axes.set_ylabel("mean force [N]")
    axes.margins(0.08, 0.12)
    axes.legend(
        frameon=False,
        fontsize=8.5,
        ncols=3,
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        columnspacing=1.2,
        labelcolor=INK,
    )
    return figure
