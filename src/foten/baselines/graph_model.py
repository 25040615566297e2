"""The definition of a model whose file holds a graph: what the graph predicts, or what it makes of noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from foten.dsp import Array
from foten.models.excitation import Excitation
from foten.models.stream import Model, Prediction, Stream
from foten.models.texture_file import Texture
from foten.models.window_model import WindowModel
from foten.runtime.onnx_predictor import OnnxPredictor


def model_of_graph(texture: Texture) -> Model:
    """The model of a texture's graph, run by ONNX Runtime."""
    predictor = OnnxPredictor(texture.sizes, texture.tensors)
    if predictor.takes_noise:
        return NoiseModel(predictor.predict, predictor.window)
    excitation = Excitation.of(texture.tensors) if texture.sizes.excited else None
    return WindowModel(predictor.predict, predictor.window, excitation)


@dataclass(frozen=True)
class NoiseModel:
    """A network that makes samples from noise: windows (b, m, 3) of noise, speed and force, scaled → (b,) scaled."""

    network: Callable[[Array], Array]
    window: int

    def predict(self, windows: Array) -> Array:
        """The samples without chance: of recorded windows (b, m, 3) scaled the noise is not known → (b,)."""
        return self.network(windows * [0.0, 1.0, 1.0])

    def start(self, windows: Array) -> Stream:
        """Streams that go on from scaled windows, shape (s, m, 3)."""
        return NoiseStream(self, windows * [0.0, 1.0, 1.0])


@dataclass
class NoiseStream:
    """Streams of a model of noise: noise and condition of the last m samples, shape (s, m, 3)."""

    model: NoiseModel
    windows: Array
    bounded: ClassVar[bool] = True

    @property
    def n_initial(self) -> int:
        """A number for each sample of a window."""
        return self.windows.shape[1]

    def begin(self, condition: Array, noise: Array, fade: float = 1.0) -> None:
        """Take noise of a window's length; the conditions before are those of the window."""
        self.windows[..., 0] = noise

    def predict(self) -> Prediction:
        """The next samples; what is random in them is in the noise before."""
        return Prediction(self.model.network(self.windows))

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        """Move the windows on by a number of noise, 0 in the deterministic loop."""
        self.windows[:, :-1] = self.windows[:, 1:]
        self.windows[:, -1, 0] = np.zeros(len(self.windows)) if noise is None else noise
        self.windows[:, -1, 1:] = condition[:, :2]
