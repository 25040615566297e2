"""Fit of networks to windows, and the texture of one, with an excitation or without."""

import math
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from foten.dsp import Array
from foten.models.excitation import WithExcitation
from foten.models.model_sizes import ModelSizes
from foten.recording.windows import first_scored, window_indices
from foten.runtime.proof import MakeModel, Tensors
from foten.training.calibration import ClosedLoop, Residuals, calibrate_excitation
from foten.training.checkpoint import Progress
from foten.training.config import LoopConfig, WindowConfig
from foten.training.dropout import bits_from, random_bits, set_dropout
from foten.training.initial_weights import draw_glorot
from foten.training.job import ScaledBlocks, Trained, TrainingJob
from foten.training.loop import (
    Loop,
    Monitor,
    Optimiser,
    epoch_seed,
    gradient_step,
    run_loop,
    schedule,
    shared_gradients,
)
from foten.training.texture_builder import TextureBuilder


@dataclass(frozen=True)
class TrainingWindows:
    """Samples, and the indices of those to predict from windows before them."""

    samples: NDArray[np.float64]  # scaled acceleration, speed, force, shape (n, 3), and what else a network sees
    train: NDArray[np.int64]  # indices to predict
    validation: NDArray[np.int64]
    window: int  # m
    target: NDArray[np.floating] | None = None  # to predict, (n,), or (n, k) for k numbers; None for the acceleration


class DeviceWindows:
    """Training windows on the device of a network, in float32."""

    def __init__(self, data: TrainingWindows, network: nn.Module) -> None:
        self.device = next(network.parameters()).device
        target = data.samples[:, 0] if data.target is None else data.target
        self.samples, self.target = (
            torch.from_numpy(values).to(self.device, torch.float32) for values in (data.samples, target)
        )
        offsets = window_indices(np.zeros(1, dtype=np.int64), data.window)
        self.train, self.validation, self._offsets = (
            torch.from_numpy(n).to(self.device) for n in (data.train, data.validation, offsets)
        )

    def windows(self, n: Tensor) -> Tensor:
        """Windows of samples: (b,) → (b, m, 3 or more)."""
        return self.samples[n[:, None] + self._offsets]

    def shuffled(self, seed: int, epoch: int) -> Tensor:
        """Training indices in the order of an epoch."""
        generator = torch.Generator().manual_seed(epoch_seed(seed, epoch))
        return self.train[torch.randperm(len(self.train), generator=generator).to(self.device)]


def loss_of(config: WindowConfig) -> Callable[[Tensor, Tensor], Tensor]:
    """The loss that a configuration names. Source: Eq. 14."""
    if config.loss == "huber":
        return nn.HuberLoss(delta=config.delta)
    return nn.MSELoss() if config.loss == "mse" else nn.L1Loss()


def fit_windows(
    network: nn.Module, data: TrainingWindows, config: WindowConfig, monitor: Monitor, name: str = "network"
) -> Progress:
    """Train a new network in place, windows (b, m, 3) → (b,) or (b, k); see `run_loop`. `name` is that in a checkpoint."""
    if config.initial_weights == "glorot":
        draw_glorot(network)
    on_device = DeviceWindows(data, network)
    set_dropout(network, config.dropout)
    n_threads = config.threads if on_device.device.type == "cpu" else 1
    n_steps = math.ceil(len(data.train) / config.batch)
    parameters = dict(network.named_parameters())
    optimiser = Optimiser(parameters, config, config.matrix_learning_rate if config.optimiser == "muon" else 0.0)
    criterion = loss_of(config)
    batches: tuple[Tensor, ...] = ()

    def gradients(epoch: int, number: int) -> tuple[Tensor, list[Tensor]]:
        nonlocal batches
        if number == 0:
            torch.manual_seed(epoch_seed(config.seed, epoch))
            batches = on_device.shuffled(config.seed, epoch).split(config.batch)
        shares = batches[number].chunk(n_threads)
        # No seed comes twice in 1000 epochs of a million steps.
        seed = ((config.seed * 1_000 + epoch) * 1_000_000 + number) * n_threads

        def loss_of_share(k: int) -> Tensor:
            on_cpu = on_device.device.type == "cpu"  # on a GPU its own generator draws
            generator = torch.Generator().manual_seed((seed + k) % 2**63) if on_cpu else None
            with bits_from(partial(random_bits, generator=generator)):
                loss = criterion(network(on_device.windows(shares[k])), on_device.target[shares[k]])
                return loss * (len(shares[k]) / len(batches[number]))

        loss, values = shared_gradients(list(parameters.values()), pool, loss_of_share, len(shares))
        share = len(batches[number]) * n_steps / len(data.train)  # for the mean over windows, not over steps
        return loss * share, values

    with ThreadPoolExecutor(n_threads) as pool:
        step = gradient_step(network, optimiser, gradients, config.clip_norm, schedule(config, n_steps))
        validate = partial(validated, data=on_device, criterion=criterion, over=pool.map)
        trial = config.trial_epochs, config.min_gain
        loop = Loop(name, network, n_steps, step, validate, {"optimiser": optimiser}, trial=trial)
        return run_loop(loop, config, monitor)


