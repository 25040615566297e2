import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import LinearNDInterpolator
from scipy.signal import lfilter
from scipy.spatial import Delaunay

from foten.dsp.ar import (
    MIN_GAP_RAD,
    burg,
    levinson,
    line_spectral_frequencies,
    polynomial_of,
    solved,
    spectral_radius,
    spread_out,
    stabilised,
)
from foten.dsp.lattice import LEAK, polynomial, reflections_of
from foten.dsp.speed_force_table import Mesh


def taps_of(poles: list[complex]) -> np.ndarray:
    """Taps, oldest first, of the process with these poles."""
    return -np.poly(poles).real[:0:-1]


def test_it_minimises_the_squares() -> None:
    """Oracle: numpy.linalg.lstsq."""
    rng = np.random.default_rng(0)
    design, target = rng.standard_normal((500, 7)), rng.standard_normal(500)
    expected = np.linalg.lstsq(design, target, rcond=None)[0]
    # The ridge of 1e-9 shifts the solution by that share.
    np.testing.assert_allclose(solved(design.T @ design, design.T @ target), expected, atol=1e-8)


def test_collinear_columns_still_have_an_answer() -> None:
    column = np.random.default_rng(0).standard_normal(100)
    design = np.stack([column, column], axis=1)
    found = solved(design.T @ design, design.T @ (3 * column))
    # The ridge shares alike between equals; 1e-9 of noise is amplified by 1 over it, times rounding 1e-16.
    np.testing.assert_allclose(found, 1.5, atol=1e-5)


def test_a_known_process_is_recovered() -> None:
    taps = taps_of([0.95 * np.exp(0.7j), 0.95 * np.exp(-0.7j), 0.6])
    n = 100_000
    noise = np.random.default_rng(0).standard_normal(n)
    x = lfilter([1.0], np.concatenate([[1.0], -taps[::-1]]), noise)
    design = np.stack([x[i : n - 3 + i] for i in range(3)], axis=1)
    # Standard errors are below 1/√n = 0.003 each; four of them.
    np.testing.assert_allclose(solved(design.T @ design, design.T @ x[3:]), taps, atol=4 / np.sqrt(n))


@pytest.mark.parametrize("radius", [0.3, 0.99, 1.2])
def test_the_radius_is_the_largest_poles(radius: float) -> None:
    taps = taps_of([radius * np.exp(1j), radius * np.exp(-1j), 0.2])
    assert spectral_radius(taps) == pytest.approx(radius, rel=1e-9)  # roots of a cubic: rounding
    assert spectral_radius(np.concatenate([np.zeros(6), taps])) == pytest.approx(radius, rel=1e-9)
    assert spectral_radius(0 * taps) == 0


def test_stable_taps_are_left_alone() -> None:
    taps = taps_of([0.9 * np.exp(1j), 0.9 * np.exp(-1j)])
    np.testing.assert_array_equal(stabilised(taps, 0.9995), taps)


def test_unstable_poles_are_pulled_in_and_keep_their_frequency() -> None:
    poles = [1.05 * np.exp(0.8j), 1.05 * np.exp(-0.8j), 0.5]
    found = np.roots(np.concatenate([[1.0], -stabilised(taps_of(poles), 0.9995)[::-1]]))
    expected = np.array(poles) * 0.9995 / 1.05
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(expected), atol=1e-9)  # roots: rounding
    assert spectral_radius(stabilised(taps_of(poles), 0.9995)) == pytest.approx(0.9995, rel=1e-9)


@pytest.mark.parametrize("p", [1, 4, 20])
def test_levinson_solves_yule_and_walker(p: int) -> None:
    rng = np.random.default_rng(p)
    x = rng.standard_normal((5, 400))
    moments = np.array([(x[:, k:] * x[:, : 400 - k]).mean(axis=1) for k in range(p + 1)])
    reflections, errors = levinson(moments)
    for row in range(5):
        r = moments[:, row]
        taps = np.linalg.solve(r[np.abs(np.subtract.outer(range(p), range(p)))], -r[1:])
        lags = LEAK ** np.arange(p + 1)
        np.testing.assert_allclose(polynomial(reflections[:, row]) / lags, np.append(1.0, taps), atol=1e-12)
        assert errors[-1, row] == pytest.approx(r[0] + taps @ r[1:], rel=1e-12)


def test_burg_finds_a_sharp_resonance_in_a_short_piece() -> None:
    """Poles of 0.995 in 150 samples: where nothing is taken for zero outside, they stay within a hundredth."""
    a = np.array([1.0, -2 * 0.995 * np.cos(0.9), 0.995**2])
    found = []
    for seed in range(20):
        x = lfilter([1.0], a, np.random.default_rng(seed).standard_normal(3000))[-150:]
        reflections, error = burg(x, 2)
        assert np.abs(reflections).max() < 1
        found.append((np.abs(np.roots(polynomial(reflections))).max() / LEAK, error))
    radius, error = np.median(found, axis=0)
    assert radius == pytest.approx(0.995, abs=0.01)
    assert error == pytest.approx(1.0, rel=0.15)


