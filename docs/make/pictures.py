"""Make the pictures and sounds of README.md and docs/, each from measured figures or from a simulation made on the spot.

    python docs/make/pictures.py [--only NAME,...] [--recordings DIR] [--sweep DIR DIR]

Figures are read from docs/results. Textures that a picture shows are trained once, into build/pictures. DIR of `--recordings`
holds the real recordings, for the picture `rates`; those of `--sweep` are what `foten sweep table-1` and `foten sweep
table-1-tuned` wrote, for `compared` and the paper's Fig. 6 and 7.
"""

from __future__ import annotations

import argparse
import csv
import os
import re
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from PIL import Image
from scipy.signal import welch

from csv_records import ONE_STEP
from foten.datasets.hdf5 import load_recording
from foten.dsp.distance import log_spectral_distance, scored_bins, segment_length
from foten.dsp.distance import welch as spectra
from foten.dsp.level import frame_levels
from foten.dsp.perception import RATES_HZ, carried
from foten.dsp.resample import interpolate
from foten.evaluate.free_run import scored, synthesize, synthesize_linear
from foten.evaluate.one_step import ORDERS, fit_linear, predict
from foten.experiments import figures
from foten.experiments.experiment import Run, experiment_path, read_experiment, recording_of
from foten.experiments.results import VALIDATION, chosen_results, read_records, read_results
from foten.experiments.simulator_reference import linear_bounds
from foten.models.texture_file import Texture, read_texture, write_texture
from foten.models.trainable import TRAINABLE, recipe_of, train
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.scaling import fit_scaling
from foten.recording.split import Split, split_blocks
from foten.recording.windows import first_scored, targets
from foten.reporting.figure import BLUE, GREEN, MAUVE, ORANGE, Style, add_legend, new_figure
from foten.reporting.table import mean_number
from foten.runtime.live.sinks import pcm_wav
from foten.runtime.native import NativeState, NativeTexture
from foten.runtime.stylus import PressureCalibration
from foten.simulation.contact_mechanics import CONTACT
from foten.simulation.linear_family import LINEAR_FAMILY
from foten.simulation.simulate import TEXTURES, second_realisation, simulate
from foten.simulation.simulated_capture import PLAN_HZ, simulate_capture
from foten.simulation.simulated_capture import SOUND_HZ as CAPTURED_HZ
from foten.training.job import TrainingJob
from paper_tables import PAPER_CELL, by_window, of_seeds

DOCS = Path(__file__).resolve().parents[1]
RESULTS, BUILD = DOCS / "results", DOCS.parent / "build" / "pictures"
REAL = ("copper", "fabric", "leather", "wood")
COMPARED = ("steel-mesh-1", "cardboard", "towel")  # of the twelve of Table I
SHOWN = "towel"  # the easiest of the simulated textures to predict, and the paper's network falls silent on it
SEED = 1
OURS_KEY = "foten-plus"
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


def texture_of(key: str, model: str = OURS_KEY, **changed: Any) -> Texture:
    """Texture of 64 s of simulation, trained once, by our recipe or with changes of it."""
    path = BUILD / "-".join([key, model, *(f"{name}-{value}" for name, value in changed.items()), f"{SEED}.foten"])
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        recording, recipe = simulate(key, 64.0, seed=SEED), recipe_of(model, **changed)
        write_texture(
            train(TrainingJob(recording, model, TRAINABLE[model].sizes(), recipe, split_seed=SEED)).texture, path
        )
    return read_texture(path)


def stroke(arguments: argparse.Namespace) -> None:
    """Test blocks, recorded and rendered, as sound."""
    texture = texture_of("jeans")
    trace = preprocess(simulate("jeans", 64.0, seed=SEED), PreprocessConfig())
    blocks = Split.from_fields(texture.card["split"]).test
    rendered, _ = synthesize(NativeTexture(texture.to_bytes()), trace, blocks, excitation=True, n_seeds=1)
    played = slice(0, round(2.0 * trace.rate_hz))
    signals = (trace.blocks(trace.acceleration)[list(blocks)], rendered[0])
    write_sound("stroke", [signal.ravel()[played] for signal in signals], trace.rate_hz)


