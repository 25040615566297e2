"""Fit of foten-plus: level → lattice → tones → excitation → likelihood → closed loop → calibrate → prove."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import Any

import numpy as np
import torch

from foten.dsp import Array
from foten.dsp.equaliser import Equaliser
from foten.dsp.level import FRAME_MS, frame_levels, frame_means
from foten.models.conditions import MOVING_FORCE, MOVING_SPEED
from foten.models.foten_plus.closed_loop_training import envelope_distance_of, excerpts_of, fit_closed_loop
from foten.models.foten_plus.equaliser_fit import fit_equaliser
from foten.models.foten_plus.linear_model import MIN_SAMPLES_PER_SECTION, LinearModel, fit_level, fit_linear_models
from foten.models.foten_plus.network import (
    InnovationNetwork,
    Innovations,
    fit_innovation_network,
    innovations_of,
    mean_share,
    scored,
    with_mean_share,
)
from foten.models.foten_plus.recorded_fit import recorded_innovations
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.foten_plus.tones_fit import fit_residual, silent_tones, tonal_model
from foten.models.texture_file import Texture
from foten.recording.recording import RELATIVE
from foten.runtime.proof import Tensors
from foten.training.calibration import (
    UNSCORED_SHARE,
    Calibrated,
    ClosedLoop,
    Residuals,
    calibrate_excitation,
    calibrate_level,
    calibrate_network_gain,
)
from foten.training.config import TrainConfig
from foten.training.excerpt_classifier import classified_area
from foten.training.job import ScaledBlocks, Trained, TrainingJob, check_block
from foten.training.loop import Monitor, Progress, pick_device
from foten.training.texture_builder import TextureBuilder, tensors_of

MIN_GAIN_NAT = 0.005  # of an innovation's nll on the validation blocks, for a network to be in the loop
INNOVATION_HEADROOM = 1.3  # times the largest recorded innovation is the largest that a network may draw
MAX_TONE_DISTORTION = 1.05  # times the log-spectral distance without tones, on the validation blocks
AS_NEAR = 0.005  # share of the distance by which a table is nearer than one filter, to be worth it
MAX_MICROPHONE_HZ = 2000.0  # rate above which a microphone's recording is not stored: speech nearby could be in it
MAX_NOISE_AREA = 0.6  # up to which noise is not told from the recording: nothing else is tried then
MAX_EXPONENT = 1.5  # of speed or force, that the level grows with outside the trained range
# Mean and standard deviation of these powers over textures: 100 measured AR models (0.97 ± 0.28, 0.32 ± 0.19), and the simulated
# ones (1.00, 0.33).
LAW = {"speed": (0.95, 0.28), "force": (0.33, 0.19)}
N_REGRESSIONS = 3


@dataclass(frozen=True)
class FitContext:
    """Arguments of every stage after the linear model."""

    builder: TextureBuilder
    config: TrainConfig
    monitor: Monitor

    @property
    def blocks(self) -> ScaledBlocks:
        """The recording."""
        return self.builder.blocks


@dataclass(frozen=True)
class Candidate:
    """A linear model with its random part: an excitation, or a network that is in the loop."""

    model: LinearModel
    random_part: Calibrated
    rendering_network: Tensors = field(default_factory=dict)  # where one is in the loop
    closed_loop: dict[str, float] | None = None  # validation loss of its closed-loop training, before and after
    distance: float | None = None  # `_distance`; None where blocks are too short for envelopes
    equaliser: Equaliser | None = None
    area: float | None = None  # `classified_area`; None where there are too few excerpts


@dataclass(frozen=True)
class FittedNetwork:
    """A network fitted by likelihood, for renderings by a linear model; its nll is of the validation blocks [nat]."""

    model: LinearModel
    network: InnovationNetwork
    data: Innovations
    progress: Progress
    innovation_nll: float
    predictor: InnovationNetwork  # the same with a share of its mean
    mean_share: float
    predictor_mae: float  # scaled, as the next of the validation blocks
    acceleration_nll: float | None  # of the predictor where a rendering does not fade; None where it always does


def fit(job: TrainingJob, monitor: Monitor) -> Trained:
    """Texture learned from a recording; its linear model is playable before its networks are fitted."""
    sizes, config = job.sizes, job.config
    assert isinstance(sizes, FotenPlusSizes)
    blocks = checked_blocks(job, sizes.window)
    monitor.on_stage("fitting level, lattices and tones")
    level, data = fit_level(blocks.flat[:, 0], sizes, blocks, config)
    run = FitContext(texture_builder(job, blocks), config, monitor)
    torch.manual_seed(config.seed)
    initial = InnovationNetwork(sizes).to(pick_device())
    with ThreadPoolExecutor() as beside:
        residual = beside.submit(fit_residual, data, sizes, blocks, config)
        linear_models = fit_linear_models(level, data, sizes, config)

        @cache
        def with_tones() -> LinearModel | None:
            fitted = residual.result()
            return None if fitted is None else tonal_model(linear_models[0], fitted, blocks.trace.rate_hz)

        def playable(candidate: Candidate) -> None:
            early = texture_of([candidate], initial, None, best_candidate([candidate])[1], run)
            unfinished = {**early.card, "training": {**early.card["training"], "unfinished": True}}
            monitor.on_playable(replace(early, card=unfinished))

        monitor.on_stage("fitting the excitation and calibrating its level in the closed loop")
        excited, report = best_linear_model(linear_models, with_tones, initial, run, playable)
    if excited.model is not linear_models[0]:
        playable(excited)
    tonal = with_tones()
    linear = linear_models[0] if excited.model.phase is not None else excited.model
    with ThreadPoolExecutor() as beside:
        loop = _closed_loop(excited.model, tensors_of(initial, "network."), run)
        behind_equaliser = beside.submit(equalised, excited, loop, run)
        network = fit_network(initial, excited, run)
    excited = behind_equaliser.result()
    playing = recorded_candidates(excited, tensors_of(initial, "network."), run) if is_distinguishable(excited) else []
    chosen = best_random_part([excited, *playing])
    rendering_network = fit_rendering_network(network, excited, linear, tonal, run)
    in_loop = calibrated_network(rendering_network, chosen, network.network, run)
    network.progress.include(rendering_network.progress)
    monitor.on_stage("proving the texture file")
    candidates = [chosen, *([] if in_loop is None else [in_loop])]
    texture = texture_of(candidates, network.predictor, network, report, run)
    mae = texture.card["metrics"]["validation_mae_scaled_lattice"]
    return Trained(texture, blocks.trace, blocks.split, network.progress, mae)


def checked_blocks(job: TrainingJob, window: int) -> ScaledBlocks:
    """The recording in blocks; ValueError where they are too short for windows, or for a frame to calibrate on."""
    blocks = job.blocks()
    check_block(blocks, window)
    rate, block = blocks.trace.rate_hz, blocks.trace.block
    frame, history = FRAME_MS * rate / 1000, window + 1 + min(job.config.max_order, block // MIN_SAMPLES_PER_SECTION)
    if block - max(UNSCORED_SHARE * block, history) < frame:
        enough = max(frame / (1 - UNSCORED_SHARE), (frame + window + 1) / (1 - 1 / MIN_SAMPLES_PER_SECTION))
        raise ValueError(
            f"a block of {1000 * block / rate:g} ms holds no frame of {FRAME_MS:g} ms after its first {history} samples, and "
            f"the level could not be calibrated: use a --block of {math.ceil(1000 * enough / rate)} ms or more"
        )
    return blocks


def texture_builder(job: TrainingJob, blocks: ScaledBlocks) -> TextureBuilder:
    """Builder of textures of the recording."""
    card = job.card(blocks, pick_device().type)
    return TextureBuilder(job.model, blocks, {**card, "extrapolation_exponents": extrapolation_exponents(blocks)})


def best_linear_model(
    linear: Sequence[LinearModel],
    tonal: Callable[[], LinearModel | None],
    network: InnovationNetwork,
    run: FitContext,
    playable: Callable[[Candidate], None] = lambda candidate: None,
) -> tuple[Candidate, dict[str, Any]]:
    """The linear model, with tones or without, that `best_candidate` chooses once excited; and what was tried.

    The first is `playable` before it is compared. Those without tones are excited while that with tones, if there is one, is
    being fitted.
    """
    networks = tensors_of(network, "network.")

    def calibrated(model: LinearModel) -> tuple[Candidate, ClosedLoop]:
        _, e, gain = model.innovations(run.blocks, residual=True)
        train, validation = run.blocks.targets(model.sizes.history)
        n = np.concatenate([train, validation])
        condition, moving = run.blocks.flat[n - 1, 1:], run.blocks.moving().ravel()[n]
        residuals = Residuals(condition, e.ravel()[n], gain.ravel()[n], len(train), moving)
        width = model.sizes.excitation_width
        loop = _closed_loop(model, networks, run).with_unit_sigma(width, residuals.largest)
        return Candidate(model, calibrate_excitation(width, residuals, loop, run.config.seed)), loop

    def compared(candidate: Candidate, loop: ClosedLoop) -> Candidate:
        return replace(candidate, distance=_distance(loop, candidate.random_part, run))

    def excited(model: LinearModel) -> Candidate:
        return compared(*calibrated(model))

    first, loop = calibrated(linear[0])
    playable(first)
    with ThreadPoolExecutor() as pool:
        without_tones = [pool.submit(compared, first, loop), *(pool.submit(excited, model) for model in linear[1:])]
        with_tones = tonal()
        candidates = [] if with_tones is None else [excited(with_tones)]
        return best_candidate([*(candidate.result() for candidate in without_tones), *candidates])


def best_candidate(candidates: Sequence[Candidate]) -> tuple[Candidate, dict[str, Any]]:
    """The candidate whose band envelopes are nearest to the recording's, and what was tried.

    Where blocks are too short for envelopes, that of the least log-spectral distance × level error within `MAX_TONE_DISTORTION`.
    """

    def report(candidate: Candidate) -> dict[str, Any]:
        errors = {**candidate.random_part.free_run._asdict(), "distance": candidate.distance}
        sizes = candidate.model.sizes
        kind = {"order": sizes.order, "n_speed": sizes.n_speed, "gain_before_filter": sizes.gain_before_filter}
        return {**candidate.model.report, "free_run": errors, "kind": kind}

    first, *others = candidates
    if first.distance is None:
        allowed = MAX_TONE_DISTORTION * first.random_part.free_run.lsd_db
        eligible = [first, *(candidate for candidate in others if candidate.random_part.free_run.lsd_db <= allowed)]
        best = min(eligible, key=lambda candidate: math.prod(candidate.random_part.free_run))
    else:
        best = _nearest(candidates)
    rejected = [report(candidate) for candidate in candidates if candidate is not best]
    return best, {**report(best), **({"rejected": rejected} if rejected else {})}


def _nearest(candidates: Sequence[Candidate]) -> Candidate:
    """The candidate of the least distance; in place of a table one filter with its gain there, where that is as near."""
    best = min(candidates, key=lambda candidate: candidate.distance or 0.0)
    if best.model.phase is not None:
        return best
    for other in candidates:
        sizes = other.model.sizes
        alike = other.model.phase is None and sizes.gain_before_filter == best.model.sizes.gain_before_filter
        if alike and sizes.n_speed * sizes.n_force == 1:
            return other if (other.distance or 0.0) <= (best.distance or 0.0) * (1 + AS_NEAR) else best
    return best


def fit_network(network: InnovationNetwork, excited: Candidate, run: FitContext) -> FittedNetwork:
    """The network that predicts a recorded sample, over the linear model's lattice; a rendering may draw from it."""
    data = innovations_of(excited.model, run.blocks, excited.model.n_transient)
    return _fitted(network, excited.model, data, run, "network")


