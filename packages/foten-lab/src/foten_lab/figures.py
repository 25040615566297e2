"""The paper's figures from result files: the split, windows, losses and thresholds, waveforms, spectra."""

import itertools
import json
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from foten.dsp import Array
from foten.evaluate.warm_start import CONVERGED_MS, ERROR_FRAME_MS, SILENT_DB
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.split import split_blocks
from foten.reporting.figure import COLOURS, PRINT, add_legend, new_figure, panel_grid
from foten_lab.experiment import Run, recording_of, texture_name
from foten_lab.results import Results, chosen_results, label_of

RECORDED = PRINT.ink
PARTS = {"train": "#8fd3e8", "validation": "#f3e28a", "test": "#f0a3a0"}
RANGE = "#c9c9c9"
LOWEST_DB = -60.0  # level that is drawn


def figures(
    results: Results, recordings: Path | None = None, say: Callable[[str], None] = lambda text: None
) -> Iterator[tuple[str, Figure]]:
    """Yield each figure that the results have the numbers for, and its name; say which are left out, and why.

    Args:
        recordings: folder of the recordings that were learned from; by default their paths in the results are used.
    """
    results = chosen_results(results)
    try:
        yield "figure-4", split(results[0], recordings)
    except (ValueError, OSError) as error:
        say(f"figure-4 is left out, as it is drawn from the recording: {error}")
    # One method at a time: between methods more differs than the window.
    methods = list(dict.fromkeys((result["run"]["method"], result["run"]["model"]) for result in results))
    for k, (method, model) in enumerate(methods, 1):
        of_method = [result for result in results if result["run"]["method"] == method and _has_one_step(result)]
        alone = [other for _, other in methods].count(model) == 1
        name = f"figure-5-{model if alone else f'{k}-{_file_name(method)}'}"
        for others, some in _by_other_settings(of_method, ("window", "loss")):
            if len({(result["run"]["sizes"]["window"], result["run"]["train"]["loss"]) for result in some}) > 1:
                yield f"{name}{others}", windows_and_losses(_mean_errors(some, ("train", "loss"), ("sizes", "window")))
        huber = [result for result in of_method if result["run"]["train"]["loss"] == "huber"]
        for others, some in _by_other_settings(huber, ("delta",)):
            if len({result["run"]["train"]["delta"] for result in some}) > 1:
                yield f"{name}{others}-delta", thresholds(some)
    with_signals = [result for result in results if result.get("signals")]
    if with_signals:
        yield "figure-6", waveforms(with_signals)
        of_paper = [result for result in with_signals if result["run"]["model"] == "foten"]
        if of_paper and len(methods) > 1:
            yield "figure-6-foten", waveforms(with_signals, "foten")  # as printed, large
        yield "figure-6-convergence", convergence(with_signals)
        yield "figure-7", spectra(with_signals)


def _by_other_settings(results: Results, drawn: Sequence[str]) -> list[tuple[str, Results]]:
    """Results grouped by all settings that are not drawn, each group with a suffix for the file's name.

    A run of one grid belongs to another grid's figure too, where its settings are that grid's: the suffix is the shortest.
    """
    groups, suffixes = defaultdict(list), defaultdict(set)
    for result in results:
        run = result["run"]
        settings = {k: v for k, v in (run["sizes"] | run["train"]).items() if k not in (*drawn, "seed")}
        key = json.dumps(settings, sort_keys=True)
        others = " ".join(f"{k} {v}" for k, v in run["cell"].items() if k not in drawn)
        groups[key].append(result)
        suffixes[key].add(f"-{_file_name(others)}" if others else "")
    return [(min(suffixes[key], key=len), group) for key, group in groups.items()]


def _file_name(method: str) -> str:
    return re.sub(r"[^A-Za-z0-9]+", "-", method).strip("-").lower()


def _has_one_step(result: Mapping[str, Any]) -> bool:
    sizes, train, one_step = result["run"]["sizes"], result["run"]["train"], result["evaluation"]["one_step"]
    return "window" in sizes and "loss" in train and one_step["mae_scaled"] is not None


