"""How well pairs of methods are told apart: what ABX and the oddity task share, with another count of right answers each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from foten.dsp.inference import holm
from foten.reporting.table import minus
from foten_study.choosing import beginning, by_texture, ends, power_of_choices, shares_of, who_compared
from foten_study.orders import Order, Trial
from foten_study.results import json_value, of_trials, p_text
from foten_study.sensitivity import Sensitivity
from foten_study.statistics import Array, pairs
from foten_study.tasks.kind import CHOICE, Answer, People, Population, Power, PowerQuery, Ratings, Result, TaskKind

EFFECT = 1.0  # d′ between two methods
SPREAD = 0.4  # of the logarithm of d′ between people


@dataclass(frozen=True)
class Discrimination:
    """A task in which one surface is the right answer.

    Args:
        name: in sentences.
        choices: names of the surfaces that can be chosen.
        share_of: d′ → share of right answers.
        sensitivity_of: of participants by number, and their trials of one pair: participant, target, and the surface chosen as
            `rating`.
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
        index = None if reference is None else ratings.methods.index(reference)
        result = []
        for i, j in pairs(len(ratings.methods), index):
            of_pair = [row for row in rows if {row["method"], row["other"]} == {i, j}]
            sensitivity = self.sensitivity_of(ratings.numbers, of_pair)
            values = {one.name: json_value(getattr(sensitivity, one.name)) for one in fields(Sensitivity)}
            result.append({"pair": [ratings.methods[i], ratings.methods[j]], **values})
        p = np.array([row["p"] for row in result])
        adjusted = {"p_bonferroni": np.minimum(len(p) * p, 1.0), "p_holm": holm(p)}
        return [
            {**row, **{name: float(values[k]) for name, values in adjusted.items()}} for k, row in enumerate(result)
        ]

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

    def people(self, rng: np.random.Generator, n: int, n_methods: int, d_prime: float) -> Array:
        """d′ of each pair (n, pairs), of people about a mean."""
        if not 0.0 <= d_prime <= 10.0:
            raise ValueError(f"d′ is {d_prime:g}, expected 0 to 10")
        deviates = rng.standard_normal((n, len(pairs(n_methods))))
        return np.asarray(d_prime * np.exp(SPREAD * deviates - SPREAD**2 / 2))

    def simulate(self, population: Population, rng: np.random.Generator) -> People:
        """People who are right as often as their d′ lets them."""
        people, family = (
            self.people(rng, population.n, population.n_methods, population.effect),
            pairs(population.n_methods),
        )

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

    def p_values(
        self, rng: np.random.Generator, n: int, per_pair: int, n_methods: int = 2, d_prime: float = EFFECT
    ) -> tuple[float, Array]:
        """Smallest p of a simulated study, and p of each pair, after Holm's bound for the smallest."""
        shares = self.share_of(self.people(rng, n, n_methods, d_prime))
        p = np.array([self.draw(rng, share, per_pair).p for share in shares.T])
        adjusted = np.minimum(p * len(p), 1.0) if len(p) > 1 else p
        return float(adjusted.min()), adjusted

    def power(self, query: PowerQuery) -> Power:
        """Power of the tests of d′."""
        d_prime = EFFECT if query.effect is None else query.effect

        def p_values(rng: np.random.Generator, n: int, per_pair: int) -> tuple[float, Array]:
            return self.p_values(rng, n, per_pair, query.methods, d_prime)

        return power_of_choices(p_values, query, f"d′ = {d_prime:g}", "two methods")
