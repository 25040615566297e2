"""foten-plus: the linear part and its excitation first, which make a texture; then its networks, where they gain.

The network that predicts is fitted by likelihood. The network that a rendering draws from, where one is in the loop, begins as
that, or as one that is given the phase of a surface that repeats, and is trained on its own output.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from foten.dsp.level import FRAME_MS, frame_levels, frame_means
from foten.models.conditions import FADE_FORCE, FADE_SPEED
from foten.models.excitation import Scale as LevelOf
from foten.models.foten_plus.closed_loop_training import JUDGED_EVERY, N_STEPS, OwnOutput, excerpts_of, fit_own_output
from foten.models.foten_plus.innovation_network import InnovationNetwork as Reference
from foten.models.foten_plus.likelihood import (
    Batches,
    Innovations,
    fit_innovations,
    innovations_of,
    mixtures,
    scored,
    validated,
)
from foten.models.foten_plus.linear_model import LinearPart, fit_linear_parts, phase_alone
from foten.models.foten_plus.network import InnovationNetwork, negative_log_likelihood
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import Texture
from foten.training.blocks import ScaledBlocks
from foten.training.calibration import ClosedLoop
from foten.training.config import TrainConfig
from foten.training.excitation_fit import FittedExcitation, fit_excitation, settle_gain
from foten.training.job import Stage, Task, TrainingJob
from foten.training.loop import Epoch, Progress
from foten.training.texture_builder import N_GOLDEN, Draft, Tensors, tensors_of
from foten.training.window_fit import TrainingWindows, pick_device

LEAST_GAIN_NAT = 0.005  # of an innovation's likelihood on the validation blocks, for a network to be in the loop
LARGEST_BEYOND = 1.3  # times the largest recorded innovation is the largest that a network may draw
TONES_MAY_DISTORT = 1.05  # times the log-spectral distance without them, on the validation blocks


@dataclass(frozen=True)
class Rendering:
    """A linear part with an excitation, or one whose network is in the loop."""

    part: LinearPart
    fitted: FittedExcitation


@dataclass(kw_only=True)
class FotenPlusTask(Task):
    """The networks of a texture that is playable without them: as `plain` is, one of the linear parts that were tried."""

    # By what their tensors' names begin with: the one that predicts and, where a surface repeats, one that is given its phase.
    networks: dict[str, InnovationNetwork]
    innovations: dict[str, Innovations]  # of each
    draft: Draft
    plain: Rendering
    phased: LinearPart | None  # what a rendering goes by whose network is given the phase
    tried: dict[str, Any]

    def __post_init__(self) -> None:
        weights = tensors_of(self.networks["network"], "network.")
        epochs: dict[str, float | None] = {"best_epoch": 0, "n_epochs": 0, "validation_loss": None}
        self.playable = self._texture(self.plain, weights, self.linear_mae, {}, **epochs)

    def fit(self, on_epoch: Callable[[Epoch], None], checkpoint: Path | None, resume: bool) -> Progress:
        """Fit the networks."""
        warm_up, config = self.plain.part.sizes.window, self.job.config
        networks = list(self.networks.values())
        data = list(self.innovations.values())
        return fit_innovations(networks, data, self.blocks, warm_up, config, on_epoch, checkpoint, resume)

    def finish(self, progress: Progress, on_stage: Stage) -> Texture:
        """Return the texture with the networks that were fitted, one of them in the loop where its innovations are likelier."""
        best, chosen = progress.best, self.plain
        renderings: dict[str, Any] = {"without network": self.plain.fitted.metrics()}
        name, part, likelihood = self._drawing()
        before, weights = self.plain.fitted.likelihood_in_units, tensors_of(self.networks["network"], "network.")
        if best.epoch and before - likelihood >= LEAST_GAIN_NAT:
            drawing, of = copy.deepcopy(self.networks[name]), self.innovations[name]
            part = replace(part, sizes=replace(part.sizes, network_in_loop=True))
            nll, largest = self._nll(drawing, of), self._largest(of)
            own = None
            if self.job.config.own_output and not progress.interrupted:
                own = self._on_own_output(drawing, of, part, largest[0], on_stage)
                progress.interrupted = own is not None and own.interrupted
            settled = own is not None and own.gained
            if not settled:
                on_stage("settling the level with the network in the loop")
            weights |= tensors_of(drawing, "rendering_network.")
            loop = _loop(part, self.draft, weights)
            fitted = settle_gain(part.sizes.excitation_width, largest, loop, self.job.config, nll, settled)
            chosen = Rendering(part, fitted)
            renderings["with network"] = {**fitted.metrics(), "own_output": own and asdict(own)}
        on_stage("proving the texture file")
        _check_twin(self.networks["network"], weights, self.innovations["network"])
        epochs = {
            "best_epoch": best.epoch,
            "n_epochs": progress.epochs[-1].epoch,
            "validation_loss": best.validation_loss,
        }
        return self._texture(chosen, weights, best.validation_mae, renderings, **epochs)

    def _drawing(self) -> tuple[str, LinearPart, float]:
        """Return the network that a rendering may begin to draw from, what it goes by, and its likelihood [nat, of innovations].

        Where tones are in the rendering anyway, that of what they leave; else the one that knows the phase where it is likelier.
        """
        plain, _ = self._validated("network")
        if self.phased is None:
            return "network", self.plain.part, plain
        likelihood, _ = self._validated("rendering_network")
        if self.plain.part.phase is None and plain - likelihood < LEAST_GAIN_NAT:
            return "network", self.plain.part, plain
        return "rendering_network", self.phased, likelihood

    def _validated(self, name: str) -> tuple[float, float]:
        """Return a network's likelihood [nat, of innovations] and error on the validation blocks."""
        network, of = self.networks[name], self.innovations[name]
        tensors = of.tensors(next(network.parameters()).device)
        return validated(network, of, tensors, self.blocks.split.validation, self.plain.part.sizes.window)

    def _largest(self, of: Innovations) -> list[float]:
        """Return the largest innovations that a network may draw: in units of σ, and in scaled acceleration."""
        train = list(self.blocks.split.train)
        known = (one[train, of.first + 1 :] for one in (of.innovation, of.innovation * of.unit))
        return [LARGEST_BEYOND * float(np.abs(values).max()) for values in known]

    def _nll(self, network: InnovationNetwork, of: Innovations) -> float | None:
        """Return a network's negative log-likelihood of the validation blocks [nat], as the judge counts it."""
        numbers, window = self.blocks.split.validation, self.plain.part.sizes.window
        tensors = of.tensors(next(network.parameters()).device)
        nats, _, unit = scored(network, of, tensors, numbers, window)
        counted = self.blocks.moving()[list(numbers), of.first + 1 + window :]
        return float((nats + np.log(unit))[counted].mean()) if counted.any() else None

    def _on_own_output(
        self, network: InnovationNetwork, of: Innovations, part: LinearPart, largest: float, on_stage: Stage
    ) -> OwnOutput | None:
        """Train a network in place on its own output; None where blocks are too short for it."""
        excerpts = excerpts_of(self.blocks, part, of, largest)
        if excerpts is None:
            return None
        window, config = part.sizes.window, self.job.config
        batches = Batches(of, self.blocks, window, config, next(network.parameters()).device)

        def likelihood(one: InnovationNetwork, rng: np.random.Generator) -> Tensor:
            inputs, follows = batches.draw(rng)
            return negative_log_likelihood(mixtures(one, inputs), follows)[:, window:].mean()

        n_steps = min(N_STEPS, JUDGED_EVERY * config.epochs)

        def on_step(step: int) -> None:
            if step % (n_steps // 4) == 0:
                on_stage(f"training the network on its own output: {100 * step // n_steps} %")

        return fit_own_output(network, excerpts, likelihood, n_steps, config.seed, on_step)

    def _texture(
        self, chosen: Rendering, weights: Tensors, mae: float | None, renderings: dict[str, Any], **epochs: float | None
    ) -> Texture:
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
    """Return the linear part with its excitation as a texture, and what its networks are to be fitted to."""
    assert isinstance(job.sizes, FotenPlusSizes)
    blocks, window = job.blocks(), job.sizes.window
    check_block(blocks, window)
    _check_frame(blocks, window, job.config.max_order)
    torch.manual_seed(job.config.seed)
    parts = fit_linear_parts(job.sizes, blocks, job.config, on_stage)
    device = pick_device()
    networks = {"network": InnovationNetwork(job.sizes)}
    card = {**job.card(blocks, device.type), "beyond_exponents": _beyond_exponents(blocks)}
    draft = Draft(job.model, blocks, card)
    on_stage("fitting the excitation and settling its level in the closed loop")
    weights = tensors_of(networks["network"], "network.")
    plain, tried = _chosen([_rendering(part, weights, draft, job.config) for part in parts])
    phased = plain.part if plain.part.phase is not None else None if len(parts) == 1 else phase_alone(*parts)
    first = plain.part.sizes.history - window
    innovations = {"network": _innovations(plain.part, blocks, first, plain.part.phase is None)}
    if phased is not None:
        networks["rendering_network"] = InnovationNetwork(job.sizes, phased.sizes.n_rendering_inputs)
        innovations["rendering_network"] = _innovations(phased, blocks, first, False, residual=True)
    of, validation = innovations["network"], list(blocks.split.validation)
    scored = (slice(None), slice(first + 1 + window, None))
    missed = (of.innovation * of.unit)[validation][scored]
    return FotenPlusTask(
        job=job,
        blocks=blocks,
        linear_mae=float(np.abs(missed).mean()),
        networks={name: network.to(device) for name, network in networks.items()},
        innovations=innovations,
        draft=draft,
        plain=plain,
        phased=phased,
        tried=tried,
    )


def _rendering(part: LinearPart, weights: Tensors, draft: Draft, config: TrainConfig) -> Rendering:
    """Return a linear part with an excitation."""
    windows = _windows(part, draft.blocks)
    innovations = windows.samples[np.concatenate([windows.train, windows.validation]), 3]
    loop = _loop(part, draft, weights)
    return Rendering(part, fit_excitation(part.sizes.excitation_width, innovations, windows, loop, config))


def _loop(part: LinearPart, draft: Draft, weights: Tensors) -> ClosedLoop:
    kernel = partial(draft.kernel, part.sizes, {**part.tensors, **weights})
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


def _windows(part: LinearPart, blocks: ScaledBlocks) -> TrainingWindows:
    """Return windows of x, speed, force and e, and as targets the innovations of what a rendering excites."""
    x, e, unit = part.innovations(blocks, residual=True)
    samples = np.concatenate([x[..., None], blocks.samples[..., 1:], e[..., None]], axis=2)
    indices = blocks.targets(part.sizes.history)
    return TrainingWindows(samples.reshape(-1, 4), *indices, part.sizes.window, e.ravel(), unit.ravel())


def _innovations(
    part: LinearPart, blocks: ScaledBlocks, first: int, mirrored: bool, residual: bool = False
) -> Innovations:
    """Return what a network is fitted to."""
    level = part.excited_lattice.level if residual else LevelOf(part.tensors, "lattice.level.")
    phase = part.phase if residual else None
    return innovations_of(blocks, level, *part.innovations(blocks, residual), first, mirrored, phase)


def _check_twin(network: InnovationNetwork, weights: Tensors, of: Innovations) -> None:
    """Check that the network in PyTorch and its reference expect the same, in float64."""
    some = of.inputs[:2, of.first : of.first + 16]
    reference, hidden = Reference(weights, "network."), np.zeros((len(some), network.recurrent.hidden_size))
    for i in range(some.shape[1]):
        hidden = reference.push(hidden, some[:, i])
    with torch.no_grad():
        ours = copy.deepcopy(network).cpu().double().expected(torch.from_numpy(some))[:, -1].numpy()
    assert np.abs(ours - reference.mixture(hidden, some[:, -1]).expected()).max() < 1e-9


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
