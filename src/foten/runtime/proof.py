"""Textures of tensors with their proof: golden samples that the definition makes and the kernel replays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.noise import gaussian
from foten.models.definitions import model_of
from foten.models.model_sizes import ModelSizes
from foten.models.stream import Model, run
from foten.models.texture_file import CLOSED_LOOP_TOLERANCE, FORMAT_VERSION, Texture, texture_from_bytes
from foten.recording.scaling import Scaling
from foten.runtime.native import NativeTexture

Tensors = dict[str, NDArray[Any]]
MakeModel = Callable[[ModelSizes, Tensors], Model]
GOLDEN_STEPS = 64  # of the free run
ROUNDING = 1e-6  # scaled; a step in float32 is off by less
N_PERTURBED, N_CONDITIONS = 8, 8  # runs that are off by it, under each of so many conditions


@dataclass(frozen=True)
class ProvedTexture:
    """A texture, and the kernel that accepted its file."""

    texture: Texture
    kernel: NativeTexture


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
    defined = definition(sizes, tensors)
    noise = gaussian(0, 0, 0, GOLDEN_STEPS)[None] if sizes.excited or definition is not model_of else None
    held = np.concatenate([warm_start[-1:, 1:], golden[:, -1, 1:]])
    if definition is model_of and not defined.start(warm_start[None]).bounded:
        condition = steady_condition(defined, warm_start, held, noise, scaling)
    else:
        condition = np.repeat(held[:2], GOLDEN_STEPS // 2, axis=0)
    samples = {
        "warm_start": stored_start,
        "golden.windows": stored,
        "golden.one_step": defined.predict(golden),
        "golden.condition": condition,
        "golden.closed_loop": _closed_loop(defined, warm_start[None], condition[None], noise, scaling)[0],
    }
    if sizes.excited:
        samples["golden.sigma"] = defined.start(golden).predict().scale
    return with_golden(model, sizes, {**tensors, **samples}, scaling, card)


def steady_condition(defined: Model, warm_start: Array, held: Array, noise: Array | None, scaling: Scaling) -> Array:
    """Condition of a short free run, shape (GOLDEN_STEPS, 2), scaled, along which rounding hardly moves the definition itself.

    A network jumps where the phase of a bin wraps from π to −π, and where a run comes within rounding of that, two runtimes
    that are both right part. Of pairs of held conditions (n, 2) the first along which starts and conditions that are off by
    `ROUNDING` end within half the tolerance; where none is, that along which they end nearest to one another.
    """
    off = ROUNDING * np.random.default_rng(0).standard_normal((N_PERTURBED + 1, len(warm_start) + GOLDEN_STEPS, 3))
    off[0] = 0.0
    starts = warm_start + off[:, : len(warm_start)]
    every = None if noise is None else np.repeat(noise, len(off), axis=0)
    steadiest, least = np.repeat(held[:2], GOLDEN_STEPS // 2, axis=0), np.inf
    for i in range(0, min(2 * N_CONDITIONS, len(held) - 1), 2):
        condition = np.repeat(held[i : i + 2], GOLDEN_STEPS // 2, axis=0)
        runs = _closed_loop(defined, starts, condition + off[:, len(warm_start) :, 1:], every, scaling)
        moved = float(np.abs(runs - runs[0]).max())
        if moved < least:
            steadiest, least = condition, moved
        if moved <= CLOSED_LOOP_TOLERANCE / 2:
            break
    return steadiest


def _closed_loop(defined: Model, starts: Array, condition: Array, noise: Array | None, scaling: Scaling) -> Array:
    """Free runs (s, n) from scaled windows (s, m, 3), under scaled speed and force (s, n, 2)."""
    speed = np.maximum(condition[..., :1] * scaling.sd[1] + scaling.mean[1], 0.0)
    return run(defined.start(starts), np.concatenate([condition, speed], axis=-1), noise)


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
