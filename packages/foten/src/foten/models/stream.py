"""Parts that the definitions of models share: tensors by name, streams, their closed loop (Sec. V); all scaled."""

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array


class Weights(dict[str, Array]):
    """Tensors of a texture file under one prefix, in float64, and the two maps that every network has of them."""

    def __init__(self, tensors: Mapping[str, NDArray[Any]], prefix: str) -> None:
        under = {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}
        super().__init__({name: np.asarray(tensor, dtype=np.float64) for name, tensor in under.items()})

    def linear(self, name: str, values: Array) -> Array:
        weight, bias = self[f"{name}.weight"], self[f"{name}.bias"]
        if values.shape[-1] == 1:
            return values * weight[:, 0] + bias
        # One large product is faster than NumPy's loop over a stack of small ones.
        flat = values.reshape(-1, values.shape[-1]) @ weight.T + bias
        return flat.reshape(*values.shape[:-1], -1)

    def norm(self, name: str, values: Array) -> Array:
        centred = values - values.mean(axis=-1, keepdims=True)
        variance = np.square(centred).mean(axis=-1, keepdims=True)
        return centred / np.sqrt(variance + 1e-5) * self[f"{name}.weight"] + self[f"{name}.bias"]


class Prediction(NamedTuple):
    """The next sample of each stream without excitation, and what an excitation adds; shapes (s,)."""

    sample: Array
    scale: Array | None = None  # by how much a unit of excitation moves it; None for no excitation
    innovation_limit: tuple[float, float] = (np.inf, np.inf)  # in units of the scale, and of scaled acceleration
    recorded: Array | None = None  # innovations that take the place of noise, in units of the scale
    gain_before_filter: bool = False  # then near rest the excitation fades, and not what a lattice makes of it
    tone: Array | float = 0.0  # of the sample

    def excited(self, noise: Array) -> Array:
        """The sample with excitation from standard normal noise, shape (s,)."""
        if self.scale is None:
            return self.sample
        in_scales, in_acceleration = self.innovation_limit
        limit = np.minimum(in_scales, in_acceleration / self.scale)
        return self.sample + self.scale * np.clip(noise if self.recorded is None else self.recorded, -limit, limit)

    def faded(self, noise: Array | None, fade: Array | float) -> tuple[Array, Array]:
        """The output with a fade near rest, and the sample that the stream goes on from, (s,) each; of noise or None."""
        sample = self.sample if noise is None else self.excited(noise)
        if not self.gain_before_filter:
            return fade * sample, sample
        sample = self.sample + fade * (sample - self.sample)
        return sample - (1 - fade) * self.tone, sample


class Stream(Protocol):
    """s independent streams of a model; a condition is speed and force, scaled, and the speed of tones [mm/s]."""

    @property
    def bounded(self) -> bool:
        """Whether they stay within bounds in the closed loop, however speed and force move."""

    @property
    def n_initial(self) -> int:
        """Numbers of noise that a stream takes to `begin`."""

    def begin(self, condition: Array, noise: Array, fade: float = 1.0) -> None:
        """Take a state as after a long time under one condition (s, 3), of standard normal numbers (s, n_initial)."""

    def predict(self) -> Prediction:
        """The next samples, shape (s,)."""

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        """Take in the next samples (s,), their condition (s, 3), and the noise that was in them, (s,) or None."""

    def leave(self, sample: Array) -> Array:
        """What leaves, of a bounded stream, of samples (s,) that were pushed and faded."""


class Model(Protocol):
    """A model: one step ahead from windows, and streams of it."""

    def predict(self, windows: Array) -> Array:
        """The next samples: windows (b, m, 3) scaled → (b,) scaled."""

    def start(self, windows: Array) -> Stream:
        """Streams that go on from scaled windows, shape (s, m, 3)."""


def run(
    stream: Stream, condition: Array, noise: Array | None, limit: float = np.inf, fade: Array | None = None
) -> Array:
    """n samples of each stream's closed loop, shape (s, n).

    A sample is predicted under the condition of the one before (Eq. 1). What the saturator cuts off is cut from what leaves; a
    bounded stream goes on from its uncut sample.

    Args:
        condition: of each sample, shape (s, n, 3).
        noise: standard normal, shape (s, n); None for the deterministic loop.
        limit: of the saturator.
        fade: how much of the vibration is left near rest, shape (n,); None for all.
    """
    out = np.empty(condition.shape[:2])
    for i in range(condition.shape[1]):
        z = None if noise is None else noise[:, i]
        left = 1.0 if fade is None else float(fade[i])
        leaving, sample = stream.predict().faded(z, left)
        if stream.bounded:
            stream.push(sample, condition[:, i], z)
            out[:, i] = np.clip(stream.leave(leaving), -limit, limit)
        else:
            played = np.clip(sample, -limit, limit)
            out[:, i] = left * played
            stream.push(played, condition[:, i], z)
    return out
