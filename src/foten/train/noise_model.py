"""Models of spectra, whose samples are filtered noise: dftnet and gan."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import nn

from foten.families.texture_file import Texture
from foten.networks import build
from foten.networks.dftnet import Dftnet
from foten.networks.gan import Gan
from foten.train.adversarial import fit_adversarial
from foten.train.blocks import ScaledBlocks
from foten.train.epochs import Epoch, Progress
from foten.train.export import N_GOLDEN, Draft, multiply_adds
from foten.train.fit import TrainingWindows, pick_device
from foten.train.foten_plus import check_block
from foten.train.job import NetworkTask, Stage, TrainingJob
from foten.train.one_step import network_tensors
from foten.train.targets import log_spectra

NAT_DB = 20 / math.log(10)


@dataclass(kw_only=True)
class NoiseModelTask(NetworkTask):
    """A model of spectra.

    Attributes:
        renderer: what makes samples of noise; the network is a part of it.
    """

    renderer: nn.Module

    def finish(self, progress: Progress, on_stage: Stage) -> Texture:
        """Return the texture."""
        job, best = self.job, progress.best
        device = next(self.network.parameters()).device.type
        tensors, network = network_tensors(self.renderer, job)
        metrics = {
            "validation_loss": best.validation_loss,
            "validation_mae_scaled": None,
            "validation_spectrum_db": NAT_DB * best.validation_mae,
            "recorded_peak_sd": self.blocks.peak_sd,
            "best_epoch": best.epoch,
            "n_epochs": progress.epochs[-1].epoch,
            "multiply_adds": multiply_adds(self.renderer, job.sizes.window),
        }
        on_stage("proving the texture file")
        draft = Draft(job.model, self.blocks, job.card(self.blocks, device), network)
        return draft.texture(job.sizes, tensors, metrics, N_GOLDEN).texture


class AdversarialTask(NoiseModelTask):
    """A generator, which a discriminator fits."""

    def fit(self, on_epoch: Callable[[Epoch], None], checkpoint: Path | None, resume: bool) -> Progress:
        """Train the generator in place."""
        assert isinstance(self.network, Gan)
        m, config = self.job.sizes.window, self.job.config
        return fit_adversarial(self.network, m, self.blocks, config, on_epoch, checkpoint, resume)


def prepare_dftnet(job: TrainingJob, on_stage: Stage) -> NoiseModelTask:
    """Return the network of spectra and the frames that it is to be fitted to."""
    blocks, windows = _windows(job)
    network = build(job.model, job.sizes).to(pick_device())
    assert isinstance(network, Dftnet)
    spectra = log_spectra(windows, blocks)
    return NoiseModelTask(job=job, blocks=blocks, network=network.spectrum, windows=spectra, renderer=network)


def prepare_gan(job: TrainingJob, on_stage: Stage) -> AdversarialTask:
    """Return the generator, on the CPU."""
    blocks, windows = _windows(job)
    network = build(job.model, job.sizes)
    return AdversarialTask(job=job, blocks=blocks, network=network, windows=windows, renderer=network)


def _windows(job: TrainingJob) -> tuple[ScaledBlocks, TrainingWindows]:
    blocks, m = job.blocks(), job.sizes.window
    check_block(blocks, m)
    torch.manual_seed(job.config.seed)
    return blocks, TrainingWindows(blocks.flat, *blocks.targets(m), m)
