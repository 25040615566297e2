"""The paper's network and TEN, equation by equation: nothing is left out because the output does not depend on it."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.spectrum import WEAKEST_BIN, dft_matrices, position_encoding
from foten.models.foten.sizes import SpectralSizes, TransformerSizes
from foten.models.stream import Weights


class Network:
    """Windows (b, m, 3) scaled → (b,)."""

    def __init__(self, sizes: TransformerSizes, tensors: Mapping[str, NDArray[Any]]) -> None:
        self._sizes, self._w = sizes, Weights(tensors, "")

    def __call__(self, windows: Array) -> Array:
        sizes, w = self._sizes, self._w
        tokens = w.linear("temporal.embedding", windows[:, :, :1]) + position_encoding(sizes.window, sizes.d_model)
        for layer in range(sizes.n_layers):
            tokens = self._encoder(f"temporal.layers.{layer}", tokens)
        if sizes.pre_norm:
            tokens = w.norm("temporal.norm", tokens)
        if isinstance(sizes, SpectralSizes):
            spectral = w.linear("spectral_embedding", self._spectral(sizes, windows[:, :, 0])[:, :, None])  # Eq. 10
            tokens = np.concatenate([tokens, spectral], axis=2)
        fused = np.concatenate([tokens[:, -1], windows[:, -1, 1:3]], axis=1)  # Eq. 11, the last token
        hidden = np.maximum(w.linear("head_1", fused), 0.0)
        hidden = np.maximum(w.linear("head_2", hidden), 0.0)
        return w.linear("head_3", hidden)[:, 0]

    def _spectral(self, sizes: SpectralSizes, acceleration: Array) -> Array:
        """A_spec: (b, m) → (b, m), Eq. 6 to 9."""
        real, imaginary = (acceleration @ matrix[:, : sizes.n_bins] for matrix in dft_matrices(sizes.window))
        power = real * real + imaginary * imaginary
        # Rounding alone is zero: its phase would differ from one processor to the next.
        weakest = WEAKEST_BIN * power.sum(axis=1, keepdims=True)
        real, imaginary = np.where(real**2 > weakest, real, 0.0), np.where(imaginary**2 > weakest, imaginary, 0.0)
        phase = np.arctan2(imaginary, real)
        magnitude = np.sqrt(power + 1e-16)
        magnitude, phase = self._bins(sizes, "magnitude", magnitude), self._bins(sizes, "phase", phase)
        n, k = np.arange(sizes.window), np.arange(sizes.n_bins)
        mirrored = (sizes.bins == "half") & (k >= 1) & (k < (sizes.window + 1) // 2)
        angle = 2 * np.pi * np.outer(k, n) / sizes.window
        weighted = magnitude * np.where(mirrored, 2.0, 1.0) / sizes.window
        return (weighted * np.cos(phase)) @ np.cos(angle) - (weighted * np.sin(phase)) @ np.sin(angle)

    def _bins(self, sizes: SpectralSizes, name: str, numbers: Array) -> Array:
        tokens, lifted = numbers[..., None], sizes.spectral_width > 1
        tokens = self._w.linear(f"spectral.{name}_in", tokens) if lifted else tokens
        tokens = self._encoder(f"spectral.{name}_layer", tokens)
        return (self._w.linear(f"spectral.{name}_out", tokens) if lifted else tokens)[..., 0]

    def _encoder(self, name: str, tokens: Array) -> Array:
        """Encoder layer: tokens (b, n, width) → (b, n, width), Eq. 3 to 5."""
        w, before = self._w, self._sizes.pre_norm
        normed = w.norm(f"{name}.norm_1", tokens) if before else tokens
        hidden = tokens + self._attention(name, normed)
        hidden = hidden if before else w.norm(f"{name}.norm_1", hidden)
        inner = w.norm(f"{name}.norm_2", hidden) if before else hidden
        inner = np.maximum(w.linear(f"{name}.feedforward_in", inner), 0.0)
        hidden = hidden + w.linear(f"{name}.feedforward_out", inner)
        return hidden if before else w.norm(f"{name}.norm_2", hidden)

    def _attention(self, name: str, tokens: Array) -> Array:
        b, n, width = tokens.shape
        n_heads = self._sizes.n_heads if width % self._sizes.n_heads == 0 else 1
        projected = self._w.linear(f"{name}.attention_in", tokens).reshape(b, n, 3, n_heads, -1)
        query, key, value = projected.transpose(2, 0, 3, 1, 4)
        scores = query @ key.transpose(0, 1, 3, 2) / np.sqrt(width // n_heads)
        weights = np.exp(scores - scores.max(axis=-1, keepdims=True))
        mixed = weights / weights.sum(axis=-1, keepdims=True) @ value
        return self._w.linear(f"{name}.attention_out", mixed.transpose(0, 2, 1, 3).reshape(b, n, width))
