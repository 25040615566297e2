"""The sliding window of Eq. 1: the only definition of it, and which samples of a block are scored."""

import numpy as np
from numpy.typing import NDArray

FIRST_SCORED = 320  # samples of each block that no method is scored on: more than the history of any


def first_scored(block: int) -> int:
    """First sample of a block that is scored: the same for all methods, and at most half of a block."""
    return max(20, min(FIRST_SCORED, block // 2))


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
