"""Tasks in which one surface is chosen of several: shares, leanings to a position, power, and how well methods are told apart."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from foten.dsp.inference import holm
from foten.recording.recording import counted
from foten.reporting.table import minus
from foten_study.choice_statistics import Sensitivity
from foten_study.orders import Order, Trial
from foten_study.results import about, json_values, means_of, of_trials, p_text, who_left
from foten_study.statistics import ALPHA, Array, pairs
from foten_study.tasks.kind import AIM, CHOICE, Answer, People, Plan, Power, Ratings, Result, TaskKind, check_answers

MAX_LEANING = 0.1  # of the share of a position, above an even one
SHOWN = (4, 8, 12, 16, 21, 30, 40, 60)  # numbers of participants whose power is printed
EFFECT = 1.0  # d′ between two methods
SPREAD = 0.4  # of the logarithm of d′ between people
PValues = Callable[[Plan, np.random.Generator, int, int], tuple[float, Array]]
"""p of a simulated study's overall test and of pairs, of so many participants with so many trials of each pair."""


def shares_of(
    ratings: Ratings, quantity: str, conditions: list[str], hits: Callable[[Mapping[str, Any]], Mapping[int, bool]]
) -> Ratings:
    """Shares [%] by participant, condition and texture, of what a row is a hit or a miss of."""
    check_answers(ratings.task, [row["other"] for row in ratings.rows])
    counts = np.zeros((2, len(ratings.numbers), len(conditions), len(ratings.textures)))  # of hits, and of all
    for row in ratings.rows:
        for condition, hit in hits(row).items():
            counts[:, ratings.numbers.index(row["participant"]), condition, row["texture"]] += hit, 1
    values = 100 * np.divide(counts[0], counts[1], out=np.full(counts[0].shape, np.nan), where=counts[1] > 0)
    return replace(ratings, quantity=quantity, unit="%", noun="choices", conditions=conditions, values=values)


def beginning(ratings: Ratings, names: Sequence[str], correction: str) -> tuple[dict[str, Any], list[str]]:
    """Beginning of a document about choices between surfaces, and cautions: about who left, and a leaning to a position."""
    counts = Counter(int(row["rating"]) for row in ratings.rows)
    shares = {name: counts[k] / len(ratings.rows) for k, name in enumerate(names)}
    even = 1 / len(names)
    leaning = [name for name, share in shares.items() if share > even + MAX_LEANING]
    cautions = [
        f"{name} was chosen in {100 * shares[name]:.0f} % of trials, {100 * even:.0f} % is even: a leaning to a position"
        for name in leaning[:1]
    ]
    document = {**about(ratings, correction), "means": means_of(ratings), "chance": even, "positions": shares}
    return document, who_left(ratings, "what they answered is counted") + cautions


def by_texture(ratings: Ratings) -> dict[str, list[dict[str, Any]]]:
    """Rows of each texture."""
    return {key: [row for row in ratings.rows if row["texture"] == t] for t, key in enumerate(ratings.textures)}


def who_compared(ratings: Ratings, did: str) -> str:
    """Beginning of a sentence about participants, methods and textures."""
    who = "simulated raters" if ratings.simulated else "participants"
    b = len(ratings.textures)
    return f"{len(ratings.numbers)} {who} {did} {len(ratings.methods)} methods on {b} texture{'s' * (b > 1)}"


def ends(row: Mapping[str, Any]) -> str:
    """Interval of a row in brackets; empty where neither end is known."""
    low, high = (row[f"ci95_{end}"] for end in ("low", "high"))
    if low is None and high is None:
        return ""
    return f" ({'−∞' if low is None else f'{low:.2f}'} to {'∞' if high is None else f'{high:.2f}'})"


def power_of_choices(p_values: PValues, plan: Plan, studies: int, seed: int, of: str, pair: str) -> Power:
    """Power for the numbers of `SHOWN`, and the smallest of them whose `pair` reaches `AIM`, if any does."""
    per_pair = plan.textures * plan.task.repeats
    table = [{"participants": float(n), **power(p_values, plan, n, per_pair, studies, seed)} for n in SHOWN]
    needed = next((n for n, row in zip(SHOWN, table, strict=True) if row["pair"] >= AIM), None)
    trials = counted(per_pair, "trial")
    heading = f"{of}, {plan.methods} methods, {trials} of each pair by each participant, α = 0.05"
    return Power(heading, table, needed, f"any: the test of all methods; pair: {pair}, adjusted for all pairs")


def power(p_values: PValues, plan: Plan, n: int, per_pair: int, studies: int, seed: int) -> dict[str, float]:
    """Shares of studies with n people in which the overall test (`any`) and pairs, on average (`pair`), are below `ALPHA`."""
    rng = np.random.default_rng(seed)
    drawn = [p_values(plan, rng, n, per_pair) for _ in range(studies)]
    return {
        "any": float(np.mean([p < ALPHA for p, _ in drawn])),
        "pair": float(np.mean([(p < ALPHA).mean() for _, p in drawn])),
    }


