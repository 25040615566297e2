"""Figures of a recording: channels over time, coverage of speed and force, density of the vibration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from foten.dsp import Array
from foten.recording.inspection.speed_force import HAND_HZ
from foten.recording.inspection.values import CELL_S, NOTE, Finding, Inspection
from foten.recording.recording import UNITS, Recording
from foten.reporting.figure import COLOURS, Style, add_colour_bar, add_legend, new_figure, write_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STYLE = Style(grid=0.25)
_COLOURS = dict(zip(("acceleration", "speed", "force", "position"), COLOURS, strict=False))
_MARKED = ("spikes", "clipping", "gaps", "frozen", "order", "sign", "contact", "jumps")
_COLUMNS = 3000  # of an envelope: more than pixels, so that no spike is lost


def _title(recording: Recording, what: str) -> str:
    return f"{recording.texture}: {what}" if recording.texture else what[0].upper() + what[1:]


def overview(recording: Recording, inspection: Inspection) -> Figure:
    """Channels over time, with a mark at each place that a finding lists."""
    names = [name for name in UNITS if name in recording]
    figure, panels = new_figure(10, 1.0 + 1.7 * len(names), _STYLE, nrows=len(names), sharex=True, squeeze=False)
    for axes, name in zip(panels[:, 0], names, strict=True):
        channel, colour = recording[name], _COLOURS[name.split("_")[0]]
        if channel.samples.size <= 2 * _COLUMNS:
            axes.plot(channel.times, channel.samples, color=colour, linewidth=0.8)
        else:
            starts = np.linspace(0, channel.samples.size, _COLUMNS, endpoint=False).astype(np.int64)
            low, high = (extreme.reduceat(channel.samples, starts) for extreme in (np.minimum, np.maximum))
            axes.fill_between(channel.times[starts], low, high, color=colour, linewidth=0.4, edgecolor=colour)
        axes.set_ylabel(f"{name.replace('_', ' ')}\n[{UNITS[name].replace('^2', '²')}]")
        axes.margins(x=0.01)
        _keep_readable(axes, channel.samples, UNITS[name])
        _mark(
            axes,
            [f for f in inspection.findings if f.channel == name and f.places_s and f.code in _MARKED and f.take == 1],
        )
    figure.align_ylabels()
    panels[-1, 0].set_xlabel("time [s]")
    takes = f", take 1 of {len(recording.takes)}" if recording.later_takes else ""
    panels[0, 0].set_title(_title(recording, f"recorded channels{takes}"))
    return figure


def _mark(axes: Any, findings: list[Finding]) -> None:
    """Mark the places of findings in rows above a channel, with a legend."""
    for k, finding in enumerate(findings):
        height = np.full(len(finding.places_s), 0.96 - 0.09 * k)
        style = {"marker": "vos^DPX*"[_MARKED.index(finding.code)], "markersize": 4.5, "color": "black"}
        if finding.severity == NOTE:
            style |= {"color": "#555555", "markerfacecolor": "white"}
        across = axes.get_xaxis_transform()
        axes.plot(finding.places_s, height, transform=across, linestyle="none", label=finding.code, **style)
    if findings:
        bottom, top = axes.get_ylim()
        axes.set_ylim(bottom, top + 0.09 * (len(findings) + 1) * (top - bottom))
        add_legend(axes, loc="center left", bbox_to_anchor=(1.0, 0.5))


def _keep_readable(axes: Any, samples: Array, unit: str) -> None:
    """Limit the axis to the usual values where a few spikes are far beyond them, and write their size on it."""
    low, high = np.quantile(samples, [0.002, 0.998])
    margin = max(high - low, 1e-12)
    if samples.max() - samples.min() > 5 * margin:
        axes.set_ylim(low - 0.2 * margin, high + 0.2 * margin)
        cut = f"axis cut: from {samples.min():.6g} to {samples.max():.6g} {unit}"
        box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1}
        axes.text(0.995, 0.03, cut, transform=axes.transAxes, ha="right", fontsize=8, bbox=box)


def coverage(recording: Recording, inspection: Inspection) -> Figure | None:
    """Seconds spent at each speed and force, or None without both channels."""
    from matplotlib.colors import LogNorm

    cells = inspection.coverage
    if cells is None:
        return None
    figure, axes = new_figure(7.5, 5)
    shown = np.ma.masked_less(cells.seconds.T, 1e-9)
    norm = LogNorm(CELL_S / 10, max(float(cells.seconds.max()), 10 * CELL_S))
    mesh = axes.pcolormesh(cells.speed_edges, cells.force_edges, shown, cmap="viridis", norm=norm)
    axes.vlines(cells.speed_edges, *cells.force_edges[[0, -1]], color="white", linewidth=0.6)
    axes.hlines(cells.force_edges, *cells.speed_edges[[0, -1]], color="white", linewidth=0.6)
    add_colour_bar(figure, mesh, "time spent [s]")
    axes.set(xlabel="scanning speed [mm/s]", ylabel="normal force [N]", facecolor="#eeeeee")
    visited = f"{cells.covered} of {cells.seconds.size} cells visited for {CELL_S * 1000:g} ms or more"
    axes.set_title(_title(recording, visited) + "\n(grey: never)", fontsize=11)
    return figure


def density(recording: Recording, inspection: Inspection) -> Figure | None:
    """Power spectral density of each acceleration axis, or None without acceleration."""
    if not inspection.psd:
        return None
    figure, axes = new_figure(8, 4.5, _STYLE)
    for colour, (name, (frequency, power)) in zip(COLOURS, inspection.psd.items(), strict=False):
        axes.loglog(frequency, np.maximum(power, 1e-30), color=colour, linewidth=1, label=name.replace("_", " "))
    frequencies, powers = zip(*inspection.psd.values(), strict=True)
    axes.set_xlim(min(*(f[0] for f in frequencies), HAND_HZ / 2), max(f[-1] for f in frequencies) * 1.05)
    axes.axvspan(axes.get_xlim()[0], HAND_HZ, color="0.5", alpha=0.15, linewidth=0)
    grey = f"grey: below {HAND_HZ:g} Hz, the hand's own movement"
    axes.text(0.01, 0.03, grey, transform=axes.transAxes, fontsize=8)
    # Above a sensor's anti-alias filter only rounding is left, over ten decades.
    axes.set_ylim(bottom=max(axes.get_ylim()[0], max(float(power.max()) for power in powers) * 1e-9))
    axes.set(xlabel="frequency [Hz]", ylabel="density [(m/s²)²/Hz]")
    axes.set_title(_title(recording, "power spectral density of the acceleration"))
    if len(inspection.psd) > 1:
        add_legend(axes)
    return figure


def write_pictures(recording: Recording, inspection: Inspection, folder: Path) -> list[Path]:
    """Write overview.png, coverage.png and psd.png, those that the channels allow, and return their paths."""
    written = []
    for name, draw in (("overview.png", overview), ("coverage.png", coverage), ("psd.png", density)):
        figure = draw(recording, inspection)
        if figure is not None:
            write_figure(figure, folder / name)
            written.append(folder / name)
    return written