def _mean_errors(results: Results, *settings: tuple[str, str]) -> dict[tuple[Any, ...], Array]:
    """Mean one-step errors on the test and on the validation blocks, (2,), by texture and settings of a run."""
    errors = defaultdict(list)
    for result in results:
        key = (result["run"]["texture"], *(result["run"][part][name] for part, name in settings))
        errors[key].append((result["evaluation"]["one_step"]["mae_scaled"], result["validation_mae_scaled"]))
    return {key: np.mean(of, axis=0) for key, of in errors.items()}


def split(result: Mapping[str, Any], recordings: Path | None = None) -> Figure:
    """Recording's acceleration, speed and force over the blocks of its split, as Fig. 4.

    Raises:
        FileNotFoundError: the recording is missing.
        ValueError: it is another one than was learned from.
    """
    run = Run(**result["run"])
    if run.seconds is None and recordings is not None:
        run = replace(run, texture=str(recordings / Path(run.texture).name))
    recording = recording_of(run)
    if recording.sha256() != result["recording_sha256"]:
        raise ValueError(f"{run.texture} is not what was learned from")
    trace = preprocess(recording, PreprocessConfig(**run.preprocess))
    parts = split_blocks(trace, seed=run.split_seed)
    figure, panels = new_figure(10.0, 5.0, nrows=3, sharex=True)
    length, times = trace.block / trace.rate_hz, np.arange(len(trace)) / trace.rate_hz
    rows = (("acceleration [m/s²]", trace.acceleration), ("speed [mm/s]", trace.speed), ("force [N]", trace.force))
    for axes, (label, values) in zip(panels, rows, strict=True):
        for name, colour in PARTS.items():
            for block in getattr(parts, name):
                axes.axvspan(block * length, (block + 1) * length, color=colour, linewidth=0)
        axes.plot(times, values, color=RECORDED, linewidth=0.4)
        axes.set_ylabel(label)
    panels[-1].set(xlabel="time [s]", xlim=(0, times[-1]))
    handles = [Patch(color=colour, label=name) for name, colour in PARTS.items()]
    add_legend(panels[0], handles=handles, loc="lower right", bbox_to_anchor=(1, 1), ncols=3)
    panels[0].set_title(f"{texture_name(run.texture)}, split {run.split_seed}", loc="left")
    return figure


def windows_and_losses(
    errors: Mapping[tuple[Any, ...], Array], seeds: Mapping[tuple[str, int], Sequence[float]] | None = None
) -> Figure:
    """One-step errors by window and loss, a panel for each texture, as Fig. 5: test solid, validation hollow.

    Args:
        errors: on test and validation blocks, (2,), by texture, loss and window.
        seeds: errors on test blocks of several seeds by texture and window, which are drawn as a range.
    """
    textures, losses = list(dict.fromkeys(key[0] for key in errors)), sorted({key[1] for key in errors})
    figure, panels = panel_grid([*map(texture_name, textures)], 2.6, 2.1)
    for axes, texture in zip(panels, textures, strict=True):
        for (key, window), of in (seeds or {}).items():
            if key == texture:
                span = [min(of), max(of)]
                axes.plot([window] * 2, span, lw=7, color=RANGE, solid_capstyle="butt", label=f"{len(of)} seeds")
        for loss, colour in zip(losses, COLOURS, strict=False):
            windows = sorted(window for *of, window in errors if of == [texture, loss])
            tested, validated = np.array([errors[texture, loss, window] for window in windows]).reshape(-1, 2).T
            axes.plot(windows, tested, "o-", ms=3, lw=1, color=colour, label=loss)
            axes.plot(windows, validated, "o", ms=4, mfc="none", color=colour)
    add_legend(panels[0])
    figure.supxlabel("window [samples]", fontsize=9)
    figure.supylabel("one-step MAE [sd]: test ●, validation ○", fontsize=9)
    return figure


def thresholds(results: Results) -> Figure:
    """One-step errors by the threshold of the Huber loss, relative to each texture's mean, and their mean."""
    errors = _mean_errors(results, ("train", "delta"))
    textures, deltas = list(dict.fromkeys(key[0] for key in errors)), sorted({key[1] for key in errors})
    lines = np.array([[errors.get((texture, delta), [np.nan] * 2) for delta in deltas] for texture in textures])
    lines /= np.nanmean(lines, axis=1, keepdims=True)
    figure, panels = new_figure(6.5, 5.5, nrows=2, sharex=True)
    for axes, name, of in zip(panels, ("test", "validation"), np.moveaxis(lines, 2, 0), strict=True):
        axes.plot(deltas, of.T, "-", lw=0.7, color="#9a9a9a")
        axes.plot(deltas, np.nanmean(of, axis=0), "o-", lw=1.6, ms=4, color=COLOURS[0], label="mean of the textures")
        axes.set_ylabel(f"{name}: MAE ÷ the texture's mean", fontsize=9)
    add_legend(panels[0])
    panels[1].set_xlabel("δ of the Huber loss [sd]", fontsize=9)
    return figure


