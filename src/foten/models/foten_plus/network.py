"""The innovation network: how the next one is distributed. Lattice and tones of foten-plus are not trained by gradient."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from foten.models.foten_plus.sizes import LOG_SCALE_LIMIT, N_INPUTS, FotenPlusSizes


class InnovationNetwork(nn.Module):
    """A mixture of Gaussians for the next innovation, from a gated recurrent unit: `models.foten_plus.innovation_network`.

    Before training its means are zero: what it predicts is what the lattice does.
    """

    def __init__(self, sizes: FotenPlusSizes, n_inputs: int = N_INPUTS) -> None:
        super().__init__()
        k = self.n_components = sizes.n_components
        self.recurrent = nn.GRU(n_inputs, sizes.n_hidden, batch_first=True)
        self.head = nn.Linear(sizes.n_hidden + n_inputs, sizes.head_width)
        self.out = nn.Linear(sizes.head_width, 3 * k)
        with torch.no_grad():
            self.out.weight.mul_(0.1)
            self.out.weight[k : 2 * k] = 0.0
            self.out.bias.zero_()
            self.out.bias[2 * k :] = torch.linspace(-1.5, 1.0, k) if k > 1 else 0.0

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Log w, μ and log s after each sample: u (b, n, n_inputs) → (b, n, k) each."""
        hidden, _ = self.recurrent(inputs)
        return self.mixture(hidden, inputs)

    def mixture(self, hidden: Tensor, inputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """log w, μ and log s of the next innovation: from the hidden state after a sample (…, n_hidden), and its inputs."""
        out = self.out(torch.tanh(self.head(torch.cat([hidden, inputs], dim=-1))))
        logit, mean, log_scale = out.split(self.n_components, dim=-1)
        return torch.log_softmax(logit, dim=-1), mean, LOG_SCALE_LIMIT * torch.tanh(log_scale / LOG_SCALE_LIMIT)

    def expected(self, inputs: Tensor) -> Tensor:
        """The mean of the next innovation after each sample: (b, n, n_inputs) → (b, n)."""
        log_weight, mean, _ = self(inputs)
        return (log_weight.exp() * mean).sum(dim=-1)


class NextInnovation(nn.Module):
    """The same for one sample after a window: u (b, m, 5) → (b, 3k), log w, μ and log s in turn."""

    def __init__(self, network: InnovationNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, inputs: Tensor) -> Tensor:
        """The distribution of the innovation after the last sample."""
        return torch.cat([part[:, -1] for part in self.network(inputs)], dim=-1)


def negative_log_likelihood(mixture: tuple[Tensor, Tensor, Tensor], innovation: Tensor) -> Tensor:
    """−log p of innovations [nat]: mixtures (…, k) each, innovations (…) → (…)."""
    log_weight, mean, log_scale = mixture
    z = (innovation[..., None] - mean) * torch.exp(-log_scale)
    constant = 0.9189385332046727  # log √2π
    return constant - torch.logsumexp(log_weight - log_scale - 0.5 * z * z, dim=-1)
