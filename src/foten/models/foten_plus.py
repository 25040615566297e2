"""Ours: the paper's network as a correction of a lattice's prediction, and the scale of the excitation."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn

from foten.architecture import HEAVIEST_TAIL, FotenPlusArchitecture
from foten.dsp.lattice import LEAK
from foten.dsp.plane import FORCE_FLOOR
from foten.dsp.tones import (
    LARGEST_INNOVATION,
    LARGEST_STEP,
    LARGEST_VARIANCE,
    LEAST_VARIANCE,
    N_CANDIDATES,
    START_VARIANCE,
)
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
        if architecture.n_tones:
            n_vertices = architecture.n_tone_speed * architecture.n_tone_force
            for name, shape in (
                ("tone_speed_knots", (architecture.n_tone_speed,)),
                ("tone_force_knots", (architecture.n_tone_force,)),
                ("tones", (n_vertices, 2 * architecture.n_tones)),
                # Phase for a mm/s and a sample, its variance for the same, and what a rendering forgets of it in a sample.
                ("tone_motion", (3,)),
            ):
                self.register_buffer(name, torch.zeros(shape, dtype=torch.float64))
        self.level = Scale(architecture.excitation_width).requires_grad_(False)
        self.excitation = Excitation(architecture.excitation_width).requires_grad_(False)

    def forward(self, windows: Tensor) -> Tensor:
        """Return the next samples: windows (b, m, 3) scaled, m the architecture's `history` → (b,) scaled."""
        return self.forecast(self.start(windows))[0]

    def start(self, windows: Tensor) -> Heard:
        """Return the state of streams that have heard the given scaled windows, shape (b, m, 3)."""
        b, m, _ = windows.shape
        samples, condition = windows[:, 1:, 0], windows[:, :-1, 1:]
        rest = torch.zeros(self.architecture.order, b, dtype=windows.dtype, device=windows.device)
        phase = torch.zeros(b, dtype=windows.dtype, device=windows.device)
        if self.architecture.n_tones:
            flat = condition.reshape(-1, 2)
            turned = (self.tone_motion[0] * self._physical(flat)[:, 0]).reshape(b, m - 1).to(windows.dtype)
            level = self.level(flat).reshape(b, m - 1)
            coefficients = self._tones(flat).reshape(b, m - 1, -1) / level[..., None]
            travelled = torch.cumsum(turned, dim=1)
            candidates = 2 * math.pi * torch.arange(N_CANDIDATES, dtype=windows.dtype) / N_CANDIDATES
            missed = [
                (samples / level - _tone(coefficients, travelled + start)[0]).square().sum(dim=1)
                for start in candidates
            ]
            phase = candidates[torch.stack(missed).argmin(dim=0)]
        heard = Heard(
            states=rest,
            slopes=rest,
            phase=phase,
            variance=torch.full_like(phase, START_VARIANCE),
            path=torch.zeros_like(phase),
            condition=windows[:, 0, 1:],
            seen=torch.zeros(b, self.architecture.window, 4, dtype=windows.dtype, device=windows.device),
        )
        for n in range(1, m):
            heard = self._take_in(heard, windows[:, n, 0], windows[:, n, 1:], own=False)
        if not self.architecture.n_tones:
            return heard
        speed = self._physical(heard.condition)[:, 0].to(phase.dtype)
        return heard._replace(path=-self.tone_motion[0].to(phase.dtype) * speed)

    def forecast(self, heard: Heard) -> tuple[Tensor, Tensor]:
        """Return the next samples, and by how much a unit of excitation moves them: (b,), (b,); scaled."""
        level, k = self.level(heard.condition), self._reflections(heard.condition)
        cosine = torch.sqrt(1 - k * k)
        expected = torch.zeros_like(level)
        for i in reversed(range(k.shape[1])):
            expected = cosine[:, i] * expected - k[:, i] * LEAK * heard.states[i]
        unit = level * cosine.prod(dim=1)
        sample = level * expected + unit * self.network(heard.seen)
        if self.architecture.n_tones:
            sample = sample + self._moved(heard)[1]
        return sample, unit * self.excitation(heard.condition)

    def push(self, heard: Heard, sample: Tensor, condition: Tensor) -> Heard:
        """Return the state after a sample (b,) of the model's own and its speed and force (b, 2), all scaled."""
        return self._take_in(heard, sample, condition, own=True)

    def tone_power(self, condition: Tensor) -> Tensor:
        """Return the mean square of the tones: speed and force (b, 2) scaled → (b,), float64."""
        if not self.architecture.n_tones:
            return torch.zeros(len(condition), dtype=torch.float64)
        return 0.5 * self._tones(condition.double()).square().sum(dim=1)

    def _take_in(self, heard: Heard, sample: Tensor, condition: Tensor, own: bool) -> Heard:
        level, k = self.level(heard.condition), self._reflections(heard.condition)
        value = slope = torch.zeros_like(sample)
        before = heard.condition
        if self.architecture.n_tones:
            heard, value, slope = self._moved(heard)
        x = (sample - value) / level
        states, e = _through(heard.states, k, x)
        seen = torch.cat([x[:, None], condition, e[:, None]], dim=1)
        after = heard._replace(
            states=states, condition=condition, seen=torch.cat([heard.seen[:, 1:], seen[:, None]], dim=1)
        )
        if not self.architecture.n_tones:
            return after
        chance = e.clamp(-LARGEST_INNOVATION, LARGEST_INNOVATION)
        if own:
            turn = 2 * math.pi
            away = heard.phase - heard.path
            away = away - turn * torch.round(away / turn)
            speed = self._physical(before)[:, 0].to(sample.dtype)
            jitter, forgetting = self.tone_motion[1:].to(sample.dtype)
            phase = heard.phase - forgetting * away + torch.sqrt(jitter * speed) * chance
            return after._replace(phase=phase)
        slopes, h = _through(heard.slopes, k, slope / level)
        gain = heard.variance * h / (h * h * heard.variance + 1)
        step = gain * chance
        phase = heard.phase + step.clamp(-LARGEST_STEP, LARGEST_STEP)
        variance = ((1 - gain * h) * heard.variance).clamp(LEAST_VARIANCE, LARGEST_VARIANCE)
        return after._replace(slopes=slopes, phase=phase, variance=variance)

    def _moved(self, heard: Heard) -> tuple[Heard, Tensor, Tensor]:
        """Return the streams a sample further along the path, the tone there and its derivative by the phase."""
        speed = self._physical(heard.condition)[:, 0].to(heard.phase.dtype)
        turn, jitter = self.tone_motion[:2].to(heard.phase.dtype)
        moved = heard._replace(
            phase=heard.phase + turn * speed,
            path=heard.path + turn * speed,
            variance=heard.variance + jitter * speed,
        )
        return moved, *_tone(self._tones(heard.condition), moved.phase)

    def _physical(self, condition: Tensor) -> Tensor:
        return (condition.double() * self.level.sd.double() + self.level.mean.double()).clamp(min=0.0)

    def _reflections(self, condition: Tensor) -> Tensor:
        physical = self._physical(condition)
        return _bilinear(physical, self.speed_knots, self.force_knots, self.reflections).to(condition.dtype)

    def _tones(self, condition: Tensor) -> Tensor:
        physical = self._physical(condition)
        found = _bilinear(physical, self.tone_speed_knots, self.tone_force_knots, self.tones)
        return found.to(condition.dtype)


