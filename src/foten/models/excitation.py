"""The excitation: a scale over speed and force, heavy tails, volatility."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.noise import Volatility
from foten.models.foten.definition import Weights
from foten.models.stream import Prediction
from foten.models.tensor_shapes import HEAVIEST_TAIL


class Scale:
    """A standard deviation over speed and force (b, 2) scaled → (b,): a power law, corrected by a small network.

    log s = powers(log v, log f) · exponents + out · tanh(hidden · (v, f, log v, log f)) + bias, at most `highest`.
    """

    def __init__(self, tensors: Mapping[str, NDArray[Any]], prefix: str) -> None:
        self._w = Weights(tensors, prefix)

    def __call__(self, condition: Array) -> Array:
        logs = self.logarithms(condition)
        hidden = np.tanh(self._w.linear("hidden", np.concatenate([condition, logs], axis=1)))
        log_scale = self._w.linear("out", hidden) + powers(logs) @ self._w["power_law.weight"].T
        return np.minimum(np.exp(log_scale[:, 0]), self._w["highest"])

    def logarithms(self, condition: Array) -> Array:
        """Return log speed and log force re their means: (b, 2) scaled → (b, 2)."""
        floor = self._w["floor"]
        return np.log((self.physical(condition) + floor) / (self._w["mean"] + floor))

    def physical(self, condition: Array) -> Array:
        """Return speed [mm/s] and force [N], none negative: scaled (b, 2) → (b, 2)."""
        return np.maximum(condition * self._w["sd"] + self._w["mean"], 0.0)


def powers(logs: Array) -> Array:
    """Return x, y, x², xy, y² of logarithms: (b, 2) → (b, 5)."""
    x, y = logs.T
    return np.stack([x, y, x * x, x * y, y * y], axis=1)


class Excitation:
    """The tensors under ``excitation.``."""

    def __init__(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        self._w = Weights(tensors, "excitation.")
        self.sigma = Scale(tensors, "excitation.")
        in_sigma, in_acceleration = self._w["largest"]
        self.largest = float(in_sigma), float(in_acceleration)

    def tail(self, condition: Array) -> Array:
        """Return h of the tails: speed and force (b, 2) scaled → (b,)."""
        logs = powers(self.sigma.logarithms(condition))
        return HEAVIEST_TAIL / (1 + np.exp(-self._w.linear("tail", logs)[:, 0]))

    def volatility(self, n_streams: int) -> Volatility:
        """Return the volatility of streams that begin at its mean."""
        kept, sd = self._w["volatility"]
        return Volatility(float(kept), float(sd), np.zeros(n_streams))

    def added_to(self, sample: Array, unit: Array, condition: Array) -> Prediction:
        """Return a prediction with excitation: scaled samples, what a unit is worth (b,), under (b, 2)."""
        return Prediction(sample, unit * self.sigma(condition), self.tail(condition), self.largest)
