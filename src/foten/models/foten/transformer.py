"""Layers of the Transformer: the encoder's of Eq. 3–5, for all tokens or the last, and the decoder's."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from foten.training.dropout import Dropout


class EncoderLayer(nn.Module):
    """Self-attention and a feed-forward network, each with its residual and normalisation.

    Source: Eq. 3–5, after [17]; hidden layer and heads as Sec. IV-c.
    """

    def __init__(self, width: int, n_heads: int, d_feedforward: int, pre_norm: bool) -> None:
        super().__init__()
        # At the literal width 1 of the spectral branch there is room for one head only.
        self.n_heads = n_heads if width % n_heads == 0 else 1
        self.pre_norm = pre_norm
        self.attention_in = nn.Linear(width, 3 * width)
        self.attention_out = nn.Linear(width, width)
        self.feedforward_in = nn.Linear(width, d_feedforward)
        self.feedforward_out = nn.Linear(d_feedforward, width)
        self.norm_1, self.norm_2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.dropout = Dropout()

    def forward(self, tokens: Tensor, last_only: bool = False) -> Tensor:
        """The encoded tokens: (b, m, width) → (b, m, width), or the last of them alone, (b, 1, width)."""
        normed = self.norm_1(tokens) if self.pre_norm else tokens
        queries = slice(-1, None) if last_only else slice(None)
        hidden = tokens[:, queries] + self.dropout(self._attend(normed, queries))
        hidden = hidden if self.pre_norm else self.norm_1(hidden)
        inner = self.norm_2(hidden) if self.pre_norm else hidden
        fed = self.dropout(self.feedforward_out(self.dropout(torch.relu(self.feedforward_in(inner)))))
        return hidden + fed if self.pre_norm else self.norm_2(hidden + fed)

    def _attend(self, normed: Tensor, queries: slice) -> Tensor:
        width, weight, bias = normed.shape[2], self.attention_in.weight, self.attention_in.bias
        query = nn.functional.linear(normed[:, queries], weight[:width], bias[:width])
        key, value = nn.functional.linear(normed, weight[width:], bias[width:]).chunk(2, dim=-1)
        return self.attention_out(attended(query, key, value, self.n_heads))


class DecoderLayer(nn.Module):
    """Self-attention, attention to a memory and a feed-forward network, each normalised before. Source: [17]."""

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
        """The decoded tokens: (b, n, width) and a memory (b, k, width) → (b, n, width)."""
        query, key, value = self.attention_in(self.norm_1(tokens)).chunk(3, dim=-1)
        hidden = tokens + self.dropout(self.attention_out(attended(query, key, value, self.n_heads)))
        key, value = self.memory_in(memory).chunk(2, dim=-1)
        query = self.query_in(self.norm_2(hidden))
        hidden = hidden + self.dropout(self.memory_out(attended(query, key, value, self.n_heads)))
        inner = self.dropout(torch.relu(self.feedforward_in(self.norm_3(hidden))))
        return hidden + self.dropout(self.feedforward_out(inner))


def attended(query: Tensor, key: Tensor, value: Tensor, n_heads: int) -> Tensor:
    """Scaled dot-product attention in heads (Eq. 3): (b, n, w), (b, k, w), (b, k, w) → (b, n, w)."""
    b, _, width = query.shape
    query, key, value = (x.reshape(b, -1, n_heads, width // n_heads).transpose(1, 2) for x in (query, key, value))
    # Written out: PyTorch's fused attention takes 1.7 times as long for 20 tokens in heads of 8, both ways on one core.
    share = torch.softmax((query * (width // n_heads) ** -0.5) @ key.transpose(2, 3), dim=-1)
    return (share @ value).transpose(1, 2).reshape(b, -1, width)