@dataclass(frozen=True)
class Discrimination:
    """A task in which one surface is the right answer.

    Args:
        name: in sentences.
        choices: names of the surfaces that can be chosen.
        share_of: d′ → share of right answers.
        sensitivity_of: of participants by number, and their trials of one pair.
        draw: sensitivity of people whose shares of right answers are some, from so many trials each.
    """

    name: str
    choices: tuple[str, ...]
    share_of: Callable[[Array], Array]
    sensitivity_of: Callable[[Sequence[int], Sequence[dict[str, Any]]], Sensitivity]
    draw: Callable[[np.random.Generator, Array, int], Sensitivity]

    def kind(self, surfaces: Callable[[Trial], tuple[int, ...]], intervals: tuple[str, ...], question: str) -> TaskKind:
        """The task, with its surfaces, their names, and the key of its question in the words of a language."""
        return TaskKind(
            surfaces=surfaces,
            read=self.read,
            analyse=self.analyse,
            simulate=self.simulate,
            power=self.power,
            effect=EFFECT,
            effect_in_words=f"d′ = {EFFECT:g} between two methods",
            n_studies=(200, 60),
            order=Order(pairs=True, n_targets=len(self.choices)),
            intervals=intervals,
            choices=self.choices,
            settings=("repeats", "feedback"),
            question=lambda task: question,
            columns=("other", "choice", "target", "right", "contact_s_1", "contact_s_2", "contact_s_3"),
        )

    def read(self, ratings: Ratings, _document: Mapping[str, Any]) -> list[Ratings]:
        """Shares of right answers to each pair of methods."""
        compared = pairs(len(ratings.methods))

        def hits(row: Mapping[str, Any]) -> dict[int, bool]:
            pair = min(row["method"], row["other"]), max(row["method"], row["other"])
            return {compared.index(pair): row["rating"] == row["target"]}

        labels = [f"{ratings.methods[a]}, {ratings.methods[b]}" for a, b in compared]
        return [shares_of(ratings, "share of right answers", labels, hits)]

    def analyse(self, every: list[Ratings], reference: str | None, correction: str) -> list[Result]:
        """d′ of each pair of methods, or of those with a reference."""
        (ratings,) = every
        document, cautions = beginning(ratings, self.choices, correction)
        overall = document["sensitivity"] = self._of_pairs(ratings, ratings.rows, reference)
        document["sensitivity_within_textures"] = {
            texture: self._of_pairs(ratings, rows, reference) for texture, rows in by_texture(ratings).items()
        }
        sentences = [minus(sentence) for sentence in self._sentences(ratings, overall)]
        return [Result(ratings, document, sentences, cautions + of_trials(ratings))]

    def _of_pairs(
        self, ratings: Ratings, rows: Sequence[dict[str, Any]], reference: str | None
    ) -> list[dict[str, Any]]:
        methods, result = ratings.methods, []
        for i, j in pairs(len(methods), None if reference is None else methods.index(reference)):
            of_pair = [row for row in rows if {row["method"], row["other"]} == {i, j}]
            sensitivity = self.sensitivity_of(ratings.numbers, of_pair)
            result.append({"pair": [methods[i], methods[j]], **json_values(vars(sensitivity))})
        p = np.array([row["p"] for row in result])
        for row, bonferroni, adjusted in zip(result, np.minimum(len(p) * p, 1.0), holm(p), strict=True):
            row |= {"p_bonferroni": float(bonferroni), "p_holm": float(adjusted)}
        return result

    def _sentences(self, ratings: Ratings, overall: Sequence[dict[str, Any]]) -> list[str]:
        sentences = [
            f"{who_compared(ratings, 'were to tell apart')}, by {self.name} ({len(ratings.rows)} answers). "
            "d′ is by the differencing model, of all answers together, with 95 % intervals over participants."
        ]
        for row in overall:
            sentences.append(
                f"{row['pair'][0]} and {row['pair'][1]}: {100 * row['share']:.0f} % right of {row['n_trials']:.0f} answers "
                f"({100 / len(self.choices):.0f} % by chance), d′ = {row['d_prime']:.2f}{ends(row)}; "
                f"exact one-sided test against chance, {p_text(row['p_holm'])}{' (Holm)' * (len(overall) > 1)}."
            )
        return sentences

    def people(self, plan: Plan, rng: np.random.Generator, n: int) -> Array:
        """d′ of each pair (n, pairs), of people about a mean."""
        d_prime = EFFECT if plan.effect is None else plan.effect
        if not 0.0 <= d_prime <= 10.0:
            raise ValueError(f"d′ is {d_prime:g}, expected 0 to 10")
        deviates = rng.standard_normal((n, len(pairs(plan.methods))))
        return np.asarray(d_prime * np.exp(SPREAD * deviates - SPREAD**2 / 2))

    def simulate(self, plan: Plan, n: int, rng: np.random.Generator) -> People:
        """People who are right as often as their d′ lets them."""
        people, family = self.people(plan, rng, n), pairs(plan.methods)

        def person(i: int, _deviate: float) -> Callable[[Trial], Answer]:
            def answer(trial: Trial) -> Answer:
                assert trial.other is not None
                pair = family.index((min(trial.method, trial.other), max(trial.method, trial.other)))
                if rng.random() < self.share_of(people[i, pair]):
                    return {CHOICE: float(trial.target)}, {}
                others = [place for place in range(len(self.choices)) if place != trial.target]
                return {CHOICE: float(rng.choice(others))}, {}

            return answer

        return person

    def p_values(self, plan: Plan, rng: np.random.Generator, n: int, per_pair: int) -> tuple[float, Array]:
        """Smallest p of a simulated study, and p of each pair, after Holm's bound for the smallest."""
        p = np.array([self.draw(rng, share, per_pair).p for share in self.share_of(self.people(plan, rng, n)).T])
        adjusted = np.minimum(p * len(p), 1.0)
        return float(adjusted.min()), adjusted

    def power(self, plan: Plan, studies: int, seed: int) -> Power:
        """Power of the tests of d′."""
        of = f"d′ = {EFFECT if plan.effect is None else plan.effect:g}"
        return power_of_choices(self.p_values, plan, studies, seed, of, "two methods")
