"""Table III: what a step and an epoch cost, framework and runtimes side by side, beside the paper's figures.

    python benchmarks/efficiency.py [--models dstn,ldhtd,…] [--steps 1000] [--seconds 56] [--csv FILE] [--on gpu]

A step is a sample, one window at a time on one thread: eager PyTorch, as the paper measured its own in Keras, the mean of all
steps as in the paper and their median; ONNX Runtime, and the kernel where it runs the model, medians. An epoch is one of the
paper's recipe (batches of 16) over the training blocks of a simulated recording as long as the paper's, one thread; LDHTD's is
one of its teacher and one of the student. Encoder layers train in foten's kernel in C; ratios are of epochs in PyTorch's own
operations, as the other layers train, and so are steps. Sizes that no source states are ours, and the order of the systems
depends on them. Networks are untrained: their costs are the same. All in one run, in three rounds over all models, so that a
machine that slows down slows all alike; ratios are what to read, since machines differ. `--on gpu` measures a GPU instead: steps
in three rounds, then one epoch each, all in PyTorch's own operations; the GAN trains on the CPU. What a sample of foten-plus
costs depends on the texture: `foten bench T.foten`.
"""

import dataclasses
import os
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from unittest.mock import patch

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import torch

from bench import parser_of, report, times_us, write_rows
from foten.models.foten.transformer import EncoderLayer
from foten.models.graph import graph_of
from foten.models.registry import GraphSizes
from foten.models.texture_file import Texture
from foten.models.trainable import TRAINABLE, recipe_of
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.recording import Recording
from foten.recording.split import split_blocks
from foten.runtime.native import NativeState, NativeTexture
from foten.runtime.onnx_predictor import GRAPH, OnnxPredictor
from foten.runtime.proof import proved
from foten.simulation.simulate import simulate
from foten.training.config import PAPER as PAPER_RECIPE
from foten.training.job import ScaledBlocks, TrainingJob, scaled_blocks
from foten.training.loop import Monitor
from foten.training.reproducible import reproducible
from foten.training.texture_builder import tensors_of
from foten.training.window_fit import fit_windows, one_step_windows
from foten_lab.baselines.dftnet import Dftnet
from foten_lab.baselines.fit import log_spectra
from foten_lab.baselines.gan import STEPS, Gan, fit_adversarial
from foten_lab.baselines.networks import build
from foten_lab.baselines.sizes import HapinfSizes, NoiseModelSizes
from foten_lab.provenance import code_here, processor

MODELS = ("dstn", "ldhtd", "gan", "dftnet", "hapinf", "fnn", "ten", "ten-mfcc", "ten-wavelet", "foten", "foten-d")


@dataclasses.dataclass(frozen=True)
class Published:
    """A row of the paper's Table III."""

    gpu_ms: float  # of one inference, mean of 1000
    cpu_ms: float
    epoch_s: float


PAPER = {
    "dstn": Published(1.38, 1.89, 44.35),
    "ldhtd": Published(1.13, 1.26, 27.45),
    "gan": Published(1.72, 2.37, 85.71),
    "ten": Published(0.87, 1.07, 8.92),
    "foten": Published(0.96, 1.11, 10.26),
    "foten-d": Published(1.16, 1.39, 14.81),
}
WARM = 50  # steps of a round that are not counted
ROUNDS = 3


def in_pytorch() -> AbstractContextManager[object]:
    """Encoder layers as PyTorch's own operations."""
    return patch("foten.models.foten.transformer.has_kernel", return_value=False)


def has_encoder(model: str) -> bool:
    """Whether a model, or what it is distilled from, has encoder layers."""
    network = build(TRAINABLE[model].sizes())
    return model == "ldhtd" or any(isinstance(module, EncoderLayer) for module in network.modules())


def epochs_s(model: str, blocks: ScaledBlocks, device: str = "cpu") -> tuple[float, float | None]:
    """How long an epoch takes, and that of the teacher of a model that has one [s]."""
    teacher_s = epoch_s("hapinf", blocks, TRAINABLE[model].sizes().window, device) if model == "ldhtd" else None
    return epoch_s(model, blocks, device=device) + (teacher_s or 0.0), teacher_s


