"""The Transformer decoder layer after [17]: its tokens attend to each other, then to a memory."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from foten.networks.dropout import Dropout


class DecoderLayer(nn.Module):
    """Self-attention, attention to a memory and a feed-forward network, each normalised before and added to its input."""

    def __init__(self, width: int, n_heads: int, d_feedforward: int) -> None:
        super().__init__()
        self.n_heads = n_heads
        self.attention_in = nn.Linear(width, 3 * width)
        self.attention_out = nn.Linear(width, width)
        self.query_in = nn.Linear(width, width)
        self.memory_in = nn.Linear(width, 2 * width)
        self.memory_out = nn.Linear(width, width)
        self.feedforward_in = nn.Linear(width, d_feedforward)
        self.feedforward_out = nn.Linear(d_feedforward, width)
        self.norm_1, self.norm_2, self.norm_3 = (nn.LayerNorm(width) for _ in range(3))
        self.dropout = Dropout()

    def forward(self, tokens: Tensor, memory: Tensor) -> Tensor:
        """Return the decoded tokens: (b, n, width) and a memory (b, k, width) → (b, n, width)."""
        query, key, value = self.attention_in(self.norm_1(tokens)).chunk(3, dim=-1)
        hidden = tokens + self.dropout(self.attention_out(attended(query, key, value, self.n_heads)))
        key, value = self.memory_in(memory).chunk(2, dim=-1)
        query = self.query_in(self.norm_2(hidden))
        hidden = hidden + self.dropout(self.memory_out(attended(query, key, value, self.n_heads)))
        inner = self.dropout(torch.relu(self.feedforward_in(self.norm_3(hidden))))
        return hidden + self.dropout(self.feedforward_out(inner))


def attended(query: Tensor, key: Tensor, value: Tensor, n_heads: int) -> Tensor:
    """Return values by how their keys meet the queries, in heads: (b, n, w), (b, k, w), (b, k, w) → (b, n, w)."""
    b, _, width = query.shape
    query, key, value = (x.reshape(b, -1, n_heads, width // n_heads).transpose(1, 2) for x in (query, key, value))
    share = torch.softmax((query * (width // n_heads) ** -0.5) @ key.transpose(2, 3), dim=-1)
    return (share @ value).transpose(1, 2).reshape(b, -1, width)