def fit_rendering_network(
    network: FittedNetwork, excited: Candidate, linear: LinearModel, tonal: LinearModel | None, run: FitContext
) -> FittedNetwork:
    """The network that a rendering may draw from.

    With tones, one of their residual that is given their phase; else the more likely of one with the phase and `network`.
    """
    if tonal is None or network.progress.interrupted:
        return network
    with_tones = excited.model.phase is not None
    model = excited.model if with_tones else silent_tones(linear, tonal)
    data = innovations_of(model, run.blocks, network.data.n_transient, residual=True)
    torch.manual_seed(run.config.seed + 1)
    initial = InnovationNetwork(model.sizes, model.sizes.n_rendering_inputs).to(pick_device())
    run.monitor.on_stage("training a network that is given the phase of the surface")
    quiet = replace(run, monitor=replace(run.monitor, on_epoch=lambda epoch: None))
    phase_conditioned = _fitted(initial, model, data, quiet, "phase-conditioned network")
    network.progress.include(phase_conditioned.progress)  # that of the training, whichever is drawn from
    likelier = network.innovation_nll - phase_conditioned.innovation_nll >= MIN_GAIN_NAT
    return phase_conditioned if with_tones or likelier else network


def recorded_candidates(excited: Candidate, networks: Tensors, run: FitContext) -> list[Candidate]:
    """Candidates that play recorded innovations over the excited one's σ, as they were and along the path, each calibrated."""
    random_part = excited.random_part
    recorded = recorded_innovations(excited.model, random_part.excitation.sigma, run.blocks)
    of_microphone = run.builder.card["units"]["acceleration"] == RELATIVE
    if recorded is None or (of_microphone and run.blocks.trace.rate_hz > MAX_MICROPHONE_HZ):
        return []
    run.monitor.on_stage("calibrating the level of recorded innovations")
    limit = float(np.abs(recorded.values).max()), random_part.excitation.innovation_limit[1]

    def calibrated(along_path: bool) -> Candidate:
        sizes = replace(excited.model.sizes, recorded=True, along_path=along_path)
        model = replace(excited.model, sizes=sizes, tensors={**excited.model.tensors, **recorded.tensors()})
        loop = _closed_loop(model, networks, run)
        excitation, errors = calibrate_level(
            loop, replace(random_part.excitation, innovation_limit=limit), run.config.seed
        )
        part = replace(random_part, excitation=excitation, level_errors_db=errors)
        return equalised(Candidate(model, part), loop, run)

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(calibrated, (False, True)))


