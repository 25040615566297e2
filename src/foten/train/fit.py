"""The training loop: windows gathered on the device, the best validation loss kept."""

from __future__ import annotations

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

from foten.networks.dropout import mask, masks_from, set_dropout
from foten.recording.windows import window_indices
from foten.train.config import TrainConfig
from foten.train.epochs import Epoch, Progress, Stateful, run_epochs
from foten.train.optimiser import Optimiser


@dataclass(frozen=True)
class TrainingWindows:
    """What a network is fitted to.

    Attributes:
        samples: what windows are cut from: scaled acceleration, speed, force, shape (n, 3), and what else a network sees.
        train, validation: indices to predict.
        window: m.
        target: what is to be predicted, shape (n,), or (n, k) of a network that gives k numbers; None for the acceleration.
        unit: what one of the target is worth in scaled acceleration, shape (n,); None for one.
    """

    samples: NDArray[np.float64]
    train: NDArray[np.int64]
    validation: NDArray[np.int64]
    window: int
    target: NDArray[np.floating] | None = None
    unit: NDArray[np.float64] | None = None


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
    before = torch.get_num_threads(), torch.are_deterministic_algorithms_enabled()
    torch.set_num_threads(1)
    # On the CPU one thread adds up in one order anyway, and the call takes a second, for it loads a compiler.
    on_gpu = torch.cuda.is_available()
    if on_gpu:
        torch.use_deterministic_algorithms(True, warn_only=True)
    try:
        yield
    finally:
        torch.set_num_threads(before[0])
        if on_gpu:
            torch.use_deterministic_algorithms(before[1])


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
        data: what to fit.
        config: how.
        on_epoch: called after each epoch.
        checkpoint: file that is written after each epoch.
        resume: go on from the checkpoint.

    Returns:
        The log, and whether it was interrupted.
    """
    device = next(network.parameters()).device
    samples = torch.from_numpy(data.samples).to(device, torch.float32)
    goal = samples[:, 0] if data.target is None else torch.from_numpy(data.target).to(device, torch.float32)
    unit = torch.ones(len(samples)) if data.unit is None else torch.from_numpy(data.unit)
    unit = unit.to(device, torch.float32)
    train, validation = (torch.from_numpy(n).to(device) for n in (data.train, data.validation))
    offsets = torch.from_numpy(window_indices(np.zeros(1, dtype=np.int64), data.window)).to(device)
    set_dropout(network, config.dropout)
    n_threads = config.threads if device.type == "cpu" else 1
    pool = ThreadPoolExecutor(n_threads)
    trained = list(network.parameters())
    optimiser = Optimiser(dict(network.named_parameters()), config)
    steps = max(1, math.ceil(len(train) / config.batch))
    rate = schedule_of(config, steps * max(1, config.epochs))
    criterion = loss_of(config)
    parts: dict[str, Stateful] = {"network": network, "optimiser": optimiser}

    def windows(n: Tensor) -> Tensor:
        return samples[n[:, None] + offsets]

    def gradients(share: Tensor, n: int, seed: int) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Return the loss and gradients of one thread's share of a batch of n."""
        with masks_from(partial(mask, generator=masks_of(seed, device))):
            loss = criterion(network(windows(share)), goal[share]) * (len(share) / n)
        return loss.detach(), torch.autograd.grad(loss, trained)

    def step(batch: Tensor, seed: int, number: int) -> Tensor:
        shares = batch.chunk(n_threads)
        seeds = [seed * n_threads + i for i in range(len(shares))]
        losses, parts = zip(*pool.map(gradients, shares, [len(batch)] * len(shares), seeds), strict=True)
        # Added in the order of the shares, whichever thread was first.
        for parameter, *pieces in zip(trained, *parts, strict=True):
            parameter.grad = sum(pieces[1:], start=pieces[0])
        if config.clip_norm > 0:
            nn.utils.clip_grad_norm_(trained, config.clip_norm)
        optimiser.step(rate(number))
        return torch.stack(losses).sum()

    def one_epoch(epoch: int) -> float:
        order = train[order_of(len(train), config.seed, epoch).to(device)]
        torch.manual_seed(epoch_seed(config.seed, epoch))
        total = torch.zeros((), device=device)
        for number, batch in enumerate(order.split(config.batch)):
            n_steps = (epoch - 1) * steps + number
            total += step(batch, mask_seed(config.seed, epoch, number), n_steps) * len(batch)
        return float(total) / len(train)

    def validate() -> tuple[float, float]:
        return validated(network, windows, goal, unit, validation, criterion)

    try:
        return run_epochs(network, config, parts, one_epoch, validate, on_epoch, checkpoint, resume)
    finally:
        pool.shutdown()


def epoch_seed(seed: int, epoch: int) -> int:
    """Return the seed of what an epoch draws, so that a resumed run draws the same."""
    return seed * 100_003 + epoch


def order_of(n: int, seed: int, epoch: int) -> Tensor:
    """Return the order of n windows in an epoch."""
    return torch.randperm(n, generator=torch.Generator().manual_seed(epoch_seed(seed, epoch)))


def mask_seed(seed: int, epoch: int, number: int) -> int:
    """Return the seed of a step's dropout: none comes twice in any run of fewer than a million steps."""
    return (seed * 1_000 + epoch) * 1_000_000 + number


def masks_of(seed: int, device: torch.device) -> torch.Generator | None:
    """Return what draws a step's dropout; on a GPU its own generator does."""
    return torch.Generator().manual_seed(seed % 2**63) if device.type == "cpu" else None


def predict(network: nn.Module, data: TrainingWindows, n: NDArray[np.int64], batch: int = 4096) -> NDArray[np.float64]:
    """Return a network's predictions of the samples n, shape (k,), scaled: of several at once the first."""
    device = next(network.parameters()).device
    network.eval()
    samples = torch.from_numpy(data.samples).to(device, torch.float32)
    with torch.no_grad():
        pieces = [
            network(samples[torch.from_numpy(window_indices(piece, data.window)).to(device)]).cpu()
            for piece in np.array_split(n, max(1, math.ceil(len(n) / batch)))
        ]
    return torch.cat(pieces).double().reshape(len(n), -1)[:, 0].numpy()


def schedule_of(config: TrainConfig, n_steps: int) -> Callable[[int], float]:
    """Return the learning rate over its highest, by step: a linear rise over the first tenth, then half a cosine."""
    if config.schedule == "constant":
        return lambda step: 1.0
    rise = max(1, n_steps // 10)
    return lambda step: (
        (step + 1) / rise
        if step < rise
        else 0.5 * (1 + math.cos(math.pi * min(1.0, (step - rise) / max(1, n_steps - rise))))
    )


def validated(
    network: nn.Module,
    windows: Callable[[Tensor], Tensor],
    goal: Tensor,
    unit: Tensor,
    validation: Tensor,
    criterion: Callable[[Tensor, Tensor], Tensor],
) -> tuple[float, float]:
    """Return a network's loss and mean absolute error on the validation windows, the latter scaled."""
    network.eval()
    loss = mae = 0.0
    with torch.no_grad():
        for batch in validation.split(2048):
            predicted = network(windows(batch))
            loss += float(criterion(predicted, goal[batch])) * len(batch)
            missed = (predicted - goal[batch]).abs().reshape(len(batch), -1).mean(1)
            mae += float((unit[batch].abs() * missed).sum())
    return loss / len(validation), mae / len(validation)
