"""foten-plus: the linear part and its excitation first, which make a texture; then the network, where it gains."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch

from foten.dsp.level import FRAME_MS, frame_levels, frame_means
from foten.families.conditions import FADE_FORCE, FADE_SPEED
from foten.families.foten_plus import FotenPlusSizes
from foten.families.texture_file import Texture
from foten.networks.foten_plus import Corrector
from foten.reference.network import Network
from foten.train.blocks import ScaledBlocks
from foten.train.closed_loop import ClosedLoop
from foten.train.config import TrainConfig
from foten.train.epochs import Progress
from foten.train.excitation import FittedExcitation, fit_excitation
from foten.train.export import N_GOLDEN, Draft, Tensors, in_float64, tensors_of
from foten.train.fit import TrainingWindows, pick_device, predict
from foten.train.job import NetworkTask, Stage, TrainingJob
from foten.train.linear_part import LinearPart, fit_linear_parts

NETWORK_IS_NEARER = 0.98  # times the free run's distance without it
NETWORK_MAY_BE_NEARER = 1.25  # times that before its level is settled, which moved it by up to a fifth
LEAST_GAIN = 0.002  # of the one-step error, for the network to be tried in the loop
TONES_MAY_DISTORT = 1.05  # times the log-spectral distance without them, on the validation blocks


@dataclass(frozen=True)
class Rendering:
    """A linear part with an excitation: that of what the network leaves, where the part has it in the loop."""

    part: LinearPart
    fitted: FittedExcitation


@dataclass(kw_only=True)
class FotenPlusTask(NetworkTask):
    """The network of a texture that is playable without it: as `plain` is, one of the linear parts that were tried."""

    linear_mae: float
    network: Corrector
    draft: Draft
    plain: Rendering
    tried: dict[str, Any]

    def __post_init__(self) -> None:
        self.playable = self._texture(self.plain, self.linear_mae, {}, best_epoch=0, n_epochs=0, validation_loss=None)

    def finish(self, progress: Progress, on_stage: Stage) -> Texture:
        """Return the texture with the network that was fitted, in the loop where the free run is nearer so."""
        best, chosen = progress.best, self.plain
        renderings = {"without network": list(self.plain.fitted.distance)}
        gained = 1 - best.validation_mae / self.linear_mae
        if best.epoch and gained >= LEAST_GAIN and self.plain.part.phase is None:
            on_stage("rendering with the network in the loop")
            rendering = self._with_network()
            if rendering is not None:
                renderings["with network"] = list(rendering.fitted.distance)
                if rendering.fitted.nearness < NETWORK_IS_NEARER * self.plain.fitted.nearness:
                    chosen = rendering
        on_stage("proving the texture file")
        epochs = {"best_epoch": best.epoch, "n_epochs": progress.epochs[-1].epoch}
        return self._texture(chosen, best.validation_mae, renderings, validation_loss=best.validation_loss, **epochs)

    def _with_network(self) -> Rendering | None:
        """Return a rendering with the network in the loop, or None where it is far from any use."""
        both = np.concatenate([self.windows.train, self.windows.validation])
        left = self.windows.samples[both, 3] - predict(self.network, self.windows, both)
        part = replace(self.plain.part, sizes=replace(self.plain.part.sizes, network_in_loop=True))
        useless_from = NETWORK_MAY_BE_NEARER * self.plain.fitted.nearness
        loop, width = _loop(part, self.draft, self.network), part.sizes.excitation_width
        fitted = fit_excitation(width, left, self.windows, loop, self.job.config, useless_from)
        return None if fitted is None else Rendering(part, fitted)

    def _texture(self, chosen: Rendering, mae: float, renderings: dict[str, Any], **epochs: float | None) -> Texture:
        network = self.network
        weights = tensors_of(network, "network.")
        _check_twin(network, chosen.part.sizes, weights, self.windows)
        metrics = {
            **epochs,
            **chosen.fitted.metrics(),
            "validation_mae_scaled": mae,
            "validation_mae_scaled_lattice": self.linear_mae,
            "linear_part": self.tried,
            "renderings": renderings,
            "recorded_peak_sd": self.blocks.peak_sd,
        }
        tensors = {**chosen.part.tensors, **weights, **tensors_of(chosen.fitted.excitation, "excitation.")}
        return self.draft.texture(chosen.part.sizes, tensors, metrics, N_GOLDEN).texture


def prepare_foten_plus(job: TrainingJob, on_stage: Stage) -> FotenPlusTask:
    """Return the linear part with its excitation as a texture, and the windows that a network is to be fitted to."""
    assert isinstance(job.sizes, FotenPlusSizes)
    blocks = job.blocks()
    check_block(blocks, job.sizes.window)
    _check_frame(blocks, job.sizes.window, job.config.max_order)
    torch.manual_seed(job.config.seed)
    parts = fit_linear_parts(job.sizes, blocks, job.config, on_stage)
    device, network = pick_device(), Corrector(job.sizes)
    card = {**job.card(blocks, device.type), "beyond_exponents": _beyond_exponents(blocks)}
    draft = Draft(job.model, blocks, card)
    on_stage("fitting the excitation and settling its level in the closed loop")
    plain, tried = _chosen([_rendering(part, network, draft, job.config) for part in parts])
    windows = _innovations(plain.part, blocks)
    n, unit = windows.validation, windows.unit
    assert unit is not None
    return FotenPlusTask(
        job=job,
        blocks=blocks,
        linear_mae=float(np.abs(windows.samples[n, 3] * unit[n]).mean()),
        network=network.to(device),
        windows=windows,
        draft=draft,
        plain=plain,
        tried=tried,
    )


def _rendering(part: LinearPart, network: Corrector, draft: Draft, config: TrainConfig) -> Rendering:
    """Return a linear part with an excitation."""
    windows = _innovations(part, draft.blocks, residual=True)
    innovations = windows.samples[np.concatenate([windows.train, windows.validation]), 3]
    loop = _loop(part, draft, network)
    fitted = fit_excitation(part.sizes.excitation_width, innovations, windows, loop, config)
    assert fitted is not None
    return Rendering(part, fitted)


def _loop(part: LinearPart, draft: Draft, network: Corrector) -> ClosedLoop:
    kernel = partial(draft.kernel, part.sizes, {**part.tensors, **tensors_of(network, "network.")})
    history, block = part.sizes.history, draft.blocks.trace.block
    return ClosedLoop(draft.blocks, history, kernel, part.power, part.response(block - history))


def _chosen(renderings: list[Rendering]) -> tuple[Rendering, dict[str, Any]]:
    """Return the rendering whose free run is nearest, and what was tried.

    Tones that change the spectrum are none of the surface's, whatever the level.
    """

    def report(one: Rendering) -> dict[str, Any]:
        return {**one.part.tried, "free_run": dict(zip(("lsd_db", "level_error_db"), one.fitted.distance, strict=True))}

    allowed = TONES_MAY_DISTORT * renderings[0].fitted.distance[0]
    best = min(
        (one for one in renderings if one is renderings[0] or one.fitted.distance[0] <= allowed),
        key=lambda one: one.fitted.nearness,
    )
    rejected = [report(one) for one in renderings if one is not best]
    return best, {**report(best), **({"rejected": rejected} if rejected else {})}


def _innovations(part: LinearPart, blocks: ScaledBlocks, residual: bool = False) -> TrainingWindows:
    """Return windows of x, speed, force and e, and as targets the lattice's innovations, or those of what the tones leave."""
    x, e, unit = part.innovations(blocks, residual)
    samples = np.concatenate([x[..., None], blocks.samples[..., 1:], e[..., None]], axis=2)
    indices = blocks.targets(part.sizes.history)
    return TrainingWindows(samples.reshape(-1, 4), *indices, part.sizes.window, e.ravel(), unit.ravel())


