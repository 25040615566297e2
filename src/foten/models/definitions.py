"""The definition of any model that the kernel runs: NumPy, float64, written to be read.

Training makes golden samples with it, and tests hold the kernel against it; nothing that a user calls renders with it.
"""

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from foten.models.excitation import Excitation
from foten.models.foten.definition import Network
from foten.models.foten.sizes import TransformerSizes
from foten.models.foten_plus.definition import FotenPlus
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.model_sizes import ModelSizes
from foten.models.piecewise_ar.definition import PiecewiseAr
from foten.models.piecewise_ar.sizes import PiecewiseArSizes
from foten.models.stream import Model
from foten.models.window_model import WindowModel


def model_of(sizes: ModelSizes, tensors: Mapping[str, NDArray[Any]]) -> Model:
    """The model of a texture's tensors."""
    if isinstance(sizes, FotenPlusSizes):
        return FotenPlus(sizes, tensors)
    if isinstance(sizes, PiecewiseArSizes):
        return PiecewiseAr(sizes, tensors)
    assert isinstance(sizes, TransformerSizes)
    return WindowModel(Network(sizes, tensors), sizes.window, Excitation.of(tensors) if sizes.excited else None)
