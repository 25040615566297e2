"""Fit of foten-plus: level → lattice → tones → excitation → recorded innovations → equaliser → network → proof."""

import copy
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch

from foten.dsp import Array
from foten.dsp.equaliser import Equaliser
from foten.dsp.level import FRAME_MS, frame_levels, frame_means
from foten.dsp.shrinkage import regression_with_prior
from foten.models.conditions import MOVING_FORCE, MOVING_SPEED
from foten.models.definitions import model_of
from foten.models.foten_plus.config import FotenPlusConfig, withholds_recording
from foten.models.foten_plus.equaliser_fit import fit_equaliser
from foten.models.foten_plus.linear_model import MIN_SAMPLES_PER_SECTION, LinearModel, fit_level, fit_linear_models
from foten.models.foten_plus.network import (
    InnovationNetwork,
    fit_innovation_network,
    innovations_of,
    mean_share,
    scored,
    with_mean_share,
)
from foten.models.foten_plus.recorded_fit import recorded_innovations
from foten.models.foten_plus.recorded_innovations import neighbourhoods
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.foten_plus.tones_fit import FittedResidual, fit_residual, tonal_model
from foten.models.texture_file import Texture
from foten.training.calibration import (
    UNSCORED_SHARE,
    Calibrated,
    ClosedLoop,
    Residuals,
    calibrate_excitation,
    calibrate_level,
)
from foten.training.checkpoint import Progress
from foten.training.excerpt_classifier import classified_area
from foten.training.job import ScaledBlocks, Trained, TrainingJob, check_block
from foten.training.loop import Monitor, pick_device
from foten.training.texture_builder import TextureBuilder, tensors_of

MAX_DISTORTION = 1.05  # times the log-spectral distance of the first linear model, on the validation blocks
MAX_NOISE_AREA = 0.6  # up to which noise is not told from the recording: nothing else is tried then
MAX_EXPONENT = 1.5  # of speed or force, that the level grows with outside the trained range
# Mean and standard deviation of these powers over textures: 100 measured AR models (0.97 ± 0.28, 0.32 ± 0.19), and the simulated
# ones (1.00, 0.33).
LAW = {"speed": (0.95, 0.28), "force": (0.33, 0.19)}


@dataclass(frozen=True)
class FitContext:
    """Arguments of every stage."""

    sizes: FotenPlusSizes
    config: FotenPlusConfig
    builder: TextureBuilder
    network: InnovationNetwork  # before its training
    monitor: Monitor

    @property
    def blocks(self) -> ScaledBlocks:
        """The recording."""
        return self.builder.blocks

    def closed_loop(self, model: LinearModel) -> ClosedLoop:
        """Free runs of a linear model, which play no recorded moment near their own block."""
        tensors = {**model.tensors, **tensors_of(self.network, "network.")}
        kernel = partial(self.builder.kernel, model.sizes, tensors)
        history, trace = model.sizes.history, self.blocks.trace
        excluded = partial(neighbourhoods, self.blocks.split, trace)
        response = model.response(trace.block - history)
        return ClosedLoop(self.blocks, history, kernel, model.power, response, excluded=excluded)


@dataclass(frozen=True)
class Candidate:
    """A linear model with its random part."""

    model: LinearModel
    random_part: Calibrated
    equaliser: Equaliser | None = None
    area: float | None = None  # `classified_area`; None where there are too few excerpts
    rejected: tuple[dict[str, Any], ...] = ()  # reports of linear models that were tried beside it

    def report(self) -> dict[str, Any]:
        """What the linear model is, and the errors of its free runs."""
        sizes = self.model.sizes
        kind = {"order": sizes.order, "n_speed": sizes.n_speed, "gain_before_filter": sizes.gain_before_filter}
        return {**self.model.report, "free_run": self.random_part.free_run._asdict(), "kind": kind}


@dataclass(frozen=True)
class FittedNetwork:
    """A network that predicts recorded samples, with a share of its mean."""

    network: InnovationNetwork
    mean_share: float
    mae: float  # of the validation blocks, scaled
    progress: Progress


def fit(job: TrainingJob, monitor: Monitor) -> Trained:
    """Texture learned from a recording.

    A first texture is playable before the linear models are compared. What is rendered is final before the network, which only
    predicts recorded samples, is fitted.
    """
    run = fit_context(job, monitor)
    level, data = fit_level(run.blocks.flat[:, 0], run.sizes, run.blocks, run.config)
    with ThreadPoolExecutor() as executor:  # tones take as long as lattices
        residual = executor.submit(fit_residual, data, run.sizes, run.blocks, run.config)
        linear_models = fit_linear_models(level, data, run.sizes, run.config)
        excited = best_linear_model(linear_models, residual.result, run)
    chosen = fit_random_part(excited, run)
    play(chosen, run)
    network = fit_network(chosen.model, run)
    monitor.on_stage("proving the texture file")
    texture = texture_of(chosen, network, run)
    mae = texture.card["metrics"]["validation_mae_scaled_lattice"]
    return Trained(texture, run.blocks.trace, run.blocks.split, network.progress, mae)


