"""The innovation networks of foten-plus, by likelihood on recorded innovations."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from foten.dsp import Array
from foten.models.excitation import Scale
from foten.models.foten_plus.innovation_network import innovation_inputs, phase_inputs
from foten.models.foten_plus.network import InnovationNetwork, negative_log_likelihood
from foten.training.blocks import ScaledBlocks
from foten.training.config import TrainConfig
from foten.training.loop import Epoch, Progress, run_epochs
from foten.training.optimiser import Optimiser
from foten.training.training_kernel import hidden_states
from foten.training.window_fit import epoch_seed, rate_of

STEPS_PER_EPOCH = 100
CHUNK = 128  # samples of a chunk that count, after those that the network takes in first
# Chunks are drawn by 1 / (speed + this) [mm/s]: slow strokes are a small part of a recording, and what is slow has to be right as
# well. On simulated plain cloth a listener's area was 0.69 with it and 0.77 without.
SLOWNESS = 25.0
AVERAGED = 0.99  # of the weights, kept in a step by those that are judged and used
MIRRORED_BELOW = 4.0  # standard errors of the innovations' asymmetry, up to which their signs mean nothing


@dataclass(frozen=True)
class Innovations:
    """What one network is fitted to: all (n_blocks, block); samples before `first` of a block are not known well."""

    inputs: Array  # u of each sample, (n_blocks, block, 5), with the phase of tones 9: `models.foten_plus.innovation_network`
    innovation: Array  # of each sample, which is to be predicted from the inputs before it
    unit: Array  # what one is worth in scaled acceleration
    speed: Array  # of each sample [mm/s]
    first: int
    mirrored: bool  # whether its mirror image is as good a texture

    def tensors(self, device: torch.device) -> tuple[Tensor, Tensor]:
        """Return inputs and, beside each, the innovation that follows it, from the first sample on, in float32."""
        inputs, follows = self.inputs[:, self.first : -1], self.innovation[:, self.first + 1 :]
        return tuple(torch.from_numpy(np.ascontiguousarray(one)).float().to(device) for one in (inputs, follows))


def innovations_of(
    blocks: ScaledBlocks,
    level: Scale,
    x: Array,
    e: Array,
    unit: Array,
    first: int,
    mirrored: bool,
    phase: Array | None = None,
) -> Innovations:
    """Return what a network is fitted to: x, innovations and units as `LinearPart.innovations` gives them.

    With the phase of tones at every sample [rad], (n_blocks, block), for one that is given it: that of the next.
    """
    logs = level.logarithms(blocks.samples[..., 1:].reshape(-1, 2))
    inputs = innovation_inputs(e.ravel(), x.ravel(), logs).reshape(*e.shape, -1)
    if phase is not None:
        after = 2 * phase[:, -1:] - phase[:, -2:-1]  # the last one's is not predicted from
        inputs = np.concatenate([inputs, phase_inputs(np.concatenate([phase[:, 1:], after], axis=1))], axis=2)
    known = e[list(blocks.split.train), first:]
    symmetric = mirrored and asymmetry(known) < MIRRORED_BELOW
    return Innovations(inputs, e, unit, blocks.trace.blocks(blocks.trace.speed), first, symmetric)


def asymmetry(innovation: Array) -> float:
    """Return by how many standard errors innovations (n_blocks, n) are not like their mirror image.

    The largest of two figures: the mean of e √|e|, and of e[n] |e[n−1]|; their standard errors are those between blocks.
    """
    figures = np.stack(
        [
            (np.sign(innovation) * np.abs(innovation) ** 1.5).mean(axis=1),
            (innovation[:, 1:] * np.abs(innovation[:, :-1])).mean(axis=1),
        ]
    )
    if figures.shape[1] < 3:
        return np.inf
    doubt = figures.std(axis=1, ddof=1) / np.sqrt(figures.shape[1])
    return float((np.abs(figures.mean(axis=1)) / np.maximum(doubt, 1e-12)).max())


@dataclass(frozen=True)
class _Chunks:
    """Where chunks begin that are drawn for training."""

    block: NDArray[np.int64]
    start: NDArray[np.int64]
    cumulative: Array  # probability of being drawn
    length: int

    def draw(self, n: int, generator: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return blocks (n, 1) and samples (n, length) of chunks."""
        chosen = np.searchsorted(self.cumulative, generator.random(n)).clip(0, len(self.start) - 1)
        return self.block[chosen, None], self.start[chosen, None] + np.arange(self.length)