def best_random_part(candidates: Sequence[Candidate]) -> Candidate:
    """The candidate that is told from the recording the least often, the first where that is not known."""
    return min(candidates, key=lambda candidate: candidate.area or 0.0)


def is_distinguishable(candidate: Candidate) -> bool:
    """Whether a candidate is told from the recording more often than chance explains."""
    return candidate.area is not None and candidate.area > MAX_NOISE_AREA


def calibrated_network(
    fitted: FittedNetwork, excited: Candidate, network: InnovationNetwork, run: FitContext
) -> Candidate | None:
    """Candidate that draws from a network, calibrated in its closed loop; None where noise is as near, or as likely."""
    compared = excited.area is not None and run.config.closed_loop_training
    if compared and not is_distinguishable(excited):
        return None
    gain_nat = excited.random_part.innovation_nll - fitted.innovation_nll
    if not fitted.progress.best.epoch or (gain_nat < MIN_GAIN_NAT and not compared):
        return None
    drawing, sizes = copy.deepcopy(fitted.network), fitted.model.sizes
    if drawing.recurrent.input_size != sizes.n_rendering_inputs:
        return None  # it was interrupted before there was one that is given the phase of its tones
    model = replace(fitted.model, sizes=replace(sizes, network_in_loop=True))
    limit, closed_loop = _innovation_limit(fitted.data, run.blocks), None
    if run.config.closed_loop_training and not fitted.progress.interrupted:
        closed_loop = _train_in_closed_loop(drawing, fitted, model, limit[0], run)
    gained = closed_loop is not None and closed_loop["after"] < closed_loop["before"]
    if not gained:
        run.monitor.on_stage("calibrating the level with the network in the loop")
    tensors = tensors_of(drawing, "rendering_network.")
    loop = _closed_loop(model, {**tensors_of(network, "network."), **tensors}, run)
    nll, seed = fitted.acceleration_nll, run.config.seed
    random_part = calibrate_network_gain(sizes.excitation_width, limit, loop, seed, nll, level=not gained)
    run.monitor.on_stage("fitting the equaliser of the network's renderings")
    candidate = equalised(Candidate(model, random_part, tensors, closed_loop), loop, run)
    if compared and (candidate.area or 0.0) >= (excited.area or 0.0):
        return None
    return candidate


