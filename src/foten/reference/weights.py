"""The tensors of a texture file, and the two maps that every network has of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Weights:
    """The tensors under one prefix, in float64."""

    def __init__(self, tensors: Mapping[str, NDArray[Any]], prefix: str) -> None:
        self._tensors = {
            name.removeprefix(prefix): np.asarray(tensor, dtype=np.float64)
            for name, tensor in tensors.items()
            if name.startswith(prefix)
        }

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._tensors:
            raise ValueError(f"the texture file has no tensor {name!r}")
        return self._tensors[name]

    def linear(self, name: str, values: NDArray[Any]) -> NDArray[Any]:
        weight, bias = self[f"{name}.weight"], self[f"{name}.bias"]
        if values.shape[-1] == 1:
            return values * weight[:, 0] + bias
        # One large product is faster than NumPy's loop over a stack of small ones.
        flat = values.reshape(-1, values.shape[-1]) @ weight.T + bias
        return flat.reshape(*values.shape[:-1], -1)

    def norm(self, name: str, values: NDArray[Any]) -> NDArray[Any]:
        centred = values - values.mean(axis=-1, keepdims=True)
        variance = np.square(centred).mean(axis=-1, keepdims=True)
        return centred / np.sqrt(variance + 1e-5) * self[f"{name}.weight"] + self[f"{name}.bias"]
