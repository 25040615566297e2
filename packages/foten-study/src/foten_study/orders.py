"""Orders of trials, balanced over textures and methods by the squares of Williams, Austral. J. Sci. Res. A 2, 149 (1949)."""

import math
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.int64]
Condition = tuple[int, int | None]  # a method, and another one that it is compared with


@dataclass(frozen=True)
class Order:
    """How the trials of a task follow from textures and methods."""

    pairs: bool = False  # two methods are compared: either is the first as often as the other
    n_targets: int = 0  # places of what is right, drawn anew for each trial: nothing to count
    rounds: bool = False  # answers come in rounds, each of all textures and methods in an order of its own


SINGLE = Order()  # each method by itself


@dataclass(frozen=True)
class Trial:
    """A question to a participant: a texture by one method, or by two that are compared.

    Of ABX the target is which of both X is; of an oddity and of a threshold in which interval the other one is.
    """

    number: int  # from 1; practice trials are 0 and below
    texture: int
    method: int
    other: int | None = None
    target: int = 0

    @property
    def practice(self) -> bool:
        """Whether it does not count."""
        return self.number < 1


def conditions(kind: Order, n_methods: int, repeats: int = 1) -> list[Condition]:
    """What a participant judges on each texture: methods, or pairs of them."""
    single: list[Condition] = [(method, None) for method in range(n_methods)]
    pairs: list[Condition] = [*combinations(range(n_methods), 2)]
    return repeats * (pairs if kind.pairs else single)


def williams(k: int) -> Rows:
    """Rows of 0 … k − 1, shape (k, k), or (2 k, k) for an odd k, in whose columns each number occurs equally often, and so does
    each pair of neighbours.
    """
    first = np.array([(i + 1) // 2 if i % 2 else -(i // 2) for i in range(k)])
    rows = (np.arange(k)[:, None] + first) % k
    return rows if k % 2 == 0 or k == 1 else np.concatenate([rows, rows[:, ::-1]])


def orders(
    n_participants: int,
    n_textures: int,
    n_methods: int,
    seed: int,
    practice: int,
    order: str,
    kind: Order = SINGLE,
    repeats: int = 1,
) -> list[list[Trial]]:
    """Trials of each participant, practice first, drawn from the same: each texture with each method, or each pair of them.

    Args:
        order: "balanced", or "random" for a permutation drawn for each participant, as in Sec. VII; of no effect on rounds.
        repeats: how often each condition is asked; of a threshold, how many answers it takes.
    """
    rng, per_texture = np.random.default_rng(seed), conditions(kind, n_methods, repeats)
    n_conditions = len(per_texture)
    n_trials = n_textures * n_conditions
    if kind.rounds:
        rounds = [np.arange(n_trials).reshape(n_textures, repeats, n_methods)[:, r].ravel() for r in range(repeats)]
        counted = [[int(i) for one in rounds for i in rng.permutation(one)] for _ in range(n_participants)]
    elif order == "balanced":
        counted = _balanced(rng, n_participants, n_textures, n_conditions)
    else:
        counted = [rng.permutation(n_trials).tolist() for _ in range(n_participants)]
    result = []
    for indices in counted:
        drawn = rng.permutation(n_trials)[:practice].tolist()
        swaps: dict[Any, list[bool]] = {}
        trials = []
        for number, index in enumerate([*drawn, *indices], 1 - practice):
            texture, condition = divmod(index, n_conditions)
            method, other = per_texture[condition]
            if other is not None:
                deck = swaps.setdefault((number < 1, method, other), [])  # practice has its own
                if not deck:
                    deck += [bool(i) for i in rng.permutation(2)]
                method, other = (other, method) if deck.pop() else (method, other)
            target = int(rng.integers(kind.n_targets)) if kind.n_targets else 0
            trials.append(Trial(number, texture, method, other, target))
        result.append(trials)
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


def planned(n_participants: int, *plan: Any) -> list[list[Trial]]:
    """Orders that a study stores, of the arguments of `orders`: its participants', and a quarter more for those who leave."""
    # Not the first of a longer list: within a square those who come would then be any of its rows.
    n_with_reserves = n_participants + max(2, n_participants // 4)
    return orders(n_participants, *plan) + orders(n_with_reserves, *plan)[n_participants:]


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


def balance(
    orders: list[list[Trial]], n_textures: int, n_methods: int, kind: Order = SINGLE
) -> dict[str, tuple[int, int]]:
    """Smallest and largest count of a texture's method in a round, of a texture at a place of a round, and of a texture behind
    another one; of pairs and rounds, of each method shown first and each right answer, instead of the method's round.
    """
    counted = [[trial for trial in trials if not trial.practice] for trials in orders]
    # (participants, rounds, places).
    texture = np.array([[trial.texture for trial in trials] for trials in counted]).reshape(len(orders), -1, n_textures)
    place = np.indices(texture.shape)[2]
    places, behind = (np.zeros((n_textures, n_textures), dtype=int) for _ in range(2))
    np.add.at(places, (texture, place), 1)
    np.add.at(behind, (texture[..., :-1], texture[..., 1:]), 1)
    named = {"texture at place": places, "neighbours": behind[~np.eye(n_textures, dtype=bool)]}
    methods = np.array([[trial.method for trial in trials] for trials in counted])
    if kind == SINGLE:
        rounds = np.zeros((n_textures, n_methods, n_methods), dtype=int)
        np.add.at(rounds, (texture, methods.reshape(texture.shape), np.indices(texture.shape)[1]), 1)
        named["method in round"] = rounds
    else:
        named["method first"] = np.bincount(methods.ravel(), minlength=n_methods)
    if kind.n_targets:
        targets = [trial.target for trials in counted for trial in trials]
        named["right answer"] = np.bincount(targets, minlength=kind.n_targets)
    return {name: (int(counts.min()), int(counts.max())) for name, counts in named.items() if counts.size}