def steps(model: str, n: int, texture: Texture | None) -> dict[str, list[float]]:
    """How long each of n steps takes in each runtime [µs]."""
    torch.manual_seed(0)
    sizes = TRAINABLE[model].sizes()
    network = build(sizes).eval()
    window = torch.randn(1, sizes.history, 3)
    predictor = OnnxPredictor(sizes, {GRAPH: graph_of(network, sizes.history)})
    array = window.numpy()
    times = {}
    with torch.no_grad(), in_pytorch():
        times["pytorch"] = times_us(lambda: network(window), n, WARM)
    times["onnxruntime"] = times_us(lambda: predictor.predict(array), n, WARM)
    if texture is not None:
        state, out = NativeState(NativeTexture(texture.to_bytes()), excitation=False), np.empty(1, np.float32)
        state.set_condition(80.0, 0.8)
        times["kernel"] = times_us(lambda: state.render(out), n, WARM)
    return times


def steps_on_gpu(model: str, n: int) -> list[float]:
    """How long each of n steps takes in PyTorch on a GPU, its result read back [µs]."""
    torch.manual_seed(0)
    sizes = TRAINABLE[model].sizes()
    network, window = build(sizes).eval().cuda(), torch.randn(1, sizes.history, 3).cuda()
    with torch.no_grad():
        return times_us(lambda: network(window).cpu(), n, WARM)


def epoch_s(model: str, blocks: ScaledBlocks, window: int | None = None, device: str = "cpu") -> float:
    """How long an epoch takes with its validation [s]; of the GAN, as many spectrograms as windows.

    Args:
        window: samples; by default the model's.
        device: on which it trains, the GAN aside, which does so on the CPU.
    """
    recipe = "paper" if "paper" in TRAINABLE[model].recipes else "default"
    sizes = TRAINABLE[model].sizes() if window is None else HapinfSizes(window=window, n_start=min(10, window))
    config = recipe_of(model, recipe, epochs=1, batch=PAPER_RECIPE["batch"])
    windows = one_step_windows(blocks, sizes.window)
    with reproducible():
        torch.manual_seed(0)
        network = build(sizes).to(device)
        if isinstance(network, Gan):
            # Epoch 0 is a validation and no more.
            before, line = fit_adversarial(network, sizes.window, blocks, config, Monitor()).epochs
            return before.seconds + (line.seconds - before.seconds) * len(windows.train) / (STEPS * config.batch)
        if isinstance(network, Dftnet):
            network, windows = network.spectrum, log_spectra(windows, blocks)
        return fit_windows(network, windows, config, Monitor()).epochs[1].seconds


def untrained(model: str, recording: Recording, blocks: ScaledBlocks) -> Texture:
    """A texture that the kernel runs, its network untrained."""
    sizes = TRAINABLE[model].sizes()
    job = TrainingJob(recording, model, sizes, recipe_of(model), PreprocessConfig(), texture_name="towel")
    card = job.card(blocks, "cpu")
    card |= {"warm_start": {}, "metrics": {"validation_mae_scaled": 1.0}}
    windows = np.random.default_rng(0).standard_normal((64, sizes.window, 3))
    torch.manual_seed(0)
    tensors = tensors_of(build(sizes))
    return proved(model, sizes, tensors, blocks.scaling, windows, windows[0], card).texture