def fit_context(job: TrainingJob, monitor: Monitor) -> FitContext:
    """Blocks of the recording, a builder of textures, and a new network.

    Raises:
        ValueError: blocks are too short for windows, or for a frame to calibrate on.
    """
    sizes, config = job.sizes, job.config
    assert isinstance(sizes, FotenPlusSizes)
    assert isinstance(config, FotenPlusConfig)
    blocks = checked_blocks(job, sizes.window, config.max_order)
    monitor.on_stage("fitting level, lattices and tones")
    device = pick_device()
    card = {**job.card(blocks, device.type), "extrapolation_exponents": extrapolation_exponents(blocks)}
    torch.manual_seed(config.seed)
    network = InnovationNetwork(sizes).to(device)
    return FitContext(sizes, config, TextureBuilder(job.model, blocks, card, model_of), network, monitor)


def checked_blocks(job: TrainingJob, window: int, max_order: int) -> ScaledBlocks:
    """The recording in blocks; ValueError where they are too short for windows, or for a frame to calibrate on."""
    blocks = job.blocks()
    check_block(blocks, window)
    rate, block = blocks.trace.rate_hz, blocks.trace.block
    frame, history = FRAME_MS * rate / 1000, window + 1 + min(max_order, block // MIN_SAMPLES_PER_SECTION)
    if block - max(UNSCORED_SHARE * block, history) < frame:
        enough = max(frame / (1 - UNSCORED_SHARE), (frame + window + 1) / (1 - 1 / MIN_SAMPLES_PER_SECTION))
        raise ValueError(
            f"a block of {1000 * block / rate:g} ms holds no frame of {FRAME_MS:g} ms after its first {history} samples, and "
            f"the level could not be calibrated: use a --block of {math.ceil(1000 * enough / rate)} ms or more"
        )
    return blocks


def play(candidate: Candidate, run: FitContext) -> None:
    """Hand on a texture of a candidate, which is marked as unfinished, to whoever wants to stroke it already."""
    early = texture_of(candidate, None, run)
    unfinished = {**early.card, "training": {**early.card["training"], "unfinished": True}}
    run.monitor.on_playable(replace(early, card=unfinished))


def best_linear_model(
    linear: Sequence[LinearModel], residual: Callable[[], FittedResidual | None], run: FitContext
) -> Candidate:
    """The linear model, with tones or without, that `best_candidate` chooses once excited.

    The first is playable before it is compared. Those without tones are excited while tones, if there are any, are being fitted.
    """
    run.monitor.on_stage("fitting the excitation and calibrating its level in the closed loop")
    first = excited(linear[0], run)
    play(first, run)
    with ThreadPoolExecutor() as pool:
        others = [pool.submit(excited, model, run) for model in linear[1:]]
        fitted = residual()
        tonal = [] if fitted is None else [excited(tonal_model(linear[0], fitted, run.blocks.trace.rate_hz), run)]
        return best_candidate([first, *(candidate.result() for candidate in others), *tonal])


def excited(model: LinearModel, run: FitContext) -> Candidate:
    """A linear model with an excitation of its residuals, calibrated in the closed loop."""
    _, e, gain = model.innovations(run.blocks, residual=True)
    train, validation = run.blocks.targets(model.sizes.history)
    n = np.concatenate([train, validation])
    condition, moving = run.blocks.flat[n - 1, 1:], run.blocks.moving().ravel()[n]
    residuals = Residuals(condition, e.ravel()[n], gain.ravel()[n], len(train), moving)
    width = model.sizes.excitation_width
    loop = run.closed_loop(model).with_unit_sigma(width, residuals.largest)
    return Candidate(model, calibrate_excitation(width, residuals, loop, run.config.seed))


def best_candidate(candidates: Sequence[Candidate]) -> Candidate:
    """The candidate of the least log-spectral distance × level error, with reports of the others.

    One whose log-spectral distance is not within `MAX_DISTORTION` of the first's is not taken.
    """
    allowed = MAX_DISTORTION * candidates[0].random_part.free_run.lsd_db
    eligible = [one for one in candidates if one is candidates[0] or one.random_part.free_run.lsd_db <= allowed]
    best = min(eligible, key=lambda candidate: math.prod(candidate.random_part.free_run))
    return replace(best, rejected=tuple(one.report() for one in candidates if one is not best))


def fit_random_part(excited: Candidate, run: FitContext) -> Candidate:
    """The candidate behind its equaliser, or one with recorded innovations that is told from the recording less often."""
    excited = equalised(excited, run.closed_loop(excited.model), run)
    playing = recorded_candidates(excited, run) if is_distinguishable(excited) else []
    return best_random_part([excited, *playing])


def fit_network(model: LinearModel, run: FitContext) -> FittedNetwork:
    """The network that predicts a recorded sample over the linear model's lattice."""
    run.monitor.on_stage("renderings are final; training the network for one-step predictions")
    warm_up, blocks, network = model.sizes.window, run.blocks, copy.deepcopy(run.network)
    data = innovations_of(model, blocks, model.n_transient)
    progress = fit_innovation_network(network, data, blocks, warm_up, run.config, run.monitor)
    tensors = data.tensors(next(network.parameters()).device)

    def validated(it: InnovationNetwork) -> tuple[Array, Array, Array]:
        return scored(it, data, tensors, blocks.split.validation, warm_up)[1:]

    share = mean_share(*validated(network), blocks.trace.rate_hz, len(progress.epochs) - 1)
    predictor = with_mean_share(network, share)
    innovation, mean, gain = validated(predictor)
    return FittedNetwork(predictor, share, float(np.abs((innovation - mean) * gain).mean()), progress)


def recorded_candidates(excited: Candidate, run: FitContext) -> list[Candidate]:
    """Candidates that play recorded innovations over the excited one's σ, as they were and along the path, each calibrated."""
    random_part, stored = excited.random_part, run.config.recorded_innovations
    microphone = run.builder.card.get("microphone", False)
    if stored == "never" or withholds_recording(microphone, run.blocks.trace.rate_hz, stored):
        return []
    recorded = recorded_innovations(excited.model, random_part.excitation.sigma, run.blocks)
    if recorded is None:
        return []
    run.monitor.on_stage("calibrating the level of recorded innovations")
    limit = float(np.abs(recorded.values).max()), random_part.excitation.innovation_limit[1]

    def calibrated(along_path: bool) -> Candidate:
        sizes = replace(excited.model.sizes, recorded=True, along_path=along_path)
        model = replace(excited.model, sizes=sizes, tensors={**excited.model.tensors, **recorded.tensors()})
        loop = run.closed_loop(model)
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


def texture_of(chosen: Candidate, fitted: FittedNetwork | None, run: FitContext) -> Texture:
    """Proved texture of a candidate; `fitted` is None before the network is."""
    _, e, gain = chosen.model.innovations(run.blocks)
    first = chosen.model.n_transient + 1 + chosen.model.sizes.window
    linear_mae = float(np.abs((e * gain)[list(run.blocks.split.validation), first:]).mean())
    metrics: dict[str, Any] = {"best_epoch": 0, "n_epochs": 0, "validation_loss": None}
    metrics["validation_mae_scaled"] = linear_mae
    network = run.network
    if fitted is not None:
        network = fitted.network
        best, last = fitted.progress.best, fitted.progress.epochs[-1]
        metrics = {"best_epoch": best.epoch, "n_epochs": last.epoch, "validation_loss": best.validation_loss}
        metrics |= {"validation_mae_scaled": fitted.mae, "mean_share": fitted.mean_share}
    metrics |= {
        **chosen.random_part.metrics(),
        "validation_mae_scaled_lattice": linear_mae,
        "linear_model": {**chosen.report(), **({"rejected": list(chosen.rejected)} if chosen.rejected else {})},
        "area": chosen.area,
        "recorded_peak_sd": run.blocks.peak_sd,
    }
    tensors = {**chosen.model.tensors, **tensors_of(network, "network."), **chosen.random_part.excitation.tensors()}
    if chosen.equaliser is not None:
        tensors |= chosen.equaliser.tensors()
    sizes = replace(chosen.model.sizes, equalised=chosen.equaliser is not None)
    return run.builder.texture(sizes, tensors, metrics).texture


def equalised(candidate: Candidate, loop: ClosedLoop, run: FitContext) -> Candidate:
    """The candidate with an equaliser, where that is borne out; its errors are those behind it."""
    random_part, seed = candidate.random_part, run.config.seed
    loop = loop.with_kernel_of(random_part.excitation)
    equaliser = fit_equaliser(loop, random_part.excitation, seed)
    loop = replace(loop, as_heard=True, equaliser=equaliser)
    random_part = replace(random_part, free_run=loop.free_run_errors(random_part.excitation, seed))
    area = classified_area(loop, random_part.excitation, seed)
    return replace(candidate, random_part=random_part, equaliser=equaliser, area=area)


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
        posterior = regression_with_prior(logs[:, upper].T, levels[upper] * math.log(10) / 20, law)
        exponents[name] = float(np.clip(posterior[row], 0.0, MAX_EXPONENT))
    return exponents
