"""Networks that are fitted as they are, without a linear part: the paper's, its variants, and those it is compared with.

Most predict samples from windows; dftnet and gan are models of spectra, whose samples are filtered noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from foten.baselines.gan_fit import fit_adversarial
from foten.baselines.noise_filter import log_magnitudes
from foten.baselines.sizes import HapinfSizes
from foten.dsp import Array
from foten.models.foten_plus.fit import check_block
from foten.models.tensor_shapes import WithExcitation
from foten.models.texture_file import Texture
from foten.runtime.onnx_predictor import GRAPH, INPUT, NOISE
from foten.training.blocks import ScaledBlocks
from foten.training.calibration import ClosedLoop
from foten.training.config import TrainConfig
from foten.training.excitation_fit import fit_excitation
from foten.training.job import NetworkTask, Stage, TrainingJob
from foten.training.loop import Epoch, Progress
from foten.training.networks import build
from foten.training.texture_builder import N_GOLDEN, Draft, Tensors, graph_of, in_float64, multiply_adds, tensors_of
from foten.training.window_fit import TrainingWindows, fit, pick_device, predict

_AT_ONCE = 65536  # frames


@dataclass(kw_only=True)
class EndToEndTask(NetworkTask):
    """A network that is fitted to recorded samples, or to their spectra."""

    renderer: nn.Module  # what makes samples: the network, which in a model of spectra is a part of it

    def finish(self, progress: Progress, on_stage: Stage) -> Texture:
        """Return the texture, with an excitation where one was asked for."""
        job, sizes, best = self.job, self.job.sizes, progress.best
        card = job.card(self.blocks, next(self.network.parameters()).device.type)
        metrics: dict[str, Any] = {
            "validation_loss": best.validation_loss,
            "validation_mae_scaled": best.validation_mae,
            "recorded_peak_sd": self.blocks.peak_sd,
            "best_epoch": best.epoch,
            "n_epochs": progress.epochs[-1].epoch,
        }
        draft, tensors = Draft(job.model, self.blocks, card), tensors_of(self.renderer)
        if sizes.in_graph:  # the graph alone, which the network in float64 proves
            draft = replace(draft, network=in_float64(self.renderer))
            tensors = {GRAPH: graph_of(self.renderer, sizes.window, name=NOISE if sizes.from_noise else INPUT)}
            metrics["multiply_adds"] = multiply_adds(self.renderer, sizes.window)
        windows = TrainingWindows(self.blocks.flat, *self.blocks.targets(sizes.window), sizes.window)
        if sizes.from_noise:
            spectrum_db = 20 / math.log(10) * best.validation_mae  # of nats
            metrics |= {"validation_mae_scaled": None, "validation_spectrum_db": spectrum_db}
        if sizes.excited:
            on_stage("fitting the excitation and settling its level in the closed loop")
            both = np.concatenate([windows.train, windows.validation])
            missed = windows.samples[both, 0] - predict(self.network, windows, both)
            assert isinstance(sizes, WithExcitation)
            fitted = fit_excitation(sizes.excitation_width, missed, windows, self._loop(draft, tensors), job.config)
            metrics |= fitted.metrics()
            tensors |= tensors_of(fitted.excitation, "excitation.")
        on_stage("proving the texture file")
        return draft.texture(sizes, tensors, metrics, N_GOLDEN).texture

    def _loop(self, draft: Draft, tensors: Tensors) -> ClosedLoop:
        def power(condition: Array) -> tuple[Array, Array]:
            # What the network makes of the excitation is not known; where it is a filter, it is as loud in the same measure.
            return np.ones(len(condition)), np.zeros(len(condition))

        sizes = self.job.sizes
        kernel = partial(draft.kernel, sizes, tensors)
        return ClosedLoop(self.blocks, sizes.history, kernel, power, limit=self.blocks.saturation)


class AdversarialTask(EndToEndTask):
    """A generator, which a discriminator fits."""

    def fit(self, on_epoch: Callable[[Epoch], None], checkpoint: Path | None, resume: bool) -> Progress:
        """Train the generator in place."""
        m, config = self.job.sizes.window, self.job.config
        return fit_adversarial(self.network, m, self.blocks, config, on_epoch, checkpoint, resume)


def prepare_end_to_end(job: TrainingJob, on_stage: Stage) -> EndToEndTask:
    """Return a network, and the windows or frames that it is to be fitted to."""
    blocks, m = job.blocks(), job.sizes.window
    check_block(blocks, m)
    torch.manual_seed(job.config.seed)
    windows = TrainingWindows(blocks.flat, *blocks.targets(m), m)
    if job.model == "ldhtd":
        windows = distilled(windows, m, job.config, on_stage)
    network = renderer = build(job.model, job.sizes)
    if job.model == "gan":  # stays on the CPU
        return AdversarialTask(job=job, blocks=blocks, network=network, windows=windows, renderer=renderer)
    renderer.to(pick_device())
    if job.model == "dftnet":
        network, windows = renderer.spectrum, log_spectra(windows, blocks)
    return EndToEndTask(job=job, blocks=blocks, network=network, windows=windows, renderer=renderer)


def distilled(windows: TrainingWindows, m: int, config: TrainConfig, on_stage: Stage) -> TrainingWindows:
    """Return windows whose targets in training lie half-way to what a teacher predicts, those of validation as they were.

    The mean of the squared errors against the recording and against the teacher, 0.5 (y − s)² + 0.5 (t − s)², differs from the
    squared error against their mean by what s has no part in.
    """
    on_stage("training the teacher, hapinf")
    teacher = build("hapinf", HapinfSizes(window=m, n_start=min(10, m))).to(pick_device())
    if fit(teacher, windows, config).interrupted:
        raise KeyboardInterrupt  # of a half-distilled student nothing is kept
    target = windows.samples[:, 0].copy()
    target[windows.train] = 0.5 * (target[windows.train] + predict(teacher, windows, windows.train))
    return replace(windows, target=target)


def log_spectra(windows: TrainingWindows, blocks: ScaledBlocks) -> TrainingWindows:
    """Return windows whose targets are the log magnitudes of frames around every fourth sample or so, (n, m // 2 + 1), float32.

    A window ends before the middle of its frame.
    """
    m, block = windows.window, blocks.trace.block
    acceleration = torch.from_numpy(blocks.samples[..., 0]).float()
    target = np.zeros((len(windows.samples), m // 2 + 1), dtype=np.float32)
    framed = []
    for n in (windows.train, windows.validation):
        within = n % block
        framed.append(n[((within - m) % max(1, m // 25) == 0) & (within - m // 2 + m <= block)])
        for some in np.split(framed[-1], range(_AT_ONCE, len(framed[-1]), _AT_ONCE)):
            around = torch.from_numpy(some % block - m // 2)[:, None] + torch.arange(m)
            target[some] = log_magnitudes(acceleration[torch.from_numpy(some // block)[:, None], around]).numpy()
    return replace(windows, train=framed[0], validation=framed[1], target=target)
