"""The innovation network, which gives the distribution of the next innovation, and its fit by likelihood."""

import copy
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import stdtrit
from torch import Tensor, nn

from foten.dsp import Array
from foten.models.foten_plus.config import FotenPlusConfig
from foten.models.foten_plus.definition import innovation_inputs
from foten.models.foten_plus.linear_model import LinearModel
from foten.models.foten_plus.sizes import N_INPUTS, FotenPlusSizes
from foten.training.checkpoint import Progress
from foten.training.job import ScaledBlocks
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
from foten.training.training_kernel import hidden_states

N_STEPS = 100  # of an epoch
CHUNK = 128  # samples of a chunk that count, after those that the network takes in first
SPEED_OFFSET_MM_S = 25.0  # chunks are drawn by 1 / (speed + this): slow strokes are a small part of a recording
EMA_DECAY = 0.99  # of the weights, from step to step
MEAN_SHARES = tuple(i / 20 for i in range(21))  # of a network's mean, that validation chooses from
MEAN_CHANCE = 0.05  # that a mean which brings nothing is used
STRETCH_MS = 200.0  # of the validation blocks, over which a mean's gains are averaged; less where these were too few
MIN_STRETCHES = 10
MAX_MIRRORED_ASYMMETRY = 4.0  # standard errors of the innovations' asymmetry, up to which their signs mean nothing
LOG_SCALE_LIMIT = 6.0  # of log s, in size
MIRROR = (-1.0, 1.0, -1.0, 1.0, 1.0)  # of the inputs: the innovation and x change their sign


