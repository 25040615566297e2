"""The paper's network (Sec. IV): windows in, next samples out."""

import math

import torch
from torch import Tensor, nn

from foten.dsp.spectrum import WEAKEST_BIN, dft_matrices, last_sample_row, position_encoding
from foten.models.foten.sizes import SpectralSizes, TransformerSizes
from foten.models.foten.transformer import EncoderLayer
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
        """E_t, or its last token alone: (b, m, 1) scaled → (b, m or 1, d_model)."""
        tokens = self.dropout(self.embedding(samples) + self.positions.to(samples.dtype))
        for layer in self.layers[:-1]:
            tokens = layer(tokens)
        return self.norm(self.layers[-1](tokens, last_only=last_only))


class SpectralBranch(nn.Module):
    """Magnitude and phase through an encoder layer each, and back to time (Eq. 6–9)."""

    n_out = 1

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
        """Re a_spec[m−1], the only sample that the head sees: (b, m) scaled → (b, 1)."""
        dtype = acceleration.dtype
        real = acceleration @ self.real.to(dtype)
        # −0 would turn the angle of a negative real bin from π to −π.
        imaginary = acceleration @ self.imaginary.to(dtype) + 0.0
        power = real * real + imaginary * imaginary
        # Rounding alone is zero: its phase would differ from one processor to the next.
        weakest = WEAKEST_BIN * power.sum(dim=1, keepdim=True)
        real, imaginary = torch.where(real**2 > weakest, real, 0.0), torch.where(imaginary**2 > weakest, imaginary, 0.0)
        magnitude = self._encode("magnitude", torch.sqrt(power + 1e-16))
        phase = self._encode("phase", _angle(real, imaginary))
        last_row = self.cosine.to(dtype) * torch.cos(phase) + self.sine.to(dtype) * torch.sin(phase)
        return (magnitude * last_row).sum(dim=1, keepdim=True)

    def _encode(self, name: str, bins: Tensor) -> Tensor:
        encoded = self.get_submodule(f"{name}_layer")(self.get_submodule(f"{name}_in")(bins[..., None]))
        return self.get_submodule(f"{name}_out")(encoded)[..., 0]


def _angle(real: Tensor, imaginary: Tensor) -> Tensor:
    """The angle; π of negative real bins, 0 of zero."""
    if not torch.onnx.is_in_onnx_export():
        return torch.atan2(imaginary, real)
    # The exporter's stand-in divides by zero, and gives −π where nothing is imaginary.
    is_real = imaginary == 0
    angle = torch.atan2(imaginary, torch.where(is_real, 1.0, real))
    return torch.where(is_real & (real < 0), math.pi, angle)


class Foten(nn.Module):
    """FoTEN: both branches, fused with speed and force at the last token, and a dense head (Eq. 10, 11).

    Without a Fourier branch it is TEN. Other rows of Table II give another branch: acceleration (b, m) → (b, branch.n_out).
    """

    def __init__(self, sizes: TransformerSizes, branch: nn.Module | None = None) -> None:
        super().__init__()
        self.sizes = sizes
        d, (first, second) = sizes.d_model, sizes.head
        self.temporal = TemporalBranch(sizes)
        self.spectral = SpectralBranch(sizes) if branch is None and isinstance(sizes, SpectralSizes) else branch
        self.spectral_embedding = None if self.spectral is None else nn.Linear(self.spectral.n_out, d)
        self.head_1 = nn.Linear(sizes.n_features + 2, first)
        self.head_2 = nn.Linear(first, second)
        self.head_3 = nn.Linear(second, 1)
        self.dropout = Dropout()

    def tokens(self, windows: Tensor) -> Tensor:
        """Tokens of the branches for the head: (b, m, 3) scaled → (b, n_branches, d_model)."""
        return torch.cat([self.temporal(windows[:, :, :1]), *self.spectral_tokens(windows)], dim=1)

    def spectral_tokens(self, windows: Tensor) -> list[Tensor]:
        """The single token of the other branch, (b, 1, d_model), where there is one."""
        if self.spectral is None or self.spectral_embedding is None:
            return []
        return [self.spectral_embedding(self.spectral(windows[:, :, 0]))[:, None]]

    def forward(self, windows: Tensor) -> Tensor:
        """The next samples: windows (b, m, 3) of scaled acceleration, speed, force → (b,) scaled."""
        fused = torch.cat([self.tokens(windows).flatten(1), windows[:, -1, 1:3]], dim=1)
        hidden = self.dropout(torch.relu(self.head_1(fused)))
        hidden = self.dropout(torch.relu(self.head_2(hidden)))
        return self.head_3(hidden)[:, 0]
