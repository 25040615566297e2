"""Table III: what a step and an epoch cost, framework and runtimes side by side, beside the paper's figures.

    python benchmarks/efficiency.py [--models dstn,ldhtd,…] [--steps 1000] [--seconds 56] [--csv FILE]

A step is a sample, one window at a time on one thread: eager PyTorch, as the
paper measured its own in Keras, ONNX Runtime, and the kernel where it runs the model. An epoch is one of the paper's recipe
(batches of 16) and one of ours (of 128) over the training blocks of a simulated recording as long as the paper's, one thread
each. Networks are untrained: their costs are the same. All in one run; ratios are what to read, since machines differ. A GPU is
measured where there is one. What a sample of foten-plus costs depends on the texture: `foten bench T.foten`.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import platform
import sys
import time
from collections.abc import Callable
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import torch

from foten.baselines.dftnet import Dftnet
from foten.baselines.fit import log_spectra
from foten.baselines.gan import STEPS, Gan, fit_adversarial
from foten.baselines.graph import build, graph_of
from foten.baselines.sizes import TRAINABLE, NoiseModelSizes
from foten.models.registry import GraphSizes
from foten.models.texture_file import Texture
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.recording import Recording
from foten.recording.split import split_blocks
from foten.runtime.native import NativeState, NativeTexture
from foten.runtime.onnx_predictor import GRAPH, OnnxPredictor
from foten.runtime.proof import proved
from foten.simulation.simulate import simulate
from foten.training.config import OWN_RECIPES, RECIPES
from foten.training.job import ScaledBlocks, TrainingJob, scaled_blocks
from foten.training.loop import Monitor
from foten.training.pipeline import reproducible
from foten.training.texture_builder import tensors_of
from foten.training.window_fit import fit_windows, one_step_windows
from result_table import add_csv, report

MODELS = ("dstn", "ldhtd", "gan", "dftnet", "hapinf", "fnn", "ten", "ten-mfcc", "ten-wavelet", "foten", "foten-d")
PAPER = {
    "dstn": (1.89, 44.35),
    "ldhtd": (1.26, 27.45),
    "gan": (2.37, 85.71),
    "foten": (1.11, 10.26),
    "ten": (1.07, 8.92),
    "foten-d": (1.39, 14.81),
}
"""The paper's milliseconds of one inference on a CPU and seconds of one epoch of training, Table III."""
WARM = 50  # steps that are not counted


def p50_us(step: Callable[[], object], n: int) -> float:
    """The median time of a step [µs]."""
    for _ in range(WARM):
        step()
    times = np.empty(n)
    for i in range(n):
        started = time.perf_counter_ns()
        step()
        times[i] = time.perf_counter_ns() - started
    return float(np.median(times)) / 1000


def steps(model: str, n: int, texture: Texture | None) -> dict[str, float]:
    """The median time of a step of each runtime [µs]."""
    torch.manual_seed(0)
    sizes = TRAINABLE[model]()
    network = build(model, sizes).eval()
    window = torch.randn(1, sizes.history, 3)
    predictor = OnnxPredictor(sizes, {GRAPH: graph_of(network, sizes.history)})
    array = window.numpy()
    times = {}
    with torch.no_grad():
        times["pytorch"] = p50_us(lambda: network(window), n)
        if torch.cuda.is_available():
            network, on_gpu = network.cuda(), window.cuda()
            times["gpu"] = p50_us(lambda: network(on_gpu).item(), n)
    times["onnxruntime"] = p50_us(lambda: predictor.predict(array), n)
    if texture is not None:
        state, out = NativeState(NativeTexture(texture.to_bytes()), excitation=False), np.empty(1, np.float32)
        state.set_condition(80.0, 0.8)
        times["kernel"] = p50_us(lambda: state.render(out), n)
    return times


