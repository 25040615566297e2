"""The networks, in PyTorch, one a file: windows (b, m, 3) → next samples (b,)."""

from collections.abc import Callable
from typing import Any

from torch import nn

from foten.baselines.dftnet import Dftnet
from foten.baselines.dstn import Dstn
from foten.baselines.fnn import Fnn
from foten.baselines.gan import Gan
from foten.baselines.hapinf import Hapinf
from foten.baselines.ldhtd import Ldhtd
from foten.models.foten.network import Foten
from foten.models.foten_plus.network import InnovationNetwork
from foten.models.model_sizes import Sizes

NETWORKS: dict[str, Callable[[Any], nn.Module]] = {
    "foten-plus": InnovationNetwork,
    **dict.fromkeys(("foten", "ten", "ten-mfcc", "ten-wavelet", "foten-d"), Foten),
    "fnn": Fnn,
    "dstn": Dstn,
    "hapinf": Hapinf,
    "ldhtd": Ldhtd,
    "dftnet": Dftnet,
    "gan": Gan,
}


def build(model: str, sizes: Sizes) -> nn.Module:
    """Return a new network of the given model and sizes, drawn from PyTorch's current seed."""
    return NETWORKS[model](sizes)
