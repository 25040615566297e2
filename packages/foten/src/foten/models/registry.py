"""Models that the kernel runs, by the key that names each on the command line and in a card; sizes of any file."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from foten.models.excitation import WithExcitation
from foten.models.foten.sizes import FotenSizes, TenSizes
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.model_sizes import ModelSizes, Shapes, shortened
from foten.models.piecewise_ar.sizes import PiecewiseArSizes

GRAPH = "graph"  # the tensor that holds one, as bytes
MAX_GRAPH_WINDOW = 4096  # samples


@dataclass(frozen=True)
class GraphSizes(WithExcitation):
    """Sizes of a network whose file holds a graph; a card states no others."""

    max_window: ClassVar[int] = MAX_GRAPH_WINDOW

    def tensor_shapes(self) -> Shapes:
        return {GRAPH: (None,), **super().tensor_shapes()}


MODELS: dict[str, type[ModelSizes]] = {
    "foten-plus": FotenPlusSizes,
    "foten": FotenSizes,
    "ten": TenSizes,
    "ar": PiecewiseArSizes,
}


def sizes_of(model: str, card: Mapping[str, Any]) -> ModelSizes:
    """The sizes that a card gives for a model; one that the kernel does not run is a graph's.

    Raises:
        ValueError: the model or a size is unknown, or a size is out of range.
    """
    if model in MODELS:
        return checked_sizes(model, MODELS[model], card)
    if set(card) - {field.name for field in fields(GraphSizes)}:
        raise ValueError(f"unknown model {shortened(model)}, expected one of {', '.join(MODELS)}, or a graph")
    return GraphSizes(**card)


def checked_sizes(model: str, kind: type[ModelSizes], card: Mapping[str, Any]) -> ModelSizes:
    """Sizes of a kind from values by name.

    Raises:
        ValueError: a size is unknown or out of range.
    """
    known = [field.name for field in fields(kind)]
    unknown = set(card) - set(known)
    if unknown:
        raise ValueError(f"{model} has no size {min(unknown)!r}, expected one of {', '.join(known)}")
    return kind(**card)
