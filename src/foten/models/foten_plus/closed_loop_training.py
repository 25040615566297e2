"""An innovation network trained in its own closed loop, after it was fitted by likelihood: `rollout`, `envelope_loss`.

Likelihood asks what comes after recorded samples. A rendering never has these: it goes on from what it drew itself, and a small
error of each step becomes another texture. What is best on the validation blocks is kept: on artificial grass that is the
network as it was, on rubber that squeals the loss fell by 15 %.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from foten.dsp import Array
from foten.dsp.bands import BAND_FRAME_MS
from foten.dsp.lattice import analyse
from foten.dsp.level import framed
from foten.dsp.tones import tone
from foten.models.foten_plus.definition import Tones
from foten.models.foten_plus.likelihood import Batches, Innovations, mixtures
from foten.models.foten_plus.linear_model import LinearModel
from foten.models.foten_plus.network import InnovationNetwork, negative_log_likelihood
from foten.training.blocks import ScaledBlocks
from foten.training.config import TrainConfig
from foten.training.envelope_loss import EnvelopeEnergyDistance
from foten.training.loop import Epoch, GradientStep, Loop, Monitor, Progress, epoch_seed, run_loop, schedule
from foten.training.optimiser import Optimiser
from foten.training.rollout import PARTS, Rollout, RolloutInputs, RolloutState, repeated
from foten.training.training_kernel import hidden_states

N_EPOCHS = 8  # at most: of a shorter training this part is short too
N_STEPS = 25  # of an epoch
N_EXCERPTS = 32  # of a step, each rendered twice
EXCERPT_S, PREFIX_S = 0.512, 0.256  # what is rendered, and what was recorded before it, so that filters have settled
MIN_S = 0.3  # of an excerpt, for its statistics to be any
MAX_SAMPLES = 1300  # of an excerpt: at 10 kHz a step would take ten times as long
WARM_UP = 64  # samples that the network takes in first
LIKELIHOOD_WEIGHT = 0.2  # beside the envelope loss, so that what was learned by likelihood is not lost
AVERAGING = 0.97  # of the weights, from step to step
N_KNOWN = 400  # excerpts of the recording that say how much statistics vary
N_VALIDATIONS = 8  # draws of excerpts of the validation blocks that a network is validated by
RECIPE: dict[str, Any] = {
    "optimiser": "adamw",
    "learning_rate": 2e-3,
    "weight_decay": 0.0,
    "clip_norm": 1.0,
    "schedule": "one_cycle",
}


@dataclass(frozen=True)
class Excerpts:
    """Where a network is rolled out: stretches of the recording, after what was recorded before them."""

    blocks: ScaledBlocks
    model: LinearModel  # whose lattice and tones a rendering goes by
    data: Innovations  # what the network was fitted to
    n: int  # samples of an excerpt
    innovation_limit: float

    @property
    def n_before(self) -> int:
        """How many samples of the recording come before an excerpt: whole frames."""
        frame = round(BAND_FRAME_MS * self.blocks.trace.rate_hz / 1000)
        return round(PREFIX_S * self.blocks.trace.rate_hz / frame) * frame

    @property
    def first(self) -> int:
        """The first sample of a block that an excerpt may begin with."""
        return max(self.n_before, self.data.first + WARM_UP, self.model.excited_lattice.order) + 1

    def draw(
        self, numbers: tuple[int, ...], n: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The blocks and the first samples of n excerpts of some blocks, (n,) each."""
        last = self.blocks.trace.block - self.n - 1
        return np.array(numbers)[rng.integers(0, len(numbers), n)], rng.integers(self.first, last + 1, n)

    def recorded(self, block: NDArray[np.int64], start: NDArray[np.int64]) -> tuple[Array, Array]:
        """Excerpts (k, n) and what was recorded before each (k, n_before), scaled."""
        around = self.blocks.samples[block[:, None], start[:, None] + np.arange(-self.n_before, self.n), 0]
        return around[:, self.n_before :], around[:, : self.n_before]

    def moving(self, block: NDArray[np.int64], start: NDArray[np.int64]) -> NDArray[np.bool_]:
        """In which frames of excerpts a rendering does not fade, (k, n_frames)."""
        samples = self.blocks.moving()[block[:, None], start[:, None] + np.arange(self.n)]
        return np.asarray(framed(samples, BAND_FRAME_MS, self.blocks.trace.rate_hz).all(axis=-1))

    def rollout(
        self,
        network: InnovationNetwork,
        block: NDArray[np.int64],
        start: NDArray[np.int64],
        rng: np.random.Generator,
        times: int = 1,
    ) -> tuple[Rollout, Array]:
        """The network's roll-outs of k excerpts, and the whole vibration (times · k, n), scaled: all in turn, `times`."""
        inputs, state, coefficients = self._rollout_inputs(network, block, start)
        if times > 1:
            inputs, state = repeated(inputs, times), repeated(state, times)
            coefficients = None if coefficients is None else np.tile(coefficients, (times, 1, 1))
        weights = {name: dict(network.named_parameters())[name].detach().cpu().numpy() for name in PARTS}
        run = Rollout(weights, inputs, state, rng)
        tones = 0.0 if coefficients is None else tone(coefficients, run.phase)
        return run, np.asarray(run.residual + tones)

    def _rollout_inputs(
        self, network: InnovationNetwork, block: NDArray[np.int64], start: NDArray[np.int64]
    ) -> tuple[RolloutInputs, RolloutState, Array | None]:
        """What roll-outs are given, with the state that the recording leaves, and the coefficients of tones."""
        lattice, p = self.model.excited_lattice, self.model.excited_lattice.order
        rows, conditions = block[:, None], self.blocks.path_conditions()
        # A prediction knows the condition of the sample before; the states of the lattice are of its last p samples.
        at = start[:, None] + np.arange(-p, self.n)
        before = conditions[rows, at - 1]
        flat = before.reshape(-1, 3)
        reflections = lattice.reflections(flat[:, :2]).T.reshape(*at.shape, p)
        level = lattice.level(flat[:, :2]).reshape(at.shape)
        recorded = self.blocks.samples[rows, at[:, :p], 0]
        tones, phase_increment, coefficients, phase = None, None, None, None
        if self.model.phase is not None:
            tones = Tones(self.model.tensors, self.model.level)
            coefficients = tones.coefficients(flat).reshape(*at.shape, -1)
            recorded = recorded - tone(coefficients[:, :p], self.model.phase[rows, at[:, :p]])
            coefficients, phase = coefficients[:, p:], self.model.phase[block, start]
            phase_increment = tones.phase_increment(conditions[rows, start[:, None] + np.arange(-1, self.n)])
        _, after = lattice.gains(level[:, :p])
        states = analyse(recorded / after, reflections[:, :p])[2].T
        inputs = self.data.inputs[rows, start[:, None] + np.arange(-WARM_UP, 0)]
        device = next(network.parameters()).device
        with torch.no_grad():
            hidden = hidden_states(network.recurrent, torch.from_numpy(inputs).float().to(device))
        logs = lattice.level.logarithms(conditions[rows, at[:, p:], :2].reshape(-1, 2)).reshape(len(block), self.n, 2)
        arrays = (reflections[:, p:], level[:, p:], logs, states, hidden[:, -1].cpu().numpy(), inputs[:, -1])
        k, of_level, of_logs, of_lattice, of_network, last = (np.ascontiguousarray(x, dtype=np.float32) for x in arrays)
        limit, before_filter = self.innovation_limit, lattice.gain_before_filter
        rollout = RolloutInputs(k, of_level, of_logs, before_filter, limit, tones, phase_increment)
        return rollout, RolloutState(of_lattice, of_network, last, phase), coefficients


