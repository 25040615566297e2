"""The networks, in PyTorch, one architecture a file: windows (b, m, 3) → next samples (b,), or (b, n_ahead) of those that hop."""

from collections.abc import Callable
from typing import Any

from torch import nn

from foten.architecture import GraphArchitecture, TenArchitecture
from foten.models.dftnet import Dftnet
from foten.models.dstn import Dstn
from foten.models.fnn import Fnn
from foten.models.foten import Foten
from foten.models.foten_plus import FotenPlus
from foten.models.gan import Gan
from foten.models.hapinf import Hapinf
from foten.models.ldhtd import Ldhtd
from foten.models.ldhtd_hop import LdhtdHop

MODELS: dict[str, Callable[[Any], nn.Module]] = {
    "foten-plus": FotenPlus,
    "foten": Foten,
    "ten": Foten,
    "ten-mfcc": Foten,
    "ten-wavelet": Foten,
    "foten-d": Foten,
    "fnn": Fnn,
    "dstn": Dstn,
    "hapinf": Hapinf,
    "ldhtd": Ldhtd,
    "ldhtd-hop": LdhtdHop,
    "dftnet": Dftnet,
    "gan": Gan,
}


def build(key: str, architecture: TenArchitecture | GraphArchitecture) -> nn.Module:
    """Return a new network of the given key and sizes, drawn from PyTorch's current seed."""
    return MODELS[key](architecture)
