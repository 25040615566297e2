"""Samples between two threads: one writes, another reads, neither waits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Ring:
    """A ring of float32 samples, one writer, one reader.

    The counters only grow, each is written by one thread alone, and a sample is in place before its counter says so: no lock.

    Args:
        size: samples that it holds.
    """

    def __init__(self, size: int) -> None:
        if size < 1:
            raise ValueError(f"a ring of {size} samples, expected 1 or more")
        self._samples = np.zeros(size, dtype=np.float32)
        self.n_written = 0
        self.n_read = 0

    @property
    def size(self) -> int:
        """Return how many samples it holds at most."""
        return self._samples.size

    @property
    def level(self) -> int:
        """Return how many samples wait to be read."""
        return self.n_written - self.n_read

    def write(self, samples: NDArray[np.float32]) -> int:
        """Take in as many samples as there is room for, and return how many."""
        n = min(samples.size, self.size - self.level)
        at = self.n_written % self.size
        first = min(n, self.size - at)
        self._samples[at : at + first] = samples[:first]
        self._samples[: n - first] = samples[first:n]
        self.n_written += n
        return n

    def read_into(self, out: NDArray[np.float32]) -> int:
        """Fill an array with what waits, zeros behind it, and return how many were there."""
        n = min(out.size, self.level)
        at = self.n_read % self.size
        first = min(n, self.size - at)
        out[:first] = self._samples[at : at + first]
        out[first:n] = self._samples[: n - first]
        out[n:] = 0.0
        self.n_read += n
        return n
