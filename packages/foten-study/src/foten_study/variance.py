"""Analysis of means: of ratings and of thresholds, every test of Sec. VII and those that it leaves out; raters and power."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from foten.recording.recording import counted
from foten.reporting.table import minus
from foten_study.results import about, by_pair, json_values, means_of, of_trials, p_text, who_left
from foten_study.statistics import ALPHA, Array, anova, friedman, mixed_model, paired_tests, reliability, wilcoxon_tests
from foten_study.tasks.kind import AIM, PAPER_SD, Plan, Power, Ratings, Result

MIN_RELIABILITY = 0.2  # correlation with the others, below which a participant is named
MIN_CORRELATED = 4  # conditions: of two a correlation is 1 or −1
NULL_STUDIES, NULL_SEED = 1000, 0
NULL_AT_ONCE = 50  # studies in memory
MIN_NULL_RATE = 0.04  # of errors at ALPHA, below which a test is called conservative
NOTE = "pair: the last method differs from another on one texture (Holm's adjustment); all pairs: from all on every texture"
LEAVERS = "the analyses of variance, paired tests and ranks leave them out, the mixed model does not"
PAPER_METHODS = ("ar", "dstn", "ldhtd", "foten")
PAPER_PARTICIPANTS, PAPER_TEXTURES = 21, 12
PAPER_MEAN = 80.14  # of FoTEN; Sec. VIII
# By how much FoTEN was better on the 8 textures where it was significantly so, and on the other 4 from nothing to that; Sec. VII.
PAPER_DIFFERENCES = {"dstn": (9.75, 31.33), "ldhtd": (8.75, 25.25)}
# Of AR the text gives p alone, after Bonferroni's correction, taken as for 6 pairs, on all 12 textures; Sec. VII.
PAPER_AR_P = (2.0e-7, 1.0e-3)
SHOWN = (4, 8, 12, 16, 21, 24, 30, 40, 50, 60)  # numbers of participants whose power is printed
MIN_DIFFERENCE = 8.75  # points; the smallest that the paper found significant, Sec. VII


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


@dataclass(frozen=True)
class Raters:
    """A model of raters: rating = mean(method, texture) + rater + rater × method + rater × texture + noise, cut to the scale.

    Means are of each method on each texture, on the scale of 0 to 100, shape (a, b).
    """

    means: Array
    sd: float = PAPER_SD
    correlation: float = 0.3
    by_method: float = 0.15
    by_texture: float = 0.15

    @property
    def sd_of_difference(self) -> float:
        """Standard deviation of a rater's difference between two methods on a texture."""
        return float(self.sd * np.sqrt(2 * (1 - self.correlation) * (1 - self.by_texture)))

    def draw(self, rng: np.random.Generator, n: int, studies: int | None = None) -> Array:
        """Ratings 0 … 100, shape (n, a, b), or (studies, n, a, b)."""
        a, b = self.means.shape
        lead = () if studies is None else (studies,)
        left = self.sd**2 * (1 - self.correlation)
        noise = left * (1 - self.by_method - self.by_texture)
        parts = (
            ((n, 1, 1), self.sd**2 * self.correlation),
            ((n, a, 1), left * self.by_method),
            ((n, 1, b), left * self.by_texture),
            ((n, a, b), noise),
        )
        y = self.means + sum(np.sqrt(v) * rng.standard_normal((*lead, *shape)) for shape, v in parts)
        return np.asarray(np.clip(y, 0, 100))


def paper_raters(sd: float = PAPER_SD, correlation: float = 0.3) -> Raters:
    """Raters with the effects of Sec. VII on 4 methods and 12 textures.

    Differs from the paper: it gives ranges, no table. Differences are spread evenly over them; those of AR follow from its p
    values, the standard deviation and the correlation.
    """
    from scipy import stats

    means = np.full((len(PAPER_METHODS), PAPER_TEXTURES), PAPER_MEAN)
    significant = 8
    for method, (low, high) in PAPER_DIFFERENCES.items():
        d = np.concatenate(
            [np.linspace(high, low, significant), np.linspace(low, 0, PAPER_TEXTURES - significant + 1)[1:]]
        )
        means[PAPER_METHODS.index(method)] -= d
    of_ar = np.array(PAPER_AR_P) / 6
    high, low = stats.t.isf(of_ar / 2, PAPER_PARTICIPANTS - 1)
    error = Raters(means, sd, correlation).sd_of_difference / np.sqrt(PAPER_PARTICIPANTS)
    means[PAPER_METHODS.index("ar")] -= np.linspace(high, low, PAPER_TEXTURES) * error
    return Raters(means, sd, correlation)


def raters_for(
    methods: int, textures: int, difference: float, sd: float = PAPER_SD, correlation: float = 0.3, better: int = -1
) -> Raters:
    """Raters to whom one method, by default the last, is better than the others by a difference, on every texture."""
    means = np.full((methods, textures), 65.0)
    means[better] += difference
    return Raters(means, sd, correlation)


