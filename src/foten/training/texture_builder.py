"""Tensors to a texture, its golden samples made by the reference, proved in the kernel that renders it."""

from __future__ import annotations

import copy
import io
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from foten.dsp import Array
from foten.dsp.noise import gaussian
from foten.models.definitions import model_of
from foten.models.foten_plus.network import InnovationNetwork, NextInnovation
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.model_sizes import Sizes
from foten.models.stream import run
from foten.models.tensor_shapes import N_INNOVATION_INPUTS
from foten.models.texture_file import FORMAT_VERSION, MIN_GOLDEN, Texture, texture_from_bytes
from foten.recording.scaling import Scaling
from foten.recording.windows import windows
from foten.runtime.native import NativeTexture
from foten.runtime.onnx_predictor import GRAPH, INPUT, OUTPUT
from foten.training.blocks import ScaledBlocks
from foten.training.config import WARM_START
from foten.training.networks import NETWORKS, build

Tensors = dict[str, NDArray[Any]]

N_GOLDEN = 12  # windows of the validation blocks
WARM_START_NEAR = 100  # of so many training windows one is near enough to begin from
WARM_START_RINGS_MS = 20.0  # the end of a window, which rings on into what comes after


@dataclass(frozen=True)
class ProvedTexture:
    """A texture, and what renders it: that its file was accepted there is the proof."""

    texture: Texture
    kernel: NativeTexture


@dataclass(frozen=True)
class Draft:
    """All of a texture but its sizes, tensors and metrics."""

    model: str
    blocks: ScaledBlocks
    card: dict[str, Any]  # entries beyond model, sizes and scaling
    # Of a graph, in float64: windows (b, m, 3) scaled → (b,) scaled.
    network: Callable[[Array], Array] | None = None

    def kernel(self, sizes: Sizes, tensors: Tensors, excitation: nn.Module) -> NativeTexture:
        """Return what renders a texture with an excitation that is being fitted."""
        tensors = {**tensors, **tensors_of(excitation, "excitation.")}
        return self.texture(sizes, tensors, {"validation_mae_scaled": 0.0}).kernel

    def texture(
        self, sizes: Sizes, tensors: Tensors, metrics: dict[str, Any], n_golden: int = MIN_GOLDEN
    ) -> ProvedTexture:
        """Return a texture of tensors, as `proved` makes it."""
        m, blocks = sizes.history, self.blocks
        window, condition = pick_warm_start(blocks, m)
        _, ends = blocks.targets(m)
        some = windows(blocks.flat, ends[np.linspace(0, len(ends) - 1, n_golden - 2).astype(int)], m)
        card = {**self.card, "warm_start": condition, "metrics": metrics}
        return proved(self.model, sizes, tensors, blocks.scaling, some, window, card, self.network)


def proved(
    model: str,
    sizes: Sizes,
    tensors: Tensors,
    scaling: Scaling,
    golden: Array,
    warm_start: Array,
    card: dict[str, Any],
    network: Callable[[Array], Array] | None = None,
) -> ProvedTexture:
    """Return a texture with golden samples, loaded into the kernel, which replays them.

    Args:
        tensors: as `Sizes.tensor_shapes` names them; of a graph that.
        golden: scaled windows, shape (b, m, 3); one at rest and one far outside the recording are added.
        warm_start: scaled, shape (m, 3).
        card, network: as `Draft` has them.

    Raises:
        ValueError: the kernel does not reproduce the reference.
    """
    golden = np.concatenate([golden, np.zeros_like(golden[:1]), 4 * golden[:1]])
    # What they are predicted from is kept in half of the bytes, which are most of a file with a long history; exactly so.
    stored, stored_start = golden.astype(np.float32), warm_start.astype(np.float32)
    golden, warm_start = stored.astype(np.float64), stored_start.astype(np.float64)
    condition = np.repeat(warm_start[-1:, 1:], 64, axis=0)
    condition[32:] = golden[0, -1, 1:]
    reference = model_of(sizes, tensors, network)
    speed = np.maximum(condition[:, :1] * scaling.sd[1] + scaling.mean[1], 0.0)
    noise = gaussian(0, 0, 0, 64)[None] if sizes.excited or sizes.from_noise else None
    stream = reference.start(warm_start[None])
    made = {
        "warm_start": stored_start,
        "golden.windows": stored,
        "golden.one_step": reference.predict(golden),
        "golden.condition": condition,
        "golden.closed_loop": run(stream, np.concatenate([condition, speed], axis=1)[None], noise)[0],
    }
    if sizes.excited:
        made["golden.sigma"] = reference.start(golden).predict().scale
    return with_golden(model, sizes, {**tensors, **made}, scaling, card)


def with_golden(model: str, sizes: Sizes, tensors: Tensors, scaling: Scaling, card: dict[str, Any]) -> ProvedTexture:
    """Return a texture of tensors, golden samples among them, once the kernel has replayed these; otherwise as `proved`."""
    own = {
        "format_version": FORMAT_VERSION,
        "model": model,
        "sizes": sizes.to_card(),
        "window": sizes.history,
        "units": {"acceleration": "m/s^2", "speed": "mm/s", "force": "N"},
        "scaling": {"mean": list(scaling.mean), "sd": list(scaling.sd)},
    }
    data = Texture(card={**own, **card}, tensors=tensors).to_bytes()
    return ProvedTexture(texture_from_bytes(data), NativeTexture(data))


