"""Networks that predict from windows as they are, without a linear model: fitted, given an excitation, made a texture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from torch import nn

from foten.dsp import Array
from foten.models.excitation import WithExcitation
from foten.models.model_sizes import ModelSizes
from foten.training.blocks import ScaledBlocks
from foten.training.calibration import ClosedLoop, Residuals, calibrate_excitation
from foten.training.job import Trained, TrainingJob
from foten.training.loop import Monitor, Progress
from foten.training.texture_builder import Definition, Tensors, TextureBuilder, model_of
from foten.training.window_fit import TrainingWindows, fit_windows, predict


@dataclass(frozen=True)
class Packed:
    """A network as its texture file holds it."""

    sizes: ModelSizes
    tensors: Tensors
    definition: Definition = model_of
    metrics: dict[str, Any] = field(default_factory=dict)


def one_step_windows(blocks: ScaledBlocks, m: int) -> TrainingWindows:
    """Windows of m samples, whose targets are the accelerations that follow."""
    return TrainingWindows(blocks.flat, *blocks.targets(m), m)


def fit_one_step(
    job: TrainingJob,
    blocks: ScaledBlocks,
    network: nn.Module,
    windows: TrainingWindows,
    pack: Callable[[nn.Module], Packed],
    monitor: Monitor,
) -> Trained:
    """A texture of a network that is trained in place on windows, with an excitation where one is asked for."""
    progress = fit_windows(network, windows, job.config, monitor)
    return one_step_texture(job, blocks, network, progress, pack(network), monitor)


def one_step_texture(
    job: TrainingJob, blocks: ScaledBlocks, network: nn.Module, progress: Progress, packed: Packed, monitor: Monitor
) -> Trained:
    """A texture of a trained network, with an excitation where one is asked for."""
    best, sizes, tensors = progress.best, packed.sizes, packed.tensors
    card = job.card(blocks, next(network.parameters()).device.type)
    builder = TextureBuilder(job.model, blocks, card, packed.definition)
    metrics: dict[str, Any] = {
        "validation_loss": best.validation_loss,
        "validation_mae_scaled": best.validation_mae,
        "recorded_peak_sd": blocks.peak_sd,
        "best_epoch": best.epoch,
        "n_epochs": progress.epochs[-1].epoch,
        **packed.metrics,
    }
    if isinstance(sizes, WithExcitation) and sizes.excitation:
        monitor.on_stage("fitting the excitation and calibrating its level in the closed loop")
        residuals = _residuals(blocks, network, sizes.window)
        loop = ClosedLoop(
            blocks, sizes.history, partial(builder.kernel, sizes, tensors), _unit_power, limit=blocks.saturation
        )
        calibrated = calibrate_excitation(sizes.excitation_width, residuals, loop, job.config.seed)
        metrics |= calibrated.metrics()
        tensors = {**tensors, **calibrated.excitation.tensors()}
    monitor.on_stage("proving the texture file")
    texture = builder.texture(sizes, tensors, metrics).texture
    return Trained(texture, blocks.trace, blocks.split, progress)


def _unit_power(condition: Array) -> tuple[Array, Array]:
    """What the network makes of the excitation is not known; where it is a filter, it is as loud in the same measure."""
    return np.ones(len(condition)), np.zeros(len(condition))


def _residuals(blocks: ScaledBlocks, network: nn.Module, m: int) -> Residuals:
    """What a network leaves of the acceleration."""
    windows = one_step_windows(blocks, m)
    n = np.concatenate([windows.train, windows.validation])
    residual = windows.samples[n, 0] - predict(network, windows, n)
    gain, moving = np.ones(len(n)), blocks.moving().ravel()[n]
    return Residuals(windows.samples[n - 1, 1:3], residual, gain, len(windows.train), moving)
