"""Every model once more in NumPy and float64, written to be read: makes golden samples and is the oracle of tests.

Nothing that a user calls renders with it: that is the kernel's.
"""

from collections.abc import Callable, Mapping
from typing import Any

from numpy.typing import NDArray

from foten.dsp import Array
from foten.models.excitation import Excitation
from foten.models.foten.definition import Network
from foten.models.foten_plus.definition import FotenPlus
from foten.models.piecewise_ar.definition import PiecewiseAr
from foten.models.registry import FotenPlusSizes, FotenSizes, PiecewiseArSizes, Sizes, TenSizes
from foten.models.stream import Model
from foten.models.window_model import WindowModel


def model_of(
    sizes: Sizes, tensors: Mapping[str, NDArray[Any]], network: Callable[[Array], Array] | None = None
) -> Model:
    """Return the model of a texture's tensors; a graph's has a network: windows (b, m, 3) scaled → (b,) scaled."""
    if isinstance(sizes, FotenPlusSizes):
        return FotenPlus(sizes, tensors)
    if isinstance(sizes, PiecewiseArSizes):
        return PiecewiseAr(sizes, tensors)
    if network is None:
        assert isinstance(sizes, FotenSizes | TenSizes)
        network = Network(sizes, tensors)
    excitation = Excitation(tensors) if sizes.excited else None
    return WindowModel(network, sizes.window, excitation, sizes.from_noise)
