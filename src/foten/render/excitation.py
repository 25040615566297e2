"""The random part of a texture: a scale that follows the hand, tails, and a swell."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.architecture import HEAVIEST_TAIL
from foten.dsp.noise import Swell
from foten.render.forecast import Forecast
from foten.render.weights import Weights

Array = NDArray[np.float64]


class Scale:
    """A standard deviation over speed and force (b, 2) scaled → (b,)."""

    def __init__(self, tensors: Mapping[str, NDArray[Any]], prefix: str) -> None:
        self._w = Weights(tensors, prefix)

    def __call__(self, condition: Array) -> Array:
        logs = self.logarithms(condition)
        hidden = np.tanh(self._w.linear("hidden", np.concatenate([condition, logs], axis=1)))
        log_scale = self._w.linear("out", hidden) + powers(logs) @ self._w["power_law.weight"].T
        return np.minimum(np.exp(log_scale[:, 0]), self._w["highest"])

    def logarithms(self, condition: Array) -> Array:
        floor = self._w["floor"]
        return np.log((self.physical(condition) + floor) / (self._w["mean"] + floor))

    def physical(self, condition: Array) -> Array:
        return np.maximum(condition * self._w["sd"] + self._w["mean"], 0.0)


def powers(logs: Array) -> Array:
    x, y = logs.T
    return np.stack([x, y, x * x, x * y, y * y], axis=1)


class Excitation:
    """What the tensors under ``excitation.`` say."""

    def __init__(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        self._w = Weights(tensors, "excitation.")
        self.sigma = Scale(tensors, "excitation.")
        in_sigma, in_acceleration = self._w["largest"]
        self.largest = float(in_sigma), float(in_acceleration)

    def tail(self, condition: Array) -> Array:
        """Return h of the tails: speed and force (b, 2) scaled → (b,)."""
        logs = powers(self.sigma.logarithms(condition))
        return HEAVIEST_TAIL / (1 + np.exp(-self._w.linear("tail", logs)[:, 0]))

    def swell(self, n_streams: int) -> Swell:
        """Return how much louder than usual streams are that begin."""
        kept, sd = self._w["swell"]
        return Swell(float(kept), float(sd), np.zeros(n_streams))

    def forecast(self, sample: Array, unit: Array, condition: Array) -> Forecast:
        """Return a forecast with the excitation of a speed and force (b, 2): scaled samples, what a unit is worth (b,)."""
        return Forecast(sample, unit * self.sigma(condition), self.tail(condition), self.largest)
