"""The tensors of a texture file as the definitions read them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array


class Weights(dict[str, Array]):
    """The tensors of a texture file under one prefix, in float64, and the two maps that every network has of them."""

    def __init__(self, tensors: Mapping[str, NDArray[Any]], prefix: str) -> None:
        under = {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}
        super().__init__({name: np.asarray(tensor, dtype=np.float64) for name, tensor in under.items()})

    def __missing__(self, name: str) -> Array:
        raise ValueError(f"the texture file has no tensor {name!r}")

    def linear(self, name: str, values: Array) -> Array:
        weight, bias = self[f"{name}.weight"], self[f"{name}.bias"]
        if values.shape[-1] == 1:
            return values * weight[:, 0] + bias
        # One large product is faster than NumPy's loop over a stack of small ones.
        flat = values.reshape(-1, values.shape[-1]) @ weight.T + bias
        return flat.reshape(*values.shape[:-1], -1)

    def norm(self, name: str, values: Array) -> Array:
        centred = values - values.mean(axis=-1, keepdims=True)
        variance = np.square(centred).mean(axis=-1, keepdims=True)
        return centred / np.sqrt(variance + 1e-5) * self[f"{name}.weight"] + self[f"{name}.bias"]
