"""What any model has to beat in one step: zero, persistence and linear predictors, fitted on the training blocks."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from foten.dsp.ar import MAX_POLE, solved, stabilised

Array = NDArray[np.float64]

ORDERS = (5, 10, 20, 40, 80, 160, 240)
FIRST_SCORED = 320  # samples of each block that no method is scored on: more than the history of any


@dataclass(frozen=True)
class Zero:
    """Predict the mean."""

    window: int = 1

    def predict(self, windows: Array) -> Array:
        """Return zeros: (b, m, 3) → (b,)."""
        return np.zeros(len(windows))


@dataclass(frozen=True)
class Persistence:
    """Predict the last sample."""

    window: int = 1

    def predict(self, windows: Array) -> Array:
        """Return the last acceleration: (b, m, 3) → (b,)."""
        return windows[:, -1, 0]


@dataclass(frozen=True)
class Linear:
    """AR(p) with a constant, each coefficient optionally affine in speed and force.

    Attributes:
        coefficients: shape (p + 1,) or, scheduled, (3, p + 1): global, times speed, times force; all scaled.
        noise_sd: standard deviation of its error on the training blocks, scaled.
    """

    coefficients: Array
    noise_sd: float

    @property
    def window(self) -> int:
        """Return the order p."""
        return self.coefficients.shape[-1] - 1

    @property
    def scheduled(self) -> bool:
        """Return whether the coefficients follow speed and force."""
        return self.coefficients.ndim == 2

    def predict(self, windows: Array) -> Array:
        """Return the next samples: (b, m, 3) with m ≥ p → (b,)."""
        coefficients = self.coefficients
        if self.scheduled:
            coefficients = coefficients[0] + windows[:, -1, 1:] @ coefficients[1:]
        history = windows[:, windows.shape[1] - self.window :, 0]
        return (history * coefficients[..., :-1]).sum(axis=1) + coefficients[..., -1]

    def stable(self) -> Linear:
        """Return an unscheduled predictor with its poles inside 0.9995, for a closed loop."""
        return Linear(np.append(stabilised(self.coefficients[:-1], MAX_POLE), self.coefficients[-1]), self.noise_sd)


def first_scored(block: int) -> int:
    """Return the first sample of a block that methods are scored on: the same for all, and at most half of a block."""
    return max(20, min(FIRST_SCORED, block // 2))


def fit_linear(
    samples: Array, blocks: tuple[int, ...], block: int, order: int, scheduled: bool = False
) -> Linear | None:
    """Return AR(order) by least squares over whole blocks of scaled samples (n, 3).

    None where the blocks hold fewer than twice as many windows as coefficients.
    """
    n_coefficients = (order + 1) * (3 if scheduled else 1)
    n = len(blocks) * (block - order)
    if block <= order or n < 2 * n_coefficients:
        return None
    gram, moment, power = np.zeros((n_coefficients,) * 2), np.zeros(n_coefficients), 0.0
    for number in blocks:
        one = samples[number * block : (number + 1) * block]
        design, target = _design(one, order, scheduled), one[order:, 0]
        gram += design.T @ design
        moment += design.T @ target
        power += float(target @ target)
    coefficients = solved(gram, moment)
    missed = power - 2 * coefficients @ moment + coefficients @ gram @ coefficients
    shaped = coefficients.reshape(3, order + 1) if scheduled else coefficients
    return Linear(shaped, math.sqrt(max(0.0, float(missed)) / n))


def _design(block: Array, order: int, scheduled: bool) -> Array:
    """Return what the coefficients multiply, for each sample of a block (n, 3) after the first `order`.

    History and a constant, then both times speed and times force of the sample before.
    """
    design = np.ones((len(block) - order, order + 1))
    design[:, :-1] = np.lib.stride_tricks.sliding_window_view(block[:-1, 0], order)
    if not scheduled:
        return design
    condition = block[order - 1 : -1, 1:]
    return np.concatenate([design, design * condition[:, :1], design * condition[:, 1:]], axis=1)


def best_linear(samples: Array, train: tuple[int, ...], validation: tuple[int, ...], block: int) -> Linear | None:
    """Return the AR of any order of `ORDERS`, scheduled or not, with the lowest absolute error on the validation blocks.

    Orders beyond what is left out of every block (`first_scored`) are not tried.
    """
    first = first_scored(block)
    orders = [order for order in ORDERS if order <= first]

    def judged(kind: tuple[int, bool]) -> tuple[float, Linear] | None:
        order, scheduled = kind
        fitted = fit_linear(samples, train, block, order, scheduled)
        if fitted is None or not validation or block <= first:
            return None
        coefficients = fitted.coefficients.ravel()
        error = 0.0
        for number in validation:
            one = samples[number * block + first - order : (number + 1) * block]
            error += float(np.abs(one[order:, 0] - _design(one, order, scheduled) @ coefficients).mean())
        return error, fitted

    with ThreadPoolExecutor() as pool:  # NumPy's products release the interpreter's lock
        candidates = [one for one in pool.map(judged, product(orders, (False, True))) if one is not None]
    return min(candidates, key=lambda one: one[0])[1] if candidates else None
