import numpy as np
import pytest
from scipy.signal import lfilter

from foten.dsp.ar import burg, levinson, solved, spectral_radius, stabilised
from foten.dsp.lattice import LEAK, polynomial


def taps_of(poles: list[complex]) -> np.ndarray:
    """Return the taps, oldest first, of the process with these poles."""
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


def test_the_radius_is_how_fast_it_rings_out() -> None:
    taps = taps_of([0.9 * np.exp(0.5j), 0.9 * np.exp(-0.5j)])
    ringing = lfilter([1.0], np.concatenate([[1.0], -taps[::-1]]), np.eye(1, 400)[0])
    slope = np.log(np.abs(ringing[300:]).max() / np.abs(ringing[100:200]).max()) / 200
    assert np.exp(slope) == pytest.approx(0.9, rel=0.01)  # where the maxima fall within a period of 12


def test_no_taps_have_no_poles() -> None:
    assert spectral_radius(np.zeros(5)) == 0.0


def test_zeros_as_oldest_taps_change_nothing() -> None:
    taps = taps_of([0.9, -0.5])
    assert spectral_radius(np.concatenate([np.zeros(6), taps])) == pytest.approx(0.9, rel=1e-9)


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
