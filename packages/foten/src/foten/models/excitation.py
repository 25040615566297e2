"""The random part of a model: σ(v, f) z, z standard normal, at most the innovation limit. Source: ours (docs/model.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.models.model_sizes import ModelSizes, Shapes
from foten.models.stream import Prediction, Weights

N_FEATURES = 4  # of the network in log σ: scaled speed and force, and their logarithms
N_POWERS = 5  # x, y, x², xy, y² of the logarithms
MAX_SIGMA = 1e6  # of a scale that nothing bounds


@dataclass(frozen=True)
class WithExcitation(ModelSizes):
    """Sizes of a one-step model that may have an excitation; none of the sources has one."""

    excitation: bool = False  # whether it has
    excitation_width: int = 16  # hidden units of log σ over speed and force

    @property
    def excited(self) -> bool:
        return self.excitation

    def tensor_shapes(self) -> Shapes:
        return excitation_shapes(self.excitation_width) if self.excitation else {}

    def to_card(self) -> dict[str, Any]:
        """The sizes as plain JSON values; nothing of an excitation where there is none."""
        sizes = super().to_card().items()
        return {name: size for name, size in sizes if self.excitation or not name.startswith("excitation")}


def linear_shapes(name: str, outputs: int, inputs: int) -> Shapes:
    return {f"{name}.weight": (outputs, inputs), f"{name}.bias": (outputs,)}


def scale_shapes(name: str, width: int) -> Shapes:
    shapes = linear_shapes(f"{name}.hidden", width, N_FEATURES) | linear_shapes(f"{name}.out", 1, width)
    shapes |= {f"{name}.exponents": (N_POWERS,), f"{name}.sigma_max": (1,)}
    return shapes | {f"{name}.{part}": (2,) for part in ("mean", "sd", "floor")}


def scale_cost(width: int) -> int:
    """Multiply-adds of a `Scale` at one speed and force."""
    return (N_FEATURES + 2) * width + N_POWERS


def excitation_shapes(width: int) -> Shapes:
    return scale_shapes("excitation", width) | {"excitation.innovation_limit": (2,)}


@dataclass(frozen=True)
class Scale:
    """A standard deviation over speed and force: a power law, corrected by a small network.

        log σ = q · exponents + out · tanh(hidden · u) + bias,   at most log sigma_max

    with x, y = log((v + floor) / (v̄ + floor)), likewise of f; q = (x, y, x², xy, y²), and u = (v, f scaled, x, y).
    """

    hidden_weight: Array  # (width, 4)
    hidden_bias: Array  # (width,)
    out_weight: Array  # (1, width)
    out_bias: Array  # (1,)
    exponents: Array  # (5,)
    sigma_max: Array  # (1,): what was hardly recorded is no louder than the loudest 3 % of what was
    mean: Array  # of speed [mm/s] and force [N], (2,)
    sd: Array  # of the same, (2,)
    floor: Array  # what is added before the logarithm [mm/s, N], (2,)

    @classmethod
    def of(cls, tensors: Mapping[str, NDArray[Any]], prefix: str) -> Scale:
        """The scale whose tensors have names under a prefix, such as ``lattice.level.``."""
        weights = Weights(tensors, prefix)
        return cls(**{field.name: weights[_tensor(field.name)] for field in fields(cls)})

    def tensors(self, prefix: str) -> dict[str, NDArray[np.float32]]:
        return {prefix + _tensor(name): value.astype(np.float32) for name, value in vars(self).items()}

    def __call__(self, condition: Array) -> Array:
        """σ at speeds and forces: (n, 2) scaled → (n,)."""
        logs = self.logarithms(condition)
        hidden = np.tanh(np.concatenate([condition, logs], axis=1) @ self.hidden_weight.T + self.hidden_bias)
        log_sigma = hidden @ self.out_weight[0] + self.out_bias + powers(logs) @ self.exponents
        return np.minimum(np.exp(log_sigma), self.sigma_max)

    def logarithms(self, condition: Array) -> Array:
        """Log speed and log force re their means: (n, 2) scaled → (n, 2)."""
        return np.log((self.physical(condition) + self.floor) / (self.mean + self.floor))

    def physical(self, condition: Array) -> Array:
        """Speed [mm/s] and force [N], none negative: (…, 2) scaled → (…, 2)."""
        return np.maximum(condition * self.sd + self.mean, 0.0)

    def bounded(self, condition: Array) -> Scale:
        """The same, nowhere above its 97th percentile over conditions (n, 2) scaled."""
        free = replace(self, sigma_max=np.array([MAX_SIGMA]))
        return replace(free, sigma_max=np.quantile(free(condition), [0.97]))


def _tensor(name: str) -> str:
    return name.replace("_weight", ".weight").replace("_bias", ".bias")


def powers(logs: Array) -> Array:
    """x, y, x², xy, y² of logarithms: (n, 2) → (n, 5)."""
    x, y = logs.T
    return np.stack([x, y, x * x, x * y, y * y], axis=1)


@dataclass(frozen=True)
class Excitation:
    """σ(v, f), in units of what it excites, and the largest recorded innovation, in units of σ and in scaled acceleration."""

    sigma: Scale
    innovation_limit: tuple[float, float]

    @classmethod
    def of(cls, tensors: Mapping[str, NDArray[Any]]) -> Excitation:
        in_sigma, in_acceleration = Weights(tensors, "excitation.")["innovation_limit"]
        return cls(Scale.of(tensors, "excitation."), (float(in_sigma), float(in_acceleration)))

    def tensors(self) -> dict[str, NDArray[np.float32]]:
        limit = np.array(self.innovation_limit, dtype=np.float32)
        return {**self.sigma.tensors("excitation."), "excitation.innovation_limit": limit}

    def added_to(self, sample: Array, innovation_gain: Array | float, condition: Array) -> Prediction:
        """A prediction with excitation: samples (n,) scaled, what a unit moves them by (n,), under (n, 2) scaled."""
        return Prediction(sample, innovation_gain * self.sigma(condition), self.innovation_limit)
