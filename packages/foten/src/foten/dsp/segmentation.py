"""Segmentation of a signal into stationary autoregressions by the minimum description length.

A signal of n samples cut into m + 1 pieces of n_j samples, each of order p_j with Yule–Walker variance σ_j², takes in nats

    log m + (m + 1) log n + Σ log p_j + Σ (p_j + 2)/2 · log n_j + Σ n_j/2 · log(2π σ_j²)      (log 0 counted as 0)

Source: AutoPARM of Davis, Lee and Rodriguez-Yam, J. Am. Stat. Assoc. 101 (2006), which [12] cuts recordings with. Differs from
it: the cuts are found by dynamic programming on a grid and then moved by single samples, not by a genetic search.
"""

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.ar import levinson

Index = NDArray[np.int64]

MAX_ORDER = 20
MIN_PIECE_SAMPLES = np.array([10, 10, 12, 14, 16, 18, 20, *[25] * 4, *[50] * 10])
"""The fewest samples of a piece of each order; as in the source."""
_MIN_VARIANCE = 1e-12  # of a piece, relative to the signal's power
_PASSES = 5  # over all cuts, at most, when they are moved


def pieces_of(x: Array, max_order: int = MAX_ORDER, grid: int = 50, longest: int | None = None) -> tuple[Index, float]:
    """Cuts of the shortest description of x (n,), of mean zero, rising, and its length in nats.

    Places `grid` samples apart, 10 or more, are tried for a cut, which is moved by single samples afterwards. A piece has an
    order up to `max_order`, `MAX_ORDER` at most, and up to `longest` samples, two steps of the grid or more; None for any number.
    """
    longest = x.size if longest is None else longest
    description = _Description(x, max_order)
    places = np.append(np.arange(0, x.size - grid + 1, grid), x.size)
    # Of the pieces that end at each place, a row for each number of places before it that they begin at.
    costs = np.full((min(longest // grid, len(places) - 1), len(places)), np.inf)
    for i, row in enumerate(costs, start=1):
        begin, end = places[:-i], places[i:]
        row[i:] = np.where(end - begin <= longest, description.of(begin, end), np.inf)
    cuts = places[_best(costs, np.log(x.size))]
    for _ in range(_PASSES):
        changed = _with_cuts_moved(description, cuts, grid, longest)
        if np.array_equal(changed, cuts):
            break
        cuts = changed
    edges, m = np.concatenate([[0], cuts, [x.size]]), len(cuts)
    each = description.of(edges[:-1], edges[1:])
    return cuts, float(each.sum() + (m + 1) * np.log(x.size) + np.log(max(m, 1)))


class _Description:
    """Description lengths of pieces of one signal, without what their number takes."""

    def __init__(self, x: Array, max_order: int) -> None:
        self.n = x.size
        self._sums = np.zeros((max_order + 1, x.size + 1))
        for lag in range(max_order + 1):
            np.cumsum(x[lag:] * x[: x.size - lag], out=self._sums[lag, lag + 1 :])
        self._min_variance = _MIN_VARIANCE * max(float(np.square(x).mean()), np.finfo(float).tiny)

    def of(self, begin: Index, end: Index) -> Array:
        """Nats of pieces from samples `begin` to before `end`, each by its best order: (b,), (b,) → (b,)."""
        n = (end - begin).astype(float)
        p = np.arange(len(self._sums))[:, None]
        moments = (self._sums[p, end] - self._sums[p, np.minimum(begin + p, end)]) / n
        moments[0] = np.maximum(moments[0], self._min_variance)
        _, errors = levinson(moments)
        nats = np.log(np.maximum(p, 1)) + (p + 2) / 2 * np.log(n)
        nats = nats + n / 2 * np.log(2 * np.pi * np.maximum(errors, self._min_variance))
        return np.asarray(np.where(n >= MIN_PIECE_SAMPLES[p], nats, np.inf).min(axis=0))


def _best(costs: Array, each: float) -> Index:
    """Places to cut at, from the nats of pieces that end at each place (w, k) and those of one piece more."""
    w, k = costs.shape
    begin = np.arange(k) - np.arange(1, w + 1)[:, None]  # of a piece; below 0 the costs are infinite
    # The logarithm of the number of pieces does not add up, so their number is a state too; it only bounds that number.
    shortest, pieces = np.full(k, np.inf), np.zeros(k, dtype=int)
    shortest[0] = 0.0
    for j in range(1, k):
        reached = shortest[begin[:, j]] + costs[:, j] + each
        i = int(reached.argmin())
        shortest[j], pieces[j] = reached[i], pieces[begin[i, j]] + 1
    nats, totals, before = np.where(np.arange(k) == 0, 0.0, np.inf), [], []
    for _ in range(pieces[-1]):
        reached = nats[begin] + costs
        before.append(begin[reached.argmin(axis=0), np.arange(k)])
        nats = reached.min(axis=0)
        totals.append(nats[-1])
    numbers = np.arange(1, len(totals) + 1)
    number = int((totals + numbers * each + np.log(np.maximum(numbers - 1, 1))).argmin()) + 1
    cuts, place = [], k - 1
    for begins in before[number - 1 : 0 : -1]:
        place = int(begins[place])
        cuts.append(place)
    return np.array(cuts[::-1], dtype=int)


def _with_cuts_moved(description: _Description, cuts: Index, grid: int, longest: int) -> Index:
    """Cuts, each moved by at most a step of the grid to where the pieces beside it are shortest."""
    edges = np.concatenate([[0], cuts, [description.n]])
    for j in range(1, len(edges) - 1):
        before, after = edges[j - 1], edges[j + 1]
        tried = np.arange(max(before + 1, edges[j] - grid), min(after, edges[j] + grid + 1))
        tried = tried[(tried - before <= longest) & (after - tried <= longest)]
        edges[j] = tried[int((description.of(before, tried) + description.of(tried, after)).argmin())]
    return edges[1:-1]
