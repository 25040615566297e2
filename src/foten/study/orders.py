"""Orders of trials that are balanced over textures and methods, by Williams squares.

Source: Williams, Australian Journal of Scientific Research A 2, 149 (1949).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.int64]


@dataclass(frozen=True)
class Trial:
    """A comparison of a participant."""

    number: int  # from 1; practice trials are 0 and below
    texture: int
    method: int

    @property
    def practice(self) -> bool:
        """Whether it does not count."""
        return self.number < 1


def williams(k: int) -> Rows:
    """Rows of 0 … k − 1, shape (k, k), or (2 k, k) for an odd k, in whose columns each number occurs equally often, and so does
    each pair of neighbours.
    """
    first = np.array([(i + 1) // 2 if i % 2 else -(i // 2) for i in range(k)])
    rows = (np.arange(k)[:, None] + first) % k
    return rows if k % 2 == 0 or k == 1 else np.concatenate([rows, rows[:, ::-1]])


def orders(
    n_participants: int, n_textures: int, n_methods: int, seed: int, practice: int, order: str
) -> list[list[Trial]]:
    """Trials of each participant, practice first.

    Args:
        n_textures, n_methods: each texture with each method is a trial.
        seed: of everything that is drawn.
        practice: how many trials come before, drawn from the same.
        order: "balanced", or "random" for a permutation drawn for each participant, as in Sec. VII.
    """
    rng, n_trials = np.random.default_rng(seed), n_textures * n_methods
    if order == "balanced":
        counted = _balanced(rng, n_participants, n_textures, n_methods)
    else:
        counted = [rng.permutation(n_trials).tolist() for _ in range(n_participants)]
    result = []
    for pairs in counted:
        drawn = rng.permutation(n_trials)[:practice].tolist()
        numbered = enumerate([*drawn, *pairs], 1 - practice)
        result.append([Trial(number, *divmod(pair, n_methods)) for number, pair in numbered])
    return result


def _balanced(rng: np.random.Generator, n: int, textures: int, methods: int) -> list[list[int]]:
    """Trials of each participant, as texture × methods + method.

    A round holds each texture once, in the order of a row of a square; a texture's methods over the rounds are a row of another
    square. Participants take the rows in turn.
    """
    texture_rows, method_rows = williams(textures), williams(methods)
    texture_of, method_of = rng.permutation(textures), rng.permutation(methods)  # which is called what in the squares
    row_of = _rounds(rng, texture_rows, methods)
    result = []
    for p in range(n):
        pairs = []
        for r in range(methods):
            for t in texture_rows[(p + row_of[r]) % len(texture_rows)]:
                m = method_rows[(t + p) % len(method_rows), r]
                pairs.append(int(texture_of[t]) * methods + int(method_of[m]))
        result.append(pairs)
    # In which turn a participant comes says nothing of the row.
    size = square(textures, methods)
    turns = [start + int(i) for start in range(0, n, size) for i in rng.permutation(min(size, n - start))]
    return [result[i] for i in turns]


def square(n_textures: int, n_methods: int) -> int:
    """Number of participants whose orders are exactly balanced; so are those of each multiple."""
    return math.lcm(len(williams(n_textures)), len(williams(n_methods)))


def planned(
    n_participants: int, n_textures: int, n_methods: int, seed: int, practice: int, order: str
) -> list[list[Trial]]:
    """Orders that a study stores: of its participants, and behind them a quarter more for those who leave."""
    counts = n_textures, n_methods, seed, practice, order
    # Not the first of a longer list: within a square those who come would then be any of its rows.
    n_with_reserves = n_participants + max(2, n_participants // 4)
    return orders(n_participants, *counts) + orders(n_with_reserves, *counts)[n_participants:]


def _rounds(rng: np.random.Generator, rows: Rows, n_rounds: int) -> list[int]:
    """Offset of each round's row in the square, such that no texture ends a round and begins the next."""
    chosen = [0]
    for _ in range(n_rounds - 1):
        ends = np.roll(rows[:, -1], -chosen[-1])
        repeats = [int(np.sum(ends == np.roll(rows[:, 0], -offset))) for offset in range(len(rows))]
        fewest = min(repeats)
        unused = [i for i, many in enumerate(repeats) if many == fewest and i not in chosen]
        chosen.append(int(rng.choice(unused or [i for i, many in enumerate(repeats) if many == fewest])))
    return chosen


def balance(orders: list[list[Trial]], n_textures: int, n_methods: int) -> dict[str, tuple[int, int]]:
    """Smallest and largest count of a texture's method in a round, of a texture at a place of a round, and of a texture behind
    another one within a round.
    """
    counted = np.array([[(t.texture, t.method) for t in trials if not t.practice] for trials in orders])
    # (participants, rounds, places) each.
    texture, method = np.moveaxis(counted.reshape(-1, n_methods, n_textures, 2), -1, 0)
    _, in_round, place = np.indices(texture.shape)
    rounds = np.zeros((n_textures, n_methods, n_methods), dtype=int)
    places, behind = (np.zeros((n_textures, n_textures), dtype=int) for _ in range(2))
    np.add.at(rounds, (texture, method, in_round), 1)
    np.add.at(places, (texture, place), 1)
    np.add.at(behind, (texture[..., :-1], texture[..., 1:]), 1)
    different = behind[~np.eye(n_textures, dtype=bool)]
    named = {"method in round": rounds, "texture at place": places, "neighbours": different}
    return {name: (int(counts.min()), int(counts.max())) for name, counts in named.items() if counts.size}
