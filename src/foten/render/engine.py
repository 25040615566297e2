"""The networks in NumPy: windows (b, m, 3) → next samples (b,), from a texture's tensors alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from foten.architecture import FotenArchitecture, FotenPlusArchitecture
from foten.dsp.spectrum import WEAKEST_BIN, dft_matrices, last_sample_row, position_encoding
from foten.texture_file import Texture

Array = NDArray[np.float64]


class Predictor(Protocol):
    """Windows in, next samples out; stateless. The linear references and a network being trained are predictors too."""

    @property
    def window(self) -> int:
        """Return m, the samples in a window."""
        ...

    def predict(self, windows: Array) -> Array:
        """Return the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        ...


class NumpyFoten:
    """The paper's network, pruned exactly as in training: one query row in the last layer, one row of Eq. 9.

    In float64: float32 takes half the time, but missed PyTorch in float64 by 1.7e-5 on four times a golden window of the
    simulated styrofoam, more than the file's own proof allows.
    """

    def __init__(
        self, architecture: FotenArchitecture, tensors: Mapping[str, NDArray[Any]], prefix: str = ""
    ) -> None:
        self.window = architecture.window
        self._architecture = architecture
        self._w = _Weights(tensors, prefix)
        m = architecture.window
        matrices = (
            position_encoding(m, architecture.d_model),
            *(matrix[:, : architecture.n_bins] for matrix in dft_matrices(m)),
            *last_sample_row(m, half=architecture.bins == "half"),
        )
        self._positions, self._real, self._imaginary, self._cosine, self._sine = (
            np.ascontiguousarray(matrix) for matrix in matrices
        )

    def predict(self, windows: Array) -> Array:
        """Return the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        acceleration = np.ascontiguousarray(windows[:, :, 0])
        tokens = self._w.linear("temporal.embedding", acceleration[..., None]) + self._positions
        n_layers = self._architecture.n_layers
        for layer in range(n_layers):
            tokens = self._layer(f"temporal.layers.{layer}", tokens, last_only=layer == n_layers - 1)
        temporal = tokens[:, 0]
        if self._architecture.pre_norm:
            temporal = self._w.norm("temporal.norm", temporal)
        spectral = self._w.linear("spectral_embedding", self._spectral(acceleration)[:, None])
        hidden = np.concatenate([temporal, spectral, windows[:, -1, 1:]], axis=1)
        hidden = np.maximum(self._w.linear("head_1", hidden), 0.0)
        hidden = np.maximum(self._w.linear("head_2", hidden), 0.0)
        return self._w.linear("head_3", hidden)[:, 0]

    def _spectral(self, acceleration: NDArray[Any]) -> NDArray[Any]:
        real, imaginary = acceleration @ self._real, acceleration @ self._imaginary + 0.0
        power = real * real + imaginary * imaginary
        heard = power > WEAKEST_BIN * power.sum(axis=1, keepdims=True)
        real, imaginary = np.where(heard, real, 0.0), np.where(heard, imaginary, 0.0)
        magnitude = np.sqrt(power + 1e-16)
        if self._architecture.phase_input == "cos_sin":
            phase = np.stack([real / magnitude, imaginary / magnitude], axis=-1)
        else:
            phase = np.arctan2(imaginary, real)[..., None]
        if self._architecture.magnitude_input == "log":
            magnitude = np.log1p(magnitude)
        encoded_phase = self._encode("phase", phase)
        turned = self._cosine * np.cos(encoded_phase) + self._sine * np.sin(encoded_phase)
        return (self._encode("magnitude", magnitude[..., None]) * turned).sum(axis=1)

    def _encode(self, name: str, tokens: NDArray[Any]) -> NDArray[Any]:
        lifted = self._architecture.spectral_width > 1
        if lifted:
            tokens = self._w.linear(f"spectral.{name}_in", tokens)
        if self._architecture.bin_embedding:
            tokens = tokens + self._w["spectral.bins"]
        tokens = self._layer(f"spectral.{name}_layer", tokens)
        return (self._w.linear(f"spectral.{name}_out", tokens) if lifted else tokens)[..., 0]

    def _layer(self, name: str, tokens: NDArray[Any], last_only: bool = False) -> NDArray[Any]:
        pre_norm = self._architecture.pre_norm
        normed = self._w.norm(f"{name}.norm_1", tokens) if pre_norm else tokens
        asked = slice(-1, None) if last_only else slice(None)
        hidden = tokens[:, asked] + self._attend(name, normed, asked)
        if not pre_norm:
            hidden = self._w.norm(f"{name}.norm_1", hidden)
        inner = self._w.norm(f"{name}.norm_2", hidden) if pre_norm else hidden
        inner = np.maximum(self._w.linear(f"{name}.feedforward_in", inner), 0.0)
        hidden = hidden + self._w.linear(f"{name}.feedforward_out", inner)
        return hidden if pre_norm else self._w.norm(f"{name}.norm_2", hidden)

    def _attend(self, name: str, normed: NDArray[Any], asked: slice) -> NDArray[Any]:
        b, _, width = normed.shape
        n_heads = self._architecture.n_heads if width % self._architecture.n_heads == 0 else 1
        projected = self._w.linear(f"{name}.attention_in", normed)
        query, key, value = (
            part.reshape(b, -1, n_heads, width // n_heads).transpose(0, 2, 1, 3)
            for part in (
                projected[:, asked, :width],
                projected[..., width : 2 * width],
                projected[..., 2 * width :],
            )
        )
        scores = (query * (width // n_heads) ** -0.5) @ key.transpose(0, 1, 3, 2)
        scores = np.exp(scores - scores.max(axis=-1, keepdims=True))
        mixed = (scores @ value) / scores.sum(axis=-1, keepdims=True)
        return self._w.linear(f"{name}.attention_out", mixed.transpose(0, 2, 1, 3).reshape(b, -1, width))


class NumpyFotenPlus:
    """The linear shortcut, the bounded correction and σ(speed, force)."""

    def __init__(self, architecture: FotenPlusArchitecture, tensors: Mapping[str, NDArray[Any]]) -> None:
        self.window = architecture.window
        self._limit = architecture.correction_limit
        self._network = NumpyFoten(architecture, tensors, "network.")
        self._w = _Weights(tensors, "")

    def linear(self, windows: Array) -> Array:
        """Return the shortcut's prediction alone: (b, m, 3) scaled → (b,) scaled."""
        return windows[:, :, 0] @ self._w["shortcut"] + self._w["shortcut_bias"]

    def predict(self, windows: Array) -> Array:
        """Return the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        level = self._scale("level", windows[:, -1, 1:])
        levelled = windows.copy()
        levelled[:, :, 0] *= (self._w["mean_level"] / level)[:, None]
        correction = level * self._limit * np.tanh(self._network.predict(levelled) / self._limit)
        return self.linear(windows) + correction

    def sigma(self, condition: Array) -> Array:
        """Return the excitation's scale: speed and force (b, 2) scaled → (b,) scaled."""
        return self._scale("excitation", condition)

    def _scale(self, name: str, condition: Array) -> Array:
        mean, sd, floor = (self._w[f"{name}.{part}"] for part in ("mean", "sd", "floor"))
        physical = np.maximum(condition * sd + mean, 0.0)
        logs = np.log((physical + floor) / (mean + floor))
        hidden = np.tanh(self._w.linear(f"{name}.hidden", np.concatenate([condition, logs], axis=1)))
        x, y = logs.T
        powers = np.stack([x, y, x * x, x * y, y * y], axis=1)
        log_scale = self._w.linear(f"{name}.out", hidden) + powers @ self._w[f"{name}.power_law.weight"].T
        return np.minimum(np.exp(log_scale[:, 0]), self._w[f"{name}.highest"])


