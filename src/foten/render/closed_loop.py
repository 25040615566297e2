"""The closed loop of Sec. V: a model on its own output, with or without excitation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.render.forecast import State

Array = NDArray[np.float64]


@dataclass
class ClosedLoop:
    """Many independent streams of one model, a sample at a time; all scaled.

    Attributes:
        state: what the streams remember; changed by every step.
        limit: the saturator's bound on a sample; it is there for safety and counts its hits in `n_saturated`. A state that is
            bounded by itself hears what it played before the cut: the innovation of a cut sample is as large as the cut, over
            the gain of the lattice, and a real fabric that began from ±50 standard deviations kept itself at the limit for good.
    """

    state: State
    limit: float = np.inf
    n_saturated: int = 0

    def step(self, condition: Array, noise: Array | None) -> Array:
        """Return the next sample of each stream, shape (s,), and take it into the state.

        Args:
            condition: speed and force that go with the new sample, shape (s, 2), scaled. The prediction
                sees those up to the sample before (Eq. 1). Where that speed is cut to what was trained, the true one
                [mm/s] may stand in a third column: the path's tones go by it.
            noise: standard normal, shape (s,); None for the deterministic loop.
        """
        expected = self.state.forecast()
        sample = expected.sample if noise is None else expected.excited(noise)
        played = np.clip(sample, -self.limit, self.limit)
        self.n_saturated += int((played != sample).sum())
        self.state.push(sample if self.state.bounded else played, condition, noise)
        return played

    def run(self, condition: Array, noise: Array | None) -> Array:
        """Return n samples of each stream, shape (s, n): condition (s, n, 2 or 3), noise (s, n) or None."""
        out = np.empty(condition.shape[:2])
        for i in range(condition.shape[1]):
            out[:, i] = self.step(condition[:, i], None if noise is None else noise[:, i])
        return out
