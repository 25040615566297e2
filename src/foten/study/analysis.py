"""Analysis of a study: every test of Sec. VII and those that it leaves out, from a database to numbers and sentences.

Ratings and thresholds are here; choices between surfaces are analysed in `choice_analysis`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from foten.dsp.inference import student_quantile
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
from foten.study.thresholds import is_reached, level_search, noticeable_db
from foten.untrusted import parse_toml

MIN_RELIABILITY = 0.2  # correlation with the others, below which a participant is named
MIN_CORRELATED = 4  # conditions: of two a correlation is 1 or −1
MIN_COMPLETE = 3  # participants
MIN_ANSWERS = 8  # of a threshold
CORRECTIONS = {"bonferroni": "Bonferroni", "holm": "Holm"}  # of many tests: the paper's, and one of more power
UNITS = {"detection": "dB re recorded", "difference": "dB re the other surfaces"}
QUANTITIES = {"detection": "threshold of detection", "difference": "just noticeable increment"}
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
    factor: str = field(default="method", kw_only=True)  # what conditions are of
    thresholds: list[dict[str, Any]] = field(default_factory=list, kw_only=True)  # each, with what is known of it
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
    if reference is not None and len(ratings.methods) < 2:
        raise ValueError(f"the reference is {reference!r}, and there is no other method to compare it with")
    index = None if reference is None else ratings.methods.index(reference)
    results = [_result(one, index, correction) for one in every]
    if len(results) > 1:
        results[0].cautions.insert(0, f"p values are not corrected for there being {len(results)} scales")
    return results


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
    needed = [row["measured"].get("level_db") if task.kind == "threshold" else row["other"] for row in rows]
    if not all(isinstance(value, int | float) for value in needed):
        raise ValueError(f"{store.path}: answers are not those of the design's task, {task.kind!r}")
    complete = _who_ended(store, rows, numbers)
    if task.kind == "threshold":
        plays_in_page = parse_toml(str(store.study["design"])).get("output", {}).get("to", "page") == "page"
        thresholds = _thresholds(task, rows, plays_in_page)
        values = np.full((len(numbers), len(methods), len(textures)), np.nan)
        for one in thresholds:
            place = numbers.index(one["participant"]), methods.index(one["method"]), textures.index(one["texture"])
            values[place] = one["threshold_db"]
        quantity = QUANTITIES[task.measures], UNITS[task.measures]
        found = Ratings(*study, *quantity, *names, rows, numbers, methods, values, complete, *beside)
        return [replace(found, thresholds=thresholds)]
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


def _thresholds(task: Task, rows: Sequence[dict[str, Any]], plays_in_page: bool) -> list[dict[str, Any]]:
    """Thresholds of all answers so far, by participant, texture and method.

    A threshold of detection is re the recorded level at a volume of 0 dB: a page's volume is added.
    """
    tracks: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in rows:
        tracks.setdefault((row["participant"], row["texture_key"], row["method_key"]), []).append(row)
    result = []
    for (participant, texture, method), answers in tracks.items():
        if len(answers) < MIN_ANSWERS:
            continue
        search = level_search(task, [(row["measured"]["level_db"], row["rating"] == row["target"]) for row in answers])
        volumes = [float(row["measured"].get("volume_db") or 0.0) for row in answers]
        volume = float(np.median(volumes)) if plays_in_page and task.measures == "detection" else 0.0
        one = {"participant": participant, "texture": texture, "method": method, "threshold_db": search.point + volume}
        one |= {"sd_db": search.sd, "n_answers": len(answers), "reached": int(is_reached(task, search))}
        if task.measures == "difference":
            one["difference_db"] = noticeable_db(search.point)
        result.append({**one, "volume_db": float(np.median(volumes)), "volume_range_db": float(np.ptp(volumes))})
    return result


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
    cautions = who_left(ratings)
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
    several, what, factor = len(within) > 1, _noun(ratings), ratings.factor
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
        name = "highest mean" if ratings.task.kind == "rating" else "lowest threshold"
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
    verb = "rated" if ratings.task.kind == "rating" else "were asked about"
    conditions = f"{k} {ratings.factor}{'s' * (k > 1)}"
    where = f" on {b} texture{'s' * (b > 1)}" if ratings.factor == "method" else ""
    return (
        f"{n} {who} {verb} {conditions}{where} ({n * k * b} {_noun(ratings)}). "
        f"Mean {ratings.quantity}: {', '.join(means)} (± SD between participants)."
    )


def _noun(ratings: Ratings) -> str:
    return "ratings" if ratings.task.kind == "rating" else "thresholds"


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
