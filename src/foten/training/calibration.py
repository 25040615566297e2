"""The random part, fitted and calibrated: σ by likelihood, its level in the model's own closed loop, rendered by the kernel."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from foten.dsp import Array
from foten.dsp.distance import log_spectral_distance, scored_bins, segment_length, welch
from foten.dsp.level import frame_levels, frame_means
from foten.dsp.noise import gaussian, innovation_likelihood
from foten.models.excitation import Excitation, Scale, powers
from foten.runtime.loops import run_loops
from foten.runtime.native import NativeTexture
from foten.training.blocks import ScaledBlocks
from foten.training.scale_fit import constant_scale, fit_scale

N_CALIBRATIONS = 3
N_RUNS = 5  # free runs of a block that a distance is the mean of
# The judge's streams begin at 0; what is calibrated or chosen on is other noise than he renders with.
CALIBRATION_STREAM, DISTANCE_STREAM = 2**32, 2**33
RIDGE = 0.05  # of each exponent's adjustment, for each frame: a recording at one condition has no slopes to adjust
MAX_ADJUSTMENT = 1.0  # of a term of log σ, at once


@dataclass(frozen=True)
class Residuals:
    """What predictions leave of the training, then of the validation samples; arrays of n samples."""

    condition: Array  # speed and force that a prediction knows, scaled, (n, 2)
    innovation: Array
    innovation_gain: Array  # what an innovation of 1 is in scaled acceleration
    n_train: int
    moving: NDArray[np.bool_]  # where a rendering does not fade


@dataclass(frozen=True)
class ClosedLoop:
    """A model whose random part is calibrated."""

    blocks: ScaledBlocks
    history: int  # samples that a run begins from
    kernel: Callable[[Excitation], NativeTexture]  # the model with an excitation, ready to render
    # Mean squares under a steady condition (k, 2) scaled, (k,) each: of what an innovation of 1 adds, and of the tones.
    power: Callable[[Array], tuple[Array, Array]]
    # Squares of the impulse response from excitation to output, (n,), with the gain before a lattice; else σ shows at once.
    response: Array | None = None
    limit: float = math.inf  # that samples are cut to; infinite for what is bounded by itself

    @property
    def first(self) -> int:
        """The first sample of a block that counts: after its first fifth, and after the history."""
        return max(self.history, round(0.2 * self.blocks.trace.block))

    def free_runs(
        self, excitation: Excitation, numbers: tuple[int, ...], seed: int, first_stream: int, n_runs: int
    ) -> tuple[Array, Array]:
        """Recorded blocks, and free runs under their speed and force, scaled: (n_blocks, n), (n_runs, n_blocks, n)."""
        m, block, chosen = self.history, self.blocks.trace.block, list(numbers)
        starts = np.tile(self.blocks.samples[chosen, :m], (n_runs, 1, 1))
        conditions = np.tile(self.blocks.path_conditions()[chosen, m:], (n_runs, 1, 1))
        noise = np.stack([gaussian(seed, first_stream + k, 0, block - m) for k in range(len(starts))])
        rendered = run_loops(self.kernel(excitation), starts, conditions, noise, self.limit)
        recorded = self.blocks.samples[chosen, self.first :, 0]
        return recorded, rendered[:, self.first - m :].reshape(n_runs, len(chosen), -1)

    def distance(self, excitation: Excitation, seed: int) -> tuple[float, float]:
        """Log-spectral distance and level error [dB] of the free run on the validation blocks."""
        rate, block = self.blocks.trace.rate_hz, self.blocks.trace.block
        recorded, rendered = self.free_runs(excitation, self.blocks.split.validation, seed, DISTANCE_STREAM, N_RUNS)
        (frequencies, p), (_, q) = (welch(signal, rate, segment_length(block)) for signal in (recorded, rendered))
        bins = scored_bins(frequencies, rate)
        reference = float(np.sqrt(np.square(recorded).mean()))
        levels, rendered_levels = (frame_levels(signal, rate, reference) for signal in (recorded, rendered))
        lsd_db = log_spectral_distance(p[None, :, bins], q[..., bins])
        return float(lsd_db.mean()), float(np.abs(rendered_levels - levels).mean())


@dataclass(frozen=True)
class Calibrated:
    """A random part, and how near its free run is."""

    excitation: Excitation
    distance: tuple[float, float]  # log-spectral distance and level error of the free run on the validation blocks [dB]
    # Negative log-likelihood, mean over the validation blocks where a rendering does not fade [nat]; None where it always does.
    likelihood: float | None
    # By how much the loop was too loud before each adjustment [dB].
    level_errors_db: list[float] = field(default_factory=list)
    # The negative log-likelihood of innovations over all of the validation blocks, before the level was calibrated [nat].
    likelihood_of_innovations: float = math.nan

    @property
    def nearness(self) -> float:
        """What decides between renderings: log-spectral distance times level error."""
        return math.prod(self.distance)

    def metrics(self) -> dict[str, Any]:
        """What the card says of it."""
        return {
            "validation_nll": self.likelihood,
            "validation_lsd_db": self.distance[0],
            "validation_level_error_db": self.distance[1],
            "level_errors_db": self.level_errors_db,
        }


def calibrate_excitation(width: int, residuals: Residuals, loop: ClosedLoop, seed: int) -> Calibrated:
    """An excitation: scale and bound of the residuals, then its level in the closed loop."""
    n = residuals.n_train
    sigma = fit_scale(width, residuals.condition, residuals.innovation, n, loop.blocks.scaling, seed)
    gain, innovation = residuals.innovation_gain, residuals.innovation
    # None is larger than what was left to explain at the training samples, in σ and in acceleration.
    recorded = (innovation / sigma(residuals.condition))[:n], (innovation * gain)[:n]
    fitted = Excitation(sigma, (float(np.abs(recorded[0]).max()), float(np.abs(recorded[1]).max())))

    def likelihood(excitation: Excitation) -> tuple[float | None, float]:
        scale = excitation.sigma(residuals.condition[n:]) * gain[n:]
        _, nll = innovation_likelihood((innovation * gain)[n:], scale)
        moving = residuals.moving[n:]
        return float(nll[moving].mean()) if moving.any() else None, float((nll - np.log(gain[n:])).mean())

    _, of_innovations = likelihood(fitted)
    excitation, errors = calibrate_level(loop, fitted, seed)
    return Calibrated(excitation, loop.distance(excitation, seed), likelihood(excitation)[0], errors, of_innovations)


def calibrate_network_gain(
    width: int,
    innovation_limit: tuple[float, float],
    loop: ClosedLoop,
    seed: int,
    likelihood: float | None,
    level: bool,
) -> Calibrated:
    """What scales a network's innovations in the closed loop, σ near 1, and bounds them.

    Args:
        innovation_limit: in units of σ and in scaled acceleration.
        likelihood: as `Calibrated` has it, the network's.
        level: False leaves σ at 1: the network has learned its level in the closed loop.
    """
    excitation, errors = Excitation(constant_scale(width, loop.blocks.scaling), innovation_limit), list[float]()
    if level:
        excitation, errors = calibrate_level(loop, excitation, seed)
    return Calibrated(excitation, loop.distance(excitation, seed), likelihood, errors)


def calibrate_level(loop: ClosedLoop, excitation: Excitation, seed: int) -> tuple[Excitation, list[float]]:
    """Adjust σ until the closed loop is as loud as the recording, at every speed and force.

    A likelihood measures the error of one step. In the closed loop the lattice filters the excitation, and small errors
    of its resonances, or a correction that feeds on itself, change the level by a dB. What the levels of frames miss is taken
    off the terms of log σ in log speed and log force, by a ridge regression on how each frame answers to each term; what the
    power of all misses, as far as that is beyond chance, off its constant; three times over.

    The loop runs under the speed and force of the training and validation blocks, the first fifth not counted; σ stays within
    its range over the training blocks. With it, by how much the loop was louder than the recording before each adjustment [dB].
    """
    blocks, m, first = loop.blocks, loop.history, loop.first
    rate, known = blocks.trace.rate_hz, list(blocks.known)
    recorded = blocks.samples[known, first:, 0]
    reference = float(np.sqrt(np.square(recorded).mean()))
    level = frame_levels(recorded, rate, reference)
    condition = blocks.samples[known, m - 1 : -1, 1:].reshape(-1, 2)
    innovation_power, tone_power = loop.power(condition)
    tone_power = tone_power.reshape(len(known), -1)[:, first - m :]
    within: Array = blocks.flat[blocks.targets(m)[0] - 1, 1:]
    terms = powers(excitation.sigma.logarithms(condition))
    errors = []
    for _ in range(N_CALIBRATIONS):
        rendered = loop.free_runs(excitation, blocks.known, seed, CALIBRATION_STREAM, 1)[1][0]
        error = (frame_levels(rendered, rate, reference) - level).ravel()
        block_powers = np.stack([np.square(signal).mean(axis=1) for signal in (rendered, recorded)])
        louder, standard_error = _jackknifed(block_powers, lambda ours, theirs: 10 * np.log10(ours / theirs))
        errors.append(louder)
        # A frame's power is the mean of ℓ²σ² and the tones': it answers to a term of log σ by that term's mean under ℓ²σ².
        random_power = innovation_power * np.square(excitation.sigma(condition))
        weighted = random_power[:, None] * np.insert(terms, 0, 1.0, axis=1)
        weighted = _filtered(weighted.reshape(len(known), -1, 6), loop.response)[:, first - m :]
        total = frame_means(weighted[..., 0] + tone_power, rate).reshape(-1, 1)
        answers = np.stack([frame_means(weighted[..., k], rate).ravel() for k in range(6)], axis=1) / total
        ridge = RIDGE * len(error) * np.diag([0.0, 1.0, 1.0, 1.0, 1.0, 1.0])
        step = -np.linalg.solve(answers.T @ answers + ridge, answers.T @ error)
        # What all frames have in common follows the power of all, and only as far as it is beyond chance: of two seconds
        # it is known to a dB, and calibrated on that the real copper's free run was 2 to 9 % further from the recording.
        loud = 10 ** (level.ravel() / 10)
        answer = (loud[:, None] * answers).sum(axis=0) / loud.sum()
        step[0] = -(_beyond_chance(louder, standard_error) + float(answer[1:] @ step[1:])) / answer[0]
        step = np.clip(step * math.log(10) / 20, -MAX_ADJUSTMENT, MAX_ADJUSTMENT)
        excitation = Excitation(_adjusted(excitation.sigma, step, within), excitation.innovation_limit)
    return excitation, errors


def _adjusted(sigma: Scale, step: NDArray[np.floating], within: Array) -> Scale:
    """σ with a step (6,) added to the constant and the exponents of its logarithm, bounded over conditions (n, 2) scaled."""
    parts = {"out_bias": sigma.out_bias + step[:1], "exponents": sigma.exponents + step[1:]}
    moved = Scale(**{**vars(sigma), **parts}).bounded(within)
    return Scale.of(moved.tensors(""), "")  # in float32, as the file has it


def _filtered(power: Array, response: Array | None) -> Array:
    """Power that leaves a filter, for that which enters it at each sample, (n_blocks, n, any)."""
    if response is None:
        return power
    n = power.shape[1]
    held = np.pad(power, ((0, 0), (n, 0), (0, 0)), mode="edge")  # before the first sample as at the first
    return np.asarray(fftconvolve(held, response[None, :n, None] / response[:n].sum(), axes=1)[:, n : 2 * n])


def _jackknifed(parts: Array, figure: Callable[..., Array]) -> tuple[float, float]:
    """A figure of sums over blocks, of which each block has the parts (k, n), and its jackknifed standard error."""
    total, n = parts.sum(axis=1, keepdims=True), parts.shape[1]
    without = figure(*(total - parts))
    return figure(*total).item(), float(np.sqrt((n - 1) / n * np.square(without - without.mean()).sum()))


def _beyond_chance(value: float, standard_error: float) -> float:
    """A value less the share of it that chance explains, 0 where that is all."""
    return value * max(0.0, 1 - (standard_error / value) ** 2) if value else 0.0
