"""The excitation: σ over speed and force and its tails by maximum likelihood, its level and volatility in the closed loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from foten.dsp import Array
from foten.dsp.noise import innovation_likelihood
from foten.models.tensor_shapes import HEAVIEST_TAIL
from foten.recording.scaling import Scaling
from foten.training.calibration import ClosedLoop, fit_volatility, free_run_distance, settle_level
from foten.training.config import TrainConfig
from foten.training.scale import Excitation, Scale
from foten.training.window_fit import TrainingWindows

KEPT = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the fitted shape of log σ


@dataclass(frozen=True)
class FittedExcitation:
    """An excitation, and how it came about."""

    excitation: Excitation
    distance: tuple[float, float]  # log-spectral distance and level error of the free run on the validation blocks [dB]
    level_errors_db: list[float]  # by how much the closed loop was louder than the recording before each adjustment
    tail_gain: float  # what the tails gain in the negative log-likelihood of the validation blocks [nat]
    likelihood: float | None  # mean negative log-likelihood of those blocks, where a rendering does not fade [nat]
    likelihood_in_units: float = math.nan  # that of innovations over all of them, before the level was settled [nat]

    @property
    def nearness(self) -> float:
        """Return what decides between renderings: log-spectral distance times level error."""
        return math.prod(self.distance)

    def metrics(self) -> dict[str, Any]:
        """Return what the card says of it."""
        return {
            "validation_nll": self.likelihood,
            "validation_lsd_db": self.distance[0],
            "validation_level_error_db": self.distance[1],
            "tail_gain_nat": self.tail_gain,
            "level_errors_db": self.level_errors_db,
        }


def fit_excitation(
    width: int, innovations: Array, windows: TrainingWindows, loop: ClosedLoop, config: TrainConfig
) -> FittedExcitation:
    """Return an excitation: scale, tails and bound, then level and volatility in the closed loop.

    Args:
        innovations: what is left to the excitation at the training, then the validation indices, in its unit.
    """
    torch.manual_seed(config.seed)
    excitation = Excitation(width).requires_grad_(False)
    fit_scale(excitation, windows, loop.blocks.scaling, innovations, config.seed)
    tail_gain = fit_tail(excitation, windows, innovations) if config.tails else 0.0
    # None is larger than what was left to explain at the training indices, in σ and in acceleration.
    n, unit = len(windows.train), 1.0 if windows.unit is None else windows.unit[windows.train]
    left = innovations[:n] / _sigma(excitation, windows)[:n], innovations[:n] * unit
    excitation.largest.copy_(torch.tensor([float(np.abs(values).max()) for values in left]))
    _, in_units = _likelihood_of(excitation, innovations, windows, loop)
    errors = settle_level(loop, excitation, config.seed)
    if config.volatility:
        fit_volatility(loop, excitation, config.seed)
    settled, _ = _likelihood_of(excitation, innovations, windows, loop)
    distance = free_run_distance(loop, excitation, config.seed)
    return FittedExcitation(excitation, distance, errors, tail_gain, settled, in_units)


def settle_gain(
    width: int, largest: list[float], loop: ClosedLoop, config: TrainConfig, likelihood: float | None, settled: bool
) -> FittedExcitation:
    """Return what scales a network's innovations in the closed loop, σ near 1, and bounds them; no tails, no volatility.

    Args:
        settled: the network has learned its level in the closed loop, and σ stays 1.
        largest: bounds of an innovation, in units of σ and in scaled acceleration.
        likelihood: the network's of the validation blocks where a rendering does not fade [nat]; None where it always does.
    """
    torch.manual_seed(config.seed)
    excitation = Excitation(width).requires_grad_(False)
    scaling = loop.blocks.scaling
    excitation.mean.copy_(torch.tensor(scaling.mean[1:]))
    excitation.sd.copy_(torch.tensor(scaling.sd[1:]))
    for part in (excitation.hidden.weight, excitation.hidden.bias, excitation.out.weight, excitation.out.bias):
        part.zero_()
    excitation.power_law.weight.zero_()
    excitation.largest.copy_(torch.tensor(largest))
    excitation.highest.fill_(1.0)  # which is what σ is everywhere, and part of the bound that is proven of a file
    errors = [] if settled else settle_level(loop, excitation, config.seed)
    distance = free_run_distance(loop, excitation, config.seed)
    return FittedExcitation(excitation, distance, errors, 0.0, likelihood)


def _likelihood_of(
    excitation: Excitation, innovations: Array, windows: TrainingWindows, loop: ClosedLoop
) -> tuple[float | None, float]:
    """Return the mean negative log-likelihood of the validation blocks [nat]: as the judge counts it, and of innovations."""
    n = windows.validation
    unit = np.ones(len(n)) if windows.unit is None else windows.unit[n]
    condition = _conditions(windows)[len(windows.train) :].float()
    with torch.no_grad():
        scale, tail = (part(condition).double().numpy() for part in (excitation, excitation.tails))
    _, nats = innovation_likelihood(innovations[len(windows.train) :] * unit, scale * unit, tail)
    counted = loop.blocks.moving().ravel()[n]
    return float(nats[counted].mean()) if counted.any() else None, float((nats - np.log(unit)).mean())


def _conditions(windows: TrainingWindows) -> Tensor:
    """Return speed and force, scaled, of the last samples of the training, then of the validation windows, (n, 2)."""
    return torch.from_numpy(windows.samples[np.concatenate([windows.train, windows.validation]) - 1, 1:3]).double()


def _sigma(excitation: Excitation, windows: TrainingWindows) -> Array:
    """Return σ at the training, then the validation indices."""
    with torch.no_grad():
        return excitation(_conditions(windows).float()).double().numpy()


def fit_scale(scale: Scale, windows: TrainingWindows, scaling: Scaling, residual: Array, seed: int) -> float:
    """Fit the scale over speed and force of a vibration or of residuals, by Gaussian maximum likelihood.

    The shape of log σ over speed and force is fitted on the training blocks, and how much of it is kept, from none to all, is
    chosen by the likelihood of the validation blocks: in a recording of two seconds the differences between blocks are
    mostly chance. It did not cure the level errors of the real wood (−4.4 dB on one split before and after).

    Args:
        windows: the speed and force that go with each residual are those of the last sample of its window.
        residual: what it is the scale of, in the unit that it is to have, at the training, then the validation indices, (n,).

    Returns:
        The mean negative log-likelihood of the validation blocks [nat].
    """
    condition, squared = _conditions(windows), torch.from_numpy(residual**2).double() + 1e-12
    train, validation = slice(0, len(windows.train)), slice(len(windows.train), None)
    torch.manual_seed(seed)
    scale.hidden.reset_parameters()
    with torch.no_grad():
        scale.mean.copy_(torch.tensor(scaling.mean[1:]))
        scale.sd.copy_(torch.tensor(scaling.sd[1:]))
        scale.out.weight.zero_()
        scale.power_law.weight.zero_()
        scale.highest.fill_(1e6)
        scale.out.bias.copy_(0.5 * torch.log(squared[train].mean(dim=0, keepdim=True)))
    scale.double().requires_grad_(True)

    def loss() -> Tensor:
        # The weights' squares keep σ smooth where speed and force hardly went.
        roughness = scale.hidden.weight.square().sum() + scale.out.weight.square().sum()
        return _likelihood(scale(condition[train]), squared[train]) + 1e-4 * roughness

    _minimise(loss, scale.parameters(), max_iter=60, history_size=20)
    scale.requires_grad_(False)
    shape = torch.log(scale(condition)) - scale.out.bias
    candidates = []
    for kept in KEPT:
        # The factor that maximises the likelihood of a given shape, in closed form.
        factor = torch.sqrt((squared[train] * torch.exp(-2 * kept * shape[train])).mean())
        nll = _likelihood(factor * torch.exp(kept * shape[validation]), squared[validation])
        candidates.append((float(nll), kept, math.log(float(factor))))
    nll, kept, log_factor = min(candidates)
    scale.out.weight.mul_(kept)
    scale.power_law.weight.mul_(kept)
    scale.out.bias.fill_(log_factor)
    scale.float()
    scale.bound(condition[train].float())
    return nll


def _minimise(loss: Callable[[], Tensor], parameters: Iterable[Tensor], **limits: int) -> None:
    optimiser = torch.optim.LBFGS(parameters, line_search_fn="strong_wolfe", tolerance_change=1e-7, **limits)

    def closure() -> Tensor:
        optimiser.zero_grad()
        value = loss()
        value.backward()
        return value

    optimiser.step(closure)


def _likelihood(sigma: Tensor, squared: Tensor) -> Tensor:
    """Return the mean Gaussian negative log-likelihood [nat] of squared residuals."""
    return (torch.log(sigma) + squared / (2 * sigma**2)).mean() + 0.5 * math.log(2 * math.pi)


def fit_tail(excitation: Excitation, windows: TrainingWindows, residual: Array) -> float:
    """Give a fitted excitation the tails that its residuals have, where validation agrees.

    h(speed, force) and a factor on σ, a power law too, are fitted on the training blocks by the likelihood of z·exp(h z²/2),
    and kept if the validation blocks are more likely with them. A Student t and two Gaussians are about as likely
    (`benchmarks/innovations.py`); this one is a smooth function of one Gaussian number, which a stream of noise is made of.

    Arguments are as of `fit_scale`. Returned is what the tails gain in the mean negative log-likelihood of the validation
    blocks [nat], 0 where they are not kept.
    """
    condition, u = _conditions(windows), torch.from_numpy(residual / _sigma(excitation, windows)).double()
    train, validation = slice(0, len(windows.train)), slice(len(windows.train), None)
    with torch.no_grad():
        powers = excitation.double().logarithms(condition)
    excitation.float()
    powers = torch.cat([powers, torch.ones_like(powers[:, :1])], dim=1)
    tail = torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, -2.0], dtype=torch.float64, requires_grad=True)
    factor = torch.zeros(6, dtype=torch.float64, requires_grad=True)

    def nll(part: slice) -> Tensor:
        h = HEAVIEST_TAIL * torch.sigmoid(powers[part] @ tail)
        log_factor = powers[part] @ factor
        z2 = gaussianised(u[part] * torch.exp(-log_factor), h).square()
        return (0.5 * (1 + h) * z2 + torch.log1p(h * z2) + log_factor).mean()

    def loss() -> Tensor:
        return nll(train) + 1e-3 * (tail[:5].square().sum() + factor[:5].square().sum())

    _minimise(loss, [tail, factor], max_iter=80)
    with torch.no_grad():
        gained = float(0.5 * u[validation].square().mean() - nll(validation))
        if gained > 0:
            excitation.tail.weight.copy_(tail[None, :5])
            excitation.tail.bias.copy_(tail[5:])
            excitation.power_law.weight += factor[None, :5].float()
            excitation.out.bias += factor[5:].float()
            excitation.bound(condition[train].float())
    return max(0.0, gained)


def gaussianised(u: Tensor, h: Tensor) -> Tensor:
    """Return |z| with z·exp(h z²/2) = u, any equal shapes, differentiable: Newton's method on log |z|."""
    log_u = torch.log(u.abs() + 1e-12)

    def step(q: Tensor) -> Tensor:
        z2 = torch.exp(2 * q)
        return q - (q + 0.5 * h * z2 - log_u) / (1 + h * z2)

    with torch.no_grad():
        # From above the root of a convex function every step stays above, and falls by a half until it is near.
        q = log_u
        for _ in range(20):
            q = step(q)
    return torch.exp(step(q))  # one step more, for its derivative