def waveforms(results: Results, model: str = "") -> Figure:
    """400 ms of a test block of each texture from the warm start: each method's free run over the recording, as Fig. 6.

    A line marks the 100 ms in which the paper's network converges. Where a run draws noise, it is another realisation:
    compare level and character, not samples. All of a panel have one scale.

    Args:
        model: of the methods that are drawn, in the colours that they have among all; all by default.
    """
    textures, colours = _first_split(results)
    if model:
        of_model = {label_of(result) for result in results if result["run"]["model"] == model}
        colours = {method: colour for method, colour in colours.items() if method in of_model}
        of_textures = ((key, {m: one for m, one in of.items() if m in of_model}) for key, of in textures.items())
        textures = {key: of for key, of in of_textures if of}
    figure, panels = panel_grid([*map(texture_name, textures)], 3.4, 0.7 + 0.45 * len(colours))
    for axes, by_method in zip(panels, textures.values(), strict=True):
        first = next(iter(by_method.values()))
        recorded = np.array(first["signals"]["recorded"])
        step = 2.2 * float(np.abs(recorded).max())
        times = 1000 * np.arange(len(recorded)) / first["evaluation"]["rate_hz"]
        settled = times >= min(CONVERGED_MS, times[-1] / 2)
        for k, (method, result) in enumerate(by_method.items()):
            run = np.array(result["signals"]["free_run"])
            axes.plot(times, recorded - k * step, color=RECORDED, alpha=0.35, lw=0.9)
            axes.plot(times, run.clip(-0.5 * step, 0.5 * step) - k * step, color=colours[method], lw=0.8)
            below = _below_db(recorded[settled].var(), run[settled].var())
            if below > -SILENT_DB:
                place = {"xy": (times[-1], (0.12 - k) * step), "ha": "right", "va": "bottom"}
                behind = {"boxstyle": "square,pad=0.15", "facecolor": "white", "alpha": 0.8, "linewidth": 0}
                axes.annotate(f"silent: {below:.0f} dB below", **place, fontsize=6.5, bbox=behind)
        axes.axvline(CONVERGED_MS, color=RECORDED, lw=0.7, ls=(0, (3, 2)))
        bar, beyond = float(f"{0.45 * step:.1g}"), 1.03 * times[-1]
        axes.plot([beyond, beyond], [-bar / 2, bar / 2], color=RECORDED, lw=2)
        axes.annotate(f"{bar:g} m/s²", (1.04 * times[-1], 0), rotation=90, va="center", fontsize=6.5)
        names = [method.replace(", ", ",\n") for method in by_method] if len(colours) > 1 else []
        axes.set_yticks([-k * step for k in range(len(names))], names, fontsize=7)
    drawn = "" if len(colours) > 1 else f", in colour: {next(iter(colours))}"
    figure.supxlabel(f"time [ms]; grey: recorded{drawn}", fontsize=9)
    return figure


