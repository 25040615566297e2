"""Ours: the paper's network as a correction of a linear prediction, and the scale of the excitation."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from foten.architecture import FotenPlusArchitecture
from foten.models.foten import Foten


class FotenPlus(nn.Module):
    """A linear shortcut from the acceleration window, a bounded correction by FoTEN, and σ(speed, force).

    With `level` ℓ(v, f) the standard deviation of the shortcut's error, and w the window's acceleration,

        â[n] = linear(w) + ℓ(v, f) · c · tanh(FoTEN(w · ℓ̄/ℓ(v, f), v, f) / c)

    so that the network always sees a vibration of about unit size and answers in units of what the linear prediction
    misses: a slow light stroke is predicted as carefully as a fast hard one, one learning rate suits every texture, and the
    correction is bounded by c ℓ.

    The shortcut and the level are fitted before training (`train.shortcut`, `train.excitation`) and stay as they are:
    neighbouring samples are so alike that a gradient step in the shortcut's coefficients moves the poles of the closed loop.
    The head's last layer starts at zero, so training starts at the linear predictor's error.
    """

    def __init__(self, architecture: FotenPlusArchitecture) -> None:
        super().__init__()
        self.architecture = architecture
        self.network = Foten(architecture)
        nn.init.zeros_(self.network.head_3.weight)
        nn.init.zeros_(self.network.head_3.bias)
        # float64: at 10 kHz the coefficients alternate and reach tens.
        self.register_buffer("shortcut", torch.zeros(architecture.window, dtype=torch.float64))
        self.register_buffer("shortcut_bias", torch.zeros(1, dtype=torch.float64))
        self.register_buffer("mean_level", torch.ones(1))
        self.level = Excitation(architecture.excitation_width).requires_grad_(False)
        self.excitation = Excitation(architecture.excitation_width).requires_grad_(False)

    def linear(self, windows: Tensor) -> Tensor:
        """Return the shortcut's prediction alone: (b, m, 3) scaled → (b,) scaled."""
        return (windows[:, :, 0].double() @ self.shortcut + self.shortcut_bias).to(windows.dtype)

    def correction(self, windows: Tensor) -> Tensor:
        """Return what the network adds: (b, m, 3) scaled → (b,) scaled, within ±`correction_limit` levels."""
        limit = self.architecture.correction_limit
        level = self.level(windows[:, -1, 1:])
        levelled = windows[:, :, 0] * (self.mean_level / level)[:, None]
        answer = self.network(torch.cat([levelled[:, :, None], windows[:, :, 1:]], dim=2))
        return level * limit * torch.tanh(answer / limit)

    def forward(self, windows: Tensor) -> Tensor:
        """Return the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        return self.linear(windows) + self.correction(windows)


class Excitation(nn.Module):
    """The standard deviation of what a prediction misses, σ(speed, force) > 0.

    A power law of speed and force, times what a small network of both and of their logarithms adds: the level of a texture
    is near a power law, and falls by a factor of ten where speed, in standard deviations, hardly changes.

    It does not listen to the window: a σ that did fed the model's own errors back into the loop (measured on a mesh: level error
    1.76 against 1.40 dB).
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
        # A corner of the plane that the hand hardly visited is no louder than the loudest 3 % of where it was. Ten minutes
        # on jeans: 13.0 standard deviations with the 99th percentile, 11.4 with the 97th; the recording reaches 11.1.
        self.register_buffer("highest", torch.full((1,), 1e6))

    def forward(self, condition: Tensor) -> Tensor:
        """Return σ, scaled: speed and force (b, 2) scaled → (b,)."""
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
        """Let σ nowhere exceed its 97th percentile over some conditions (b, 2) scaled, those of the training blocks."""
        self.highest.fill_(1e6)
        self.highest.copy_(torch.quantile(self(condition), 0.97))
