"""What there is to say of a task, and what its analysis takes and gives. `table.TASKS` has a `TaskKind` for each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from foten_study.orders import SINGLE, Order, Trial
from foten_study.statistics import Array

PAPER_SD = 10.67  # of the ratings of FoTEN; Sec. VIII
AIM = 0.8  # power that a study should have
CHOICE = "choice"  # key of an answer that is one of several
MINUTES_PER_CHOICE = 1 / 3  # of one of two or three surfaces; assumed


def limited(default: Any, *allowed: Any) -> Any:
    """A field of a study file: its default, and its bounds, or the texts that it may be."""
    return field(default=default, metadata={"allowed": allowed})


@dataclass(frozen=True)
class Task:
    """What a participant does in a trial, as a study file has it; empty texts are those of the study's language."""

    kind: str = "rating"  # a key of `table.TASKS`
    question: str = ""
    lowest: str = ""  # 0
    highest: str = ""  # 100, as in Sec. VII
    min_seconds: float = limited(0.0, 0, 600)  # of a trial, before an answer is taken
    repeats: int = limited(1, 1, 100)  # of each comparison
    feedback: str = limited("practice", "none", "practice", "all")  # whether the answer was right, where one is
    measures: str = limited("detection", "detection", "difference")  # the difference in level that is just noticeable
    answers: int = limited(25, 8, 200)  # to each threshold
    low_db: float = -60.0  # of what a threshold's trials play: re recorded, or of the increment re the pedestal
    high_db: float = limited(0.0, -86, 24)


@dataclass(frozen=True)
class Rated:
    """Outcome of a trial."""

    values: Mapping[str, float]  # by scale: 0 … 100, or under `CHOICE` which surface was chosen, from 0
    response_s: float | None = None  # from when the trial was shown
    switches: int | None = None  # between the real and the virtual surface
    log: Mapping[str, Any] = field(default_factory=dict)  # what else was measured


@dataclass(frozen=True)
class Ratings:
    """Answers of a study on one scale, or to its one question, and what participants answered beside them."""

    title: str
    simulated: bool
    software: str  # version of foten that made the study
    task: Task
    methods: list[str]
    textures: list[str]
    rows: list[dict[str, Any]]  # in long form
    numbers: list[int]  # of the participants
    complete: list[int]  # numbers of the participants who answered everything
    answers: list[dict[str, Any]]  # to the questions that are not private, by participant
    abouts: list[dict[str, Any]]  # to the private ones, without numbers
    quantity: str = ""  # what the values are: a scale's key, a kind of threshold, or a share
    unit: str = ""
    conditions: list[str] = field(default_factory=list)  # methods, or pairs of them
    # (participants, conditions, textures), NaN where there is none
    values: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))
    factor: str = "method"  # what conditions are of
    noun: str = "ratings"  # what the answers are called
    in_other_words: Callable[[float], str] = lambda mean: ""  # what is said behind a mean
    thresholds: list[dict[str, Any]] = field(default_factory=list)  # each, with what is known of it

    @property
    def key(self) -> str:
        """Name of the results: a scale's key, or the task's."""
        return self.quantity if self.task.kind == "rating" else self.task.kind

    @property
    def y(self) -> Array:
        """Values of the participants who answered everything."""
        return self.values[np.isin(self.numbers, self.complete)]

    @property
    def label(self) -> str:
        """Quantity and unit."""
        return f"{self.quantity} [{self.unit}]" if self.unit else f"{self.quantity} (0 to 100)"


@dataclass(frozen=True)
class Result:
    """Numbers and sentences of a study."""

    ratings: Ratings
    document: dict[str, Any]  # every number
    sentences: list[str]  # ready for a paper
    cautions: list[str]


@dataclass(frozen=True)
class Plan:
    """A study that is simulated: to try its analysis, or to learn how many people it needs."""

    task: Task
    methods: int
    textures: int
    effect: float | None = None  # of the kind that `TaskKind.effect` has; None for that one, or for the paper's
    sd: float = PAPER_SD  # of ratings between raters
    correlation: float = 0.3  # between two ratings by one rater
    better: int = -1  # number of the better method
    scales: tuple[str, ...] = ()  # keys


Answer = tuple[dict[str, float], dict[str, float]]
"""Values of a trial, and what was measured in it."""
People = Callable[[int, float], Callable[[Trial], Answer]]
"""From a number and a standard normal deviate to a person: from a trial to her answer."""


@dataclass(frozen=True)
class Power:
    """Power for numbers of participants."""

    heading: str
    table: list[dict[str, float]]
    needed: int | None  # participants; None where the largest number shown is too small
    note: str


@dataclass(frozen=True)
class TaskKind:
    """A task. Each callable is the task's own part of a stage of the study.

    `read` gives answers with their values, by scale, of all answers without values and the study file as a document; `analyse`
    takes them with a reference (or None) and the correction of the stars; `simulate` so many people; `power` so many studies and
    a seed; `level_db` is that of a trial after answers (level [dB], right), `gain_db` that of a surface at a level.
    """

    surfaces: Callable[[Trial], tuple[int, ...]]
    read: Callable[[Ratings, Mapping[str, Any]], list[Ratings]]
    analyse: Callable[[list[Ratings], str | None, str], list[Result]]
    simulate: Callable[[Plan, int, np.random.Generator], People]
    power: Callable[[Plan, int, int], Power]
    effect: float  # that a new study is planned to find
    effect_in_words: str
    n_studies: tuple[int, int]  # that are simulated to plan: by `foten study power`, by `foten study new`
    order: Order = SINGLE
    form: str = "choice"  # script of the page's part that takes an answer
    intervals: tuple[str, ...] = ()  # names of the surfaces of a trial, where there are several
    choices: tuple[str, ...] = ()  # of which one is the answer
    settings: tuple[str, ...] = ()  # keys of [task], beside kind, question and min_seconds
    new_lines: tuple[str, ...] = ()  # of [task] in a new study file, with texts of the language by name
    question: Callable[[Task], str] = lambda task: "question"  # key of the language's
    min_methods: int = 2
    beside_real: bool = False  # the real surface is touched too
    minutes: float = MINUTES_PER_CHOICE  # of a trial
    columns: tuple[str, ...] = ()  # of ratings.csv, beside those of every task
    level_db: Callable[[Task, Sequence[tuple[float, bool]], bool], float] | None = None
    gain_db: Callable[[Task, float, bool], float] | None = None


def check_answers(task: Task, values: Sequence[Any]) -> None:
    """Refuse answers of another task: each of these has a number where one of its own has it."""
    if not all(isinstance(value, int | float) for value in values):
        raise ValueError(f"answers are not those of the design's task, {task.kind!r}")
