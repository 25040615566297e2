"""The innovation networks of foten-plus, fitted by likelihood on recorded innovations."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from foten.dsp import Array
from foten.models.foten_plus.innovation_network import innovation_inputs, phase_inputs
from foten.models.foten_plus.linear_model import LinearModel
from foten.models.foten_plus.network import InnovationNetwork, negative_log_likelihood
from foten.training.blocks import ScaledBlocks
from foten.training.config import TrainConfig
from foten.training.loop import GradientStep, Loop, Monitor, Progress, SharedGradients, epoch_seed, run_loop, schedule
from foten.training.optimiser import Optimiser
from foten.training.training_kernel import hidden_states

N_STEPS = 100  # of an epoch
CHUNK = 128  # samples of a chunk that count, after those that the network takes in first
# Chunks are drawn by 1 / (speed + this) [mm/s]: slow strokes are a small part of a recording, and what is slow has to be right as
# well. On simulated plain cloth a listener's area was 0.69 with it and 0.77 without.
SLOWNESS = 25.0
AVERAGING = 0.99  # of the weights, from step to step
MAX_MIRRORED_ASYMMETRY = 4.0  # standard errors of the innovations' asymmetry, up to which their signs mean nothing


@dataclass(frozen=True)
class Innovations:
    """What a network is fitted to: all (n_blocks, block); samples before `first` of a block are not known well."""

    inputs: Array  # u of each sample, (n_blocks, block, 5), with the phase of tones 9: `innovation_network`
    innovation: Array  # of each sample, which is to be predicted from the inputs before it
    innovation_gain: Array  # what an innovation of 1 is in scaled acceleration
    speed: Array  # of each sample [mm/s]
    first: int
    mirrored: bool  # whether its mirror image is as good a texture

    def tensors(self, device: torch.device) -> tuple[Tensor, Tensor]:
        """Inputs and, beside each, the innovation that follows it, from the first sample on, in float32."""
        inputs, follows = self.inputs[:, self.first : -1], self.innovation[:, self.first + 1 :]
        return tuple(torch.from_numpy(np.ascontiguousarray(x)).float().to(device) for x in (inputs, follows))


def innovations_of(model: LinearModel, blocks: ScaledBlocks, first: int, residual: bool = False) -> Innovations:
    """What a network is fitted to: the innovations of a linear model, or of the residual of its tones, with their phase."""
    x, e, gain = model.innovations(blocks, residual)
    level = model.excited_lattice.level if residual else model.level
    logs = level.logarithms(blocks.samples[..., 1:].reshape(-1, 2))
    inputs = innovation_inputs(e.ravel(), x.ravel(), logs).reshape(*e.shape, -1)
    phase = model.phase if residual else None
    if phase is not None:
        after = 2 * phase[:, -1:] - phase[:, -2:-1]  # the last sample's is not predicted from
        inputs = np.concatenate([inputs, phase_inputs(np.concatenate([phase[:, 1:], after], axis=1))], axis=2)
    train = e[list(blocks.split.train), first:]
    mirrored = model.phase is None and asymmetry(train) < MAX_MIRRORED_ASYMMETRY
    return Innovations(inputs, e, gain, blocks.trace.blocks(blocks.trace.speed), first, mirrored)


def asymmetry(innovation: Array) -> float:
    """By how many standard errors innovations (n_blocks, n) are not like their mirror image.

    The larger of two figures: the mean of e √|e|, and of e[n] |e[n−1]|; their standard errors are those between blocks.
    """
    figures = np.stack(
        [
            (np.sign(innovation) * np.abs(innovation) ** 1.5).mean(axis=1),
            (innovation[:, 1:] * np.abs(innovation[:, :-1])).mean(axis=1),
        ]
    )
    if figures.shape[1] < 3:
        return np.inf
    standard_error = figures.std(axis=1, ddof=1) / np.sqrt(figures.shape[1])
    return float((np.abs(figures.mean(axis=1)) / np.maximum(standard_error, 1e-12)).max())


@dataclass(frozen=True)
class _Chunks:
    """Where chunks begin that are drawn for training."""

    block: NDArray[np.int64]
    start: NDArray[np.int64]
    cumulative: Array  # probability of being drawn
    length: int

    def draw(self, n: int, generator: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Blocks (n, 1) and samples (n, length) of chunks."""
        chosen = np.searchsorted(self.cumulative, generator.random(n)).clip(0, len(self.start) - 1)
        return self.block[chosen, None], self.start[chosen, None] + np.arange(self.length)


def _chunks(data: Innovations, train: tuple[int, ...], warm_up: int) -> _Chunks:
    speed = data.speed[list(train), data.first + 1 :]
    n = speed.shape[1]
    length = min(warm_up + CHUNK, n)
    path = np.concatenate([np.zeros((len(train), 1)), np.cumsum(speed, axis=1)], axis=1)
    start = np.arange(n - length + 1)
    mean = (path[:, start + length] - path[:, start + warm_up]) / (length - warm_up)
    probability = (1 / (mean + SLOWNESS)).ravel()
    block = np.repeat(np.array(train), len(start))
    return _Chunks(block, np.tile(start, len(train)), np.cumsum(probability / probability.sum()), length)


