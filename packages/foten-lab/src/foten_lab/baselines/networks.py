"""Networks in PyTorch by the sizes of their model."""

from collections.abc import Callable
from typing import Any

from torch import nn

from foten.models.foten.network import Foten
from foten.models.graph import NETWORKS as KERNEL_NETWORKS
from foten.models.model_sizes import ModelSizes
from foten_lab.baselines.dftnet import Dftnet
from foten_lab.baselines.dstn import Dstn
from foten_lab.baselines.fnn import Fnn
from foten_lab.baselines.gan import Gan
from foten_lab.baselines.hapinf import Hapinf
from foten_lab.baselines.ldhtd import Ldhtd
from foten_lab.baselines.sizes import (
    DftnetSizes,
    DstnSizes,
    FnnSizes,
    FotenDSizes,
    GanSizes,
    HapinfSizes,
    LdhtdSizes,
    TenMfccSizes,
    TenWaveletSizes,
)
from foten_lab.baselines.ten_variants import EncodedBranch, FotenD, MfccBranch, WaveletBranch

NETWORKS: dict[type[ModelSizes], Callable[[Any], nn.Module]] = {
    **KERNEL_NETWORKS,
    TenMfccSizes: lambda sizes: Foten(sizes, EncodedBranch(MfccBranch(sizes), sizes)),
    TenWaveletSizes: lambda sizes: Foten(sizes, EncodedBranch(WaveletBranch(sizes), sizes)),
    FotenDSizes: FotenD,
    FnnSizes: Fnn,
    DstnSizes: Dstn,
    HapinfSizes: Hapinf,
    LdhtdSizes: Ldhtd,
    DftnetSizes: Dftnet,
    GanSizes: Gan,
}


def build(sizes: ModelSizes) -> nn.Module:
    """A new network, drawn from PyTorch's current seed."""
    return NETWORKS[type(sizes)](sizes)
