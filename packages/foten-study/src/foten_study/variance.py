"""Analysis of means: of ratings and of thresholds, every test of Sec. VII and those that it leaves out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from foten.recording.recording import counted
from foten.reporting.table import minus
from foten_study.raters import Raters, needed
from foten_study.results import about, by_pair, json_value, means_of, of_trials, p_text, who_left
from foten_study.statistics import (
    ALPHA,
    Array,
    Effect,
    Friedman,
    Paired,
    anova,
    friedman,
    mixed_model,
    paired_tests,
    reliability,
    wilcoxon_tests,
)
from foten_study.tasks.kind import Power, PowerQuery, Ratings, Result
from foten_study.thresholds import QUANTITIES, noticeable_db

MIN_RELIABILITY = 0.2  # correlation with the others, below which a participant is named
MIN_CORRELATED = 4  # conditions: of two a correlation is 1 or −1
NULL_STUDIES, NULL_SEED = 1000, 0
NULL_AT_ONCE = 50  # studies in memory
MIN_NULL_RATE = 0.04  # of errors at ALPHA, below which a test is called conservative
NOTE = "pair: the last method differs from another on one texture (Holm's adjustment); all pairs: from all on every texture"
LEAVERS = "the analyses of variance, paired tests and ranks leave them out, the mixed model does not"


def analyse_means(every: Sequence[Ratings], reference: str | None, correction: str) -> list[Result]:
    """Results of values on one scale or several.

    Analyses of variance, paired tests and ranks take the participants who answered everything; the mixed model takes all ratings.
    """
    methods = every[0].methods
    if reference is not None and len(methods) < 2:
        raise ValueError(f"the reference is {reference!r}, and there is no other method to compare it with")
    index = None if reference is None else methods.index(reference)
    results = [_result(one, index, correction) for one in every]
    if len(results) > 1:
        results[0].cautions.insert(0, f"p values are not corrected for there being {len(results)} scales")
    return results


def power_of_means(raters: Raters, query: PowerQuery, of: str) -> Power:
    """Power of the tests of means with raters, who have an effect that is described."""
    table, smallest = needed(raters, query.studies, query.seed)
    sizes = f"{counted(query.methods, 'method')} × {counted(query.textures, 'texture')}"
    heading = f"{of}, {sizes}, sd {raters.sd:.3g}, correlation {raters.correlation:.2g}, α = 0.05"
    return Power(heading, table, smallest, NOTE)


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
    if len(ratings.conditions) == 1 < len(ratings.textures):  # one method's thresholds: textures are what is compared
        swapped = np.swapaxes(ratings.values, 1, 2)
        ratings = replace(ratings, conditions=ratings.textures, textures=["all"], values=swapped, factor="texture")
        reference = None
    document = about(ratings, correction)
    document["means"] = means_of(ratings)
    cautions = who_left(ratings, LEAVERS)
    if len(ratings.conditions) == 1:
        return Result(ratings, document, [minus(_means_sentence(ratings, document))], cautions + of_trials(ratings))
    y, n, textures = ratings.y, len(ratings.complete), ratings.textures
    by_participant = y.mean(-1)  # as in Sec. VII, averaged across textures
    one_way = [replace(effect, name=ratings.factor) for effect in anova(by_participant[..., None])]
    two_way = anova(y) if len(textures) > 1 else []
    within = [paired_tests(y[..., t], reference) for t in range(len(textures))]
    agreement = reliability(y.reshape(n, -1))
    rates = null_rates(n, len(ratings.conditions), len(textures))
    rates = {ratings.factor if name == "method" else name: rate for name, rate in rates.items()}
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
    if mixed is not None and ratings.factor != "method":
        for term in mixed["terms"]:
            term["name"] = ratings.factor
    sentences = _sentences(ratings, document, one_way, two_way, within, reference)
    return Result(ratings, document, [minus(sentence) for sentence in sentences], cautions)


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
    ratings: Ratings,
    document: dict[str, Any],
    one_way: Sequence[Effect],
    two_way: Sequence[Effect],
    within: Sequence[Paired],
    reference: int | None,
) -> list[str]:
    several, what, factor = len(within) > 1, ratings.noun, ratings.factor
    sentences = [
        _means_sentence(ratings, document),
        f"A one-way repeated-measures ANOVA on {what}{' averaged across textures' * several} gave an effect of {factor}, "
        f"{_anova(one_way[0])}.",
    ]
    if two_way:
        effects = "; ".join(f"{effect.name}, {_anova(effect)}" for effect in two_way)
        sentences.append(f"A two-way repeated-measures ANOVA (method × texture, Greenhouse–Geisser) gave {effects}.")
    sentences += _paired_sentences(ratings, within, reference)
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
        sentences.append(f"Linear mixed model of all {model['n_ratings']} {what}: {terms}.")
    if agree["icc_mean"] is not None:
        sentences.append(f"Agreement: ICC(2,1) = {agree['icc_single']:.2f}, ICC(2,k) = {agree['icc_mean']:.2f}.")
    overall = [row for row in document["means"] if row["texture"] is None]
    if len(overall) > 1:
        ends = {"highest mean": max, "lowest threshold": min}
        name = "highest mean" if ratings.noun == "ratings" else "lowest threshold"
        sentences.append(f"The {name} is that of {ends[name](overall, key=lambda row: row['mean'])['method']}.")
    return sentences


def _means_sentence(ratings: Ratings, document: dict[str, Any]) -> str:
    """Who answered what, and the means of all conditions."""
    n, unit = document["participants"]["complete"], ratings.unit and f" {ratings.unit}"
    who = "simulated raters" if ratings.simulated else "participants"
    overall = [row for row in document["means"] if row["texture"] is None]
    k, b = len(overall), len(ratings.textures)
    means = []
    for row in overall:
        noticeable = ratings.quantity == QUANTITIES["difference"]
        as_level = f", a difference in level of {noticeable_db(row['mean']):.1f} dB" * noticeable
        means.append(f"{row['method']} {row['mean']:.2f} ± {row['sd']:.2f}{unit}{as_level}")
    verb = "rated" if ratings.noun == "ratings" else "were asked about"
    conditions = f"{k} {ratings.factor}{'s' * (k > 1)}"
    where = f" on {b} texture{'s' * (b > 1)}" if ratings.factor == "method" else ""
    return (
        f"{n} {who} {verb} {conditions}{where} ({n * k * b} {ratings.noun}). "
        f"Mean {ratings.quantity}: {', '.join(means)} (± SD between participants)."
    )


def _paired_sentences(ratings: Ratings, within: Sequence[Paired], reference: int | None) -> list[str]:
    """Results of the tests within textures, by each correction; a single pair needs none."""
    methods, factors = ratings.conditions, f"{ratings.factor}s"
    family, b = within[0].pairs, len(within)
    many = len(family)
    if many == 1:
        what = f"paired t-test{'s' * (b > 1)} of {methods[family[0][0]]} and {methods[family[0][1]]}"
    elif reference is None:
        what = f"paired t-tests of all {many} pairs of {factors}"
    else:
        what = f"paired t-tests of the {many} other methods against {methods[reference]}"
    where, of = ("each texture", f"of {b} textures, ") if b > 1 else ("the one texture", "")
    if ratings.factor == "texture":
        where = "the one method"
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
