"""Values over speed and force: a table between whose vertices is interpolated, and triangles between scattered models."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array

FORCE_FLOOR = 0.05  # N; what a logarithm of force starts from
MIN_SPREAD = 0.02  # of the largest speed, and of log force: less variation has one vertex
MIN_TRIANGLE_AREA = 1e-9  # of a triangle, scaled; a flatter one has no weights
_INSIDE = -1e-12  # a weight above this is one of the triangle that a point lies in
_AT_ONCE = 500_000  # points times triangles held in memory


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


@dataclass(frozen=True)
class Mesh:
    """Triangles over speed and force; a point outside of all is moved to the nearest edge."""

    points: Array  # speed [mm/s] and force [N], shape (n, 2)
    triangles: NDArray[np.int64]  # three points each, shape (t, 3)
    scale: Array  # what a speed and a force are divided by before distances are measured, shape (2,)

    def __post_init__(self) -> None:
        if not (self.scale > 0).all():
            raise ValueError(f"the mesh is scaled by {self.scale}, expected positive numbers")
        if not ((self.triangles >= 0) & (self.triangles < len(self.points))).all():
            raise ValueError("a triangle of the mesh has a corner that no model is at")
        corners = (self.points / self.scale)[self.triangles]
        if not (np.abs(_cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])) > MIN_TRIANGLE_AREA).all():
            raise ValueError("a triangle of the mesh is flat: three models in a line, or two in one place")

    def at(self, speed: Array, force: Array) -> tuple[NDArray[np.int64], Array]:
        """The three models used at speeds [mm/s] and forces [N], and the share of each: (b,) → (b, 3), (b, 3)."""
        places = np.stack([speed, force], axis=1) / self.scale
        parts = np.array_split(places, len(places) * len(self.triangles) // _AT_ONCE + 1)
        triangles, weights = zip(*(self._some(part) for part in parts), strict=True)
        return self.triangles[np.concatenate(triangles)], np.concatenate(weights)

    def _some(self, places: Array) -> tuple[NDArray[np.int64], Array]:
        """Triangle that each point is in or nearest to, and the shares of its corners: (b, 2) → (b,), (b, 3)."""
        corners = (self.points / self.scale)[self.triangles]
        origin, first, second = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        away = places[:, None] - origin
        area = _cross(first, second)
        over = np.stack([_cross(away, second) / area, _cross(first, away) / area], axis=2)
        shares = np.concatenate([1 - over.sum(axis=2, keepdims=True), over], axis=2)
        inside = (shares > _INSIDE).all(axis=2)
        triangle = inside.argmax(axis=1)
        weights = shares[np.arange(len(places)), triangle]
        outside = inside.sum(axis=1) == 0
        if outside.any():
            triangle[outside], weights[outside] = _nearest(places[outside], corners)
        weights = np.maximum(weights, 0.0)
        return triangle, weights / weights.sum(axis=1, keepdims=True)


def _nearest(places: Array, corners: Array) -> tuple[NDArray[np.int64], Array]:
    """Triangle whose edge is nearest to each point, and the shares of its corners at the nearest place."""
    begin = corners.transpose(1, 0, 2)  # of the three edges of each triangle, (3, t, 2)
    along = np.roll(begin, -1, axis=0) - begin
    away = places[:, None, None] - begin
    share = np.clip((away * along).sum(axis=3) / np.square(along).sum(axis=2), 0.0, 1.0)
    distance = np.square(away - share[..., None] * along).sum(axis=3)
    edge, triangle = np.unravel_index(distance.reshape(len(places), -1).argmin(axis=1), distance.shape[1:])
    rows, weights = np.arange(len(places)), np.zeros((len(places), 3))
    weights[rows, (edge + 1) % 3] = share[rows, edge, triangle]
    weights[rows, edge] = 1 - share[rows, edge, triangle]
    return triangle, weights


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
