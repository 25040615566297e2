"""Figures of a judgement: waveform, spectrum, bands, conditions, and everything over time."""

from __future__ import annotations

import io
import math
import re
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from foten.evaluate import metrics
from foten.evaluate.evaluate import Judgement
from foten.evaluate.free_run import scored
from foten.families.texture_file import Texture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

N_WAVEFORM = 400  # samples
N_BLOCKS_SHOWN = 12  # over time; more would be narrower than a frame
LABELS = {
    "recorded": "recorded",
    "free_run": "free run",
    "free_run_deterministic": "without excitation",
    "free_run_ar": "AR(20)",
    "ceiling": "ceiling",
}
"""The runs of a judgement, as every figure and table calls them, in the order they are drawn."""

# Drawn in this colour and written as the page's own text colour, so that a figure is legible on light and dark.
_INK = "#010203"
# Told apart with any colour vision and by lightness on white and on black.
_COLOURS = {
    "recorded": _INK,
    "free_run": "#2b83cf",
    "free_run_deterministic": "#e08a1e",
    "free_run_ar": "#1a9c72",
    "ceiling": "#b77ab0",
}
_STYLES = {
    "free_run_deterministic": (0, (4, 2)),
    "free_run_ar": (0, (6, 1.5, 1.5, 1.5)),
    "ceiling": (0, (1.5, 1.5)),
}
_SPECTROGRAM_MS = 64.0  # of a spectrogram's window: a texture's level changes within a few frames of 40 ms
_SPECTROGRAM_COLUMNS = 700
_SPECTROGRAM_DB = 50.0  # of the colour scale, down from the loudest recorded cell


def shown_run(judgement: Judgement) -> str | None:
    """Return the name of the run that stands for the texture: with excitation where there is one; None without any."""
    return next(
        (name for name in ("free_run", "free_run_deterministic") if name in judgement.synthesized), None
    )


def scored_channels(judgement: Judgement) -> tuple[Array, Array, Array]:
    """Return recorded acceleration [m/s²], speed [mm/s] and force [N] of the scored samples, each (n_blocks, n)."""
    trace, part = judgement.trace, scored(judgement.trace.block)
    acceleration, speed, force = (
        trace.blocks(channel)[list(judgement.blocks), part]
        for channel in (trace.acceleration, trace.speed, trace.force)
    )
    return acceleration, speed, force


def shown_blocks(judgement: Judgement) -> NDArray[np.int64]:
    """Return which of the judged blocks are drawn over time: all, or 12 spread evenly."""
    n = len(judgement.blocks)
    return np.unique(np.linspace(0, n - 1, min(n, N_BLOCKS_SHOWN)).round().astype(np.int64))


