"""The paper's network (Sec. IV): windows in, next samples out."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from foten.baselines.features import MfccBranch, WaveletBranch
from foten.baselines.sizes import FotenDSizes, TenMfccSizes, TenWaveletSizes
from foten.dsp.spectrum import WEAKEST_BIN, dft_matrices, last_sample_row, position_encoding
from foten.models.foten.sizes import SpectralSizes
from foten.models.foten.ten_sizes import TransformerSizes
from foten.models.foten.transformer import DecoderLayer, EncoderLayer
from foten.training.dropout import Dropout


class TemporalBranch(nn.Module):
    """Embedding, positions and encoder layers over the acceleration window (Eq. 2–5)."""

    def __init__(self, sizes: TransformerSizes) -> None:
        super().__init__()
        d = sizes.d_model
        self.embedding = nn.Linear(1, d)
        self.layers = nn.ModuleList(
            EncoderLayer(d, sizes.n_heads, sizes.d_feedforward, sizes.pre_norm) for _ in range(sizes.n_layers)
        )
        self.norm = nn.LayerNorm(d) if sizes.pre_norm else nn.Identity()
        self.dropout = Dropout()
        self.register_buffer("positions", torch.from_numpy(position_encoding(sizes.window, d)), persistent=False)

    def forward(self, samples: Tensor, last_only: bool = True) -> Tensor:
        """Return E_t, or its last token alone: (b, m, 1) scaled → (b, m or 1, d_model)."""
        tokens = self.dropout(self.embedding(samples) + self.positions.to(samples.dtype))
        for layer in self.layers[:-1]:
            tokens = layer(tokens)
        return self.norm(self.layers[-1](tokens, last_only=last_only))


class SpectralBranch(nn.Module):
    """Magnitude and phase through an encoder layer each, and back to time (Eq. 6–9)."""

    def __init__(self, sizes: SpectralSizes) -> None:
        super().__init__()
        m, width = sizes.window, sizes.spectral_width
        lifted = width > 1
        for name in ("magnitude", "phase"):
            self.add_module(f"{name}_in", nn.Linear(1, width) if lifted else nn.Identity())
            layer = EncoderLayer(width, sizes.n_heads, sizes.d_feedforward, sizes.pre_norm)
            self.add_module(f"{name}_layer", layer)
            self.add_module(f"{name}_out", nn.Linear(width, 1) if lifted else nn.Identity())
        real, imaginary = (matrix[:, : sizes.n_bins] for matrix in dft_matrices(m))
        cosine, sine = last_sample_row(m, half=sizes.bins == "half")
        for name, matrix in {"real": real, "imaginary": imaginary, "cosine": cosine, "sine": sine}.items():
            self.register_buffer(name, torch.from_numpy(matrix), persistent=False)

    def forward(self, acceleration: Tensor) -> Tensor:
        """Return Re a_spec[m−1], the only sample that the head sees: (b, m) scaled → (b, 1)."""
        dtype = acceleration.dtype
        real = acceleration @ self.real.to(dtype)
        # −0 would turn the angle of a negative real bin from π to −π.
        imaginary = acceleration @ self.imaginary.to(dtype) + 0.0
        power = real * real + imaginary * imaginary
        # What is nothing but rounding is zero: its phase, or by its sign that of a negative real part (π or −π), would differ
        # from one processor to the next.
        least = WEAKEST_BIN * power.sum(dim=1, keepdim=True)
        real, imaginary = torch.where(real**2 > least, real, 0.0), torch.where(imaginary**2 > least, imaginary, 0.0)
        magnitude = self._encode("magnitude", torch.sqrt(power + 1e-16))
        phase = self._encode("phase", _angle(real, imaginary))
        last_row = self.cosine.to(dtype) * torch.cos(phase) + self.sine.to(dtype) * torch.sin(phase)
        return (magnitude * last_row).sum(dim=1, keepdim=True)

    def _encode(self, name: str, bins: Tensor) -> Tensor:
        encoded = self.get_submodule(f"{name}_layer")(self.get_submodule(f"{name}_in")(bins[..., None]))
        return self.get_submodule(f"{name}_out")(encoded)[..., 0]


def _angle(real: Tensor, imaginary: Tensor) -> Tensor:
    """Return the angle, π of what is real and negative, 0 of nothing."""
    if not torch.onnx.is_in_onnx_export():
        return torch.atan2(imaginary, real)
    # ONNX has no such function; the exporter's stand-in divides by nothing, and gives −π where nothing is imaginary.
    is_real = imaginary == 0
    angle = torch.atan2(imaginary, torch.where(is_real, 1.0, real))
    return torch.where(is_real & (real < 0), math.pi, angle)


class Foten(nn.Module):
    """FoTEN: both branches, fused with speed and force at the last token, and a dense head (Eq. 10, 11).

    Of a `TransformerSizes` it is TEN, the same without the Fourier branch, and of what is derived from that, the other rows of
    Table II: with cepstral or wavelet coefficients in place of a_spec, and, FoTEN-D, with a decoder layer in which one learned
    query attends to all temporal tokens and to the single spectral one, where the others take the last.
    """

    def __init__(self, sizes: TransformerSizes) -> None:
        super().__init__()
        self.sizes = sizes
        d, (first, second) = sizes.d_model, sizes.head
        self.temporal = TemporalBranch(sizes)
        self.spectral = self.spectral_embedding = self.decoder = None
        if isinstance(sizes, SpectralSizes):
            self.spectral, self.spectral_embedding = SpectralBranch(sizes), nn.Linear(1, d)
        elif isinstance(sizes, TenMfccSizes):
            self.spectral, self.spectral_embedding = MfccBranch(sizes), nn.Linear(sizes.n_coefficients, d)
        elif isinstance(sizes, TenWaveletSizes):
            self.spectral = WaveletBranch(sizes)
            self.spectral_embedding = nn.Linear(self.spectral.transform.shape[1], d)
        if isinstance(sizes, FotenDSizes):
            self.decoder = DecoderLayer(d, sizes.n_heads, sizes.d_feedforward)
            self.decoded = nn.LayerNorm(d)
            self.query = nn.Parameter(0.02 * torch.randn(1, 1, d))
        self.head_1 = nn.Linear(sizes.n_features + 2, first)
        self.head_2 = nn.Linear(first, second)
        self.head_3 = nn.Linear(second, 1)
        self.dropout = Dropout()

    def forward(self, windows: Tensor) -> Tensor:
        """Return the next samples: windows (b, m, 3) of scaled acceleration, speed, force → (b,) scaled."""
        tokens = self.temporal(windows[:, :, :1], last_only=self.decoder is None)
        if self.spectral is not None and self.spectral_embedding is not None:
            tokens = torch.cat([tokens, self.spectral_embedding(self.spectral(windows[:, :, 0]))[:, None]], dim=1)
        if self.decoder is not None:
            asked = self.query + torch.zeros_like(tokens[:, :1])  # a length would be a constant of the exported graph
            tokens = torch.cat([self.decoded(self.decoder(asked, tokens)), tokens[:, -1:]], dim=1)
        fused = torch.cat([tokens.flatten(1), windows[:, -1, 1:3]], dim=1)
        hidden = self.dropout(torch.relu(self.head_1(fused)))
        hidden = self.dropout(torch.relu(self.head_2(hidden)))
        return self.head_3(hidden)[:, 0]
