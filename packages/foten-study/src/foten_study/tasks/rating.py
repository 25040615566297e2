"""Rating: one surface beside the real one, on one scale of 0 to 100 or several, as in Sec. VII."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from foten_study.orders import Trial
from foten_study.tasks.kind import Answer, People, Plan, Power, Ratings, TaskKind
from foten_study.variance import MIN_DIFFERENCE, analyse_means, paper_raters, power_of_means, raters_for

SIMILARITY = "similarity"  # key of the one scale where a study file has none
MINUTES = 90 / 48  # Sec. VII: 90 minutes for 48 comparisons
PAPER_SIZE = 4, 12  # methods and textures


def read(ratings: Ratings, document: Mapping[str, Any]) -> list[Ratings]:
    """Ratings on each scale."""
    keys = [str(scale["key"]) for scale in document.get("scales", [])] or [SIMILARITY]
    result = []
    for key in keys:
        rows = [row for row in ratings.rows if row["scale"] == key]
        values = np.full((len(ratings.numbers), len(ratings.methods), len(ratings.textures)), np.nan)
        for row in rows:
            values[ratings.numbers.index(row["participant"]), row["method"], row["texture"]] = row["rating"]
        complete = [n for n, one in zip(ratings.numbers, values, strict=True) if np.isfinite(one).all()]
        of_key = replace(ratings, quantity=key, conditions=ratings.methods, rows=rows)
        result.append(replace(of_key, values=values, complete=complete))
    return result


def simulate(plan: Plan, n: int, rng: np.random.Generator) -> People:
    """People who rate as a model of raters does."""
    points = MIN_DIFFERENCE if plan.effect is None else plan.effect
    raters = raters_for(plan.methods, plan.textures, points, plan.sd, plan.correlation, plan.better)
    drawn = {key: np.round(raters.draw(rng, n)) for key in plan.scales}

    def person(i: int, _deviate: float) -> Callable[[Trial], Answer]:
        return lambda trial: ({key: float(y[i, trial.method, trial.texture]) for key, y in drawn.items()}, {})

    return person


def power(plan: Plan, studies: int, seed: int) -> Power:
    """Power of the tests of means."""
    if plan.effect is None and (plan.methods, plan.textures) == PAPER_SIZE:
        raters, of = paper_raters(plan.sd, plan.correlation), "the paper's effects (Sec. VII)"
    else:
        points = MIN_DIFFERENCE if plan.effect is None else plan.effect
        raters = raters_for(plan.methods, plan.textures, points, plan.sd, plan.correlation)
        of = f"a difference of {points:g} point{'s' * (points != 1)}"
    return power_of_means(raters, plan, studies, seed, of)


KIND = TaskKind(
    surfaces=lambda trial: (trial.method,),
    read=read,
    analyse=analyse_means,
    simulate=simulate,
    power=power,
    effect=MIN_DIFFERENCE,
    effect_in_words=f"a difference of {MIN_DIFFERENCE:g} points on a texture",
    n_studies=(500, 300),
    form="rating",
    settings=("lowest", "highest"),
    new_lines=("question = {question}", "lowest = {lowest}", "highest = {highest}"),
    beside_real=True,
    minutes=MINUTES,
    columns=("scale", "rating"),
)
