"""Raters from a stated model, and the power of studies with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foten_study.statistics import ALPHA, Array, anova, paired_tests

PAPER_METHODS = ("ar", "dstn", "ldhtd", "foten")
PAPER_PARTICIPANTS, PAPER_TEXTURES = 21, 12
PAPER_MEAN, PAPER_SD = 80.14, 10.67  # of FoTEN; Sec. VIII
# By how much FoTEN was better on the 8 textures where it was significantly so, and on the other 4 from nothing to that; Sec. VII.
PAPER_DIFFERENCES = {"dstn": (9.75, 31.33), "ldhtd": (8.75, 25.25)}
# Of AR the text gives p alone, after Bonferroni's correction, taken as for 6 pairs, on all 12 textures; Sec. VII.
PAPER_AR_P = (2.0e-7, 1.0e-3)
SHOWN = (4, 8, 12, 16, 21, 24, 30, 40, 50, 60)  # numbers of participants whose power is printed
AIM = 0.8  # power that a study should have
MIN_DIFFERENCE = 8.75  # points; the smallest that the paper found significant, Sec. VII


@dataclass(frozen=True)
class Raters:
    """A model of raters: rating = mean(method, texture) + rater + rater × method + rater × texture + noise, cut to the scale.

    Args:
        means: of each method on each texture, on the scale of 0 to 100, shape (a, b).
        sd: of the ratings of one condition between raters.
        correlation: of one rater's ratings of two conditions, beyond what they share by method or texture.
        by_method, by_texture: shares of the variance that is left.
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
    """Share of studies with n raters in which each test finds something at `ALPHA`:

    the two main effects and the interaction, with Greenhouse and Geisser's correction; `pair`, the share in which the last method
    differs from another one on a texture, after Holm's adjustment within the texture, averaged over textures and other methods;
    `all pairs`, the share in which it does on every texture from every other.
    """
    y = raters.draw(np.random.default_rng(seed), n, studies)
    result = {effect.name: float(np.nanmean(effect.p_corrected < ALPHA)) for effect in anova(y)}
    tests = paired_tests(np.moveaxis(y, -1, -3))  # (studies, textures, n, methods)
    with_last = [i for i, pair in enumerate(tests.pairs) if len(raters.means) - 1 in pair]
    significant = tests.p_holm[..., with_last] < ALPHA
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
