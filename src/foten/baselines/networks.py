"""Networks in PyTorch by the sizes of their model."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torch import nn

from foten.baselines.dftnet import Dftnet
from foten.baselines.dstn import Dstn
from foten.baselines.fnn import Fnn
from foten.baselines.gan import Gan
from foten.baselines.hapinf import Hapinf
from foten.baselines.ldhtd import Ldhtd
from foten.baselines.sizes import (
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
from foten.baselines.ten_variants import EncodedBranch, FotenD, MfccBranch, WaveletBranch
from foten.models.foten.network import Foten
from foten.models.graph import NETWORKS as KERNEL_NETWORKS
from foten.models.model_sizes import ModelSizes

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
