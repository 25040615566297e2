"""A network of innovations trained on its own output, after it was fitted by likelihood: `training.rollout`, `training.envelope_loss`.

Likelihood asks what comes after recorded samples. A rendering never has these: it goes on from what it drew itself, and a small
error of each step becomes another texture. What is best on the validation blocks is kept: on artificial grass that is the
network as it was, on rubber that squeals the loss fell by 15 %.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from foten.dsp import Array
from foten.dsp.bands import BAND_FRAME_MS
from foten.dsp.lattice import analyse
from foten.dsp.level import framed
from foten.dsp.tones import tone
from foten.models.excitation import Scale as LevelOf
from foten.models.foten_plus.definition import Tones
from foten.models.foten_plus.likelihood import Innovations
from foten.models.foten_plus.linear_model import LinearPart
from foten.models.foten_plus.network import InnovationNetwork
from foten.training.blocks import ScaledBlocks
from foten.training.envelope_loss import Likeness
from foten.training.rollout import PARTS, Beginning, RollOut, Surroundings, repeated
from foten.training.training_kernel import hidden_states

N_STEPS = 200  # at most
N_EXCERPTS = 32  # of a step, each rendered twice
EXCERPT_S, PREFIX_S = 0.512, 0.256  # what is rendered, and what was recorded before it, so that filters have settled
LEAST_S = 0.3  # of an excerpt, for its statistics to be any
MOST_SAMPLES = 1300  # of one: at 10 kHz a step would take ten times as long
WARM_UP = 64  # samples that the network takes in first
RATE = 2e-3  # highest, of the learning
LIKELIHOOD = 0.2  # weight of it beside the likeness, so that what was learned by it is not lost
AVERAGED = 0.97  # of the weights, kept in a step by those that are used
N_KNOWN = 400  # excerpts of the recording that say how much statistics vary
JUDGED_EVERY = 25  # steps, and so many for each epoch that is asked for: in a short training this part is short too
N_JUDGED = 8  # draws of excerpts of the validation blocks that a network is judged by


@dataclass(frozen=True)
class Excerpts:
    """Where a network is rolled out: stretches of the recording, after what was recorded before them."""

    blocks: ScaledBlocks
    part: LinearPart  # whose lattice and tones a rendering goes by
    of: Innovations  # what the network was fitted to
    n: int  # samples of an excerpt
    largest: float  # innovation

    @property
    def n_before(self) -> int:
        """Return how many samples of the recording come before an excerpt: whole frames."""
        frame = round(BAND_FRAME_MS * self.blocks.trace.rate_hz / 1000)
        return round(PREFIX_S * self.blocks.trace.rate_hz / frame) * frame

    @property
    def first(self) -> int:
        """Return the first sample of a block that an excerpt may begin with."""
        return max(self.n_before, self.of.first + WARM_UP, self.part.excited_lattice.order) + 1

    def draw(
        self, numbers: tuple[int, ...], n: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the blocks and the first samples of n excerpts of some blocks, (n,) each."""
        last = self.blocks.trace.block - self.n - 1
        return np.array(numbers)[rng.integers(0, len(numbers), n)], rng.integers(self.first, last + 1, n)

    def recorded(self, block: NDArray[np.int64], start: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return excerpts (k, n) and what was recorded before each (k, n_before), scaled."""
        around = self.blocks.samples[block[:, None], start[:, None] + np.arange(-self.n_before, self.n), 0]
        return around[:, self.n_before :], around[:, : self.n_before]

    def moving(self, block: NDArray[np.int64], start: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return in which frames of excerpts a rendering does not fade, (k, n_frames)."""
        samples = self.blocks.moving()[block[:, None], start[:, None] + np.arange(self.n)]
        return np.asarray(framed(samples, BAND_FRAME_MS, self.blocks.trace.rate_hz).all(axis=-1))

    def rolled_out(
        self,
        network: InnovationNetwork,
        block: NDArray[np.int64],
        start: NDArray[np.int64],
        rng: np.random.Generator,
        times: int = 1,
    ) -> tuple[RollOut, Array]:
        """Return the network's roll-outs of k excerpts, and the whole vibration (times · k, n), scaled: all in turn, `times`."""
        around, begin, coefficients = self._surroundings(network, block, start)
        if times > 1:
            around, begin = repeated(around, times), repeated(begin, times)
            coefficients = None if coefficients is None else np.tile(coefficients, (times, 1, 1))
        weights = {name: dict(network.named_parameters())[name].detach().cpu().numpy() for name in PARTS}
        run = RollOut(weights, around, begin, rng)
        tones = 0.0 if coefficients is None else tone(coefficients, run.phase)
        return run, np.asarray(run.residual + tones)

    def _surroundings(
        self, network: InnovationNetwork, block: NDArray[np.int64], start: NDArray[np.int64]
    ) -> tuple[Surroundings, Beginning, Array | None]:
        """Return what roll-outs are given, with the state that the recording leaves, and the coefficients of tones."""
        lattice, p = self.part.excited_lattice, self.part.excited_lattice.order
        rows, whole = block[:, None], self.blocks.path_conditions()
        # A prediction knows the condition of the sample before; the states of the lattice are of its last p samples.
        at = start[:, None] + np.arange(-p, self.n)
        before = whole[rows, at - 1]
        flat = before.reshape(-1, 3)
        reflections = lattice.reflections(flat[:, :2]).T.reshape(*at.shape, p)
        level = lattice.level(flat[:, :2]).reshape(at.shape)
        recorded = self.blocks.samples[rows, at[:, :p], 0]
        tones, turned, coefficients, phase = None, None, None, None
        if self.part.phase is not None:
            tones = Tones(self.part.tensors, LevelOf(self.part.tensors, "lattice.level."))
            coefficients = tones.coefficients(flat).reshape(*at.shape, -1)
            recorded = recorded - tone(coefficients[:, :p], self.part.phase[rows, at[:, :p]])
            coefficients, phase = coefficients[:, p:], self.part.phase[block, start]
            turned = tones.increment(whole[rows, start[:, None] + np.arange(-1, self.n)])
        _, after = lattice.gains(level[:, :p])
        states = analyse(recorded / after, reflections[:, :p])[2].T
        inputs = self.of.inputs[rows, start[:, None] + np.arange(-WARM_UP, 0)]
        device = next(network.parameters()).device
        with torch.no_grad():
            hidden = hidden_states(network.recurrent, torch.from_numpy(inputs).float().to(device))
        logs = lattice.level.logarithms(whole[rows, at[:, p:], :2].reshape(-1, 2)).reshape(len(block), self.n, 2)
        arrays = (reflections[:, p:], level[:, p:], logs, states, hidden[:, -1].cpu().numpy(), inputs[:, -1])
        k, of_level, of_hand, of_lattice, of_network, last = (
            np.ascontiguousarray(one, dtype=np.float32) for one in arrays
        )
        around = Surroundings(k, of_level, of_hand, lattice.gain_before_filter, self.largest, tones, turned)
        return around, Beginning(of_lattice, of_network, last, phase), coefficients


def excerpts_of(blocks: ScaledBlocks, part: LinearPart, of: Innovations, largest: float) -> Excerpts | None:
    """Return where a network can be rolled out, or None where blocks are too short, or half a second is too many samples."""
    rate, block = blocks.trace.rate_hz, blocks.trace.block
    tried = Excerpts(blocks, part, of, 0, largest)
    n = min(round(EXCERPT_S * rate), block - tried.first - 2)
    return Excerpts(blocks, part, of, n, largest) if LEAST_S * rate <= n <= MOST_SAMPLES else None


@dataclass(frozen=True)
class OwnOutput:
    """What the training on own output came to: how unlike the recording the validation blocks were, before and at the best."""

    before: float
    after: float
    interrupted: bool = False

    @property
    def gained(self) -> bool:
        """Return whether the network is better for it."""
        return self.after < self.before


def fit_own_output(
    network: InnovationNetwork,
    excerpts: Excerpts,
    likelihood: Callable[[InnovationNetwork, np.random.Generator], Tensor],
    n_steps: int,
    seed: int,
    on_step: Callable[[int], None] = lambda step: None,
) -> OwnOutput:
    """Train a network in place on its own output, and leave it where the validation blocks are nearest, or as it was.

    On Ctrl-C what is best so far is kept.

    Args:
        likelihood: the negative log-likelihood of a batch of recorded samples, with a gradient.
    """
    split, rate = excerpts.blocks.split, excerpts.blocks.trace.rate_hz
    known = excerpts.draw(split.train, N_KNOWN, np.random.default_rng(seed))
    likeness = Likeness(excerpts.recorded(*known)[0], excerpts.moving(*known), rate)

    def judged(one: InnovationNetwork) -> float:
        rng = np.random.default_rng(seed + 1)  # the same excerpts and noise for both
        losses = []
        for _ in range(N_JUDGED):
            block, start = excerpts.draw(split.validation, N_EXCERPTS, rng)
            losses.append(float(_loss(likeness, excerpts, one, block, start, rng)[0].detach()))
        return float(np.mean(losses))

    averaged, trained = copy.deepcopy(network), dict(network.named_parameters())
    device = next(network.parameters()).device
    before = after = judged(network)
    best = copy.deepcopy(network.state_dict())
    optimiser = torch.optim.Adam(trained.values(), RATE, betas=(0.9, 0.99))
    rng = np.random.default_rng(seed + 2)
    interrupted = False
    try:
        for step in range(n_steps):
            on_step(step)
            block, start = excerpts.draw(split.train, N_EXCERPTS, rng)
            loss, drawn, run = _loss(likeness, excerpts, network, block, start, rng)
            optimiser.zero_grad()
            loss.backward()
            assert drawn.grad is not None
            gradients = run.gradients(drawn.grad.numpy())
            (LIKELIHOOD * likelihood(network, rng)).backward()
            for name, parameter in trained.items():
                assert parameter.grad is not None
                parameter.grad += torch.from_numpy(gradients[name]).to(device)
            nn.utils.clip_grad_norm_(trained.values(), 1.0)
            for group in optimiser.param_groups:
                group["lr"] = RATE * min(1.0, (step + 1) / 10) * 0.5 * (1 + math.cos(math.pi * step / n_steps))
            optimiser.step()
            share = min(AVERAGED, (step + 1) / (step + 10))
            with torch.no_grad():
                for mean, now in zip(averaged.parameters(), network.parameters(), strict=True):
                    mean.lerp_(now, 1 - share)
            if (step + 1) % JUDGED_EVERY == 0 and (loss_there := judged(averaged)) < after:
                after, best = loss_there, copy.deepcopy(averaged.state_dict())
    except KeyboardInterrupt:
        interrupted = True
    network.load_state_dict(best)
    return OwnOutput(before, after, interrupted)


def _loss(
    likeness: Likeness,
    excerpts: Excerpts,
    network: InnovationNetwork,
    block: NDArray[np.int64],
    start: NDArray[np.int64],
    rng: np.random.Generator,
) -> tuple[Tensor, Tensor, RollOut]:
    """Return the loss of two roll-outs of each excerpt, what was drawn (2k, n), which has a gradient of it, and the roll-outs."""
    run, vibration = excerpts.rolled_out(network, block, start, rng, 2)
    drawn = torch.from_numpy(vibration.astype(np.float32)).requires_grad_()
    recorded, prefix = (torch.from_numpy(one).float() for one in excerpts.recorded(block, start))
    moving = torch.from_numpy(excerpts.moving(block, start))
    return likeness(drawn.unflatten(0, (2, len(block))), recorded, prefix, moving), drawn, run
