"""Fit of scales over speed and force by likelihood, and calibration of σ in the model's own closed loop."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.signal import fftconvolve

from foten.dsp import Array
from foten.dsp.distance import log_spectral_distance, scored_bins, segment_length, welch
from foten.dsp.equaliser import Equaliser, terms_of
from foten.dsp.level import frame_levels, frame_means
from foten.dsp.noise import gaussian, innovation_likelihood
from foten.dsp.shrinkage import empirical_bayes, james_stein
from foten.models.conditions import MOVING_SPEED
from foten.models.excitation import MAX_SIGMA, N_FEATURES, N_POWERS, Excitation, Scale, powers
from foten.recording.scaling import Scaling
from foten.runtime.loops import Excluded, render_streams, render_strokes
from foten.runtime.native import NativeTexture
from foten.training.job import ScaledBlocks

SHAPE_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the fitted shape of log σ, that validation chooses from
FLOOR = (2.0, 0.05)  # mm/s and N, that a logarithm starts from
# Penalty of the squares of the network's weights, beside the likelihood [nat]: σ is smooth where little was recorded.
WEIGHT_PENALTY = 1e-4
MAX_ITERATIONS = 60
BIN_WIDTH = 0.05  # of log speed and log force, within which σ is taken as one in the fit
N_CALIBRATION_RUNS = (1, 2, 4)  # free runs of a block, of each adjustment: the first need only come near
N_RUNS = 5  # free runs of a block that errors are means of
# The judge's streams begin at 0: what is calibrated or chosen on is other noise than what is judged.
CALIBRATION_STREAM, ERROR_STREAM = 2**32, 2**33
RIDGE = 0.05  # of each exponent's adjustment, for each frame: a recording at one condition has no slopes to adjust
MAX_ADJUSTMENT = 1.0  # of a term of log σ, at once
UNSCORED_SHARE = 0.2  # of a block, its beginning, that no level or spectrum is taken of


def fit_scale(width: int, condition: Array, residual: Array, n_train: int, scaling: Scaling, seed: int) -> Scale:
    """The scale of a vibration or of residuals over speed and force, by Gaussian maximum likelihood.

    The shape of log σ is fitted on the training samples, and the share of it that is taken is chosen on the validation samples.

    Args:
        condition: speed and force of each residual, scaled, the training, then the validation samples, (n, 2).
        residual: shape (n,).
        n_train: number of training samples.
    """
    squared = np.square(residual) + 1e-12
    start = _initial(width, scaling, float(0.5 * np.log(squared[:n_train].mean())), np.random.default_rng(seed))
    fitted = _minimised(start, *_binned(start, condition[:n_train], squared[:n_train]))
    shape = np.log(fitted(condition)) - fitted.out_bias
    tried = []
    for share in SHAPE_SHARES:
        # The factor that maximises the likelihood of a given shape, in closed form.
        factor = math.sqrt((squared[:n_train] * np.exp(-2 * share * shape[:n_train])).mean())
        nll = _gaussian_nll(math.log(factor) + share * shape[n_train:], squared[n_train:])
        tried.append((nll, share, math.log(factor)))
    _, share, log_factor = min(tried)
    parts = {"out_weight": share * fitted.out_weight, "exponents": share * fitted.exponents}
    return _as_in_file(replace(fitted, **parts, out_bias=np.array([log_factor])).bounded(condition[:n_train]))


def constant_scale(width: int, scaling: Scaling) -> Scale:
    """σ = 1 at every speed and force, at most 1."""
    parts = {"hidden_weight": np.zeros((width, N_FEATURES)), "hidden_bias": np.zeros(width)}
    return replace(_initial(width, scaling, 0.0, np.random.default_rng(0)), **parts, sigma_max=np.ones(1))


def _initial(width: int, scaling: Scaling, log_sigma: float, rng: np.random.Generator) -> Scale:
    bound = 1 / math.sqrt(N_FEATURES)
    return Scale(
        hidden_weight=rng.uniform(-bound, bound, (width, N_FEATURES)),
        hidden_bias=rng.uniform(-bound, bound, width),
        out_weight=np.zeros((1, width)),
        out_bias=np.array([log_sigma]),
        exponents=np.zeros(N_POWERS),
        sigma_max=np.array([MAX_SIGMA]),
        mean=np.array(scaling.mean[1:]),
        sd=np.array(scaling.sd[1:]),
        floor=np.array(FLOOR),
    )


def _as_in_file(scale: Scale) -> Scale:
    return Scale.of(scale.tensors(""), "")


def _gaussian_nll(log_sigma: Array, squared: Array) -> float:
    """Mean Gaussian negative log-likelihood [nat] of squared residuals, (n,) each."""
    return float((log_sigma + 0.5 * squared * np.exp(-2 * log_sigma)).mean() + 0.5 * math.log(2 * math.pi))


_FITTED = ("hidden_weight", "hidden_bias", "out_weight", "out_bias", "exponents")


def _binned(scale: Scale, condition: Array, squared: Array) -> tuple[Array, Array, Array]:
    """Means over bins of log speed and log force: conditions (k, 2) and squared residuals (k,), and each bin's share (k,).

    Sufficient for the likelihood where σ is one within a bin.
    """
    cells = np.floor(scale.logarithms(condition) / BIN_WIDTH).astype(np.int64)
    cells -= cells.min(axis=0)
    _, bin_of, counts = np.unique(cells @ [cells[:, 1].max() + 1, 1], return_inverse=True, return_counts=True)
    means = [np.bincount(bin_of, values) / counts for values in (*condition.T, squared)]
    return np.stack(means[:2], axis=1), means[2], counts / len(squared)


def _minimised(start: Scale, condition: Array, squared: Array, share: Array) -> Scale:
    """The scale of the greatest likelihood, from conditions (k, 2), squared residuals and their shares of all (k,)."""
    features = np.concatenate([condition, start.logarithms(condition)], axis=1)
    terms = powers(features[:, 2:])
    shapes = {name: getattr(start, name).shape for name in _FITTED}
    ends = np.cumsum([math.prod(shape) for shape in shapes.values()])

    def parts(x: Array) -> dict[str, Array]:
        pieces = np.split(x, ends[:-1])
        return {name: piece.reshape(shape) for (name, shape), piece in zip(shapes.items(), pieces, strict=True)}

    def loss(x: Array) -> tuple[float, Array]:
        w = parts(x)
        hidden = np.tanh(features @ w["hidden_weight"].T + w["hidden_bias"])
        log_sigma = hidden @ w["out_weight"][0] + w["out_bias"] + terms @ w["exponents"]
        relative = squared * np.exp(-2 * log_sigma)
        by_sigma = share * (1 - relative)
        by_hidden = by_sigma[:, None] * w["out_weight"] * (1 - hidden * hidden)
        gradient = [
            by_hidden.T @ features + 2 * WEIGHT_PENALTY * w["hidden_weight"],
            by_hidden.sum(axis=0),
            by_sigma @ hidden + 2 * WEIGHT_PENALTY * w["out_weight"],
            by_sigma.sum(keepdims=True),
            by_sigma @ terms,
        ]
        rough = WEIGHT_PENALTY * (np.square(w["hidden_weight"]).sum() + np.square(w["out_weight"]).sum())
        nll = float(share @ (log_sigma + 0.5 * relative) + rough)
        return nll, np.concatenate([part.ravel() for part in gradient])

    x = np.concatenate([getattr(start, name).ravel() for name in _FITTED])
    options = {"maxiter": MAX_ITERATIONS, "maxcor": 20, "ftol": 1e-10}
    return replace(start, **parts(minimize(loss, x, jac=True, method="L-BFGS-B", options=options).x))


@dataclass(frozen=True)
class Residuals:
    """Residuals of predictions of the training, then of the validation samples; arrays of n samples."""

    condition: Array  # speed and force that a prediction knows, scaled, (n, 2)
    innovation: Array
    innovation_gain: Array  # what an innovation of 1 is in scaled acceleration
    n_train: int
    moving: NDArray[np.bool_]  # where a rendering does not fade

    @property
    def largest(self) -> float:
        """The largest of the training samples, in scaled acceleration."""
        return float(np.abs((self.innovation * self.innovation_gain)[: self.n_train]).max())


class FreeRunErrors(NamedTuple):
    """Log-spectral distance and level error [dB]."""

    lsd_db: float
    level_error_db: float


@lru_cache(maxsize=4)
def _noise(seed: int, first_stream: int, n_streams: int, n: int) -> Array:
    """Standard normal numbers of streams, (n_streams, n): the same for every model and adjustment."""
    return np.stack([gaussian(seed, first_stream + k, 0, n) for k in range(n_streams)])


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
    as_heard: bool = False  # whether free runs fade near rest, and go through the equaliser
    equaliser: Equaliser | None = None
    # Recorded moments that runs of blocks do not play, so many runs of each: `runtime.loops.Excluded`.
    excluded: Callable[[tuple[int, ...], int], Excluded] = lambda numbers, n_runs: ()
    unit_sigma: bool = False  # whether the kernel's σ is 1 whatever the excitation, which scales the noise instead

    def with_unit_sigma(self, width: int, innovation_limit: float) -> ClosedLoop:
        """The same by one kernel for all excitations of a limit in acceleration."""
        unit = constant_scale(width, self.blocks.scaling)
        texture = self.kernel(Excitation(unit, (MAX_SIGMA, innovation_limit)))
        return replace(self, kernel=lambda excitation: texture, unit_sigma=True)

    def with_kernel_of(self, excitation: Excitation) -> ClosedLoop:
        """The same by one kernel, which is proved once, for runs of one excitation."""
        texture = self.kernel(excitation)
        return replace(self, kernel=lambda excitation: texture)

    @property
    def first_scored(self) -> int:
        """The first sample of a block, after the history, that level and spectrum are taken of."""
        return max(self.history, round(UNSCORED_SHARE * self.blocks.trace.block))

    def free_runs(
        self, excitation: Excitation, numbers: tuple[int, ...], seed: int, first_stream: int, n_runs: int
    ) -> tuple[Array, Array]:
        """Recorded blocks, and free runs under their speed and force, scaled: (n_blocks, n), (n_runs, n_blocks, n)."""
        if self.as_heard:
            rendered = self.heard_runs(excitation, numbers, seed, first_stream, n_runs)
            if self.equaliser is not None:
                rendered = self.equaliser.applied(rendered, self.terms(numbers))
        else:
            rendered = self._runs(excitation, numbers, seed, first_stream, n_runs)
        recorded = self.blocks.samples[list(numbers), self.first_scored :, 0]
        return recorded, rendered[..., self.first_scored - self.history :]

    def heard_runs(
        self, excitation: Excitation, numbers: tuple[int, ...], seed: int, first_stream: int, n_runs: int
    ) -> Array:
        """Runs after the history of blocks as they are heard, faded near rest, before the equaliser, (n_runs, n_blocks, n)."""
        m, trace = self.history, self.blocks.trace
        channels = [trace.blocks(x)[list(numbers)] for x in (trace.acceleration, trace.speed, trace.force)]
        _, speed, force = (np.tile(x[:, m:], (n_runs, 1)) for x in channels)
        windows = [np.tile(x[:, :m], (n_runs, 1)) for x in channels]
        rendered, _ = render_strokes(
            self.kernel(excitation), seed, speed, force, first_stream, windows, excluded=self.excluded(numbers, n_runs)
        )
        return np.asarray(self.blocks.scaling.scale_channel(0, rendered)).reshape(n_runs, len(numbers), -1)

    def _runs(
        self, excitation: Excitation, numbers: tuple[int, ...], seed: int, first_stream: int, n_runs: int
    ) -> Array:
        m, block, chosen = self.history, self.blocks.trace.block, list(numbers)
        starts = np.tile(self.blocks.samples[chosen, :m], (n_runs, 1, 1))
        conditions = np.tile(self.blocks.conditions_with_speed()[chosen, m:], (n_runs, 1, 1))
        noise = _noise(seed, first_stream, len(starts), block - m)
        if self.unit_sigma:
            sigma = excitation.sigma(self.blocks.samples[chosen, m - 1 : -1, 1:].reshape(-1, 2))
            in_sigma = excitation.innovation_limit[0]
            noise = np.clip(noise, -in_sigma, in_sigma) * np.tile(sigma.reshape(len(chosen), -1), (n_runs, 1))
        excluded = self.excluded(numbers, n_runs)
        rendered = render_streams(self.kernel(excitation), starts, conditions, noise, self.limit, excluded)
        return rendered.reshape(n_runs, len(chosen), -1)

    def terms(self, numbers: tuple[int, ...]) -> Array:
        """Terms of an equaliser under some blocks, after the history, (N_TERMS, k, n)."""
        trace, chosen = self.blocks.trace, list(numbers)
        speed, force = (trace.blocks(channel)[chosen] for channel in (trace.speed, trace.force))
        return terms_of(np.maximum(speed, 0.0), np.maximum(force, 0.0), trace.rate_hz)[..., self.history :]

    def free_run_errors(self, excitation: Excitation, seed: int) -> FreeRunErrors:
        """Errors of the free run on the validation blocks."""
        rate, block = self.blocks.trace.rate_hz, self.blocks.trace.block
        recorded, rendered = self.free_runs(excitation, self.blocks.split.validation, seed, ERROR_STREAM, N_RUNS)
        (frequencies, p), (_, q) = (welch(signal, rate, segment_length(block)) for signal in (recorded, rendered))
        bins = scored_bins(frequencies, rate)
        reference = float(np.sqrt(np.square(recorded).mean()))
        levels, rendered_levels = (frame_levels(signal, rate, reference) for signal in (recorded, rendered))
        lsd_db = log_spectral_distance(p[None, :, bins], q[..., bins])
        return FreeRunErrors(float(lsd_db.mean()), float(np.abs(rendered_levels - levels).mean()))


@dataclass(frozen=True)
class Calibrated:
    """A random part; errors and negative log-likelihoods (nll) [nat] are of the validation blocks."""

    excitation: Excitation
    free_run: FreeRunErrors
    acceleration_nll: float | None  # where a rendering does not fade; None where it always does
    # By how much the loop was too loud before each adjustment.
    level_errors_db: list[float] = field(default_factory=list)

    def metrics(self) -> dict[str, Any]:
        return {
            "validation_nll": self.acceleration_nll,
            "validation_lsd_db": self.free_run.lsd_db,
            "validation_level_error_db": self.free_run.level_error_db,
            "level_errors_db": self.level_errors_db,
        }


def calibrate_excitation(width: int, residuals: Residuals, loop: ClosedLoop, seed: int) -> Calibrated:
    """An excitation: scale and bound of the residuals, then its level in the closed loop."""
    n = residuals.n_train
    sigma = fit_scale(width, residuals.condition, residuals.innovation, n, loop.blocks.scaling, seed)
    gain, innovation = residuals.innovation_gain, residuals.innovation
    # None is larger than what was left to explain at the training samples, in σ and in acceleration.
    in_sigma = (innovation / sigma(residuals.condition))[:n]
    fitted = Excitation(sigma, (float(np.abs(in_sigma).max()), residuals.largest))

    excitation, errors = calibrate_level(loop, fitted, seed)
    acceleration_nll, moving = None, residuals.moving[n:]
    if moving.any():
        scale = excitation.sigma(residuals.condition[n:]) * gain[n:]
        acceleration_nll = float(innovation_likelihood((innovation * gain)[n:], scale)[1][moving].mean())
    free_run = loop.free_run_errors(excitation, seed)
    return Calibrated(excitation, free_run, acceleration_nll, errors)


def calibrate_level(loop: ClosedLoop, excitation: Excitation, seed: int) -> tuple[Excitation, list[float]]:
    """Adjust σ until the closed loop is as loud as the recording, at every speed and force.

    The loop runs under the speed and force of the training and validation blocks, and log σ is adjusted three times.
    Its terms in log speed and log force follow a regression of the level errors of frames on the derivatives of their levels by
    each term, as far as they are beyond what differs between blocks (`empirical_bayes`); its constant follows the level error of
    all frames, as far as that is beyond chance.

    Returns:
        The excitation, and by how much the loop was louder than the recording before each adjustment [dB].
    """
    blocks, m, first = loop.blocks, loop.history, loop.first_scored
    rate, known = blocks.trace.rate_hz, list(blocks.known)
    recorded = blocks.samples[known, first:, 0]
    reference = float(np.sqrt(np.square(recorded).mean()))
    level = frame_levels(recorded, rate, reference)
    condition = blocks.samples[known, m - 1 : -1, 1:].reshape(-1, 2)
    innovation_power, tone_power = loop.power(condition)
    tone_power = tone_power.reshape(len(known), -1)[:, first - m :]
    within: Array = blocks.flat[blocks.targets(m)[0] - 1, 1:]
    terms = powers(excitation.sigma.logarithms(condition))
    # Frames near rest say little: their speed is known late, by its low-pass, and few have most of the leverage.
    speed = blocks.conditions_with_speed()[known, first:, 2]
    counts = (frame_means(speed, rate) >= 2 * MOVING_SPEED).ravel().astype(float)
    errors = []
    uncalibrated, taken = excitation, np.zeros(6)
    for n_runs in N_CALIBRATION_RUNS:
        runs = loop.free_runs(excitation, blocks.known, seed, CALIBRATION_STREAM, n_runs)[1]
        error = (frame_levels(runs, rate, reference).mean(axis=0) - level).ravel()
        block_powers = np.stack([np.square(signal).mean(axis=(0, -1)) for signal in (runs, recorded[None])])
        louder, standard_error = _jackknifed(block_powers, lambda power, reference: 10 * np.log10(power / reference))
        errors.append(louder)
        # The power of a frame is the mean of ℓ²σ² and the tones'; its derivative by a term of log σ is that term's mean under it.
        random_power = innovation_power * np.square(excitation.sigma(condition))
        weighted = random_power[:, None] * np.insert(terms, 0, 1.0, axis=1)
        weighted = _filtered(weighted.reshape(len(known), -1, 6), loop.response)[:, first - m :]
        total = frame_means(weighted[..., 0] + tone_power, rate).reshape(-1, 1)
        slopes = np.stack([frame_means(weighted[..., k], rate).ravel() for k in range(6)], axis=1) / total
        # What the terms have taken of the error already counts as error again, so that it is shrunk as a whole.
        whole = -np.concatenate([[0.0], taken[1:]]) * 20 / math.log(10)
        of_terms = counts[:, None] * slopes
        step = -empirical_bayes(
            (counts * error + of_terms @ whole).reshape(len(known), -1), of_terms.reshape(len(known), -1, 6)
        )
        # The constant follows the power of all frames, as far as it is beyond chance: two seconds give it to a dB only.
        loud = 10 ** (level.ravel() / 10)
        slope = (loud[:, None] * slopes).sum(axis=0) / loud.sum()
        change = step[1:] + whole[1:]
        constant = -(james_stein(louder, standard_error) + float(slope[1:] @ change)) / slope[0]
        step = np.concatenate([[taken[0] + constant * math.log(10) / 20], step[1:] * math.log(10) / 20])
        taken = np.clip(step, -MAX_ADJUSTMENT, MAX_ADJUSTMENT)
        excitation = Excitation(_adjusted(uncalibrated.sigma, taken, within), excitation.innovation_limit)
    return excitation, errors


def _adjusted(sigma: Scale, step: NDArray[np.floating], within: Array) -> Scale:
    """σ with a step (6,) added to the constant and the exponents of its logarithm, bounded over conditions (n, 2) scaled."""
    parts = {"out_bias": sigma.out_bias + step[:1], "exponents": sigma.exponents + step[1:]}
    return _as_in_file(replace(sigma, **parts).bounded(within))


def _filtered(power: Array, response: Array | None) -> Array:
    """Power after a filter, from the power before it at each sample, (n_blocks, n, any)."""
    if response is None:
        return power
    n = power.shape[1]
    extended = np.pad(power, ((0, 0), (n, 0), (0, 0)), mode="edge")  # before the first sample as at the first
    return np.asarray(fftconvolve(extended, response[None, :n, None] / response[:n].sum(), axes=1)[:, n : 2 * n])


def _jackknifed(parts: Array, figure: Callable[..., Array]) -> tuple[float, float]:
    """A figure of sums over blocks of their parts (k, n), and its jackknifed standard error."""
    total, n = parts.sum(axis=1, keepdims=True), parts.shape[1]
    without = figure(*(total - parts))
    return figure(*total).item(), float(np.sqrt((n - 1) / n * np.square(without - without.mean()).sum()))