def write_sound(name: str, signals: list[np.ndarray], rate_hz: float) -> None:
    """Write signals after each other, at one gain."""
    loudest, pause = max(float(np.abs(signal).max()) for signal in signals), np.zeros(round(0.4 * rate_hz))
    row = np.concatenate([part for signal in signals for part in (0.9 / loudest * signal, pause)])
    (DOCS / "audio").mkdir(exist_ok=True)
    sound = pcm_wav(interpolate(row, Fraction(SOUND_HZ, round(rate_hz))), SOUND_HZ)
    (DOCS / "audio" / f"{name}.wav").write_bytes(sound)


def boxes(name: str, placed: Mapping[str, tuple[float, float, float, str]], arrows: list[tuple[Any, ...]]) -> None:
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
    save(figure, name)


SOFT, WARM, COOL, PLAIN = "#dcebf7", "#fbe8cf", "#d9efe5", "#f2f2f2"


def foten_diagram(arguments: argparse.Namespace) -> None:
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
    boxes("foten", placed, arrows)


def foten_plus_diagram(arguments: argparse.Namespace) -> None:
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
    boxes("foten-plus", placed, arrows)


def one_step(arguments: argparse.Namespace) -> None:
    """The same network one step ahead and in the closed loop."""
    recording = simulate(SHOWN, 64.0, seed=SEED)
    paper, ours = (texture_of(SHOWN, model) for model in ("foten", OURS_KEY))
    kernel, our_kernel = (NativeTexture(file.to_bytes()) for file in (paper, ours))
    trace = preprocess(recording, PreprocessConfig())
    split = split_blocks(trace, "regrouped", SEED)
    samples = paper.scaling.scale(trace.stacked())
    block = split.test[0]
    n = np.arange(block * trace.block + first_scored(trace.block), (block + 1) * trace.block)
    predicted = predict(kernel, samples, n[None]).sample[0]
    recorded = samples[n, 0]
    linear = fit_linear(samples, split.train, trace.block, 20)
    assert linear is not None
    runs = {
        "foten, free run": synthesize(kernel, trace, (block,), excitation=False)[0],
        "AR(20) with white noise": synthesize_linear(linear, trace, (block,), paper.scaling, n_seeds=1),
        OURS_KEY: synthesize(our_kernel, trace, (block,), excitation=True, n_seeds=1)[0],
    }
    rendered = {"recorded": samples[block * trace.block : (block + 1) * trace.block, 0]}
    rendered |= {name: paper.scaling.scale_channel(0, run[0, 0]) for name, run in runs.items()}
    figure, (above, (left, right)) = drawn(9, 6.4, 2, 2, height_ratios=[1, 1.7], width_ratios=[2, 1])
    axes = figure.add_subplot(above[0].get_gridspec()[0, :])
    axes.spines[["top", "right"]].set_visible(False)
    for unused in above:
        unused.remove()
    shown, ms = slice(400, 520), np.arange(120) / trace.rate_hz * 1000
    error, zero = np.abs(predicted - recorded).mean(), np.abs(recorded).mean()
    axes.plot(ms, recorded[shown], color=INK, label=f"recorded: mean size {zero:.2f} sd")
    label = f"the paper's network, one step ahead: mean error {error:.2f} sd"
    axes.plot(ms, predicted[shown], color=PAPER, ls="--", label=label)
    axes.set(xlabel="ms", ylabel="acceleration [sd]", title=f"Simulated {SHOWN}: every sample is given …")
    axes.set_ylim(top=1.6 * float(recorded[shown].max()))
    add_legend(axes, STYLE, loc="upper right", ncols=2)
    seconds = np.arange(trace.block) / trace.rate_hz
    step = 6 * np.std(rendered["recorded"])
    for i, ((name, signal), colour) in enumerate(zip(rendered.items(), (INK, PAPER, LINEAR, OURS), strict=True)):
        left.plot(seconds, signal - i * step, color=colour, lw=0.6)
        left.text(0.0, (0.32 - i) * step, name, fontsize=8, color=colour)
        hertz, power = welch(signal[scored(trace.block)], trace.rate_hz, nperseg=128)
        right.plot(hertz, 10 * np.log10(power + 1e-16), color=colour, lw=1.6 if i == 0 else 1.1, ls="-" if i else ":")
    left.set(xlabel="s", yticks=[], title="… free runs under the same speed and force")
    right.set(xlabel="Hz", ylabel="dB re sd²/Hz", xlim=(0, 0.5 * trace.rate_hz), ylim=(-70, 0), title="its spectrum")
    save(figure, "one-step", 24)


