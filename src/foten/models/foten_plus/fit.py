"""foten-plus fitted to a recording: level → lattice → tones → excitation → likelihood → closed loop → calibrate → prove."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import torch

from foten.dsp.level import FRAME_MS, frame_levels, frame_means
from foten.models.conditions import FADE_FORCE, FADE_SPEED
from foten.models.foten_plus.closed_loop_training import excerpts_of, fit_closed_loop
from foten.models.foten_plus.innovation_network import InnovationNetwork as ReferenceNetwork
from foten.models.foten_plus.likelihood import Innovations, fit_innovation_network, innovations_of, scored
from foten.models.foten_plus.linear_model import LinearModel, fit_level, fit_linear_model, fit_tonal_model, silent_tones
from foten.models.foten_plus.network import InnovationNetwork
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import Texture
from foten.training.blocks import ScaledBlocks
from foten.training.calibration import Calibrated, ClosedLoop, Residuals, calibrate_excitation, calibrate_network_gain
from foten.training.config import TrainConfig
from foten.training.job import Trained, TrainingJob, check_block
from foten.training.loop import Monitor, Progress, pick_device
from foten.training.tensors import tensors_of
from foten.training.texture_builder import Tensors, TextureBuilder

MIN_GAIN_NAT = 0.005  # of an innovation's likelihood on the validation blocks, for a network to be in the loop
INNOVATION_HEADROOM = 1.3  # times the largest recorded innovation is the largest that a network may draw
MAX_TONE_DISTORTION = 1.05  # times the log-spectral distance without tones, on the validation blocks
MAX_EXPONENT = 1.5  # of speed or force, that the level grows with above the trained range


@dataclass(frozen=True)
class Candidate:
    """A linear model with its random part: an excitation, or a network that is in the loop."""

    model: LinearModel
    random_part: Calibrated
    network: Tensors = field(default_factory=dict)  # of a rendering, where one is in the loop
    closed_loop: dict[str, float] | None = None  # validation loss of its closed-loop training, before and after


@dataclass(frozen=True)
class FittedNetwork:
    """A network fitted by likelihood, for renderings by a linear model."""

    model: LinearModel
    network: InnovationNetwork
    data: Innovations
    progress: Progress
    likelihood: float  # negative, of innovations of the validation blocks [nat]
    metric: float | None  # the same of acceleration, where a rendering does not fade [nat]; None where it always does


def fit(job: TrainingJob, monitor: Monitor) -> Trained:
    """A texture learned from a recording; it is playable, by its linear model alone, before its networks are fitted."""
    sizes, config = job.sizes, job.config
    assert isinstance(sizes, FotenPlusSizes)
    blocks = checked_blocks(job, sizes.window)
    monitor.on_stage("fitting level and lattice")
    level = fit_level(blocks.flat[:, 0], sizes, blocks, config)
    linear = fit_linear_model(level, sizes, blocks, config)
    monitor.on_stage("looking for a wavelength, and fitting its tones")
    tonal = fit_tonal_model(linear, level, blocks, config)
    builder = texture_builder(job, blocks)
    torch.manual_seed(config.seed)
    network = InnovationNetwork(sizes).to(pick_device())
    monitor.on_stage("fitting the excitation and calibrating its level in the closed loop")
    excited_linear, report = nearest_linear_model(linear, tonal, network, builder, config)
    playable = texture_of(excited_linear, network, None, report, [], builder)
    monitor.on_playable(playable)
    predicting = fit_predicting_network(network, excited_linear, blocks, config, monitor)
    drawing = fit_drawing_network(predicting, excited_linear, linear, tonal, blocks, config, monitor)
    chosen = calibrated_network(drawing, excited_linear, network, builder, config, monitor)
    predicting.progress.include(drawing.progress)
    monitor.on_stage("proving the texture file")
    candidates = [excited_linear, *([chosen] if chosen is not None else [])]
    texture = texture_of(candidates[-1], network, predicting, report, candidates, builder)
    mae = texture.card["metrics"]["validation_mae_scaled_lattice"]
    return Trained(texture, blocks.trace, blocks.split, predicting.progress, mae)


def checked_blocks(job: TrainingJob, window: int) -> ScaledBlocks:
    """The recording in blocks that are long enough for windows, and for a frame to calibrate the level on."""
    blocks = job.blocks()
    check_block(blocks, window)
    rate, block = blocks.trace.rate_hz, blocks.trace.block
    frame, history = FRAME_MS * rate / 1000, window + 1 + min(job.config.max_order, block // 8)
    if block - max(0.2 * block, history) < frame:
        enough = max(frame / 0.8, (frame + window + 1) / (1 - 1 / 8))
        raise ValueError(
            f"a block of {1000 * block / rate:g} ms holds no frame of {FRAME_MS:g} ms after its first {history} samples, and "
            f"the level could not be calibrated: use a --block of {math.ceil(1000 * enough / rate)} ms or more"
        )
    return blocks


def texture_builder(job: TrainingJob, blocks: ScaledBlocks) -> TextureBuilder:
    """What a texture of the recording has, whatever it is rendered by."""
    card = job.card(blocks, pick_device().type)
    return TextureBuilder(job.model, blocks, {**card, "extrapolation_exponents": extrapolation_exponents(blocks)})


def nearest_linear_model(
    linear: LinearModel,
    tonal: LinearModel | None,
    network: InnovationNetwork,
    builder: TextureBuilder,
    config: TrainConfig,
) -> tuple[Candidate, dict[str, Any]]:
    """The linear model, with tones or without, whose free run is nearer with an excitation; and what was tried."""
    weights = tensors_of(network, "network.")
    candidates = []
    for model in [linear, *([] if tonal is None else [tonal])]:
        residuals, width = _residuals(model, builder.blocks), model.sizes.excitation_width
        loop = _closed_loop(model, builder, weights)
        candidates.append(Candidate(model, calibrate_excitation(width, residuals, loop, config.seed)))
    return nearest(candidates)


def nearest(candidates: Sequence[Candidate]) -> tuple[Candidate, dict[str, Any]]:
    """The candidate whose free run is nearest, and what was tried.

    Tones that change the spectrum are none of the surface's, whatever the level.
    """

    def report(candidate: Candidate) -> dict[str, Any]:
        distance = dict(zip(("lsd_db", "level_error_db"), candidate.random_part.distance, strict=True))
        return {**candidate.model.report, "free_run": distance}

    first, *others = candidates
    allowed = MAX_TONE_DISTORTION * first.random_part.distance[0]
    eligible = [first, *(candidate for candidate in others if candidate.random_part.distance[0] <= allowed)]
    best = min(eligible, key=lambda candidate: candidate.random_part.nearness)
    rejected = [report(candidate) for candidate in candidates if candidate is not best]
    return best, {**report(best), **({"rejected": rejected} if rejected else {})}


def fit_predicting_network(
    network: InnovationNetwork, excited_linear: Candidate, blocks: ScaledBlocks, config: TrainConfig, monitor: Monitor
) -> FittedNetwork:
    """The network that predicts a recorded sample, over the linear model's lattice."""
    data = innovations_of(excited_linear.model, blocks, _first(excited_linear.model))
    return _fitted(network, excited_linear.model, data, blocks, config, monitor, "network")