def excerpts_of(
    blocks: ScaledBlocks, model: LinearModel, data: Innovations, innovation_limit: float
) -> Excerpts | None:
    """Where a network can be rolled out, or None where blocks are too short, or half a second is too many samples."""
    rate, block = blocks.trace.rate_hz, blocks.trace.block
    n = min(round(EXCERPT_S * rate), block - Excerpts(blocks, model, data, 0, innovation_limit).first - 2)
    return Excerpts(blocks, model, data, n, innovation_limit) if MIN_S * rate <= n <= MAX_SAMPLES else None


def fit_closed_loop(
    network: InnovationNetwork, excerpts: Excerpts, warm_up: int, config: TrainConfig, monitor: Monitor
) -> Progress:
    """Train a network in place in its own closed loop, and leave it where the validation blocks are nearest, or as it was.

    The loss is the envelope energy distance of two roll-outs of each excerpt, and a share of the likelihood, which the log
    leaves out; see `run_loop`.

    Args:
        warm_up: samples of a chunk that the likelihood does not count.
    """
    own = replace(config, **RECIPE, epochs=min(N_EPOCHS, config.epochs), patience=N_EPOCHS, probation=N_EPOCHS + 1)
    split, rate = excerpts.blocks.split, excerpts.blocks.trace.rate_hz
    known = excerpts.draw(split.train, N_KNOWN, np.random.default_rng(config.seed))
    distance = EnvelopeEnergyDistance(excerpts.recorded(*known)[0], excerpts.moving(*known), rate)
    device = next(network.parameters()).device
    batches = Batches(excerpts.data, excerpts.blocks, warm_up, config, device)
    rng = np.random.default_rng()

    def gradients(epoch: int, number: int) -> tuple[Tensor, list[Tensor]]:
        nonlocal rng
        if number == 0:
            rng = np.random.default_rng((config.seed, 2, epoch_seed(config.seed, epoch)))
        loss, drawn, run = _loss(distance, excerpts, network, split.train, rng)
        (by_drawn,) = torch.autograd.grad(loss, [drawn])
        by_rollout = run.gradients(by_drawn.numpy())
        inputs, follows = batches.draw(rng)
        nll = negative_log_likelihood(mixtures(network, inputs), follows)[:, warm_up:].mean()
        by_likelihood = torch.autograd.grad(LIKELIHOOD_WEIGHT * nll, list(network.parameters()))
        names = [name for name, _ in network.named_parameters()]
        both = zip(names, by_likelihood, strict=True)
        return loss.detach(), [torch.from_numpy(by_rollout[name]).to(device) + by_nll for name, by_nll in both]

    def validate(averaged: InnovationNetwork) -> tuple[float, float]:
        validation = np.random.default_rng(config.seed + 1)  # the same excerpts and noise each time
        draws = [_loss(distance, excerpts, averaged, split.validation, validation) for _ in range(N_VALIDATIONS)]
        mean = float(np.mean([float(loss.detach()) for loss, _, _ in draws]))
        return mean, mean

    def on_epoch(line: Epoch) -> None:
        monitor.on_stage(f"training the network in its closed loop: {100 * line.epoch // own.epochs} %")

    optimiser = Optimiser(dict(network.named_parameters()), own)
    step = GradientStep(network, optimiser, gradients, own.clip_norm, schedule(own, N_STEPS))
    loop = Loop("closed loop", network, N_STEPS, step, validate, {"optimiser": optimiser}, AVERAGING)
    return run_loop(loop, own, monitor, on_epoch)


def _loss(
    distance: EnvelopeEnergyDistance,
    excerpts: Excerpts,
    network: InnovationNetwork,
    numbers: tuple[int, ...],
    rng: np.random.Generator,
) -> tuple[Tensor, Tensor, Rollout]:
    """Loss of two roll-outs of each of some excerpts, what was drawn (2k, n), which has a gradient of it, and the roll-outs."""
    block, start = excerpts.draw(numbers, N_EXCERPTS, rng)
    run, vibration = excerpts.rollout(network, block, start, rng, 2)
    drawn = torch.from_numpy(vibration.astype(np.float32)).requires_grad_()
    recorded, prefix = (torch.from_numpy(x).float() for x in excerpts.recorded(block, start))
    moving = torch.from_numpy(excerpts.moving(block, start))
    return distance(drawn.unflatten(0, (2, len(block))), recorded, prefix, moving), drawn, run