def power(raters: Raters, n: int, studies: int, seed: int) -> dict[str, float]:
    """Share of studies with n raters in which each effect is significant at `ALPHA`, Greenhouse and Geisser's p; `pair`,
    in which the last method differs from another one on a texture, after Holm's adjustment within the texture, averaged;
    `all pairs`, in which it does on every texture from every other.
    """
    y = raters.draw(np.random.default_rng(seed), n, studies)
    result = {effect["name"]: float(np.nanmean(effect["p_corrected"] < ALPHA)) for effect in anova(y)}
    tests = paired_tests(np.moveaxis(y, -1, -3))  # (studies, textures, n, methods)
    with_last = [i for i, pair in enumerate(tests["pairs"]) if len(raters.means) - 1 in pair]
    significant = tests["p_holm"][..., with_last] < ALPHA
    return {**result, "pair": float(significant.mean()), "all pairs": float(significant.all((-2, -1)).mean())}


def needed(raters: Raters, studies: int, seed: int) -> tuple[list[dict[str, float]], int | None]:
    """Power for each of `SHOWN` participants, and the smallest number whose `pair` reaches `AIM`, if any does."""
    rows = [{"participants": float(n), **power(raters, n, studies, seed)} for n in SHOWN]
    reaching = [n for n, row in zip(SHOWN, rows, strict=True) if row["pair"] >= AIM]
    if not reaching:
        return rows, None
    low, high = max((n for n in SHOWN if n < reaching[0]), default=2), reaching[0]
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if power(raters, middle, studies, seed)["pair"] >= AIM else (middle, high)
    return rows, high


def power_of_means(raters: Raters, plan: Plan, studies: int, seed: int, of: str) -> Power:
    """Power of the tests of means with raters, who have an effect that is described."""
    table, smallest = needed(raters, studies, seed)
    sizes = f"{counted(plan.methods, 'method')} × {counted(plan.textures, 'texture')}"
    heading = f"{of}, {sizes}, sd {raters.sd:.3g}, correlation {raters.correlation:.2g}, α = 0.05"
    return Power(heading, table, smallest, NOTE)


