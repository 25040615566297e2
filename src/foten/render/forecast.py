"""What a model gives and remembers as it runs: the seam between the loop and the engines."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from foten.dsp.noise import gaussianised, heavy_tailed

Array = NDArray[np.float64]


class Forecast(NamedTuple):
    """The next sample without excitation, by how much a unit of excitation moves it, and how heavy its tails are; scaled.

    `largest` bounds the excitation in its unit and in scaled acceleration.
    """

    sample: Array
    scale: Array | None = None
    tail: Array | None = None
    largest: tuple[float, float] = (np.inf, np.inf)

    def excited(self, noise: Array) -> Array:
        """Return the sample with excitation from standard normal noise, shape (s,)."""
        if self.scale is None:
            return self.sample
        if self.tail is None:
            return self.sample + self.scale * noise
        limit = np.minimum(self.largest[0], self.largest[1] / self.scale)
        return self.sample + self.scale * heavy_tailed(noise, self.tail, limit)


def excitation_fit(expected: Forecast, recorded: Array) -> tuple[Array, Array]:
    """Return the errors taken back to what should be standard normal, and their negative log-likelihood [nat, scaled].

    Args:
        expected: of the recorded samples, with scale and tail.
        recorded: scaled, any shape, the forecast's.
    """
    assert expected.scale is not None
    assert expected.tail is not None
    z = gaussianised((recorded - expected.sample) / expected.scale, expected.tail)
    spread = expected.tail * z * z
    nll = 0.5 * (z * z + spread) + np.log1p(spread) + np.log(expected.scale) + 0.5 * math.log(2 * math.pi)
    return z, nll


class State(Protocol):
    """What streams of a model remember, each stream by itself.

    Attributes:
        bounded: whether it stays within bounds on its own output, whatever speed and force do.
        n_to_begin: how many numbers it takes for a stream to `begin`.
    """

    @property
    def bounded(self) -> bool: ...

    @property
    def n_to_begin(self) -> int: ...

    def begin(self, condition: Array, noise: Array) -> None:
        """Let the streams be such as had been going on for long under a hand, whatever they were started with.

        Args:
            condition: its speed and force, scaled, as `ClosedLoop.step` has them, shape (s, 2 or 3).
            noise: standard normal, shape (s, n_to_begin).
        """
        ...

    def forecast(self) -> Forecast:
        """Return the next samples, shape (s,)."""
        ...

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        """Take in the next samples (s,), their speed and force (s, 2 or 3) and the noise in them, as `ClosedLoop` has them."""
        ...


class Predictor(Protocol):
    """Windows in, next samples out; stateless. The linear references and a network being trained are predictors too."""

    @property
    def window(self) -> int:
        """Return m, the samples in a window."""
        ...

    def predict(self, windows: Array) -> Array:
        """Return the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        ...


class Engine(Predictor, Protocol):
    """A predictor that also runs streams sample by sample."""

    def start(self, windows: Array) -> State:
        """Return the state of streams that have heard the given scaled windows, shape (s, m, 3)."""
        ...


class ExcitedEngine(Engine, Protocol):
    """An engine with a random part."""

    def follow_heard(self, blocks: Array) -> Forecast:
        """Return the forecast that a rendering hears, of every sample of recorded blocks from those before it in its block.

        Args:
            blocks: scaled, shape (s, n, 3).

        Returns:
            Each of shape (s, n − window), scaled; the sample alone where the rendering knows more than the recording says.
        """
        ...
