"""The other rows of Table II: TEN with cepstral or wavelet coefficients, and FoTEN with a decoder layer."""

import math

import numpy as np
import torch
from torch import Tensor, nn

from foten.dsp import Array
from foten.dsp.spectrum import dft_matrices
from foten.models.foten.network import Foten
from foten.models.foten.transformer import DecoderLayer, EncoderLayer
from foten_lab.baselines.sizes import FotenDSizes, TenMfccSizes, TenWaveletSizes

QUIETEST = 1e-3  # power of a band, scaled, below which its logarithm no longer falls: 40 dB below the vibration


class MfccBranch(nn.Module):
    """Mel-frequency cepstral coefficients: the power spectrum of a Hann window, triangular bands, logarithms, cosine transform.

    Source: Davis and Mermelstein (1980). Mel is all but linear below 500 Hz, so the rate stands for 16 kHz.
    """

    def __init__(self, sizes: TenMfccSizes) -> None:
        super().__init__()
        m, self.n_out = sizes.window, sizes.n_coefficients
        n_bins = m // 2 + 1
        real, imaginary = (matrix[:, :n_bins] for matrix in dft_matrices(m))
        hann = 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(m) + 0.5) / m)
        matrices = {
            "real": hann[:, None] * real,
            "imaginary": hann[:, None] * imaginary,
            "bands": mel_bands(n_bins, sizes.n_bands),
            "cosines": cosine_transform(sizes.n_bands, sizes.n_coefficients),
        }
        for name, matrix in matrices.items():
            self.register_buffer(name, torch.from_numpy(matrix), persistent=False)

    def forward(self, acceleration: Tensor) -> Tensor:
        """The coefficients: (b, m) scaled → (b, n_coefficients)."""
        real, imaginary, bands, cosines = (
            matrix.to(acceleration.dtype) for matrix in (self.real, self.imaginary, self.bands, self.cosines)
        )
        power = (acceleration @ real).square() + (acceleration @ imaginary).square()
        return torch.log(power @ bands + QUIETEST) @ cosines


class WaveletBranch(nn.Module):
    """Coefficients of Daubechies' wavelet with two vanishing moments, level by level, and what remains.

    Source: Daubechies (1988), Mallat's algorithm; beyond its start the window is mirrored.
    """

    def __init__(self, sizes: TenWaveletSizes) -> None:
        super().__init__()
        transform = torch.from_numpy(wavelet_transform(sizes.window, sizes.n_levels))
        self.register_buffer("transform", transform, persistent=False)
        self.n_out = transform.shape[1]

    def forward(self, acceleration: Tensor) -> Tensor:
        """The coefficients: (b, m) scaled → (b, k)."""
        return acceleration @ self.transform.to(acceleration.dtype)


class EncodedBranch(nn.Module):
    """Coefficients of the acceleration through an encoder layer, as FoTEN's magnitude and phase go through one each (Sec. IV-d).

    So that rows of Table II differ by what the branch is given: Sec. VI-d says that all variants have the settings of Sec. IV.
    """

    def __init__(self, coefficients: MfccBranch | WaveletBranch, sizes: TenMfccSizes | TenWaveletSizes) -> None:
        super().__init__()
        self.coefficients, self.n_out, width = coefficients, coefficients.n_out, sizes.spectral_width
        self.lifted, self.projected = nn.Linear(1, width), nn.Linear(width, 1)
        self.layer = EncoderLayer(width, sizes.n_heads, sizes.d_feedforward, sizes.pre_norm)

    def forward(self, acceleration: Tensor) -> Tensor:
        """The encoded coefficients: (b, m) scaled → (b, n_out)."""
        return self.projected(self.layer(self.lifted(self.coefficients(acceleration)[..., None])))[..., 0]


def mel_bands(n_bins: int, n_bands: int) -> Array:
    """Triangular bands, evenly spaced in mel and at least a bin wide, shape (n_bins, n_bands), each adding up to 1."""
    hz = np.linspace(0.0, 8000.0, n_bins)
    edges = np.linspace(0.0, 2595 * math.log10(1 + 8000 / 700), n_bands + 2)
    edges = 700 * (10 ** (edges / 2595) - 1)
    width = hz[1]
    rising = (hz[:, None] - np.minimum(edges[:-2], edges[1:-1] - width)) / np.maximum(edges[1:-1] - edges[:-2], width)
    falling = (np.maximum(edges[2:], edges[1:-1] + width) - hz[:, None]) / np.maximum(edges[2:] - edges[1:-1], width)
    bands = np.maximum(0.0, np.minimum(rising, falling))
    return np.asarray(bands / bands.sum(axis=0))


def cosine_transform(n: int, k: int) -> Array:
    """The first k rows of the orthonormal cosine transform (DCT-II) of n numbers, as columns (n, k)."""
    columns = np.sqrt(2 / n) * np.cos(np.pi / n * (np.arange(n)[:, None] + 0.5) * np.arange(k))
    columns[:, 0] *= math.sqrt(0.5)
    return np.asarray(columns)


def wavelet_transform(m: int, n_levels: int) -> Array:
    """The matrix that takes a window (m,) to its wavelet coefficients, shape (m, k)."""
    root = math.sqrt(3)
    low = np.array([1 + root, 3 + root, 3 - root, 1 - root]) / (4 * math.sqrt(2))
    high = low[::-1] * np.array([1, -1, 1, -1])
    smooth, details = np.eye(m), []
    for _ in range(n_levels):
        n = smooth.shape[1]
        # Samples 2i − 2 … 2i + 1 counted from the end, so that the last sample is always in a coefficient of its own.
        ends = np.arange(n - 1, 0, -2)
        taken = np.abs(ends[:, None] - np.arange(3, -1, -1))
        pieces = smooth[:, taken]
        details.append(pieces @ high)
        smooth = (pieces @ low)[:, ::-1]
    return np.concatenate([*details, smooth], axis=1)


class FotenD(Foten):
    """FoTEN with a decoder layer of one learned query, which attends to all temporal tokens and the spectral one."""

    def __init__(self, sizes: FotenDSizes) -> None:
        super().__init__(sizes)
        d = sizes.d_model
        self.decoder = DecoderLayer(d, sizes.n_heads, sizes.d_feedforward)
        self.decoded = nn.LayerNorm(d)
        self.query = nn.Parameter(0.02 * torch.randn(1, 1, d))

    def tokens(self, windows: Tensor) -> Tensor:
        """The decoded query and the spectral token: (b, m, 3) scaled → (b, 2, d_model)."""
        (spectral,) = self.spectral_tokens(windows)
        memory = torch.cat([self.temporal(windows[:, :, :1], last_only=False), spectral], dim=1)
        query = self.query + torch.zeros_like(memory[:, :1])  # a length would be a constant of the exported graph
        return torch.cat([self.decoded(self.decoder(query, memory)), spectral], dim=1)