class Batches:
    """Chunks of what a network is fitted to, on a device."""

    def __init__(
        self, data: Innovations, blocks: ScaledBlocks, warm_up: int, config: TrainConfig, device: torch.device
    ) -> None:
        self._data, self._size, self._device = data, config.batch, device
        self.tensors = data.tensors(device)
        self._chunks = _chunks(data, blocks.split.train, warm_up)
        # Of the inputs: the innovation and x change their sign, a phase does not.
        self._mirror = torch.tensor([-1.0, 1.0, -1.0] + [1.0] * (data.inputs.shape[2] - 3), device=device)

    def draw(self, generator: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Inputs (b, n, n_inputs) and, beside each, the innovation that follows it (b, n)."""
        all_inputs, all_follows = self.tensors
        block, sample = self._chunks.draw(self._size, generator)
        inputs, follows = all_inputs[block, sample], all_follows[block, sample]
        if self._data.mirrored:
            mirror = torch.from_numpy(generator.random(self._size) < 0.5).to(self._device)[:, None]
            inputs = torch.where(mirror[..., None], inputs * self._mirror, inputs)
            follows = torch.where(mirror, -follows, follows)
        return inputs, follows


def fit_innovation_network(
    network: InnovationNetwork,
    data: Innovations,
    blocks: ScaledBlocks,
    warm_up: int,
    config: TrainConfig,
    monitor: Monitor,
    name: str = "network",
) -> Progress:
    """Train a network in place by likelihood, and leave it, averaged over some hundred steps, at its best; see `run_loop`."""
    device = next(network.parameters()).device
    batches = Batches(data, blocks, warm_up, config, device)
    n_threads = config.threads if device.type == "cpu" else 1
    n_shares = len(torch.empty(config.batch).chunk(n_threads))  # of 64 for 12 threads 11, of six each
    optimiser = Optimiser(dict(network.named_parameters()), config)
    generator = np.random.default_rng()

    def gradients(epoch: int, number: int) -> tuple[Tensor, list[Tensor]]:
        nonlocal generator
        if number == 0:
            generator = np.random.default_rng(epoch_seed(config.seed, epoch))
        inputs, follows = (part.chunk(n_threads) for part in batches.draw(generator))

        def loss_of_share(k: int) -> Tensor:
            nll = negative_log_likelihood(mixtures(network, inputs[k]), follows[k])[:, warm_up:]
            return nll.mean() * (len(inputs[k]) / config.batch)

        return shared(loss_of_share, n_shares)

    def validate(averaged: InnovationNetwork) -> tuple[float, float]:
        return validated(averaged, data, batches.tensors, blocks.split.validation, warm_up)

    with ThreadPoolExecutor(n_threads) as pool:
        shared = SharedGradients(network, pool)
        step = GradientStep(network, optimiser, gradients, config.clip_norm, schedule(config, N_STEPS))
        loop = Loop(name, network, N_STEPS, step, validate, {"optimiser": optimiser}, AVERAGING)
        return run_loop(loop, config, monitor)


def mixtures(network: InnovationNetwork, inputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """What a network says after each sample, as the network itself, in less time: (b, n, n_inputs) → (b, n, k) each."""
    return network.mixture(hidden_states(network.recurrent, inputs), inputs)


def validated(
    network: InnovationNetwork,
    data: Innovations,
    tensors: tuple[Tensor, Tensor],
    numbers: tuple[int, ...],
    warm_up: int,
) -> tuple[float, float]:
    """Mean negative log-likelihood of innovations [nat] and the error in scaled acceleration, over blocks."""
    nll, error, gain = scored(network, data, tensors, numbers, warm_up)
    return float(nll.mean()), float((error * np.abs(gain)).mean())


def scored(
    network: InnovationNetwork,
    data: Innovations,
    tensors: tuple[Tensor, Tensor],
    numbers: tuple[int, ...],
    warm_up: int,
) -> tuple[Array, Array, Array]:
    """Of the samples of some blocks, from `first` + 1 + `warm_up` on, (k, n) each.

    Negative log-likelihoods [nat] and absolute errors, of innovations; and what an innovation of 1 is in acceleration, scaled.
    """
    inputs, follows = (part[list(numbers)] for part in tensors)
    with torch.no_grad():
        mixture = mixtures(network, inputs)
        nll = negative_log_likelihood(mixture, follows)[:, warm_up:].cpu().double().numpy()
        error = (follows - (mixture[0].exp() * mixture[1]).sum(dim=-1))[:, warm_up:].abs().cpu().double().numpy()
    return nll, error, data.innovation_gain[list(numbers), data.first + 1 :][:, warm_up:]
