"""Oddity: three surfaces, one of them by another method: which?"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from foten_study.choice_statistics import Sensitivity, oddity, oddity_share
from foten_study.choosing import Discrimination
from foten_study.orders import Trial
from foten_study.statistics import Array

INTERVALS = ("1", "2", "3")


def surfaces(trial: Trial) -> tuple[int, ...]:
    """One method, and in the place of the target the other one."""
    assert trial.other is not None
    return tuple(trial.other if i == trial.target else trial.method for i in range(len(INTERVALS)))


def sensitivity_of(numbers: Sequence[int], rows: Sequence[dict[str, Any]]) -> Sensitivity:
    """Sensitivity of participants to one pair of methods, of its trials."""
    right, trials = np.zeros(len(numbers)), np.zeros(len(numbers))
    for row in rows:
        i = numbers.index(row["participant"])
        trials[i] += 1
        right[i] += row["rating"] == row["target"]
    return oddity(right, trials)


def draw(rng: np.random.Generator, share: Array, per_pair: int) -> Sensitivity:
    """Sensitivity of people whose shares of right answers are some."""
    return oddity(rng.binomial(per_pair, share).astype(float), np.full(len(share), float(per_pair)))


ODDITY = Discrimination("the three-interval oddity task", INTERVALS, oddity_share, sensitivity_of, draw)
KIND = ODDITY.kind(surfaces, INTERVALS, "which_odd")
