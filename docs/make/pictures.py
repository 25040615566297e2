"""Make the pictures of fidelity.md and compared.md, each from measured figures or from a simulation made on the spot.

    python docs/pictures.py [--textures DIR] [--recordings DIR] [--only NAME,...]

DIR of `--textures` holds what `benchmarks/main_table.py run --keep DIR` wrote; the figures are read from `benchmarks/results`.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from scipy.signal import welch

from foten.datasets.simulate import TEXTURES, second_realisation, simulate
from foten.dsp.distance import log_spectral_distance, scored_bins, segment_length
from foten.dsp.distance import welch as spectra
from foten.dsp.level import frame_levels
from foten.dsp.perception import RATES_HZ, carried
from foten.evaluate.free_run import scored, synthesize, synthesize_linear
from foten.evaluate.one_step import ORDERS, first_scored, fit_linear, predict
from foten.experiments.figures import waveforms
from foten.experiments.results import read_results
from foten.experiments.truth import linear_bounds
from foten.families.texture_file import read_texture
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.scaling import fit_scaling
from foten.recording.split import split_blocks
from foten.recording.windows import targets
from foten.runtime.native import NativeTexture

HERE = Path(__file__).parent
RESULTS = HERE.parent / "benchmarks" / "results"
REAL = ("copper", "fabric", "leather", "wood")
SHOWN = "towel"  # the easiest of the simulated textures to predict, and the paper's network falls silent on it
SEED = 1
INK, OURS, PAPER, LINEAR, CEILING = "#333333", "#2b83cf", "#e08a1e", "#1a9c72", "#b77ab0"


def save(figure: Any, name: str, tight: bool = True) -> None:
    if tight:
        figure.tight_layout()
    figure.savefig(HERE / "pictures" / f"{name}.png", dpi=110, facecolor="white")
    plt.close(figure)
    print(name)


def one_step(arguments: argparse.Namespace) -> None:
    """The same network one step ahead and on its own output."""
    recording = simulate(SHOWN, 64.0, seed=SEED)
    files = {
        model: read_texture(arguments.textures / f"{SHOWN}-1000-{model}-{SEED}.foten")
        for model in ("foten", "foten-plus")
    }
    paper = files["foten"]
    kernels = {model: NativeTexture(file.to_bytes()) for model, file in files.items()}
    trace = preprocess(recording, PreprocessConfig())
    split = split_blocks(trace, "regrouped", SEED)
    samples = paper.scaling.scale(trace.stacked())
    block = split.test[0]
    n = np.arange(block * trace.block + first_scored(trace.block), (block + 1) * trace.block)
    predicted = predict(kernels["foten"], samples, n[None]).sample[0]
    recorded = samples[n, 0]
    linear = fit_linear(samples, split.train, trace.block, 20)
    assert linear is not None
    played = {
        "recorded": samples[block * trace.block : (block + 1) * trace.block, 0],
        "foten on its own output": paper.scaling.scale_channel(
            0, synthesize(kernels["foten"], trace, (block,), excitation=False)[0][0, 0]
        ),
        "AR(20) with white noise": paper.scaling.scale_channel(
            0, synthesize_linear(linear, trace, (block,), paper.scaling, n_seeds=1)[0, 0]
        ),
        "foten-plus": paper.scaling.scale_channel(
            0, synthesize(kernels["foten-plus"], trace, (block,), excitation=True, n_seeds=1)[0][0, 0]
        ),
    }
    figure = plt.figure(figsize=(9, 6.4))
    grid = figure.add_gridspec(2, 2, height_ratios=[1, 1.7], width_ratios=[2, 1])
    axes = figure.add_subplot(grid[0, :])
    shown, ms = slice(400, 520), np.arange(120) / trace.rate_hz * 1000
    error, zero = np.abs(predicted - recorded).mean(), np.abs(recorded).mean()
    axes.plot(ms, recorded[shown], color=INK, label=f"recorded: mean size {zero:.2f} sd")
    axes.plot(
        ms,
        predicted[shown],
        color=PAPER,
        ls="--",
        label=f"the paper's network, one step ahead: mean error {error:.2f} sd",
    )
    axes.set(xlabel="ms", ylabel="acceleration [sd]", title=f"Simulated {SHOWN}: told every sample …")
    axes.legend(loc="upper right", fontsize=8)
    left, right = figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1])
    seconds = np.arange(trace.block) / trace.rate_hz
    step = 6 * np.std(played["recorded"])
    for i, ((name, signal), colour) in enumerate(zip(played.items(), (INK, PAPER, LINEAR, OURS), strict=True)):
        left.plot(seconds, signal - i * step, color=colour, lw=0.6)
        left.text(0.0, (0.32 - i) * step, name, fontsize=8, color=colour)
        hertz, power = welch(signal[scored(trace.block)], trace.rate_hz, nperseg=128)
        right.plot(hertz, 10 * np.log10(power + 1e-16), color=colour, lw=1.6 if i == 0 else 1.1, ls="-" if i else ":")
    left.set(xlabel="s", yticks=[], title="… and left to itself under the same hand")
    right.set(xlabel="Hz", ylabel="dB re sd²/Hz", xlim=(0, 0.5 * trace.rate_hz), ylim=(-70, 0), title="its spectrum")
    save(figure, "one-step")


def silence(arguments: argparse.Namespace) -> None:
    """Errors of another realisation of the very same surface, played louder and softer."""
    recording = simulate(SHOWN, 64.0, seed=SEED)
    trace, other = (
        preprocess(one, PreprocessConfig()) for one in (recording, second_realisation(recording, SEED + 1_000_003))
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
    figure, axes = plt.subplots(figsize=(7, 3.6))
    twin = axes.twinx()
    axes.plot(gains, waveform, color=PAPER)
    twin.plot(gains, distance, color=OURS, label="log-spectral distance")
    twin.plot(gains, level, color=OURS, ls="--", label="level error")
    for curve, colour, on in ((waveform, PAPER, axes), (distance, OURS, twin), (level, OURS, twin)):
        i = int(np.argmin(curve))
        on.plot(gains[i], curve[i], "o", color=colour)
    axes.set_xlabel(f"gain of another realisation of the simulated {SHOWN} (1: the real loudness)")
    axes.set_ylabel("waveform error [sd]", color=PAPER)
    axes.set_ylim(0, None)
    twin.set_ylabel("dB", color=OURS)
    twin.set_ylim(0, 15)
    twin.legend(loc="upper center", fontsize=8)
    save(figure, "silence")


def bound(arguments: argparse.Namespace) -> None:
    """What linear predictors of each order reach on a process whose bound is known."""
    figure, panels = plt.subplots(1, 3, figsize=(9, 3.4), sharey=True)
    for axes, key in zip(panels, ("linear-hum", "linear-twin", "linear-cloth"), strict=True):
        recording = simulate(key, 64.0, seed=SEED)
        trace = preprocess(recording, PreprocessConfig())
        split = split_blocks(trace, "regrouped", SEED)
        scaling = fit_scaling(trace, split.train)
        samples = scaling.scale(trace.stacked())
        n = targets(split.test, trace.block, first_scored(trace.block)).reshape(len(split.test), -1)
        orders = np.unique(np.geomspace(5, 260, 14).astype(int))
        of_window, infinite = [], 0.0
        for order in orders:
            of_past, window = linear_bounds(recording, trace, PreprocessConfig().highpass_hz, int(order))
            of_window.append(window[n].mean())
            infinite = float(of_past[n].mean())
        axes.axhline(1.0, color=CEILING, label="least possible, all of the past known")
        axes.plot(
            orders,
            np.array(of_window) / infinite,
            color=CEILING,
            ls="--",
            label="least possible, so many samples known",
        )
        reached = []
        for order in ORDERS:
            linear = fit_linear(samples, split.train, trace.block, order)
            assert linear is not None
            missed = np.abs(samples[n, 0] - linear.predict(samples, n)).mean()
            reached.append(missed * scaling.sd[0] / infinite)
        axes.plot(ORDERS, reached, "s", color=LINEAR, label="AR")
        for model, colour, at in (("foten", PAPER, 20), ("foten-plus", OURS, None)):
            path = RESULTS / "main_table" / f"{key}-1000-{model}-{SEED}.json"
            if not path.exists():
                continue
            document = json.loads(path.read_text())
            error = document["one_step"]["mae_m_s2"] / document["references"]["bound"]["mae_m_s2"]
            order = at or read_texture(arguments.textures / f"{key}-1000-{model}-{SEED}.foten").window
            axes.plot(order, error, "o", color=colour, label=model)
        ticks = [order for order in ORDERS if order != 160]  # no room
        axes.set(xscale="log", xlabel="samples known", title=key, xticks=ticks, xticklabels=map(str, ticks))
        axes.minorticks_off()
    panels[0].set_ylabel("mean error ÷ that of the whole past")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="lower center", ncols=5, fontsize=8)
    figure.subplots_adjust(bottom=0.25)
    save(figure, "bound", tight=False)


def _documents(model: str) -> dict[str, list[dict[str, Any]]]:
    by_texture: dict[str, list[dict[str, Any]]] = {}
    for path in sorted((RESULTS / "main_table").glob(f"*-{model}-[0-9].json")):
        document = json.loads(path.read_text())
        if document["run"]["model"] == model:
            key = f"{document['run']['texture']}-{document['run']['rate_hz']:g}"
            by_texture.setdefault(key, []).append(document)
    return by_texture


def ceiling(arguments: argparse.Namespace) -> None:
    """Log-spectral distances of every texture, beside that of a realisation of the same stroke."""
    documents = _documents("foten-plus")
    keys = [k for k in (*(f"{t}-1000" for t in TEXTURES), *(f"{t}-10000" for t in REAL)) if k in documents]
    rows = {
        "AR(20) with white noise": ("free_run_ar", LINEAR, "s"),
        "foten-plus": ("free_run", OURS, "o"),
        "ceiling": ("ceiling", CEILING, "|"),
    }
    figure, panels = plt.subplots(1, 2, figsize=(9, 5), sharey=True)
    for axes, key, title in ((panels[0], "lsd_db", "block by block"), (panels[1], "lsd_long_db", "all blocks pooled")):
        for name, (run, colour, mark) in rows.items():
            values = [np.mean([d[run][key] for d in documents[k]]) for k in keys]
            size = 14 if mark == "|" else 6
            axes.plot(values, range(len(keys)), mark, color=colour, label=name, markersize=size, markeredgewidth=2)
        axes.set(xlabel="log-spectral distance [dB]", title=title, xlim=(0, None))
        axes.grid(axis="x", alpha=0.3)
    panels[0].set_yticks(range(len(keys)), [k.rpartition("-")[0] for k in keys])
    panels[0].invert_yaxis()
    panels[1].legend(fontsize=8)
    save(figure, "ceiling")


def limits(arguments: argparse.Namespace) -> None:
    """How near the real four a signal can come at all."""
    figures = json.loads((RESULTS / "limits.json").read_text())
    anchor, *others = list(figures["copper"][0])
    ratios = {name: [[split[name] / split[anchor] for split in figures[t]] for t in REAL] for name in (anchor, *others)}
    documents = _documents("foten-plus")
    if all(f"{t}-10000" in documents for t in REAL):
        ratios["foten-plus"] = [
            [d["free_run"]["lsd_db"] / d["free_run_ar"]["lsd_db"] for d in documents[f"{t}-10000"]] for t in REAL
        ]
    means = {name: float(np.mean([np.mean(splits) for splits in rows])) for name, rows in ratios.items()}
    errors = {
        name: float(np.sqrt(np.square([np.std(s, ddof=1) / len(s) ** 0.5 for s in rows]).sum()) / len(rows))
        for name, rows in ratios.items()
    }
    figure, axes = plt.subplots(figsize=(8, 3.6))
    order = sorted(means, key=lambda name: means[name])
    colours = {anchor: LINEAR, "foten-plus": OURS, "the known blocks themselves": CEILING}
    values = [means[name] for name in order]
    axes.barh(
        order,
        values,
        color=[colours.get(name, "#bbbbbb") for name in order],
        xerr=[errors[name] for name in order],
        error_kw={"ecolor": INK, "elinewidth": 0.8, "capsize": 2},
    )
    for i, name in enumerate(order):
        axes.text(means[name] + errors[name] + 0.015, i, f"{means[name]:.2f}", va="center", fontsize=8)
    axes.set(
        xlabel="log-spectral distance to the test blocks ÷ that of AR(20)\n"
        "mean of four real recordings at 10 kHz, its standard error",
        xlim=(0, 1.35),
    )
    axes.xaxis.label.set_size(8)
    save(figure, "limits")


def outside(arguments: argparse.Namespace) -> None:
    """Level errors above the trained range, towards rest and after jumps."""
    figures = json.loads((RESULTS / "outside.json").read_text())
    regions = list(next(iter(figures.values()))["grow"])
    figure, axes = plt.subplots(figsize=(8, 3.2))
    for i, (policy, colour) in enumerate((("clamp", PAPER), ("fade", "#bbbbbb"), ("grow", OURS))):
        rows = [
            [f[policy][region]["level_error_db"] for f in figures.values() if region in f[policy]] for region in regions
        ]
        at = np.arange(len(regions)) + 0.27 * (i - 1)
        axes.bar(
            at,
            [np.mean(row) for row in rows],
            0.25,
            color=colour,
            label=policy,
            yerr=[np.std(row, ddof=1) / len(row) ** 0.5 for row in rows],
            capsize=2,
        )
    axes.set(ylabel="level error [dB]", title=f"Trained to half the range, mean of {len(figures)} textures")
    axes.set_xticks(range(len(regions)), regions, fontsize=8)
    axes.legend(fontsize=8)
    save(figure, "outside")


def rates(arguments: argparse.Namespace) -> None:
    """What each rate carries of what a hand feels of the real four."""
    figure, axes = plt.subplots(figsize=(7, 3.0))
    for i, key in enumerate(REAL):
        with np.load(arguments.recordings / f"{key}.npz", allow_pickle=False) as columns:
            hertz, density = welch(np.asarray(columns["accel"], dtype=float), 10_000.0, nperseg=1024)
        perceived = carried({"acceleration": (hertz, density)}, 10_000.0)
        plain = [density[hertz <= 0.45 * rate].sum() / density.sum() for rate in RATES_HZ]
        for j, rate in enumerate(RATES_HZ):
            axes.bar(i + 0.27 * (j - 1), 100 * perceived[rate], 0.25, color=OURS, alpha=(0.4, 0.7, 1.0)[j], zorder=2)
            axes.plot(i + 0.27 * (j - 1), 100 * plain[j], "_", color=INK, markersize=14, zorder=3)
            axes.text(i + 0.27 * (j - 1), 3, f"{rate / 1000:g}", ha="center", fontsize=7, color="white", zorder=4)
    axes.set_xticks(range(len(REAL)), REAL)
    axes.set(ylabel="%", title="Carried at 1, 2.5 and 10 kHz: of what a hand feels (bars), of all power (lines)")
    axes.title.set_size(9)
    save(figure, "rates")


def compared(arguments: argparse.Namespace) -> None:
    """Waveforms of each method of the reduced comparison on its own output, of three textures."""
    results = read_results(RESULTS / "table-1-small")
    shown = [one for one in results if one["run"]["texture"] in ("steel-mesh-1", "cardboard", "towel")]
    save(waveforms(shown), "compared", tight=False)


PICTURES: dict[str, Callable[[argparse.Namespace], None]] = {
    "one-step": one_step,
    "silence": silence,
    "ceiling": ceiling,
    "bound": bound,
    "limits": limits,
    "outside": outside,
    "rates": rates,
    "compared": compared,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--textures", type=Path, default=Path("textures"))
    parser.add_argument("--recordings", type=Path, default=Path("recordings"))
    parser.add_argument("--only", type=lambda text: text.split(","), default=list(PICTURES))
    arguments = parser.parse_args()
    (HERE / "pictures").mkdir(exist_ok=True)
    for name in arguments.only:
        PICTURES[name](arguments)


if __name__ == "__main__":
    main()
