"""HapInf-like: an encoder and a decoder after Informer, the teacher that LDHTD is distilled from."""

import torch
from torch import Tensor, nn

from foten.dsp.spectrum import position_encoding
from foten.models.foten.transformer import DecoderLayer, EncoderLayer
from foten.training.dropout import Dropout
from foten_lab.baselines.sizes import HapinfSizes


class Hapinf(nn.Module):
    """Encoder of acceleration, speed and force, and a decoder of the last tokens and a placeholder for the next sample.

    Source: Informer (Zhou et al., AAAI 2021), without its sparse attention, which has no use in a window of 20 samples. No source
    of HapInf, for which the paper gives no number, was available: our re-implementation.
    """

    def __init__(self, sizes: HapinfSizes) -> None:
        super().__init__()
        self.sizes = sizes
        d, heads, inner = sizes.d_model, sizes.n_heads, sizes.d_feedforward
        self.embedding = nn.Linear(3, d)
        self.encoder = nn.ModuleList(EncoderLayer(d, heads, inner, pre_norm=True) for _ in range(sizes.n_layers))
        self.encoded = nn.LayerNorm(d)
        self.decoder = DecoderLayer(d, heads, inner)
        self.decoded = nn.LayerNorm(d)
        self.out = nn.Linear(d, 1)
        self.dropout = Dropout()
        self.register_buffer("positions", torch.from_numpy(position_encoding(sizes.window + 1, d)), persistent=False)

    def forward(self, windows: Tensor) -> Tensor:
        """The next samples: windows (b, m, 3) scaled → (b,) scaled."""
        m = windows.shape[1]
        positions = self.positions.to(windows.dtype)
        memory = self.dropout(self.embedding(windows) + positions[:m])
        for layer in self.encoder:
            memory = layer(memory)
        # The placeholder has the last known speed and force, and no acceleration.
        placeholder = torch.cat([torch.zeros_like(windows[:, -1:, :1]), windows[:, -1:, 1:]], dim=2)
        decoded = torch.cat([windows[:, m - self.sizes.n_start :], placeholder], dim=1)
        tokens = self.dropout(self.embedding(decoded) + positions[m - self.sizes.n_start :])
        return self.out(self.decoded(self.decoder(tokens, self.encoded(memory))[:, 0]))[:, 0]