def _check_twin(network: Corrector, sizes: FotenPlusSizes, weights: Tensors, windows: TrainingWindows) -> None:
    """Check that the network in PyTorch and its reference give the same, in float64."""
    n = windows.validation[:: max(1, len(windows.validation) // 8)]
    some = windows.samples[n[:, None] + np.arange(-windows.window, 0)]
    ours = in_float64(network)(some)
    limit = sizes.correction_limit
    reference = limit * np.tanh(Network(sizes, weights, "network.")(some) / limit)
    assert np.abs(ours - reference).max() < 1e-9


def check_block(blocks: ScaledBlocks, m: int) -> None:
    """Refuse blocks that are too short to hold enough windows."""
    block = blocks.trace.block
    if block < 5 * m:
        raise ValueError(
            f"a block of {block} samples is too short for windows of {m}, expected five times as long: "
            "use a longer --block or a shorter --window"
        )


def _check_frame(blocks: ScaledBlocks, m: int, max_order: int) -> None:
    """Refuse blocks that hold no frame after their first fifth and the longest history, for the level to be settled on."""
    rate, block = blocks.trace.rate_hz, blocks.trace.block
    frame, history = FRAME_MS * rate / 1000, m + 1 + min(max_order, block // 8)
    if block - max(0.2 * block, history) >= frame:
        return
    enough = max(frame / 0.8, (frame + m + 1) / (1 - 1 / 8))
    raise ValueError(
        f"a block of {1000 * block / rate:g} ms holds no frame of {FRAME_MS:g} ms after its first {history} samples, and "
        f"the level could not be settled: use a --block of {math.ceil(1000 * enough / rate)} ms or more"
    )


def _beyond_exponents(blocks: ScaledBlocks) -> dict[str, float]:
    """Return the powers of speed and force that the level grows with, from the faster and the firmer half of the training blocks.

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
        exponents[name] = float(np.clip(slope / 20, 0.0, 1.5))
    return exponents
