"""The training loop: windows gathered on the device, the best validation loss kept."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from foten.recording.windows import window_indices
from foten.training.config import TrainConfig
from foten.training.dropout import mask, masks_from, set_dropout
from foten.training.loop import Epoch, Progress, Stateful, run_epochs
from foten.training.optimiser import Optimiser


@dataclass(frozen=True)
class TrainingWindows:
    """What a network is fitted to."""

    samples: NDArray[np.float64]  # scaled acceleration, speed, force, shape (n, 3), and what else a network sees
    train: NDArray[np.int64]  # indices to predict
    validation: NDArray[np.int64]
    window: int  # m
    target: NDArray[np.floating] | None = None  # to predict, (n,), or (n, k) for k numbers; None for the acceleration
    unit: NDArray[np.float64] | None = None  # what one of the target is in scaled acceleration, (n,); None for one


class DeviceWindows:
    """Training windows on the device of a network, in float32."""

    def __init__(self, data: TrainingWindows, network: nn.Module) -> None:
        self.device = next(network.parameters()).device
        unit = np.ones(len(data.samples)) if data.unit is None else data.unit
        target = data.samples[:, 0] if data.target is None else data.target
        self.samples, self.target, self.unit = (
            torch.from_numpy(values).to(self.device, torch.float32) for values in (data.samples, target, unit)
        )
        offsets = window_indices(np.zeros(1, dtype=np.int64), data.window)
        self.train, self.validation, self._offsets = (
            torch.from_numpy(n).to(self.device) for n in (data.train, data.validation, offsets)
        )

    def windows(self, n: Tensor) -> Tensor:
        """Return the windows of samples: (b,) → (b, m, 3 or more)."""
        return self.samples[n[:, None] + self._offsets]

    def shuffled(self, seed: int, epoch: int) -> Tensor:
        """Return the training indices in the order of an epoch."""
        generator = torch.Generator().manual_seed(epoch_seed(seed, epoch))
        return self.train[torch.randperm(len(self.train), generator=generator).to(self.device)]


def pick_device() -> torch.device:
    """Return the GPU where there is one, else the CPU."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


@contextmanager
def reproducible() -> Iterator[None]:
    """Fix the algorithms, so that one seed gives one network, and PyTorch's own threads to one; restored afterwards.

    The matrices are too small to share among threads: two gained 15 % on two idle cores, and lost a factor of ten when
    another program kept one of them busy. `fit` shares out the batch instead.
    """
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # else sums on a GPU come in any order
    n_threads, deterministic = torch.get_num_threads(), torch.are_deterministic_algorithms_enabled()
    torch.set_num_threads(1)
    # On the CPU one thread adds up in one order anyway, and the call takes a second, for it loads a compiler.
    on_gpu = torch.cuda.is_available()
    if on_gpu:
        torch.use_deterministic_algorithms(True, warn_only=True)
    try:
        yield
    finally:
        torch.set_num_threads(n_threads)
        if on_gpu:
            torch.use_deterministic_algorithms(deterministic)


def loss_of(config: TrainConfig) -> Callable[[Tensor, Tensor], Tensor]:
    """Return the loss that a configuration names. Source: Eq. 14."""
    if config.loss == "huber":
        return nn.HuberLoss(delta=config.delta)
    return nn.MSELoss() if config.loss == "mse" else nn.L1Loss()


