"""Table III: what a step and an epoch cost, framework and runtimes side by side, beside the paper's figures.

    python benchmarks/efficiency.py [--models dstn,ldhtd,…] [--steps 1000] [--seconds 56] [--save FILE] [--page FILE]

A step is a sample, one window at a time on one thread (of ldhtd-hop a twentieth of what a window costs): eager PyTorch, as the
paper measured its own in Keras, ONNX Runtime, and the kernel where it runs the model. An epoch is one of the paper's recipe
(batches of 16) and one of ours (of 128) over the training blocks of a simulated recording as long as the paper's, one thread
each; of foten-plus without the fit of its lattice. Networks are untrained: their costs are the same. All in one run; ratios are
what to read, since machines differ. A GPU is measured where there is one.
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
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import torch
from foten.architecture import ARCHITECTURES, GRAPHS, NETWORKS
from foten.train.goals import ahead, spectra
from foten.train.prepared import Prepared, prepare

from foten.atomic_write import atomic_write
from foten.datasets.simulate import simulate
from foten.experiments.paper import PAPER
from foten.families.texture_file import Texture
from foten.networks import build
from foten.networks.dftnet import Dftnet
from foten.networks.foten_plus import FotenPlus
from foten.networks.gan import Gan
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.scaling import fit_scaling
from foten.recording.split import split_blocks
from foten.recording.windows import targets
from foten.runtime.native import NativeState, NativeTexture
from foten.runtime.onnx_predictor import GRAPH, GraphEngine
from foten.train.adversarial import STEPS, fit_adversarial
from foten.train.card import card_of
from foten.train.config import OWN_RECIPES, RECIPES
from foten.train.export import export, graph_of
from foten.train.fit import Data, fit, reproducible
from main_table import between

MODELS = (
    "dstn",
    "ldhtd",
    "ldhtd-hop",
    "gan",
    "dftnet",
    "hapinf",
    "fnn",
    "ten",
    "ten-mfcc",
    "ten-wavelet",
    "foten",
    "foten-d",
    "foten-plus",
)
WARM = 50  # steps that are not counted


def p50_us(step: Callable[[], object], n: int) -> float:
    """Return the median time of a step [µs]."""
    for _ in range(WARM):
        step()
    times = np.empty(n)
    for i in range(n):
        started = time.perf_counter_ns()
        step()
        times[i] = time.perf_counter_ns() - started
    return float(np.median(times)) / 1000


def steps(key: str, n: int, texture: Texture | None) -> dict[str, float]:
    """Return the median time of a step of each runtime [µs]."""
    if key == "foten-plus":  # as foten's where its network is heard, else its lattice's
        return {}
    torch.manual_seed(0)
    architecture = ARCHITECTURES[key]()
    network = build(key, architecture).eval()
    window = torch.randn(1, architecture.history, 3)
    engine = GraphEngine(architecture, {GRAPH: graph_of(network, architecture.history)})
    array = window.numpy()
    found = {}
    with torch.no_grad():
        found["pytorch"] = p50_us(lambda: network(window), n)
        if torch.cuda.is_available():
            network, given = network.cuda(), window.cuda()
            found["gpu"] = p50_us(lambda: network(given).item(), n)
    out = np.empty(architecture.n_ahead, np.float32)
    found["onnxruntime"] = p50_us(lambda: engine.answer(array, out), n)
    found = {name: of / architecture.n_ahead for name, of in found.items()}
    if texture is not None:
        state, out = NativeState(NativeTexture(texture.to_bytes()), excitation=False), out[:1]
        state.set_hand(80.0, 0.8)
        found["kernel"] = p50_us(lambda: state.render(out), n)
    return found


def epoch_s(key: str, data: Data, prepared: Prepared, recipe: str) -> float:
    """Return how long an epoch takes with its validation, the quicker of two [s]; of the GAN, as many spectrograms as windows."""
    own = {**OWN_RECIPES.get(key, {}), "epochs": 2, "threads": 1, "batch": RECIPES[recipe].batch}
    config = dataclasses.replace(RECIPES[recipe], **own)
    architecture = ARCHITECTURES[key]()
    with reproducible():
        torch.manual_seed(0)
        network = build(key, architecture)
        if isinstance(network, Gan):
            before, *lines = fit_adversarial(network, architecture.window, prepared, config).epochs
            # Epoch 0 is a validation and no more.
            steps_s = min(line.seconds for line in lines) - before.seconds
            return before.seconds + steps_s * len(data.train) / (STEPS * config.batch)
        if isinstance(network, Dftnet):
            network, data = network.spectrum, spectra(data, prepared)
        elif isinstance(network, FotenPlus):
            network, data = network.network, _of_innovations(data)
        elif architecture.n_ahead > 1:
            data = ahead(data, prepared, architecture.n_ahead)
        return min(line.seconds for line in fit(network, data, config).epochs[1:])


def _of_innovations(data: Data) -> Data:
    """Return data as foten-plus learns them, with a channel of innovations: here the samples themselves."""
    innovations = data.samples[:, 0].copy()
    samples = np.concatenate([data.samples, innovations[:, None]], axis=1)
    return Data(samples, data.train, data.validation, data.window, innovations, np.ones(len(samples)))


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return all times of all models."""
    recording = simulate("towel", arguments.seconds + 4.0)
    config = PreprocessConfig()
    trace = preprocess(recording, config)
    split = split_blocks(trace)
    prepared = prepare(trace, split)
    samples = fit_scaling(trace, split.train).scale(trace.stacked())
    found: dict[str, Any] = {}
    for key in arguments.models:
        m = ARCHITECTURES[key]().window
        data = Data(
            samples, targets(split.train, trace.block, m), targets(split.validation, trace.block, m), m
        )
        texture = None
        if key in NETWORKS and key != "foten-plus":
            card = card_of(recording, prepared, config, "towel", "") | {
                "beyond_exponents": {"speed": 0.0, "force": 0.0},
                "warm_start": {},
                "training": {},
                "metrics": {"validation_mae_scaled": 1.0},
            }
            windows = np.random.default_rng(0).standard_normal((64, m, 3))
            torch.manual_seed(0)
            texture = export(
                build(key, ARCHITECTURES[key]()),
                key,
                ARCHITECTURES[key](),
                prepared.scaling,
                windows,
                windows[0],
                card,
            )
        found[key] = {
            "window": m,
            "step_us": steps(key, arguments.steps, texture),
            "epoch_s": {recipe: epoch_s(key, data, prepared, recipe) for recipe in ("paper", "default")},
        }
        print(key, json.dumps(found[key]), file=sys.stderr, flush=True)
    return {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "n_train_windows": len(data.train),
        "models": found,
    }