def typical_block(judgement: Judgement) -> int:
    """Return which of the judged blocks has the median recorded level (the lower of two)."""
    levels = np.square(scored_channels(judgement)[0]).mean(axis=1)
    return int(np.argsort(levels, kind="stable")[(len(levels) - 1) // 2])


def level_errors(judgement: Judgement, name: str) -> Array:
    """Return a run's mean level error [dB] of each judged block, mean over frames of 40 ms and seeds, shape (n_blocks,)."""
    recorded, _, _ = scored_channels(judgement)
    reference = float(np.sqrt(np.square(recorded).mean()))
    synthesized = judgement.synthesized[name][:, :, scored(judgement.trace.block)]
    of = [metrics.frame_levels(x, judgement.trace.rate_hz, reference) for x in (recorded, synthesized)]
    return np.asarray((of[1] - of[0]).mean(axis=(0, 2)))


def waveform(judgement: Judgement) -> Figure:
    """Return the first 400 scored samples of the typical block: recorded, the texture's run, AR(20); one scale."""
    block, part = typical_block(judgement), scored(judgement.trace.block)
    rows = {"recorded": scored_channels(judgement)[0][block, :N_WAVEFORM]}
    for name in (shown_run(judgement), "free_run_ar"):
        if name is not None and name in judgement.synthesized:
            rows[name] = judgement.synthesized[name][0, block, part][:N_WAVEFORM]
    figure, panels = _figure(
        9.6, 0.55 + 1.15 * len(rows), nrows=len(rows), sharex=True, sharey=True, squeeze=False
    )
    times = np.arange(len(rows["recorded"])) / judgement.trace.rate_hz * 1000
    for axes, (name, samples) in zip(panels[:, 0], rows.items(), strict=True):
        axes.plot(times, samples, color=_COLOURS[name], linewidth=1.0)
        axes.axhline(0, color=_INK, alpha=0.25, linewidth=0.6)
        axes.set_title(LABELS[name], loc="left", color=_COLOURS[name], fontsize=10)
        axes.set_xlim(0, len(times) / judgement.trace.rate_hz * 1000)
    limit = 1.08 * max(float(np.abs(samples).max()) for samples in rows.values())
    panels[0, 0].set_ylim(-limit, limit)
    panels[-1, 0].set_xlabel("time since the scored part began [ms]")
    figure.supylabel("acceleration [m/s²]", fontsize=9, color=_INK)
    return figure


def densities(judgement: Judgement) -> tuple[Array, dict[str, Array]]:
    """Return the scored frequencies [Hz] and each run's density [(m/s²)²/Hz] there, pooled over blocks and seeds.

    The spectra are those that the log-spectral distance is measured on.
    """
    rate_hz, part = judgement.trace.rate_hz, scored(judgement.trace.block)
    recorded, _, _ = scored_channels(judgement)
    n_segment = metrics.segment_length(judgement.trace.block)
    frequencies, density = metrics.welch(recorded, rate_hz, n_segment)
    bins = metrics.scored_bins(frequencies, rate_hz)
    pooled = {"recorded": density.mean(axis=0)[bins]}
    for name in LABELS:
        if name in judgement.synthesized:
            of = metrics.welch(judgement.synthesized[name][:, :, part], rate_hz, n_segment)[1]
            pooled[name] = of.mean(axis=(0, 1))[bins]
    return frequencies[bins], pooled


def spectrum(judgement: Judgement) -> Figure:
    """Return the pooled power spectral densities [dB re 1 (m/s²)²/Hz] of every run over log frequency."""
    frequencies, pooled = densities(judgement)
    in_db = {name: 10 * np.log10(np.maximum(density, 1e-30)) for name, density in pooled.items()}
    figure, axes = _figure(9.6, 3.7)
    top = max(float(line.max()) for line in in_db.values())
    lowest = min(float(line.min()) for name, line in in_db.items() if name != "free_run_deterministic")
    bottom = max(lowest, float(in_db["recorded"].min()) - 20) - 4  # a silent run may not flatten the others
    for name, line in in_db.items():
        hidden = " (below the axis)" if line.max() < bottom else ""
        axes.plot(
            frequencies,
            line,
            color=_COLOURS[name],
            linewidth=2.2 if name == "recorded" else 1.5,
            linestyle=_STYLES.get(name, "solid"),
            marker="o" if len(frequencies) < 12 else None,
            markersize=3,
            zorder=3 if name in ("recorded", "free_run") else 2,
            label=LABELS[name] + hidden,
        )
    axes.set_ylim(bottom, top + 3)
    _log_hertz(axes, metrics.LOWEST_HZ, min(metrics.HIGHEST_HZ, 0.45 * judgement.trace.rate_hz))
    axes.set_ylabel("density [dB re 1 (m/s²)²/Hz]")
    axes.set_xlabel("frequency [Hz]")
    axes.legend(frameon=False, fontsize=9, labelcolor=_INK)
    return figure


def bands(judgement: Judgement) -> Figure | None:
    """Return the energy error of the nine bands for the texture's run, AR(20) and the ceiling; None without any."""
    document = judgement.document
    found = {
        name: document[name]["band_errors_db"]
        for name in (shown_run(judgement), "free_run_ar", "ceiling")
        if name is not None and document[name].get("band_errors_db")
    }
    if not found:
        return None
    figure, axes = _figure(4.9, 3.4)
    width = 0.8 / len(found)
    for k, (name, errors) in enumerate(found.items()):
        known = [i for i, error in enumerate(errors) if error is not None]
        left = np.array(known) - 0.4 + k * width
        heights = [errors[i] for i in known]
        axes.bar(left, heights, 0.92 * width, align="edge", color=_COLOURS[name], label=LABELS[name])
    axes.axhline(0, color=_INK, linewidth=0.8)
    for i, error in enumerate(next(iter(found.values()))):
        if error is None:
            axes.text(
                i, 0, " no bin", rotation=90, ha="center", va="bottom", fontsize=8, color=_INK, alpha=0.6
            )
    edges = metrics.band_edges(judgement.trace.rate_hz)
    axes.set_xticks(np.arange(len(edges)) - 0.5, [f"{edge:.0f}" for edge in edges])
    axes.tick_params(axis="x", labelsize=8)
    axes.set_xlim(-0.55, len(edges) - 1.45)
    axes.grid(visible=False, axis="x")
    axes.set_xlabel("band edges [Hz]")
    axes.set_ylabel("energy error [dB]")
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.16 * (high - low))
    axes.legend(frameon=False, fontsize=8.5, ncols=3, loc="upper center", columnspacing=1.2, labelcolor=_INK)
    return figure


def conditions(judgement: Judgement, texture: Texture) -> Figure | None:
    """Return the judged blocks in the plane of speed and force, coloured by level error; None without a run."""
    name = shown_run(judgement)
    if name is None:
        return None
    trace = judgement.trace
    _, speed, force = scored_channels(judgement)
    errors = level_errors(judgement, name)
    figure, axes = _figure(4.9, 3.4)
    if judgement.document["split"] != "foreign":
        train = list(texture.card["split"]["train"])
        means = (trace.blocks(channel)[train].mean(axis=1) for channel in (trace.speed, trace.force))
        axes.plot(*means, "x", color=_INK, alpha=0.45, markersize=4, label="training")
    limit = max(1.0, float(np.abs(errors).max()))
    points = axes.scatter(
        speed.mean(axis=1),
        force.mean(axis=1),
        c=errors,
        s=52,
        cmap="RdBu_r",
        vmin=-limit,
        vmax=limit,
        edgecolors=_INK,
        linewidths=0.8,
        zorder=3,
        label="judged",
    )
    (low, high), (least, most) = (texture.trained_range(channel) for channel in ("speed", "force"))
    axes.plot(
        [low, high, high, low, low],
        [least, least, most, most, least],
        color=_INK,
        alpha=0.6,
        linewidth=0.8,
        linestyle=(0, (4, 3)),
        label="trained range",
    )
    bar = figure.colorbar(points, ax=axes, pad=0.02, aspect=28)
    bar.set_label("level error [dB]", color=_INK)
    bar.outline.set_visible(False)
    bar.ax.tick_params(color=_INK, labelcolor=_INK, labelsize=8)
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
        labelcolor=_INK,
    )
    return figure


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
    figure, panels = _figure(
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
        axes.set_title(LABELS[key], loc="left", color=_COLOURS[key], fontsize=10)
        for border in borders[1:-1]:
            axes.axvline(border, color="white", linewidth=1.2)
    bar = figure.colorbar(panels[0].images[0], ax=list(panels[:n]), pad=0.01, aspect=15 * n)
    bar.set_label("dB re 1 (m/s²)²/Hz", color=_INK)
    bar.outline.set_visible(False)
    bar.ax.tick_params(color=_INK, labelcolor=_INK, labelsize=8)

    reference = float(np.sqrt(np.square(scored_channels(judgement)[0]).mean()))
    lines = {"recorded": recorded[None]} | {key: runs[key] for key in (name, "free_run_ar") if key in runs}
    frame_s = max(1, round(metrics.FRAME_MS * rate_hz / 1000)) / rate_hz
    axes = panels[n]
    for key, samples in lines.items():
        levels = metrics.frame_levels(samples, rate_hz, reference)
        times = borders[:-1, None] + (np.arange(levels.shape[-1]) + 0.5) * frame_s
        times, levels = _with_gaps(times), np.stack([_with_gaps(run) for run in levels])
        style = {"linewidth": 1.8 if key == "recorded" else 1.3, "linestyle": _STYLES.get(key, "solid")}
        axes.plot(times, levels.mean(axis=0), color=_COLOURS[key], label=LABELS[key], **style)
        if len(levels) > 1 and key == name:
            low, high = levels.min(axis=0), levels.max(axis=0)
            axes.fill_between(times, low, high, color=_COLOURS[key], alpha=0.22, linewidth=0)
    axes.set_ylabel("level\n[dB re recorded]")
    axes.legend(
        frameon=False,
        fontsize=8.5,
        ncols=len(lines),
        loc="lower right",
        bbox_to_anchor=(1.0, 0.98),
        borderaxespad=0,
        labelcolor=_INK,
    )
    times = _with_gaps(borders[:-1, None] + np.arange(recorded.shape[1]) / rate_hz)
    step = max(1, len(times) // 4000)
    for axes, channel, label in (
        (panels[n + 1], speed, "speed\n[mm/s]"),
        (panels[n + 2], force, "force\n[N]"),
    ):
        axes.plot(times[::step], _with_gaps(channel)[::step], color=_INK, linewidth=1.1)
        axes.set_ylabel(label)
        axes.margins(y=0.15)
    for axes in panels[n:]:
        for border in borders[1:-1]:
            axes.axvline(border, color=_INK, alpha=0.45, linewidth=0.8)
    for border, index in zip(borders, which, strict=False):
        panels[-1].annotate(
            f"block {judgement.blocks[index]}",
            (border + seconds / 2, 0.04),
            xycoords=("data", "axes fraction"),
            ha="center",
            fontsize=7.5,
            alpha=0.75,
            color=_INK,
        )
    panels[0].set_xlim(0, borders[-1])
    panels[-1].set_xlabel("scored time, blocks joined [s]")
    figure.align_ylabels()
    return figure


def inline_svg(figure: Figure, name: str, description: str) -> str:
    """Return a figure as an SVG element for an HTML page; the same figure gives the same text.

    Args:
        figure: drawn by this module.
        name: of letters, unlike that of any other figure on the page: it keeps their identifiers apart.
        description: for those who do not see it.
    """
    import html

    import matplotlib

    buffer = io.StringIO()
    # Text stays text: it can be searched, takes the page's font and is a tenth of the outlines' size.
    with matplotlib.rc_context({"svg.hashsalt": name, "svg.fonttype": "none", "svg.image_inline": True}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    # Inside HTML the parser knows both namespaces.
    svg = re.sub(r' xmlns(?::\w+)?="[^"]*"', "", svg)
    svg = re.sub(r"(\bid=\"|url\(#|href=\"#)", rf"\g<1>{name}-", svg)
    svg = re.sub(r"font-family: [^;\"]*", "font-family: inherit", svg)
    # A style element would rule the whole page; both properties are inherited from the root as well.
    svg = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", svg, flags=re.DOTALL)
    svg = svg.replace(_INK, "currentColor")
    return svg.replace(
        "<svg ", f'<svg role="img" aria-label="{html.escape(description)}" style="stroke-linejoin: round" ', 1
    ).rstrip()


def _figure(width: float, height: float, **options: Any) -> tuple[Figure, Any]:
    # The object interface leaves the user's backend and open figures alone.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    ratios = options.pop("height_ratios", None)
    panels = figure.subplots(**options, gridspec_kw={"height_ratios": ratios} if ratios else None)
    for axes in np.atleast_1d(panels).ravel():
        axes.spines[["top", "right"]].set_visible(False)
        for spine in axes.spines.values():
            spine.set_color(_INK)
            spine.set_alpha(0.5)
        axes.tick_params(color=_INK, labelcolor=_INK, labelsize=9)
        axes.xaxis.label.set_color(_INK)
        axes.yaxis.label.set_color(_INK)
        axes.grid(color=_INK, alpha=0.12, linewidth=0.7)
        axes.set_axisbelow(True)
        axes.xaxis.label.set_size(9)
        axes.yaxis.label.set_size(9)
    return figure, panels


def _log_hertz(axes: Any, low: float, high: float) -> None:
    from matplotlib.ticker import NullFormatter

    axes.set_xscale("log")
    axes.set_xlim(low, high)
    ticks = [tick for tick in (20, 30, 50, 100, 200, 300, 500, 1000) if low <= tick <= 1.001 * high]
    ticks += [] if ticks and high < 1.2 * ticks[-1] else [round(high)]
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(color=_INK, alpha=0.06, linewidth=0.6, which="minor")


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
