"""Networks in PyTorch as ONNX graphs, with their cost."""

import copy
import io
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from foten.dsp import Array
from foten.models.foten.network import Foten
from foten.models.foten.sizes import FotenSizes, TenSizes
from foten.models.foten_plus.network import InnovationNetwork, NextInnovation
from foten.models.foten_plus.sizes import N_INPUTS, FotenPlusSizes
from foten.models.model_sizes import ModelSizes
from foten.models.registry import GRAPH
from foten.models.texture_file import Texture
from foten.runtime.onnx_predictor import INPUT, OUTPUT

NETWORKS: dict[type[ModelSizes], Callable[[Any], nn.Module]] = {
    FotenPlusSizes: InnovationNetwork,
    FotenSizes: Foten,
    TenSizes: Foten,
}
"""Networks of the models that the kernel runs."""


def in_float64(network: nn.Module) -> Callable[[Array], Array]:
    """A copy of a network as a function of arrays, in float64 on the CPU."""
    network = copy.deepcopy(network).cpu().double().eval()

    def predict(windows: Array) -> Array:
        with torch.no_grad():
            return np.asarray(network(torch.from_numpy(np.ascontiguousarray(windows))).numpy())

    return predict


def graph_of_texture(texture: Texture) -> bytes:
    """A texture's one-step network as an ONNX graph, as `graph_of` makes it; that of foten-plus is `NextInnovation`.

    Raises:
        ValueError: the model has no network.
    """
    sizes, tensors = texture.sizes, texture.tensors
    if GRAPH in tensors:
        return tensors[GRAPH].tobytes()
    if type(sizes) not in NETWORKS:
        raise ValueError(f"{texture.card['model']} has no network to export")
    network = NETWORKS[type(sizes)](sizes)
    prefix = "network." if isinstance(network, InnovationNetwork) else ""
    network.load_state_dict({k: torch.from_numpy(np.array(tensors[f"{prefix}{k}"])) for k in network.state_dict()})
    if isinstance(network, InnovationNetwork):
        return graph_of(NextInnovation(network), sizes.window, N_INPUTS).tobytes()
    return graph_of(network, sizes.window).tobytes()


def graph_of(network: nn.Module, m: int, n_channels: int = 3, name: str = INPUT) -> NDArray[np.uint8]:
    """A network as the bytes of an ONNX graph: windows (b, m, n_channels) under a name → (b,) or (b, k), float32."""
    file = io.BytesIO()
    network = copy.deepcopy(network).cpu().float().eval()
    with warnings.catch_warnings():
        # The exporter by tracing is 30 times as fast as the other, and needs two packages less.
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
    """Cost of a forward pass in pairs of multiplications and additions."""
    # Without oneDNN, whose recurrent layers are one operation that is not counted, and without its warnings; in double, in which
    # no layer is one of foten's own kernel.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with torch.no_grad(), torch.backends.mkldnn.flags(enabled=False), FlopCounterMode(display=False) as counter:
            copy.deepcopy(network).cpu().double().eval().requires_grad_(False)(torch.zeros(1, m, 3).double())
    return int(counter.get_total_flops()) // 2