def null_rates(n: int, a: int, b: int) -> dict[str, float]:
    """Share of null studies in which each effect is significant at α after Greenhouse and Geisser's correction; seeded.

    The correction estimates ε from the same ratings: with many contrasts for the participants it comes out too low, and the test
    is conservative.
    """
    rng, raters = np.random.default_rng(NULL_SEED), Raters(np.full((a, b), 60.0))
    errors: Counter[str] = Counter()
    for _ in range(NULL_STUDIES // NULL_AT_ONCE):
        for effect in anova(raters.draw(rng, n, NULL_AT_ONCE)):
            errors[effect["name"]] += int((effect["p_corrected"] < ALPHA).sum())
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
    one_way = [effect | {"name": ratings.factor} for effect in anova(by_participant[..., None])]
    two_way = anova(y) if len(textures) > 1 else []
    within = [paired_tests(y[..., t], reference) for t in range(len(textures))]
    icc_single, icc_mean, with_others = reliability(y.reshape(n, -1))
    rates = null_rates(n, len(ratings.conditions), len(textures))
    rates = {ratings.factor if name == "method" else name: rate for name, rate in rates.items()}
    mixed, doubts = _mixed(ratings.values)
    document |= {
        "null_rates": rates,
        "anova_one_way": list(map(json_values, one_way)),
        "anova_two_way": list(map(json_values, two_way)),
        "pairs_overall": by_pair(ratings.conditions, paired_tests(by_participant, reference)),
        "pairs_within_textures": {
            key: by_pair(ratings.conditions, tests) for key, tests in zip(textures, within, strict=True)
        },
        "friedman": json_values(friedman(by_participant)),
        "wilcoxon": by_pair(ratings.conditions, wilcoxon_tests(by_participant, reference)),
        "mixed_model": mixed,
        "reliability": {
            **json_values({"icc_single": icc_single, "icc_mean": icc_mean}),
            "with_others": json_values(dict(zip(map(str, ratings.complete), with_others, strict=True))),
        },
    }
    cautions += doubts + _cautions(ratings, document) + of_trials(ratings)
    if mixed is not None and ratings.factor != "method":
        for term in mixed["terms"]:
            term["name"] = ratings.factor
    return Result(
        ratings, document, [minus(sentence) for sentence in _sentences(ratings, document, reference)], cautions
    )


def _mixed(values: Array) -> tuple[dict[str, Any] | None, list[str]]:
    """Numbers of the mixed model, None where none can be fitted, and cautions."""
    index = np.nonzero(np.isfinite(values))
    try:
        model = mixed_model(index[0], index[1], index[2], values[index])
    except (ValueError, np.linalg.LinAlgError) as error:
        return None, [f"no mixed model could be fitted: {error}"]
    counts = {"n_ratings": int(index[0].size), "n_participants": int(np.unique(index[0]).size)}
    cautions = [] if model["converged"] else ["the mixed model did not converge: do not report it"]
    return {**counts, **model}, cautions


def _cautions(ratings: Ratings, document: dict[str, Any]) -> list[str]:
    cautions, rates = list[str](), document["null_rates"]
    for effect in document["anova_two_way"] or document["anova_one_way"]:
        # With one contrast ε is 1 and nothing is corrected: a low rate is chance.
        if effect["df"][0] > 1 and rates[effect["name"]] < MIN_NULL_RATE:
            cautions.append(
                f"{effect['name']}: in null studies of this size Greenhouse and Geisser's correction errs in "
                f"{100 * rates[effect['name']]:.1f} % at α = {ALPHA:g}: it is conservative, and that an effect is not "
                "significant by it does not say that there is none"
            )
    low = [p for p, r in document["reliability"]["with_others"].items() if r is None or r < MIN_RELIABILITY]
    if low and len(ratings.conditions) * len(ratings.textures) >= MIN_CORRELATED:
        who = f"participant{'s' * (len(low) > 1)} {', '.join(low)}"
        cautions.append(
            f"{who}: correlation with the others below {MIN_RELIABILITY:g}; look at these ratings; leaving them out needs a "
            "reason that was set before"
        )
    return cautions


def _sentences(ratings: Ratings, document: dict[str, Any], reference: int | None) -> list[str]:
    several, what, factor = len(ratings.textures) > 1, ratings.noun, ratings.factor
    sentences = [
        _means_sentence(ratings, document),
        f"A one-way repeated-measures ANOVA on {what}{' averaged across textures' * several} gave an effect of {factor}, "
        f"{_anova(*document['anova_one_way'])}.",
    ]
    if document["anova_two_way"]:
        effects = "; ".join(f"{effect['name']}, {_anova(effect)}" for effect in document["anova_two_way"])
        sentences.append(f"A two-way repeated-measures ANOVA (method × texture, Greenhouse–Geisser) gave {effects}.")
    sentences += _paired_sentences(ratings, [*document["pairs_within_textures"].values()], reference)
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
    means = [
        f"{row['method']} {row['mean']:.2f} ± {row['sd']:.2f}{unit}{ratings.in_other_words(row['mean'])}"
        for row in overall
    ]
    verb = "rated" if ratings.noun == "ratings" else "were asked about"
    conditions = f"{k} {ratings.factor}{'s' * (k > 1)}"
    where = f" on {b} texture{'s' * (b > 1)}" if ratings.factor == "method" else ""
    return (
        f"{n} {who} {verb} {conditions}{where} ({n * k * b} {ratings.noun}). "
        f"Mean {ratings.quantity}: {', '.join(means)} (± SD between participants)."
    )


def _paired_sentences(ratings: Ratings, within: list[list[dict[str, Any]]], reference: int | None) -> list[str]:
    """Results of the tests within textures, by each correction; a single pair needs none."""
    factors = f"{ratings.factor}s"
    family, b = [test["pair"] for test in within[0]], len(within)
    many = len(family)
    if many == 1:
        what = f"paired t-test{'s' * (b > 1)} of {family[0][0]} and {family[0][1]}"
    elif reference is None:
        what = f"paired t-tests of all {many} pairs of {factors}"
    else:
        what = f"paired t-tests of the {many} other methods against {ratings.conditions[reference]}"
    where, of = ("each texture", f"of {b} textures, ") if b > 1 else ("the one texture", "")
    if ratings.factor == "texture":
        where = "the one method"
    sentences = []
    for name, key in (("Bonferroni", "p_bonferroni"), ("Holm", "p_holm"))[: 1 if many == 1 else 2]:
        results = []
        for k, (first, second) in enumerate(family):
            significant = [t[k]["difference"] for t in within if t[k][key] is not None and t[k][key] < ALPHA]
            up, down = sum(d > 0 for d in significant), sum(d < 0 for d in significant)
            word = "above" if up else "below" if down else "not different from"
            on_one = f"{first} {word} {second}"
            results.append(f"{first} above {second} on {up}, below on {down}" if b > 1 else on_one)
        corrected = f", {name}-corrected for {many}" if many > 1 else ""
        sentences.append(f"Within {where}, {what}{corrected}: {of}{'; '.join(results)}.")
    return sentences


def _anova(effect: dict[str, Any]) -> str:
    if effect["f"] is None:
        return "which cannot be computed, since no rating differs"
    return (
        f"F({effect['df'][0]:.0f}, {effect['df'][1]:.0f}) = {effect['f']:.2f}, ε = {effect['epsilon']:.2f}, "
        f"{p_text(effect['p_corrected'])}, η²p = {effect['partial_eta2']:.2f}, η²G = {effect['generalised_eta2']:.2f}"
    )
