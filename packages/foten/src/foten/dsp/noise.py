"""Counter-based Gaussian noise: the same numbers in every language, on every processor, in any order and block size.

1. `(w0, w1, w2, w3) = Philox4x32-10(counter = (n mod 2³², n div 2³², s mod 2³², s div 2³²), key = (k mod 2³², k div 2³²))` of
sample n of stream s under key k (Salmon, Moraes, Dror, Shaw, SC 2011).
2. Cut the four words into eight 16-bit integers and add them: `t`, an integer in [0, 524280].
3. `x = (t − 262140) / √(8·(2³² − 1)/12)`: zero mean, unit variance, kurtosis 3 − 1.2/8.
4. `g = x·(0.97846856 + 0.00750807·x²)`, the odd cubic that gives `g` variance 1 and kurtosis 3 (solved from the moments of the
sum of eight uniform numbers, up to the twelfth). |g| < 5.68.

Integers and four float64 operations: they agree to the last bit wherever IEEE arithmetic is not contracted.
"""

import math

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array

_MULTIPLIER_0, _MULTIPLIER_1 = 0xD2511F53, 0xCD9E8D57
_WEYL_0, _WEYL_1 = 0x9E3779B9, 0xBB67AE85
_MASK = 0xFFFFFFFF
_SUM_SD = math.sqrt(8 * (2.0**32 - 1) / 12)
_LINEAR, _CUBIC = 0.97846856, 0.00750807


def philox(counter: NDArray[np.uint64], key: int) -> NDArray[np.uint64]:
    """Ten rounds of Philox4x32: counters (n, 4) of 32-bit words → random 32-bit words (n, 4)."""
    c0, c1, c2, c3 = counter.T
    k0, k1 = key & _MASK, (key >> 32) & _MASK
    for _ in range(10):
        first, second = c0 * _MULTIPLIER_0, c2 * _MULTIPLIER_1
        c0, c1, c2, c3 = (second >> 32) ^ c1 ^ k0, second & _MASK, (first >> 32) ^ c3 ^ k1, first & _MASK
        k0, k1 = (k0 + _WEYL_0) & _MASK, (k1 + _WEYL_1) & _MASK
    return np.stack([c0, c1, c2, c3], axis=1)


def gaussian(key: int, stream: int, first: int, n: int) -> Array:
    """Samples `first` … `first + n − 1` of one stream, shape (n,): zero mean, unit variance; key and stream below 2⁶⁴."""
    index = np.arange(first, first + n, dtype=np.uint64)
    counter = np.empty((n, 4), dtype=np.uint64)
    counter[:, 0], counter[:, 1] = index & _MASK, index >> 32
    counter[:, 2], counter[:, 3] = stream & _MASK, (stream >> 32) & _MASK
    words = philox(counter, key)
    total = ((words & 0xFFFF) + (words >> 16)).sum(axis=1)
    x = (total.astype(np.float64) - 262140.0) / _SUM_SD
    return x * (_LINEAR + _CUBIC * (x * x))


def innovation_likelihood(residual: Array, scale: Array) -> tuple[Array, Array]:
    """Residuals (recorded − predicted, scaled) over σ of the excitation (scaled), and −log p of them [nat], of one shape."""
    z = residual / scale
    return z, 0.5 * z * z + np.log(scale) + 0.5 * math.log(2 * math.pi)