def _chunks(of: Innovations, train: tuple[int, ...], warm_up: int) -> _Chunks:
    speed = of.speed[list(train), of.first + 1 :]
    n = speed.shape[1]
    length = min(warm_up + CHUNK, n)
    path = np.concatenate([np.zeros((len(train), 1)), np.cumsum(speed, axis=1)], axis=1)
    start = np.arange(n - length + 1)
    mean = (path[:, start + length] - path[:, start + warm_up]) / (length - warm_up)
    probability = (1 / (mean + SLOWNESS)).ravel()
    block = np.repeat(np.array(train), len(start))
    return _Chunks(block, np.tile(start, len(train)), np.cumsum(probability / probability.sum()), length)


class Batches:
    """Chunks of what one network is fitted to, on a device."""

    def __init__(
        self, of: Innovations, blocks: ScaledBlocks, warm_up: int, config: TrainConfig, device: torch.device
    ) -> None:
        self._of, self._size, self._device = of, config.batch, device
        self.tensors = of.tensors(device)
        self._chunks = _chunks(of, blocks.split.train, warm_up)
        # Of the inputs: the innovation and x change their sign, a phase does not.
        self._mirror = torch.tensor([-1.0, 1.0, -1.0] + [1.0] * (of.inputs.shape[2] - 3), device=device)

    def draw(self, generator: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Return inputs (b, n, n_inputs) and, beside each, the innovation that follows it (b, n)."""
        inputs, follows = self.tensors
        block, sample = self._chunks.draw(self._size, generator)
        given, next_ones = inputs[block, sample], follows[block, sample]
        if self._of.mirrored:
            turned = torch.from_numpy(generator.random(self._size) < 0.5).to(self._device)[:, None]
            given = torch.where(turned[..., None], given * self._mirror, given)
            next_ones = torch.where(turned, -next_ones, next_ones)
        return given, next_ones


class Kept(nn.Module):
    """Networks at their lowest validation losses, each by its own, and the error of the first there."""

    def __init__(self, networks: Sequence[InnovationNetwork]) -> None:
        super().__init__()
        self.networks = nn.ModuleList(networks)
        self.register_buffer("losses", torch.full((len(networks),), torch.inf, dtype=torch.float64))
        self.register_buffer("error", torch.full((), torch.inf, dtype=torch.float64))

    def take(self, networks: nn.ModuleList, scores: Sequence[tuple[float, float]]) -> tuple[float, float]:
        """Take those whose loss (of losses and errors) is lower than before; return the sum of the lowest, and the error."""
        for k, (loss, error) in enumerate(scores):
            # Of a loss that is not finite nothing is kept, and the sum says so.
            if loss < self.losses[k] or not math.isfinite(loss):
                self.losses[k] = loss
                self.networks[k].load_state_dict(networks[k].state_dict())
                if k == 0:
                    self.error.fill_(error)
        return float(self.losses.sum()), float(self.error)


def fit_innovations(
    networks: Sequence[InnovationNetwork],
    data: Sequence[Innovations],
    blocks: ScaledBlocks,
    warm_up: int,
    config: TrainConfig,
    on_epoch: Callable[[Epoch], None] = lambda epoch: None,
    checkpoint: Path | None = None,
    resume: bool = False,
) -> Progress:
    """Train networks in place, side by side, and leave each at its lowest validation loss.

    What is judged and kept are weights averaged over the last hundred steps or so. The loss of the log is the sum of the lowest
    so far [nat], so that training goes on as long as one of them gains; the error is that of the first.
    """
    kept = Kept(networks)
    device = next(kept.parameters()).device
    live, averaged = copy.deepcopy(kept.networks), copy.deepcopy(kept.networks)
    trained = list(live.parameters())
    optimiser = Optimiser(dict(live.named_parameters()), config)
    batches = [Batches(one, blocks, warm_up, config, device) for one in data]
    n_threads = config.threads if device.type == "cpu" else 1
    n_shares = len(torch.empty(config.batch).chunk(n_threads))  # of 64 for 12 threads 11, of six each

    def gradients(share: int, draws: list[tuple[Tensor, Tensor]]) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Return the loss and gradients of one thread's share of a batch."""
        loss = torch.zeros((), device=device)
        for network, (inputs, follows) in zip(live, draws, strict=True):
            inputs, follows = (one.chunk(n_threads)[share] for one in (inputs, follows))
            nll = negative_log_likelihood(mixtures(network, inputs), follows)[:, warm_up:]
            loss = loss + nll.mean() * (len(inputs) / config.batch)
        return loss.detach(), torch.autograd.grad(loss, trained)

    def one_epoch(epoch: int) -> float:
        generator = np.random.default_rng(epoch_seed(config.seed, epoch))
        total = 0.0
        for number in range(STEPS_PER_EPOCH):
            draws = [one.draw(generator) for one in batches]
            losses, pieces = zip(*pool.map(gradients, range(n_shares), [draws] * n_shares), strict=True)
            # Added in the order of the shares, whichever thread was first.
            for parameter, first, *others in zip(trained, *pieces, strict=True):
                parameter.grad = sum(others, start=first)
            if config.clip_norm > 0:
                nn.utils.clip_grad_norm_(trained, config.clip_norm)
            optimiser.step(rate_of(config, STEPS_PER_EPOCH * config.batch, epoch, number))
            total += float(torch.stack(losses).sum())
            step = STEPS_PER_EPOCH * (epoch - 1) + number
            share = min(AVERAGED, (step + 1) / (step + 10))
            with torch.no_grad():
                for mean, now in zip(averaged.parameters(), trained, strict=True):
                    mean.lerp_(now, 1 - share)
        return total / STEPS_PER_EPOCH

    def validate() -> tuple[float, float]:
        scores = [
            validated(network, of, given, blocks.split.validation, warm_up)
            for network, of, given in zip(averaged, data, (one.tensors for one in batches), strict=True)
        ]
        return kept.take(averaged, scores)

    parts = {"kept": kept, "averaged": averaged, "live": live, "optimiser": optimiser}
    with ThreadPoolExecutor(n_threads) as pool:
        return run_epochs(kept, config, parts, one_epoch, validate, on_epoch, checkpoint, resume)


def mixtures(network: InnovationNetwork, inputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return what a network says after each sample, as the network itself, in less time: (b, n, n_inputs) → (b, n, k) each."""
    return network.mixture(hidden_states(network.recurrent, inputs), inputs)


def validated(
    network: InnovationNetwork, of: Innovations, tensors: tuple[Tensor, Tensor], numbers: tuple[int, ...], warm_up: int
) -> tuple[float, float]:
    """Return the mean negative log-likelihood of innovations [nat] and the error in scaled acceleration, over whole blocks."""
    nats, missed, unit = scored(network, of, tensors, numbers, warm_up)
    return float(nats.mean()), float((missed * np.abs(unit)).mean())


def scored(
    network: InnovationNetwork, of: Innovations, tensors: tuple[Tensor, Tensor], numbers: tuple[int, ...], warm_up: int
) -> tuple[Array, Array, Array]:
    """Return of the samples of some blocks, from `first` + 1 + `warm_up` on, (k, n) each.

    Negative log-likelihoods [nat] and absolute errors, both of innovations, and what one is worth in scaled acceleration.
    """
    inputs, follows = (one[list(numbers)] for one in tensors)
    with torch.no_grad():
        mixture = mixtures(network, inputs)
        nats = negative_log_likelihood(mixture, follows)[:, warm_up:].cpu().double().numpy()
        missed = (follows - (mixture[0].exp() * mixture[1]).sum(dim=-1))[:, warm_up:].abs().cpu().double().numpy()
    return nats, missed, of.unit[list(numbers), of.first + 1 :][:, warm_up:]