def fit_drawing_network(
    predicting: FittedNetwork,
    excited_linear: Candidate,
    linear: LinearModel,
    tonal: LinearModel | None,
    blocks: ScaledBlocks,
    config: TrainConfig,
    monitor: Monitor,
) -> FittedNetwork:
    """The network that a rendering may draw from: the one that predicts, or one that is given the phase of the surface.

    Where the rendering has tones, that of what they leave; else the one with the phase where it is likelier.
    """
    if tonal is None or predicting.progress.interrupted:
        return predicting
    with_tones = excited_linear.model.phase is not None
    model = excited_linear.model if with_tones else silent_tones(linear, tonal)
    data = innovations_of(model, blocks, predicting.data.first, residual=True)
    torch.manual_seed(config.seed + 1)
    network = InnovationNetwork(model.sizes, model.sizes.n_rendering_inputs).to(pick_device())
    monitor.on_stage("training a network that is given the phase of the surface")
    quiet = replace(monitor, on_epoch=lambda epoch: None)
    phase_conditioned = _fitted(network, model, data, blocks, config, quiet, "phase-conditioned network")
    predicting.progress.include(phase_conditioned.progress)  # that of the training, whichever is drawn from
    likelier = predicting.likelihood - phase_conditioned.likelihood >= MIN_GAIN_NAT
    return phase_conditioned if with_tones or likelier else predicting


