"""Textures of tensors, whose golden samples the definition makes and the kernel replays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import nn

from foten.dsp import Array
from foten.dsp.noise import gaussian
from foten.models.definitions import model_of
from foten.models.excitation import Excitation
from foten.models.model_sizes import ModelSizes
from foten.models.stream import Model, run
from foten.models.texture_file import FORMAT_VERSION, MIN_GOLDEN, Texture, texture_from_bytes
from foten.recording.scaling import Scaling
from foten.recording.windows import windows
from foten.runtime.native import NativeTexture
from foten.training.config import WARM_START
from foten.training.job import ScaledBlocks

Tensors = dict[str, NDArray[Any]]
MakeModel = Callable[[ModelSizes, Tensors], Model]

N_GOLDEN = 12  # windows of the validation blocks
NEAR_SHARE = 100  # of so many training windows one is near enough to begin from
WARM_START_RINGS_MS = 20.0  # the end of a window, which rings on into what comes after


@dataclass(frozen=True)
class ProvedTexture:
    """A texture, and the kernel that accepted its file."""

    texture: Texture
    kernel: NativeTexture


@dataclass(frozen=True)
class TextureBuilder:
    """Everything of a texture but sizes, tensors and metrics."""

    model: str
    blocks: ScaledBlocks
    card: dict[str, Any]  # entries beyond model, sizes and scaling
    definition: MakeModel = model_of

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


def proved(
    model: str,
    sizes: ModelSizes,
    tensors: Tensors,
    scaling: Scaling,
    golden: Array,
    warm_start: Array,
    card: dict[str, Any],
    definition: MakeModel = model_of,
) -> ProvedTexture:
    """A texture with golden samples, loaded into the kernel, which replays them.

    Args:
        tensors: as `ModelSizes.tensor_shapes` names them.
        golden: scaled windows, shape (b, m, 3); one at rest and one far outside the recording are added.
        warm_start: scaled, shape (m, 3).
        card: entries beyond model, sizes and scaling.
        definition: gives the model whose predictions are the golden ones.

    Raises:
        ValueError: the kernel does not reproduce the definition.
    """
    golden = np.concatenate([golden, np.zeros_like(golden[:1]), 4 * golden[:1]])
    # Predictions are of what is stored, in float32.
    stored, stored_start = golden.astype(np.float32), warm_start.astype(np.float32)
    golden, warm_start = stored.astype(np.float64), stored_start.astype(np.float64)
    condition = np.repeat(warm_start[-1:, 1:], 64, axis=0)
    condition[32:] = golden[0, -1, 1:]
    defined = definition(sizes, tensors)
    speed = np.maximum(condition[:, :1] * scaling.sd[1] + scaling.mean[1], 0.0)
    noise = gaussian(0, 0, 0, 64)[None] if sizes.excited or definition is not model_of else None
    samples = {
        "warm_start": stored_start,
        "golden.windows": stored,
        "golden.one_step": defined.predict(golden),
        "golden.condition": condition,
        "golden.closed_loop": run(
            defined.start(warm_start[None]), np.concatenate([condition, speed], axis=1)[None], noise
        )[0],
    }
    if sizes.excited:
        samples["golden.sigma"] = defined.start(golden).predict().scale
    return with_golden(model, sizes, {**tensors, **samples}, scaling, card)


def with_golden(
    model: str, sizes: ModelSizes, tensors: Tensors, scaling: Scaling, card: dict[str, Any]
) -> ProvedTexture:
    """A texture of tensors, golden samples among them, once the kernel has replayed these; otherwise as `proved`."""
    entries = {
        "format_version": FORMAT_VERSION,
        "model": model,
        "sizes": sizes.to_card(),
        "window": sizes.history,
        "units": {"acceleration": "m/s^2", "speed": "mm/s", "force": "N"},
        "scaling": {"mean": list(scaling.mean), "sd": list(scaling.sd)},
    }
    data = Texture(card={**entries, **card}, tensors=tensors).to_bytes()
    return ProvedTexture(texture_from_bytes(data), NativeTexture(data))


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