def silence(arguments: argparse.Namespace) -> None:
    """Errors of another realisation of the very same surface, rendered louder and softer."""
    recording = simulate(SHOWN, 64.0, seed=SEED)
    trace, other = (
        preprocess(of, PreprocessConfig()) for of in (recording, second_realisation(recording, SEED + 1_000_003))
    )
    blocks = [t.blocks(t.acceleration)[:, scored(t.block)] for t in (trace, other)]
    sd = blocks[0].std()
    rate, n_segment = trace.rate_hz, segment_length(trace.block)
    hertz, p = spectra(blocks[0], rate, n_segment)
    bins = scored_bins(hertz, rate)
    gains = np.linspace(0.02, 2.0, 60)
    waveform, distance, level = [], [], []
    reference = float(np.sqrt(np.square(blocks[0]).mean()))
    for gain in gains:
        waveform.append(np.abs(blocks[0] - gain * blocks[1]).mean() / sd)
        _, q = spectra(gain * blocks[1], rate, n_segment)
        distance.append(float(log_spectral_distance(p[:, bins], q[:, bins]).mean()))
        levels = [frame_levels(x, rate, reference) for x in (blocks[0], gain * blocks[1])]
        level.append(np.abs(levels[0] - levels[1]).mean())
    figure, axes = drawn(7, 3.6)
    twin = axes.twinx()
    axes.plot(gains, waveform, color=PAPER)
    twin.plot(gains, distance, color=OURS, label="log-spectral distance")
    twin.plot(gains, level, color=OURS, ls="--", label="level error")
    for curve, colour, on in ((waveform, PAPER, axes), (distance, OURS, twin), (level, OURS, twin)):
        i = int(np.argmin(curve))
        on.plot(gains[i], curve[i], "o", color=colour)
    axes.set_xlabel(f"gain of a second realisation of the simulated {SHOWN} (1: its own level)")
    axes.set_ylabel("waveform error [sd]", color=PAPER)
    axes.set_ylim(0, None)
    twin.set_ylabel("dB", color=OURS)
    twin.set_ylim(0, 15)
    add_legend(twin, STYLE, loc="upper center")
    save(figure, "silence")


def linear_errors(run: Run, orders: Sequence[int]) -> tuple[list[float], dict[int, float]]:
    """Least possible errors of a run's test blocks by how many samples are known, and those of fitted AR by order.

    Both relative to the least possible with all of the past known.
    """
    recording = recording_of(run)
    trace = preprocess(recording, PreprocessConfig())
    split = split_blocks(trace, "regrouped", run.split_seed)
    scaling = fit_scaling(trace, split.train)
    samples = scaling.scale(trace.stacked())
    n = targets(split.test, trace.block, first_scored(trace.block)).reshape(len(split.test), -1)
    bounds = [linear_bounds(recording, trace, PreprocessConfig().highpass_hz, order) for order in orders]
    infinite = float(bounds[0][0][n].mean())
    reached = {}
    for order in ORDERS:
        linear = fit_linear(samples, split.train, trace.block, order)
        assert linear is not None
        reached[order] = float(np.abs(samples[n, 0] - linear.predict(samples, n)).mean() * scaling.sd[0] / infinite)
    return [float(window[n].mean()) / infinite for _, window in bounds], reached


