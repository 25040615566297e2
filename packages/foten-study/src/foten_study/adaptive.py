"""Adaptive measurements with people: a threshold, a point of equal strength, and what is preferred over all else.

Both keep a posterior over what is asked for, show what tells most about it, and go on from the answer:

    p(θ | answers) ∝ p(θ) Π p(answer | θ, shown)        shown = argmax I(θ; answer)

Source: levels after Watson, "QUEST+: a general multidimensional Bayesian adaptive psychometric method", Journal of Vision 17
(2017); the point after Coombs, "A theory of data" (1964): of two, the nearer to one's own ideal is chosen.
"""

from dataclasses import dataclass
from itertools import product
from typing import Any, ClassVar

import numpy as np

from foten.dsp import Array

LAPSES = (0.01, 0.05, 0.1)  # share of answers that have nothing to do with what was shown
SENSITIVITIES = (0.5, 1.0, 2.0)  # of a choice, a just noticeable difference
N_PARTICLES = 4000
N_PAIRS = 200  # tried before each choice
N_ASKED = 500  # particles that each of them is tried on
SHRINK = 0.98  # of particles towards their mean where they are drawn anew (Liu and West, 2001)


@dataclass(frozen=True)
class Detection:
    """Share of right answers where one of several places or intervals holds something.

        P = guess + (1 − guess − lapse) · (1 − exp(−10^(slope · (level − point) / 2)))

    Weibull's function of amplitude: 63 % of the way up at the threshold.
    """

    guess: float = 1 / 3  # where nothing is felt: one over the number of places
    slopes: ClassVar[tuple[float, ...]] = (0.1, 0.2, 0.35)  # a dB

    def __post_init__(self) -> None:
        if not 0 < self.guess < 0.8:
            raise ValueError(f"guess is {self.guess:g}, expected one over the number of places")

    def __call__(self, level: float | Array, point: Array, slope: Array, lapse: Array) -> Array:
        felt = 1 - np.exp(-(10 ** (slope * (level - point) / 2)))
        return np.asarray(self.guess + (1 - self.guess - lapse) * felt)


@dataclass(frozen=True)
class Comparison:
    """Share of answers that what is shown is the stronger of two: a logistic function, a half at the point of equality."""

    slopes: ClassVar[tuple[float, ...]] = (0.25, 0.5, 1.0)  # a dB

    def __call__(self, level: float | Array, point: Array, slope: Array, lapse: Array) -> Array:
        return np.asarray(0.5 * lapse + (1 - lapse) * (0.5 + 0.5 * np.tanh(0.5 * slope * (level - point))))


class LevelSearch:
    """The level at which answers turn from no to yes [dB]: a threshold of detection, or a point of equal strength.

        search = LevelSearch(-60.0, 20.0)
        level = search.stimulus()        # show it in one of three places
        search.answer(level, yes=True)   # which was named; until search.sd is small enough

    Slope and lapse are unknown too. Levels from `low` to `high` are a step of 1 dB apart for what is searched for and 2 for what
    is shown; what is searched for may lie `above_db` over `high`. `expected` is mean and standard deviation over people [dB].
    """

    def __init__(
        self,
        low: float,
        high: float,
        answers: Detection | Comparison = Detection(),
        expected: tuple[float, float] | None = None,
        above_db: float = 0.0,
    ) -> None:
        if not high - low >= 4:
            raise ValueError(f"levels from {low:g} to {high:g} dB, expected a range of 4 dB or more")
        self.levels = np.arange(low, high + 0.5, 2.0)
        grid = np.array(list(product(np.arange(low, high + above_db + 0.5, 1.0), answers.slopes, LAPSES)))
        self._point, slope, lapse = grid.T
        self._yes = np.stack([answers(level, self._point, slope, lapse) for level in self.levels])  # (levels, θ)
        self._spread = _entropy(self._yes)  # of an answer by someone who is known
        prior = np.ones(len(grid))
        if expected is not None:
            prior = np.exp(-0.5 * np.square((self._point - expected[0]) / expected[1]))
        self._posterior = prior / prior.sum()
        self.n_answers = 0

    @property
    def point(self) -> float:
        """Mean of the posterior [dB]."""
        return float(self._posterior @ self._point)

    @property
    def sd(self) -> float:
        """Its standard deviation [dB]."""
        return float(np.sqrt(self._posterior @ np.square(self._point - self.point)))

    def stimulus(self) -> float:
        """The level that tells most [dB]."""
        return float(self.levels[np.argmax(_entropy(self._yes @ self._posterior) - self._spread @ self._posterior)])

    def answer(self, level: float, yes: bool) -> None:
        """Take in an answer to a level of `levels`."""
        p = self._yes[int(np.argmin(np.abs(self.levels - level)))]
        self._posterior = self._posterior * (p if yes else 1 - p)
        self._posterior = self._posterior / self._posterior.sum()
        self.n_answers += 1