def table(result: dict[str, Any]) -> str:
    """Return the table."""
    models = result["models"]
    own = models.get("foten", {}).get("epoch_s", {}).get("paper")
    head = (
        "| model | window | PyTorch [µs] | ONNX Runtime [µs] | kernel [µs] | GPU [µs] | paper's CPU [µs] | GPU [µs] | "
        "epoch, batches of 16 [s] | of 128 [s] | foten's epoch ÷ its | the paper's |"
    )
    lines = [head, "|" + "---|" * 12]
    for key, of in models.items():
        step, epoch = of["step_us"], of["epoch_s"]
        reported = PAPER.get(key)
        cpu, gpu = (None, None) if reported is None else (reported.cpu_ms, reported.gpu_ms)
        ratio = "–" if own is None else f"{own / epoch['paper']:.2f}"
        theirs = PAPER["foten"].epoch_s
        known = None if reported is None else reported.epoch_s
        paper_ratio = "–" if known is None or theirs is None else f"{theirs / known:.2f}"
        cells = [
            key,
            str(of["window"]),
            *(
                f"{step[name]:.0f}" if name in step else "–"
                for name in ("pytorch", "onnxruntime", "kernel", "gpu")
            ),
            *(f"{1000 * value:.0f}" if value is not None else "–" for value in (cpu, gpu)),
            f"{epoch['paper']:.1f}",
            f"{epoch['default']:.1f}",
            ratio,
            paper_ratio,
        ]
        lines.append(f"| {' | '.join(cells)} |")
    said = f"{result['machine']}; {result['n_train_windows']:,} training windows an epoch."
    unmeasured = "" if any("gpu" in of["step_us"] for of in models.values()) else " There was no GPU."
    lines.append(f"\n{said}{unmeasured} The paper's figures are of Keras on its own machine.")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--models", type=lambda text: tuple(text.split(",")), default=MODELS)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=56.0)
    parser.add_argument("--save", type=Path, metavar="FILE", help="keep the result as JSON there")
    parser.add_argument(
        "--page", type=Path, metavar="FILE", help="put what is saved between its markers there"
    )
    arguments = parser.parse_args()
    unknown = set(arguments.models) - {*NETWORKS, *GRAPHS}
    if unknown:
        parser.error(f"unknown model {sorted(unknown)[0]}")
    if arguments.page is not None and arguments.save is not None and arguments.save.exists():
        result = json.loads(arguments.save.read_text())
    else:
        result = measure(arguments)
        if arguments.save is not None:
            with atomic_write(arguments.save) as part:
                part.write_text(json.dumps(result, indent=1) + "\n")
    between(arguments.page, "efficiency", table(result))


if __name__ == "__main__":
    main()
