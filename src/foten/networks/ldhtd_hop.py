"""LDHTD [20] as its authors published it, without its images: 20 samples at once from 200 before them."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from foten.dsp.spectrum import position_encoding
from foten.families.graphs import LdhtdHopSizes
from foten.networks.dropout import Dropout
from foten.networks.transformer import EncoderLayer


class LdhtdHop(nn.Module):
    """Speed and force each go through an LSTM and attend to one another; beside the past samples they give a hop of the next.

    Source: the structure and sizes of the authors' code, read and not copied. What their pictures of the surface add is left out,
    since a texture here is one surface, and with it the distillation, which is of the pictures' network alone. The encoder layer
    has a single token, so that its attention is a linear map, as theirs is. Our re-implementation.
    """

    def __init__(self, sizes: LdhtdHopSizes) -> None:
        super().__init__()
        self.hop, r, d = sizes.hop, sizes.recurrent, sizes.d_model
        self.speed, self.force = (nn.LSTM(1, r, num_layers=2, batch_first=True) for _ in range(2))
        self.asked, self.offered, self.value = (nn.Linear(r, r) for _ in range(3))
        self.hand = nn.Linear(2 * r, sizes.condition_width)
        self.embedding = nn.Linear(sizes.window + sizes.condition_width, d)
        self.encoder = EncoderLayer(d, sizes.n_heads, sizes.d_feedforward, pre_norm=False)
        self.out = nn.Linear(d, self.hop)
        self.dropout = Dropout()
        self.register_buffer("position", torch.from_numpy(position_encoding(1, d)[0]), persistent=False)

    def forward(self, windows: Tensor) -> Tensor:
        """Return the samples to come: windows (b, m, 3) scaled → (b, hop) scaled."""
        last = [layer(windows[:, -self.hop :, k : k + 1])[0][:, -1] for k, layer in ((1, self.speed), (2, self.force))]
        tokens = torch.stack(last, dim=1)
        scores = self.asked(tokens) @ self.offered(tokens).transpose(1, 2) * tokens.shape[2] ** -0.5
        hand = self.hand((torch.softmax(scores, dim=2) @ self.value(tokens)).flatten(1))
        token = self.embedding(torch.cat([windows[:, :, 0], hand], dim=1))
        token = self.dropout(token + self.position.to(windows.dtype))
        return self.out(self.encoder(token[:, None])[:, 0])
