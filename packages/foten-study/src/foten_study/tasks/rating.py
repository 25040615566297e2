"""Rating: one surface beside the real one, on one scale of 0 to 100 or several, as in Sec. VII."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from foten_study.orders import Trial
from foten_study.raters import MIN_DIFFERENCE, PAPER_SD, paper_raters, raters_for
from foten_study.tasks.kind import Answer, People, Population, Power, PowerQuery, Ratings, TaskKind
from foten_study.variance import analyse_means, power_of_means

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


def simulate(population: Population, rng: np.random.Generator) -> People:
    """People who rate as a model of raters does."""
    drawn = {key: np.round(population.raters.draw(rng, population.n)) for key in population.scales}

    def person(i: int, _deviate: float) -> Callable[[Trial], Answer]:
        return lambda trial: ({key: float(y[i, trial.method, trial.texture]) for key, y in drawn.items()}, {})

    return person


def power(query: PowerQuery) -> Power:
    """Power of the tests of means."""
    sd = query.sd or PAPER_SD
    if query.effect is None and (query.methods, query.textures) == PAPER_SIZE:
        raters, of = paper_raters(sd, query.correlation), "the paper's effects (Sec. VII)"
    else:
        points = MIN_DIFFERENCE if query.effect is None else query.effect
        raters = raters_for(query.methods, query.textures, points, sd, query.correlation)
        of = f"a difference of {points:g} point{'s' * (points != 1)}"
    return power_of_means(raters, query, of)


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
