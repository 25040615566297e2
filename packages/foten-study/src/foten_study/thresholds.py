"""Thresholds of a study: levels that follow a participant's answers, and people of a known threshold who answer.

In each trial one of three surfaces vibrates (detection), or vibrates more than the other two (difference). Levels L are in dB: of
the vibration re its recorded level, or of the increment re the pedestal: a difference in level of 20 log₁₀(1 + 10^(L/20)).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from foten_study.adaptive import Detection, LevelSearch
from foten_study.statistics import Array
from foten_study.tasks.kind import Task

SILENT_DB = -240.0
SLOPE, LAPSE = 0.2, 0.02  # of simulated people; [1/dB] and a share
N_INTERVALS = 3
UNITS = {"detection": "dB re recorded", "difference": "dB re the other surfaces"}
QUANTITIES = {"detection": "threshold of detection", "difference": "just noticeable increment"}


def level_search(task: Task, answers: Iterable[tuple[float, bool]] = ()) -> LevelSearch:
    """Search for a threshold, after some answers: levels [dB], and whether each was right."""
    search = LevelSearch(task.low_db, task.high_db, Detection(1 / N_INTERVALS))
    for level, right in answers:
        search.answer(level, right)
    return search


def gain_db(task: Task, level_db: float, is_target: bool) -> float:
    """Gain of a surface in a trial of a threshold [dB]."""
    if task.measures == "detection":
        return level_db if is_target else SILENT_DB
    return noticeable_db(level_db) if is_target else 0.0


def noticeable_db(increment_db: float) -> float:
    """Difference in level [dB] that an increment re the pedestal [dB] makes."""
    return float(20 * np.log10(1 + 10 ** (increment_db / 20)))


def is_reached(task: Task, search: LevelSearch) -> bool:
    """Whether a threshold lies within the levels that were played, by two standard deviations of what is known of it."""
    return task.low_db + 2 * search.sd < search.point < task.high_db - 2 * search.sd


def simulated_answers(task: Task, threshold_db: float, rng: np.random.Generator) -> list[tuple[float, bool]]:
    """Answers of a person of a known threshold [dB] to as many trials as the task has."""
    person, search, answers = Detection(1 / N_INTERVALS), level_search(task), []
    for _ in range(task.answers):
        level = search.stimulus()
        right = bool(rng.random() < person(level, np.array(threshold_db), np.array(SLOPE), np.array(LAPSE)))
        search.answer(level, right)
        answers.append((level, right))
    return answers


def thresholds_of(task: Task, true_db: Array, rng: np.random.Generator) -> Array:
    """Thresholds [dB] that are measured with people whose true ones are some, of any shape."""
    measured = [level_search(task, simulated_answers(task, true, rng)).point for true in true_db.ravel()]
    return np.reshape(measured, true_db.shape)