class PreferenceSearch:
    """The point of a box of n dimensions that someone likes best, by choices between two.

        search = PreferenceSearch(4, seed=0)
        first, second = search.pair()                  # points, (d,), −1 … 1 each
        search.answer(first, second, chose_first=True)

    P(first) = lapse/2 + (1 − lapse) · logistic(β (|second − x| − |first − x|)), x the ideal point, distances in units of `jnd`: a
    just noticeable difference of all dimensions or of each, (n,), as a share of half of its range.
    The searches are ours, since of the libraries for them questplus is under the GPL and AEPsych needs NumPy below 2.
    """

    def __init__(self, n: int, jnd: float | Array = 0.2, seed: int = 0) -> None:
        self._rng, self._jnd = np.random.default_rng(seed), jnd
        self._points = self._rng.uniform(-1, 1, (N_PARTICLES, n))
        self._beta = self._rng.choice(SENSITIVITIES, N_PARTICLES)
        self._lapse = self._rng.choice(LAPSES, N_PARTICLES)
        self._weight = np.full(N_PARTICLES, 1 / N_PARTICLES)
        self.n_answers = 0

    @property
    def point(self) -> Array:
        """Mean of the posterior, (d,)."""
        return np.asarray(self._weight @ self._points)

    @property
    def sd(self) -> Array:
        """Its standard deviations, (d,)."""
        return np.asarray(np.sqrt(self._weight @ np.square(self._points - self.point)))

    def pair(self) -> tuple[Array, Array]:
        """Two points between which a choice tells most: of what is thought possible, or across the box."""
        drawn = self._points[self._rng.choice(N_PARTICLES, (N_PAIRS // 2, 2), p=self._weight)]
        wide = self._rng.uniform(-1, 1, (N_PAIRS - len(drawn), 2, self._points.shape[1]))
        pairs = np.concatenate([drawn, wide])
        some = self._rng.choice(N_PARTICLES, N_ASKED, p=self._weight)
        chosen = self._first(pairs[:, :1], pairs[:, 1:], some)
        weight = np.full(len(some), 1 / len(some))
        first, second = pairs[np.argmax(_entropy(chosen @ weight) - _entropy(chosen) @ weight)]
        return first, second

    def _first(self, first: Array, second: Array, rows: Any = slice(None)) -> Array:
        """Probability of choosing the first, for some particles: points (…, 1, d) or (d,) → (…, particles)."""
        ideal = self._points[rows]
        away = (np.linalg.norm((point - ideal) / self._jnd, axis=-1) for point in (second, first))
        logistic = 0.5 + 0.5 * np.tanh(0.5 * self._beta[rows] * (next(away) - next(away)))
        return np.asarray(0.5 * self._lapse[rows] + (1 - self._lapse[rows]) * logistic)

    def answer(self, first: Array, second: Array, chose_first: bool) -> None:
        """Take in a choice."""
        p = self._first(first, second)
        self._weight = self._weight * (p if chose_first else 1 - p)
        self._weight = self._weight / self._weight.sum()
        self.n_answers += 1
        if 1 / np.square(self._weight).sum() < N_PARTICLES / 2:
            self._draw_anew()

    def _draw_anew(self) -> None:
        """Equal weights: particles by their weight, shrunk and jittered so that mean and variance stay."""
        mean, sd = self.point, self.sd
        rows = self._rng.choice(N_PARTICLES, N_PARTICLES, p=self._weight)
        jitter = self._rng.standard_normal(self._points.shape) * sd * np.sqrt(1 - SHRINK**2)
        self._points = np.clip(SHRINK * self._points[rows] + (1 - SHRINK) * mean + jitter, -1, 1)
        self._beta, self._lapse = self._beta[rows], self._lapse[rows]
        self._weight = np.full(N_PARTICLES, 1 / N_PARTICLES)


def _entropy(p: Array) -> Array:
    p = np.clip(p, 1e-12, 1 - 1e-12)
    return np.asarray(-p * np.log(p) - (1 - p) * np.log(1 - p))
