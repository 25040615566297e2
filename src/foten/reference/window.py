"""Models that are given the last m samples: networks, with a random part or without, and models of noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from foten.dsp import Array
from foten.dsp.noise import Volatility
from foten.reference.excitation import Excitation, Scale
from foten.reference.innovation import InnovationNetwork, innovation_inputs
from foten.reference.stream import Prediction, Stream, largest_of

LOUDEST_BEGINNING = 50.0  # standard deviations, of the samples that a stream begins with


@dataclass(frozen=True)
class InnovationModel:
    """A network of innovations over the errors of another one.

    Attributes:
        level: what an innovation is worth in scaled acceleration, over speed and force.
        network: how the next one is distributed.
    """

    level: Scale
    network: InnovationNetwork


@dataclass(frozen=True)
class WindowModel:
    """A network: windows (b, m, 3) scaled → (b,) or, of several samples ahead, (b, n_ahead).

    Where it turns noise into samples, its windows hold noise in the place of acceleration.
    """

    network: Callable[[Array], Array]
    window: int
    excitation: Excitation | None = None
    from_noise: bool = False
    innovations: InnovationModel | None = None

    def ahead(self, windows: Array) -> Array:
        """Return the samples to come: windows (b, m, 3) scaled → (b, n_ahead) scaled."""
        return self.network(windows).reshape(len(windows), -1)

    def predict(self, windows: Array) -> Array:
        """Return the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        if self.innovations is not None:
            return self._drawing(windows, settled=False).predict().sample
        return self.ahead(windows)[:, 0]

    def start(self, windows: Array) -> Stream:
        """Return streams that go on from scaled windows, shape (s, m, 3)."""
        if self.from_noise:
            return NoiseStream(self, windows.copy())
        if self.innovations is not None:
            return self._drawing(windows)
        volatility = None if self.excitation is None else self.excitation.volatility(len(windows))
        return WindowStream(self, windows.copy(), volatility, np.empty((len(windows), 0)))

    def _drawing(self, windows: Array, settled: bool = True) -> DrawingStream:
        assert self.innovations is not None
        hidden = np.zeros((len(windows), self.innovations.network.n_hidden))
        stream = DrawingStream(self, self.innovations, windows.copy(), hidden, settled)
        stream.clear()
        return stream


@dataclass
class WindowStream:
    """Streams of a network: the last m samples (s, m, 3), and predictions of it that are still to come (s, any)."""

    model: WindowModel
    windows: Array
    volatility: Volatility | None
    pending: Array
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
        self.pending = self.pending[:, :0]
        for z in noise[:, 1:].T:
            sample = np.clip(self.predict().excited(z), -LOUDEST_BEGINNING, LOUDEST_BEGINNING)
            self.push(sample, condition, z)

    def predict(self) -> Prediction:
        """Return the prediction from the windows, or the next of those made before."""
        if not self.pending.shape[1]:
            self.pending = self.model.ahead(self.windows)
        sample = self.pending[:, 0]
        if self.model.excitation is None or self.volatility is None:
            return Prediction(sample)
        return self.model.excitation.added_to(sample, self.volatility.factor(), self.windows[:, -1, 1:])

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        """Move the windows on by a sample."""
        if self.volatility is not None:
            self.volatility.push(noise)
        self.pending = self.pending[:, 1:]
        self.windows[:, :-1] = self.windows[:, 1:]
        self.windows[:, -1, 0] = sample
        self.windows[:, -1, 1:] = condition[:, :2]


@dataclass
class DrawingStream:
    """Streams of a network with a network of innovations: the last m samples (s, m, 3), and the state of the latter.

    Where they are not `settled`, σ does not scale what is drawn: as in a recording, which the network was trained on.
    """

    model: WindowModel
    innovations: InnovationModel
    windows: Array
    hidden: Array
    settled: bool = True
    bounded: ClassVar[bool] = False

    @property
    def n_initial(self) -> int:
        """Return one number that an excitation's volatility would take, and one for each sample of a window."""
        return 1 + self.windows.shape[1]

    def clear(self) -> None:
        """Know nothing of what came before."""
        zero = np.zeros(len(self.windows))
        self.hidden, self.inputs = np.zeros_like(self.hidden), self._inputs(zero, zero)

    def _inputs(self, innovation: Array, sample: Array) -> Array:
        """Return what the network of innovations is given of the last sample: its innovation, and it over what one is worth."""
        logs = self.innovations.level.logarithms(self.windows[:, -1, 1:])
        return innovation_inputs(innovation, np.arcsinh(sample), logs)

    def _unit(self) -> Array:
        """Return what an innovation of the next sample is worth, (s,)."""
        known, excitation = self.windows[:, -1, 1:], self.model.excitation
        sigma = excitation.sigma(known) if self.settled and excitation is not None else 1.0
        return self.innovations.level(known) * sigma

    def begin(self, condition: Array, noise: Array, fade: float = 1.0) -> None:
        """Run for a window's length under the condition."""
        self.windows[:, -1, 1:] = condition[:, :2]
        self.clear()
        for z in noise[:, 1:].T:
            sample = np.clip(self.predict().excited(z), -LOUDEST_BEGINNING, LOUDEST_BEGINNING)
            self.push(sample, condition, z)

    def predict(self) -> Prediction:
        """Return what both expect."""
        sample, unit = self.model.ahead(self.windows)[:, 0], self._unit()
        mixture = self.innovations.network.mixture(self.hidden, self.inputs)
        if not self.settled or self.model.excitation is None:
            return Prediction(sample + unit * mixture.expected(), unit, mixture=mixture)
        largest, tail = self.model.excitation.largest, self.model.excitation.tail(self.windows[:, -1, 1:])
        limit = largest_of(largest, unit)
        return Prediction(sample + unit * np.clip(mixture.expected(), -limit, limit), unit, tail, largest, mixture)

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        """Take in the next samples, and their innovations."""
        unit, missed = self._unit(), sample - self.model.ahead(self.windows)[:, 0]
        self.windows[:, :-1] = self.windows[:, 1:]
        self.windows[:, -1, 0] = sample
        self.windows[:, -1, 1:] = condition[:, :2]
        self.inputs = self._inputs(missed / unit, sample / unit)
        self.hidden = self.innovations.network.push(self.hidden, self.inputs)


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
        """Take noise of a window's length under the condition."""
        self.windows[..., 1:] = condition[:, None, :2]
        self.windows[..., 0] = noise

    def predict(self) -> Prediction:
        """Return the next samples; what is random in them is in the noise before."""
        return Prediction(self.model.predict(self.windows))

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        """Move the windows on by a number of noise, 0 in the deterministic loop."""
        self.windows[:, :-1] = self.windows[:, 1:]
        self.windows[:, -1, 0] = 0.0 if noise is None else noise
        self.windows[:, -1, 1:] = condition[:, :2]
