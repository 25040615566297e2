"""People of a stated model who choose between surfaces or search for a threshold, and the power of studies with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from foten.study import raters
from foten.study.choices import abx, abx_share, bradley_terry, oddity, oddity_share
from foten.study.design import CHOICE, Design, Task, repeats_of_new
from foten.study.orders import Trial, conditions, square
from foten.study.raters import AIM, MIN_DIFFERENCE, Raters
from foten.study.statistics import ALPHA, Array, pairs
from foten.study.store import Rated, Store
from foten.study.thresholds import simulated_answers, thresholds_of

SHOWN = (4, 8, 12, 16, 21, 30, 40, 60)  # numbers of participants whose power is printed
SHARE_RIGHT: dict[str, Callable[[Array], Array]] = {"abx": abx_share, "oddity": oddity_share}
DEFAULT_EFFECTS = {"paired": 0.65, "abx": 1.0, "oddity": 1.0, "threshold": 3.0}
EFFECTS = {
    "rating": f"a difference of {MIN_DIFFERENCE:g} points on a texture",
    "paired": f"a share of {DEFAULT_EFFECTS['paired']:.0%} of choices over another method".replace("%", " %"),
    "abx": f"d′ = {DEFAULT_EFFECTS['abx']:g} between two methods",
    "oddity": f"d′ = {DEFAULT_EFFECTS['oddity']:g} between two methods",
    "threshold": f"a difference of {DEFAULT_EFFECTS['threshold']:g} dB between two methods' thresholds",
}
THRESHOLD_SD_DB = 5.0  # of thresholds between people
CONDITION_SD_DB = 1.0  # and of each person's between conditions
N_ERRORS = 200  # simulated, for what a search leaves open


@dataclass(frozen=True)
class Choosers:
    """A model of people who choose.

    Args:
        task: paired, abx or oddity.
        n_methods: that are compared.
        effect: share of choices of the better method over each other one (paired), or d′ of each pair.
        spread: between people; of log-odds of each method, or of the logarithm of d′.
        better: number of the method that is chosen more often.
    """

    task: str
    n_methods: int
    effect: float
    spread: float = 0.4
    better: int = -1

    def __post_init__(self) -> None:
        low, high = (0.01, 0.99) if self.task == "paired" else (0.0, 10.0)
        if not low <= self.effect <= high:
            what = "the share of choices" if self.task == "paired" else "d′"
            raise ValueError(f"{what} is {self.effect:g}, expected {low:g} to {high:g}")

    def people(self, rng: np.random.Generator, n: int) -> Array:
        """Log-odds of each method (n, methods), or d′ of each pair (n, pairs)."""
        if self.task == "paired":
            strengths = np.zeros(self.n_methods)
            strengths[self.better] = np.log(self.effect / (1 - self.effect))
            return strengths + self.spread * rng.standard_normal((n, self.n_methods))
        n_pairs = len(pairs(self.n_methods))
        return np.asarray(self.effect * np.exp(self.spread * rng.standard_normal((n, n_pairs)) - self.spread**2 / 2))

    def answer(self, rng: np.random.Generator, person: Array, trial: Trial) -> int:
        """Which surface one of `people` chooses in a trial."""
        assert trial.other is not None
        if self.task == "paired":
            first = 1 / (1 + np.exp(person[trial.other] - person[trial.method]))
            return int(rng.random() >= first)
        pair = pairs(self.n_methods).index((min(trial.method, trial.other), max(trial.method, trial.other)))
        if rng.random() < SHARE_RIGHT[self.task](person[pair]):
            return trial.target
        others = [place for place in range(2 if self.task == "abx" else 3) if place != trial.target]
        return int(rng.choice(others))

    def p_values(self, rng: np.random.Generator, n: int, per_pair: int) -> tuple[float, Array]:
        """p of a simulated study's overall test, and of each pair of the better method, or of all pairs, by Holm's adjustment.

        Args:
            per_pair: trials of each pair by each participant.
        """
        people, family = self.people(rng, n), pairs(self.n_methods)
        if self.task == "paired":
            wins = np.zeros((n, self.n_methods, self.n_methods))
            for a, b in family:
                wins[:, a, b] = rng.binomial(per_pair, 1 / (1 + np.exp(people[:, b] - people[:, a])))
                wins[:, b, a] = per_pair - wins[:, a, b]
            strengths = bradley_terry(wins)
            better = self.better % self.n_methods
            return strengths.overall_p, strengths.p_holm[[better in pair for pair in strengths.pairs]]
        shares, p = SHARE_RIGHT[self.task](people), []
        for share in shares.T:
            if self.task == "oddity":
                p.append(oddity(rng.binomial(per_pair, share), np.full(n, per_pair)).p)
                continue
            n_a = per_pair // 2 + (per_pair % 2) * (np.arange(n) % 2)  # of X as A
            right = rng.binomial(n_a, share), rng.binomial(per_pair - n_a, share)
            x_a, x_b = (right[0], n_a - right[0]), (per_pair - n_a - right[1], right[1])
            p.append(abx(np.stack(x_a, axis=1), np.stack(x_b, axis=1)).p)
        adjusted = np.minimum(np.array(p) * len(p), 1.0) if len(p) > 1 else np.array(p)
        return float(adjusted.min()), adjusted


def power(choosers: Choosers, n: int, per_pair: int, studies: int, seed: int) -> dict[str, float]:
    """Share of studies with n people in which something is found at `ALPHA`: `any` by the overall test, and `pair`, the mean
    over pairs, after adjustment.
    """
    rng = np.random.default_rng(seed)
    found = [choosers.p_values(rng, n, per_pair) for _ in range(studies)]
    return {
        "any": float(np.mean([p < ALPHA for p, _ in found])),
        "pair": float(np.mean([(p < ALPHA).mean() for _, p in found])),
    }


def needed(
    choosers: Choosers, per_pair: int, studies: int, seed: int, shown: Sequence[int] = SHOWN
) -> tuple[list[dict[str, float]], int | None]:
    """Power for numbers of participants, and the smallest of them whose `pair` reaches `AIM`, if any does."""
    rows = [{"participants": float(n), **power(choosers, n, per_pair, studies, seed)} for n in shown]
    return rows, next((n for n, row in zip(shown, rows, strict=True) if row["pair"] >= AIM), None)


def threshold_raters(task: Task, methods: int, textures: int, effect: float, seed: int) -> raters.Raters:
    """Raters whose ratings are thresholds [dB], with what a search of the task's answers leaves open, by simulated searches.

    Those of the better method, or of one method's last texture, are lower by the effect; means are at the middle of the scale.
    """
    rng, middle = np.random.default_rng(seed), (task.low_db + task.high_db) / 2
    error = thresholds_of(task, np.full(N_ERRORS, middle), rng).std()
    own, shared = CONDITION_SD_DB**2 + error**2, THRESHOLD_SD_DB**2
    a, b = (methods, textures) if methods > 1 else (textures, 1)
    if a < 2:
        raise ValueError("there is one method on one texture, expected two or more to compare")
    means = np.full((a, b), 50.0)
    means[-1] -= effect
    return raters.Raters(means, float(np.sqrt(own + shared)), float(shared / (own + shared)), 0.0, 0.0)


def participants_for(task: str, methods: int, textures: int) -> tuple[int, int | None]:
    """Number of participants of a new study, in complete squares where these are small, and how many find the effect of `EFFECTS`
    in `AIM` of studies, if 60 do.
    """
    if task == "rating":
        n = raters.needed(raters.raters_for(methods, textures, MIN_DIFFERENCE), 300, 0)[1]
    elif task == "threshold":
        if methods * textures < 2:
            return 12, None
        n = raters.needed(threshold_raters(Task(task), methods, textures, DEFAULT_EFFECTS[task], 0), 300, 0)[1]
    else:
        per_pair = textures * repeats_of_new(task, textures, methods)
        n = needed(Choosers(task, methods, DEFAULT_EFFECTS[task]), per_pair, 60, 0)[1]
    many, cycle = n or 40, square(textures, len(conditions(task, methods, repeats_of_new(task, textures, methods))))
    return (-(-many // cycle) * cycle if cycle <= 48 else many), n


def simulate_study(
    store: Store, design: Design, model: Raters, effect: float, better: int, missing: float, seed: int
) -> None:
    """Let people answer all that a design asks; a share of them leaves before the end.

    Args:
        model: of those who rate, each scale on its own.
        effect: of those who choose, as `Choosers` has it; of a threshold, by how many dB that of the better method is lower.
        better: number of the better method.
    """
    rng, task, n = np.random.default_rng(seed), design.task, design.participants
    n_methods, n_textures = len(design.methods), len(design.textures)
    ratings = [model.draw(rng, n) for _ in design.asked]
    choosers = Choosers(task.kind, n_methods, effect, better=better) if task.kind in ("paired", *SHARE_RIGHT) else None
    people = choosers.people(rng, n) if choosers is not None else np.zeros((n, 0))

    def is_better(t: int, m: int) -> bool:
        return m == better % n_methods if n_methods > 1 else t == n_textures - 1

    base = (task.low_db + task.high_db) / 2
    for i in range(n):
        number = store.join(f"SIM{i + 1:03d}")
        trials = [trial for trial in store.trials(number) if not trial.practice or task.kind != "threshold"]
        n_done = len(trials) if rng.random() >= missing else int(rng.integers(1, len(trials)))
        level = base + THRESHOLD_SD_DB * rng.standard_normal()
        tracks = {
            (t, m): iter(
                simulated_answers(task, level - effect * is_better(t, m) + CONDITION_SD_DB * rng.standard_normal(), rng)
            )
            for t in range(n_textures if task.kind == "threshold" else 0)
            for m in range(n_methods)
        }
        rated = {}
        for trial in trials[:n_done]:
            log: dict[str, float] = {}
            if choosers is not None:
                values = {CHOICE: float(choosers.answer(rng, people[i], trial))}
            elif task.kind == "threshold":
                log["level_db"], right = next(tracks[trial.texture, trial.method])
                values = {CHOICE: float((trial.target + (0 if right else rng.integers(1, 3))) % 3)}
            else:
                scales = zip(design.asked, ratings, strict=True)
                values = {scale.key: float(np.round(drawn[i, trial.method, trial.texture])) for scale, drawn in scales}
            rated[f"trial:{trial.number}"] = Rated(values, float(rng.gamma(9, 2.5)), 0, log)
        store.take_steps(number, rated)