def predict(network: nn.Module, data: TrainingWindows, n: NDArray[np.int64]) -> NDArray[np.float64]:
    """A network's predictions of the samples n, shape (k,), scaled."""
    on_device = DeviceWindows(data, network)
    network.eval()
    pieces = np.array_split(n, max(1, math.ceil(len(n) / 4096)))
    with torch.no_grad():
        predicted = [network(on_device.windows(torch.from_numpy(piece).to(on_device.device))).cpu() for piece in pieces]
    return torch.cat(predicted).double().numpy()


def validated(
    network: nn.Module,
    data: DeviceWindows,
    criterion: Callable[[Tensor, Tensor], Tensor],
    over: Callable[..., Iterable[tuple[float, float]]] = map,  # over batches; or that of a pool of threads
) -> tuple[float, float]:
    """A network's loss and mean absolute error on the validation windows, the latter scaled."""
    network.eval()

    def sums(batch: Tensor) -> tuple[float, float]:
        with torch.no_grad():
            predicted, target = network(data.windows(batch)), data.target[batch]
            error = (predicted - target).abs().reshape(len(batch), -1).mean(1)
            return float(criterion(predicted, target)) * len(batch), float(error.sum())

    loss, mae = (
        sum(each) / len(data.validation) for each in zip(*over(sums, data.validation.split(1024)), strict=True)
    )
    return loss, mae


@dataclass(frozen=True)
class Packed:
    """A network as its texture file holds it."""

    sizes: ModelSizes
    tensors: Tensors
    definition: MakeModel
    metrics: dict[str, Any] = field(default_factory=dict)


def one_step_windows(blocks: ScaledBlocks, m: int) -> TrainingWindows:
    """Windows of m samples, whose targets are the accelerations that follow; validated are those that a test would score.

    So that validation errors of different windows are of the same samples.
    """
    (train, validation), block = blocks.targets(m), blocks.trace.block
    return TrainingWindows(blocks.flat, train, validation[validation % block >= first_scored(block)], m)


def one_step_texture(
    job: TrainingJob, blocks: ScaledBlocks, network: nn.Module, progress: Progress, packed: Packed, monitor: Monitor
) -> Trained:
    """A texture of a trained network, with an excitation where one is asked for."""
    assert isinstance(job.config, LoopConfig)
    best, sizes, tensors = progress.best, packed.sizes, packed.tensors
    card = job.card(blocks, next(network.parameters()).device.type)
    builder = TextureBuilder(job.model, blocks, card, packed.definition)
    metrics: dict[str, Any] = {
        "validation_loss": best.validation_loss,
        "validation_mae_scaled": best.validation_mae,
        "recorded_peak_sd": blocks.peak_sd,
        "best_epoch": best.epoch,
        "n_epochs": progress.epochs[-1].epoch,
        **packed.metrics,
    }
    if isinstance(sizes, WithExcitation) and sizes.excitation:
        monitor.on_stage("fitting the excitation and calibrating its level in the closed loop")
        residuals = _residuals(blocks, network, sizes.window)
        loop = ClosedLoop(
            blocks, sizes.history, partial(builder.kernel, sizes, tensors), _unit_power, limit=blocks.saturation
        )
        loop = loop.with_unit_sigma(sizes.excitation_width, residuals.largest)
        calibrated = calibrate_excitation(sizes.excitation_width, residuals, loop, job.config.seed)
        metrics |= calibrated.metrics()
        tensors = {**tensors, **calibrated.excitation.tensors()}
    monitor.on_stage("proving the texture file")
    texture = builder.texture(sizes, tensors, metrics).texture
    return Trained(texture, blocks.trace, blocks.split, progress)


def _unit_power(condition: Array) -> tuple[Array, Array]:
    return np.ones(len(condition)), np.zeros(len(condition))


def _residuals(blocks: ScaledBlocks, network: nn.Module, m: int) -> Residuals:
    windows = one_step_windows(blocks, m)
    n = np.concatenate([windows.train, windows.validation])
    residual = windows.samples[n, 0] - predict(network, windows, n)
    gain, moving = np.ones(len(n)), blocks.moving().ravel()[n]
    return Residuals(windows.samples[n - 1, 1:3], residual, gain, len(windows.train), moving)