def texture_of(
    candidates: Sequence[Candidate],
    network: InnovationNetwork,
    fitted: FittedNetwork | None,
    report: dict[str, Any],
    run: FitContext,
) -> Texture:
    """Proved texture of the last candidate; the first is its linear model alone; `fitted` is None before the networks are."""
    excited, chosen = candidates[0].model, candidates[-1]
    _, e, gain = excited.innovations(run.blocks)
    first = excited.n_transient + 1 + excited.sizes.window
    linear_mae = float(np.abs((e * gain)[list(run.blocks.split.validation), first:]).mean())
    metrics: dict[str, Any] = {"best_epoch": 0, "n_epochs": 0, "validation_loss": None}
    metrics["validation_mae_scaled"] = linear_mae
    if fitted is not None:
        best, last = fitted.progress.best, fitted.progress.epochs[-1]
        metrics = {"best_epoch": best.epoch, "n_epochs": last.epoch, "validation_loss": best.validation_loss}
        metrics |= {"validation_mae_scaled": fitted.predictor_mae, "mean_share": fitted.mean_share}
    metrics |= {
        **chosen.random_part.metrics(),
        "validation_mae_scaled_lattice": linear_mae,
        "linear_model": report,
        "renderings": {
            name: {
                **candidate.random_part.metrics(),
                "closed_loop_training": candidate.closed_loop,
                "distance": candidate.distance,
                "area": candidate.area,
                "equalised": candidate.equaliser is not None,
            }
            for name, candidate in zip(("without network", "with network"), candidates, strict=False)
        },
        "recorded_peak_sd": run.blocks.peak_sd,
    }
    tensors = {**chosen.model.tensors, **tensors_of(network, "network."), **chosen.rendering_network}
    tensors |= chosen.random_part.excitation.tensors()
    if chosen.equaliser is not None:
        tensors |= chosen.equaliser.tensors()
    sizes = replace(chosen.model.sizes, equalised=chosen.equaliser is not None)
    return run.builder.texture(sizes, tensors, metrics).texture


