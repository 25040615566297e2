"""Triangles over speed and force: oracles are SciPy's interpolation and a search over the whole rim."""

import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay

from foten.dsp.mesh import Mesh

SCALE = np.array([60.0, 0.5])


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    rng = np.random.default_rng(3)
    points = rng.uniform([0.0, 0.0], [300.0, 3.0], (30, 2))
    return Mesh(points, Delaunay(points / SCALE).simplices.astype(np.int64), SCALE)


def test_it_mixes_linearly_inside(mesh: Mesh) -> None:
    values = np.random.default_rng(4).standard_normal(len(mesh.points))
    asked = np.random.default_rng(5).uniform([0.0, 0.0], [300.0, 3.0], (500, 2))
    expected = LinearNDInterpolator(Delaunay(mesh.points / SCALE), values)(asked / SCALE)
    chosen, weights = mesh.at(*asked.T)
    found = (values[chosen] * weights).sum(axis=1)
    inside = np.isfinite(expected)
    assert 300 < inside.sum() < 500
    np.testing.assert_allclose(found[inside], expected[inside], atol=1e-9)
    assert (weights >= 0).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-12)


def test_outside_it_is_heard_from_the_nearest_place_of_the_rim(mesh: Mesh) -> None:
    asked = np.random.default_rng(6).uniform([-200.0, -2.0], [500.0, 5.0], (300, 2))
    asked = asked[Delaunay(mesh.points / SCALE).find_simplex(asked / SCALE) < 0]
    assert len(asked) > 100
    rim = Delaunay(mesh.points / SCALE).convex_hull
    over = np.linspace(0, 1, 2001)[:, None, None]
    ends = (mesh.points / SCALE)[rim]
    places = (ends[:, 0] + over * (ends[:, 1] - ends[:, 0])).reshape(-1, 2)
    chosen, weights = mesh.at(*asked.T)
    found = ((mesh.points / SCALE)[chosen] * weights[..., None]).sum(axis=1)
    least = np.array([np.hypot(*(places - point).T).min() for point in asked / SCALE])
    np.testing.assert_allclose(np.hypot(*(found - asked / SCALE).T), least, atol=2e-3)


def test_it_does_not_jump(mesh: Mesh) -> None:
    """Along a path over edges and out over the rim: ten times as many steps are a tenth as large, the largest too."""
    values = np.random.default_rng(7).standard_normal(len(mesh.points))
    largest = []
    for n in (20_000, 200_000):
        turn = np.linspace(0, 2 * np.pi, n + 1)
        chosen, weights = mesh.at(150 + 200 * np.cos(turn), 1.5 + 1.6 * np.sin(3 * turn))
        largest.append(np.abs(np.diff((values[chosen] * weights).sum(axis=1))).max())
    assert largest[0] > 1e-3
    assert largest[1] < 0.2 * largest[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"triangles": np.array([[0, 1, 30]])}, "no model is at"),
        ({"triangles": np.array([[0, 1, 1]])}, "is flat"),
        ({"scale": np.array([0.0, 1.0])}, "expected positive numbers"),
    ],
)
def test_what_is_no_mesh_is_refused(mesh: Mesh, change: dict[str, np.ndarray], message: str) -> None:
    parts = {"points": mesh.points, "triangles": mesh.triangles, "scale": mesh.scale, **change}
    with pytest.raises(ValueError, match=message):
        Mesh(**parts)
