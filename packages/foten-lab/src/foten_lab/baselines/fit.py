"""Fit of the baselines: one step ahead, to spectra, by a teacher, or against a discriminator."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import nn

from foten.models.excitation import Excitation
from foten.models.graph import graph_of, in_float64, multiply_adds
from foten.models.model_sizes import ModelSizes
from foten.models.registry import GRAPH, GraphSizes
from foten.models.stream import Model
from foten.models.window_model import NoiseModel, WindowModel
from foten.runtime.onnx_predictor import INPUT, NOISE
from foten.runtime.proof import Tensors
from foten.training.checkpoint import Progress
from foten.training.config import LoopConfig, WindowConfig
from foten.training.job import ScaledBlocks, Trained, TrainingJob, check_block
from foten.training.loop import Monitor, pick_device
from foten.training.window_fit import Packed, TrainingWindows, fit_windows, one_step_texture, one_step_windows, predict
from foten_lab.baselines.gan import Gan, fit_adversarial
from foten_lab.baselines.networks import build
from foten_lab.baselines.noise_filter import log_magnitudes
from foten_lab.baselines.sizes import HapinfSizes, NoiseModelSizes

_AT_ONCE = 65536  # frames


def fit_one_step(job: TrainingJob, monitor: Monitor) -> Trained:
    """A texture of a network that predicts the next sample from a window."""
    blocks, windows, config = _windows_of(job)
    return _fitted_one_step(job, blocks, windows, config, monitor, Progress())


def fit_distilled(job: TrainingJob, monitor: Monitor) -> Trained:
    """A texture of a network that a teacher is trained for first."""
    blocks, windows, config = _windows_of(job)
    windows, teacher = distilled(windows, job.sizes.window, config, monitor)
    monitor.on_stage(f"training the student, {job.model}")
    return _fitted_one_step(job, blocks, windows, config, monitor, teacher)


def fit_spectra(job: TrainingJob, monitor: Monitor) -> Trained:
    """A texture of a network that is fitted to spectra of short frames."""
    blocks, windows, config = _windows_of(job)
    network = build(job.sizes).to(pick_device())
    progress = fit_windows(network.spectrum, log_spectra(windows, blocks), config, monitor)
    packed = noise_graph(network, job.sizes, progress.best.validation_mae)
    return one_step_texture(job, blocks, network, progress, packed, monitor)


def fit_generator(job: TrainingJob, monitor: Monitor) -> Trained:
    """A texture of a generator of spectra, trained on the CPU against a discriminator."""
    assert isinstance(job.config, LoopConfig)
    blocks, network = _prepared(job, job.config.seed), build(job.sizes)
    assert isinstance(network, Gan)
    progress = fit_adversarial(network, job.sizes.window, blocks, job.config, monitor)
    packed = noise_graph(network, job.sizes, progress.best.validation_mae, "means")
    return one_step_texture(job, blocks, network, progress, packed, monitor)


def _prepared(job: TrainingJob, seed: int) -> ScaledBlocks:
    """The recording in blocks, with PyTorch's seed set.

    Raises:
        ImportError: before training, where ONNX or ONNX Runtime is not installed.
    """
    import onnx  # noqa: F401
    import onnxruntime  # noqa: F401

    blocks = job.blocks()
    check_block(blocks, job.sizes.window)
    torch.manual_seed(seed)
    return blocks


def _windows_of(job: TrainingJob) -> tuple[ScaledBlocks, TrainingWindows, WindowConfig]:
    assert isinstance(job.config, WindowConfig)
    blocks = _prepared(job, job.config.seed)
    return blocks, one_step_windows(blocks, job.sizes.window), job.config


def _fitted_one_step(
    job: TrainingJob,
    blocks: ScaledBlocks,
    windows: TrainingWindows,
    config: WindowConfig,
    monitor: Monitor,
    teacher: Progress,
) -> Trained:
    network = build(job.sizes).to(pick_device())
    progress = fit_windows(network, windows, config, monitor)
    progress.include(teacher)
    return one_step_texture(job, blocks, network, progress, one_step_graph(network, job.sizes), monitor)


def one_step_graph(network: nn.Module, sizes: ModelSizes) -> Packed:
    """A one-step network as the graph of a texture file; the network in float64 is its definition."""
    assert isinstance(sizes, GraphSizes)
    in_double, in_card = in_float64(network), GraphSizes(sizes.window, sizes.excitation, sizes.excitation_width)

    def definition(in_file: ModelSizes, tensors: Tensors) -> Model:
        return WindowModel(in_double, in_file.window, Excitation.of(tensors) if in_file.excited else None)

    graph, cost = graph_of(network, sizes.window, name=INPUT), multiply_adds(network, sizes.window)
    return Packed(in_card, {GRAPH: graph}, definition, {"multiply_adds": cost})


def noise_graph(network: nn.Module, sizes: ModelSizes, spectrum_error_nat: float, of: str = "frames") -> Packed:
    """A filter of noise as the graph of a texture file, with the error [nat] of the log spectra of single frames, or of means."""
    assert isinstance(sizes, NoiseModelSizes)
    in_double = in_float64(network)

    def definition(in_file: ModelSizes, tensors: Tensors) -> Model:
        return NoiseModel(in_double, in_file.window)

    error_db = 20 / math.log(10) * spectrum_error_nat
    metrics: dict[str, Any] = {"validation_mae_scaled": None, "validation_spectrum_db": error_db}
    metrics["validation_spectrum_of"] = of
    metrics["multiply_adds"] = multiply_adds(network, sizes.window)
    graph = graph_of(network, sizes.window, name=NOISE)
    return Packed(GraphSizes(sizes.window), {GRAPH: graph}, definition, metrics)


def distilled(
    windows: TrainingWindows, m: int, config: WindowConfig, monitor: Monitor
) -> tuple[TrainingWindows, Progress]:
    """Windows whose training targets are the means of the recording and a teacher's predictions, and its training.

    0.5 (y − s)² + 0.5 (t − s)² differs from the squared error against that mean by a constant.
    """
    monitor.on_stage("training the teacher, hapinf")
    teacher = build(HapinfSizes(window=m, n_start=min(10, m))).to(pick_device())
    progress = fit_windows(teacher, windows, config, monitor, "teacher")
    if progress.interrupted:
        raise KeyboardInterrupt
    target = windows.samples[:, 0].copy()
    target[windows.train] = 0.5 * (target[windows.train] + predict(teacher, windows, windows.train))
    return replace(windows, target=target), progress


def log_spectra(windows: TrainingWindows, blocks: ScaledBlocks) -> TrainingWindows:
    """Windows that end before the middle of a frame, whose log magnitudes are the target, (n, m // 2 + 1), float32."""
    m, block = windows.window, blocks.trace.block
    acceleration = torch.from_numpy(blocks.samples[..., 0]).float()
    target = np.zeros((len(windows.samples), m // 2 + 1), dtype=np.float32)
    framed = []
    for n in (windows.train, windows.validation):
        within = n % block
        framed.append(n[((within - m) % max(1, m // 25) == 0) & (within - m // 2 + m <= block)])
        for some in np.split(framed[-1], range(_AT_ONCE, len(framed[-1]), _AT_ONCE)):
            around = torch.from_numpy(some % block - m // 2)[:, None] + torch.arange(m)
            target[some] = log_magnitudes(acceleration[torch.from_numpy(some // block)[:, None], around]).numpy()
    return replace(windows, train=framed[0], validation=framed[1], target=target)