class Heard(NamedTuple):
    """What streams of foten-plus remember, as `render.engine` has it; `condition` is that of the last sample."""

    states: Tensor
    slopes: Tensor
    phase: Tensor
    variance: Tensor
    path: Tensor
    condition: Tensor
    seen: Tensor


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


def _through(states: Tensor, k: Tensor, x: Tensor) -> tuple[Tensor, Tensor]:
    """Return the lattice's states after x, shape (b,), and its innovation: states (p, b), reflections (b, p)."""
    cosine = torch.sqrt(1 - k * k)
    after, f = [x], x
    for i in range(k.shape[1]):
        b = LEAK * states[i]
        f, backward = (f + k[:, i] * b) / cosine[:, i], (b + k[:, i] * f) / cosine[:, i]
        after.append(backward)
    return torch.stack(after[:-1]), f


def _tone(coefficients: Tensor, phase: Tensor) -> tuple[Tensor, Tensor]:
    """Return T and its derivative by the phase: coefficients (…, 2 n_tones) and phases (…) → (…)."""
    multiples = torch.arange(1, coefficients.shape[-1] // 2 + 1, dtype=phase.dtype, device=phase.device)
    angle = phase[..., None] * multiples
    cosine, sine = torch.cos(angle), torch.sin(angle)
    a, b = coefficients[..., 0::2], coefficients[..., 1::2]
    return (a * cosine + b * sine).sum(dim=-1), (multiples * (b * cosine - a * sine)).sum(dim=-1)


def _bilinear(physical: Tensor, speed_knots: Tensor, force_knots: Tensor, values: Tensor) -> Tensor:
    """Return a table's values (n_v · n_f, k) at speeds [mm/s] and forces [N], (b, 2) → (b, k)."""
    over_speed = _hat_weights(physical[:, 0], speed_knots)
    over_force = _hat_weights(torch.log(physical[:, 1] + FORCE_FLOOR), force_knots)
    return (over_speed[:, :, None] * over_force[:, None, :]).reshape(len(physical), -1) @ values


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


class Scale(nn.Module):
    """A standard deviation that follows the hand: of a vibration, or of what a prediction of it misses.

    A power law of speed and force, times what a small network of both and of their logarithms adds: the level of a texture
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
        # A corner of the plane that the hand hardly visited is no louder than the loudest 3 % of where it was. Ten minutes
        # on jeans: 13.0 standard deviations with the 99th percentile, 11.4 with the 97th; the recording reaches 11.1.
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

    The tails follow speed and force too: impacts are rare when slow and many when fast.

    It does not listen to the window: a σ that did fed the model's own errors back into the loop (measured on a mesh: level error
    1.76 against 1.40 dB).
    """

    def __init__(self, width: int) -> None:
        super().__init__(width)
        self.tail = nn.Linear(5, 1)
        nn.init.zeros_(self.tail.weight)
        nn.init.constant_(self.tail.bias, NO_TAIL)
        # No excitation is larger than the largest that was left to explain.
        self.register_buffer("largest", torch.full((1,), 1e6))

    def tails(self, condition: Tensor) -> Tensor:
        """Return h, from 0 to `HEAVIEST_TAIL`: z·exp(h z²/2) is excitation, z Gaussian; (b, 2) scaled → (b,)."""
        return HEAVIEST_TAIL * torch.sigmoid(self.tail(self.logarithms(condition))[:, 0])
