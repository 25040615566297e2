"""Line spectral frequencies: there and back, and what any of them are a filter of."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foten.dsp.lattice import polynomial, reflections_of
from foten.dsp.lsf import LEAST_GAP, line_spectral_frequencies, polynomial_of, spread_out


def stable(p: int, seed: int) -> np.ndarray:
    """Return a polynomial of p zeros between 0.3 and 0.98 from the middle, in pairs and one at most alone."""
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
    assert gaps.min() > LEAST_GAP * (1 - 1e-9)
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