def calibrated_network(
    drawing: FittedNetwork,
    excited_linear: Candidate,
    predicting: InnovationNetwork,
    builder: TextureBuilder,
    config: TrainConfig,
    monitor: Monitor,
) -> Candidate | None:
    """The rendering that draws from a network, trained in its closed loop and calibrated; None where noise is as likely."""
    before = excited_linear.random_part.likelihood_of_innovations
    if not drawing.progress.best.epoch or before - drawing.likelihood < MIN_GAIN_NAT:
        return None
    blocks, network = builder.blocks, copy.deepcopy(drawing.network)
    if network.recurrent.input_size != drawing.model.sizes.n_rendering_inputs:
        return None  # it was interrupted before there was one that is given the phase of its tones
    model = replace(drawing.model, sizes=replace(drawing.model.sizes, network_in_loop=True))
    limit, closed_loop = _innovation_limit(drawing.data, blocks), None
    if config.closed_loop_training and not drawing.progress.interrupted:
        closed_loop = _train_in_closed_loop(network, drawing, model, limit[0], blocks, config, monitor)
    gained = closed_loop is not None and closed_loop["after"] < closed_loop["before"]
    if not gained:
        monitor.on_stage("calibrating the level with the network in the loop")
    weights = {**tensors_of(predicting, "network."), **tensors_of(network, "rendering_network.")}
    loop, width = _closed_loop(model, builder, weights), model.sizes.excitation_width
    random_part = calibrate_network_gain(width, limit, loop, config.seed, drawing.metric, level=not gained)
    return Candidate(model, random_part, tensors_of(network, "rendering_network."), closed_loop)


def texture_of(
    chosen: Candidate,
    network: InnovationNetwork,
    predicting: FittedNetwork | None,
    report: dict[str, Any],
    candidates: Sequence[Candidate],
    builder: TextureBuilder,
) -> Texture:
    """The proved texture of a candidate; without a fitted network, that of its linear model alone."""
    blocks, model = builder.blocks, chosen.model
    linear_mae = _linear_mae(candidates[0] if candidates else chosen, blocks)
    names = ("without network", "with network")
    epochs: dict[str, Any] = {
        "best_epoch": 0,
        "n_epochs": 0,
        "validation_loss": None,
        "validation_mae_scaled": linear_mae,
    }
    if predicting is not None:
        _check_torch_matches_definition(network, predicting.data)
        best, last = predicting.progress.best, predicting.progress.epochs[-1]
        epochs = {"best_epoch": best.epoch, "n_epochs": last.epoch, "validation_loss": best.validation_loss}
        epochs["validation_mae_scaled"] = best.validation_mae
    metrics = {
        **epochs,
        **chosen.random_part.metrics(),
        "validation_mae_scaled_lattice": linear_mae,
        "linear_model": report,
        "renderings": {
            name: {**candidate.random_part.metrics(), "closed_loop_training": candidate.closed_loop}
            for name, candidate in zip(names, candidates, strict=False)
        },
        "recorded_peak_sd": blocks.peak_sd,
    }
    tensors = {**model.tensors, **tensors_of(network, "network."), **chosen.network}
    tensors |= chosen.random_part.excitation.tensors()
    return builder.texture(model.sizes, tensors, metrics).texture


def _fitted(
    network: InnovationNetwork,
    model: LinearModel,
    data: Innovations,
    blocks: ScaledBlocks,
    config: TrainConfig,
    monitor: Monitor,
    name: str,
) -> FittedNetwork:
    warm_up, validation = model.sizes.window, blocks.split.validation
    progress = fit_innovation_network(network, data, blocks, warm_up, config, monitor, name)
    tensors = data.tensors(next(network.parameters()).device)
    nll, _, gain = scored(network, data, tensors, validation, warm_up)
    moving = blocks.moving()[list(validation), data.first + 1 + warm_up :]
    metric = float((nll + np.log(gain))[moving].mean()) if moving.any() else None
    return FittedNetwork(model, network, data, progress, float(nll.mean()), metric)


def _train_in_closed_loop(
    network: InnovationNetwork,
    drawing: FittedNetwork,
    model: LinearModel,
    innovation_limit: float,
    blocks: ScaledBlocks,
    config: TrainConfig,
    monitor: Monitor,
) -> dict[str, float] | None:
    """Validation loss before and after; None where blocks are too short for it."""
    excerpts = excerpts_of(blocks, model, drawing.data, innovation_limit)
    if excerpts is None:
        return None
    progress = fit_closed_loop(network, excerpts, model.sizes.window, config, monitor)
    drawing.progress.include(progress)
    return {"before": progress.epochs[0].validation_loss, "after": progress.best_loss}