def convergence(results: Results) -> Figure:
    """Error of free runs from the warm start over that of silence, and their level, in 10 ms: means over all runs of a method.

    Silence has an error of 1; true vibrations of the same strokes, the ceiling, one above it. A line marks the 100 ms in which
    the paper's network converges, Sec. V-a.
    """
    by_method = defaultdict(list)
    for result in results:
        by_method[label_of(result)].append(result["signals"])
    figure, (errors, levels) = new_figure(6.5, 5.0, nrows=2, sharex=True)
    for i, (method, of_method) in enumerate(by_method.items()):
        colour, dashes = COLOURS[i % len(COLOURS)], "-" if i < len(COLOURS) else "--"
        length = min(len(signals["level_db"]) for signals in of_method)
        times = ERROR_FRAME_MS * (np.arange(length) + 0.5)
        for axes, key in ((errors, "error_to_silence"), (levels, "level_db")):
            mean = np.mean([signals[key][:length] for signals in of_method], axis=0)
            axes.plot(times, np.maximum(mean, LOWEST_DB), lw=1.3, ls=dashes, color=colour, label=method)
    warm = [result["evaluation"]["warm_start"] for result in results]
    ceiling = [one["ceiling"]["mae_scaled"] / one["silence_mae_scaled"] for one in warm if "ceiling" in one]
    for value, name in ((1.0, "silence"), *([(float(np.mean(ceiling)), "ceiling")] if ceiling else [])):
        errors.axhline(value, color=RECORDED, lw=0.8, ls="-" if value == 1 else (0, (1, 1.5)))
        errors.annotate(name, (1.0, value), xycoords=("axes fraction", "data"), va="center", fontsize=7)
    levels.axhline(0.0, color=RECORDED, lw=0.8)
    for axes in (errors, levels):
        axes.axvline(CONVERGED_MS, color=RECORDED, lw=0.7, ls=(0, (3, 2)))
    errors.set(ylabel="error ÷ that of silence", ylim=(0, None))
    levels.set(xlabel="time from the warm start [ms]", ylabel="level over the recorded [dB]")
    handles, labels = levels.get_legend_handles_labels()
    add_legend(figure, handles=handles, labels=labels, loc="outside upper center", ncols=2)
    return figure


def _below_db(recorded: float, synthesized: float) -> float:
    """Distance of a power below the recorded one [dB], 300 at most."""
    return 10 * float(np.log10(recorded / max(synthesized, 1e-30 * recorded)))


def spectra(results: Results) -> Figure:
    """Power spectra of the test blocks of each texture, recorded and of each method's free run, as Fig. 7.

    Densities below the axis are drawn along its lower edge; the legend says how far below the recording a silent run lies.
    """
    textures, colours = _first_split(results)
    labels = {method: method + _silence(method, textures) for method in colours}
    figure, panels = panel_grid([*map(texture_name, textures)], 3.0, 2.2)
    for axes, by_method in zip(panels, textures.values(), strict=True):
        first = next(iter(by_method.values()))["signals"]
        recorded = 10 * np.log10(np.maximum(first["density"]["recorded"], 1e-30))
        low, high = recorded.min() - 15, recorded.max() + 8
        for method, result in by_method.items():
            frequencies, density = result["signals"]["frequencies_hz"], result["signals"]["density"]["free_run"]
            shown = np.maximum(10 * np.log10(np.maximum(density, 1e-30)), low + 0.3)
            axes.plot(frequencies, shown, color=colours[method], lw=1, label=labels[method])
        axes.plot(first["frequencies_hz"], recorded, color=RECORDED, lw=1.2, label="recorded")
        axes.set_ylim(low, high)
    named = {label: handle for axes in panels for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    # Two beside each other: a label may say by how much a method is silent.
    add_legend(figure, handles=[*named.values()], labels=[*named], loc="outside upper center", ncols=min(2, len(named)))
    figure.set_figheight(figure.get_figheight() + 0.09 * len(named))
    figure.supxlabel("frequency [Hz]", fontsize=9)
    figure.supylabel("power density [dB re 1 (m/s²)²/Hz]", fontsize=9)
    return figure


def _silence(method: str, textures: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> str:
    """Say on how many textures a method falls silent, and how far below the recording; nothing where on none."""
    densities = [by_method[method]["signals"]["density"] for by_method in textures.values() if method in by_method]
    below = [_below_db(np.mean(density["recorded"]), np.mean(density["free_run"])) for density in densities]
    silent = [level for level in below if level > -SILENT_DB]
    where = "" if len(silent) == len(below) else f" on {len(silent)} of {len(below)} textures"
    return f": falls silent{where}, {min(silent):.0f} dB or more below the recording" if silent else ""


def _first_split(results: Results) -> tuple[dict[str, dict[str, Mapping[str, Any]]], dict[str, str]]:
    """Results of each texture's first split by method, and all colours; another split is another recording."""
    textures: dict[str, dict[str, Mapping[str, Any]]] = {}
    splits: dict[str, int] = {}
    for result in results:
        run = result["run"]
        if splits.setdefault(run["texture"], run["split_seed"]) == run["split_seed"]:
            textures.setdefault(run["texture"], {})[label_of(result)] = result
    return textures, dict(zip(dict.fromkeys(map(label_of, results)), itertools.cycle(COLOURS), strict=False))
