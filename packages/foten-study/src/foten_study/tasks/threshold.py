"""Threshold: three surfaces, one of which vibrates, or vibrates more, at a level that follows the answers.

Levels L are in dB: of the vibration re its recorded level, or of the increment re the pedestal that the other two have: a
difference in level of 20 log₁₀(1 + 10^(L/20)).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from foten_study.adaptive import Detection, LevelSearch
from foten_study.orders import Order, Trial
from foten_study.statistics import Array
from foten_study.tasks.kind import CHOICE, Answer, People, Plan, Power, Ratings, Task, TaskKind, check_answers
from foten_study.variance import Raters, analyse_means, power_of_means

MIN_ANSWERS = 8  # of a threshold
SILENT_DB = -240.0
SLOPE, LAPSE = 0.2, 0.02  # of simulated people; [1/dB] and a share
PERSON_SD_DB = 5.0  # of thresholds between people
CONDITION_SD_DB = 1.0  # and of each person's between conditions
N_ERRORS = 200  # simulated, for what a search leaves open
EFFECT_DB = 3.0
INTERVALS = ("1", "2", "3")
UNITS = {"detection": "dB re recorded", "difference": "dB re the other surfaces"}
QUANTITIES = {"detection": "threshold of detection", "difference": "just noticeable increment"}
QUESTIONS = {"detection": "which_felt", "difference": "which_stronger"}  # by what is measured, keys of words


def surfaces(trial: Trial) -> tuple[int, ...]:
    """One method three times; the target is louder."""
    return (trial.method,) * len(INTERVALS)


def level_db(task: Task, answers: Sequence[tuple[float, bool]], practice: bool) -> float:
    """Level of a trial, which the answers before it lead to [dB]; of practice the highest."""
    return task.high_db if practice else level_search(task, answers).stimulus()


def level_search(task: Task, answers: Iterable[tuple[float, bool]] = ()) -> LevelSearch:
    """Search for a threshold, after some answers: levels [dB], and whether each was right."""
    search = LevelSearch(task.low_db, task.high_db, Detection(1 / len(INTERVALS)))
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


def simulated_answers(task: Task, threshold_db: float, rng: np.random.Generator) -> list[tuple[float, bool]]:
    """Answers of a person of a known threshold [dB] to as many trials as the task has."""
    person, search, answers = Detection(1 / len(INTERVALS)), level_search(task), []
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


def read(ratings: Ratings, document: Mapping[str, Any]) -> list[Ratings]:
    """Thresholds of all participants."""
    task = ratings.task
    check_answers(task, [row["measured"].get("level_db") for row in ratings.rows])
    plays_in_page = document.get("output", {}).get("to", "page") == "page"
    thresholds = _thresholds(task, ratings.rows, plays_in_page)
    values = np.full((len(ratings.numbers), len(ratings.methods), len(ratings.textures)), np.nan)
    for one in thresholds:
        participant, texture = ratings.numbers.index(one["participant"]), ratings.textures.index(one["texture"])
        values[participant, ratings.methods.index(one["method"]), texture] = one["threshold_db"]
    named = replace(ratings, quantity=QUANTITIES[task.measures], unit=UNITS[task.measures], noun="thresholds")
    if task.measures == "difference":
        named = replace(named, in_other_words=lambda db: f", a difference in level of {noticeable_db(db):.1f} dB")
    return [replace(named, conditions=ratings.methods, values=values, thresholds=thresholds)]


def _thresholds(task: Task, rows: Sequence[dict[str, Any]], plays_in_page: bool) -> list[dict[str, Any]]:
    """Thresholds by participant, texture and method; of detection re the recorded level, with a page's volume."""
    tracks: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in rows:
        tracks.setdefault((row["participant"], row["texture_key"], row["method_key"]), []).append(row)
    result = []
    for (participant, texture, method), answers in tracks.items():
        if len(answers) < MIN_ANSWERS:
            continue
        search = level_search(task, [(row["measured"]["level_db"], row["rating"] == row["target"]) for row in answers])
        volumes = [float(row["measured"].get("volume_db") or 0.0) for row in answers]
        volume = float(np.median(volumes)) if plays_in_page and task.measures == "detection" else 0.0
        one = {"participant": participant, "texture": texture, "method": method, "threshold_db": search.point + volume}
        reached = task.low_db + 2 * search.sd < search.point < task.high_db - 2 * search.sd  # within what was played
        one |= {"sd_db": search.sd, "n_answers": len(answers), "reached": int(reached)}
        if task.measures == "difference":
            one["difference_db"] = noticeable_db(search.point)
        result.append({**one, "volume_db": float(np.median(volumes)), "volume_range_db": float(np.ptp(volumes))})
    return result


