"""Models that predict from the last m samples alone: one-step networks, and filters of noise."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from foten.dsp import Array
from foten.models.excitation import Excitation
from foten.models.stream import Prediction, Stream

MAX_INITIAL = 50.0  # standard deviations, of the samples that a stream begins with: nothing else bounds a network


@dataclass(frozen=True)
class WindowModel:
    """A network: windows (b, m, 3) scaled → (b,) scaled."""

    network: Callable[[Array], Array]
    window: int
    excitation: Excitation | None = None

    def predict(self, windows: Array) -> Array:
        return self.network(windows)

    def start(self, windows: Array) -> Stream:
        return WindowStream(self, windows.copy())


@dataclass
class WindowStream:
    """Streams of a network: the last m samples (s, m, 3)."""

    model: WindowModel
    windows: Array
    bounded: ClassVar[bool] = False

    @property
    def n_initial(self) -> int:
        """With an excitation, a number for each sample of a window."""
        return 0 if self.model.excitation is None else self.windows.shape[1]

    def begin(self, condition: Array, noise: Array, fade: float = 1.0) -> None:
        """Run for a window's length under the condition; without an excitation change nothing."""
        if self.model.excitation is None:
            return
        self.windows[:, -1, 1:] = condition[:, :2]
        for z in noise.T:
            self.push(np.clip(self.predict().excited(z), -MAX_INITIAL, MAX_INITIAL), condition, z)

    def predict(self) -> Prediction:
        sample = self.model.predict(self.windows)
        if self.model.excitation is None:
            return Prediction(sample)
        return self.model.excitation.added_to(sample, 1.0, self.windows[:, -1, 1:])

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        self.windows[:, :-1] = self.windows[:, 1:]
        self.windows[:, -1, 0] = sample
        self.windows[:, -1, 1:] = condition[:, :2]

    def leave(self, sample: Array) -> Array:
        return sample


@dataclass(frozen=True)
class NoiseModel(WindowModel):
    """A network that makes samples from noise: windows (b, m, 3) of noise, speed and force, scaled → (b,) scaled."""

    def predict(self, windows: Array) -> Array:
        """Samples without noise, which is not known of recorded windows: (b, m, 3) scaled → (b,)."""
        return self.network(windows * [0.0, 1.0, 1.0])

    def start(self, windows: Array) -> Stream:
        return NoiseStream(self, windows * [0.0, 1.0, 1.0])


class NoiseStream(WindowStream):
    """Streams of a model of noise: noise and condition of the last m samples, shape (s, m, 3)."""

    bounded: ClassVar[bool] = True

    @property
    def n_initial(self) -> int:
        return self.windows.shape[1]

    def begin(self, condition: Array, noise: Array, fade: float = 1.0) -> None:
        """Take noise of a window's length; the conditions before are those of the window."""
        self.windows[..., 0] = noise

    def predict(self) -> Prediction:
        return Prediction(self.model.network(self.windows))

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        """Move the windows on by a number of noise, 0 in the deterministic loop."""
        super().push(np.zeros(len(self.windows)) if noise is None else noise, condition, noise)
