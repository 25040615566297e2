"""Training of an innovation network in its own closed loop, after its fit by likelihood: excerpts, roll-outs, loss."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from torch import Tensor

from foten.dsp import Array
from foten.dsp.bands import BAND_FRAME_MS, N_BANDS, envelope_edges
from foten.dsp.lattice import analyse
from foten.dsp.level import frame_levels, framed
from foten.dsp.tones import tone
from foten.models.excitation import Excitation
from foten.models.foten_plus.definition import Tones
from foten.models.foten_plus.linear_model import LinearModel
from foten.models.foten_plus.network import Batches, InnovationNetwork, Innovations, mixtures, negative_log_likelihood
from foten.training.calibration import ERROR_STREAM, ClosedLoop
from foten.training.config import TrainConfig
from foten.training.job import ScaledBlocks
from foten.training.loop import Epoch, Loop, Monitor, Optimiser, Progress, epoch_seed, gradient_step, run_loop, schedule
from foten.training.training_kernel import Rollout, RolloutInputs, RolloutState, hidden_states

N_EPOCHS = 8  # at most, and no more than those of the training by likelihood
N_STEPS = 25  # of an epoch
N_EXCERPTS = 32  # of a step, each rendered twice
EXCERPT_S, PREFIX_S = 0.512, 0.256  # of what is rendered, and of the recording before it, in which filters settle
MIN_S = 0.3  # of an excerpt
MAX_SAMPLES = 1300  # of an excerpt: at 10 kHz a step would take ten times as long
WARM_UP = 64  # samples that the network takes in first
NLL_WEIGHT = 0.2  # beside the envelope loss, so that what was learned by likelihood is not lost
EMA_DECAY = 0.97  # of the weights, from step to step
N_PAIRS = 8  # of free runs, by which linear models are compared
N_KNOWN = 400  # recorded excerpts, whose statistics are standardised by
N_VALIDATIONS = 4  # draws of excerpts of the validation blocks that a network is validated by
RECIPE: dict[str, Any] = {
    **{"optimiser": "adamw", "learning_rate": 2e-3, "weight_decay": 0.0},
    **{"clip_norm": 1.0, "schedule": "one_cycle"},
}
LAGS = (1, 2, 3, 4, 6, 8, 12)  # frames over which a band may go on
POOLED = (1, 2, 4, 8, 16, 32)  # frames of a stretch of all bands
STRETCH_WEIGHT = 0.3  # weight of these beside the statistics
FLOOR = 1e-4  # of the mean energy of a band, as a listener's
MIN_FRAMES = 8  # of a stroke in an excerpt, for its statistics to be any
_MIN_VARIANCE, _MIN_SQUARE = 1e-3, 1e-4


@lru_cache(maxsize=4)
def _responses(n: int, rate_hz: float) -> Tensor:
    """The band-passes of `dsp.bands` at the frequencies of a transform of n samples, (N_BANDS, n // 2 + 1)."""
    from scipy.signal import butter, sosfreqz

    frequencies = np.fft.rfftfreq(n, 1 / rate_hz)
    passes = [
        sosfreqz(butter(2, edges, "bandpass", fs=rate_hz, output="sos"), frequencies, fs=rate_hz)[1]
        for edges in pairwise(envelope_edges(rate_hz))
    ]
    return torch.from_numpy(np.stack(passes)).to(torch.complex64)


def energies(signals: Tensor, rate_hz: float) -> Tensor:
    """`dsp.bands.band_energies`, without the ringing after the end: signals (…, n) → (…, N_BANDS, n_frames)."""
    n, frame = signals.shape[-1], round(BAND_FRAME_MS * rate_hz / 1000)
    # The lowest band rings out after the end, and does not come round; other lengths take twice as long.
    length = next_fast_len(n + round(0.25 * rate_hz), real=True)
    spectra = torch.fft.rfft(signals, length)[..., None, :] * _responses(length, rate_hz)
    bands = torch.fft.irfft(spectra, length)[..., : n // frame * frame]
    return bands.reshape(*bands.shape[:-1], n // frame, frame).square().mean(dim=-1)


class EnvelopeEnergyDistance:
    """Energy distance of statistics of renderings from those of the recording, in units of their standard deviations.

    The statistics are of log energies in the bands and frames of `dsp.bands`: of each band mean, deviation, skewness and
    autocorrelation over 8 to 96 ms; of each pair the correlation, and which of the two leads.

    With y recorded and x, x' two renderings under its speed and force, the energy distance

        E |x − y| − ½ E |x − x'|

    is smallest where x is distributed as y, and for no other distribution. It is taken of each statistic by itself (the
    continuous ranked probability score), and of short stretches of all bands. Frames at rest do not count.

    Source: McDermott & Simoncelli, "Sound texture perception via statistics of the auditory periphery" (Neuron 2011), for the
    statistics; Gneiting & Raftery, "Strictly proper scoring rules" (JASA 2007), for the score.
    """

    def __init__(self, recorded: Array, moving: NDArray[np.bool_], rate_hz: float) -> None:
        """Standardise by recorded excerpts (k, n), scaled, whose frames move or rest (k, f)."""
        self._rate_hz = rate_hz
        self._standardise(energies(torch.from_numpy(recorded).float(), rate_hz), torch.from_numpy(moving))

    @classmethod
    def of_band_energies(cls, known: Tensor, counted: Tensor, rate_hz: float) -> EnvelopeEnergyDistance:
        """Standardised by band energies (k, N_BANDS, f), whose frames count or rest (k, f)."""
        self = cls.__new__(cls)
        self._rate_hz = rate_hz
        self._standardise(known, counted)
        return self

    def _standardise(self, known: Tensor, counted: Tensor) -> None:
        of_strokes = known.transpose(1, 2)[counted] if counted.any() else known.transpose(1, 2).flatten(0, 1)
        self._floor = FLOOR * of_strokes.mean(dim=0)[:, None] + torch.finfo(torch.float32).tiny
        logs = torch.log(of_strokes.T + self._floor)
        self._mean, self._sd = logs.mean(dim=1)[:, None], logs.std(dim=1)[:, None].clamp_min(1e-6)
        self._unit = self._statistics(known, counted).std(dim=0).clamp_min(1e-6)

    def __call__(self, drawn: Tensor, recorded: Tensor, prefix: Tensor, moving: Tensor) -> Tensor:
        """Loss of two renderings (2, k, n) of excerpts (k, n) after a prefix (k, m); frames (k, f) that move count."""
        n_before = prefix.shape[-1] // round(BAND_FRAME_MS * self._rate_hz / 1000)
        first, second, truth = (
            energies(torch.cat([prefix, signal], dim=-1), self._rate_hz)[..., n_before:]
            for signal in (*drawn, recorded)
        )
        return self.of_energies(first, second, truth, moving)

    def of_energies(self, first: Tensor, second: Tensor, truth: Tensor, moving: Tensor) -> Tensor:
        """The same of band energies of two renderings and the recording, (k, N_BANDS, f) each."""
        of_statistics = [self._statistics(energy, moving) / self._unit for energy in (first, second, truth)]
        loss = _energy_distance(*(statistics[..., None] for statistics in of_statistics))
        stretches = zip(*(self._stretches(energy, moving) for energy in (first, second, truth)), strict=True)
        return loss + STRETCH_WEIGHT * torch.stack([_energy_distance(*stretch) for stretch in stretches]).mean()

    def _statistics(self, energy: Tensor, moving: Tensor) -> Tensor:
        """(k, N_BANDS, f), of which frames (k, f) count → (k, n_statistics), zero where fewer than `MIN_FRAMES` do."""
        counts = moving[:, None].float()
        logs = counts * (torch.log(energy + self._floor) - self._mean) / self._sd
        n = counts.sum(dim=-1).clamp_min(1)
        mean = logs.sum(dim=-1) / n
        off = counts * (logs - mean[..., None])
        variance = off.square().sum(dim=-1) / n + _MIN_VARIANCE
        sd = variance.sqrt()

        def pairs(lag: int) -> Tensor:
            return (counts[..., lag:] * counts[..., :-lag]).sum(dim=-1).clamp_min(1)

        autocorrelation = [
            (off[..., lag:] * off[..., :-lag]).sum(dim=-1) / pairs(lag) / variance
            for lag in LAGS
            if lag < off.shape[-1]
        ]
        unit = off / sd[..., None]
        row, column = np.triu_indices(N_BANDS, 1)
        correlation = unit @ unit.transpose(-1, -2) / n[..., None]
        later = unit[..., 1:] @ unit[..., :-1].transpose(-1, -2) / pairs(1)[..., None]
        lag_difference = later - later.transpose(-1, -2)
        skewness = unit.pow(3).sum(dim=-1) / n
        of_pairs = correlation[..., row, column], lag_difference[..., row, column]
        return torch.cat([mean, sd, *autocorrelation, skewness, *of_pairs], dim=-1) * (n >= MIN_FRAMES)

    def _stretches(self, energy: Tensor, moving: Tensor) -> list[Tensor]:
        """Log energies over two stretches in a row, by length: (k, any, 2 N_BANDS), zero for stretches at rest."""
        parts = []
        counts = moving[:, None].float()
        for length in POOLED:
            n = energy.shape[-1] // length
            if n < 2:
                break
            pooled, counted = (
                values[..., : n * length].unflatten(-1, (n, length)).sum(dim=-1) for values in (counts * energy, counts)
            )
            logs = torch.log(pooled / counted.clamp_min(1) + self._floor) / self._sd * (counted > 0)
            parts.append(torch.cat([logs[..., :-1], logs[..., 1:]], dim=-2).transpose(-1, -2))
        return parts


def _energy_distance(first: Tensor, second: Tensor, recorded: Tensor) -> Tensor:
    """The mean of |x − y| − ½ |x − x'| over vectors along the last axis, equal shapes."""

    def distance(a: Tensor, b: Tensor) -> Tensor:
        if a.shape[-1] == 1:
            return (a - b).abs().mean()
        return (a - b).square().sum(dim=-1).add(_MIN_SQUARE).sqrt().mean()

    return 0.5 * (distance(first, recorded) + distance(second, recorded) - distance(first, second))


def envelope_distance_of(loop: ClosedLoop, excitation: Excitation, seed: int) -> float | None:
    """Envelope energy distance of free runs from known blocks, times that of levels [dB]; None where blocks are too short."""
    trace, known, first = loop.blocks.trace, list(loop.blocks.known), loop.first_scored
    n_piece = round(EXCERPT_S * 1000 / BAND_FRAME_MS)
    if (trace.block - first) * 1000 / trace.rate_hz < n_piece * BAND_FRAME_MS:
        return None
    recorded, rendered = loop.free_runs(excitation, loop.blocks.known, seed, ERROR_STREAM, 2 * N_PAIRS)

    def pieces(frames: Tensor) -> Tensor:
        """(…, f) → (…, pieces, n_piece)"""
        n = frames.shape[-1] // n_piece
        return frames[..., : n * n_piece].unflatten(-1, (n, n_piece))

    def of(signals: Array) -> Tensor:
        bands = pieces(energies(torch.from_numpy(np.ascontiguousarray(signals)).float(), trace.rate_hz))
        return bands.movedim(-2, -3).flatten(-4, -3)  # (…, k · pieces, N_BANDS, n_piece)

    moving = pieces(
        torch.from_numpy(framed(loop.blocks.moving()[known, first:], BAND_FRAME_MS, trace.rate_hz).all(axis=-1))
    )
    moving = moving.flatten(0, 1)
    truth, runs = of(recorded), of(rendered)
    distance = EnvelopeEnergyDistance.of_band_energies(truth, moving, trace.rate_hz)
    pairs = range(0, 2 * N_PAIRS, 2)
    with torch.no_grad():
        of_envelopes = [float(distance.of_energies(runs[k], runs[k + 1], truth, moving)) for k in pairs]
    reference = float(np.sqrt(np.square(recorded).mean()))
    level, levels = (
        torch.from_numpy(frame_levels(x, trace.rate_hz, reference))[..., None] for x in (recorded, rendered)
    )
    of_levels = [float(_energy_distance(levels[k], levels[k + 1], level)) for k in pairs]
    return float(np.mean(of_envelopes) * np.mean(of_levels))


@dataclass(frozen=True)
class Excerpts:
    """Stretches of the recording in which a network is rolled out, each with the recording before it."""

    blocks: ScaledBlocks
    model: LinearModel
    data: Innovations  # what the network was fitted to
    n: int  # samples of an excerpt
    innovation_limit: float

    @property
    def n_before(self) -> int:
        """Samples of the recording before an excerpt: whole frames."""
        frame = round(BAND_FRAME_MS * self.blocks.trace.rate_hz / 1000)
        return round(PREFIX_S * self.blocks.trace.rate_hz / frame) * frame

    @property
    def min_start(self) -> int:
        """The first sample of a block that an excerpt may begin with."""
        return max(self.n_before, self.data.n_transient + WARM_UP, self.model.excited_lattice.order) + 1

    def draw(
        self, numbers: tuple[int, ...], n: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The blocks and the first samples of n excerpts of some blocks, (n,) each."""
        end = self.blocks.trace.block - self.n
        return np.array(numbers)[rng.integers(0, len(numbers), n)], rng.integers(self.min_start, end, n)

    def recorded(self, block: NDArray[np.int64], start: NDArray[np.int64]) -> tuple[Array, Array]:
        """Excerpts (k, n) and what was recorded before each (k, n_before), scaled."""
        around = self.blocks.samples[block[:, None], start[:, None] + np.arange(-self.n_before, self.n), 0]
        return around[:, self.n_before :], around[:, : self.n_before]

    def moving(self, block: NDArray[np.int64], start: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Frames of excerpts where a rendering does not fade, (k, n_frames)."""
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
        """The network's roll-outs of k excerpts, each `times`, and the vibration with its tones (times · k, n), scaled."""
        inputs, state, coefficients = self._rollout_inputs(network, block, start)
        weights = {name: weight.detach().cpu().numpy() for name, weight in network.named_parameters()}
        run = Rollout(weights, inputs, state, rng, times)
        tones = 0.0 if coefficients is None else tone(np.tile(coefficients, (times, 1, 1)), run.phase)
        return run, np.asarray(run.residual + tones)

    def _rollout_inputs(
        self, network: InnovationNetwork, block: NDArray[np.int64], start: NDArray[np.int64]
    ) -> tuple[RolloutInputs, RolloutState, Array | None]:
        """The inputs of roll-outs, their states after the recording, and the coefficients of tones."""
        lattice, p = self.model.excited_lattice, self.model.excited_lattice.order
        rows, conditions = block[:, None], self.blocks.conditions_with_speed()
        # A prediction knows the condition of the sample before; the states of the lattice are of its last p samples.
        at = start[:, None] + np.arange(-p, self.n)
        reflections, level = self._reflections(conditions[rows, at - 1, :2]), self._levels[rows, at - 1]
        recorded = self.blocks.samples[rows, at[:, :p], 0]
        tones, phase_increment, coefficients, phase = None, None, None, None
        if self.model.phase is not None:
            tones = Tones(self.model.tensors, self.model.level)
            coefficients = tones.coefficients(conditions[rows, at - 1].reshape(-1, 3)).reshape(*at.shape, -1)
            recorded = recorded - tone(coefficients[:, :p], self.model.phase[rows, at[:, :p]])
            coefficients, phase = coefficients[:, p:], self.model.phase[block, start]
            phase_increment = tones.phase_increment(conditions[rows, start[:, None] + np.arange(-1, self.n)])
        _, after = lattice.gains(level[:, :p])
        states = analyse(recorded / after, reflections[:p].transpose(2, 0, 1).astype(np.float64))[2].T
        inputs = self.data.inputs[rows, start[:, None] + np.arange(-WARM_UP, 0)]
        device = next(network.parameters()).device
        with torch.no_grad():
            hidden = hidden_states(network.recurrent, torch.from_numpy(inputs).float().to(device))
        arrays = (level[:, p:], self._logs[rows, at[:, p:]], states, hidden[:, -1].cpu().numpy(), inputs[:, -1])
        levels, known, begin, hidden_state, last = (np.ascontiguousarray(x, dtype=np.float32) for x in arrays)
        limit, before_filter = self.innovation_limit, lattice.gain_before_filter
        rollout = RolloutInputs(reflections[p:], levels, known, before_filter, limit, tones, phase_increment)
        return rollout, RolloutState(begin, hidden_state, last, phase), coefficients

    def _reflections(self, conditions: Array) -> NDArray[np.float32]:
        """K under conditions (k, n, 2) scaled, (n, p, k)."""
        lattice = self.model.excited_lattice
        speed, force = np.moveaxis(lattice.level.physical(conditions), 2, 0)
        weights = lattice.table.weights(speed.ravel(), force.ravel()).astype(np.float32)
        of_samples = weights.reshape(*conditions.shape[:2], -1).transpose(1, 2, 0)
        return np.asarray(lattice.table.values.T.astype(np.float32) @ of_samples)

    @cached_property
    def _levels(self) -> Array:
        """The level under the condition of each sample, (n_blocks, block)."""
        conditions = self.blocks.samples[..., 1:]
        return self.model.excited_lattice.level(conditions.reshape(-1, 2)).reshape(conditions.shape[:2])

    @cached_property
    def _logs(self) -> Array:
        """Log speed and log force of each sample, (n_blocks, block, 2)."""
        conditions = self.blocks.samples[..., 1:]
        return self.model.excited_lattice.level.logarithms(conditions.reshape(-1, 2)).reshape(conditions.shape)


def excerpts_of(
    blocks: ScaledBlocks, model: LinearModel, data: Innovations, innovation_limit: float
) -> Excerpts | None:
    """Excerpts of a recording; None where blocks are too short, or half a second is too many samples."""
    rate, block = blocks.trace.rate_hz, blocks.trace.block
    excerpts = Excerpts(blocks, model, data, 0, innovation_limit)
    n = min(round(EXCERPT_S * rate), block - excerpts.min_start - 2)
    return replace(excerpts, n=n) if MIN_S * rate <= n <= MAX_SAMPLES else None


def fit_closed_loop(
    network: InnovationNetwork, excerpts: Excerpts, warm_up: int, config: TrainConfig, monitor: Monitor
) -> Progress:
    """Train a network in place in its own closed loop; see `run_loop`.

    The loss is the envelope energy distance of two roll-outs of each excerpt, and a share of the nll, which the log leaves out
    and which does not count the `warm_up` samples of a chunk.
    """
    recipe = replace(
        config, **RECIPE, epochs=min(N_EPOCHS, config.epochs), patience=N_EPOCHS, trial_epochs=N_EPOCHS + 1
    )
    split, rate = excerpts.blocks.split, excerpts.blocks.trace.rate_hz
    known = excerpts.draw(split.train, N_KNOWN, np.random.default_rng(config.seed))
    envelope_distance = EnvelopeEnergyDistance(excerpts.recorded(*known)[0], excerpts.moving(*known), rate)
    device = next(network.parameters()).device
    batches = Batches(excerpts.data, excerpts.blocks, warm_up, config, device)
    n_threads = min(config.threads, N_EXCERPTS, config.batch) if device.type == "cpu" else 1
    parameters = dict(network.named_parameters())
    rng = np.random.default_rng()

    def of_share(
        block: NDArray[np.int64], start: NDArray[np.int64], inputs: Tensor, targets: Tensor, rng: np.random.Generator
    ) -> tuple[Tensor, list[Tensor]]:
        loss, drawn, run = _loss(envelope_distance, excerpts, network, block, start, rng)
        (grad_drawn,) = torch.autograd.grad(loss, [drawn])
        grad_rollout = run.gradients(grad_drawn.numpy())
        nll = negative_log_likelihood(mixtures(network, inputs, warm_up), targets[:, warm_up:]).mean()
        grad_nll = torch.autograd.grad(NLL_WEIGHT * nll, list(parameters.values()))
        both = zip(parameters, grad_nll, strict=True)
        share = len(block) / N_EXCERPTS  # of the chunks too, but for what does not divide
        return share * loss.detach(), [
            share * (torch.from_numpy(grad_rollout[name]).to(device) + part) for name, part in both
        ]

    def gradients(epoch: int, number: int) -> tuple[Tensor, list[Tensor]]:
        nonlocal rng
        if number == 0:
            rng = np.random.default_rng((config.seed, 2, epoch_seed(config.seed, epoch)))
        drawn = (np.array_split(part, n_threads) for part in excerpts.draw(split.train, N_EXCERPTS, rng))
        chunks = (part.tensor_split(n_threads) for part in batches.draw(rng))
        losses, pieces = zip(*pool.map(of_share, *drawn, *chunks, rng.spawn(n_threads)), strict=True)
        return torch.stack(losses).sum(), [sum(others, start=first) for first, *others in zip(*pieces, strict=True)]

    def validate(averaged: InnovationNetwork) -> tuple[float, float]:
        def loss_of_draw(rng: np.random.Generator) -> float:
            drawn = excerpts.draw(split.validation, N_EXCERPTS, rng)
            return float(_loss(envelope_distance, excerpts, averaged, *drawn, rng)[0].detach())

        draws = np.random.default_rng(config.seed + 1).spawn(N_VALIDATIONS)  # the same excerpts and noise each time
        with ThreadPoolExecutor(n_threads) as some:
            mean = float(np.mean(list(some.map(loss_of_draw, draws))))
        return mean, mean

    def on_epoch(line: Epoch) -> None:
        monitor.on_stage(f"training the network in its closed loop: {100 * line.epoch // recipe.epochs} %")

    optimiser = Optimiser(parameters, recipe)
    step = gradient_step(network, optimiser, gradients, recipe.clip_norm, schedule(recipe, N_STEPS))
    loop = Loop("closed loop", network, N_STEPS, step, validate, {"optimiser": optimiser}, EMA_DECAY)
    with ThreadPoolExecutor(n_threads) as pool:
        return run_loop(loop, recipe, replace(monitor, on_epoch=on_epoch))


def _loss(
    envelope_distance: EnvelopeEnergyDistance,
    excerpts: Excerpts,
    network: InnovationNetwork,
    block: NDArray[np.int64],
    start: NDArray[np.int64],
    rng: np.random.Generator,
) -> tuple[Tensor, Tensor, Rollout]:
    """Loss of two roll-outs of k excerpts, the vibration (2k, n) that it has a gradient by, and the roll-outs."""
    run, vibration = excerpts.rollout(network, block, start, rng, 2)
    drawn = torch.from_numpy(vibration.astype(np.float32)).requires_grad_()
    recorded, prefix = (torch.from_numpy(x).float() for x in excerpts.recorded(block, start))
    moving = torch.from_numpy(excerpts.moving(block, start))
    return envelope_distance(drawn.unflatten(0, (2, len(block))), recorded, prefix, moving), drawn, run