def bound(arguments: argparse.Namespace) -> None:
    """What linear predictors of each order reach on processes whose bound is known: means over recordings.

    The paper's network has run on one of them; its error relative to that of AR(20) there is shown.
    """
    runs = [run for run in read_experiment(experiment_path("main-linear")).runs() if run.model == OURS_KEY]
    orders = [int(order) for order in np.unique(np.geomspace(5, 260, 14).astype(int))]
    keys = list(dict.fromkeys(run.texture for run in runs))
    figure, panels = drawn(9, 3.4, 1, len(keys), sharey=True)
    for axes, key in zip(panels, keys, strict=True):
        bounds, reached = zip(*(linear_errors(run, orders) for run in runs if run.texture == key), strict=True)
        mean = {order: float(np.mean([of[order] for of in reached])) for order in ORDERS}

        def ratio(model: str, under: str, unit: str, key: str = key) -> float:
            records = [record for record in runs_of("main-linear", model) if record["texture"] == key]
            return float(np.mean([r[f"one_step.{unit}"] / r[f"references.{under}.{unit}"] for r in records]))

        axes.axhline(1.0, color=CEILING, label="least possible, all of the past known")
        axes.plot(
            orders, np.mean(bounds, axis=0), color=CEILING, ls="--", label="least possible, so many samples known"
        )
        axes.plot([*mean], [*mean.values()], "s", color=LINEAR, label="AR")
        axes.plot(20, mean[20] * ratio("foten", "ar", "mae_scaled"), "o", color=PAPER, label="foten")
        axes.plot(260, ratio(OURS_KEY, "bound", "mae_m_s2"), "o", color=OURS, label="foten-plus")
        ticks = [order for order in ORDERS if order != 160]  # no room
        axes.set(xscale="log", xlabel="samples known", title=key, xticks=ticks, xticklabels=map(str, ticks))
        axes.minorticks_off()
    panels[0].set_ylabel("mean error ÷ that of the whole past")
    handles, labels = panels[0].get_legend_handles_labels()
    add_legend(figure, STYLE, handles=handles, labels=labels, loc="outside lower center", ncols=5)
    save(figure, "bound")


def ceiling(arguments: argparse.Namespace) -> None:
    """Log-spectral distances of every texture, beside that of a realisation of the same stroke."""
    records = [*runs_of("main-simulated"), *runs_of("main-real-10khz")]
    keys = [key for key in (*TEXTURES, *REAL) if any(record["texture"] == key for record in records)]
    rows = {
        "AR(20) with white noise": ("free_run_ar", LINEAR, "s"),
        "foten-plus": ("free_run", OURS, "o"),
        "ceiling": ("ceiling", CEILING, "|"),
    }
    figure, panels = drawn(9, 5, 1, 2, sharey=True)
    for axes, key, title in ((panels[0], "lsd_db", "block by block"), (panels[1], "lsd_long_db", "all blocks pooled")):
        for name, (run, colour, mark) in rows.items():
            values = [np.mean([r[f"{run}.{key}"] for r in records if r["texture"] == k]) for k in keys]
            size = 14 if mark == "|" else 6
            axes.plot(values, range(len(keys)), mark, color=colour, label=name, markersize=size, markeredgewidth=2)
        axes.set(xlabel="log-spectral distance [dB]", title=title, xlim=(0, None))
        axes.grid(axis="x", alpha=0.3)
    panels[0].set_yticks(range(len(keys)), keys)
    panels[0].invert_yaxis()
    add_legend(panels[1], STYLE)
    save(figure, "ceiling")


def runs_of(name: str, model: str = OURS_KEY) -> list[dict[str, Any]]:
    path = RESULTS / f"{name}.csv"
    return [record for record in read_records(path) if record["model"] == model] if path.exists() else []


