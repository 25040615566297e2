"""What analyses of all tasks share: the beginning of a document, means, cautions, numbers as people read them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from foten.dsp.inference import student_quantile
from foten_study.statistics import ALPHA
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
    means = []
    for m, method in enumerate(ratings.conditions):
        columns = [*zip(ratings.textures, ratings.values[:, m].T, strict=True), (None, ratings.y[:, m].mean(-1))]
        for texture, of_texture in columns:
            values = of_texture[np.isfinite(of_texture)]
            n, mean, sd = values.size, float(values.mean()), float(values.std(ddof=1))
            half = student_quantile(n) * sd / n**0.5
            row = {"method": method, "texture": texture, "n": n, "mean": mean, "sd": sd}
            means.append(row | {"ci95_low": mean - half, "ci95_high": mean + half})
    return means


def by_pair(methods: Sequence[str], tests: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Tests as JSON has them, a row for each pair."""
    family, columns = tests["pairs"], {name: values for name, values in tests.items() if name != "pairs"}
    rows = json_rows({name: np.broadcast_to(values, len(family)) for name, values in columns.items()})
    return [{"pair": [methods[i], methods[j]], **row} for (i, j), row in zip(family, rows, strict=True)]


def json_rows(columns: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Rows of columns by name."""
    return [json_values(dict(zip(columns, row, strict=True))) for row in zip(*columns.values(), strict=True)]


def json_values(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values by name as JSON has them, None for NaN and the infinite."""
    return {name: json_value(value) for name, value in values.items()}


def who_left(ratings: Ratings, tests: str) -> list[str]:
    """Caution about participants who did not answer everything, with what tests do about them."""
    n, began = len(ratings.complete), len(ratings.numbers)
    if n == began:
        return []
    return [f"{began - n} of {began} participants did not answer everything: {tests}"]


def of_trials(ratings: Ratings) -> list[str]:
    """Cautions about trials."""
    measured = [row["measured"] for row in {(row["participant"], row["trial"]): row for row in ratings.rows}.values()]
    counts = {
        "ratings corrected by hand: {}; the log of the study says which": [row["corrected"] for row in ratings.rows],
        "trials in which the sound had under-runs: {}": [bool(one.get("n_underruns")) for one in measured],
        "trials in which the output ended by itself: {}": [bool(one.get("n_stopped")) for one in measured],
        "trials that were answered without a stroke on the virtual surface: {}": [
            one.get("contact_s") == 0 for one in measured
        ],
    }
    cautions = [text.format(sum(which)) for text, which in counts.items() if any(which)] + _of_thresholds(ratings)
    of_surfaces = [[seconds for name, seconds in one.items() if name.startswith("contact_s_")] for one in measured]
    if partly := sum(0 in seconds and any(seconds) for seconds in of_surfaces):
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
