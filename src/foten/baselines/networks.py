"""Every network in PyTorch by its model's key: windows (b, m, 3) → next samples (b,)."""

from collections.abc import Callable
from typing import Any

from torch import nn

from foten.baselines.dftnet import Dftnet
from foten.baselines.dstn import Dstn
from foten.baselines.fnn import Fnn
from foten.baselines.gan import Gan
from foten.baselines.hapinf import Hapinf
from foten.baselines.ldhtd import Ldhtd
from foten.baselines.ten_variants import FotenD, TenMfcc, TenWavelet
from foten.models.foten.network import Foten
from foten.models.foten_plus.network import InnovationNetwork
from foten.models.model_sizes import ModelSizes

NETWORKS: dict[str, Callable[[Any], nn.Module]] = {
    "foten-plus": InnovationNetwork,
    "foten": Foten,
    "ten": Foten,
    "ten-mfcc": TenMfcc,
    "ten-wavelet": TenWavelet,
    "foten-d": FotenD,
    "fnn": Fnn,
    "dstn": Dstn,
    "hapinf": Hapinf,
    "ldhtd": Ldhtd,
    "dftnet": Dftnet,
    "gan": Gan,
}


def build(model: str, sizes: ModelSizes) -> nn.Module:
    """A new network of the given model and sizes, drawn from PyTorch's current seed."""
    return NETWORKS[model](sizes)
