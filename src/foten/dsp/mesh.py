"""Models at scattered speeds and forces: a triangulation of the plane between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array

MIN_TRIANGLE_AREA = 1e-9  # of a triangle, scaled; a flatter one has no weights
_INSIDE = -1e-12  # a weight above this is one of the triangle that a point lies in
_AT_ONCE = 500_000  # points times triangles held in memory


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
