"""What any model has to beat in one step: zero, persistence and linear predictors, fitted on the training blocks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.dsp.ar import MAX_POLE, least_squares_in_parts, stabilised
from foten.recording.windows import targets, windows

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
        return Linear(
            np.append(stabilised(self.coefficients[:-1], MAX_POLE), self.coefficients[-1]), self.noise_sd
        )


def first_scored(block: int) -> int:
    """Return the first sample of a block that methods are scored on: the same for all, and at most half of a block."""
    return max(20, min(FIRST_SCORED, block // 2))


def fit_linear(
    samples: Array, blocks: tuple[int, ...], block: int, order: int, scheduled: bool = False
) -> Linear | None:
    """Return AR(order) by least squares over whole blocks of scaled samples (n, 3).

    None where the blocks hold fewer than twice as many windows as coefficients.
    """
    n = targets(blocks, block, order)
    n_coefficients = (order + 1) * (3 if scheduled else 1)
    if block <= order or len(n) < 2 * n_coefficients:
        return None
    # A minute at 10 kHz and order 160 would take gigabytes at once.
    pieces = np.array_split(n, -(-len(n) * n_coefficients // 4_000_000))

    def parts() -> Iterator[tuple[Array, Array]]:
        for piece in pieces:
            yield _design(samples, piece, order, scheduled), samples[piece, 0]

    coefficients = least_squares_in_parts(parts())
    squared = sum(float(np.square(target - design @ coefficients).sum()) for design, target in parts())
    shaped = coefficients.reshape(3, order + 1) if scheduled else coefficients
    return Linear(shaped, float(np.sqrt(squared / len(n))))


def _design(samples: Array, n: NDArray[np.int64], order: int, scheduled: bool) -> Array:
    """Return what the coefficients multiply: history and a constant, then both times speed and times force."""
    history = windows(samples, n, order)
    design = np.concatenate([history[:, :, 0], np.ones((len(n), 1))], axis=1)
    if not scheduled:
        return design
    condition = history[:, -1, 1:]
    return np.concatenate([design, design * condition[:, :1], design * condition[:, 1:]], axis=1)


def best_linear(
    samples: Array, train: tuple[int, ...], validation: tuple[int, ...], block: int
) -> Linear | None:
    """Return the AR of any order of `ORDERS`, scheduled or not, with the lowest absolute error on the validation blocks.

    Orders beyond what is left out of every block (`first_scored`) are not tried.
    """
    first = first_scored(block)
    n = targets(validation, block, first)
    best: tuple[float, Linear] | None = None
    for order in ORDERS:
        for scheduled in (False, True):
            fitted = fit_linear(samples, train, block, order, scheduled)
            if fitted is None or not len(n) or order > first:
                continue
            pieces = np.array_split(n, len(n) // 16384 + 1)
            missed = [
                np.abs(samples[piece, 0] - fitted.predict(windows(samples, piece, order))) for piece in pieces
            ]
            error = float(np.concatenate(missed).mean())
            if best is None or error < best[0]:
                best = error, fitted
    return best[1] if best else None