class _Weights:
    """The tensors under one prefix, in float64."""

    def __init__(self, tensors: Mapping[str, NDArray[Any]], prefix: str) -> None:
        self._tensors = {
            name.removeprefix(prefix): np.asarray(tensor, dtype=np.float64)
            for name, tensor in tensors.items()
            if name.startswith(prefix)
        }

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._tensors:
            raise ValueError(f"the texture file has no tensor {name!r}")
        return self._tensors[name]

    def linear(self, name: str, values: NDArray[Any]) -> NDArray[Any]:
        weight, bias = self[f"{name}.weight"], self[f"{name}.bias"]
        if values.shape[-1] == 1:
            return values * weight[:, 0] + bias
        # One large product is faster than NumPy's loop over a stack of small ones.
        flat = values.reshape(-1, values.shape[-1]) @ weight.T + bias
        return flat.reshape(*values.shape[:-1], -1)

    def norm(self, name: str, values: NDArray[Any]) -> NDArray[Any]:
        centred = values - values.mean(axis=-1, keepdims=True)
        variance = np.square(centred).mean(axis=-1, keepdims=True)
        return centred / np.sqrt(variance + 1e-5) * self[f"{name}.weight"] + self[f"{name}.bias"]


ENGINES: dict[str, Callable[[Any, Mapping[str, NDArray[Any]]], Predictor]] = {
    "foten": NumpyFoten,
    "foten-plus": NumpyFotenPlus,
}
"""What runs each model of a texture file."""


def engine_for(texture: Texture) -> Predictor:
    """Return the engine of a texture, not yet proved on its golden windows.

    Raises:
        ValueError: no engine runs its model.
    """
    key = texture.card["model"]
    if key not in ENGINES:
        raise ValueError(f"no engine runs model {key!r}, expected one of {', '.join(ENGINES)}")
    return ENGINES[key](texture.architecture, texture.tensors)
