"""Raters from a stated model, and what a study with them would find: for the number of participants, and to try a study before
anyone is invited.

    rating = mean(method, texture) + rater + rater × method + rater × texture + noise, cut to the scale

Its standard deviation between raters and the correlation between two ratings of one rater are parameters; what one rater
thinks of a method and of a texture has a stated share of the rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.study.statistics import anova, paired_tests

Array = NDArray[np.float64]

PAPER_METHODS = ("ar", "dstn", "ldhtd", "foten")
PAPER_PARTICIPANTS, PAPER_TEXTURES = 21, 12
PAPER_MEAN, PAPER_SD = 80.14, 10.67  # of FoTEN; Sec. VIII
# By how much FoTEN was better on the 8 textures where it was significantly so, and on the other 4 from nothing to that; Sec. VII.
PAPER_DIFFERENCES = {"dstn": (9.75, 31.33), "ldhtd": (8.75, 25.25)}
# Of AR the text gives p alone, after Bonferroni's correction for 6 pairs, on all 12 textures; Sec. VII.
PAPER_AR_P = (2.0e-7, 1.0e-3)
SHOWN = (4, 8, 12, 16, 21, 24, 30, 40, 50)  # numbers of participants whose power is printed
SMALLEST = 8.75  # the smallest difference that the paper found significant


@dataclass(frozen=True)
class Raters:
    """A model of raters.

    Args:
        means: of each method on each texture, on the scale of 0 to 100, shape (a, b).
        sd: of the ratings of one condition between raters.
        correlation: of one rater's ratings of two conditions, beyond what they share by method or texture.
        by_method, by_texture: shares of the variance that is left.
        lapses: share of ratings that are drawn from the whole scale.
    """

    means: Array
    sd: float = PAPER_SD
    correlation: float = 0.3
    by_method: float = 0.15
    by_texture: float = 0.15
    lapses: float = 0.0

    def __post_init__(self) -> None:
        for name in ("correlation", "by_method", "by_texture", "lapses"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} is {getattr(self, name)}, expected 0 to 1")
        if self.by_method + self.by_texture > 1:
            raise ValueError(
                f"by_method and by_texture are {self.by_method} and {self.by_texture}: they are more than all"
            )
        if not 0 < self.sd < np.inf:
            raise ValueError(f"the standard deviation is {self.sd}, expected a positive number")

    @property
    def sd_of_difference(self) -> float:
        """Return the standard deviation of one rater's difference between two methods on one texture."""
        return float(self.sd * np.sqrt(2 * (1 - self.correlation) * (1 - self.by_texture)))

    def draw(self, rng: np.random.Generator, n: int, studies: int | None = None) -> Array:
        """Return ratings 0 … 100, shape (n, a, b), or (studies, n, a, b)."""
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
        if self.lapses:
            lapsed = rng.random(y.shape) < self.lapses
            y = np.where(lapsed, rng.uniform(0, 100, y.shape), y)
        return np.asarray(np.clip(y, 0, 100))


def paper_raters(correlation: float = 0.3) -> Raters:
    """Return raters with the effects of Sec. VII on 4 methods and 12 textures.

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
    sd = Raters(means, correlation=correlation).sd_of_difference
    means[PAPER_METHODS.index("ar")] -= np.linspace(high, low, PAPER_TEXTURES) * sd / np.sqrt(PAPER_PARTICIPANTS)
    return Raters(means, correlation=correlation)


def raters_for(
    methods: int, textures: int, difference: float, sd: float = PAPER_SD, correlation: float = 0.3
) -> Raters:
    """Return raters to whom the last method is worth so much more than each other one, on every texture."""
    means = np.full((methods, textures), 65.0)
    means[-1] += difference
    return Raters(means, sd=sd, correlation=correlation)


def power(raters: Raters, n: int, studies: int, seed: int, alpha: float = 0.05) -> dict[str, float]:
    """Return the share of studies with n raters in which each test finds something at α:

    the two main effects and the interaction, with Greenhouse and Geisser's correction; `pair`, the share in which the last method
    differs from another one on a texture, after Holm's adjustment within the texture, averaged over textures and other methods;
    `all pairs`, the share in which it does on every texture from every other.
    """
    rng = np.random.default_rng(seed)
    a, b = raters.means.shape
    y = raters.draw(rng, n, studies)
    names = ("method", "texture") if b > 1 else ("method",)
    effects = anova(y if b > 1 else y[..., 0], names)
    result: dict[str, Any] = {effect.name: float(np.nanmean(effect.p_corrected < alpha)) for effect in effects}
    tests = paired_tests(np.moveaxis(y, -1, -3))  # (studies, textures, n, methods)
    with_last = [i for i, pair in enumerate(tests.pairs) if a - 1 in pair]
    found = tests.p_holm[..., with_last] < alpha
    result["pair"] = float(found.mean())
    result["all pairs"] = float(found.all((-2, -1)).mean())
    return result


def needed(
    raters: Raters, studies: int, seed: int, aim: float = 0.8, most: int = 60
) -> tuple[list[dict[str, float]], int | None]:
    """Return the power for numbers of participants up to `most`, and the smallest whose `pair` reaches an aim, if any does."""
    counts = sorted({*(n for n in SHOWN if n <= most), most})
    rows = [{"participants": float(n), **power(raters, n, studies, seed)} for n in counts]
    reaching = [n for n, row in zip(counts, rows, strict=True) if row["pair"] >= aim]
    if not reaching:
        return rows, None
    low = max((n for n in counts if n < reaching[0]), default=2)
    high = reaching[0]
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if power(raters, middle, studies, seed)["pair"] >= aim else (middle, high)
    return rows, high
