"""Repeated-measures statistics of ratings: arrays in, numbers out; they know nothing of a server or a file.

Ratings are arrays y of shape (n, a) or (n, a, b): participants, methods, textures. Leading axes before those are studies.
What cannot be computed, where every value is the same, is NaN.

Sources: Greenhouse & Geisser, Psychometrika 24, 95 (1959), for ε; Mauchly, Annals of Mathematical Statistics 11, 204 (1940);
Olejnik & Algina, Psychological Methods 8, 434 (2003), for generalised η²; Holm, Scandinavian Journal of Statistics 6, 65 (1979);
Shrout & Fleiss, Psychological Bulletin 86, 420 (1979), for intraclass correlations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.signedinteger[Any]]


@dataclass(frozen=True)
class Effect:
    """A row of an analysis of variance; each value a number, or an array over studies."""

    name: str
    f: Array
    df: tuple[float, float]
    p: Array
    epsilon: Array  # Greenhouse and Geisser's
    p_corrected: Array  # with it
    partial_eta2: Array
    generalised_eta2: Array
    mauchly_p: Array  # of the hypothesis that ε is 1; NaN where there are fewer participants than it needs


def contrasts(k: int) -> Array:
    """Orthonormal contrasts of k conditions, shape (k, k − 1)."""
    q, _ = np.linalg.qr(np.concatenate([np.ones((k, 1)), np.eye(k)[:, :-1]], axis=1))
    return np.asarray(q[:, 1:])


def anova(y: Array, names: Sequence[str] = ("method", "texture")) -> list[Effect]:
    """Repeated-measures analysis of variance of complete ratings.

    One factor: y of shape (…, n, a) with one name. Two factors: (…, n, a, b), both main effects and their interaction.

    Raises:
        ValueError: there are fewer than two participants or conditions, or a value is missing.
    """
    y = np.asarray(y, dtype=np.float64)
    if len(names) == 1:
        y = y[..., None]
    n, a, b = y.shape[-3:]
    if n < 2 or a < 2 or (len(names) == 2 and b < 2):
        raise ValueError(f"{n} participants and {a} × {b} conditions, expected two or more of each")
    if not np.isfinite(y).all():
        raise ValueError("a rating is missing: an analysis of variance needs all of a participant's")
    flat = y.reshape(*y.shape[:-2], a * b)
    means = [np.full((k, 1), k**-0.5) for k in (a, b)]
    spaces = {names[0]: np.kron(contrasts(a), means[1])}
    if len(names) == 2:
        spaces[names[1]] = np.kron(means[0], contrasts(b))
        spaces[f"{names[0]} × {names[1]}"] = np.kron(contrasts(a), contrasts(b))
    subjects = flat @ np.kron(*means)
    others = ((subjects - subjects.mean(-2, keepdims=True)) ** 2).sum((-2, -1))
    parts = {name: _parts(flat @ space) for name, space in spaces.items()}
    noise = others + sum(error for _, error, _ in parts.values())
    return [_effect(name, n, *part, noise) for name, part in parts.items()]


def _parts(scores: Array) -> tuple[Array, Array, Array]:
    """Sums of squares of an effect and its error, and the covariance of its scores (…, n, d)."""
    n = scores.shape[-2]
    mean = scores.mean(-2, keepdims=True)
    deviations = scores - mean
    covariance = np.swapaxes(deviations, -1, -2) @ deviations / (n - 1)
    return n * (mean**2).sum((-2, -1)), (deviations**2).sum((-2, -1)), covariance


def _effect(name: str, n: int, effect: Array, error: Array, covariance: Array, noise: Array) -> Effect:
    from scipy import stats

    d = covariance.shape[-1]
    df = float(d), float(d * (n - 1))
    trace = np.trace(covariance, axis1=-2, axis2=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        f = np.where(error > 1e-18 * (effect + error + 1e-300), (effect / df[0]) / (error / df[1]), np.nan)
        epsilon = np.clip(trace**2 / (d * (covariance**2).sum((-2, -1))), 1 / d, 1.0)
        partial, generalised = effect / (effect + error), effect / (effect + noise)
    return Effect(
        name,
        f,
        df,
        stats.f.sf(f, *df),
        epsilon,
        stats.f.sf(f, df[0] * epsilon, df[1] * epsilon),
        partial,
        generalised,
        _mauchly(covariance, n),
    )


def _mauchly(covariance: Array, n: int) -> Array:
    """p of Mauchly's test of sphericity, with the second term of its expansion.

    R 4.2's `mauchly.test` has the number of conditions in one place of that term where the number of contrasts belongs, which
    moves p by less than a hundredth where it is above 0.03.
    """
    from scipy import stats

    d = covariance.shape[-1]
    trace = np.trace(covariance, axis1=-2, axis2=-1)
    if d < 2 or n - 1 < d:
        return np.full(trace.shape, np.nan if d >= 2 else 1.0)
    sign, log_det = np.linalg.slogdet(covariance)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_w = np.where(sign > 0, log_det - d * np.log(trace / d), np.nan)
    rho = 1 - (2 * d * d + d + 2) / (6 * d * (n - 1))
    w2 = (d + 2) * (d - 1) * (d - 2) * (2 * d**3 + 6 * d * d + 3 * d + 2) / (288 * (d * (n - 1) * rho) ** 2)
    z, df = -(n - 1) * rho * log_w, d * (d + 1) / 2 - 1
    first, second = stats.chi2.sf(z, df), stats.chi2.sf(z, df + 4)
    return np.asarray(np.clip(first + w2 * (second - first), 0.0, 1.0))


def holm(p: Array) -> Array:
    """p values adjusted by Holm's method along the last axis."""
    p = np.asarray(p, dtype=np.float64)
    m = p.shape[-1]
    order = np.argsort(p, axis=-1)
    stepped = np.maximum.accumulate(np.take_along_axis(p, order, -1) * np.arange(m, 0, -1), axis=-1)
    adjusted = np.empty_like(p)
    np.put_along_axis(adjusted, order, np.minimum(stepped, 1.0), -1)
    return adjusted


