"""Networks that predict samples from windows: the paper's, its variants, and those it is compared with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import nn

from foten.families.excitation import WithExcitation
from foten.families.texture_file import Texture
from foten.networks import build
from foten.networks.scale import Excitation
from foten.runtime.native import NativeTexture
from foten.runtime.onnx_predictor import GRAPH
from foten.train.closed_loop import ClosedLoop
from foten.train.epochs import Progress
from foten.train.excitation import fit_excitation
from foten.train.export import N_GOLDEN, Draft, Tensors, graph_of, in_float64, multiply_adds, tensors_of
from foten.train.fit import TrainingWindows, pick_device, predict
from foten.train.foten_plus import check_block
from foten.train.job import NetworkTask, Stage, TrainingJob
from foten.train.targets import distilled, multi_step


class OneStepTask(NetworkTask):
    """A network that is to be fitted to recorded samples."""

    def finish(self, progress: Progress, on_stage: Stage) -> Texture:
        """Return the texture, with an excitation where one was asked for."""
        job, sizes, best = self.job, self.job.sizes, progress.best
        device = next(self.network.parameters()).device.type
        windows = TrainingWindows(self.blocks.flat, *self.blocks.targets(sizes.window), sizes.window)
        metrics: dict[str, Any] = {
            "validation_loss": best.validation_loss,
            "validation_mae_scaled": best.validation_mae,
            "recorded_peak_sd": self.blocks.peak_sd,
            "best_epoch": best.epoch,
            "n_epochs": progress.epochs[-1].epoch,
        }
        if sizes.n_ahead > 1:
            n = windows.validation
            first = float(np.abs(predict(self.network, windows, n) - windows.samples[n, 0]).mean())
            metrics |= {"validation_mae_scaled": first, "validation_mae_scaled_hop": best.validation_mae}
        tensors, network = network_tensors(self.network, job)
        if sizes.in_graph:
            cost = multiply_adds(self.network, sizes.window) // sizes.n_ahead
            metrics["multiply_adds"] = cost
        draft = Draft(job.model, self.blocks, job.card(self.blocks, device), network)
        if sizes.excited:
            on_stage("fitting the excitation and settling its level in the closed loop")
            tensors |= self._excitation(draft, tensors, windows, metrics)
        on_stage("proving the texture file")
        return draft.texture(sizes, tensors, metrics, N_GOLDEN).texture

    def _excitation(self, draft: Draft, tensors: Tensors, windows: TrainingWindows, metrics: dict[str, Any]) -> Tensors:
        """Return the tensors of an excitation, that of foten-plus, and add to the metrics what came of it."""
        sizes, config = self.job.sizes, self.job.config
        assert isinstance(sizes, WithExcitation)

        def kernel(excitation: Excitation) -> NativeTexture:
            given = {**tensors, **tensors_of(excitation, "excitation.")}
            return draft.texture(sizes, given, {**metrics, "validation_mae_scaled": 0.0}).kernel

        # What the network makes of the excitation is not known; where it is a filter, it is as loud in the same measure.
        loop = ClosedLoop(
            self.blocks,
            sizes.history,
            kernel,
            lambda condition: (np.ones(len(condition)), np.zeros(len(condition))),
            limit=self.blocks.saturation,
        )
        both = np.concatenate([windows.train, windows.validation])
        missed = windows.samples[both, 0] - predict(self.network, windows, both)
        fitted = fit_excitation(sizes.excitation_width, missed, windows, loop, config)
        assert fitted is not None
        metrics |= fitted.metrics()
        return tensors_of(fitted.excitation, "excitation.")


def network_tensors(network: nn.Module, job: TrainingJob) -> tuple[Tensors, Callable[..., Any] | None]:
    """Return a network's tensors; of a graph the graph alone, and the network in float64, which proves it."""
    if not job.sizes.in_graph:
        return tensors_of(network), None
    return {GRAPH: graph_of(network, job.sizes.window)}, in_float64(network)


def prepare_one_step(job: TrainingJob, on_stage: Stage) -> OneStepTask:
    """Return a network and the windows that it is to be fitted to.

    Raises:
        ValueError: the recording does not fit the configuration; the message names the option.
    """
    blocks, m = job.blocks(), job.sizes.window
    check_block(blocks, m)
    torch.manual_seed(job.config.seed)
    windows = TrainingWindows(blocks.flat, *blocks.targets(m), m)
    if job.model == "ldhtd":
        windows = distilled(windows, m, job.config, on_stage)
    network = build(job.model, job.sizes).to(pick_device())
    if job.sizes.n_ahead > 1:
        windows = multi_step(windows, blocks, job.sizes.n_ahead)
    return OneStepTask(job=job, blocks=blocks, network=network, windows=windows)
