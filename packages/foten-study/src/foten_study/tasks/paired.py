"""Paired comparison: two methods of a texture; which is nearer to the real surface?"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from foten.reporting.table import minus
from foten_study.choice_statistics import Strengths, bradley_terry
from foten_study.choosing import beginning, by_texture, ends, power_of_choices, shares_of, who_compared
from foten_study.orders import Order, Trial
from foten_study.results import by_pair, json_rows, json_values, of_trials, p_text
from foten_study.statistics import ALPHA, Array, pairs
from foten_study.tasks.kind import CHOICE, Answer, People, Plan, Power, Ratings, Result, TaskKind

INTERVALS = ("A", "B")
EFFECT = 0.65  # share of choices of the better method over another one
SPREAD = 0.4  # of log-odds of each method between people


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
    of_methods = {name: getattr(strengths, name) for name in ("log_odds", "ci95_low", "ci95_high")}
    share = 1 / (1 + np.exp(-strengths.tests["difference"]))
    tests = {"pairs": strengths.tests["pairs"], "df": strengths.tests["df"], **strengths.tests, "share": share}
    return {
        "methods": [{"method": method, **row} for method, row in zip(methods, json_rows(of_methods), strict=True)],
        "pairs": by_pair(methods, tests),
        "overall": json_values(strengths.overall),
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


def people_of(plan: Plan, rng: np.random.Generator, n: int) -> Array:
    """Log-odds of each method (n, methods) of people who choose the better one over each other with the share of the effect."""
    effect = EFFECT if plan.effect is None else plan.effect
    if not 0.01 <= effect <= 0.99:
        raise ValueError(f"the share of choices is {effect:g}, expected 0.01 to 0.99")
    strengths = np.zeros(plan.methods)
    strengths[plan.better] = np.log(effect / (1 - effect))
    return strengths + SPREAD * rng.standard_normal((n, plan.methods))


def p_values(plan: Plan, rng: np.random.Generator, n: int, per_pair: int) -> tuple[float, Array]:
    """p of a simulated study's overall test, and of each pair of the better method, by Holm's adjustment."""
    people = people_of(plan, rng, n)
    wins = np.zeros((n, plan.methods, plan.methods))
    for a, b in pairs(plan.methods):
        wins[:, a, b] = rng.binomial(per_pair, 1 / (1 + np.exp(people[:, b] - people[:, a])))
        wins[:, b, a] = per_pair - wins[:, a, b]
    strengths = bradley_terry(wins)
    of_better = [plan.better % plan.methods in pair for pair in strengths.tests["pairs"]]
    return strengths.overall["p"], strengths.tests["p_holm"][of_better]


def simulate(plan: Plan, n: int, rng: np.random.Generator) -> People:
    """People who choose by log-odds of their own."""
    people = people_of(plan, rng, n)

    def person(i: int, _deviate: float) -> Callable[[Trial], Answer]:
        def answer(trial: Trial) -> Answer:
            assert trial.other is not None
            first = 1 / (1 + np.exp(people[i, trial.other] - people[i, trial.method]))
            return {CHOICE: float(rng.random() >= first)}, {}

        return answer

    return person


def power(plan: Plan, studies: int, seed: int) -> Power:
    """Power of the tests of strengths."""
    of = f"{100 * (EFFECT if plan.effect is None else plan.effect):.0f} % of choices for one method"
    return power_of_choices(p_values, plan, studies, seed, of, "the better method from another one")


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