def bonferroni(p: Array) -> Array:
    """p values adjusted by their number along the last axis."""
    p = np.asarray(p, dtype=np.float64)
    return np.minimum(p * p.shape[-1], 1.0)


def pairs(k: int, reference: int | None = None) -> list[tuple[int, int]]:
    """All pairs of k conditions, or those of a reference with each other condition, the reference first."""
    if reference is None:
        return list(combinations(range(k), 2))
    return [(reference, other) for other in range(k) if other != reference]


@dataclass(frozen=True)
class Paired:
    """Comparisons of two conditions within participants; arrays over studies and, last, pairs."""

    pairs: list[tuple[int, int]]
    difference: Array  # of the means
    low: Array  # of its confidence interval
    high: Array
    t: Array
    df: float
    p: Array
    p_bonferroni: Array
    p_holm: Array
    dz: Array  # Cohen's d of the differences
    d_av: Array  # the difference over the mean of both standard deviations


def paired_tests(y: Array, reference: int | None = None, confidence: float = 0.95) -> Paired:
    """Paired t-tests of conditions y (…, n, a): a family for Bonferroni and Holm.

    Args:
        y: complete ratings.
        reference: compares all others with this condition; None for all pairs.
        confidence: of the intervals, which are not adjusted.
    """
    from scipy import stats

    y = np.asarray(y, dtype=np.float64)
    n, a = y.shape[-2:]
    family = pairs(a, reference)
    first, second = (y[..., [pair[i] for pair in family]] for i in (0, 1))
    d = first - second
    mean, sd = d.mean(-2), d.std(-2, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = mean / (sd / np.sqrt(n))
        d_av = mean / ((first.std(-2, ddof=1) + second.std(-2, ddof=1)) / 2)
        dz = mean / sd
    p = 2 * stats.t.sf(np.abs(t), n - 1)
    half = stats.t.ppf((1 + confidence) / 2, n - 1) * sd / np.sqrt(n)
    return Paired(family, mean, mean - half, mean + half, t, float(n - 1), p, bonferroni(p), holm(p), dz, d_av)


@dataclass(frozen=True)
class Friedman:
    """Friedman's test by ranks."""

    chi2: float
    df: int
    p: float
    w: float  # Kendall's coefficient of concordance


def friedman(y: Array) -> Friedman:
    """Friedman's test of conditions y (n, a), corrected for ties."""
    from scipy import stats

    n, a = y.shape
    ranks = stats.rankdata(y, axis=1)
    counts = np.concatenate([np.unique(row, return_counts=True)[1] for row in y])
    ties = float((counts**3 - counts).sum())
    spread = float(((ranks.mean(0) - (a + 1) / 2) ** 2).sum())
    correction = 1 - ties / (n * (a**3 - a))
    if correction <= 0:
        return Friedman(np.nan, a - 1, np.nan, np.nan)
    chi2 = 12 * n / (a * (a + 1)) * spread / correction
    return Friedman(chi2, a - 1, float(stats.chi2.sf(chi2, a - 1)), chi2 / (n * (a - 1)))


@dataclass(frozen=True)
class SignedRank:
    """Wilcoxon's signed-rank tests of pairs."""

    pairs: list[tuple[int, int]]
    w: Array
    p: Array
    p_holm: Array
    rank_biserial: Array  # −1 … 1


def wilcoxon_tests(y: Array, reference: int | None = None) -> SignedRank:
    """Signed-rank tests of conditions y (n, a), adjusted by Holm's method; p is 1 where nothing differs.

    Zero differences are left out; equal ones share the mean of their ranks.
    """
    from scipy import stats

    family = pairs(y.shape[1], reference)
    w: list[float] = []
    p: list[float] = []
    r: list[float] = []
    for i, j in family:
        d = y[:, i] - y[:, j]
        d = d[d != 0]
        if d.size == 0:
            w, p, r = [*w, np.nan], [*p, 1.0], [*r, 0.0]
            continue
        ranks = stats.rankdata(np.abs(d))
        up, down = float(ranks[d > 0].sum()), float(ranks[d < 0].sum())
        w.append(min(up, down))
        p.append(float(stats.wilcoxon(d).pvalue))
        r.append((up - down) / (up + down))
    return SignedRank(family, np.array(w), np.array(p), holm(np.array(p)), np.array(r))


@dataclass(frozen=True)
class Reliability:
    """Agreement of participants."""

    with_others: Array  # (n,): correlation of a participant's ratings with the mean of the others'
    single: float  # intraclass correlation of a single rater, ICC(2,1)
    mean: float  # of the mean of all, ICC(2,k)


def reliability(y: Array) -> Reliability:
    """Reliability of ratings y (n, conditions); NaN where a participant rated all the same."""
    n, k = y.shape
    others = (y.sum(0) - y) / (n - 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (v - v.mean(1, keepdims=True) for v in (y, others))
        r = (a * b).sum(1) / np.sqrt((a**2).sum(1) * (b**2).sum(1))
        between_targets = n * ((y.mean(0) - y.mean()) ** 2).sum() / (k - 1)
        between_raters = k * ((y.mean(1) - y.mean()) ** 2).sum() / (n - 1)
        left = y - y.mean(0) - y.mean(1)[:, None] + y.mean()
        error = (left**2).sum() / ((n - 1) * (k - 1))
        single = (between_targets - error) / (between_targets + (n - 1) * error + n * (between_raters - error) / k)
        mean = (between_targets - error) / (between_targets + (between_raters - error) / k)
    return Reliability(r, float(single), float(mean))


@dataclass(frozen=True)
class MixedModel:
    """A linear mixed model of ratings, for those that are not complete."""

    terms: list[tuple[str, float, int, float, float]]  # name, F, and its two degrees of freedom, p
    sd_participants: float
    sd_methods: float  # of a method's worth between participants
    sd_textures: float
    sd_residual: float
    converged: bool


def mixed_model(participant: Index, method: Index, texture: Index, rating: Array) -> MixedModel:
    """Linear mixed model of ratings in long form, shapes (rows,): method × texture fixed, and by participant a random intercept,
    a random effect of each method and of each texture; fitted by REML.

    F is Wald's over its degrees of freedom; those of the denominator are of the stratum in which an effect lies, as in an
    analysis of variance, so that complete ratings give the same F.

    Raises:
        ValueError: a cell of method and texture has no rating.
    """
    import warnings

    import pandas
    from scipy import stats
    from statsmodels.regression.mixed_linear_model import MixedLM

    frame = pandas.DataFrame({"participant": participant, "method": method, "texture": texture, "rating": rating})
    a, b = (int(column.max()) + 1 for column in (method, texture))
    if np.unique(method * b + texture).size < a * b:
        raise ValueError("a texture has no rating with some method: a mixed model cannot say what it is worth")
    n = np.unique(participant).size
    ca, cb = contrasts(a), contrasts(b) if b > 1 else np.zeros((1, 0))
    blocks = {"method": ca[method]}
    if b > 1:
        blocks["texture"] = cb[texture]
        blocks["method × texture"] = (ca[method][:, :, None] * cb[texture][:, None, :]).reshape(rating.size, -1)
    exog = np.concatenate([np.ones((rating.size, 1)), *blocks.values()], axis=1)
    parts = {"methods": "0 + C(method)"} | ({"textures": "0 + C(texture)"} if b > 1 else {})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that a variance is at its edge, 0, is a result
        model = MixedLM(
            frame["rating"],
            exog,
            groups=frame["participant"],
            exog_re=np.ones((rating.size, 1)),
            exog_vc=_components(frame, parts),
        )
        fitted = model.fit(reml=True, method=["lbfgs", "powell"])
    covariance = np.asarray(fitted.cov_params())[: exog.shape[1], : exog.shape[1]]
    fixed = np.asarray(fitted.fe_params)
    strata = {"method": (a - 1), "texture": (b - 1), "method × texture": (a - 1) * (b - 1)}
    terms: list[tuple[str, float, int, float, float]] = []
    at = 1
    left = rating.size - n * (1 + (a - 1) + (b - 1)) - (a - 1) * (b - 1) if b > 1 else rating.size - n - (a - 1)
    for name, block in blocks.items():
        width = block.shape[1]
        part = slice(at, at + width)
        at += width
        wald = float(fixed[part] @ np.linalg.solve(covariance[part, part], fixed[part]))
        in_stratum = name != "method × texture" and b > 1
        df2 = float((n - 1) * strata[name]) if in_stratum else float(max(1, left))
        f = wald / width
        terms.append((name, f, width, df2, float(stats.f.sf(f, width, df2))))
    variances = dict(zip(parts, np.asarray(fitted.vcomp), strict=False))
    return MixedModel(
        terms,
        float(np.sqrt(max(0.0, np.asarray(fitted.cov_re)[0, 0]))) if np.size(fitted.cov_re) else 0.0,
        float(np.sqrt(variances.get("methods", 0.0))),
        float(np.sqrt(variances.get("textures", 0.0))),
        float(np.sqrt(fitted.scale)),
        bool(fitted.converged),
    )


def _components(frame: Any, parts: dict[str, str]) -> Any:
    """Random effects beside the intercept, as statsmodels takes them."""
    from statsmodels.regression.mixed_linear_model import VCSpec

    names, columns, matrices = [], [], []
    for name, kind in zip(parts, ("method", "texture"), strict=False):
        levels = sorted(frame[kind].unique())
        by_group = {
            group: (rows[kind].to_numpy()[:, None] == np.array(levels)).astype(float)
            for group, rows in frame.groupby("participant")
        }
        groups = sorted(by_group)
        names.append(name)
        columns.append([[f"{name}[{level}]" for level in levels] for _ in groups])
        matrices.append([by_group[group] for group in groups])
    return VCSpec(names, columns, matrices)