class InnovationNetwork(nn.Module):
    """A mixture of Gaussians for the next innovation (`definition.NetworkDefinition`); before training its means are zero."""

    def __init__(self, sizes: FotenPlusSizes) -> None:
        super().__init__()
        k = self.n_components = sizes.n_components
        self.recurrent = nn.GRU(N_INPUTS, sizes.n_hidden, batch_first=True)
        self.head = nn.Linear(sizes.n_hidden + N_INPUTS, sizes.head_width)
        self.out = nn.Linear(sizes.head_width, 3 * k)
        with torch.no_grad():
            self.out.weight.mul_(0.1)
            self.out.weight[k : 2 * k] = 0.0
            self.out.bias.zero_()
            self.out.bias[2 * k :] = torch.linspace(-1.5, 1.0, k) if k > 1 else 0.0

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Log w, μ and log s after each sample: u (b, n, 5) → (b, n, k) each."""
        hidden, _ = self.recurrent(inputs)
        return self.mixture(hidden, inputs)

    def mixture(self, hidden: Tensor, inputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """log w, μ and log s of the next innovation: from the hidden state after a sample (…, n_hidden), and its inputs."""
        out = self.out(torch.tanh(self.head(torch.cat([hidden, inputs], dim=-1))))
        logit, mean, log_scale = out.split(self.n_components, dim=-1)
        return torch.log_softmax(logit, dim=-1), mean, LOG_SCALE_LIMIT * torch.tanh(log_scale / LOG_SCALE_LIMIT)


class NextInnovation(nn.Module):
    """The same for one sample after a window: u (b, m, 5) → (b, 3k), log w, μ and log s in turn."""

    def __init__(self, network: InnovationNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, inputs: Tensor) -> Tensor:
        """The distribution of the innovation after the last sample."""
        return torch.cat([part[:, -1] for part in self.network(inputs)], dim=-1)


def negative_log_likelihood(mixture: tuple[Tensor, Tensor, Tensor], innovation: Tensor) -> Tensor:
    """−log p of innovations [nat]: mixtures (…, k) each, innovations (…) → (…)."""
    log_weight, mean, log_scale = mixture
    z = (innovation[..., None] - mean) * torch.exp(-log_scale)
    constant = 0.9189385332046727  # log √2π
    return constant - torch.logsumexp(log_weight - log_scale - 0.5 * z * z, dim=-1)


@dataclass(frozen=True)
class Innovations:
    """Innovations that a network is fitted to: arrays of (n_blocks, block)."""

    inputs: Array  # u of each sample, (n_blocks, block, 5): `definition.NetworkDefinition`
    innovation: Array  # of each sample, which is to be predicted from the inputs before it
    innovation_gain: Array  # what an innovation of 1 is in scaled acceleration
    speed: Array  # of each sample [mm/s]
    n_transient: int  # samples of a block before the first that is known well
    sign_symmetric: bool  # whether its mirror image is as good a texture

    def tensors(self, device: torch.device) -> tuple[Tensor, Tensor]:
        """Inputs and, beside each, the innovation that follows it, of the samples that are known well, in float32."""
        inputs, target = self.inputs[:, self.n_transient : -1], self.innovation[:, self.n_transient + 1 :]
        return tuple(torch.from_numpy(np.ascontiguousarray(x)).float().to(device) for x in (inputs, target))


def innovations_of(model: LinearModel, blocks: ScaledBlocks, n_transient: int) -> Innovations:
    """Innovations of a linear model, for a network to be fitted to."""
    x, e, gain = model.innovations(blocks)
    logs = model.level.logarithms(blocks.samples[..., 1:].reshape(-1, 2))
    inputs = innovation_inputs(e.ravel(), x.ravel(), logs).reshape(*e.shape, -1)
    train = e[list(blocks.split.train), n_transient:]
    sign_symmetric = model.phase is None and asymmetry(train) < MAX_MIRRORED_ASYMMETRY
    return Innovations(inputs, e, gain, blocks.trace.blocks(blocks.trace.speed), n_transient, sign_symmetric)


def asymmetry(innovation: Array) -> float:
    """Asymmetry of innovations (n_blocks, n) in standard errors between blocks: mean of e √|e| or e[n] |e[n−1]|."""
    skew = (np.sign(innovation) * np.abs(innovation) ** 1.5).mean(axis=1)
    figures = np.stack([skew, (innovation[:, 1:] * np.abs(innovation[:, :-1])).mean(axis=1)])
    if figures.shape[1] < 3:
        return np.inf
    standard_error = figures.std(axis=1, ddof=1) / np.sqrt(figures.shape[1])
    return float((np.abs(figures.mean(axis=1)) / np.maximum(standard_error, 1e-12)).max())


class Chunks:
    """Chunks of some blocks, drawn for training."""

    def __init__(self, data: Innovations, numbers: tuple[int, ...], warm_up: int) -> None:
        speed = data.speed[list(numbers), data.n_transient + 1 :]
        n = speed.shape[1]
        self._length = length = min(warm_up + CHUNK, n)
        path = np.concatenate([np.zeros((len(numbers), 1)), np.cumsum(speed, axis=1)], axis=1)
        start = np.arange(n - length + 1)
        mean = (path[:, start + length] - path[:, start + warm_up]) / (length - warm_up)
        probability = (1 / (mean + SPEED_OFFSET_MM_S)).ravel()
        self._cumulative = np.cumsum(probability / probability.sum())
        self._block, self._start = np.repeat(np.array(numbers), len(start)), np.tile(start, len(numbers))

    def draw(self, n: int, generator: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Blocks (n, 1) and samples (n, length) of chunks."""
        chosen = np.searchsorted(self._cumulative, generator.random(n)).clip(0, len(self._start) - 1)
        return self._block[chosen, None], self._start[chosen, None] + np.arange(self._length)