def rows_of(name: str) -> list[dict[str, str]]:
    with (RESULTS / f"{name}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def limits(arguments: argparse.Namespace) -> None:
    """How near the real four a signal can come at all."""
    rows = rows_of("limits")
    anchor, *others = list(rows[0])[3:]
    groups = {
        name: [np.array([float(r[name]) / float(r[anchor]) for r in rows if r["texture"] == t]) for t in REAL]
        for name in (anchor, *others)
    }
    ours = runs_of("main-real-10khz")
    if ours:
        groups[OURS_KEY] = [
            np.array([r["free_run.lsd_db"] / r["free_run_ar.lsd_db"] for r in ours if r["texture"] == t]) for t in REAL
        ]
    means = {name: mean_number(splits, 2) for name, splits in groups.items()}
    order = sorted(means, key=lambda name: means[name].value)
    values, errors = [means[name].value for name in order], [means[name].error for name in order]
    figure, axes = drawn(8, 3.6)
    colours = {anchor: LINEAR, OURS_KEY: OURS, "the known blocks themselves": CEILING}
    bars = {"color": [colours.get(name, "#bbbbbb") for name in order], "xerr": errors}
    axes.barh(order, values, **bars, error_kw={"ecolor": INK, "elinewidth": 0.8, "capsize": 2})
    for i, (value, error) in enumerate(zip(values, errors, strict=True)):
        axes.text(value + error + 0.015, i, f"{value:.2f}", va="center", fontsize=8)
    axes.set(
        xlabel="log-spectral distance to the test blocks ÷ that of AR(20)\n"
        "mean of four real recordings at 10 kHz, its standard error",
        xlim=(0, 1.35),
    )
    axes.xaxis.label.set_size(8)
    save(figure, "limits")


def outside(arguments: argparse.Namespace) -> None:
    """Level errors above the trained range, towards rest and after jumps."""
    rows = rows_of("outside")
    regions = list(dict.fromkeys(row["where"] for row in rows))
    figure, axes = drawn(8, 3.2)
    for i, (policy, colour) in enumerate((("clamp", PAPER), ("fade", "#bbbbbb"), ("grow", OURS))):
        errors = [
            [float(row["level_error_db"]) for row in rows if (row["policy"], row["where"]) == (policy, region)]
            for region in regions
        ]
        at = np.arange(len(regions)) + 0.27 * (i - 1)
        spread = [np.std(row, ddof=1) / len(row) ** 0.5 for row in errors]
        axes.bar(at, [np.mean(row) for row in errors], 0.25, color=colour, label=policy, yerr=spread, capsize=2)
    n = len({row["texture"] for row in rows})
    axes.set(ylabel="level error [dB]", title=f"Trained to half the range, mean of {n} textures")
    axes.set_xticks(range(len(regions)), regions, fontsize=8)
    add_legend(axes, STYLE)
    save(figure, "outside")


def abrupt(arguments: argparse.Namespace) -> None:
    """Levels around four abrupt changes on a surface of two masses, of the truth and of renderings."""
    rows = [row for row in rows_of("abrupt") if row["surface"] == "sandstone"]
    shown = ("speed 40 → 200 mm/s", "reversal at 120 mm/s", "force 0.5 → 2 N", "tap of 1.5 N at 80 mm/s")
    levels = next(name for name in rows[0] if name.startswith("levels from"))
    ms = re.fullmatch(r"levels from (-?\d+) ms, each (\d+) ms \[dB\]", levels)
    assert ms is not None
    first, each = map(float, ms.groups())
    lines = {
        "truth": ("second realisation", INK, "-"),
        "its flat surface": ("flat surface", INK, ":"),
        "foten-plus": ("foten-plus", OURS, "-"),
        "foten": ("foten", PAPER, "-"),
    }
    figure, panels = drawn(9, 2.8, 1, 4, sharey=True)
    for axes, change in zip(panels, shown, strict=True):
        for name, (rendering, colour, dashes) in lines.items():
            of = (row for row in rows if (row["change"], row["rendering"]) == (change, rendering) and row[levels])
            values = [float(value) for row in of for value in row[levels].split()]
            at = first + each * (np.arange(len(values)) + 0.5)  # the middle of a frame
            axes.plot(at, values, color=colour, ls=dashes, label=name)
        axes.axvline(0.0, color="#cccccc", lw=0.8, zorder=0)
        axes.set_title(change, loc="left", fontsize=9)
        axes.set(xlim=(-50, 250), xlabel="ms")
    panels[0].set_ylabel("level [dB]")
    handles, labels = panels[0].get_legend_handles_labels()
    add_legend(figure, STYLE, handles=handles, labels=labels, ncols=4, loc="outside upper right")
    save(figure, "abrupt")


def listener(arguments: argparse.Namespace) -> None:
    """The area under a listener's curve, by texture, and that of the control."""
    auc = {
        row["texture"]: [float(row[f"listener.{key}"]) for key in ("listener_auc", "listener_auc_control")]
        for row in read_records(RESULTS / "listener.csv")
    }
    kinds = (LINEAR_FAMILY, TEXTURES, CONTACT)
    figure, panels = drawn(9, 3.6, 1, 3, sharey=True, width_ratios=[len(kind) + 1 for kind in kinds])
    for axes, kind, title in zip(panels, kinds, ("linear", "simulated", "contact mechanics"), strict=True):
        order = sorted((key for key in kind if key in auc), key=lambda key: auc[key][0])
        ours, control = zip(*(auc[key] for key in order), strict=True)
        axes.plot(range(len(order)), ours, "o", color=OURS, label="foten-plus", ms=6)
        axes.plot(range(len(order)), control, "_", color=INK, ms=11, label="control")
        axes.axhline(0.5, color="#cccccc", lw=0.8, zorder=0)
        axes.set_xticks(range(len(order)), order, rotation=60, ha="right", fontsize=8)
        axes.set_title(title, loc="left", fontsize=10)
        axes.set(xlim=(-0.6, len(order) - 0.4), ylim=(0.4, 1.02))
    panels[0].set_ylabel("AUC of the listener")
    handles, labels = panels[2].get_legend_handles_labels()
    add_legend(figure, STYLE, handles=handles, labels=labels, ncols=4, loc="outside upper right")
    save(figure, "listener", 12)


def lengths(arguments: argparse.Namespace) -> None:
    """The ideal listener's area by seconds learned from: of the default now and before, and of each random part alone."""
    names = {
        "before recorded innovations": (PAPER, "-"),
        "as by default": (OURS, "-"),
        "recorded alone": (OURS, ":"),
        "noise alone": (LINEAR, ":"),
    }
    areas: dict[tuple[str, bool], dict[float, list[float]]] = {}
    for row in rows_of("trials"):
        name, _, length = row["approach"].partition(", ")
        if name in names and length.endswith(" s"):
            of = areas.setdefault((name, row["surface"].startswith("linear-")), {})
            of.setdefault(float(length.removesuffix(" s")), []).append(float(row["ideal"]))
    figure, panels = drawn(6.4, 2.5, 1, 2, sharey=True)
    for axes, linear, title in zip(panels, (False, True), ("glitter paper, wood", "a linear process"), strict=True):
        for name, (colour, style) in names.items():
            known = sorted(areas.get((name, linear), {}).items())
            axes.plot(*zip(*((s, np.mean(each)) for s, each in known), strict=True), style, color=colour, label=name)
        axes.set_xscale("log", base=2)
        axes.set_xticks([8, 16, 32, 64, 256], ["8", "16", "32", "64", "256"])
        axes.set_title(title, loc="left", fontsize=10)
        axes.axhline(0.5, color="#cccccc", lw=0.8, zorder=0)
    panels[0].set(ylabel="AUC of the listener", xlabel="s learned from")
    add_legend(panels[1], STYLE, fontsize=8)
    save(figure, "lengths", 12)


def impact(arguments: argparse.Namespace) -> None:
    """A slow stroke over sparse impacts, recorded, and rendered with noise alone and as by default; all as sound."""
    key = "artificial-grass"
    texture = texture_of(key)
    noise = texture_of(key, recorded_innovations="never")
    trace = preprocess(simulate(key, 40.0, seed=SEED + 1), PreprocessConfig())
    slow = (trace.speed > 8) & (trace.speed < 40)
    length = 600  # samples
    start = int(np.argmax(np.convolve(slow[2000:], np.ones(length), mode="valid"))) + 2000
    shown = slice(start, start + length)
    signals = {"recorded": trace.acceleration}
    for name, of in (("noise alone", noise), ("foten-plus", texture)):
        signals[name] = NativeState(NativeTexture(of.to_bytes()), seed=SEED).render_stroke(trace.speed, trace.force)
    figure, panels = drawn(8, 3.9, 3, 1, sharex=True, sharey=True)
    for axes, (name, signal), colour in zip(panels, signals.items(), (INK, PAPER, OURS), strict=True):
        axes.plot(np.arange(length) / trace.rate_hz, signal[shown], color=colour, lw=0.7)
        axes.set_title(name, loc="left", fontsize=9)
    panels[1].set_ylabel("acceleration [m/s²]")
    panels[-1].set(xlabel="time [s]", xlim=(0, length / trace.rate_hz))
    save(figure, "impact", 24)
    played = slice(start, start + 1500)
    write_sound("listener", [signal[played] for signal in signals.values()], trace.rate_hz)


def rates(arguments: argparse.Namespace) -> None:
    """What each rate carries of perceived power of the real four."""
    figure, axes = drawn(7, 3.0)
    for i, key in enumerate(REAL):
        recording = load_recording(arguments.recordings / f"{key}.h5")
        hertz, density = welch(recording["acceleration"].samples, 10_000.0, nperseg=1024)
        perceived = carried({"acceleration": (hertz, density)}, 10_000.0)
        plain = [density[hertz <= 0.45 * rate].sum() / density.sum() for rate in RATES_HZ]
        for j, rate in enumerate(RATES_HZ):
            axes.bar(i + 0.27 * (j - 1), 100 * perceived[rate], 0.25, color=OURS, alpha=(0.4, 0.7, 1.0)[j], zorder=2)
            axes.plot(i + 0.27 * (j - 1), 100 * plain[j], "_", color=INK, markersize=14, zorder=3)
            axes.text(i + 0.27 * (j - 1), 3, f"{rate / 1000:g}", ha="center", fontsize=7, color="white", zorder=4)
    axes.set_xticks(range(len(REAL)), REAL)
    axes.set(ylabel="%", title="Carried at 1, 2.5 and 10 kHz: of perceived power (bars), of all power (lines)")
    axes.title.set_size(9)
    save(figure, "rates")


def of_sweeps(arguments: argparse.Namespace) -> list[Any]:
    """Results of Table I by several recipes, of each system those of the recipe that validation chose."""
    results = [
        {**result, "run": {**result["run"], "recipe": result["experiment"]["title"]}}
        for folder in arguments.sweep
        for result in read_results(folder, mixed=True)
    ]
    order = [method.title for method in read_experiment(experiment_path("table-1-tuned")).methods]
    return sorted(chosen_results(results), key=lambda result: order.index(result["run"]["method"]))


def compared(arguments: argparse.Namespace) -> None:
    """Waveforms of each system of Table I in the closed loop, of three textures."""
    shown = [result for result in of_sweeps(arguments) if result["run"]["texture"] in COMPARED]
    save(figures.waveforms(shown), "compared")


def figure_5(arguments: argparse.Namespace) -> None:
    """Fig. 5: errors by window and loss, and the range of those of several seeds."""
    errors = {
        (record["texture"], loss, window): np.array([record[path] for path in (ONE_STEP, VALIDATION[0])])
        for (window, loss), records in by_window().items()
        for record in records
    }
    if not errors:
        print("figure-5: there are no runs in docs/results yet")
        return
    seeds: dict[tuple[str, int], list[float]] = {}
    for record in chain.from_iterable(of_seeds()):
        seeds.setdefault((record["texture"], PAPER_CELL[0]), []).append(record[ONE_STEP])
    save(figures.windows_and_losses(errors, seeds), "figure-5")


def figure_6(arguments: argparse.Namespace) -> None:
    """Fig. 6, free runs of FoTEN, with an excitation and without, over recordings; below how all systems converge."""
    results = of_sweeps(arguments)
    above = figures.waveforms(results, "foten")
    below = figures.convergence(results)
    below.set_size_inches(above.get_figwidth(), 4.8)
    images = [image_of(above), image_of(below)]
    picture = Image.new("RGB", (images[0].width, sum(image.height for image in images)))
    picture.paste(images[0], (0, 0))
    picture.paste(images[1], (0, images[0].height))
    save(picture, "figure-6", 24)


def figure_7(arguments: argparse.Namespace) -> None:
    """Fig. 7: spectra of the test blocks and of every system's free run."""
    save(figures.spectra(of_sweeps(arguments)), "figure-7")


def capture(arguments: argparse.Namespace) -> None:
    """A good capture: the sound, speed and force of a pen; taps, strokes, taps."""
    taken = simulate_capture("jeans", 24.0, seed=SEED)
    t, x, y, pressure = taken.plan.T
    shown = slice(round((taken.taps_s[0] - 1.0) * PLAN_HZ), round((taken.taps_s[-1] + 1.0) * PLAN_HZ))
    figure, axes = drawn(8, 4.2, 3, sharex=True, height_ratios=(1.6, 1, 1))
    every = round(CAPTURED_HZ / PLAN_HZ)
    peaks = taken.sound[: taken.sound.size // every * every].reshape(-1, every)
    seconds = np.arange(len(peaks)) / PLAN_HZ
    axes[0].fill_between(seconds, peaks.min(axis=1), peaks.max(axis=1), color=INK, linewidth=0.3)
    axes[0].set(ylim=(-0.4, 0.4), ylabel="sound")
    for tap in taken.taps_s:
        axes[0].annotate("", (tap, 0.27), (tap, 0.39), arrowprops={"arrowstyle": "->", "color": PAPER})
    speed = np.where(pressure > 0, np.hypot(np.gradient(x, t), np.gradient(y, t)), np.nan)
    axes[1].plot(t, speed, color=OURS, linewidth=1)
    axes[1].set(ylabel="mm/s")
    axes[2].plot(t, np.where(pressure > 0, PressureCalibration().force(pressure), np.nan), color=LINEAR, linewidth=1)
    axes[2].set(ylabel="N", xlabel="seconds", xlim=(t[shown][0], t[shown][-1]))
    save(figure, "capture", 24)


PICTURES: dict[str, Callable[[argparse.Namespace], None]] = {
    "stroke": stroke,
    "foten": foten_diagram,
    "foten-plus": foten_plus_diagram,
    "one-step": one_step,
    "silence": silence,
    "ceiling": ceiling,
    "bound": bound,
    "limits": limits,
    "outside": outside,
    "abrupt": abrupt,
    "rates": rates,
    "listener": listener,
    "impact": impact,
    "lengths": lengths,
    "compared": compared,
    "figure-5": figure_5,
    "figure-6": figure_6,
    "figure-7": figure_7,
    "capture": capture,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=Path, default=Path("recordings"))
    tables = [Path("results") / name for name in ("table-1", "table-1-tuned")]
    parser.add_argument("--sweep", type=Path, nargs="+", default=tables)
    parser.add_argument("--only", type=lambda text: text.split(","), default=list(PICTURES))
    arguments = parser.parse_args()
    for name in arguments.only:
        PICTURES[name](arguments)


if __name__ == "__main__":
    main()
