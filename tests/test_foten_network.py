"""The paper's network in PyTorch and in NumPy, beside its equations."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn import TransformerEncoderLayer
from torch.nn.functional import layer_norm, linear

from conftest import SMALL, untrained
from foten.models.foten.definition import Network
from foten.models.foten.sizes import FotenSizes
from foten.training.texture_builder import tensors_of
from foten_lab.baselines.networks import build

SIZES = {
    "paper": FotenSizes(),
    "post-norm": FotenSizes(**SMALL, pre_norm=False),
    "literal-width": FotenSizes(**{**SMALL, "spectral_width": 1}),
    "literal-width-post-norm": FotenSizes(**{**SMALL, "spectral_width": 1}, pre_norm=False),
    "window-5": FotenSizes(**SMALL, window=5),
    "window-30": FotenSizes(**SMALL, window=30),
    "one-layer": FotenSizes(**{**SMALL, "n_layers": 1}),
}


class Equations:
    """Eq. 2 to 11 as they are written: all m queries of every layer, the whole complex inverse transform, all tokens.

    They share nothing with either network but the names of its parameters.
    """

    def __init__(self, network: torch.nn.Module, sizes: FotenSizes) -> None:
        self.w = network.state_dict()
        self.sizes = sizes

    def affine(self, name: str, x: Tensor) -> Tensor:
        return linear(x, self.w[f"{name}.weight"], self.w[f"{name}.bias"])

    def layer(self, name: str, x: Tensor) -> Tensor:
        """Eq. 3 to 5, by PyTorch's own layer."""
        sizes, width = self.sizes, x.shape[-1]
        n_heads = sizes.n_heads if width % sizes.n_heads == 0 else 1
        options = {"dropout": 0.0, "batch_first": True, "norm_first": sizes.pre_norm, "dtype": torch.float64}
        layer = TransformerEncoderLayer(width, n_heads, sizes.d_feedforward, **options)
        names = {"self_attn.in_proj_": "attention_in.", "self_attn.out_proj.": "attention_out."}
        names |= {"linear1.": "feedforward_in.", "linear2.": "feedforward_out."}
        names |= {"norm1.": "norm_1.", "norm2.": "norm_2."}
        parts = [(theirs + part, ours + part) for theirs, ours in names.items() for part in ("weight", "bias")]
        layer.load_state_dict({theirs: self.w[f"{name}.{ours}"] for theirs, ours in parts})
        return layer(x).detach()

    def temporal(self, a: Tensor) -> Tensor:
        m, d = a.shape[1], self.sizes.d_model
        positions = torch.zeros(m, d, dtype=torch.float64)
        for pos in range(m):
            for i in range(d // 2):
                positions[pos, 2 * i] = math.sin(pos * 10000 ** (-2 * i / d))
                positions[pos, 2 * i + 1] = math.cos(pos * 10000 ** (-2 * i / d))
        x = self.affine("temporal.embedding", a[..., None]) + positions
        for i in range(self.sizes.n_layers):
            x = self.layer(f"temporal.layers.{i}", x)
        if not self.sizes.pre_norm:
            return x
        return layer_norm(x, x.shape[-1:], self.w["temporal.norm.weight"], self.w["temporal.norm.bias"], 1e-5)

    def encode(self, name: str, tokens: Tensor) -> Tensor:
        if self.sizes.spectral_width > 1:
            tokens = self.affine(f"spectral.{name}_in", tokens)
        tokens = self.layer(f"spectral.{name}_layer", tokens)
        if self.sizes.spectral_width > 1:
            tokens = self.affine(f"spectral.{name}_out", tokens)
        return tokens[..., 0]

    def spectral(self, a: Tensor) -> Tensor:
        z = torch.fft.fft(a)  # Eq. 6
        magnitude, phase = (z.abs(), torch.atan2(z.imag + 0.0, z.real))  # Eq. 7; a real bin's angle is 0 or π, not −π
        encoded = torch.polar(torch.ones_like(phase), self.encode("phase", phase[..., None]))
        encoded = self.encode("magnitude", magnitude[..., None]) * encoded  # Eq. 8
        return torch.fft.ifft(encoded).real  # Eq. 9

    def __call__(self, windows: Tensor) -> Tensor:
        a = windows[..., 0]
        e_s = self.affine("spectral_embedding", self.spectral(a)[..., None])  # Eq. 10
        fused = torch.cat([self.temporal(a), e_s, windows[..., 1:]], dim=-1)  # Eq. 11
        x = fused[:, -1]
        for name in ("head_1", "head_2"):
            x = torch.relu(self.affine(name, x))
        return self.affine("head_3", x)[:, 0]


def windows(sizes: FotenSizes, n: int = 40, seed: int = 0) -> Tensor:
    rng = np.random.default_rng(seed)
    return torch.from_numpy(rng.standard_normal((n, sizes.window, 3)))


@pytest.mark.parametrize("name", SIZES)
def test_the_pruned_network_is_the_papers(name: str) -> None:
    """Oracle: an unpruned network of the paper's equations, in float64; the reference in NumPy is beside it too."""
    sizes = SIZES[name]
    network = untrained("foten", sizes).double()
    inputs = windows(sizes)
    with torch.no_grad():
        predicted = network(inputs)
    expected = Equations(network, sizes)(inputs)
    assert expected.std() > 1e-3  # or there would be nothing to compare
    # Rounding through six layers, and √(|Z|² + 1e-16), which is 5e-17/|Z| off.
    np.testing.assert_allclose(predicted, expected, atol=1e-10)
    np.testing.assert_allclose(Network(sizes, tensors_of(network))(inputs.numpy()), expected, atol=1e-10)


def n_parameters(network: torch.nn.Module) -> int:
    return sum(parameter.numel() for parameter in network.parameters())


def test_it_has_the_papers_sizes() -> None:
    def dense(inputs: int, outputs: int) -> int:
        return inputs * outputs + outputs

    layer = 4 * dense(32, 32) + dense(32, 128) + dense(128, 32) + 2 * 64  # Eq. 3 to 5, feed-forward, two norms
    temporal = dense(1, 32) + 3 * layer + 64  # embedding, three layers, the last norm
    spectral = 2 * (dense(1, 32) + layer + dense(32, 1)) + dense(1, 32)
    head = dense(2 * 32 + 2, 256) + dense(256, 64) + dense(64, 1)
    n = n_parameters(build(FotenSizes()))
    assert n == temporal + spectral + head
    assert n == pytest.approx(97_500, rel=0.005)
    assert n == sum(math.prod(shape) for shape in FotenSizes().tensor_shapes().values())


@pytest.mark.parametrize("pre_norm", [True, False])
def test_the_literal_width_of_one_is_degenerate(pre_norm: bool) -> None:
    """A layer normalisation over one feature gives its bias, so the encoders add a constant, or are one."""
    sizes = FotenSizes(**{**SMALL, "spectral_width": 1}, pre_norm=pre_norm)
    branch = untrained("foten", sizes).double().spectral
    inputs = torch.from_numpy(np.random.default_rng(0).uniform(0, 9, (30, sizes.window)))
    for name in ("magnitude", "phase"):
        with torch.no_grad():
            left = branch._encode(name, inputs) - inputs * pre_norm
        assert left.std() < 1e-12  # rounding
    wide = untrained("foten", FotenSizes(**SMALL, pre_norm=pre_norm)).double().spectral
    with torch.no_grad():
        assert (wide._encode("magnitude", inputs) - inputs * pre_norm).std() > 1e-3


@pytest.mark.parametrize("fields", [{}, {"pre_norm": False}, {"spectral_width": 1}])
def test_silence_has_finite_gradients(fields: dict[str, object]) -> None:
    """|Z| = 0 is where √ has no derivative and the angle none either."""
    sizes = FotenSizes(**fields)  # type: ignore[arg-type]
    network = untrained("foten", sizes).train()
    network(torch.zeros(4, sizes.window, 3)).sum().backward()
    gradients = [p.grad for p in network.parameters() if p.requires_grad]
    assert all(gradient is not None and torch.isfinite(gradient).all() for gradient in gradients)
    assert any(gradient.abs().max() > 0 for gradient in gradients if gradient is not None)
