"""Ours: the paper's network as a correction of a lattice's prediction, and the scale of the excitation."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn

from foten.architecture import HEAVIEST_TAIL, FotenPlusArchitecture
from foten.dsp.lattice import LEAK
from foten.dsp.plane import FORCE_FLOOR
from foten.dsp.tones import LARGEST_STRAY, N_CANDIDATES
from foten.models.foten import Foten

NO_TAIL = -30.0  # of which the logistic function is zero


class FotenPlus(nn.Module):
    """A lattice that follows speed and force, a bounded correction of it by FoTEN, and an excitation; tones where it repeats.

    With ℓ(v, f) the `level` of the vibration, x = a/ℓ is of about unit size at every speed and force. A lattice whose reflections
    follow v and f (`dsp.lattice`) predicts x and leaves the innovation e, of unit variance; a unit of it is worth Π cᵢ in x. The
    network sees x, e, v and f at each sample of its window and answers with what of the next innovation it expects:

        â[n] = ℓ · ( lattice(x[n−1], x[n−2], …) + Π cᵢ · L · tanh(FoTEN(x, e, v, f) / L) )

    Where `level_drives`, the lattice predicts a itself and ℓ e drives it: â[n] = lattice(a[n−1], …) + ℓ · Π cᵢ · L · tanh(…).
    What rang before then rings on as loud as it was, and not as loud as the hand is by now. Which of both predicts better is
    found in training (`train.lattice`).

    In the closed loop ℓ · Π cᵢ · σ(v, f) times heavy-tailed noise that swells is added to that answer. The lattice is driven by
    at most E = L + σ · (largest swell) · (largest shock), times the largest ℓ where the level drives it, whatever the network
    says, and stays bounded itself however speed and force move: its energy settles below E²/(1 − leak²), `dsp.lattice`.

    Whether a rendering hears the network is chosen on the validation blocks (`train.train`): what makes the next sample
    likelier does not always bring the free run nearer. A surface that repeats is rendered otherwise: tones of the path
    (`dsp.tones`), plus a lattice of its own for the `rest`, excited by chance alone. Its next sample is still predicted as
    above, from what was heard.

    Level, lattices and tones are fitted before training (`train.lattice`, `train.tones`, `train.excitation`) and stay as they
    are. The head's last layer starts at zero, so training starts at the lattice's error.

    Why e is an input: what a tool does after an impact depends on the impact, which is one large innovation that the
    acceleration hides under ringing (in a trial on simulated styrofoam, over the best AR's error: 0.96 without it, 0.94 with it).
    """

    def __init__(self, architecture: FotenPlusArchitecture) -> None:
        super().__init__()
        self.architecture = architecture
        self.network = Corrector(architecture)
        width = architecture.excitation_width
        self.lattice = Lattice(
            architecture.n_speed, architecture.n_force, architecture.order, width, architecture.level_drives
        )
        if architecture.n_tones:
            self.tones = Tones(architecture)
            self.rest = Lattice(
                architecture.n_rest_speed,
                architecture.n_rest_force,
                architecture.rest_order,
                width,
                architecture.rest_level_drives,
            )
        self.excitation = Excitation(width).requires_grad_(False)

    @property
    def excited(self) -> Lattice:
        """Return the lattice that a rendering excites."""
        return self.rest if self.architecture.n_tones else self.lattice

    def forward(self, windows: Tensor) -> Tensor:
        """Return the next samples: windows (b, m, 3) scaled, m the architecture's `history` → (b,) scaled."""
        return self._expected(self._heard(windows, self.lattice))[0]

    def start(self, windows: Tensor) -> Heard:
        """Return the state of a rendering that goes on from the given scaled windows, shape (b, m, 3)."""
        if not self.architecture.n_tones:
            return self._heard(windows, self.lattice)
        samples, condition = windows[:, 1:, 0], windows[:, :-1, 1:]
        shape, flat = samples.shape, condition.reshape(-1, 2)
        turned = self._turn(flat).reshape(shape).to(windows.dtype)
        travelled = torch.cumsum(turned, dim=1)
        level = self.lattice.level(flat).reshape(shape)
        coefficients = self._tones_at(flat).reshape(*shape, -1)
        candidates = 2 * math.pi * torch.arange(N_CANDIDATES, dtype=windows.dtype) / N_CANDIDATES
        missed = [
            ((samples - _tone(coefficients, travelled + start)) / level).square().sum(dim=1)
            for start in candidates
        ]
        return self._heard(windows, self.rest, candidates[torch.stack(missed).argmin(dim=0)])

    def forecast(self, heard: Heard) -> tuple[Tensor, Tensor]:
        """Return the next samples of a rendering, and by how much a unit of excitation moves them: (b,), (b,); scaled."""
        if not self.architecture.n_tones:
            sample, unit = self._expected(heard, self.architecture.network_heard)
            return sample, unit * self.excitation(heard.condition)
        sample, unit = self.rest.forecast(heard.states, heard.condition)
        sample = sample + _tone(self._tones_at(heard.condition), self._moved(heard).phase)
        return sample, unit * self.excitation(heard.condition)

    def push(self, heard: Heard, sample: Tensor, condition: Tensor) -> Heard:
        """Return the state after a rendered sample (b,) and its speed and force (b, 2), all scaled."""
        before = heard.condition
        heard, e = self._take_in(heard, self.excited, sample, condition)
        if not self.architecture.n_tones:
            return heard
        away = heard.phase - heard.path
        unevenness, forgetting = self.tones.motion[1:].to(sample.dtype)
        turn = self._turn(before).to(sample.dtype)
        alike = torch.exp(-turn / math.pi)
        chance = unevenness * e.clamp(-LARGEST_STRAY, LARGEST_STRAY)
        rate = alike * heard.rate + torch.sqrt(1 - alike * alike) * chance
        return heard._replace(phase=heard.phase - forgetting * away + turn * rate, rate=rate)

    def rendered_power(self, condition: Tensor) -> tuple[Tensor, Tensor]:
        """Return the mean squares, under a steady hand (b, 2) scaled, of what is random and of the tones: (b,), (b,), float64."""
        chance = (self.excited.level(condition) * self.excitation(condition)).double().square()
        if not self.architecture.n_tones:
            return chance, torch.zeros_like(chance)
        return chance, 0.5 * self._tones_at(condition).double().square().sum(dim=1)

    def _heard(self, windows: Tensor, lattice: Lattice, phase: Tensor | None = None) -> Heard:
        """Return what a lattice makes of windows; tones that begin at a phase are taken off before."""
        b, m, _ = windows.shape
        nothing = torch.zeros(b, dtype=windows.dtype, device=windows.device)
        heard = Heard(
            states=nothing.new_zeros(lattice.reflections.shape[1], b),
            seen=nothing.new_zeros(b, self.architecture.window, 4),
            condition=windows[:, 0, 1:],
            phase=nothing if phase is None else phase,
            path=nothing,
            rate=nothing,
        )
        for n in range(1, m):
            heard, _ = self._take_in(heard, lattice, windows[:, n, 0], windows[:, n, 1:])
        if lattice is self.lattice:
            return heard
        # The way to the first sample belongs to the recording, of which nothing is to be left: the path begins there, and the
        # phase within half a turn of it.
        turn = self._turn(heard.condition).to(heard.path.dtype)
        return heard._replace(phase=wrapped(heard.phase + turn) - turn, path=-turn)

    def _take_in(
        self, heard: Heard, lattice: Lattice, sample: Tensor, condition: Tensor
    ) -> tuple[Heard, Tensor]:
        if lattice is not self.lattice:
            heard = self._moved(heard)
            sample = sample - _tone(self._tones_at(heard.condition), heard.phase)
        states, x, e = lattice.push(heard.states, heard.condition, sample)
        seen = torch.cat([x[:, None], condition, e[:, None]], dim=1)
        seen = torch.cat([heard.seen[:, 1:], seen[:, None]], dim=1)
        return heard._replace(states=states, condition=condition, seen=seen), e

    def _expected(self, heard: Heard, corrected: bool = True) -> tuple[Tensor, Tensor]:
        """Return what is to be expected of the next samples, and what a unit of innovation is worth: (b,), (b,); scaled."""
        sample, unit = self.lattice.forecast(heard.states, heard.condition)
        return sample + (unit * self.network(heard.seen) if corrected else 0.0), unit

    def _moved(self, heard: Heard) -> Heard:
        """Return the streams a sample further along the path."""
        turn = self._turn(heard.condition).to(heard.phase.dtype)
        return heard._replace(phase=heard.phase + turn, path=heard.path + turn)

    def _turn(self, condition: Tensor) -> Tensor:
        """Return by how much the phase moves on in a sample [rad]: speed and force (b, 2) scaled → (b,), float64."""
        return self.tones.motion[0] * self.lattice.physical(condition)[:, 0]

    def _tones_at(self, condition: Tensor) -> Tensor:
        coefficients = self.tones(self.lattice.physical(condition))
        multiples = torch.arange(1, coefficients.shape[1] // 2 + 1).repeat_interleave(2)
        # As much as the rate can hold, `dsp.tones.heard_of`.
        held = (10.0 - 10.0 * multiples * self._turn(condition)[:, None] / math.pi).clamp(0.0, 1.0)
        return (coefficients * held).to(condition.dtype) * self.lattice.level(condition)[:, None]


class Heard(NamedTuple):
    """What streams remember, as `render.engine` has it; `condition` is that of the last sample."""

    states: Tensor
    seen: Tensor
    condition: Tensor
    phase: Tensor
    path: Tensor
    rate: Tensor


class Lattice(nn.Module):
    """A level and reflections over speed and force: of the whole vibration, or of what tones leave of it."""

    def __init__(self, n_speed: int, n_force: int, order: int, width: int, level_drives: bool) -> None:
        super().__init__()
        self.level_drives = level_drives
        self.level = Scale(width).requires_grad_(False)
        # float64: at 10 kHz reflections reach 0.9999.
        self.register_buffer("speed_knots", torch.zeros(n_speed, dtype=torch.float64))
        self.register_buffer("force_knots", torch.zeros(n_force, dtype=torch.float64))
        self.register_buffer("reflections", torch.zeros(n_speed * n_force, order, dtype=torch.float64))

    def forecast(self, states: Tensor, condition: Tensor) -> tuple[Tensor, Tensor]:
        """Return the sample expected next, and what a unit of innovation is worth: (p, b), (b, 2) → (b,) each, scaled."""
        level, k = self.level(condition), self.at(condition)
        cosine = torch.sqrt(1 - k * k)
        expected = torch.zeros_like(level)
        for i in reversed(range(k.shape[1])):
            expected = cosine[:, i] * expected - k[:, i] * LEAK * states[i]
        return expected if self.level_drives else level * expected, level * cosine.prod(dim=1)

    def push(self, states: Tensor, condition: Tensor, sample: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the states after a sample (b,), x and e: states (p, b), speed and force before the sample (b, 2) scaled."""
        level, k = self.level(condition), self.at(condition)
        cosine = torch.sqrt(1 - k * k)
        f = sample if self.level_drives else sample / level
        after = [f]
        for i in range(k.shape[1]):
            b = LEAK * states[i]
            f, backward = (f + k[:, i] * b) / cosine[:, i], (b + k[:, i] * f) / cosine[:, i]
            after.append(backward)
        return torch.stack(after[:-1]), sample / level, f / level if self.level_drives else f

    def at(self, condition: Tensor) -> Tensor:
        """Return the reflections: speed and force (b, 2) scaled → (b, p)."""
        physical = self.physical(condition)
        return _bilinear(physical, self.speed_knots, self.force_knots, self.reflections).to(condition.dtype)

    def physical(self, condition: Tensor) -> Tensor:
        """Return speed [mm/s] and force [N], none negative: scaled (b, 2) → (b, 2), float64."""
        return (condition.double() * self.level.sd.double() + self.level.mean.double()).clamp(min=0.0)


class Tones(nn.Module):
    """Coefficients of the tones over speed and force, in units of the vibration's level, and how their phase moves."""

    def __init__(self, architecture: FotenPlusArchitecture) -> None:
        super().__init__()
        n_speed, n_force = architecture.n_tone_speed, architecture.n_tone_force
        for name, shape in (
            ("speed_knots", (n_speed,)),
            ("force_knots", (n_force,)),
            ("values", (n_speed * n_force, 2 * architecture.n_tones)),
            # Phase for a mm/s and a sample; by how much periods differ; what a rendering forgets of its stray in a sample.
            ("motion", (3,)),
        ):
            self.register_buffer(name, torch.zeros(shape, dtype=torch.float64))

    def forward(self, physical: Tensor) -> Tensor:
        """Return the coefficients: speed [mm/s] and force [N] (b, 2) → (b, 2 n_tones), float64."""
        return _bilinear(physical, self.speed_knots, self.force_knots, self.values)


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


def wrapped(phase: Tensor) -> Tensor:
    """Return a phase [rad] without its whole turns, from −π to π, any shape."""
    return torch.remainder(phase + math.pi, 2 * math.pi) - math.pi


def _tone(coefficients: Tensor, phase: Tensor) -> Tensor:
    """Return T: coefficients (…, 2 n_tones) and phases (…) → (…)."""
    multiples = torch.arange(1, coefficients.shape[-1] // 2 + 1, dtype=phase.dtype, device=phase.device)
    angle = phase[..., None] * multiples
    return (coefficients[..., 0::2] * torch.cos(angle) + coefficients[..., 1::2] * torch.sin(angle)).sum(
        dim=-1
    )


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
        # A corner of the plane that the hand hardly visited is no louder than the loudest 3 % of where it was. In a trial,
        # ten minutes on jeans: 13.0 standard deviations with the 99th percentile, 11.4 with the 97th; the recording reaches 11.1.
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

    It does not listen to the window: a σ that did fed the model's own errors back into the loop (in a trial on a simulated
    mesh, level error 1.76 against 1.40 dB).
    """

    def __init__(self, width: int) -> None:
        super().__init__(width)
        self.tail = nn.Linear(5, 1)
        # No shock is larger than the largest that was left to explain, in units of σ and its swell, and in scaled acceleration:
        # where the hand is fast and firm a rare shock of a slow one would be beyond all that was recorded.
        self.register_buffer("largest", torch.full((2,), 1e6))
        # How the loudness swells by itself (`dsp.noise.Swell`): what is kept of it in a sample, and its standard deviation.
        self.register_buffer("swell", torch.zeros(2))
        self.forget()

    @torch.no_grad()
    def forget(self) -> None:
        """Let it have neither tails nor swell nor bound."""
        self.tail.weight.zero_()
        self.tail.bias.fill_(NO_TAIL)
        self.largest.fill_(1e6)
        self.swell.zero_()

    def tails(self, condition: Tensor) -> Tensor:
        """Return h, from 0 to `HEAVIEST_TAIL`: z·exp(h z²/2) is excitation, z Gaussian; (b, 2) scaled → (b,)."""
        return HEAVIEST_TAIL * torch.sigmoid(self.tail(self.logarithms(condition))[:, 0])
