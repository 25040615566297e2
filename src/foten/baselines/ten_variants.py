"""The other rows of Table II: TEN with cepstral or wavelet coefficients, and FoTEN with a decoder layer."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from foten.baselines.features import MfccBranch, WaveletBranch
from foten.baselines.sizes import FotenDSizes, TenMfccSizes, TenWaveletSizes
from foten.models.foten.network import Foten
from foten.models.foten.transformer import DecoderLayer


class TenMfcc(Foten):
    """TEN with cepstral coefficients of the window in place of a_spec."""

    def __init__(self, sizes: TenMfccSizes) -> None:
        super().__init__(sizes, MfccBranch(sizes), sizes.n_coefficients)


class TenWavelet(Foten):
    """TEN with wavelet coefficients of the window in place of a_spec."""

    def __init__(self, sizes: TenWaveletSizes) -> None:
        branch = WaveletBranch(sizes)
        super().__init__(sizes, branch, branch.transform.shape[1])


class FotenD(Foten):
    """FoTEN with a decoder layer, in which one learned query attends to all temporal tokens and to the single spectral one."""

    def __init__(self, sizes: FotenDSizes) -> None:
        super().__init__(sizes)
        d = sizes.d_model
        self.decoder = DecoderLayer(d, sizes.n_heads, sizes.d_feedforward)
        self.decoded = nn.LayerNorm(d)
        self.query = nn.Parameter(0.02 * torch.randn(1, 1, d))

    def tokens(self, windows: Tensor) -> Tensor:
        """What the query makes of all tokens, and the spectral one: (b, m, 3) scaled → (b, 2, d_model)."""
        (spectral,) = self.spectral_tokens(windows)
        memory = torch.cat([self.temporal(windows[:, :, :1], last_only=False), spectral], dim=1)
        query = self.query + torch.zeros_like(memory[:, :1])  # a length would be a constant of the exported graph
        return torch.cat([self.decoded(self.decoder(query, memory)), spectral], dim=1)
