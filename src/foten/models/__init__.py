"""The networks, in PyTorch, one architecture a file: windows (b, m, 3) → next samples (b,)."""

from collections.abc import Callable
from typing import Any

from torch import nn

from foten.architecture import TenArchitecture
from foten.models.foten import Foten
from foten.models.foten_plus import FotenPlus

MODELS: dict[str, Callable[[Any], nn.Module]] = {"foten-plus": FotenPlus, "foten": Foten, "ten": Foten}


def build(key: str, architecture: TenArchitecture) -> nn.Module:
    """Return a new network of the given key and sizes, drawn from PyTorch's current seed."""
    return MODELS[key](architecture)
