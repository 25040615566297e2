"""Pictures and sounds of simulations that are made on the spot, and of recordings."""

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.signal import welch

from csv_records import OURS as OURS_KEY
from csv_records import REAL, runs
from drawing import CEILING, DOCS, INK, LINEAR, OURS, PAPER, STYLE, drawn, legend_of, write_sound
from foten.cli.simulator_reference import linear_bounds
from foten.datasets.hdf5 import load_recording
from foten.dsp.distance import log_spectral_distance, scored_bins, segment_length
from foten.dsp.distance import welch as spectra
from foten.dsp.level import frame_levels
from foten.dsp.perception import RATES_HZ, carried
from foten.evaluate.free_run import scored, synthesize, synthesize_linear
from foten.evaluate.one_step import ORDERS, fit_linear, predict
from foten.models.texture_file import Texture, read_texture, write_texture
from foten.models.trainable import TRAINABLE, recipe_of, train
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.scaling import fit_scaling
from foten.recording.split import Split, split_blocks
from foten.recording.windows import first_scored, targets
from foten.reporting.figure import add_legend
from foten.runtime.native import NativeState, NativeTexture
from foten.runtime.stylus import PressureCalibration
from foten.simulation.simulate import second_realisation, simulate
from foten.simulation.simulated_capture import PLAN_HZ, simulate_capture
from foten.simulation.simulated_capture import SOUND_HZ as CAPTURED_HZ
from foten.training.job import TrainingJob
from foten_lab.experiment import Run, experiment_path, read_experiment, recording_of

BUILD = DOCS.parent / "build" / "pictures"
SHOWN = "towel"  # the easiest of the simulated textures to predict, and the paper's network falls silent on it
SEED = 1


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


def one_step(arguments: argparse.Namespace) -> Figure:
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
    return figure


def silence(arguments: argparse.Namespace) -> Figure:
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
    return figure


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


def bound(arguments: argparse.Namespace) -> Figure:
    """What linear predictors of each order reach on processes whose bound is known: means over recordings.

    The paper's network has run on one of them; its error relative to that of AR(20) there is shown.
    """
    planned = [run for run in read_experiment(experiment_path("main-linear")).runs() if run.model == OURS_KEY]
    orders = [int(order) for order in np.unique(np.geomspace(5, 260, 14).astype(int))]
    keys = list(dict.fromkeys(run.texture for run in planned))
    figure, panels = drawn(9, 3.4, 1, len(keys), sharey=True)
    for axes, key in zip(panels, keys, strict=True):
        bounds, reached = zip(*(linear_errors(run, orders) for run in planned if run.texture == key), strict=True)
        mean = {order: float(np.mean([of[order] for of in reached])) for order in ORDERS}

        def ratio(model: str, under: str, unit: str, key: str = key) -> float:
            records = [record for record in runs("main-linear", model) if record["texture"] == key]
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
    legend_of(figure, panels[0], loc="outside lower center", ncols=5)
    return figure


def impact(arguments: argparse.Namespace) -> Figure:
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
    played = slice(start, start + 1500)
    write_sound("listener", [signal[played] for signal in signals.values()], trace.rate_hz)
    return figure


def rates(arguments: argparse.Namespace) -> Figure:
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
    return figure


def capture(arguments: argparse.Namespace) -> Figure:
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
    return figure