def fit(
    network: nn.Module,
    data: TrainingWindows,
    config: TrainConfig,
    on_epoch: Callable[[Epoch], None] = lambda epoch: None,
    checkpoint: Path | None = None,
    resume: bool = False,
) -> Progress:
    """Train a network in place and leave it at its best validation loss.

    The network before training counts as epoch 0, so that one that starts from a linear predictor never has a higher
    validation loss than it. Ctrl-C ends the loop and keeps the best so far; before there is one, it goes on to the caller.

    Args:
        network: windows (b, m, 3) → (b,) or (b, k), on the CPU or a GPU.
        checkpoint: file that is written after each epoch, and that `resume` goes on from.
    """
    on_device = DeviceWindows(data, network)
    set_dropout(network, config.dropout)
    n_threads = config.threads if on_device.device.type == "cpu" else 1
    trained = list(network.parameters())
    optimiser = Optimiser(dict(network.named_parameters()), config)
    criterion = loss_of(config)

    def gradients(share: Tensor, n: int, seed: int) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Return the loss and gradients of one thread's share of a batch of n."""
        with masks_from(partial(mask, generator=masks_of(seed, on_device.device))):
            loss = criterion(network(on_device.windows(share)), on_device.target[share]) * (len(share) / n)
        return loss.detach(), torch.autograd.grad(loss, trained)

    def one_epoch(epoch: int) -> float:
        torch.manual_seed(epoch_seed(config.seed, epoch))
        total = torch.zeros((), device=on_device.device)
        for number, batch in enumerate(on_device.shuffled(config.seed, epoch).split(config.batch)):
            seeds = itertools.count(mask_seed(config.seed, epoch, number) * n_threads)
            shares = pool.map(gradients, batch.chunk(n_threads), itertools.repeat(len(batch)), seeds)
            losses, pieces = zip(*shares, strict=True)
            # Added in the order of the shares, whichever thread was first.
            for parameter, first, *others in zip(trained, *pieces, strict=True):
                parameter.grad = sum(others, start=first)
            if config.clip_norm > 0:
                nn.utils.clip_grad_norm_(trained, config.clip_norm)
            optimiser.step(rate_of(config, len(on_device.train), epoch, number))
            total += torch.stack(losses).sum() * len(batch)
        return float(total) / len(on_device.train)

    parts: dict[str, Stateful] = {"network": network, "optimiser": optimiser}
    with ThreadPoolExecutor(n_threads) as pool:
        validate = partial(validated, network, on_device, criterion, pool.map)
        return run_epochs(network, config, parts, one_epoch, validate, on_epoch, checkpoint, resume)


def epoch_seed(seed: int, epoch: int) -> int:
    """Return the seed of what an epoch draws, so that a resumed run draws the same."""
    return seed * 100_003 + epoch


def mask_seed(seed: int, epoch: int, number: int) -> int:
    """Return the seed of a step's dropout: none comes twice in any run of fewer than a million steps."""
    return (seed * 1_000 + epoch) * 1_000_000 + number


def masks_of(seed: int, device: torch.device) -> torch.Generator | None:
    """Return what draws a step's dropout; on a GPU its own generator does."""
    return torch.Generator().manual_seed(seed % 2**63) if device.type == "cpu" else None


def rate_of(config: TrainConfig, n_windows: int, epoch: int, number: int) -> float:
    """Return a step's learning rate over its highest: a linear rise over the first tenth of all steps, then half a cosine."""
    if config.schedule == "constant":
        return 1.0
    of_epoch = math.ceil(n_windows / config.batch)
    n_steps, step = of_epoch * config.epochs, of_epoch * (epoch - 1) + number
    rise = max(1, n_steps // 10)
    return (step + 1) / rise if step < rise else 0.5 * (1 + math.cos(math.pi * ((step - rise) / (n_steps - rise))))


def predict(network: nn.Module, data: TrainingWindows, n: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return a network's predictions of the samples n, shape (k,), scaled: of several at once the first."""
    on_device = DeviceWindows(data, network)
    network.eval()
    pieces = np.array_split(n, max(1, math.ceil(len(n) / 4096)))
    with torch.no_grad():
        predicted = [network(on_device.windows(torch.from_numpy(piece).to(on_device.device))).cpu() for piece in pieces]
    return torch.cat(predicted).double().reshape(len(n), -1)[:, 0].numpy()


def validated(
    network: nn.Module,
    on_device: DeviceWindows,
    criterion: Callable[[Tensor, Tensor], Tensor],
    over: Callable[..., Iterator[tuple[float, float]]] = map,  # over batches; or that of a pool of threads
) -> tuple[float, float]:
    """Return a network's loss and mean absolute error on the validation windows, the latter scaled."""
    network.eval()

    def sums(batch: Tensor) -> tuple[float, float]:
        with torch.no_grad():
            predicted, target = network(on_device.windows(batch)), on_device.target[batch]
            missed = (predicted - target).abs().reshape(len(batch), -1).mean(1)
            return float(criterion(predicted, target)) * len(batch), float((on_device.unit[batch].abs() * missed).sum())

    loss, mae = (
        sum(each) / len(on_device.validation)
        for each in zip(*over(sums, on_device.validation.split(1024)), strict=True)
    )
    return loss, mae