def epoch_s(model: str, blocks: ScaledBlocks, recipe: str) -> float:
    """How long an epoch takes with its validation, the quicker of two [s]; of the GAN, as many spectrograms as windows."""
    changed = {**OWN_RECIPES.get(model, {}), "epochs": 2, "threads": 1, "batch": RECIPES[recipe].batch}
    config, sizes = dataclasses.replace(RECIPES[recipe], **changed), TRAINABLE[model]()
    windows = one_step_windows(blocks, sizes.window)
    with reproducible():
        torch.manual_seed(0)
        network = build(model, sizes)
        if isinstance(network, Gan):
            before, *lines = fit_adversarial(network, sizes.window, blocks, config, Monitor()).epochs
            # Epoch 0 is a validation and no more.
            steps_s = min(line.seconds for line in lines) - before.seconds
            return before.seconds + steps_s * len(windows.train) / (STEPS * config.batch)
        if isinstance(network, Dftnet):
            network, windows = network.spectrum, log_spectra(windows, blocks)
        return min(line.seconds for line in fit_windows(network, windows, config, Monitor()).epochs[1:])


def untrained(model: str, recording: Recording, blocks: ScaledBlocks, config: PreprocessConfig) -> Texture:
    """A texture that the kernel runs, its network untrained."""
    sizes = TRAINABLE[model]()
    card = TrainingJob(recording, model, sizes, RECIPES["default"], config, texture_name="towel").card(blocks, "cpu")
    card |= {"warm_start": {}, "metrics": {"validation_mae_scaled": 1.0}}
    windows = np.random.default_rng(0).standard_normal((64, sizes.window, 3))
    torch.manual_seed(0)
    tensors = tensors_of(build(model, sizes))
    return proved(model, sizes, tensors, blocks.scaling, windows, windows[0], card).texture


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """All times of all models."""
    recording, config = simulate("towel", arguments.seconds + 4.0), PreprocessConfig()
    trace = preprocess(recording, config)
    blocks = scaled_blocks(trace, split_blocks(trace))
    models: dict[str, Any] = {}
    for model in arguments.models:
        sizes = TRAINABLE[model]()
        texture = (
            None if isinstance(sizes, GraphSizes | NoiseModelSizes) else untrained(model, recording, blocks, config)
        )
        models[model] = {
            "window": sizes.window,
            "step_us": steps(model, arguments.steps, texture),
            "epoch_s": {recipe: epoch_s(model, blocks, recipe) for recipe in ("paper", "default")},
        }
        print(model, json.dumps(models[model]), file=sys.stderr, flush=True)
    return {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "n_train_windows": len(blocks.targets(sizes.window)[0]),
        "models": models,
    }


def table(models: dict[str, Any]) -> list[list[str]]:
    """The table: the cost of a step, and of an epoch beside the paper's ratio to its own network."""
    foten_epoch_s = models.get("foten", {}).get("epoch_s", {}).get("paper")
    head = ["model", "PyTorch [µs]", "ONNX Runtime [µs]", "kernel [µs]", "paper's CPU [µs]", "epoch [s]"]
    head += ["foten's epoch ÷ its", "the paper's"]
    on_gpu = any("gpu" in of["step_us"] for of in models.values())
    cells = [[*head, *(["GPU [µs]"] if on_gpu else [])]]
    for key, of in models.items():
        step, epoch = of["step_us"], of["epoch_s"]
        cpu, known = PAPER.get(key, (None, None))
        row = [key, *(f"{step[name]:.0f}" if name in step else "–" for name in ("pytorch", "onnxruntime", "kernel"))]
        row += ["–" if cpu is None else f"{1000 * cpu:.0f}", f"{epoch['paper']:.1f}"]
        row.append("–" if foten_epoch_s is None else f"{foten_epoch_s / epoch['paper']:.2f}")
        row.append("–" if known is None else f"{PAPER['foten'][1] / known:.2f}")
        cells.append(row + ([f"{step['gpu']:.0f}" if "gpu" in step else "–"] if on_gpu else []))
    return cells


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", type=lambda text: tuple(text.split(",")), default=MODELS)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=56.0)
    add_csv(parser)
    arguments = parser.parse_args()
    unknown = set(arguments.models) - set(MODELS)
    if unknown:
        parser.error(f"unknown model {sorted(unknown)[0]}")
    result = measure(arguments)
    report(table(result["models"]), arguments.csv)
    print(f"{result['machine']}; {result['n_train_windows']:,} training windows an epoch", file=sys.stderr)


if __name__ == "__main__":
    main()
