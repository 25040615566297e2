"""DSTN [15]: convolutions and recurrent layers that attend to channels and to time."""

import torch
from torch import Tensor, nn

from foten.training.dropout import Dropout
from foten_lab.baselines.sizes import DstnSizes


class Dstn(nn.Module):
    """Two convolutions, attention over channels and over time, a recurrent encoder both ways, and a decoder of one step.

    Source: Joolee and Jeon, IEEE Trans. Haptics 15 (2022), as far as its abstract and the paper tell ("attention-aware 1D CNN",
    "attention-aware encoder–decoder"); neither states sizes: our re-implementation. Layers are normalised by themselves,
    where batch statistics would differ between training and rendering.
    """

    def __init__(self, sizes: DstnSizes) -> None:
        super().__init__()
        c, r = sizes.channels, sizes.recurrent
        self.convolution_1 = nn.Conv1d(3, c, 5, padding="same")
        self.convolution_2 = nn.Conv1d(c, c, 3, padding="same")
        self.norm_1, self.norm_2 = nn.LayerNorm(c), nn.LayerNorm(c)
        self.squeeze = nn.Linear(c, sizes.squeezed)
        self.excite = nn.Linear(sizes.squeezed, c)
        self.when = nn.Linear(c, 1)
        self.encoder = nn.LSTM(c, r, batch_first=True, bidirectional=True)
        self.condition = nn.Linear(3, r)
        self.query, self.key, self.energy = nn.Linear(r, r), nn.Linear(2 * r, r), nn.Linear(r, 1)
        self.decoder = nn.LSTM(3 + 2 * r, r, batch_first=True)
        self.dense = nn.Linear(3 * r, sizes.dense)
        self.out = nn.Linear(sizes.dense, 1)
        self.dropout = Dropout()

    def forward(self, windows: Tensor) -> Tensor:
        """The next samples: windows (b, m, 3) scaled → (b,) scaled."""
        features = self.convolution_1(windows.transpose(1, 2)).transpose(1, 2)
        features = torch.relu(self.norm_1(features))
        features = self.convolution_2(features.transpose(1, 2)).transpose(1, 2)
        features = self.dropout(torch.relu(self.norm_2(features)))
        # Channels by their mean over time (squeeze and excitation), then moments by what they hold.
        gates = torch.sigmoid(self.excite(torch.relu(self.squeeze(features.mean(dim=1)))))
        features = features * gates[:, None, :]
        # Times m, so that even attention leaves every moment as it was.
        features = features * torch.softmax(self.when(features), dim=1) * features.shape[1]
        encoded, _ = self.encoder(features)
        last = windows[:, -1:]
        query = self.query(torch.tanh(self.condition(last)))
        energy = self.energy(torch.tanh(query + self.key(encoded)))
        context = (torch.softmax(energy, dim=1) * encoded).sum(dim=1)
        decoded, _ = self.decoder(torch.cat([last, context[:, None]], dim=2))
        hidden = torch.relu(self.dense(torch.cat([decoded[:, 0], context], dim=1)))
        return self.out(self.dropout(hidden))[:, 0]
