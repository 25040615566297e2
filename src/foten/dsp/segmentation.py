"""Where a signal becomes another one: pieces that are autoregressions each, by the minimum description length.

A signal of n samples cut into m + 1 pieces of n_j samples, each an autoregression of order p_j with Yule–Walker variance σ_j²,
takes

    log m + (m + 1) log n + Σ log p_j + Σ (p_j + 2)/2 · log n_j + Σ n_j/2 · log(2π σ_j²)      (log 0 counted as 0)

nats to tell. Differs from the source: found by dynamic programming, exactly over all cuts on a grid and then moved by single
samples while that is shorter, not by a genetic search.

Source: AutoPARM of Davis, Lee and Rodriguez-Yam, J. Am. Stat. Assoc. 101 (2006), which [12] cuts recordings with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.dsp.ar import levinson

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MAX_ORDER = 20
_LEAST_SPANS = (10, 10, 12, 14, 16, 18, 20, *[25] * 4, *[50] * 10)
"""The fewest samples of a piece of each order; as in the source."""
_QUIETEST = (
    1e-12  # variance of a piece as a share of the signal's power: a silent piece is not infinitely short to tell
)
_PASSES = 5  # over all cuts, at most, when they are moved
_AT_ONCE = 100_000  # pieces that are fitted together


@dataclass(frozen=True)
class Pieces:
    """A signal's pieces.

    Attributes:
        cuts: where each but the first begins, rising, shape (m,).
        orders: of each, shape (m + 1,).
        nats: the description length.
    """

    cuts: Index
    orders: Index
    nats: float


def pieces_of(x: Array, max_order: int = MAX_ORDER, grid: int = 50, longest: int | None = None) -> Pieces:
    """Return the pieces of a signal with the shortest description.

    Args:
        x: shape (n,), of mean zero.
        max_order: of a piece, 20 at most.
        grid: samples between places that are tried for a cut; a cut is moved by single samples afterwards.
        longest: samples that a piece may have; None for any number.

    Raises:
        ValueError: the signal is too short, or a size cannot be.
    """
    if not 0 <= max_order <= MAX_ORDER:
        raise ValueError(f"max_order is {max_order}, expected 0 to {MAX_ORDER}")
    if grid < _LEAST_SPANS[0] or (longest is not None and longest < 2 * grid):
        raise ValueError(
            f"a grid of {grid} and pieces of {longest} at most cannot be, expected a grid of 10 or more, and twice as much"
        )
    if x.size < 2 * grid:
        raise ValueError(f"the signal has {x.size} samples, expected at least two steps of the grid, {2 * grid}")
    description = _Description(x, max_order)
    places = np.append(np.arange(0, x.size - grid + 1, grid), x.size)
    cuts = places[_best(description.between(places, longest), np.log(x.size))]
    for _ in range(_PASSES):
        moved = _moved(description, cuts, grid, longest)
        if np.array_equal(moved, cuts):
            break
        cuts = moved
    edges = np.concatenate([[0], cuts, [x.size]])
    each, orders = description.of(edges[:-1], edges[1:])
    m = len(cuts)
    return Pieces(cuts, orders, float(each.sum() + (m + 1) * np.log(x.size) + (np.log(m) if m else 0.0)))


class _Description:
    """What pieces of one signal take to tell, without what their number takes."""

    def __init__(self, x: Array, max_order: int) -> None:
        self.n = x.size
        self._sums = np.zeros((max_order + 1, x.size + 1))
        for lag in range(max_order + 1):
            np.cumsum(x[lag:] * x[: x.size - lag], out=self._sums[lag, lag + 1 :])
        self._quietest = _QUIETEST * max(float(np.square(x).mean()), np.finfo(float).tiny)

    def of(self, begin: Index, end: Index) -> tuple[Array, Index]:
        """Return the nats of pieces from samples `begin` to before `end`, and the order that takes the fewest, each (b,)."""
        parts = [self._some(begin[i : i + _AT_ONCE], end[i : i + _AT_ONCE]) for i in range(0, len(begin), _AT_ONCE)]
        return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])

    def _some(self, begin: Index, end: Index) -> tuple[Array, Index]:
        n = (end - begin).astype(float)
        lags = np.arange(len(self._sums))
        first = np.minimum(begin + lags[:, None], end)
        moments = (
            np.take_along_axis(self._sums, np.broadcast_to(end, first.shape), 1)
            - np.take_along_axis(self._sums, first, 1)
        ) / n
        moments[0] = np.maximum(moments[0], self._quietest)
        _, errors = levinson(moments)
        p = lags[:, None]
        nats = np.log(np.maximum(p, 1)) + (p + 2) / 2 * np.log(n)
        nats = nats + n / 2 * np.log(2 * np.pi * np.maximum(errors, self._quietest))
        nats = np.where(n >= np.array(_LEAST_SPANS[: len(lags)])[:, None], nats, np.inf)
        orders = nats.argmin(axis=0)
        return nats[orders, np.arange(len(n))], orders

    def between(self, places: Index, longest: int | None) -> Array:
        """Return the nats of the pieces that end at each place and begin so many places before, infinite where there is none.

        Returns:
            Shape (w, k), the first row for one place before; w as many as the longest piece has.
        """
        k = len(places)
        widest = k - 1 if longest is None else int(np.searchsorted(places, longest, side="right"))
        back, last = np.meshgrid(np.arange(1, widest + 1), np.arange(k), indexing="ij")
        there = back <= last
        first, last = (last - back)[there], last[there]
        allowed = places[last] - places[first] <= (self.n if longest is None else longest)
        first, last = first[allowed], last[allowed]
        costs = np.full((widest, k), np.inf)
        costs[last - first - 1, last], _ = self.of(places[first], places[last])
        return costs


def _best(costs: Array, each: float) -> Index:
    """Return at which of the places to cut: the nats of pieces, as `between` gives them, and those of one piece more."""
    w, k = costs.shape
    # By how many pieces a place is reached with: the logarithm of their number does not add up. It only grows, so there are no
    # more pieces than without it.
    least, pieces = np.full(k, np.inf), np.zeros(k, dtype=int)
    least[0] = 0.0
    for j in range(1, k):
        back = np.arange(1, min(w, j) + 1)
        reached = least[j - back] + costs[back - 1, j] + each
        i = int(reached.argmin())
        least[j], pieces[j] = reached[i], pieces[j - back[i]] + 1
    most = int(pieces[-1])
    nats = np.full((most + 1, k), np.inf)
    nats[0, 0] = 0.0
    before = np.zeros((most + 1, k), dtype=int)
    for number in range(1, most + 1):
        for away in range(1, w + 1):
            reached = nats[number - 1, :-away] + costs[away - 1, away:]
            better = reached < nats[number, away:]
            nats[number, away:][better] = reached[better]
            before[number, away:][better] = np.flatnonzero(better)
    numbers = np.arange(1, most + 1)
    number = int((nats[1:, -1] + numbers * each + np.log(np.maximum(numbers - 1, 1))).argmin()) + 1
    cuts, place = [], k - 1
    for left in range(number, 1, -1):
        place = int(before[left, place])
        cuts.append(place)
    return np.array(cuts[::-1], dtype=int)


def _moved(description: _Description, cuts: Index, grid: int, longest: int | None) -> Index:
    """Return each cut in turn where the two pieces beside it are shortest to tell, at most a step of the grid away."""
    edges = np.concatenate([[0], cuts, [description.n]])
    for j in range(1, len(edges) - 1):
        tried = np.arange(max(edges[j - 1] + 1, edges[j] - grid), min(edges[j + 1], edges[j] + grid + 1))
        if longest is not None:
            tried = tried[(tried - edges[j - 1] <= longest) & (edges[j + 1] - tried <= longest)]
        nats = (
            description.of(np.full(len(tried), edges[j - 1]), tried)[0]
            + description.of(tried, np.full(len(tried), edges[j + 1]))[0]
        )
        edges[j] = tried[int(nats.argmin())]
    return edges[1:-1]
