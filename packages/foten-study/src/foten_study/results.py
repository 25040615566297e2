"""What analyses of all tasks share: the beginning of a document, means, cautions, numbers as people read them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from foten_study.statistics import ALPHA, Paired, SignedRank
from foten_study.tasks.kind import Ratings

CORRECTIONS = {"bonferroni": "Bonferroni", "holm": "Holm"}  # of many tests: the paper's, and one of more power


def about(ratings: Ratings, correction: str) -> dict[str, Any]:
    """What every document begins with."""
    return {
        "title": ratings.title,
        "simulated": ratings.simulated,
        "software": ratings.software,
        "task": ratings.task.kind,
        "quantity": ratings.quantity,
        "unit": ratings.unit,
        "correction": correction,
        "participants": {"began": len(ratings.numbers), "complete": len(ratings.complete), "numbers": ratings.complete},
    }


def means_of(ratings: Ratings) -> list[dict[str, Any]]:
    """Means of each method on each texture, and of all textures, where the texture is None."""
    from scipy import stats

    means = []
    for m, method in enumerate(ratings.conditions):
        columns = [*zip(ratings.textures, ratings.values[:, m].T, strict=True), (None, ratings.y[:, m].mean(-1))]
        for texture, of_texture in columns:
            values = of_texture[np.isfinite(of_texture)]
            n, mean, sd = values.size, float(values.mean()), float(values.std(ddof=1))
            half = float(stats.t.ppf(0.975, n - 1)) * sd / n**0.5
            row = {"method": method, "texture": texture, "n": n, "mean": mean, "sd": sd}
            means.append(row | {"ci95_low": mean - half, "ci95_high": mean + half})
    return means


def by_pair(methods: Sequence[str], tests: Paired | SignedRank) -> list[dict[str, Any]]:
    """Tests as JSON has them, a row for each pair."""
    columns = {
        name: np.broadcast_to(values, len(tests.pairs)) for name, values in vars(tests).items() if name != "pairs"
    }
    return [
        {"pair": [methods[i], methods[j]], **{name: json_value(values[k]) for name, values in columns.items()}}
        for k, (i, j) in enumerate(tests.pairs)
    ]


def who_left(ratings: Ratings, tests: str) -> list[str]:
    """Caution about participants who did not answer everything, with what tests do about them."""
    n, began = len(ratings.complete), len(ratings.numbers)
    if n == began:
        return []
    return [f"{began - n} of {began} participants did not answer everything: {tests}"]


def of_trials(ratings: Ratings) -> list[str]:
    """Cautions about trials."""
    trials = list({(row["participant"], row["trial"]): row for row in ratings.rows}.values())
    cautions = []
    if corrected := sum(row["corrected"] for row in ratings.rows):
        cautions.append(f"ratings corrected by hand: {corrected}; the log of the study says which")
    if under := sum(bool(row["measured"].get("n_underruns")) for row in trials):
        cautions.append(f"trials in which the sound had under-runs: {under}")
    if stopped := sum(bool(row["measured"].get("n_stopped")) for row in trials):
        cautions.append(f"trials in which the output ended by itself: {stopped}")
    if without := sum(row["measured"].get("contact_s") == 0 for row in trials):
        cautions.append(f"trials that were answered without a stroke on the virtual surface: {without}")
    cautions += _of_thresholds(ratings)
    if partly := sum(_misses_one(row["measured"]) for row in trials):
        cautions.append(f"trials that were answered without a stroke on each of the surfaces: {partly}")
    return cautions


def _of_thresholds(ratings: Ratings) -> list[str]:
    """Cautions about thresholds."""
    cautions, of = [], ratings.thresholds
    if missed := [one for one in of if not one["reached"]]:
        which = "; ".join(f"participant {one['participant']}, {one['texture']}, {one['method']}" for one in missed[:5])
        more = f" and {len(missed) - 5} more" if len(missed) > 5 else ""
        cautions.append(
            f"{len(missed)} of {len(of)} thresholds are not reached, at an end of the levels that were played ({which}{more}): "
            "their values are bounds, and the tests take them as values; thresholds.csv says which"
        )
    if changed := sum(one["volume_range_db"] > 0 for one in of):
        cautions.append(f"the volume was changed while a threshold was searched for: {changed} of {len(of)}")
    return cautions


def _misses_one(measured: dict[str, Any]) -> bool:
    seconds = [value for name, value in measured.items() if name.startswith("contact_s_")]
    return 0 in seconds and any(seconds)


def p_text(value: float) -> str:
    """p as journals print it."""
    return "p < .001" if value < 0.001 else f"p = {value:.3f}".replace("0.", ".")


def stars(p: float | None) -> str:
    """Marks of Fig. 9: *** below .001, ** below .01, * below .05."""
    if p is None or not p < ALPHA:
        return ""
    return "***" if p < 0.001 else "**" if p < 0.01 else "*"


def json_value(value: Any) -> Any:
    """A value as JSON has it, None for NaN."""
    if isinstance(value, str | tuple):
        return value if isinstance(value, str) else list(value)
    return float(value) if np.isfinite(value) else None
