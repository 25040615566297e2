"""What only a model's own closed loop shows, rendered by the kernel: its level, its volatility, how near the free run is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from foten.dsp import Array
from foten.dsp.distance import log_spectral_distance, scored_bins, segment_length, welch
from foten.dsp.level import frame_levels, frame_means, framed
from foten.dsp.noise import gaussian
from foten.runtime.loops import run_loops
from foten.runtime.native import NativeTexture
from foten.training.blocks import ScaledBlocks
from foten.training.scale import Excitation

N_SETTLING = 3
LASTING_S = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2)  # that a change of volatility may last
FRAMES_MS = (2.0, 5.0, 10.0, 20.0, 40.0)  # that show how long it does
LARGEST_SD = 0.6  # of the log of the level, by volatility
LEVEL_FRAME_MS = 10.0  # frames whose levels show whether there is volatility
LEVEL_ERRORS = 0.01  # variance of the log of the level that is left to errors of the level: 0.9 dB
N_RUNS = 5  # free runs of a block that a distance is the mean of
# The judge's streams begin at 0; what is settled or chosen on is other noise than he renders with.
SETTLING_STREAM, DISTANCE_STREAM, VOLATILITY_STREAM = 2**32, 2**33, 2**34


@dataclass(frozen=True)
class ClosedLoop:
    """A model whose excitation is being fitted."""

    blocks: ScaledBlocks
    history: int  # samples that a run begins from
    kernel: Callable[[Excitation], NativeTexture]  # the model with an excitation, ready to render
    # Mean squares under a steady condition (k, 2) scaled, (k,) each: of what a unit of σ adds, and of the tones.
    power: Callable[[Array], tuple[Array, Array]]
    # Squares of the impulse response from excitation to output, (n,), with the gain before a lattice; else σ shows at once.
    response: Array | None = None
    limit: float = math.inf  # that samples are cut to; infinite for what is bounded by itself

    @property
    def settled(self) -> int:
        """Return the first sample of a block that counts: after its first fifth, and after the history."""
        return max(self.history, round(0.2 * self.blocks.trace.block))

    def free_runs(
        self, excitation: Excitation, numbers: tuple[int, ...], seed: int, first_stream: int, n_runs: int
    ) -> tuple[Array, Array]:
        """Return recorded blocks and free runs under their speed and force, scaled: (n_blocks, n), (n_runs, n_blocks, n)."""
        m, block, chosen = self.history, self.blocks.trace.block, list(numbers)
        starts = np.tile(self.blocks.samples[chosen, :m], (n_runs, 1, 1))
        conditions = np.tile(self.blocks.path_conditions()[chosen, m:], (n_runs, 1, 1))
        noise = np.stack([gaussian(seed, first_stream + k, 0, block - m) for k in range(len(starts))])
        rendered = run_loops(self.kernel(excitation), starts, conditions, noise, self.limit)
        recorded = self.blocks.samples[chosen, self.settled :, 0]
        return recorded, rendered[:, self.settled - m :].reshape(n_runs, len(chosen), -1)


def free_run_distance(loop: ClosedLoop, excitation: Excitation, seed: int) -> tuple[float, float]:
    """Return how far the free run is from the validation blocks: log-spectral distance and level error [dB]."""
    rate, block = loop.blocks.trace.rate_hz, loop.blocks.trace.block
    recorded, rendered = loop.free_runs(excitation, loop.blocks.split.validation, seed, DISTANCE_STREAM, N_RUNS)
    (frequencies, p), (_, q) = (welch(signal, rate, segment_length(block)) for signal in (recorded, rendered))
    bins = scored_bins(frequencies, rate)
    reference = float(np.sqrt(np.square(recorded).mean()))
    theirs, ours = (frame_levels(signal, rate, reference) for signal in (recorded, rendered))
    lsd_db = log_spectral_distance(p[None, :, bins], q[..., bins])
    return float(lsd_db.mean()), float(np.abs(ours - theirs).mean())


def settle_level(loop: ClosedLoop, excitation: Excitation, seed: int) -> list[float]:
    """Adjust σ until the closed loop is as loud as the recording, at every speed and force.

    A likelihood measures the error of one step. In the closed loop the lattice filters the excitation, and small errors
    of its resonances, or a correction that feeds on itself, change the level by a dB. What the levels of frames miss is taken
    off the terms of log σ in log speed and log force, by a ridge regression on how each frame answers to each term; what the
    power of all misses, as far as that is beyond chance, off its constant; three times over.

    The loop runs under the speed and force of the training and validation blocks, the first fifth not counted; σ, adjusted in
    place, stays within its range over the training blocks. Returned is by how much the loop was louder than the recording
    before each adjustment [dB].
    """
    blocks, m, settled = loop.blocks, loop.history, loop.settled
    rate, known = blocks.trace.rate_hz, list(blocks.known)
    recorded = blocks.samples[known, settled:, 0]
    reference = float(np.sqrt(np.square(recorded).mean()))
    level = frame_levels(recorded, rate, reference)
    condition = blocks.samples[known, m - 1 : -1, 1:].reshape(-1, 2)
    unit, tones = loop.power(condition)
    tones = tones.reshape(len(known), -1)[:, settled - m :]
    given = torch.from_numpy(condition).float()
    within = torch.from_numpy(blocks.flat[blocks.targets(m)[0] - 1, 1:]).float()
    errors = []
    for _ in range(N_SETTLING):
        rendered = loop.free_runs(excitation, blocks.known, seed, SETTLING_STREAM, 1)[1][0]
        error = (frame_levels(rendered, rate, reference) - level).ravel()
        powers = np.stack([np.square(blocks).mean(axis=1) for blocks in (rendered, recorded)])
        louder, doubt = _jackknifed(powers, lambda ours, theirs: 10 * np.log10(ours / theirs))
        errors.append(louder)
        # A frame's power is the mean of ℓ²σ² and the tones': it answers to a term of log σ by that term's mean under ℓ²σ².
        with torch.no_grad():
            random = unit * excitation(given).double().square().numpy()
            terms = excitation.logarithms(given).double().numpy()
        weighed = random[:, None] * np.insert(terms, 0, 1.0, axis=1)
        weighed = _filtered(weighed.reshape(len(known), -1, 6), loop.response)[:, settled - m :]
        total = frame_means(weighed[..., 0] + tones, rate).reshape(-1, 1)
        answers = np.stack([frame_means(weighed[..., k], rate).ravel() for k in range(6)], axis=1) / total
        # Ridge: a recording at one condition has no slopes to adjust, one that varies (log-variance 0.5 and more) has.
        ridge = 0.05 * len(error) * np.diag([0.0, 1.0, 1.0, 1.0, 1.0, 1.0])
        step = -np.linalg.solve(answers.T @ answers + ridge, answers.T @ error)
        # What all frames have in common follows the power of all, and only as far as it is beyond chance: of two seconds
        # it is known to a dB, and settled on that the real copper's free run was 2 to 9 % further from the recording.
        loud = 10 ** (level.ravel() / 10)
        answer = (loud[:, None] * answers).sum(axis=0) / loud.sum()
        step[0] = -(_beyond_chance(louder, doubt) + float(answer[1:] @ step[1:])) / answer[0]
        step = np.clip(step * math.log(10) / 20, -1.0, 1.0)
        with torch.no_grad():
            excitation.out.bias += float(step[0])
            excitation.power_law.weight += torch.from_numpy(step[None, 1:]).float()
        excitation.bound(within)
    return errors


def _filtered(power: Array, response: Array | None) -> Array:
    """Return the power that leaves a filter, for that which enters it at each sample, (n_blocks, n, any)."""
    if response is None:
        return power
    n = power.shape[1]
    held = np.pad(power, ((0, 0), (n, 0), (0, 0)), mode="edge")  # before the first sample as at the first
    return np.asarray(fftconvolve(held, response[None, :n, None] / response[:n].sum(), axes=1)[:, n : 2 * n])


def _jackknifed(parts: Array, figure: Callable[..., Array]) -> tuple[float, float]:
    """Return a figure of sums over blocks, of which each block has the parts (k, n), and its jackknifed standard error."""
    total, n = parts.sum(axis=1, keepdims=True), parts.shape[1]
    without = figure(*(total - parts))
    return figure(*total).item(), float(np.sqrt((n - 1) / n * np.square(without - without.mean()).sum()))


def fit_volatility(loop: ClosedLoop, excitation: Excitation, seed: int) -> None:
    """Give an excitation volatility where the recording is spikier than the free run, as far as that is beyond chance.

    exp(4s²) is the ratio of their kurtoses over all training and validation blocks, its logarithm shrunk by how little it is
    known: with all of it, a cardboard whose ratio was hardly more than its standard error had 1.39 of the ceiling's level
    error, and 1.12 without volatility. A kurtosis is made by a few large samples, so s² is at most twice what levels of frames
    vary beyond the free runs' (`_level_variance`), less what errors of the level may explain: without that, nine of 36 simulated
    recordings had volatility by chance, and up to 1.7 of the ceiling's level error.

    How long it lasts, of `LASTING_S`, is what describes best how much more uneven the powers of frames of 2 to 40 ms are
    than those of the free run: short changes average out in long frames. Real wood was 1.6 times as uneven at all lengths, copper
    1.4 times in 2 ms and 1.1 in 40 ms.
    """
    rate = loop.blocks.trace.rate_hz
    recorded, runs = loop.free_runs(excitation, loop.blocks.known, seed, VOLATILITY_STREAM, N_RUNS)
    rendered = np.concatenate(runs, axis=1)  # every run of a block beside it
    moving = loop.blocks.moving()[list(loop.blocks.known), -recorded.shape[1] :]
    spikier = _beyond_chance(*_spikier(recorded, rendered))
    varied = _beyond_chance(*_level_variance(recorded, runs, moving, rate))
    sd = min(LARGEST_SD, math.sqrt(max(0.0, min(spikier / 4, 2 * (varied - LEVEL_ERRORS)))))
    lasts = _lasts_s(recorded, rendered, rate)
    excitation.volatility.copy_(torch.tensor([math.exp(-1 / (lasts * rate)), sd]))


def _beyond_chance(value: float, doubt: float) -> float:
    """Return a value less the share of it that chance explains, 0 where that is all."""
    return value * max(0.0, 1 - (doubt / value) ** 2) if value else 0.0


def _level_variance(recorded: Array, runs: Array, moving: NDArray[np.bool_], rate_hz: float) -> tuple[float, float]:
    """Return by how much more recorded levels vary about free runs' mean than free runs do, and its jackknifed standard error.

    The variance of the log of loudness in frames of 10 ms, under the same condition: what is loud when fast, or spiky within
    a frame, is so in both and does not count, as it does in a kurtosis. Linear processes, which have no volatility, came to
    0.00 ± 0.01; simulated cardboard and smooth rubber, whose levels are not quite right, to 0.01; the real copper, leather,
    wood and fabric to 0.03, 0.04, 0.16 and 0.45.
    Shapes (n_blocks, n), (n_runs, n_blocks, n) and, where frames count, (n_blocks, n).
    """
    least = 1e-8 * float(np.square(recorded).mean())
    recorded, runs, moving = (framed(signal, LEVEL_FRAME_MS, rate_hz) for signal in (recorded, runs, moving))
    levels, ours = (0.5 * np.log(np.square(one).mean(axis=-1) + least) for one in (recorded, runs))
    beyond = np.square(levels - ours.mean(axis=0)) - ours.var(axis=0, ddof=1) * (1 + 1 / len(ours))
    counts = moving.all(axis=-1)
    parts = np.stack([np.where(counts, beyond, 0.0).sum(axis=1), counts.sum(axis=1)])
    if not (parts[1] < parts[1].sum()).all():
        return 0.0, math.inf
    return _jackknifed(parts, np.divide)


def _spikier(recorded: Array, rendered: Array) -> tuple[float, float]:
    """Return the log of the ratio of kurtoses over all blocks, (n_blocks, any) each, and its jackknifed standard error."""
    moments = np.stack([np.power(blocks, k).mean(axis=1) for blocks in (recorded, rendered) for k in (2, 4)])

    def log_ratio(second: Array, fourth: Array, rendered_second: Array, rendered_fourth: Array) -> Array:
        return np.log(fourth / second**2) - np.log(rendered_fourth / rendered_second**2)

    return _jackknifed(moments, log_ratio)


def _lasts_s(recorded: Array, rendered: Array, rate_hz: float) -> float:
    """Return how long the loudness stays up that recorded blocks have beyond rendered ones, (n_blocks, any) each [s]."""

    def unevenness(blocks: Array, frame_ms: float) -> float:
        powers = np.square(framed(blocks, frame_ms, rate_hz)).mean(axis=-1)
        return float(np.square(powers).mean() / powers.mean() ** 2)

    more = np.array([unevenness(recorded, ms) / unevenness(rendered, ms) - 1 for ms in FRAMES_MS])

    def missed(lasts_s: float) -> float:
        # What is left of the variance of an exponentially correlated loudness in the mean of a frame.
        frames = np.array(FRAMES_MS) / 1000 / lasts_s
        left = 2 * (frames - 1 + np.exp(-frames)) / frames**2
        size = max(0.0, float(left @ more) / float(left @ left))
        return float(np.square(more - size * left).sum())

    return min(LASTING_S, key=missed)