def stable(p: int, seed: int) -> np.ndarray:
    """Polynomial of p zeros between 0.3 and 0.98 from the middle, in pairs and one at most alone."""
    rng = np.random.default_rng(seed)
    zeros = rng.uniform(0.3, 0.98, p // 2) * np.exp(1j * rng.uniform(0.1, 3.0, p // 2))
    zeros = np.concatenate([zeros, zeros.conj(), rng.uniform(-0.9, 0.9, p % 2)])
    return np.real(np.poly(zeros))


@settings(max_examples=60, deadline=None)
@given(p=st.integers(1, 24), seed=st.integers(0, 1000))
def test_a_filter_comes_back(p: int, seed: int) -> None:
    a = stable(p, seed)
    angles = line_spectral_frequencies(a)
    assert angles.shape == (p,)
    assert (np.diff(np.concatenate([[0.0], angles, [np.pi]])) > 0).all()
    np.testing.assert_allclose(polynomial_of(angles[None])[0], a, atol=1e-6 * np.abs(a).max())


def test_they_are_known_of_a_filter_that_does_nothing() -> None:
    """Of A = 1, P and Q are 1 ± z^−(p+1): the angles are π k / (p + 1)."""
    for p in (1, 2, 5, 8):
        a = np.zeros(p + 1)
        a[0] = 1.0
        np.testing.assert_allclose(line_spectral_frequencies(a), np.pi * np.arange(1, p + 1) / (p + 1), atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(p=st.integers(1, 20), seed=st.integers(0, 1000), share=st.floats(0, 1))
def test_a_mixture_is_stable(p: int, seed: int, share: float) -> None:
    one, other = (line_spectral_frequencies(stable(p, s)) for s in (seed, seed + 1))
    mixed = polynomial_of((share * one + (1 - share) * other)[None])[0]
    assert np.abs(np.roots(mixed)).max() < 1


def test_a_filter_that_is_not_stable_has_none() -> None:
    with pytest.raises(ValueError, match="expected a stable filter"):
        line_spectral_frequencies(np.array([1.0, -2.1, 1.2]))


@settings(max_examples=60, deadline=None)
@given(p=st.integers(1, 40), seed=st.integers(0, 1000))
def test_spread_angles_are_apart(p: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.choice([0.0, 0.3, 0.301, 3.1, 3.14, np.pi], (3, p)), axis=1)
    gaps = np.diff(np.pad(spread_out(angles), ((0, 0), (1, 1)), constant_values=((0, 0), (0.0, np.pi))), axis=1)
    assert gaps.min() > MIN_GAP_RAD * (1 - 1e-9)
    far = np.linspace(0.0, np.pi, p + 2)[1:-1]
    np.testing.assert_allclose(spread_out(far), far, rtol=1e-12)


@settings(max_examples=60, deadline=None)
@given(p=st.integers(1, 24), seed=st.integers(0, 1000))
def test_the_lattice_of_a_polynomial_is_its_filter(p: int, seed: int) -> None:
    a = stable(p, seed)
    np.testing.assert_allclose(polynomial(reflections_of(a[None])[0]), a, atol=1e-7 * np.abs(a).max())


def test_a_pole_beyond_the_leak_is_drawn_in() -> None:
    ringing = np.array([[1.0, -2 * 0.99995 * np.cos(0.4), 0.99995**2]])
    reflections = reflections_of(ringing)
    assert np.abs(reflections).max() < 1
    assert np.abs(np.roots(polynomial(reflections[0]))).max() < 0.9998


SCALE = np.array([60.0, 0.5])


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    rng = np.random.default_rng(3)
    points = rng.uniform([0.0, 0.0], [300.0, 3.0], (30, 2))
    return Mesh(points, Delaunay(points / SCALE).simplices.astype(np.int64), SCALE)


def test_it_mixes_linearly_inside(mesh: Mesh) -> None:
    values = np.random.default_rng(4).standard_normal(len(mesh.points))
    queries = np.random.default_rng(5).uniform([0.0, 0.0], [300.0, 3.0], (500, 2))
    expected = LinearNDInterpolator(Delaunay(mesh.points / SCALE), values)(queries / SCALE)
    chosen, weights = mesh.at(*queries.T)
    found = (values[chosen] * weights).sum(axis=1)
    inside = np.isfinite(expected)
    assert 300 < inside.sum() < 500
    np.testing.assert_allclose(found[inside], expected[inside], atol=1e-9)
    assert (weights >= 0).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-12)


def test_outside_it_is_heard_from_the_nearest_place_of_the_rim(mesh: Mesh) -> None:
    queries = np.random.default_rng(6).uniform([-200.0, -2.0], [500.0, 5.0], (300, 2))
    queries = queries[Delaunay(mesh.points / SCALE).find_simplex(queries / SCALE) < 0]
    assert len(queries) > 100
    rim = Delaunay(mesh.points / SCALE).convex_hull
    over = np.linspace(0, 1, 2001)[:, None, None]
    ends = (mesh.points / SCALE)[rim]
    places = (ends[:, 0] + over * (ends[:, 1] - ends[:, 0])).reshape(-1, 2)
    chosen, weights = mesh.at(*queries.T)
    found = ((mesh.points / SCALE)[chosen] * weights[..., None]).sum(axis=1)
    nearest = np.array([np.hypot(*(places - point).T).min() for point in queries / SCALE])
    np.testing.assert_allclose(np.hypot(*(found - queries / SCALE).T), nearest, atol=2e-3)


def test_it_does_not_jump(mesh: Mesh) -> None:
    """Along a path over edges and out over the rim: ten times as many steps are a tenth as large, the largest too."""
    values = np.random.default_rng(7).standard_normal(len(mesh.points))
    largest = []
    for n in (4000, 40_000):
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
