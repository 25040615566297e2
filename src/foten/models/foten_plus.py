"""Ours: the paper's network as a correction of a lattice's prediction, and the scale of the excitation."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from foten.architecture import HEAVIEST_TAIL, FotenPlusArchitecture
from foten.dsp.lattice import FORCE_FLOOR, LEAK
from foten.models.foten import Foten

NO_TAIL = -30.0  # of which the logistic function is zero


class FotenPlus(nn.Module):
    """A lattice that follows speed and force, a bounded correction of it by FoTEN, and the scale of the excitation.

    With ℓ(v, f) the `level` of the vibration, x = a/ℓ is of about unit size at every speed and force. A lattice whose reflections
    follow v and f (`dsp.lattice`) predicts x and leaves the innovation e, of unit variance; a unit of it is worth Π cᵢ in x. The
    network sees x and e in its window and answers with what of the next innovation it expects:

        â[n] = ℓ · ( lattice(x[n−1], x[n−2], …) + Π cᵢ · c · tanh(FoTEN(x, e, v, f) / c) )

    In the closed loop the excitation σ(v, f) times noise is added to that answer, so the lattice is driven by something
    that is bounded, whatever the network says, and stays bounded itself however speed and force move.

    Level and lattice are fitted before training (`train.lattice`, `train.excitation`) and stay as they are. The head's last layer
    starts at zero, so training starts at the lattice's error.

    Why e is an input: what a tool does after an impact depends on the impact, which is one large innovation that the
    acceleration hides under ringing (simulated styrofoam, share of the best AR's error: 0.96 without it, 0.94 with it).
    """

    def __init__(self, architecture: FotenPlusArchitecture) -> None:
        super().__init__()
        self.architecture = architecture
        self.network = Corrector(architecture)
        n_vertices = architecture.n_speed * architecture.n_force
        # float64: at 10 kHz reflections reach 0.9999.
        self.register_buffer("speed_knots", torch.zeros(architecture.n_speed, dtype=torch.float64))
        self.register_buffer("force_knots", torch.zeros(architecture.n_force, dtype=torch.float64))
        self.register_buffer("reflections", torch.zeros(n_vertices, architecture.order, dtype=torch.float64))
        self.level = Excitation(architecture.excitation_width).requires_grad_(False)
        self.excitation = Excitation(architecture.excitation_width).requires_grad_(False)

    def forward(self, windows: Tensor) -> Tensor:
        """Return the next samples: windows (b, m, 3) scaled, m the architecture's `history` → (b,) scaled."""
        return self.forecast(windows)[0]

    def forecast(self, windows: Tensor) -> tuple[Tensor, Tensor]:
        """Return the next samples, and by how much a unit of excitation moves them: (b, m, 3) → (b,), (b,); scaled."""
        b, m, _ = windows.shape
        condition = windows[:, :, 1:]
        level = self.level(condition.reshape(-1, 2)).reshape(b, m)
        k = self._reflections(condition.reshape(-1, 2)).reshape(b, m, -1).to(windows.dtype)
        cosine = torch.sqrt(1 - k * k)
        # A sample's level and reflections are those of the speed and force before it.
        x = windows[:, 1:, 0] / level[:, :-1]
        forward = backward = x
        states = []
        for i in range(k.shape[2]):
            states.append(backward[:, -1])
            delayed = LEAK * torch.cat([torch.zeros_like(x[:, :1]), backward[:, :-1]], dim=1)
            ki, ci = k[:, :-1, i], cosine[:, :-1, i]
            forward, backward = (forward + ki * delayed) / ci, (delayed + ki * forward) / ci
        expected = torch.zeros_like(x[:, 0])
        for i in reversed(range(k.shape[2])):
            expected = cosine[:, -1, i] * expected - k[:, -1, i] * LEAK * states[i]
        seen = torch.cat([x[:, :, None], condition[:, 1:], forward[:, :, None]], dim=2)
        unit = level[:, -1] * cosine[:, -1].prod(dim=1)
        correction = self.network(seen[:, -self.architecture.window :])
        return level[:, -1] * expected + unit * correction, unit * self.excitation(condition[:, -1])

    def _reflections(self, condition: Tensor) -> Tensor:
        physical = condition.double() * self.level.sd.double() + self.level.mean.double()
        over_speed = _hat_weights(physical[:, 0], self.speed_knots)
        logs = torch.log(torch.clamp(physical[:, 1], min=0.0) + FORCE_FLOOR)
        weights = over_speed[:, :, None] * _hat_weights(logs, self.force_knots)[:, None, :]
        return weights.reshape(len(condition), -1) @ self.reflections


class Corrector(Foten):
    """The paper's network, its answer bounded: windows (b, m, 4) of x, speed, force, e → innovations (b,)."""

    def __init__(self, architecture: FotenPlusArchitecture) -> None:
        super().__init__(architecture)
        self.limit = architecture.correction_limit
        nn.init.zeros_(self.head_3.weight)
        nn.init.zeros_(self.head_3.bias)

    def forward(self, windows: Tensor) -> Tensor:
        """Return what of the next innovation is to be expected, within ±`correction_limit`."""
        return self.limit * torch.tanh(super().forward(windows) / self.limit)


def _hat_weights(values: Tensor, knots: Tensor) -> Tensor:
    """Return the weights of linear interpolation between knots, the end ones outside: (n,), (k,) → (n, k)."""
    if len(knots) == 1:
        return torch.ones(len(values), 1, dtype=knots.dtype, device=knots.device)
    inside = torch.clamp(values, knots[0], knots[-1])
    left = torch.clamp(torch.searchsorted(knots, inside, right=True) - 1, 0, len(knots) - 2)
    share = (inside - knots[left]) / (knots[left + 1] - knots[left])
    weights = torch.zeros(len(values), len(knots), dtype=knots.dtype, device=knots.device)
    return weights.scatter(1, left[:, None], (1 - share)[:, None]).scatter(
        1, left[:, None] + 1, share[:, None]
    )


class Excitation(nn.Module):
    """The standard deviation of what a prediction misses, σ(speed, force) > 0.

    A power law of speed and force, times what a small network of both and of their logarithms adds: the level of a texture
    is near a power law, and falls by a factor of ten where speed, in standard deviations, hardly changes.

    What it scales may have heavy tails, which follow speed and force too: impacts are rare when slow and many when fast.

    It does not listen to the window: a σ that did fed the model's own errors back into the loop (measured on a mesh: level error
    1.76 against 1.40 dB).
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.hidden = nn.Linear(4, width)
        self.out = nn.Linear(width, 1)
        self.power_law = nn.Linear(5, 1, bias=False)  # exponents of speed and force, and how they change
        self.tail = nn.Linear(5, 1)
        nn.init.zeros_(self.tail.weight)
        nn.init.constant_(self.tail.bias, NO_TAIL)
        # Speed [mm/s] and force [N]: what undoes the scaling, and what a logarithm starts from.
        self.register_buffer("mean", torch.zeros(2))
        self.register_buffer("sd", torch.ones(2))
        self.register_buffer("floor", torch.tensor([2.0, 0.05]))
        # A corner of the plane that the hand hardly visited is no louder than the loudest 3 % of where it was. Ten minutes
        # on jeans: 13.0 standard deviations with the 99th percentile, 11.4 with the 97th; the recording reaches 11.1.
        self.register_buffer("highest", torch.full((1,), 1e6))
        # No excitation is larger than the largest that was left to explain.
        self.register_buffer("largest", torch.full((1,), 1e6))

    def forward(self, condition: Tensor) -> Tensor:
        """Return σ, scaled: speed and force (b, 2) scaled → (b,)."""
        logs = self.logarithms(condition)
        features = torch.cat([condition, logs[:, :2]], dim=1)
        log_scale = (self.out(torch.tanh(self.hidden(features))) + self.power_law(logs))[:, 0]
        return torch.minimum(torch.exp(log_scale), self.highest)

    def tails(self, condition: Tensor) -> Tensor:
        """Return h, from 0 to 0.4, with which z·exp(h z²/2) is excitation, z Gaussian: (b, 2) scaled → (b,)."""
        return HEAVIEST_TAIL * torch.sigmoid(self.tail(self.logarithms(condition))[:, 0])

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
