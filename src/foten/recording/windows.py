"""The sliding window of Eq. 1: the only definition of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def targets(blocks: tuple[int, ...], block: int, first: int) -> NDArray[np.int64]:
    """Indices n to predict, (k,): in each block all but the first `first` samples; from m on no window straddles blocks."""
    within = np.arange(first, block)
    return (np.asarray(blocks, dtype=np.int64)[:, None] * block + within[None, :]).ravel()


def window_indices(n: NDArray[np.int64], m: int) -> NDArray[np.int64]:
    """The m indices before each n, oldest first: (b,) → (b, m). Source: Eq. 1."""
    return n[:, None] + np.arange(-m, 0)


def windows(samples: NDArray[np.float64], n: NDArray[np.int64], m: int) -> NDArray[np.float64]:
    """Windows before the given indices: samples (t, 3) → (b, m, 3)."""
    return samples[window_indices(n, m)]


def stretches(samples: NDArray[np.float64], n: NDArray[np.int64], m: int) -> NDArray[np.float64]:
    """Rows of consecutive samples and the window before each: n (s, k), samples (t, 3) → (s, m + k, 3)."""
    return samples[n[:, :1] + np.arange(-m, n.shape[1])]
