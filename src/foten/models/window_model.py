"""Models that are given the last m samples: networks, with a random part or without, and models of noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from foten.dsp import Array
from foten.dsp.noise import Volatility
from foten.models.excitation import Excitation
from foten.models.stream import Prediction, Stream

LOUDEST_BEGINNING = 50.0  # standard deviations, of the samples that a stream begins with


@dataclass(frozen=True)
class WindowModel:
    """A network: windows (b, m, 3) scaled → (b,) scaled.

    Where it turns noise into samples, noise takes the place of acceleration: none is known of recorded windows.
    """

    network: Callable[[Array], Array]
    window: int
    excitation: Excitation | None = None
    from_noise: bool = False

    def predict(self, windows: Array) -> Array:
        """Return the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        return self.network(windows * [0.0, 1.0, 1.0] if self.from_noise else windows)

    def start(self, windows: Array) -> Stream:
        """Return streams that go on from scaled windows, shape (s, m, 3)."""
        if self.from_noise:
            return NoiseStream(self, windows * [0.0, 1.0, 1.0])
        volatility = None if self.excitation is None else self.excitation.volatility(len(windows))
        return WindowStream(self, windows.copy(), volatility)


@dataclass
class WindowStream:
    """Streams of a network: the last m samples (s, m, 3)."""

    model: WindowModel
    windows: Array
    volatility: Volatility | None
    bounded: ClassVar[bool] = False

    @property
    def n_initial(self) -> int:
        """Return, with an excitation, one number for the volatility and one for each sample of a window."""
        return 0 if self.volatility is None else 1 + self.windows.shape[1]

    def begin(self, condition: Array, noise: Array, fade: float = 1.0) -> None:
        """Run for a window's length under the condition; without an excitation change nothing: no window is known."""
        if self.volatility is None:
            return
        self.volatility.draw(noise[:, 0])
        self.windows[:, -1, 1:] = condition[:, :2]
        for z in noise[:, 1:].T:
            sample = np.clip(self.predict().excited(z), -LOUDEST_BEGINNING, LOUDEST_BEGINNING)
            self.push(sample, condition, z)

    def predict(self) -> Prediction:
        """Return the prediction from the windows."""
        sample = self.model.predict(self.windows)
        if self.model.excitation is None or self.volatility is None:
            return Prediction(sample)
        return self.model.excitation.added_to(sample, self.volatility.factor(), self.windows[:, -1, 1:])

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        """Move the windows on by a sample."""
        if self.volatility is not None:
            self.volatility.push(noise)
        self.windows[:, :-1] = self.windows[:, 1:]
        self.windows[:, -1, 0] = sample
        self.windows[:, -1, 1:] = condition[:, :2]


@dataclass
class NoiseStream:
    """Streams of a model of noise: noise and condition of the last m samples, shape (s, m, 3)."""

    model: WindowModel
    windows: Array
    bounded: ClassVar[bool] = True

    @property
    def n_initial(self) -> int:
        """Return a number for each sample of a window."""
        return self.windows.shape[1]

    def begin(self, condition: Array, noise: Array, fade: float = 1.0) -> None:
        """Take noise of a window's length; what the hand did before is known."""
        self.windows[..., 0] = noise

    def predict(self) -> Prediction:
        """Return the next samples; what is random in them is in the noise before."""
        return Prediction(self.model.network(self.windows))

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        """Move the windows on by a number of noise, 0 in the deterministic loop."""
        self.windows[:, :-1] = self.windows[:, 1:]
        self.windows[:, -1, 0] = 0.0 if noise is None else noise
        self.windows[:, -1, 1:] = condition[:, :2]