def _fitted(
    network: InnovationNetwork, model: LinearModel, data: Innovations, run: FitContext, name: str
) -> FittedNetwork:
    warm_up, blocks = model.sizes.window, run.blocks
    progress = fit_innovation_network(network, data, blocks, warm_up, run.config, run.monitor, name)
    tensors = data.tensors(next(network.parameters()).device)
    nll, innovation, mean, gain = scored(network, data, tensors, blocks.split.validation, warm_up)
    share = mean_share(innovation, mean, gain, blocks.trace.rate_hz, len(progress.epochs) - 1)
    predictor = with_mean_share(network, share)
    predictor_nll, _, mean, _ = scored(predictor, data, tensors, blocks.split.validation, warm_up)
    mae = float(np.abs((innovation - mean) * gain).mean())
    moving = blocks.moving()[list(blocks.split.validation), data.n_transient + 1 + warm_up :]
    acceleration_nll = float((predictor_nll + np.log(gain))[moving].mean()) if moving.any() else None
    return FittedNetwork(model, network, data, progress, float(nll.mean()), predictor, share, mae, acceleration_nll)


def _train_in_closed_loop(
    network: InnovationNetwork, fitted: FittedNetwork, model: LinearModel, innovation_limit: float, run: FitContext
) -> dict[str, float] | None:
    """Validation loss before and after; None where blocks are too short for it, or the rate is too high."""
    excerpts = excerpts_of(run.blocks, model, fitted.data, innovation_limit)
    if excerpts is None:
        run.monitor.on_stage("no training in the closed loop: blocks are too short for it, or the rate is too high")
        return None
    progress = fit_closed_loop(network, excerpts, model.sizes.window, run.config, run.monitor)
    fitted.progress.include(progress)
    return {"before": progress.epochs[0].validation_loss, "after": progress.best_loss}


