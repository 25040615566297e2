"""Paired comparison: two methods of a texture; which is nearer to the real surface?"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from foten.reporting.table import minus
from foten_study.choosing import beginning, by_texture, ends, power_of_choices, shares_of, who_compared
from foten_study.orders import Order, Trial
from foten_study.results import json_value, of_trials, p_text
from foten_study.statistics import ALPHA, Array, pairs
from foten_study.strengths import Strengths, bradley_terry
from foten_study.tasks.kind import CHOICE, Answer, People, Population, Power, PowerQuery, Ratings, Result, TaskKind

INTERVALS = ("A", "B")
EFFECT = 0.65  # share of choices of the better method over another one


def surfaces(trial: Trial) -> tuple[int, ...]:
    """Both methods."""
    assert trial.other is not None
    return trial.method, trial.other


def read(ratings: Ratings, _document: Mapping[str, Any]) -> list[Ratings]:
    """Shares of choices of each method."""

    def hits(row: Mapping[str, Any]) -> dict[int, bool]:
        return {method: row["rating"] == place for place, method in enumerate((row["method"], row["other"]))}

    return [shares_of(ratings, "share of choices", ratings.methods, hits)]


def analyse(every: list[Ratings], reference: str | None, correction: str) -> list[Result]:
    """Strengths of methods."""
    (ratings,) = every
    document, cautions = beginning(ratings, INTERVALS, correction)
    index = None if reference is None else ratings.methods.index(reference)
    strengths = bradley_terry(wins_in(ratings, ratings.rows), index)
    document["strengths"] = _as_json(ratings.methods, strengths)
    within = document["strengths_within_textures"] = {
        texture: _as_json(ratings.methods, bradley_terry(wins_in(ratings, rows), index))
        for texture, rows in by_texture(ratings).items()
    }
    if apart := ["all textures"] * strengths.separated + [key for key, one in within.items() if one["separated"]]:
        cautions.append(
            f"{', '.join(apart)}: a method was always, or never, chosen over others: half a win each way was added to "
            "every pair, and the strengths are not the maximum of the likelihood, which has none"
        )
    sentences = [minus(sentence) for sentence in _sentences(ratings, document)]
    return [Result(ratings, document, sentences, cautions + of_trials(ratings))]


def wins_in(ratings: Ratings, rows: Sequence[dict[str, Any]]) -> Array:
    """How often participants chose a method over another, shape (participants, methods, methods)."""
    k = len(ratings.methods)
    wins = np.zeros((len(ratings.numbers), k, k))
    for row in rows:
        shown = row["method"], row["other"]
        chosen = int(row["rating"])
        wins[ratings.numbers.index(row["participant"]), shown[chosen], shown[1 - chosen]] += 1
    return wins


def _as_json(methods: Sequence[str], strengths: Strengths) -> dict[str, Any]:
    """Strengths as JSON has them."""
    by_method = zip(methods, strengths.log_odds, strengths.ci95_low, strengths.ci95_high, strict=True)
    names = ("difference", "t", "p", "p_bonferroni", "p_holm")
    rows = []
    for k, (i, j) in enumerate(strengths.pairs):
        row = {"pair": [methods[i], methods[j]], "df": strengths.df}
        row |= {name: json_value(getattr(strengths, name)[k]) for name in names}
        row |= {
            "ci95_low": json_value(strengths.difference_low[k]),
            "ci95_high": json_value(strengths.difference_high[k]),
        }
        rows.append({**row, "share": float(1 / (1 + np.exp(-strengths.difference[k])))})
    return {
        "methods": [
            {"method": name, "log_odds": float(value), "ci95_low": json_value(low), "ci95_high": json_value(high)}
            for name, value, low, high in by_method
        ],
        "pairs": rows,
        "overall": {
            "f": json_value(strengths.overall_f),
            "df": list(strengths.overall_df),
            "p": json_value(strengths.overall_p),
        },
        "separated": strengths.separated,
    }


def _sentences(ratings: Ratings, document: dict[str, Any]) -> list[str]:
    strengths = document["strengths"]
    overall = strengths["overall"]
    shown = ", ".join(f"{row['method']} {row['log_odds']:+.2f}{ends(row)}" for row in strengths["methods"])
    best = max(strengths["methods"], key=lambda row: row["log_odds"])
    sentences = [
        f"{who_compared(ratings, 'compared')} in pairs ({len(ratings.rows)} choices).",
        f"Strengths by Bradley and Terry's model, in log-odds of mean 0 with 95 % intervals over participants: {shown}.",
    ]
    if overall["p"] is not None:
        f = "" if overall["f"] is None else f"F({overall['df'][0]}, {overall['df'][1]}) = {overall['f']:.2f}, "
        sentences.append(
            f"Hypothesis that no method is preferred: {f}{p_text(overall['p'])} (Hotelling's T²; p by participants' signs)."
        )
    preferred = overall["p"] is not None and overall["p"] < ALPHA
    return [*sentences, f"The strongest is {best['method']}." if preferred else "No method is shown to be preferred."]


@dataclass(frozen=True)
class Choosers:
    """A model of people who prefer a method.

    Args:
        n_methods: that are compared.
        effect: share of choices of the better method over each other one.
        spread: of log-odds of each method between people.
        better: number of the method that is chosen more often.
    """

    n_methods: int
    effect: float
    spread: float = 0.4
    better: int = -1

    def __post_init__(self) -> None:
        if not 0.01 <= self.effect <= 0.99:
            raise ValueError(f"the share of choices is {self.effect:g}, expected 0.01 to 0.99")

    def people(self, rng: np.random.Generator, n: int) -> Array:
        """Log-odds of each method (n, methods)."""
        strengths = np.zeros(self.n_methods)
        strengths[self.better] = np.log(self.effect / (1 - self.effect))
        return strengths + self.spread * rng.standard_normal((n, self.n_methods))

    def p_values(self, rng: np.random.Generator, n: int, per_pair: int) -> tuple[float, Array]:
        """p of a simulated study's overall test, and of each pair of the better method, by Holm's adjustment.

        Args:
            per_pair: trials of each pair by each participant.
        """
        people = self.people(rng, n)
        wins = np.zeros((n, self.n_methods, self.n_methods))
        for a, b in pairs(self.n_methods):
            wins[:, a, b] = rng.binomial(per_pair, 1 / (1 + np.exp(people[:, b] - people[:, a])))
            wins[:, b, a] = per_pair - wins[:, a, b]
        strengths = bradley_terry(wins)
        better = self.better % self.n_methods
        return strengths.overall_p, strengths.p_holm[[better in pair for pair in strengths.pairs]]


def simulate(population: Population, rng: np.random.Generator) -> People:
    """People who choose by log-odds of their own."""
    choosers = Choosers(population.n_methods, population.effect, better=population.better)
    people = choosers.people(rng, population.n)

    def person(i: int, _deviate: float) -> Callable[[Trial], Answer]:
        def answer(trial: Trial) -> Answer:
            assert trial.other is not None
            first = 1 / (1 + np.exp(people[i, trial.other] - people[i, trial.method]))
            return {CHOICE: float(rng.random() >= first)}, {}

        return answer

    return person


def power(query: PowerQuery) -> Power:
    """Power of the tests of strengths."""
    effect = EFFECT if query.effect is None else query.effect
    choosers = Choosers(query.methods, effect)
    of = f"{100 * effect:.0f} % of choices for one method"
    return power_of_choices(choosers.p_values, query, of, "the better method from another one")


KIND = TaskKind(
    surfaces=surfaces,
    read=read,
    analyse=analyse,
    simulate=simulate,
    power=power,
    effect=EFFECT,
    effect_in_words=f"a share of {100 * EFFECT:.0f} % of choices over another method",
    n_studies=(200, 60),
    order=Order(pairs=True),
    intervals=INTERVALS,
    choices=INTERVALS,
    settings=("repeats",),
    question=lambda task: "which_nearer",
    beside_real=True,
    columns=("other", "choice", "chosen", "contact_s_1", "contact_s_2"),
)