def gpu_table(models: Sequence[str], n: int, blocks: ScaledBlocks) -> list[list[str]]:
    """Steps in rounds [µs] and one epoch [s] of each model on a GPU, a teacher's with its student's, beside the paper's."""
    times: dict[str, list[float]] = defaultdict(list)
    for model in [*models] * ROUNDS:
        times[model] += steps_on_gpu(model, -(-n // ROUNDS))
    epochs: dict[str, float] = {}
    for model in models:
        if model != "gan":  # which trains on the CPU
            epochs[model], _ = epochs_s(model, blocks, "cuda")
            print(f"{model}: an epoch takes {epochs[model]:.1f} s", file=sys.stderr, flush=True)
    heads = ("step, mean [µs]", "median", "the paper's mean [µs]", "epoch [s]", "foten's ÷ its", "the paper's")
    cells = [["model", *heads]]
    for model, of in times.items():
        published = f"{1000 * PAPER[model].gpu_ms:.0f}" if model in PAPER else "–"
        epoch = f"{epochs[model]:.1f}" if model in epochs else "–"
        step = f"{np.mean(of):.0f}", f"{np.median(of):.0f}", published
        cells.append([model, *step, epoch, *ratios_of(model, epochs)])
    return cells


def ratios_of(model: str, epochs: Mapping[str, float]) -> tuple[str, str]:
    """Epoch of FoTEN over that of a model, here and in the paper."""
    ratio = f"{epochs['foten'] / epochs[model]:.2f}" if {"foten", model} <= epochs.keys() else "–"
    return ratio, f"{PAPER['foten'].epoch_s / PAPER[model].epoch_s:.2f}" if model in PAPER else "–"


Times = dict[str, dict[str, list[float]]]
"""By runtime, or what an epoch is of, and model."""


def measured(models: Sequence[str], n: int, recording: Recording, blocks: ScaledBlocks) -> tuple[Times, Times]:
    """Steps of all models on the CPU [µs], and epochs, those of teachers, and epochs in PyTorch alone [s], in rounds."""
    times: Times = defaultdict(lambda: defaultdict(list))
    epochs: Times = defaultdict(lambda: defaultdict(list))
    for i in range(ROUNDS):
        for model in models:
            by_graph = isinstance(TRAINABLE[model].sizes(), GraphSizes | NoiseModelSizes)
            texture = None if by_graph else untrained(model, recording, blocks)
            for runtime, of in steps(model, -(-n // ROUNDS), texture).items():
                times[runtime][model] += of
        for model in models:
            epoch, teacher = epochs_s(model, blocks)
            with in_pytorch():
                in_own, _ = epochs_s(model, blocks) if has_encoder(model) else (epoch, teacher)
            epochs["epoch"][model].append(epoch)
            epochs["PyTorch"][model].append(in_own)
            if teacher is not None:
                epochs["teacher"][model].append(teacher)
            print(f"round {i + 1} of {ROUNDS}, {model}: an epoch takes {epoch:.1f} s", file=sys.stderr, flush=True)
    return times, epochs


def step_table(times: Times) -> list[list[str]]:
    """The cost of a step on a CPU, beside the paper's."""
    heads = ["PyTorch, mean [µs]", "median", "ONNX Runtime, median", "kernel, median", "paper's mean [µs]"]
    cells = [["model", "input [samples]", *heads]]
    for model, of in times["pytorch"].items():
        others = (times[name].get(model) for name in ("onnxruntime", "kernel"))
        medians = (f"{np.median(us):.0f}" if us else "–" for us in (of, *others))
        published = f"{1000 * PAPER[model].cpu_ms:.0f}" if model in PAPER else "–"
        cells.append([model, str(TRAINABLE[model].sizes().window), f"{np.mean(of):.0f}", *medians, published])
    return cells


def epoch_table(epochs: Times) -> list[list[str]]:
    """The cost of an epoch, of all rounds the quickest, and foten's over it, both in PyTorch alone, beside the paper's."""
    heads = ["model", "parameters that render", "epoch [s]", "of it the teacher's", "epoch in PyTorch alone [s]"]
    cells = [[*heads, "foten's ÷ its", "the paper's"]]
    quickest = {kind: {model: min(rounds) for model, rounds in of.items()} for kind, of in epochs.items()}
    for model, seconds in quickest["epoch"].items():
        n_parameters = sum(parameter.numel() for parameter in build(TRAINABLE[model].sizes()).parameters())
        teacher = f"{quickest['teacher'][model]:.1f}" if model in quickest.get("teacher", {}) else ""
        times = f"{seconds:.1f}", teacher, f"{quickest['PyTorch'][model]:.1f}"
        cells.append([model, f"{n_parameters:,}", *times, *ratios_of(model, quickest["PyTorch"])])
    return cells


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--models", type=lambda text: tuple(text.split(",")), default=MODELS)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=56.0)
    parser.add_argument("--on", choices=("cpu", "gpu"), default="cpu")
    arguments = parser.parse_args()
    unknown = set(arguments.models) - set(MODELS)
    if unknown:
        parser.error(f"unknown model {sorted(unknown)[0]}")
    if arguments.on == "gpu" and not torch.cuda.is_available():
        parser.error("PyTorch finds no GPU: is this its CPU build?")
    recording = simulate("towel", arguments.seconds + 4.0)
    trace = preprocess(recording, PreprocessConfig())
    blocks = scaled_blocks(trace, split_blocks(trace))
    if arguments.on == "gpu":
        machine, cells = torch.cuda.get_device_name(), gpu_table(arguments.models, arguments.steps, blocks)
        report(cells)
    else:
        machine = f"{processor()}, {os.cpu_count()} cores"
        times, epochs = measured(arguments.models, arguments.steps, recording, blocks)
        per_step, per_epoch = step_table(times), epoch_table(epochs)
        report(per_step)
        print()
        report(per_epoch)
        cells = [[*first, *second[1:]] for first, second in zip(per_step, per_epoch, strict=True)]
    if arguments.csv is not None:
        head, *rows = cells
        about = {"machine": machine, "code": code_here()}
        write_rows([dict(zip(head, row, strict=True)) | about for row in rows], arguments.csv)
    n_windows = len(blocks.targets(TRAINABLE[arguments.models[-1]].sizes().window)[0])
    print(f"{machine}; {n_windows:,} training windows an epoch", file=sys.stderr)


if __name__ == "__main__":
    main()
