"""The paper's network (Sec. IV): windows in, next samples out."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from foten.architecture import (
    FotenArchitecture,
    FotenDArchitecture,
    TenArchitecture,
    TenMfccArchitecture,
    TenWaveletArchitecture,
)
from foten.dsp.spectrum import WEAKEST_BIN, dft_matrices, last_sample_row, position_encoding
from foten.models.decoder import DecoderLayer
from foten.models.dropout import Dropout
from foten.models.encoder import EncoderLayer
from foten.models.features import MfccBranch, WaveletBranch


class TemporalBranch(nn.Module):
    """Embedding, positions and encoder layers over the acceleration window (Eq. 2–5)."""

    def __init__(self, architecture: TenArchitecture) -> None:
        super().__init__()
        d = architecture.d_model
        self.embedding = nn.Linear(architecture.n_inputs, d)
        self.layers = nn.ModuleList(
            EncoderLayer(
                d,
                architecture.n_heads,
                architecture.d_feedforward,
                architecture.pre_norm,
            )
            for _ in range(architecture.n_layers)
        )
        self.norm = nn.LayerNorm(d) if architecture.pre_norm else nn.Identity()
        self.dropout = Dropout()
        positions = torch.from_numpy(position_encoding(architecture.window, d))
        self.register_buffer("positions", positions, persistent=False)

    def forward(self, samples: Tensor, last_only: bool = True) -> Tensor:
        """Return E_t, or its last token alone: (b, m, n_inputs) scaled → (b, m or 1, d_model)."""
        tokens = self.dropout(self.embedding(samples) + self.positions.to(samples.dtype))
        for layer in self.layers[:-1]:
            tokens = layer(tokens)
        return self.norm(self.layers[-1](tokens, last_only=last_only))


class SpectralBranch(nn.Module):
    """Magnitude and phase through an encoder layer each, and back to time (Eq. 6–9)."""

    def __init__(self, architecture: FotenArchitecture) -> None:
        super().__init__()
        m, width = architecture.window, architecture.spectral_width
        self.phase_input, self.magnitude_input = architecture.phase_input, architecture.magnitude_input
        self.lifted = width > 1
        inputs = {"magnitude": 1, "phase": 2 if architecture.phase_input == "cos_sin" else 1}
        for name, n_inputs in inputs.items():
            self.add_module(f"{name}_in", nn.Linear(n_inputs, width) if self.lifted else nn.Identity())
            layer = EncoderLayer(
                width,
                architecture.n_heads,
                architecture.d_feedforward,
                architecture.pre_norm,
            )
            self.add_module(f"{name}_layer", layer)
            self.add_module(f"{name}_out", nn.Linear(width, 1) if self.lifted else nn.Identity())
        self.bins = (
            nn.Parameter(torch.zeros(architecture.n_bins, width)) if architecture.bin_embedding else None
        )
        real, imaginary = (matrix[:, : architecture.n_bins] for matrix in dft_matrices(m))
        cosine, sine = last_sample_row(m, half=architecture.bins == "half")
        for name, matrix in {"real": real, "imaginary": imaginary, "cosine": cosine, "sine": sine}.items():
            self.register_buffer(name, torch.from_numpy(matrix), persistent=False)

    def forward(self, acceleration: Tensor) -> Tensor:
        """Return Re a_spec[m−1], the only sample that the head sees: (b, m) scaled → (b, 1)."""
        dtype = acceleration.dtype
        real = acceleration @ self.real.to(dtype)
        # −0 would turn the angle of a negative real bin from π to −π.
        imaginary = acceleration @ self.imaginary.to(dtype) + 0.0
        power = real * real + imaginary * imaginary
        # A bin that holds nothing but rounding has no phase: it would differ from one processor to the next.
        heard = power > WEAKEST_BIN * power.sum(dim=1, keepdim=True)
        real, imaginary = torch.where(heard, real, 0.0), torch.where(heard, imaginary, 0.0)
        magnitude = torch.sqrt(power + 1e-16)
        if self.phase_input == "cos_sin":
            phase = torch.stack([real / magnitude, imaginary / magnitude], dim=-1)
        else:
            phase = _angle(real, imaginary)[..., None]
        if self.magnitude_input == "log":
            magnitude = torch.log1p(magnitude)
        encoded_magnitude = self._encode("magnitude", magnitude[..., None])
        encoded_phase = self._encode("phase", phase)
        turned = self.cosine.to(dtype) * torch.cos(encoded_phase) + self.sine.to(dtype) * torch.sin(
            encoded_phase
        )
        return (encoded_magnitude * turned).sum(dim=1, keepdim=True)

    def _encode(self, name: str, tokens: Tensor) -> Tensor:
        lifted = self.get_submodule(f"{name}_in")(tokens)
        if self.bins is not None:
            lifted = lifted + self.bins
        encoded = self.get_submodule(f"{name}_layer")(lifted)
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

    Of a `TenArchitecture` it is TEN, the same without the Fourier branch, and of what is derived from that, the other rows of
    Table II: with cepstral or wavelet coefficients in place of a_spec, and, FoTEN-D, with a decoder layer in which one learned
    query looks at all tokens of both branches, where the others take the last.
    """

    def __init__(self, architecture: TenArchitecture) -> None:
        super().__init__()
        self.architecture = architecture
        n_found, (first, second) = architecture.n_found, architecture.head
        self.temporal = TemporalBranch(architecture)
        d = architecture.d_model
        self.spectral = self.spectral_embedding = self.decoder = None
        if isinstance(architecture, FotenArchitecture):
            self.spectral = SpectralBranch(architecture)
            self.spectral_embedding = nn.Linear(1, d)
        elif isinstance(architecture, TenMfccArchitecture):
            self.spectral = MfccBranch(architecture)
            self.spectral_embedding = nn.Linear(architecture.n_coefficients, d)
        elif isinstance(architecture, TenWaveletArchitecture):
            self.spectral = WaveletBranch(architecture)
            self.spectral_embedding = nn.Linear(self.spectral.transform.shape[1], d)
        if isinstance(architecture, FotenDArchitecture):
            self.decoder = DecoderLayer(d, architecture.n_heads, architecture.d_feedforward)
            self.decoded = nn.LayerNorm(d)
            self.query = nn.Parameter(0.02 * torch.randn(1, 1, d))
        self.head_1 = nn.Linear(n_found + 2, first)
        self.head_2 = nn.Linear(first, second)
        self.head_3 = nn.Linear(second, 1)
        self.dropout = Dropout()
        self.modulation = nn.Linear(2, 2 * n_found) if architecture.modulated else None
        if self.modulation is not None:
            nn.init.zeros_(self.modulation.weight)
            nn.init.zeros_(self.modulation.bias)

    def forward(self, windows: Tensor) -> Tensor:
        """Return the next samples: windows (b, m, 3) of scaled acceleration, speed, force → (b,) scaled.

        Where `n_inputs` is 2, windows are (b, m, 4) with what else the temporal branch sees last; where it is 4, it sees all.
        """
        without_hand = torch.cat([windows[:, :, :1], windows[:, :, 3:]], dim=2)
        seen = windows if self.architecture.n_inputs == 4 else without_hand
        tokens = self.temporal(seen, last_only=self.decoder is None)
        if self.spectral is not None and self.spectral_embedding is not None:
            tokens = torch.cat(
                [tokens, self.spectral_embedding(self.spectral(windows[:, :, 0]))[:, None]], dim=1
            )
        if self.decoder is not None:
            asked = self.query + torch.zeros_like(
                tokens[:, :1]
            )  # a length would be a constant of the exported graph
            tokens = torch.cat([self.decoded(self.decoder(asked, tokens)), tokens[:, -1:]], dim=1)
        found = tokens.flatten(1)
        if self.modulation is not None:
            scale, shift = self.modulation(windows[:, -1, 1:3]).chunk(2, dim=1)
            found = found * (1 + scale) + shift
        fused = torch.cat([found, windows[:, -1, 1:3]], dim=1)
        hidden = self.dropout(torch.relu(self.head_1(fused)))
        hidden = self.dropout(torch.relu(self.head_2(hidden)))
        return self.head_3(hidden)[:, 0]
