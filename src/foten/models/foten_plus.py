"""Ours: the paper's network as a correction of a linear prediction, and the scale of the excitation."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from foten.architecture import FotenPlusArchitecture
from foten.models.foten import Foten


class FotenPlus(nn.Module):
    """A linear shortcut from the acceleration window, a bounded correction by FoTEN, and σ(speed, force).

    The shortcut is fitted by least squares before training (`train.shortcut`) and stays as it is: neighbouring
    samples are so alike that a gradient step in its coefficients moves the poles of the closed loop. The head's last
    layer starts at zero, so training starts at the linear predictor's error.
    """

    def __init__(self, architecture: FotenPlusArchitecture) -> None:
        super().__init__()
        self.architecture = architecture
        self.network = Foten(architecture)
        nn.init.zeros_(self.network.head_3.weight)
        nn.init.zeros_(self.network.head_3.bias)
        # float64: at 10 kHz the coefficients alternate and reach tens.
        self.register_buffer("shortcut", torch.zeros(architecture.window, dtype=torch.float64))
        self.register_buffer("shortcut_bias", torch.zeros((), dtype=torch.float64))
        self.register_buffer("correction_scale", torch.ones(()))
        self.excitation = Excitation(architecture.excitation_width)

    def linear(self, windows: Tensor) -> Tensor:
        """Return the shortcut's prediction alone: (b, m, 3) scaled → (b,) scaled."""
        return (windows[:, :, 0].double() @ self.shortcut + self.shortcut_bias).to(windows.dtype)

    def correction(self, windows: Tensor) -> Tensor:
        """Return what the network adds: (b, m, 3) scaled → (b,) scaled.

        Counted in standard deviations of the shortcut's error, `correction_scale`, and bounded to ±`correction_limit` of them:
        one learning rate then suits textures whose linear error is 0.04 as well as 0.7, and the loop cannot run away.
        """
        limit = self.architecture.correction_limit
        return self.correction_scale * limit * torch.tanh(self.network(windows) / limit)

    def forward(self, windows: Tensor) -> Tensor:
        """Return the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        return self.linear(windows) + self.correction(windows)


class Excitation(nn.Module):
    """The standard deviation of what the prediction misses, σ(speed, force) > 0.

    It does not listen to the window: a σ that did fed the model's own errors back into the loop (measured on a mesh: level error
    1.76 against 1.40 dB).
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.hidden = nn.Linear(2, width)
        self.out = nn.Linear(width, 1)

    def forward(self, condition: Tensor) -> Tensor:
        """Return σ, scaled: speed and force (b, 2) scaled → (b,)."""
        return torch.exp(self.out(torch.tanh(self.hidden(condition)))[:, 0])
