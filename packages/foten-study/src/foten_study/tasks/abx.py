"""ABX: two methods and X, which is one of both: which?"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from foten_study.choice_statistics import Sensitivity, abx, abx_share
from foten_study.choosing import Discrimination
from foten_study.orders import Trial
from foten_study.statistics import Array

CHOICES = ("A", "B")


def surfaces(trial: Trial) -> tuple[int, ...]:
    """Both methods, and again the target."""
    assert trial.other is not None
    pair = trial.method, trial.other
    return (*pair, pair[trial.target])


def sensitivity_of(numbers: Sequence[int], rows: Sequence[dict[str, Any]]) -> Sensitivity:
    """Sensitivity of participants to one pair of methods, of its trials."""
    counts = np.zeros((2, len(numbers), 2))  # by which method X was, participant, and which one was answered
    for row in rows:
        swapped = row["method"] > row["other"]  # A is here the method of the lower number
        truth, answer = (int(place) ^ swapped for place in (row["target"], row["rating"]))
        counts[truth, numbers.index(row["participant"]), answer] += 1
    return abx(counts[0], counts[1])


def draw(rng: np.random.Generator, share: Array, per_pair: int) -> Sensitivity:
    """Sensitivity of people whose shares of right answers are some; X is either method as often."""
    n_a = per_pair // 2 + (per_pair % 2) * (np.arange(len(share)) % 2)  # of X as A
    right = rng.binomial(n_a, share), rng.binomial(per_pair - n_a, share)
    x_a, x_b = (right[0], n_a - right[0]), (per_pair - n_a - right[1], right[1])
    return abx(np.stack(x_a, axis=1), np.stack(x_b, axis=1))


ABX = Discrimination("ABX", CHOICES, abx_share, sensitivity_of, draw)
KIND = ABX.kind(surfaces, ("A", "B", "X"), "which_x")
