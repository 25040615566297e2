"""The sizes of a model that the kernel has no code for: its file holds a graph, which `runtime.onnx_predictor` runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from foten.models.excitation import WithExcitation
from foten.models.model_sizes import Shapes

GRAPH = "graph"  # the tensor that holds one, as bytes
MAX_GRAPH_WINDOW = 4096  # samples


@dataclass(frozen=True)
class GraphSizes(WithExcitation):
    """What a texture file says of a graph's sizes; what the graph is made of is its own."""

    max_window: ClassVar[int] = MAX_GRAPH_WINDOW

    def tensor_shapes(self) -> Shapes:
        """The graph, and the excitation where there is one."""
        return {GRAPH: (None,), **super().tensor_shapes()}
