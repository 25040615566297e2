"""What the tasks share in which one surface is chosen of several: shares, leanings to a position, power."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from foten.recording.recording import counted
from foten_study.raters import AIM
from foten_study.results import about, means_of, who_left
from foten_study.statistics import ALPHA, Array
from foten_study.tasks.kind import Power, PowerQuery, Ratings, check_answers

MAX_LEANING = 0.1  # of the share of a position, above an even one
SHOWN = (4, 8, 12, 16, 21, 30, 40, 60)  # numbers of participants whose power is printed
PValues = Callable[[np.random.Generator, int, int], tuple[float, Array]]
"""p of a study's overall test and of pairs, of so many participants with so many trials of each pair."""


def shares_of(
    ratings: Ratings, quantity: str, conditions: list[str], hits: Callable[[Mapping[str, Any]], Mapping[int, bool]]
) -> Ratings:
    """Shares [%] by participant, condition and texture, of what a row is a hit or a miss of."""
    check_answers(ratings.task, [row["other"] for row in ratings.rows])
    counts = np.zeros((2, len(ratings.numbers), len(conditions), len(ratings.textures)))  # of hits, and of all
    for row in ratings.rows:
        for condition, hit in hits(row).items():
            counts[:, ratings.numbers.index(row["participant"]), condition, row["texture"]] += hit, 1
    values = 100 * np.divide(counts[0], counts[1], out=np.full(counts[0].shape, np.nan), where=counts[1] > 0)
    return replace(ratings, quantity=quantity, unit="%", noun="choices", conditions=conditions, values=values)


def beginning(ratings: Ratings, names: Sequence[str], correction: str) -> tuple[dict[str, Any], list[str]]:
    """Beginning of a document about choices between surfaces, and cautions: about who left, and a leaning to a position."""
    counts = Counter(int(row["rating"]) for row in ratings.rows)
    shares = {name: counts[k] / len(ratings.rows) for k, name in enumerate(names)}
    even = 1 / len(names)
    leaning = [name for name, share in shares.items() if share > even + MAX_LEANING]
    cautions = [
        f"{name} was chosen in {100 * shares[name]:.0f} % of trials, {100 * even:.0f} % is even: a leaning to a position"
        for name in leaning[:1]
    ]
    document = {**about(ratings, correction), "means": means_of(ratings), "chance": even, "positions": shares}
    return document, who_left(ratings, "what they answered is counted") + cautions


def by_texture(ratings: Ratings) -> dict[str, list[dict[str, Any]]]:
    """Rows of each texture."""
    return {key: [row for row in ratings.rows if row["texture"] == t] for t, key in enumerate(ratings.textures)}


def who_compared(ratings: Ratings, did: str) -> str:
    """Beginning of a sentence about participants, methods and textures."""
    who = "simulated raters" if ratings.simulated else "participants"
    b = len(ratings.textures)
    return f"{len(ratings.numbers)} {who} {did} {len(ratings.methods)} methods on {b} texture{'s' * (b > 1)}"


def ends(row: Mapping[str, Any]) -> str:
    """Interval of a row in brackets; empty where neither end is known."""
    low, high = (row[f"ci95_{end}"] for end in ("low", "high"))
    if low is None and high is None:
        return ""
    return f" ({'−∞' if low is None else f'{low:.2f}'} to {'∞' if high is None else f'{high:.2f}'})"


def power(p_values: PValues, n: int, per_pair: int, studies: int, seed: int) -> dict[str, float]:
    """Share of studies with n people in which something is found at `ALPHA`: `any` by the overall test, and `pair`, the mean
    over pairs, after adjustment.
    """
    rng = np.random.default_rng(seed)
    drawn = [p_values(rng, n, per_pair) for _ in range(studies)]
    return {
        "any": float(np.mean([p < ALPHA for p, _ in drawn])),
        "pair": float(np.mean([(p < ALPHA).mean() for _, p in drawn])),
    }


def power_of_choices(p_values: PValues, query: PowerQuery, of: str, pair: str) -> Power:
    """Power for the numbers of `SHOWN`, and the smallest of them whose `pair` reaches `AIM`, if any does."""
    per_pair = query.textures * query.task.repeats
    table = [{"participants": float(n), **power(p_values, n, per_pair, query.studies, query.seed)} for n in SHOWN]
    needed = next((n for n, row in zip(SHOWN, table, strict=True) if row["pair"] >= AIM), None)
    trials = counted(per_pair, "trial")
    heading = f"{of}, {query.methods} methods, {trials} of each pair by each participant, α = 0.05"
    return Power(heading, table, needed, f"any: the test of all methods; pair: {pair}, adjusted for all pairs")