class Batches:
    """Batches of chunks of innovations, on a device."""

    def __init__(
        self, data: Innovations, blocks: ScaledBlocks, warm_up: int, config: FotenPlusConfig, device: torch.device
    ) -> None:
        self._data, self._size, self._device = data, config.batch, device
        self.tensors = data.tensors(device)
        self._chunks = Chunks(data, blocks.split.train, warm_up)
        self._mirror = torch.tensor(MIRROR, device=device)

    def draw(self, generator: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Inputs (b, n, 5) and, beside each, the innovation that follows it (b, n)."""
        all_inputs, all_targets = self.tensors
        block, sample = self._chunks.draw(self._size, generator)
        inputs, target = all_inputs[block, sample], all_targets[block, sample]
        if self._data.sign_symmetric:
            mirror = torch.from_numpy(generator.random(self._size) < 0.5).to(self._device)[:, None]
            inputs = torch.where(mirror[..., None], inputs * self._mirror, inputs)
            target = torch.where(mirror, -target, target)
        return inputs, target


def fit_innovation_network(
    network: InnovationNetwork,
    data: Innovations,
    blocks: ScaledBlocks,
    warm_up: int,
    config: FotenPlusConfig,
    monitor: Monitor,
) -> Progress:
    """Train a network in place by likelihood; its weights are averaged over some hundred steps. See `run_loop`."""
    device = next(network.parameters()).device
    batches = Batches(data, blocks, warm_up, config, device)
    n_threads = config.threads if device.type == "cpu" else 1
    n_shares = len(torch.empty(config.batch).chunk(n_threads))  # of 64 for 12 threads 11, of six each
    parameters = dict(network.named_parameters())
    optimiser = Optimiser(parameters, config)
    generator = np.random.default_rng()

    def gradients(epoch: int, number: int) -> tuple[Tensor, list[Tensor]]:
        nonlocal generator
        if number == 0:
            generator = np.random.default_rng(epoch_seed(config.seed, epoch))
        inputs, target = (part.chunk(n_threads) for part in batches.draw(generator))

        def loss_of_share(k: int) -> Tensor:
            nll = negative_log_likelihood(mixtures(network, inputs[k], warm_up), target[k][:, warm_up:])
            return nll.mean() * (len(inputs[k]) / config.batch)

        return shared_gradients(list(parameters.values()), pool, loss_of_share, n_shares)

    def validate(averaged: InnovationNetwork) -> tuple[float, float]:
        nll, innovation, mean, gain = scored(averaged, data, batches.tensors, blocks.split.validation, warm_up)
        return float(nll.mean()), float(np.abs((innovation - mean) * gain).mean())

    with ThreadPoolExecutor(n_threads) as pool:
        step = gradient_step(network, optimiser, gradients, config.clip_norm, schedule(config, N_STEPS))
        loop = Loop("network", network, N_STEPS, step, validate, {"optimiser": optimiser}, EMA_DECAY)
        return run_loop(loop, config, monitor)


def mixtures(network: InnovationNetwork, inputs: Tensor, first: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """`InnovationNetwork.forward` by the training kernel, from a sample on: (b, n, 5) → (b, n − first, k) each."""
    return network.mixture(hidden_states(network.recurrent, inputs)[:, first:], inputs[:, first:])


def scored(
    network: InnovationNetwork,
    data: Innovations,
    tensors: tuple[Tensor, Tensor],
    numbers: tuple[int, ...],
    warm_up: int,
) -> tuple[Array, Array, Array, Array]:
    """Nll [nat], innovation, its expected value and its gain in blocks from `n_transient` + 1 + `warm_up` on, (k, n) each."""
    inputs, target = (part[list(numbers)] for part in tensors)
    with torch.no_grad():
        mixture = mixtures(network, inputs)
        nll = negative_log_likelihood(mixture, target)[:, warm_up:].cpu().double().numpy()
        mean = (mixture[0].exp() * mixture[1]).sum(dim=-1)[:, warm_up:].cpu().double().numpy()
    known = list(numbers), slice(data.n_transient + 1 + warm_up, None)
    return nll, data.innovation[known], mean, data.innovation_gain[known]


def mean_share(innovation: Array, mean: Array, gain: Array, rate_hz: float, n_epochs: int) -> float:
    """Share of a network's mean that a prediction takes, from innovations, means and gains of validation blocks, (k, n) each.

    Of all shares the one whose gain in absolute error is the largest at the lower end of its interval; 0 where none is above 0.
    So little is taken of a mean that few samples bear out. The interval is Student's over stretches. Its level is shared out
    among the epochs, since the best was chosen on the same blocks.
    """
    n_parts = max(1, -(-MIN_STRETCHES // len(gain)), round(1000 * gain.shape[1] / (STRETCH_MS * rate_hz)))
    if gain.shape[1] < n_parts:
        return 0.0
    without = np.abs(innovation * gain)
    starts = np.linspace(0, gain.shape[1], n_parts, endpoint=False).astype(int)
    lengths = np.diff(starts, append=gain.shape[1])
    quantile = stdtrit(n_parts * len(gain) - 1, 1 - MEAN_CHANCE / max(1, n_epochs))
    lower_ends = [0.0]
    for share in MEAN_SHARES[1:]:
        gained = without - np.abs((innovation - share * mean) * gain)
        stretches = np.add.reduceat(gained, starts, axis=1) / lengths
        standard_error = stretches.std(ddof=1) / np.sqrt(stretches.size)
        lower_ends.append(float(stretches.mean() - quantile * standard_error))
    return MEAN_SHARES[int(np.argmax(lower_ends))]


def with_mean_share(network: InnovationNetwork, share: float) -> InnovationNetwork:
    """A copy of a network whose mean is a share of its own."""
    scaled, k = copy.deepcopy(network), network.n_components
    with torch.no_grad():
        scaled.out.weight[k : 2 * k] *= share
        scaled.out.bias[k : 2 * k] *= share
    return scaled
