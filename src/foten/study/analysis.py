"""Analysis of a study: every test of Sec. VII and those that it leaves out, from a database to numbers and sentences.

Ratings and thresholds are here; choices between surfaces are analysed in `choice_analysis`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from foten.dsp.adaptive import LevelSearch
from foten.reporting.table import minus
from foten.study.design import CHOICES, Task, task_of
from foten.study.raters import Raters
from foten.study.statistics import (
    ALPHA,
    Array,
    Effect,
    Friedman,
    Paired,
    SignedRank,
    anova,
    friedman,
    mixed_model,
    paired_tests,
    pairs,
    reliability,
    wilcoxon_tests,
)
from foten.study.store import Store
from foten.study.thresholds import level_search, reported_db

MIN_RELIABILITY = 0.2  # correlation with the others, below which a participant is named
MIN_CORRELATED = 4  # conditions: of two a correlation is 1 or −1
MIN_COMPLETE = 3  # participants
MIN_ANSWERS = 8  # of a threshold
CORRECTIONS = {"bonferroni": "Bonferroni", "holm": "Holm"}  # of many tests: the paper's, and one of more power
QUANTITIES = {"detection": "threshold of detection", "difference": "just noticeable difference"}
NULL_STUDIES, NULL_SEED = 1000, 0
NULL_AT_ONCE = 50  # studies in memory
MIN_NULL_RATE = 0.04  # of errors at ALPHA, below which a test is called conservative


@dataclass(frozen=True)
class Ratings:
    """Answers of a study on one scale, or to its one question, and what participants answered beside them."""

    title: str
    simulated: bool
    software: str  # version of foten that made the study
    task: Task
    quantity: str  # what the values are: a scale's key, a kind of threshold, or a share
    unit: str
    methods: list[str]
    textures: list[str]
    rows: list[dict[str, Any]]  # in long form
    numbers: list[int]  # of the participants
    conditions: list[str]  # methods, or pairs of them
    values: Array  # (participants, conditions, textures), NaN where there is none
    complete: list[int]  # numbers of the participants who answered everything
    answers: list[dict[str, Any]]  # to the questions that are not private, by participant
    abouts: list[dict[str, Any]]  # to the private ones, without numbers

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


class TooFewError(ValueError):
    """There are answers, and of too few participants to test anything."""


def analyse(store: Store, reference: str | None = None, correction: str = "bonferroni") -> list[Result]:
    """Results of a study, one for each scale.

    Analyses of variance, paired tests and ranks take the participants who answered everything; the mixed model takes all ratings.

    Args:
        reference: a method that the others are compared with; None for all pairs.
        correction: of the stars of Fig. 9, a key of `CORRECTIONS`.

    Raises:
        ValueError: there is no answer, or the reference is no method.
        TooFewError: fewer than three participants answered everything.
    """
    from foten.study.choice_analysis import analyse_choices

    every = read_ratings(store)
    ratings = every[0]
    if reference is not None and reference not in ratings.methods:
        raise ValueError(f"the reference is {reference!r}, expected one of {', '.join(ratings.methods)}")
    if len(ratings.complete) < MIN_COMPLETE:
        answered = (
            f"participants who have answered everything: {len(ratings.complete)}, of {len(ratings.numbers)} who began"
        )
        raise TooFewError(f"{answered}; expected three or more; foten study status says who is where")
    if ratings.task.kind in CHOICES and ratings.task.kind != "threshold":
        return [analyse_choices(ratings, reference, correction)]
    index = None if reference is None else ratings.methods.index(reference)
    return [_result(one, index, correction) for one in every]


def read_ratings(store: Store) -> list[Ratings]:
    """Answers in a database, by scale.

    Raises:
        ValueError: there is none yet.
    """
    stimuli, rows = store.stimuli(), store.ratings()
    if not rows:
        raise ValueError(f"{store.path} holds no answers yet; foten study status says who is where")
    textures = [stimuli[t, 0].texture_key for t in range(1 + max(t for t, _ in stimuli))]
    methods = [stimuli[0, m].method_key for m in range(1 + max(m for _, m in stimuli))]
    numbers = sorted({row["participant"] for row in rows})
    task, scales = task_of(str(store.study["design"]))
    study = str(store.study["title"]), store.simulated, str(store.study["software"]), task
    beside = store.answers(), store.abouts()
    names = methods, textures
    if task.kind == "rating":
        result = []
        for scale in scales:
            of_scale = [row for row in rows if row["scale"] == scale.key]
            values = np.full((len(numbers), len(methods), len(textures)), np.nan)
            for row in of_scale:
                values[numbers.index(row["participant"]), row["method"], row["texture"]] = row["rating"]
            complete = [n for n, one in zip(numbers, values, strict=True) if np.isfinite(one).all()]
            result.append(Ratings(*study, scale.key, "", *names, of_scale, numbers, methods, values, complete, *beside))
        return result
    complete = _who_ended(store, rows, numbers)
    if task.kind == "threshold":
        values = _thresholds(task, rows, numbers, len(methods), len(textures))
        quantity = QUANTITIES[task.measures], "dB"
        return [Ratings(*study, *quantity, *names, rows, numbers, methods, values, complete, *beside)]
    compared = pairs(len(methods))
    if task.kind == "paired":
        quantity, labels = ("share of choices", "%"), methods
    else:
        quantity, labels = ("share of right answers", "%"), [f"{methods[a]}, {methods[b]}" for a, b in compared]
    counts = np.zeros((2, len(numbers), len(labels), len(textures)))  # of what the share is of, and of all
    for row in rows:
        shown = row["method"], row["other"]
        hits = {compared.index((min(shown), max(shown))): row["rating"] == row["target"]}
        if task.kind == "paired":
            hits = {method: row["rating"] == place for place, method in enumerate(shown)}
        for condition, hit in hits.items():
            counts[:, numbers.index(row["participant"]), condition, row["texture"]] += hit, 1
    values = 100 * np.divide(counts[0], counts[1], out=np.full(counts[0].shape, np.nan), where=counts[1] > 0)
    return [Ratings(*study, *quantity, *names, rows, numbers, labels, values, complete, *beside)]


def _who_ended(store: Store, rows: Sequence[dict[str, Any]], numbers: Sequence[int]) -> list[int]:
    """Participants who answered all that they were to be asked."""
    answered = Counter(row["participant"] for row in rows)
    return [n for n in numbers if answered[n] == sum(not trial.practice for trial in store.trials(n))]


def _thresholds(
    task: Task, rows: Sequence[dict[str, Any]], numbers: Sequence[int], n_methods: int, n_textures: int
) -> Array:
    """Thresholds [dB] of all answers so far, shape (participants, methods, textures)."""
    searches: dict[tuple[int, int, int], LevelSearch] = {}
    for row in rows:
        key = numbers.index(row["participant"]), row["method"], row["texture"]
        search = searches.setdefault(key, level_search(task))
        search.answer(row["measured"]["level_db"], row["rating"] == row["target"])
    values = np.full((len(numbers), n_methods, n_textures), np.nan)
    for key, search in searches.items():
        if search.n_answers >= MIN_ANSWERS:
            values[key] = reported_db(task, search.point)
    return values


def null_rates(n: int, a: int, b: int) -> dict[str, float]:
    """Share of null studies in which each effect is significant at α after Greenhouse and Geisser's correction.

    Ratings of n participants, a methods, b textures have the same mean; seeded. With one texture there is only the effect of
    method. The correction estimates ε from the same ratings: with many contrasts for the participants it comes out too low, and
    the test is conservative.
    """
    rng, raters = np.random.default_rng(NULL_SEED), Raters(np.full((a, b), 60.0))
    errors: Counter[str] = Counter()
    for _ in range(NULL_STUDIES // NULL_AT_ONCE):
        for effect in anova(raters.draw(rng, n, NULL_AT_ONCE)):
            errors[effect.name] += int((effect.p_corrected < ALPHA).sum())
    return {name: count / NULL_STUDIES for name, count in errors.items()}


def _result(ratings: Ratings, reference: int | None, correction: str) -> Result:
    document = about(ratings, correction)
    document["means"] = means_of(ratings)
    if len(ratings.conditions) == 1 < len(ratings.textures):  # one method's thresholds: textures are what is compared
        ratings = replace(
            ratings, conditions=ratings.textures, textures=["all"], values=np.swapaxes(ratings.values, 1, 2)
        )
    cautions = who_left(ratings)
    if len(ratings.conditions) == 1:
        return Result(ratings, document, [_means_sentence(document)], cautions + of_trials(ratings))
    y, n, textures = ratings.y, len(ratings.complete), ratings.textures
    by_participant = y.mean(-1)  # as in Sec. VII, averaged across textures
    one_way = anova(by_participant[..., None])
    two_way = anova(y) if len(textures) > 1 else []
    within = [paired_tests(y[..., t], reference) for t in range(len(textures))]
    agreement = reliability(y.reshape(n, -1))
    rates = null_rates(n, len(ratings.conditions), len(textures))
    mixed, doubts = _mixed(ratings.values)
    document |= {
        "null_rates": rates,
        "anova_one_way": [_numbers(effect) for effect in one_way],
        "anova_two_way": [_numbers(effect) for effect in two_way],
        "pairs_overall": by_pair(ratings.conditions, paired_tests(by_participant, reference)),
        "pairs_within_textures": {
            key: by_pair(ratings.conditions, tests) for key, tests in zip(textures, within, strict=True)
        },
        "friedman": _numbers(friedman(by_participant)),
        "wilcoxon": by_pair(ratings.conditions, wilcoxon_tests(by_participant, reference)),
        "mixed_model": mixed,
        "reliability": {
            "icc_single": json_value(agreement.single),
            "icc_mean": json_value(agreement.mean),
            "with_others": {
                str(p): json_value(r) for p, r in zip(ratings.complete, agreement.with_others, strict=True)
            },
        },
    }
    cautions += doubts + _cautions(ratings, two_way or one_way, rates, agreement.with_others) + of_trials(ratings)
    sentences = _sentences(ratings.conditions, document, one_way, two_way, within, reference)
    if ratings.textures == ["all"]:
        sentences = [sentence.replace("effect of method", "effect of texture") for sentence in sentences]
    return Result(ratings, document, [minus(sentence) for sentence in sentences], cautions)


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
    columns = {
        name: np.broadcast_to(values, len(tests.pairs)) for name, values in vars(tests).items() if name != "pairs"
    }
    return [
        {"pair": [methods[i], methods[j]], **{name: json_value(values[k]) for name, values in columns.items()}}
        for k, (i, j) in enumerate(tests.pairs)
    ]


def _mixed(values: Array) -> tuple[dict[str, Any] | None, list[str]]:
    """Numbers of the mixed model, None where none can be fitted, and cautions."""
    index = np.nonzero(np.isfinite(values))
    try:
        model = mixed_model(index[0], index[1], index[2], values[index])
    except (ValueError, np.linalg.LinAlgError) as error:
        return None, [f"no mixed model could be fitted: {error}"]
    counts = {"n_ratings": int(index[0].size), "n_participants": int(np.unique(index[0]).size)}
    cautions = [] if model.converged else ["the mixed model did not converge: do not report it"]
    return {**counts, **vars(model)}, cautions


def who_left(ratings: Ratings) -> list[str]:
    """Caution about participants who did not answer everything."""
    n, began = len(ratings.complete), len(ratings.numbers)
    if n == began:
        return []
    tests = "the analyses of variance, paired tests and ranks leave them out, the mixed model does not"
    if ratings.task.kind in ("paired", "abx", "oddity"):
        tests = "what they answered is counted"
    return [f"{began - n} of {began} participants did not answer everything: {tests}"]


def of_trials(ratings: Ratings) -> list[str]:
    """Cautions about trials."""
    trials = list({(row["participant"], row["trial"]): row for row in ratings.rows}.values())
    cautions = []
    if corrected := sum(row["corrected"] for row in ratings.rows):
        cautions.append(f"ratings corrected by hand: {corrected}; the log of the study says which")
    if under := sum(bool(row["measured"].get("n_underruns")) for row in trials):
        cautions.append(f"trials in which the sound had under-runs: {under}")
    if without := sum(row["measured"].get("contact_s") == 0 for row in trials):
        cautions.append(f"trials that were answered without a stroke on the virtual surface: {without}")
    if partly := sum(_misses_one(row["measured"]) for row in trials):
        cautions.append(f"trials that were answered without a stroke on each of the surfaces: {partly}")
    return cautions


def _misses_one(measured: dict[str, Any]) -> bool:
    seconds = [value for name, value in measured.items() if name.startswith("contact_s_")]
    return 0 in seconds and any(seconds)


def _cautions(ratings: Ratings, effects: Sequence[Effect], rates: dict[str, float], with_others: Array) -> list[str]:
    cautions = list[str]()
    for effect in effects:
        # With one contrast ε is 1 and nothing is corrected: a low rate is chance.
        if effect.df[0] > 1 and rates[effect.name] < MIN_NULL_RATE:
            cautions.append(
                f"{effect.name}: in null studies of this size Greenhouse and Geisser's correction errs in "
                f"{100 * rates[effect.name]:.1f} % at α = {ALPHA:g}: it is conservative, and that an effect is not "
                "significant by it does not say that there is none"
            )
    low = [str(p) for p, r in zip(ratings.complete, with_others, strict=True) if not r >= MIN_RELIABILITY]
    if low and len(ratings.conditions) * len(ratings.textures) >= MIN_CORRELATED:
        who = f"participant{'s' * (len(low) > 1)} {', '.join(low)}"
        cautions.append(
            f"{who}: correlation with the others below {MIN_RELIABILITY:g}; look at these ratings; leaving them out needs a "
            "reason that was set before"
        )
    return cautions


def _sentences(
    methods: Sequence[str],
    document: dict[str, Any],
    one_way: Sequence[Effect],
    two_way: Sequence[Effect],
    within: Sequence[Paired],
    reference: int | None,
) -> list[str]:
    several = len(within) > 1
    sentences = [
        _means_sentence(document),
        f"A one-way repeated-measures ANOVA on ratings{' averaged across textures' * several} gave an effect of method, "
        f"{_anova(one_way[0])}.",
    ]
    if two_way:
        effects = "; ".join(f"{effect.name}, {_anova(effect)}" for effect in two_way)
        sentences.append(f"A two-way repeated-measures ANOVA (method × texture, Greenhouse–Geisser) gave {effects}.")
    sentences += _paired_sentences(methods, within, reference)
    ranks, model, agree = document["friedman"], document["mixed_model"], document["reliability"]
    if ranks["p"] is not None:
        sentences.append(
            f"Friedman: χ²({ranks['df']:.0f}) = {ranks['chi2']:.2f}, {p_text(ranks['p'])}, Kendall's W = {ranks['w']:.2f}."
        )
    if model is not None:
        terms = "; ".join(
            f"{term['name']}, F({term['df'][0]:.0f}, {term['df'][1]:.0f}) = {term['f']:.2f}, {p_text(term['p'])}"
            for term in model["terms"]
        )
        sentences.append(f"Linear mixed model of all {model['n_ratings']} ratings: {terms}.")
    if agree["icc_mean"] is not None:
        sentences.append(f"Agreement: ICC(2,1) = {agree['icc_single']:.2f}, ICC(2,k) = {agree['icc_mean']:.2f}.")
    overall = [row for row in document["means"] if row["texture"] is None]
    if len(overall) > 1:
        sentences.append(f"The highest mean is that of {max(overall, key=lambda row: row['mean'])['method']}.")
    return sentences


def _means_sentence(document: dict[str, Any]) -> str:
    """Who answered what, and the means of all methods."""
    n, unit = document["participants"]["complete"], document["unit"] and f" {document['unit']}"
    who = "simulated raters" if document["simulated"] else "participants"
    overall = [row for row in document["means"] if row["texture"] is None]
    b = len({row["texture"] for row in document["means"]}) - 1
    many = n * len(overall) * b
    means = ", ".join(f"{row['method']} {row['mean']:.2f} ± {row['sd']:.2f}{unit}" for row in overall)
    verb, values = ("rated", "ratings") if document["task"] == "rating" else ("were asked about", "thresholds")
    methods = f"{len(overall)} method{'s' * (len(overall) > 1)}"
    return (
        f"{n} {who} {verb} {methods} on {b} texture{'s' * (b > 1)} ({many} {values}). "
        f"Mean {document['quantity']}: {means} (± SD between participants)."
    )


def _paired_sentences(methods: Sequence[str], within: Sequence[Paired], reference: int | None) -> list[str]:
    """Results of the tests within textures, by each correction; a single pair needs none."""
    family, b = within[0].pairs, len(within)
    many = len(family)
    if many == 1:
        what = f"paired t-test{'s' * (b > 1)} of {methods[family[0][0]]} and {methods[family[0][1]]}"
    elif reference is None:
        what = f"paired t-tests of all {many} pairs of methods"
    else:
        what = f"paired t-tests of the {many} other methods against {methods[reference]}"
    where, of = ("each texture", f"of {b} textures, ") if b > 1 else ("the one texture", "")
    sentences = []
    for name, key in (("Bonferroni", "p_bonferroni"), ("Holm", "p_holm"))[: 1 if many == 1 else 2]:
        results = []
        for k, (i, j) in enumerate(family):
            up = sum(bool(t.difference[k] > 0 and getattr(t, key)[k] < ALPHA) for t in within)
            down = sum(bool(t.difference[k] < 0 and getattr(t, key)[k] < ALPHA) for t in within)
            word = "above" if up else "below" if down else "not different from"
            one_texture = f"{methods[i]} {word} {methods[j]}"
            results.append(f"{methods[i]} above {methods[j]} on {up}, below on {down}" if b > 1 else one_texture)
        corrected = f", {name}-corrected for {many}" if many > 1 else ""
        sentences.append(f"Within {where}, {what}{corrected}: {of}{'; '.join(results)}.")
    return sentences


def _numbers(test: Effect | Friedman) -> dict[str, Any]:
    return {name: json_value(value) for name, value in vars(test).items()}


def _anova(effect: Effect) -> str:
    if not np.isfinite(effect.f):
        return "which cannot be computed, since no rating differs"
    return (
        f"F({effect.df[0]:.0f}, {effect.df[1]:.0f}) = {float(effect.f):.2f}, ε = {float(effect.epsilon):.2f}, "
        f"{p_text(float(effect.p_corrected))}, η²p = {float(effect.partial_eta2):.2f}, η²G = {float(effect.generalised_eta2):.2f}"
    )


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
