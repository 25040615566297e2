"""Textures of a recording's tensors: card, warm start and golden windows of its blocks."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import nn

from foten.dsp import Array
from foten.models.excitation import Excitation
from foten.models.model_sizes import ModelSizes
from foten.models.texture_file import MIN_GOLDEN
from foten.recording.windows import windows
from foten.runtime.native import NativeTexture
from foten.runtime.proof import MakeModel, ProvedTexture, Tensors, proved
from foten.training.job import ScaledBlocks

WARM_START = (45.0, 0.8)  # mm/s, N: mean of early contacts; Sec. V-a
N_GOLDEN = 12  # windows of the validation blocks
NEAR_SHARE = 100  # of so many training windows one is near enough to begin from
WARM_START_RINGS_MS = 20.0  # the end of a window, which rings on into what comes after


@dataclass(frozen=True)
class TextureBuilder:
    """Everything of a texture but sizes, tensors and metrics."""

    model: str
    blocks: ScaledBlocks
    card: dict[str, Any]  # entries beyond model, sizes and scaling
    definition: MakeModel

    def kernel(self, sizes: ModelSizes, tensors: Tensors, excitation: Excitation) -> NativeTexture:
        """The kernel of a texture with an excitation that is being fitted."""
        metrics = {"validation_mae_scaled": 0.0}
        return self.texture(sizes, {**tensors, **excitation.tensors()}, metrics, MIN_GOLDEN).kernel

    def texture(
        self, sizes: ModelSizes, tensors: Tensors, metrics: dict[str, Any], n_golden: int = N_GOLDEN
    ) -> ProvedTexture:
        """A texture of tensors, as `proved` makes it."""
        m, blocks = sizes.history, self.blocks
        window, condition = pick_warm_start(blocks, m)
        _, ends = blocks.targets(m)
        golden = windows(blocks.flat, ends[np.linspace(0, len(ends) - 1, n_golden - 2).astype(int)], m)
        card = {**self.card, "warm_start": condition, "metrics": metrics}
        return proved(self.model, sizes, tensors, blocks.scaling, golden, window, card, self.definition)


def pick_warm_start(blocks: ScaledBlocks, m: int) -> tuple[Array, dict[str, Any]]:
    """A recorded training window near 45 mm/s and 0.8 N, scaled, (m, 3), and its condition.

    Of the nearest hundredth of the training windows, in training standard deviations, the one whose last 20 ms have the median
    power.

    Source: Sec. V-a. Differs from the paper: it synthesises the window without saying from what; ours is recorded.
    """
    trace = blocks.trace
    ends, _ = blocks.targets(m)
    condition = np.stack([trace.speed, trace.force], axis=1)[ends - 1]
    distance = np.hypot(*((condition - WARM_START) / blocks.scaling.sd[1:]).T)
    near = np.argsort(distance, kind="stable")[: max(1, len(ends) // NEAR_SHARE)]
    candidates = windows(blocks.flat, ends[near], m)
    n_last = min(m, max(1, round(WARM_START_RINGS_MS * trace.rate_hz / 1000)))
    power = np.square(candidates[:, -n_last:, 0]).mean(axis=1)
    chosen = np.argsort(power, kind="stable")[(len(near) - 1) // 2]
    return candidates[chosen], warm_start_entry(condition[near[chosen]])


def warm_start_entry(recorded: Array) -> dict[str, dict[str, float]]:
    """The card's entry of a warm start under a speed [mm/s] and a force [N], (2,)."""
    channels = ("speed", "force")
    return {
        "asked": dict(zip(channels, WARM_START, strict=True)),
        "recorded": dict(zip(channels, recorded.tolist(), strict=True)),
    }


def tensors_of(module: nn.Module, prefix: str = "") -> Tensors:
    """A module's parameters and buffers by name, copied."""
    return {f"{prefix}{name}": t.detach().cpu().numpy().copy() for name, t in module.state_dict().items()}
