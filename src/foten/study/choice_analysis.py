"""Analysis of choices between surfaces: paired comparisons, ABX and the oddity task."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from foten.reporting.table import minus
from foten.study.analysis import Ratings, Result, about, json_value, means_of, of_trials, p_text, who_left
from foten.study.choices import Sensitivity, Strengths, abx, bradley_terry, oddity
from foten.study.design import CHOICES
from foten.study.statistics import ALPHA, Array, holm, pairs

MAX_LEANING = 0.1  # of the share of a position, above an even one
CHANCE = {"paired": 1 / 2, "abx": 1 / 2, "oddity": 1 / 3}  # share of right answers of those who guess


def analyse_choices(ratings: Ratings, reference: str | None, correction: str) -> Result:
    """Result of a study of choices: strengths of methods, or how well each pair of them is told apart."""
    document = about(ratings, correction)
    document |= {"means": means_of(ratings), "chance": CHANCE[ratings.task.kind]}
    cautions = who_left(ratings)
    document["positions"] = positions = _positions(ratings)
    even = 1 / len(positions)
    if leaning := [name for name, share in positions.items() if share > even + MAX_LEANING]:
        share = 100 * positions[leaning[0]]
        cautions.append(
            f"{leaning[0]} was chosen in {share:.0f} % of trials, {100 * even:.0f} % is even: a leaning to a position"
        )
    if ratings.task.kind == "paired":
        index = None if reference is None else ratings.methods.index(reference)
        strengths = bradley_terry(wins_in(ratings, ratings.rows), index)
        document["strengths"] = _of_strengths(ratings.methods, strengths)
        document["strengths_within_textures"] = {
            texture: _of_strengths(ratings.methods, bradley_terry(wins_in(ratings, rows), index))
            for texture, rows in _by_texture(ratings).items()
        }
        within = document["strengths_within_textures"]
        if apart := ["all textures"] * strengths.separated + [key for key, one in within.items() if one["separated"]]:
            cautions.append(
                f"{', '.join(apart)}: a method was always, or never, chosen over others: half a win each way was added to "
                "every pair, and the strengths are not the maximum of the likelihood, which has none"
            )
        sentences = _sentences_of_strengths(ratings, document)
    else:
        overall = _sensitivities(ratings, ratings.rows, reference)
        document["sensitivity"] = overall
        document["sensitivity_within_textures"] = {
            texture: _sensitivities(ratings, rows, reference) for texture, rows in _by_texture(ratings).items()
        }
        sentences = _sentences_of_sensitivity(ratings, overall)
    return Result(ratings, document, [minus(sentence) for sentence in sentences], cautions + of_trials(ratings))


def _positions(ratings: Ratings) -> dict[str, float]:
    """Share of trials in which each surface was chosen."""
    names = CHOICES[ratings.task.kind]
    counts = Counter(int(row["rating"]) for row in ratings.rows)
    return {name: counts[k] / len(ratings.rows) for k, name in enumerate(names)}


def _by_texture(ratings: Ratings) -> dict[str, list[dict[str, Any]]]:
    return {key: [row for row in ratings.rows if row["texture"] == t] for t, key in enumerate(ratings.textures)}


def wins_in(ratings: Ratings, rows: Sequence[dict[str, Any]]) -> Array:
    """How often participants chose a method over another, shape (participants, methods, methods)."""
    k = len(ratings.methods)
    wins = np.zeros((len(ratings.numbers), k, k))
    for row in rows:
        shown = row["method"], row["other"]
        chosen = int(row["rating"])
        wins[ratings.numbers.index(row["participant"]), shown[chosen], shown[1 - chosen]] += 1
    return wins


def _of_strengths(methods: Sequence[str], strengths: Strengths) -> dict[str, Any]:
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


def _sensitivities(ratings: Ratings, rows: Sequence[dict[str, Any]], reference: str | None) -> list[dict[str, Any]]:
    """d′ of each pair of methods, or of those with a reference."""
    index = None if reference is None else ratings.methods.index(reference)
    result = []
    for i, j in pairs(len(ratings.methods), index):
        of_pair = [row for row in rows if {row["method"], row["other"]} == {i, j}]
        sensitivity = sensitivity_of(ratings.task.kind, ratings.numbers, of_pair)
        names = [one.name for one in fields(Sensitivity)]
        values = {name: json_value(getattr(sensitivity, name)) for name in names}
        result.append({"pair": [ratings.methods[i], ratings.methods[j]], **values})
    p = np.array([row["p"] for row in result])
    adjusted = {"p_bonferroni": np.minimum(len(p) * p, 1.0), "p_holm": holm(p)}
    return [{**row, **{name: float(values[k]) for name, values in adjusted.items()}} for k, row in enumerate(result)]


def sensitivity_of(task: str, numbers: Sequence[int], rows: Sequence[dict[str, Any]]) -> Sensitivity:
    """Sensitivity of participants to one pair of methods.

    Args:
        rows: trials of the pair: participant, target, and the surface chosen as `rating`.
    """
    n = len(numbers)
    if task == "oddity":
        right, trials = np.zeros(n), np.zeros(n)
        for row in rows:
            i = numbers.index(row["participant"])
            trials[i] += 1
            right[i] += row["rating"] == row["target"]
        return oddity(right, trials)
    counts = np.zeros((2, n, 2))  # by which method X was, participant, and which one was answered
    for row in rows:
        swapped = row["method"] > row["other"]  # A is here the method of the lower number
        truth, answer = (int(place) ^ swapped for place in (row["target"], row["rating"]))
        counts[truth, numbers.index(row["participant"]), answer] += 1
    return abx(counts[0], counts[1])


def _who(ratings: Ratings, many: str) -> str:
    who = "simulated raters" if ratings.simulated else "participants"
    b = len(ratings.textures)
    return f"{len(ratings.numbers)} {who} {many} {len(ratings.methods)} methods on {b} texture{'s' * (b > 1)}"


def _sentences_of_strengths(ratings: Ratings, document: dict[str, Any]) -> list[str]:
    strengths = document["strengths"]
    overall = strengths["overall"]
    shown = ", ".join(f"{row['method']} {row['log_odds']:+.2f}{_ends(row)}" for row in strengths["methods"])
    best = max(strengths["methods"], key=lambda row: row["log_odds"])
    sentences = [
        f"{_who(ratings, 'compared')} in pairs ({len(ratings.rows)} choices).",
        f"Strengths by Bradley and Terry's model, in log-odds of mean 0 with 95 % intervals over participants: {shown}.",
    ]
    if overall["p"] is not None:
        f = "" if overall["f"] is None else f"F({overall['df'][0]}, {overall['df'][1]}) = {overall['f']:.2f}, "
        sentences.append(
            f"Hypothesis that no method is preferred: {f}{p_text(overall['p'])} (Hotelling's T²; p by participants' signs)."
        )
    preferred = overall["p"] is not None and overall["p"] < ALPHA
    return [*sentences, f"The strongest is {best['method']}." if preferred else "No method is shown to be preferred."]


def _sentences_of_sensitivity(ratings: Ratings, overall: Sequence[dict[str, Any]]) -> list[str]:
    name = "ABX" if ratings.task.kind == "abx" else "the three-interval oddity task"
    sentences = [
        f"{_who(ratings, 'were to tell apart')}, by {name} ({len(ratings.rows)} answers). "
        "d′ is by the differencing model, of all answers together, with 95 % intervals over participants."
    ]
    for row in overall:
        sentences.append(
            f"{row['pair'][0]} and {row['pair'][1]}: {100 * row['share']:.0f} % right of {row['n_trials']:.0f} answers "
            f"({100 * CHANCE[ratings.task.kind]:.0f} % by chance), d′ = {row['d_prime']:.2f}{_ends(row)}; "
            f"exact one-sided test against chance, {p_text(row['p_holm'])}{' (Holm)' * (len(overall) > 1)}."
        )
    return sentences


def _ends(row: dict[str, Any]) -> str:
    low, high = (row[f"ci95_{end}"] for end in ("low", "high"))
    if low is None and high is None:
        return ""
    return f" ({'−∞' if low is None else f'{low:.2f}'} to {'∞' if high is None else f'{high:.2f}'})"
