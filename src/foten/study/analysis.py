"""Analysis of a study: every test of Sec. VII and those that it leaves out, from a database to numbers and sentences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

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
    reliability,
    wilcoxon_tests,
)
from foten.study.store import Store

MIN_RELIABILITY = 0.2  # correlation with the others, below which a participant is named
NULL_STUDIES, NULL_SEED = 1000, 0
NULL_AT_ONCE = 50  # studies in memory
MIN_NULL_RATE = 0.04  # of errors at ALPHA, below which a test is called conservative


@dataclass(frozen=True)
class Ratings:
    """Ratings of a study, and what participants answered beside them."""

    title: str
    simulated: bool
    software: str  # version of foten that made the study
    methods: list[str]
    textures: list[str]
    rows: list[dict[str, Any]]  # in long form
    values: Array  # (participants, methods, textures), NaN where there is none
    complete: list[int]  # numbers of the participants who rated everything
    y: Array  # their values
    answers: list[dict[str, Any]]  # to the questions that are not private, by participant
    abouts: list[dict[str, Any]]  # to the private ones, without numbers


@dataclass(frozen=True)
class Result:
    """Numbers and sentences of a study."""

    ratings: Ratings
    document: dict[str, Any]  # every number
    sentences: list[str]  # ready for a paper
    cautions: list[str]


def analyse(store: Store, reference: str | None = None) -> Result:
    """Result of a study.

    Analyses of variance, paired tests and ranks take the participants who rated everything; the mixed model takes all ratings.

    Args:
        reference: a method that the others are compared with; None for all pairs.

    Raises:
        ValueError: there are fewer than three participants who rated everything, or the reference is no method.
    """
    ratings = read_ratings(store)
    if reference is not None and reference not in ratings.methods:
        raise ValueError(f"the reference is {reference!r}, expected one of {', '.join(ratings.methods)}")
    if len(ratings.complete) < 3:
        many = f"{len(ratings.complete)} participants have rated everything, of {len(ratings.values)} who began"
        raise ValueError(f"{many}: expected three or more; foten study status says who is where")
    return _result(ratings, None if reference is None else ratings.methods.index(reference))


def read_ratings(store: Store) -> Ratings:
    """Ratings in a database."""
    stimuli, rows = store.stimuli(), store.ratings()
    textures = [stimuli[t, 0].texture_key for t in range(1 + max(t for t, _ in stimuli))]
    methods = [stimuli[0, m].method_key for m in range(1 + max(m for _, m in stimuli))]
    numbers = sorted({row["participant"] for row in rows})
    values = np.full((len(numbers), len(methods), len(textures)), np.nan)
    for row in rows:
        values[numbers.index(row["participant"]), row["method"], row["texture"]] = row["rating"]
    is_complete = np.isfinite(values).all((1, 2))
    complete = [number for number, all_rated in zip(numbers, is_complete, strict=True) if all_rated]
    study = str(store.study["title"]), store.simulated, str(store.study["software"])
    return Ratings(
        *study, methods, textures, rows, values, complete, values[is_complete], store.answers(), store.abouts()
    )


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


def _result(ratings: Ratings, reference: int | None) -> Result:
    y, n, textures = ratings.y, len(ratings.complete), ratings.textures
    by_participant = y.mean(-1)  # as in Sec. VII, averaged across textures
    one_way = anova(by_participant[..., None])
    two_way = anova(y) if len(textures) > 1 else []
    within = [paired_tests(y[..., t], reference) for t in range(len(textures))]
    agreement = reliability(y.reshape(n, -1))
    rates = null_rates(n, len(ratings.methods), len(textures))
    mixed, cautions = _mixed(ratings.values)
    document: dict[str, Any] = {
        "title": ratings.title,
        "simulated": ratings.simulated,
        "software": ratings.software,
        "participants": {"began": len(ratings.values), "complete": n, "numbers": ratings.complete},
        "means": _means(ratings),
        "null_rates": rates,
        "anova_one_way": [_numbers(effect) for effect in one_way],
        "anova_two_way": [_numbers(effect) for effect in two_way],
        "pairs_overall": _by_pair(ratings.methods, paired_tests(by_participant, reference)),
        "pairs_within_textures": {
            key: _by_pair(ratings.methods, tests) for key, tests in zip(textures, within, strict=True)
        },
        "friedman": _numbers(friedman(by_participant)),
        "wilcoxon": _by_pair(ratings.methods, wilcoxon_tests(by_participant, reference)),
        "mixed_model": mixed,
        "reliability": {
            "icc_single": _json_value(agreement.single),
            "icc_mean": _json_value(agreement.mean),
            "with_others": {
                str(p): _json_value(r) for p, r in zip(ratings.complete, agreement.with_others, strict=True)
            },
        },
    }
    cautions += _cautions(ratings, two_way or one_way, rates, agreement.with_others)
    return Result(ratings, document, _sentences(document, one_way, two_way, within, reference), cautions)


def _means(ratings: Ratings) -> list[dict[str, Any]]:
    """Means of each method on each texture, and of all textures, where the texture is None."""
    from scipy import stats

    means = []
    for m, method in enumerate(ratings.methods):
        columns = [*zip(ratings.textures, ratings.values[:, m].T, strict=True), (None, ratings.y[:, m].mean(-1))]
        for texture, of_texture in columns:
            values = of_texture[np.isfinite(of_texture)]
            n, mean, sd = values.size, float(values.mean()), float(values.std(ddof=1))
            half = float(stats.t.ppf(0.975, n - 1)) * sd / n**0.5
            row = {"method": method, "texture": texture, "n": n, "mean": mean, "sd": sd}
            means.append(row | {"ci95_low": mean - half, "ci95_high": mean + half})
    return means


def _by_pair(methods: Sequence[str], tests: Paired | SignedRank) -> list[dict[str, Any]]:
    columns = {
        name: np.broadcast_to(values, len(tests.pairs)) for name, values in vars(tests).items() if name != "pairs"
    }
    return [
        {"pair": [methods[i], methods[j]], **{name: _json_value(values[k]) for name, values in columns.items()}}
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


def _cautions(ratings: Ratings, effects: Sequence[Effect], rates: dict[str, float], with_others: Array) -> list[str]:
    n, began, cautions = len(ratings.complete), len(ratings.values), list[str]()
    if n < began:
        cautions.append(
            f"{began - n} of {began} participants did not rate everything: the analyses of variance, paired tests and ranks "
            "leave them out, the mixed model does not"
        )
    for effect in effects:
        # With one contrast ε is 1 and nothing is corrected: a low rate is chance.
        if effect.df[0] > 1 and rates[effect.name] < MIN_NULL_RATE:
            cautions.append(
                f"{effect.name}: in null studies of this size Greenhouse and Geisser's correction errs in "
                f"{100 * rates[effect.name]:.1f} % at α = {ALPHA:g}: it is conservative, and that an effect is not "
                "significant by it does not say that there is none"
            )
    low = [str(p) for p, r in zip(ratings.complete, with_others, strict=True) if not r >= MIN_RELIABILITY]
    if low:
        who = f"participant{'s' * (len(low) > 1)} {', '.join(low)}"
        cautions.append(
            f"{who}: correlation with the others below {MIN_RELIABILITY:g}; look at these ratings; leaving them out needs a "
            "reason that was set before"
        )
    if corrected := sum(row["corrected"] for row in ratings.rows):
        cautions.append(f"ratings corrected by hand: {corrected}; the log of the study says which")
    if under := sum(bool(row["measured"].get("n_underruns")) for row in ratings.rows):
        cautions.append(f"trials in which the sound had under-runs: {under}")
    if without := sum(row["measured"].get("contact_s") == 0 for row in ratings.rows):
        cautions.append(f"trials that were rated without a stroke on the virtual surface: {without}")
    return cautions


def _sentences(
    document: dict[str, Any],
    one_way: Sequence[Effect],
    two_way: Sequence[Effect],
    within: Sequence[Paired],
    reference: int | None,
) -> list[str]:
    n, b, several = document["participants"]["complete"], len(within), len(within) > 1
    who = "simulated raters" if document["simulated"] else "participants"
    overall = [row for row in document["means"] if row["texture"] is None]
    methods = [row["method"] for row in overall]
    means = ", ".join(f"{row['method']} {row['mean']:.2f} ± {row['sd']:.2f}" for row in overall)
    sentences = [
        f"{n} {who} rated {len(methods)} methods on {b} texture{'s' * several} ({n * len(methods) * b} ratings). "
        f"Mean similarity: {means} (± SD between participants).",
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
            f"Friedman: χ²({ranks['df']:.0f}) = {ranks['chi2']:.2f}, {_p(ranks['p'])}, Kendall's W = {ranks['w']:.2f}."
        )
    if model is not None:
        terms = "; ".join(
            f"{term['name']}, F({term['df'][0]:.0f}, {term['df'][1]:.0f}) = {term['f']:.2f}, {_p(term['p'])}"
            for term in model["terms"]
        )
        sentences.append(f"Linear mixed model of all {model['n_ratings']} ratings: {terms}.")
    if agree["icc_mean"] is not None:
        sentences.append(f"Agreement: ICC(2,1) = {agree['icc_single']:.2f}, ICC(2,k) = {agree['icc_mean']:.2f}.")
    best = max(overall, key=lambda row: row["mean"])
    return [*sentences, f"The highest mean is that of {best['method']}."]


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
    return {name: _json_value(value) for name, value in vars(test).items()}


def _anova(effect: Effect) -> str:
    if not np.isfinite(effect.f):
        return "which cannot be computed, since no rating differs"
    return (
        f"F({effect.df[0]:.0f}, {effect.df[1]:.0f}) = {float(effect.f):.2f}, ε = {float(effect.epsilon):.2f}, "
        f"{_p(float(effect.p_corrected))}, η²p = {float(effect.partial_eta2):.2f}, η²G = {float(effect.generalised_eta2):.2f}"
    )


def _p(value: float) -> str:
    """p as journals print it."""
    return "p < .001" if value < 0.001 else f"p = {value:.3f}".replace("0.", ".")


def stars(p: float | None) -> str:
    """Marks of Fig. 9: *** below .001, ** below .01, * below .05."""
    if p is None or not p < ALPHA:
        return ""
    return "***" if p < 0.001 else "**" if p < 0.01 else "*"


def _json_value(value: Any) -> Any:
    """A value as JSON has it, None for NaN."""
    if isinstance(value, str | tuple):
        return value if isinstance(value, str) else list(value)
    return float(value) if np.isfinite(value) else None
