"""The closed loop of Sec. V: a predictor on its own output, with or without excitation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.render.engine import Predictor

Array = NDArray[np.float64]
Sigma = Callable[[Array], Array]
"""Speed and force (b, 2) scaled → the excitation's standard deviation (b,) scaled."""


@dataclass
class ClosedLoop:
    """Many independent streams of one predictor, a sample at a time; all scaled.

    Attributes:
        windows: the last m samples of each stream, shape (s, m, 3); the state.
        limit: the saturator's bound on a sample; it is there for safety and counts its hits in `n_saturated`.
    """

    predictor: Predictor
    sigma: Sigma | None
    windows: Array
    limit: float = np.inf
    n_saturated: int = 0

    def step(self, condition: Array, noise: Array | None) -> Array:
        """Return the next sample of each stream, shape (s,), and take it into the windows.

        Args:
            condition: speed and force that go with the new sample, shape (s, 2), scaled. The prediction
                sees those up to the sample before (Eq. 1).
            noise: standard normal, shape (s,); None for the deterministic loop.
        """
        sample = self.predictor.predict(self.windows)
        if noise is not None and self.sigma is not None:
            sample = sample + self.sigma(self.windows[:, -1, 1:]) * noise
        beyond = np.abs(sample) > self.limit
        if beyond.any():
            self.n_saturated += int(beyond.sum())
            sample = np.clip(sample, -self.limit, self.limit)
        self.windows[:, :-1] = self.windows[:, 1:]
        self.windows[:, -1, 0] = sample
        self.windows[:, -1, 1:] = condition
        return sample

    def run(self, condition: Array, noise: Array | None) -> Array:
        """Return n samples of each stream, shape (s, n): condition (s, n, 2), noise (s, n) or None."""
        out = np.empty(condition.shape[:2])
        for i in range(condition.shape[1]):
            out[:, i] = self.step(condition[:, i], None if noise is None else noise[:, i])
        return out