def equalised(candidate: Candidate, loop: ClosedLoop, run: FitContext) -> Candidate:
    """The candidate with an equaliser, where that is borne out; its errors and its distance are those behind it."""
    random_part, seed = candidate.random_part, run.config.seed
    loop = loop.with_kernel_of(random_part.excitation)
    equaliser = fit_equaliser(loop, random_part.excitation, seed)
    loop = replace(loop, as_heard=True, equaliser=equaliser)
    random_part = replace(random_part, free_run=loop.free_run_errors(random_part.excitation, seed))
    distance, area = _distance(loop, random_part, run), classified_area(loop, random_part.excitation, seed)
    return replace(candidate, random_part=random_part, distance=distance, equaliser=equaliser, area=area)


def _distance(loop: ClosedLoop, random_part: Calibrated, run: FitContext) -> float | None:
    """How far a closed loop is from the recording: `envelope_distance_of`, times the log-spectral distance [dB]."""
    distance = envelope_distance_of(loop, random_part.excitation, run.config.seed)
    return None if distance is None else distance * random_part.free_run.lsd_db


def _closed_loop(model: LinearModel, networks: Tensors, run: FitContext) -> ClosedLoop:
    kernel = partial(run.builder.kernel, model.sizes, {**model.tensors, **networks})
    history, block = model.sizes.history, run.blocks.trace.block
    return ClosedLoop(run.blocks, history, kernel, model.power, model.response(block - history))


def _innovation_limit(data: Innovations, blocks: ScaledBlocks) -> tuple[float, float]:
    """The largest innovations that a network may draw: in units of σ, and in scaled acceleration."""
    train = list(blocks.split.train)
    residuals = data.innovation, data.innovation * data.innovation_gain
    recorded = (residual[train, data.n_transient + 1 :] for residual in residuals)
    in_sigma, in_acceleration = (INNOVATION_HEADROOM * float(np.abs(values).max()) for values in recorded)
    return in_sigma, in_acceleration


def extrapolation_exponents(blocks: ScaledBlocks) -> dict[str, float]:
    """Powers of speed and force that the level follows outside the trained range.

    Bayesian regression of levels in frames on the logarithms of speed and force, in the faster and the firmer half of the
    training blocks. The prior is the law that textures share, `LAW`; the recording's own exponents take over as they are known
    better. Levels of near frames depend on each other: as many count as the residuals' correlation leaves.

    Source: ours. Differs from the paper: it clamps speed and force to their range (Sec. VIII).
    """
    rate, law = blocks.trace.rate_hz, np.array(list(LAW.values()))
    if blocks.trace.block < FRAME_MS * rate / 1000:
        return dict(zip(LAW, law[:, 0].tolist(), strict=True))
    acceleration, *condition = np.moveaxis(blocks.training_blocks(), 2, 0)
    levels = frame_levels(acceleration, rate, float(np.sqrt(np.square(acceleration).mean()))).ravel()
    speed, force = (frame_means(channel, rate).ravel() for channel in condition)
    logs = np.log(np.maximum(np.stack([speed, force]), [[MOVING_SPEED], [MOVING_FORCE]]))
    exponents = {}
    for row, name in enumerate(LAW):
        upper = logs[row] >= np.median(logs[row])
        posterior = posterior_slopes(logs[:, upper].T, levels[upper] * math.log(10) / 20, law)
        exponents[name] = float(np.clip(posterior[row], 0.0, MAX_EXPONENT))
    return exponents


def posterior_slopes(logs: Array, levels: Array, prior: Array) -> Array:
    """Posterior mean of slopes: logarithms (n, k), log levels (n,), prior means and standard deviations (k, 2) → (k,)."""
    logs, levels = logs - logs.mean(axis=0), levels - levels.mean()
    precision = np.diag(1 / np.square(prior[:, 1]))
    slopes: Array = prior[:, 0]
    for _ in range(N_REGRESSIONS):  # the noise is what the slopes leave
        residual = levels - logs @ slopes
        correlation = float(np.clip(residual[1:] @ residual[:-1] / max(float(residual @ residual), 1e-12), 0.0, 0.95))
        noise = float(np.square(residual).mean()) * (1 + correlation) / (1 - correlation) + 1e-12
        moment = logs.T @ levels / noise + precision @ prior[:, 0]
        slopes = np.asarray(np.linalg.solve(logs.T @ logs / noise + precision, moment), dtype=np.float64)
    return slopes
