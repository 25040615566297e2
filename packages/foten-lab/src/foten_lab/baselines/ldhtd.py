"""LDHTD [20], the student: a recurrent encoder of speed and force and one decoder layer over the acceleration."""

import torch
from torch import Tensor, nn

from foten.dsp.spectrum import position_encoding
from foten.models.foten.transformer import DecoderLayer
from foten.training.dropout import Dropout
from foten_lab.baselines.sizes import LdhtdSizes


class Ldhtd(nn.Module):
    """LSTM over speed and force, to which tokens of the acceleration attend; the last gives the next sample.

    Source: the paper's account of [20], "LSTM-based encoder for action inputs" and "lightweight Transformer-based decoder";
    sizes are our choice: our re-implementation. Public code that fits the abstract of [20] is another system.
    """

    def __init__(self, sizes: LdhtdSizes) -> None:
        super().__init__()
        d = sizes.d_model
        self.condition = nn.LSTM(2, sizes.recurrent, batch_first=True)
        self.condition_out = nn.Linear(sizes.recurrent, d)
        self.embedding = nn.Linear(1, d)
        self.decoder = DecoderLayer(d, sizes.n_heads, sizes.d_feedforward)
        self.decoded = nn.LayerNorm(d)
        self.dense = nn.Linear(d, sizes.dense)
        self.out = nn.Linear(sizes.dense, 1)
        self.dropout = Dropout()
        self.register_buffer("positions", torch.from_numpy(position_encoding(sizes.window, d)), persistent=False)

    def forward(self, windows: Tensor) -> Tensor:
        """The next samples: windows (b, m, 3) scaled → (b,) scaled."""
        memory, _ = self.condition(windows[:, :, 1:])
        tokens = self.dropout(self.embedding(windows[:, :, :1]) + self.positions.to(windows.dtype))
        last = self.decoded(self.decoder(tokens, self.condition_out(memory))[:, 0])
        return self.out(self.dropout(torch.relu(self.dense(last))))[:, 0]
