"""Simulated studies: how many people a new one needs, and people who take part in one."""

from __future__ import annotations

import numpy as np

from foten_study.design import Design
from foten_study.new_study import repeats_of_new
from foten_study.orders import conditions, square
from foten_study.raters import Raters
from foten_study.store import Rated, Store
from foten_study.tasks.kind import Population, PowerQuery, Task
from foten_study.tasks.table import TASKS

PARTICIPANTS_OF_ONE = 12  # where there is nothing to compare
MAX_CYCLE = 48  # participants, of squares that a new study fills
MANY = 40  # participants of a new study that would need more than are simulated


def participants_for(task: str, methods: int, textures: int) -> tuple[int, int | None]:
    """Number of participants of a new study, in complete squares where these are small, and how many find the effect that it is
    planned for in `AIM` of studies, if 60 do.
    """
    kind, repeats = TASKS[task], repeats_of_new(task, textures, methods)
    if methods * textures < 2:
        return PARTICIPANTS_OF_ONE, None
    query = PowerQuery(Task(task, repeats=repeats), methods, textures, kind.effect, studies=kind.n_studies[1])
    n = kind.power(query).needed
    many, cycle = n or MANY, square(textures, len(conditions(kind.order, methods, repeats)))
    return (-(-many // cycle) * cycle if cycle <= MAX_CYCLE else many), n


def simulate_study(
    store: Store, design: Design, model: Raters, effect: float, better: int, missing: float, seed: int
) -> None:
    """Let people answer all that a design asks; a share of them leaves before the end.

    Args:
        model: of those who rate, each scale on its own.
        effect: of those who choose, as their task has it.
        better: number of the better method.
    """
    rng, kind, n = np.random.default_rng(seed), design.kind, design.participants
    scales = tuple(scale.key for scale in design.asked)
    sizes = n, len(design.methods), len(design.textures)
    person = kind.simulate(Population(design.task, scales, *sizes, model, effect, better), rng)
    for i in range(n):
        number = store.join(f"SIM{i + 1:03d}")
        trials = [trial for trial in store.trials(number) if not (trial.practice and kind.order.rounds)]
        n_done = len(trials) if rng.random() >= missing else int(rng.integers(1, len(trials)))
        answer = person(i, float(rng.standard_normal()))
        rated = {}
        for trial in trials[:n_done]:
            values, measured = answer(trial)
            rated[f"trial:{trial.number}"] = Rated(values, float(rng.gamma(9, 2.5)), 0, measured)
        store.take_steps(number, rated)