def _closed_loop(model: LinearModel, builder: TextureBuilder, weights: Tensors) -> ClosedLoop:
    kernel = partial(builder.kernel, model.sizes, {**model.tensors, **weights})
    history, block = model.sizes.history, builder.blocks.trace.block
    return ClosedLoop(builder.blocks, history, kernel, model.power, model.response(block - history))


def _first(model: LinearModel) -> int:
    """The first sample of a block whose innovation is known well."""
    return model.sizes.history - model.sizes.window


def _residuals(model: LinearModel, blocks: ScaledBlocks) -> Residuals:
    """What a linear model leaves of what a rendering excites."""
    _, e, gain = model.innovations(blocks, residual=True)
    train, validation = blocks.targets(model.sizes.history)
    n = np.concatenate([train, validation])
    return Residuals(blocks.flat[n - 1, 1:], e.ravel()[n], gain.ravel()[n], len(train), blocks.moving().ravel()[n])


def _linear_mae(excited_linear: Candidate, blocks: ScaledBlocks) -> float:
    """One-step validation error of the lattice alone, scaled."""
    _, e, gain = excited_linear.model.innovations(blocks)
    first = _first(excited_linear.model) + 1 + excited_linear.model.sizes.window
    return float(np.abs((e * gain)[list(blocks.split.validation), first:]).mean())


def _innovation_limit(data: Innovations, blocks: ScaledBlocks) -> tuple[float, float]:
    """The largest innovations that a network may draw: in units of σ, and in scaled acceleration."""
    train = list(blocks.split.train)
    recorded = (part[train, data.first + 1 :] for part in (data.innovation, data.innovation * data.innovation_gain))
    in_sigma, in_acceleration = (INNOVATION_HEADROOM * float(np.abs(values).max()) for values in recorded)
    return in_sigma, in_acceleration


def _check_torch_matches_definition(network: InnovationNetwork, data: Innovations) -> None:
    """Check that the network in PyTorch and its definition expect the same, in float64."""
    inputs = data.inputs[:2, data.first : data.first + 16]
    definition = ReferenceNetwork(tensors_of(network, "network."), "network.")
    hidden = np.zeros((len(inputs), network.recurrent.hidden_size))
    for i in range(inputs.shape[1]):
        hidden = definition.push(hidden, inputs[:, i])
    with torch.no_grad():
        ours = copy.deepcopy(network).cpu().double().expected(torch.from_numpy(inputs))[:, -1].numpy()
    assert np.abs(ours - definition.mixture(hidden, inputs[:, -1]).expected()).max() < 1e-9


def extrapolation_exponents(blocks: ScaledBlocks) -> dict[str, float]:
    """Powers of speed and force that the level grows with, from the faster and the firmer half of the training blocks.

    Levels in frames, least squares over their logarithms. 0, which holds the level, where there are fewer than 20 frames, speed
    or force varies by less than a factor of 1.2 in them, or the level falls.
    """
    rate = blocks.trace.rate_hz
    if blocks.trace.block < FRAME_MS * rate / 1000:
        return {"speed": 0.0, "force": 0.0}
    acceleration, *condition = np.moveaxis(blocks.training_blocks(), 2, 0)
    levels = frame_levels(acceleration, rate, float(np.sqrt(np.square(acceleration).mean()))).ravel()
    speed, force = (frame_means(channel, rate).ravel() for channel in condition)
    logs = np.log10(np.maximum(np.stack([speed, force]), [[FADE_SPEED], [FADE_FORCE]]))
    exponents = {}
    for row, name in enumerate(("speed", "force")):
        upper = logs[row] >= np.median(logs[row])
        design = np.stack([np.ones(upper.sum()), *logs[:, upper]], axis=1)
        varied = upper.sum() >= 20 and np.ptp(np.percentile(logs[row, upper], [10, 90])) >= math.log10(1.2)
        slope = np.linalg.lstsq(design, levels[upper], rcond=None)[0][1 + row] if varied else 0.0
        exponents[name] = float(np.clip(slope / 20, 0.0, MAX_EXPONENT))
    return exponents