def simulate(plan: Plan, _n: int, rng: np.random.Generator) -> People:
    """People of a threshold each; that of the better method, or of one method's last texture, is lower by the effect."""
    task, effect = plan.task, EFFECT_DB if plan.effect is None else plan.effect

    def is_better(t: int, m: int) -> bool:
        return m == plan.better % plan.methods if plan.methods > 1 else t == plan.textures - 1

    def person(_i: int, deviate: float) -> Callable[[Trial], Answer]:
        level = (task.low_db + task.high_db) / 2 + PERSON_SD_DB * deviate
        tracks = {}
        for t, m in np.ndindex(plan.textures, plan.methods):
            true_db = level - effect * is_better(t, m) + CONDITION_SD_DB * rng.standard_normal()
            tracks[t, m] = iter(simulated_answers(task, true_db, rng))

        def answer(trial: Trial) -> Answer:
            level_db, right = next(tracks[trial.texture, trial.method])
            chosen = (trial.target + (0 if right else rng.integers(1, len(INTERVALS)))) % len(INTERVALS)
            return {CHOICE: float(chosen)}, {"level_db": level_db}

        return answer

    return person


def threshold_raters(task: Task, methods: int, textures: int, effect: float, seed: int) -> Raters:
    """Raters whose ratings are thresholds [dB], with what a search of the task's answers leaves open, by simulated searches.

    Those of the better method, or of one method's last texture, are lower by the effect; means are at the middle of the scale.
    """
    rng, middle = np.random.default_rng(seed), (task.low_db + task.high_db) / 2
    error = thresholds_of(task, np.full(N_ERRORS, middle), rng).std()
    own, shared = CONDITION_SD_DB**2 + error**2, PERSON_SD_DB**2
    a, b = (methods, textures) if methods > 1 else (textures, 1)
    if a < 2:
        raise ValueError("there is one method on one texture, expected two or more to compare")
    means = np.full((a, b), 50.0)
    means[-1] -= effect
    return Raters(means, float(np.sqrt(own + shared)), float(shared / (own + shared)), 0.0, 0.0)


def power(plan: Plan, studies: int, seed: int) -> Power:
    """Power of the tests of means of thresholds."""
    db = EFFECT_DB if plan.effect is None else plan.effect
    people = threshold_raters(plan.task, plan.methods, plan.textures, db, seed)
    return power_of_means(people, plan, studies, seed, f"a difference of {db:g} dB between thresholds")


KIND = TaskKind(
    surfaces=surfaces,
    read=read,
    analyse=analyse_means,
    simulate=simulate,
    power=power,
    effect=EFFECT_DB,
    effect_in_words=f"a difference of {EFFECT_DB:g} dB between two methods' thresholds",
    n_studies=(500, 300),
    order=Order(n_targets=len(INTERVALS), rounds=True),
    intervals=INTERVALS,
    choices=INTERVALS,
    settings=("feedback", "measures", "answers", "low_db", "high_db"),
    new_lines=(
        'measures = "detection"  # or "difference": the difference in level that is just noticeable',
        "answers = 25            # to each threshold, of each method on each texture",
    ),
    question=lambda task: QUESTIONS.get(task.measures, "question"),
    min_methods=1,
    columns=("choice", "target", "right", "level_db", "contact_s_1", "contact_s_2", "contact_s_3"),
    level_db=level_db,
    gain_db=gain_db,
)
