"""Counter-based Gaussian noise: the same numbers in every language, on every processor, in any order.

Sample `n` of stream `s` under key `k` depends on nothing else, so a renderer may draw it in any block size.

1. `(w0, w1, w2, w3) = Philox4x32-10(counter = (n mod 2³², n div 2³², s mod 2³², s div 2³²),
   key = (k mod 2³², k div 2³²))` (Salmon, Moraes, Dror, Shaw, SC 2011).
2. Cut the four words into eight 16-bit integers and add them: `t`, an integer in [0, 524280].
3. `x = (t − 262140) / √(8·(2³² − 1)/12)`: zero mean, unit variance, kurtosis 3 − 1.2/8.
4. `g = x·(0.97846856 + 0.00750807·x²)`, the odd cubic that gives `g` variance 1 and kurtosis 3 (solved from the moments
   of the sum of eight uniform numbers, up to the twelfth).

Steps 1 and 2 are integers and steps 3 and 4 four float64 operations without a library function, so that they agree to
the last bit wherever IEEE arithmetic is not contracted. The sum bounds every number to |g| < 5.68.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array

_MULTIPLIER_0, _MULTIPLIER_1 = 0xD2511F53, 0xCD9E8D57
_WEYL_0, _WEYL_1 = 0x9E3779B9, 0xBB67AE85
_MASK = 0xFFFFFFFF
_SUM_SD = math.sqrt(8 * (2.0**32 - 1) / 12)
_LINEAR, _CUBIC = 0.97846856, 0.00750807

LARGEST_SHOCK = 4.0
LARGEST_VOLATILITY = 3.0  # standard deviations
_MEAN_SIZE, _SIZE_SD = math.sqrt(2 / math.pi), math.sqrt(1 - 2 / math.pi)  # of |z|


def philox(counter: NDArray[np.uint64], key: int) -> NDArray[np.uint64]:
    """Return ten rounds of Philox4x32: counters (n, 4) of 32-bit words → random 32-bit words (n, 4)."""
    c0, c1, c2, c3 = counter.T
    k0, k1 = key & _MASK, (key >> 32) & _MASK
    for _ in range(10):
        first, second = c0 * _MULTIPLIER_0, c2 * _MULTIPLIER_1
        c0, c1, c2, c3 = (second >> 32) ^ c1 ^ k0, second & _MASK, (first >> 32) ^ c3 ^ k1, first & _MASK
        k0, k1 = (k0 + _WEYL_0) & _MASK, (k1 + _WEYL_1) & _MASK
    return np.stack([c0, c1, c2, c3], axis=1)


def gaussian(key: int, stream: int, first: int, n: int) -> Array:
    """Return samples `first` … `first + n − 1` of one stream, shape (n,): zero mean, unit variance.

    Key and stream from 0 to 2⁶⁴ − 1; streams of one key are independent.
    """
    index = np.arange(first, first + n, dtype=np.uint64)
    counter = np.empty((n, 4), dtype=np.uint64)
    counter[:, 0], counter[:, 1] = index & _MASK, index >> 32
    counter[:, 2], counter[:, 3] = stream & _MASK, (stream >> 32) & _MASK
    words = philox(counter, key)
    total = ((words & 0xFFFF) + (words >> 16)).sum(axis=1)
    x = (total.astype(np.float64) - 262140.0) / _SUM_SD
    return x * (_LINEAR + _CUBIC * (x * x))


def heavy_tailed(noise: Array, tail: Array, limit: Array | float) -> Array:
    """Return z·exp(h z²/2), at most `limit` in size: Gaussian numbers z with tails as heavy as h says, any equal shapes.

    Source: the h-distribution of Tukey; Goerg, "Lambert W random variables", Annals of Applied Statistics 5 (2011).
    """
    return np.clip(noise * np.exp(0.5 * tail * noise * noise), -limit, limit)


def heavy_tailed_rms(tail: Array) -> Array:
    """Return the standard deviation of z·exp(h z²/2): its mean square is (1 − 2h)^(−3/2)."""
    return (1 - 2 * tail) ** -0.75


def gaussianised(values: Array, tail: Array) -> Array:
    """Return z with z·exp(h z²/2) = u, what `heavy_tailed` undoes but for its limit: u and h of equal shapes, h from 0 on."""
    log_u = np.log(np.maximum(np.abs(values), 1e-300))
    # Newton's method on log |z|: from above the root of a convex function every step stays above.
    q = log_u
    for _ in range(20):
        spread = tail * np.exp(2 * q)
        q = q - (q + 0.5 * spread - log_u) / (1 + spread)
    return np.copysign(np.exp(q), values)


def innovation_likelihood(missed: Array, scale: Array, tail: Array) -> tuple[Array, Array]:
    """Return innovations taken back to what should be standard normal, and their negative log-likelihood [nat, scaled].

    From recorded minus predicted and σ of the excitation, scaled, and h of its tails, of equal shapes.
    """
    z = gaussianised(missed / scale, tail)
    spread = tail * z * z
    nll = 0.5 * (z * z + spread) + np.log1p(spread) + np.log(scale) + 0.5 * math.log(2 * math.pi)
    return z, nll


@dataclass
class Volatility:
    """How much louder than usual streams are: a slow wander that no speed or force explains.

    A real texture has louder and softer places. The logarithm of their loudness, g, is a first-order process driven by how large
    the excitation's own numbers are,

        g ← ρ g + √(1 − ρ²) s (min(|z|, 4) − √(2/π)) / √(1 − 2/π)

    within ±3s, so it needs no other noise, depends on nothing that was heard, and is forgotten as ρⁿ. The factor is exp(g − s²),
    whose mean square is near 1. With it the kurtosis of a Gaussian texture grows by about exp(4s²).

    Source: the exponential GARCH of Nelson, Econometrica 59 (1991), fitted by the kurtosis rather than one step ahead.
    """

    kept: float  # ρ, of g in a sample
    sd: float  # s
    state: Array  # g of each stream, shape (s,)

    def factor(self) -> Array:
        """Return by how much the next excitation is louder than usual, shape (s,)."""
        return np.exp(self.state - self.sd * self.sd)

    def draw(self, noise: Array) -> None:
        """Be as if the wander had always been going on, by a standard normal number for each stream, shape (s,)."""
        self.state = self.sd * np.clip(noise, -LARGEST_VOLATILITY, LARGEST_VOLATILITY)

    def push(self, noise: Array | None) -> None:
        """Take in the standard normal numbers of a sample, shape (s,); None leaves all as it is."""
        if noise is None or self.sd == 0:
            return
        driven = (np.minimum(np.abs(noise), LARGEST_SHOCK) - _MEAN_SIZE) / _SIZE_SD
        state = self.kept * self.state + math.sqrt(1 - self.kept * self.kept) * self.sd * driven
        self.state = np.clip(state, -LARGEST_VOLATILITY * self.sd, LARGEST_VOLATILITY * self.sd)
