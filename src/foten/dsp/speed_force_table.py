"""A table over speed and force."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array

FORCE_FLOOR = 0.05  # N; what a logarithm of force starts from
MIN_SPREAD = 0.02  # of the largest speed, and of log force: less variation has one vertex


@dataclass(frozen=True)
class SpeedForceTable:
    """Values at the vertices of a grid: bilinear in speed and log force between them, constant outside."""

    speed_knots: Array  # [mm/s], rising, shape (n_v,)
    force_knots: Array  # log(force/N + 0.05), rising, shape (n_f,)
    values: Array  # speed the slower index, shape (n_v · n_f, k)

    def __post_init__(self) -> None:
        if not (np.diff(self.speed_knots) > 0).all() or not (np.diff(self.force_knots) > 0).all():
            raise ValueError("the knots of speed or force do not rise")

    def weights(self, speed: Array, force: Array) -> Array:
        """Weights of the vertices: speed [mm/s] and force [N] (n,) → (n, n_v · n_f), rows sum to 1."""
        over_speed = hat_weights(speed, self.speed_knots)
        over_force = hat_weights(log_force(force), self.force_knots)
        return (over_speed[:, :, None] * over_force[:, None, :]).reshape(len(over_speed), -1)

    @property
    def steps(self) -> tuple[int, int]:
        """Vertices from one to the next faster and to the next firmer one, 0 where there is none."""
        return len(self.force_knots) * (len(self.speed_knots) > 1), int(len(self.force_knots) > 1)

    def place(self, speed: Array, force: Array) -> tuple[NDArray[np.int32], Array, Array]:
        """The slowest and softest vertex around each condition, and the shares of the way to the next: (n,) → (n,) each."""
        slower, faster = _between(speed, self.speed_knots)
        softer, firmer = _between(log_force(force), self.force_knots)
        return slower * np.int32(len(self.force_knots)) + softer, faster, firmer

    def at(self, speed: Array, force: Array) -> Array:
        """The values at speeds [mm/s] and forces [N]: (n,) → (n, k)."""
        if len(self.values) == 1:
            return np.broadcast_to(self.values, (len(speed), self.values.shape[1]))
        vertex, faster, firmer = self.place(speed, force)
        to_faster, to_firmer = self.steps
        slow, fast = (
            (1 - firmer)[:, None] * self.values[v] + firmer[:, None] * self.values[v + to_firmer]
            for v in (vertex, vertex + to_faster)
        )
        return (1 - faster)[:, None] * slow + faster[:, None] * fast


def _between(values: Array, knots: Array) -> tuple[NDArray[np.int32], Array]:
    """The knot below each value, and the share of the way to the next: (n,), (k,) → (n,) each; the end ones outside."""
    if len(knots) == 1:
        return np.zeros(len(values), np.int32), np.zeros(len(values))
    below = np.clip(np.searchsorted(knots, values, side="right") - 1, 0, len(knots) - 2)
    return below.astype(np.int32), np.clip((values - knots[below]) / np.diff(knots)[below], 0.0, 1.0)


def log_force(force: Array) -> Array:
    """Log(force + 0.05), force [N], negative ones as 0."""
    return np.log(np.maximum(force, 0.0) + FORCE_FLOOR)


def hat_weights(values: Array, knots: Array) -> Array:
    """The weights of linear interpolation between knots, the end ones outside: (n,), (k,) → (n, k)."""
    return np.stack([np.interp(values, knots, hat) for hat in np.eye(len(knots))], axis=1)


def spanning(speed: Array, force: Array, n_speed: int, n_force: int) -> SpeedForceTable:
    """Empty table over the range of speeds [mm/s] and the middle 98 % of forces [N], any equal shapes."""

    def knots(low: float, high: float, n: int, min_spread: float) -> Array:
        return np.linspace(low, high, n) if n > 1 and high - low > min_spread else np.zeros(1)

    speed_knots = knots(speed.min(), speed.max(), n_speed, MIN_SPREAD * speed.max())
    low, high = np.quantile(log_force(force), [0.01, 0.99])
    force_knots = knots(low, high, n_force, MIN_SPREAD)
    return SpeedForceTable(speed_knots, force_knots, np.zeros((len(speed_knots) * len(force_knots), 0)))
