"""The noise that every language draws alike: exact integers, moments, independence."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foten.dsp.noise import gaussian, philox

N = 1_000_000


def scalar_philox(counter: tuple[int, ...], key: int) -> tuple[int, ...]:
    """Philox4x32-10 in plain integers, as its paper writes it."""
    c, k = list(counter), [key % 2**32, key >> 32]
    for _ in range(10):
        first, second = 0xD2511F53 * c[0], 0xCD9E8D57 * c[2]
        c = [(second >> 32) ^ c[1] ^ k[0], second % 2**32, (first >> 32) ^ c[3] ^ k[1], first % 2**32]
        k = [(k[0] + 0x9E3779B9) % 2**32, (k[1] + 0xBB67AE85) % 2**32]
    return tuple(c)


def scalar_gaussian(key: int, stream: int, n: int) -> float:
    """One sample by the four steps of the module's docstring."""
    words = scalar_philox((n % 2**32, n >> 32, stream % 2**32, stream >> 32), key)
    total = sum(word % 2**16 + (word >> 16) for word in words)
    x = (total - 262140) / math.sqrt(8 * (2**32 - 1) / 12)
    return x * (0.97846856 + 0.00750807 * (x * x))


@pytest.mark.parametrize(
    ("counter", "key", "words"),
    [
        ("00000000 00000000 00000000 00000000", "00000000 00000000", "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
        ("ffffffff ffffffff ffffffff ffffffff", "ffffffff ffffffff", "408f276d 41c83b0e a20bc7c6 6d5451fd"),
        ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0", "d16cfe09 94fdcceb 5001e420 24126ea1"),
    ],
)
def test_known_answers(counter: str, key: str, words: str) -> None:
    """Oracle: the known-answer vectors that the authors of Philox publish."""
    low, high = (int(word, 16) for word in key.split())
    drawn = philox(np.array([[int(word, 16) for word in counter.split()]], dtype=np.uint64), low + (high << 32))
    assert [f"{int(word):08x}" for word in drawn[0]] == words.split()


@given(
    key=st.integers(0, 2**64 - 1),
    stream=st.integers(0, 2**64 - 1),
    first=st.integers(0, 2**63) | st.integers(2**32 - 20, 2**32 + 20),
)
@settings(max_examples=25, deadline=None)
def test_every_sample_is_that_of_plain_integers(key: int, stream: int, first: int) -> None:
    """Oracle: Python's integers; equal to the last bit, as every other language must be."""
    expected = [scalar_gaussian(key, stream, first + i) for i in range(12)]
    assert gaussian(key, stream, first, 12).tolist() == expected


def test_moments_are_a_normal_distributions() -> None:
    g = gaussian(0, 0, 0, N)
    # Four standard errors: 1, √2, √6 and √96 over √n for mean, variance, skewness and kurtosis of a normal.
    error = 4 / math.sqrt(N)
    assert g.mean() == pytest.approx(0.0, abs=error)
    assert g.var() == pytest.approx(1.0, abs=error * math.sqrt(2))
    assert (g**3).mean() == pytest.approx(0.0, abs=error * math.sqrt(15))
    assert (g**4).mean() == pytest.approx(3.0, abs=error * math.sqrt(96))


def test_the_distribution_is_near_normal() -> None:
    """Oracle: the normal's own distribution function (Kolmogorov's distance)."""
    from scipy.stats import norm

    ordered = np.sort(gaussian(1, 0, 0, N))
    distance = np.abs(norm.cdf(ordered) - np.arange(1, N + 1) / N).max()
    # Kolmogorov's 0.1 % point is 1.95/√n = 0.002; the sum of eight bends the shape by some 0.001 more.
    assert distance < 0.003


def test_it_is_bounded() -> None:
    x = 262140 / math.sqrt(8 * (2**32 - 1) / 12)  # the largest sum of eight 16-bit numbers
    assert x * (0.97846856 + 0.00750807 * x * x) < 5.68
    assert np.abs(gaussian(2, 0, 0, N)).max() < 5.68


def test_it_is_white() -> None:
    g = gaussian(3, 0, 0, N)
    for lag in (1, 2, 3, 4, 5, 16, 1000):
        assert abs(float(g[lag:] @ g[:-lag])) / N < 4.5 / math.sqrt(N)  # standard errors; eight looks


def test_streams_and_keys_are_independent() -> None:
    n = N // 4
    drawn = np.stack([gaussian(key, stream, 0, n) for key, stream in ((0, 0), (0, 1), (1, 0), (2**32, 0), (0, 2**32))])
    correlation = drawn @ drawn.T / n - np.eye(5)
    # 4.5 standard errors: 1/√n beside the diagonal, √2/√n on it.
    assert np.abs(correlation - np.diag(np.diag(correlation))).max() < 4.5 / math.sqrt(n)
    assert np.abs(np.diag(correlation)).max() < 4.5 * math.sqrt(2 / n)
