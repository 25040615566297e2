"""Analysis of a study, from a database to numbers and sentences; the task's own part is its `TaskKind`'s."""

from collections import Counter

from foten.untrusted import parse_toml
from foten_study.design import task_of
from foten_study.store import Store
from foten_study.tasks.kind import Ratings, Result
from foten_study.tasks.table import TASKS

MIN_COMPLETE = 3  # participants


class TooFewError(ValueError):
    """There are answers, and of too few participants to test anything."""


def analyse(store: Store, reference: str | None = None, correction: str = "bonferroni") -> list[Result]:
    """Results of a study, one for each scale; the stars of Fig. 9 are by a correction of `results.CORRECTIONS`.

    ValueError where there is no answer, or the reference is no method; TooFewError for fewer than three complete participants.
    """
    every = read_ratings(store)
    ratings = every[0]
    if reference is not None and reference not in ratings.methods:
        raise ValueError(f"the reference is {reference!r}, expected one of {', '.join(ratings.methods)}")
    if len(ratings.complete) < MIN_COMPLETE:
        n, began = len(ratings.complete), len(ratings.numbers)
        answered = f"participants who have answered everything: {n}, of {began} who began"
        raise TooFewError(f"{answered}; expected three or more; foten study status says who is where")
    return TASKS[ratings.task.kind].analyse(every, reference, correction)


def read_ratings(store: Store) -> list[Ratings]:
    """Answers in a database, by scale; ValueError where there is none yet, or they are of another task than the design's."""
    stimuli, rows = store.stimuli(), store.ratings()
    if not rows:
        raise ValueError(f"{store.path} holds no answers yet; foten study status says who is where")
    numbers = sorted({row["participant"] for row in rows})
    answered = Counter(row["participant"] for row in rows)
    text = str(store.study["design"])
    task = task_of(text)
    ratings = Ratings(
        str(store.study["title"]),
        store.simulated,
        str(store.study["software"]),
        task,
        methods=[stimuli[0, m].method_key for m in range(1 + max(m for _, m in stimuli))],
        textures=[stimuli[t, 0].texture_key for t in range(1 + max(t for t, _ in stimuli))],
        rows=rows,
        numbers=numbers,
        complete=[n for n in numbers if answered[n] == sum(not trial.practice for trial in store.trials(n))],
        answers=store.answers(),
        abouts=store.abouts(),
    )
    try:
        return TASKS[task.kind].read(ratings, parse_toml(text))
    except ValueError as error:
        raise ValueError(f"{store.path}: {error}") from error
