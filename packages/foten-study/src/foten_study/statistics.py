"""Repeated-measures statistics of ratings y, shape (…, n, a) or (…, n, a, b): studies, participants, methods, textures.

Ratings are complete, but for the mixed model. What cannot be computed, where every value is the same, is NaN.
"""

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp.inference import holm, student_quantile

ALPHA = 0.05  # of every test
Array = NDArray[np.float64]
Index = NDArray[np.signedinteger[Any]]


def contrasts(k: int) -> Array:
    """Orthonormal contrasts of k conditions, shape (k, k − 1)."""
    q, _ = np.linalg.qr(np.concatenate([np.ones((k, 1)), np.eye(k)[:, :-1]], axis=1))
    return np.asarray(q[:, 1:])


def anova(y: Array) -> list[dict[str, Any]]:
    """Repeated-measures analysis of variance of complete ratings, shape (…, n, a, b): both main effects and their interaction.

    Where b is 1 there is the effect of method alone. An effect has `name`, `f` of two degrees `df`, `p`, and `p_corrected` by
    `epsilon` (Greenhouse & Geisser, Psychometrika 24, 95, 1959); `partial_eta2`, `generalised_eta2` (Olejnik & Algina,
    Psychological Methods 8, 434, 2003); `mauchly_p` of the hypothesis that ε is 1, NaN where participants are too few.
    """
    n, a, b = y.shape[-3:]
    flat = y.reshape(*y.shape[:-2], a * b)
    means = [np.full((k, 1), k**-0.5) for k in (a, b)]
    spaces = {"method": np.kron(contrasts(a), means[1])}
    if b > 1:
        spaces["texture"] = np.kron(means[0], contrasts(b))
        spaces["method × texture"] = np.kron(contrasts(a), contrasts(b))
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