def pick_warm_start(blocks: ScaledBlocks, m: int) -> tuple[Array, dict[str, Any]]:
    """Return a recorded training window near 45 mm/s and 0.8 N that is neither loud nor soft, scaled, (m, 3), and its condition.

    Of the hundredth of the training windows that is nearest (in units of the training standard deviations), it is the one
    whose last 20 ms have the median power: those ring on. What is rendered without excitation goes on from it, and so does the
    proof of the file; with excitation a stroke begins with noise.

    Source: Sec. V-a. Differs from the paper: it synthesises the window without saying from what; ours is recorded, and the
    card says under what condition.
    """
    trace = blocks.trace
    ends, _ = blocks.targets(m)
    condition = np.stack([trace.speed, trace.force], axis=1)[ends - 1]
    distance = np.hypot(*((condition - WARM_START) / blocks.scaling.sd[1:]).T)
    near = np.argsort(distance, kind="stable")[: max(1, len(ends) // WARM_START_NEAR)]
    candidates = windows(blocks.flat, ends[near], m)
    n_last = min(m, max(1, round(WARM_START_RINGS_MS * trace.rate_hz / 1000)))
    power = np.square(candidates[:, -n_last:, 0]).mean(axis=1)
    chosen = np.argsort(power, kind="stable")[(len(near) - 1) // 2]
    return candidates[chosen], warm_start_entry(condition[near[chosen]])


def warm_start_entry(recorded: Array) -> dict[str, dict[str, float]]:
    """Return what the card says of a warm start under a speed [mm/s] and a force [N], (2,)."""
    channels = ("speed", "force")
    return {
        "asked": dict(zip(channels, WARM_START, strict=True)),
        "recorded": dict(zip(channels, recorded.tolist(), strict=True)),
    }


def tensors_of(module: nn.Module, prefix: str = "") -> Tensors:
    """Return a module's parameters and buffers by name, copied."""
    return {f"{prefix}{name}": t.detach().cpu().numpy().copy() for name, t in module.state_dict().items()}


def in_float64(network: nn.Module) -> Callable[[Array], Array]:
    """Return a copy of a network as a function of arrays, in float64 on the CPU."""
    network = copy.deepcopy(network).cpu().double().eval()

    def predict(windows: Array) -> Array:
        with torch.no_grad():
            return np.asarray(network(torch.from_numpy(np.ascontiguousarray(windows))).numpy())

    return predict


def graph_of_texture(texture: Texture) -> bytes:
    """Return a texture's one-step network as an ONNX graph, as `graph_of` makes it; that of foten-plus is `NextInnovation`.

    Raises:
        ValueError: the model has no network.
    """
    model, sizes, tensors = texture.card["model"], texture.sizes, texture.tensors
    if GRAPH in tensors:
        return tensors[GRAPH].tobytes()
    if model not in NETWORKS:
        raise ValueError(f"{model} has no network, expected one of {', '.join(NETWORKS)}")
    network, prefix = build(model, sizes), "network." if isinstance(sizes, FotenPlusSizes) else ""
    network.load_state_dict(
        {key: torch.from_numpy(np.array(tensors[f"{prefix}{key}"])) for key in network.state_dict()}
    )
    if isinstance(network, InnovationNetwork):
        return graph_of(NextInnovation(network), sizes.window, N_INNOVATION_INPUTS).tobytes()
    return graph_of(network, sizes.window).tobytes()


def graph_of(network: nn.Module, m: int, n_channels: int = 3, name: str = INPUT) -> NDArray[np.uint8]:
    """A network as the bytes of an ONNX graph: windows (b, m, n_channels) under a name → (b,) or (b, k), float32."""
    file = io.BytesIO()
    network = copy.deepcopy(network).cpu().float().eval()
    with warnings.catch_warnings():
        # The exporter by tracing: the other takes fifteen seconds for what this does in half a one, and needs two packages more.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network,
            (torch.zeros(2, m, n_channels),),
            file,
            dynamo=False,
            opset_version=17,
            input_names=[name],
            output_names=[OUTPUT],
            dynamic_axes={name: {0: "b"}, OUTPUT: {0: "b"}},
        )
    return np.frombuffer(file.getvalue(), dtype=np.uint8)


def multiply_adds(network: nn.Module, m: int) -> int:
    """Return what a forward pass costs in multiplications and additions in pairs."""
    # Without oneDNN, whose recurrent layers are one operation that nobody counts; and without what it says of other processors.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with torch.no_grad(), torch.backends.mkldnn.flags(enabled=False), FlopCounterMode(display=False) as counter:
            copy.deepcopy(network).cpu().float().eval().requires_grad_(False)(torch.zeros(1, m, 3))
    return int(counter.get_total_flops()) // 2
