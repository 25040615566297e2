"""The networks, in PyTorch, one a file: windows (b, m, 3) → next samples (b,)."""

from collections.abc import Callable
from typing import Any

from torch import nn

from foten.families.sizes import Sizes
from foten.networks.dftnet import Dftnet
from foten.networks.dstn import Dstn
from foten.networks.fnn import Fnn
from foten.networks.foten import Foten
from foten.networks.gan import Gan
from foten.networks.hapinf import Hapinf
from foten.networks.innovation import InnovationNetwork
from foten.networks.ldhtd import Ldhtd

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