def _effect(name: str, n: int, effect: Array, error: Array, covariance: Array, noise: Array) -> dict[str, Any]:
    from scipy import stats

    d = covariance.shape[-1]
    df = float(d), float(d * (n - 1))
    trace = np.trace(covariance, axis1=-2, axis2=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        f = np.where(error > 1e-18 * (effect + error + 1e-300), (effect / df[0]) / (error / df[1]), np.nan)
        epsilon = np.clip(trace**2 / (d * (covariance**2).sum((-2, -1))), 1 / d, 1.0)
        partial, generalised = effect / (effect + error), effect / (effect + noise)
    corrected = {"epsilon": epsilon, "p_corrected": stats.f.sf(f, df[0] * epsilon, df[1] * epsilon)}
    sizes = {"partial_eta2": partial, "generalised_eta2": generalised}
    test = {"name": name, "f": f, "df": df, "p": stats.f.sf(f, *df)}
    return {**test, **corrected, **sizes, "mauchly_p": _mauchly(covariance, n)}


def _mauchly(covariance: Array, n: int) -> Array:
    """p of Mauchly's test of sphericity (Ann. Math. Stat. 11, 204, 1940), with the second term of its expansion.

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


def pairs(k: int, reference: int | None = None) -> list[tuple[int, int]]:
    """All pairs of k conditions, or those of a reference with each other condition, the reference first."""
    if reference is None:
        return list(combinations(range(k), 2))
    return [(reference, other) for other in range(k) if other != reference]


def paired_tests(y: Array, reference: int | None = None) -> dict[str, Any]:
    """Paired t-tests of all pairs of conditions y (…, n, a), or of a reference with each other one: a family for Bonferroni and
    Holm. `difference` is of means, with its interval, not adjusted; `dz` is Cohen's d of the differences, `d_av` the difference
    over the mean of both standard deviations; arrays are over studies and, last, pairs.
    """
    n, a = y.shape[-2:]
    family = pairs(a, reference)
    first, second = np.moveaxis(y[..., family], -1, 0)
    d = first - second
    mean, sd = d.mean(-2), d.std(-2, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        dz, d_av = mean / sd, mean / ((first.std(-2, ddof=1) + second.std(-2, ddof=1)) / 2)
        t = dz * np.sqrt(n)
    half = student_quantile(n) * sd / np.sqrt(n)
    interval = {"ci95_low": mean - half, "ci95_high": mean + half}
    return {"pairs": family, "difference": mean, **interval, **t_tests(t, n - 1), "dz": dz, "d_av": d_av}


def t_tests(t: Array, df: int) -> dict[str, Any]:
    """A family of two-sided t-tests, last axis, of so many degrees of freedom."""
    from scipy import stats

    p = 2 * stats.t.sf(np.abs(t), df)
    return {"t": t, "df": float(df), "p": p, "p_bonferroni": np.minimum(t.shape[-1] * p, 1.0), "p_holm": holm(p)}


def friedman(y: Array) -> dict[str, Any]:
    """Friedman's test of conditions y (…, n, a), corrected for ties: `chi2`, `df`, `p`, and Kendall's `w`."""
    from scipy import stats

    n, a = y.shape[-2:]
    ranks = stats.rankdata(y, axis=-1) - (a + 1) / 2
    with np.errstate(invalid="ignore"):  # of equal ratings there is none
        w = n * (ranks.mean(-2) ** 2).sum(-1) / (ranks**2).sum((-2, -1))
    chi2 = n * (a - 1) * w
    return {"chi2": chi2, "df": a - 1, "p": stats.chi2.sf(chi2, a - 1), "w": w}


def wilcoxon_tests(y: Array, reference: int | None = None) -> dict[str, Any]:
    """Wilcoxon's signed-rank tests of conditions y (n, a): `pairs`, `w`, `p`, 1 where nothing differs, `p_holm`, and
    `rank_biserial` from −1 to 1. Zero differences are left out; equal ones share the mean of their ranks.
    """
    from scipy import stats

    family = pairs(y.shape[1], reference)
    rows = []
    for i, j in family:
        d = y[:, i] - y[:, j]
        d = d[d != 0]
        if d.size == 0:
            rows.append((np.nan, 1.0, 0.0))
            continue
        test, total = stats.wilcoxon(d), d.size * (d.size + 1) / 2
        up = stats.wilcoxon(d, alternative="greater").statistic
        rows.append((test.statistic, test.pvalue, 2 * up / total - 1))
    w, p, rank_biserial = np.array(rows).T
    return {"pairs": family, "w": w, "p": p, "p_holm": holm(p), "rank_biserial": rank_biserial}


def reliability(y: Array) -> tuple[float, float, Array]:
    """Reliability of ratings y (n, conditions): ICC(2,1) of a single rater, ICC(2,k) of the mean of all, and the correlation of
    each participant's ratings with the mean of the others' (n,), NaN where a participant rated all the same.

    Source: Shrout & Fleiss, Psychological Bulletin 86, 420 (1979).
    """
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
    return float(single), float(mean), r


def mixed_model(participant: Index, method: Index, texture: Index, rating: Array) -> dict[str, Any]:
    """Linear mixed model of ratings in long form, shapes (rows,): method × texture fixed, and by participant a random intercept,
    a random effect of each method and of each texture; fitted by REML. `terms` have name, f, df, p; `sd` is of random effects.

    F is Wald's over its degrees of freedom; those of the denominator are of the stratum in which an effect lies, as in an
    analysis of variance, so that complete ratings give the same F.
    """
    import warnings

    import pandas
    from scipy import stats
    from statsmodels.regression.mixed_linear_model import MixedLM

    frame = pandas.DataFrame({"participant": participant, "method": method, "texture": texture, "rating": rating})
    n, a, b = (int(frame[name].nunique()) for name in ("participant", "method", "texture"))
    fixed, random = "C(method, Sum)", {"participant × method": "0 + C(method)"}
    df2 = {"method": max(1, rating.size - n - (a - 1))}
    if b > 1:
        fixed, random = f"{fixed} * C(texture, Sum)", {**random, "participant × texture": "0 + C(texture)"}
        left = rating.size - n * (a + b - 1) - (a - 1) * (b - 1)
        df2 = {"method": (n - 1) * (a - 1), "texture": (n - 1) * (b - 1), "method × texture": max(1, left)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that a variance is at its edge, 0, is a result
        model = MixedLM.from_formula(
            f"rating ~ {fixed}", frame, groups="participant", re_formula="1", vc_formula=random
        )
        fitted = model.fit(reml=True, method=["lbfgs", "powell"])
        wald = fitted.wald_test_terms(scalar=True).table.iloc[1:]  # behind the intercept
    terms = []
    for (name, df), chi2, width in zip(df2.items(), wald["statistic"], wald["df_constraint"], strict=True):
        f = float(chi2) / width
        terms.append({"name": name, "f": f, "df": [int(width), float(df)], "p": float(stats.f.sf(f, width, df))})
    variances = {"participants": np.asarray(fitted.cov_re)[0, 0], **dict.fromkeys(random, 0.0)}
    variances |= dict(zip(model.exog_vc.names, fitted.vcomp, strict=True), residual=fitted.scale)
    sd = {name: float(np.sqrt(max(0.0, variance))) for name, variance in variances.items()}
    return {"terms": terms, "sd": sd, "converged": bool(fitted.converged)}
