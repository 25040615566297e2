"""Textures of tensors with their proof: golden samples that the definition makes and the kernel replays."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.noise import gaussian
from foten.models.definitions import model_of
from foten.models.model_sizes import ModelSizes
from foten.models.stream import Model, run
from foten.models.texture_file import FORMAT_VERSION, Texture, texture_from_bytes
from foten.recording.scaling import Scaling
from foten.runtime.native import NativeTexture

Tensors = dict[str, NDArray[Any]]
MakeModel = Callable[[ModelSizes, Tensors], Model]


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
    """A texture with golden samples, loaded into the kernel; ValueError where that does not reproduce the definition.

    Args:
        tensors: as `ModelSizes.tensor_shapes` names them.
        golden: scaled windows, shape (b, m, 3); one at rest and one far outside the recording are added.
        warm_start: scaled, shape (m, 3).
        card: entries beyond model, sizes and scaling.
        definition: gives the model whose predictions are the golden ones.
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
    followed = np.concatenate([condition, speed], axis=1)
    samples = {
        "warm_start": stored_start,
        "golden.windows": stored,
        "golden.one_step": defined.predict(golden),
        "golden.condition": condition,
        "golden.closed_loop": run(defined.start(warm_start[None]), followed[None], noise)[0],
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


def reproved(texture: Texture, card: Mapping[str, Any], tensors: Mapping[str, NDArray[Any]] | None = None) -> Texture:
    """The texture with changes of its card and its tensors, proved anew; its split and metrics were of what it was."""
    cost = {key: value for key, value in texture.card["metrics"].items() if key == "multiply_adds"}
    entries = {**texture.card, "split": None, "metrics": cost, **card}
    if tensors is None:
        return Texture(entries, texture.tensors)
    windows, start = (texture.tensors[name].astype(np.float64) for name in ("golden.windows", "warm_start"))
    stored = {name: t for name, t in texture.tensors.items() if not name.startswith("golden.") and name != "warm_start"}
    of_file = {"format_version", "model", "sizes", "window", "units", "scaling"}
    entries = {key: value for key, value in entries.items() if key not in of_file}
    model, scaling = texture.card["model"], texture.scaling
    return proved(model, texture.sizes, {**stored, **tensors}, scaling, windows[:-2], start, entries).texture
