"""What streams of a stateless predictor remember."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from foten.dsp.noise import Swell
from foten.render.excitation import Excitation
from foten.render.forecast import Forecast, Predictor

Array = NDArray[np.float64]

LOUDEST_BEGUN = (
    50.0  # standard deviations, of a sample that a stream begins with, where nothing else bounds it
)
_AT_ONCE = 4096  # windows


@dataclass
class WindowState:
    """Streams of a stateless predictor: the last m samples, shape (s, m, 3).

    Attributes:
        sigma: speed and force (s, 2) scaled → the scale of white noise (s,) scaled; None for none.
        excitation: of a texture, None for none.
        swell: how much louder than usual the streams are, where there is an excitation.
        coming: what the predictor said of the samples to come and did not take back since, shape (s, any).
    """

    predictor: Predictor
    windows: Array
    sigma: Callable[[Array], Array] | None = None
    excitation: Excitation | None = None
    swell: Swell | None = None
    coming: Array | None = None
    bounded: ClassVar[bool] = False

    @property
    def n_to_begin(self) -> int:
        """Return, with an excitation, one number for the swell and one for each sample of a window."""
        return 1 + self.windows.shape[1] if self.excitation is not None else 0

    def begin(self, condition: Array, noise: Array) -> None:
        """Play a window's length under the hand; without an excitation change nothing: what was heard is not known."""
        if self.swell is None:
            return
        hand = condition[:, :2]
        self.swell.draw(noise[:, 0])
        self.windows[:, -1, 1:] = hand
        self.coming = None
        for z in noise[:, 1:].T:
            self.push(np.clip(self.forecast().excited(z), -LOUDEST_BEGUN, LOUDEST_BEGUN), hand, z)

    def forecast(self) -> Forecast:
        """Return the prediction from the windows."""
        if self.coming is None:
            ahead = getattr(self.predictor, "ahead", None)
            self.coming = (
                self.predictor.predict(self.windows)[:, None] if ahead is None else ahead(self.windows)
            )
        sample, hand = self.coming[:, 0], self.windows[:, -1, 1:]
        if self.excitation is not None and self.swell is not None:
            return self.excitation.forecast(sample, self.swell.factor(), hand)
        return Forecast(sample, None if self.sigma is None else self.sigma(hand))

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        """Move the windows on by a sample."""
        if self.swell is not None:
            self.swell.push(noise)
        if self.coming is not None:
            self.coming = self.coming[:, 1:] if self.coming.shape[1] > 1 else None
        self.windows[:, :-1] = self.windows[:, 1:]
        self.windows[:, -1, 0] = sample
        self.windows[:, -1, 1:] = condition[:, :2]


@dataclass
class NoiseState:
    """Streams of a model of noise: what they drew, and the hand, of the last m samples, shape (s, m, 3)."""

    predictor: Predictor
    windows: Array
    bounded: ClassVar[bool] = True

    @property
    def n_to_begin(self) -> int:
        """Return a number for each sample of a window."""
        return self.windows.shape[1]

    def begin(self, condition: Array, noise: Array) -> None:
        """Let the streams have heard noise under a hand."""
        self.windows[..., 1:] = condition[:, None, :2]
        self.listen(noise)

    def listen(self, noise: Array) -> None:
        """Let the streams have heard noise (s, m), under the hand that they know."""
        self.windows[..., 0] = noise

    def forecast(self) -> Forecast:
        """Return the next samples: chance is in what was drawn before."""
        return Forecast(self.predictor.predict(self.windows))

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        """Move the windows on by a number of noise, none for no chance."""
        self.windows[:, :-1] = self.windows[:, 1:]
        self.windows[:, -1, 0] = 0.0 if noise is None else noise
        self.windows[:, -1, 1:] = condition[:, :2]


class OneStep(Predictor, Protocol):
    """A predictor that may have an excitation."""

    @property
    def excitation(self) -> Excitation | None:
        """Return it, or None."""
        ...


def begun(engine: OneStep, windows: Array) -> WindowState:
    """Return the state of streams that have heard the given scaled windows, shape (s, m, 3)."""
    swell = None if engine.excitation is None else engine.excitation.swell(len(windows))
    return WindowState(engine, windows.copy(), None, engine.excitation, swell)


def followed(engine: OneStep, blocks: Array) -> Forecast:
    """Return the forecast of every sample of recorded blocks from those before it: `ExcitedEngine.follow_heard`."""
    s, n = blocks.shape[0], blocks.shape[1] - engine.window
    seen = np.lib.stride_tricks.sliding_window_view(blocks, engine.window, axis=1)[:, :n].swapaxes(2, 3)
    flat = seen.reshape(s * n, engine.window, 3)
    sample = np.concatenate([engine.predict(flat[i : i + _AT_ONCE]) for i in range(0, s * n, _AT_ONCE)])
    if engine.excitation is None:
        return Forecast(sample.reshape(s, n))
    found = engine.excitation.forecast(sample, np.ones(s * n), flat[:, -1, 1:])
    assert found.scale is not None
    assert found.tail is not None
    return Forecast(sample.reshape(s, n), found.scale.reshape(s, n), found.tail.reshape(s, n), found.largest)
