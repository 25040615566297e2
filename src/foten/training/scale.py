"""Standard deviations over speed and force, fitted by maximum likelihood: levels, and the excitation."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from foten.models.tensor_shapes import HEAVIEST_TAIL


class Scale(nn.Module):
    """A standard deviation that follows the hand: of a vibration, or of what a prediction of it misses.

    A power law of speed and force, corrected by a small network of both and of their logarithms: the level of a texture
    is near a power law, and falls by a factor of ten where speed, in standard deviations, hardly changes.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.hidden = nn.Linear(4, width)
        self.out = nn.Linear(width, 1)
        self.power_law = nn.Linear(5, 1, bias=False)  # exponents of speed and force, and how they change
        # Speed [mm/s] and force [N]: what undoes the scaling, and what a logarithm starts from.
        self.register_buffer("mean", torch.zeros(2))
        self.register_buffer("sd", torch.ones(2))
        self.register_buffer("floor", torch.tensor([2.0, 0.05]))
        # Speeds and forces that were hardly recorded are no louder than the loudest 3 % of the others. Ten minutes on jeans
        # peak at 13.0 standard deviations with the 99th percentile, at 11.4 with the 97th; the recording reaches 11.1.
        self.register_buffer("highest", torch.full((1,), 1e6))

    def forward(self, condition: Tensor) -> Tensor:
        """Return the standard deviation: speed and force (b, 2) scaled → (b,)."""
        logs = self.logarithms(condition)
        features = torch.cat([condition, logs[:, :2]], dim=1)
        log_scale = (self.out(torch.tanh(self.hidden(features))) + self.power_law(logs))[:, 0]
        return torch.minimum(torch.exp(log_scale), self.highest)

    def logarithms(self, condition: Tensor) -> Tensor:
        """Return log speed x and log force y re their means, and x², xy, y²: (b, 2) scaled → (b, 5)."""
        physical = torch.clamp(condition * self.sd + self.mean, min=0.0)
        x, y = torch.log((physical + self.floor) / (self.mean + self.floor)).unbind(dim=1)
        return torch.stack([x, y, x * x, x * y, y * y], dim=1)

    @torch.no_grad()
    def bound(self, condition: Tensor) -> None:
        """Let it nowhere exceed its 97th percentile over some conditions (b, 2) scaled, those of the training blocks."""
        self.highest.fill_(1e6)
        self.highest.copy_(torch.quantile(self(condition), 0.97))


class Excitation(Scale):
    """σ(speed, force), the scale of what is random, in units of the lattice's innovation, and how heavy its tails are.

    The tails follow speed and force too: impacts are rare when slow and many when fast. Neither depends on the window: a σ that
    did fed the model's own errors back into the loop (on a simulated mesh, level error 1.76 against 1.40 dB).
    """

    def __init__(self, width: int) -> None:
        super().__init__(width)
        self.tail = nn.Linear(5, 1)
        nn.init.zeros_(self.tail.weight)
        nn.init.constant_(self.tail.bias, -30.0)  # of which the logistic function is zero
        # No excitation is larger than the largest innovation, in units of σ and in scaled acceleration: in a fast and firm
        # stroke a rare shock of a slow one would be beyond all that was recorded.
        self.register_buffer("largest", torch.full((2,), 1e6))
        # Of `dsp.noise.Volatility`: what is kept of it in a sample, and its standard deviation.
        self.register_buffer("volatility", torch.zeros(2))

    def tails(self, condition: Tensor) -> Tensor:
        """Return h, from 0 to `HEAVIEST_TAIL`: z·exp(h z²/2) is excitation, z Gaussian; (b, 2) scaled → (b,)."""
        return HEAVIEST_TAIL * torch.sigmoid(self.tail(self.logarithms(condition))[:, 0])
