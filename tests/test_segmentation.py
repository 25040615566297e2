"""Pieces of a signal: the example of the source, a search over all cuts, and what must not be cut."""

from itertools import combinations, pairwise

import numpy as np
import pytest
from scipy.signal import lfilter

from foten.dsp.segmentation import MIN_PIECE_SAMPLES, pieces_of

THREE = ((512, (0.9,)), (256, (1.69, -0.81)), (256, (1.32, -0.81)))


def played(pieces: tuple[tuple[int, tuple[float, ...]], ...], seed: int) -> np.ndarray:
    """Autoregressions one after the other, each going on from the samples before."""
    rng, x = np.random.default_rng(seed), [0.0, 0.0]
    for n, taps in pieces:
        for _ in range(n):
            x.append(sum(tap * x[-1 - i] for i, tap in enumerate(taps)) + rng.standard_normal())
    return np.array(x[2:])


def described(x: np.ndarray, cuts: tuple[int, ...], max_order: int) -> float:
    """Description length as the source writes it, with Yule–Walker by solving its equations."""
    edges = (0, *cuts, x.size)
    m, total = len(cuts), 0.0
    for begin, end in pairwise(edges):
        piece, n = x[begin:end], end - begin
        r = np.array([piece[k:] @ piece[: n - k] / n for k in range(max_order + 1)])
        nats_of_order = []
        for p in range(max_order + 1):
            taps = np.linalg.solve(r[np.abs(np.subtract.outer(range(p), range(p)))], r[1 : p + 1]) if p else np.empty(0)
            error = r[0] - taps @ r[1 : p + 1]
            if n >= MIN_PIECE_SAMPLES[p]:
                nats_of_order.append(np.log(max(p, 1)) + (p + 2) / 2 * np.log(n) + n / 2 * np.log(2 * np.pi * error))
        total += min(nats_of_order, default=np.inf)
    return total + (np.log(m) if m else 0.0) + (m + 1) * np.log(x.size)


def test_the_three_pieces_of_davis_are_found() -> None:
    """50 series of the source's example: at least 85 % in three pieces, the cuts within ten samples at the median."""
    found = [pieces_of(played(THREE, seed), grid=10)[0] for seed in range(50)]
    right = [np.abs(cuts - [512, 768]) for cuts in found if len(cuts) == 2]
    assert len(right) >= 43
    assert np.median(right) <= 10


@pytest.mark.parametrize("seed", range(6))
def test_nothing_on_the_grid_is_shorter(seed: int) -> None:
    """Oracle: all cuts of a short signal on the grid, each told as the source writes it."""
    x = played(((60, (0.9,)), (50, (1.5, -0.9)), (40, (-0.7,))), seed)
    places = range(10, x.size - 9, 10)
    best = min(described(x, cuts, 3) for m in range(4) for cuts in combinations(places, m))
    cuts, nats = pieces_of(x, max_order=3, grid=10)
    assert nats <= best + 1e-9
    assert described(x, tuple(cuts.tolist()), 3) == pytest.approx(nats, rel=1e-12)


def test_a_change_of_loudness_alone_is_found() -> None:
    rng = np.random.default_rng(0)
    x = lfilter([1.0], [1.0, -1.2, 0.8], np.concatenate([rng.standard_normal(700), 3 * rng.standard_normal(700)]))
    assert np.abs(pieces_of(x)[0] - 700).max() < 20


def test_one_process_is_one_piece() -> None:
    n_cuts = [len(pieces_of(played(((3000, (1.5, -0.9)),), seed))[0]) for seed in range(10)]
    assert sum(n_cuts) <= 1


def test_a_long_recording_takes_as_much_longer_as_it_is_long() -> None:
    """Pieces of a second at most: 240 s in 4800 steps of the grid, which a square of them would not fit in memory for."""
    rng = np.random.default_rng(0)
    x = rng.standard_normal(240_000) * np.repeat(rng.uniform(0.2, 5, 240), 1000)
    cuts, _ = pieces_of(x, max_order=2, longest=1000)
    assert np.diff(np.concatenate([[0], cuts, [x.size]])).max() <= 1000
    assert len(set(range(1000, 240_000, 1000)) - {round(cut, -2) for cut in cuts.tolist()}) < 12


def test_silence_is_told() -> None:
    x = np.concatenate([np.zeros(500), np.random.default_rng(0).standard_normal(500)])
    cuts, nats = pieces_of(x)
    assert np.isfinite(nats)
    assert np.abs(cuts - 500).min() <= 2
    assert len(pieces_of(np.zeros(500))[0]) == 0
