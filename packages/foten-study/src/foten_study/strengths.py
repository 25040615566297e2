"""Strengths of methods by paired comparisons.

Participants are the unit. The choices of one participant are not independent, so intervals are over participants.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.dsp.inference import holm
from foten_study.statistics import Array, contrasts, pairs

N_ENUMERATED = 14  # participants up to which all patterns of signs are gone through, 8,192
N_PATTERNS = 20_000  # drawn beyond, the observed one among them; at p = 0.05 the standard error is 0.0015


@dataclass(frozen=True)
class Strengths:
    """Log-odds of k methods, of pairs of them, and the test that no method is preferred.

    A method is chosen over another with the odds exp(difference of their log-odds).
    """

    log_odds: Array  # (k,), of mean 0
    ci95_low: Array  # (k,), not adjusted
    ci95_high: Array
    pairs: list[tuple[int, int]]
    difference: Array  # of log-odds, of each pair
    difference_low: Array  # its 95 % interval, not adjusted
    difference_high: Array
    t: Array
    df: float
    p: Array
    p_bonferroni: Array
    p_holm: Array
    overall_f: float  # Hotelling's T² as F
    overall_df: tuple[int, int]
    overall_p: float  # by signs
    separated: bool  # half a win was added to each side of each compared pair
    n_participants: int  # with at least one choice


def bradley_terry(wins: Array, reference: int | None = None) -> Strengths:
    """Strengths by maximum likelihood of Bradley and Terry's model, of all pairs or of a reference with each other method.

    Intervals and t-tests, of n − 1 degrees, are by the delete-one-participant jackknife, with Newton's first step for each
    participant left out. They are NaN for fewer than three participants, where all chose alike, and where methods without a
    chain of comparisons remain when one participant is left out. Where no chain of wins leads from some method to another the
    likelihood has no maximum: half a win is added to each side of each compared pair, and counts in the variance as one more
    participant's.

    `overall_p` compares T², of participants' scores at equality, with that of all patterns of signs of their scores; beyond
    14 participants of random ones. It is exact where preferences are spread symmetrically about none, and cannot be below
    2^(1 − n). p of F, for which scores are normal, is too small where they have few values: of 21 participants with one trial of
    two methods it was below 0.05 in 9 % of null studies. T² and p are NaN unless n is above both 2 and k − 1.

    Args:
        wins: how often participant i chose method a over b, shape (n, k, k); half a win each for a tie.
        reference: method whose pairs are tested; all pairs if None.

    Raises:
        ValueError: not such counts, nothing chosen, or methods that no chain of comparisons connects.

    Sources: Bradley & Terry, Biometrika 39, 324 (1952); Bell & McCaffrey, Survey Methodology 28, 169 (2002), for the jackknife.
    """
    from scipy import stats

    wins = _choices(wins)
    n, k = wins.shape[:2]
    if reference is not None and not 0 <= reference < k:
        raise ValueError(f"the reference is method {reference}, expected one of 0 … {k - 1}")
    total, space = wins.sum(0), contrasts(k)
    reached = _reached(total + total.T)
    if not reached.all():
        a, b = np.argwhere(~reached)[0]
        raise ValueError(f"methods {a} and {b} are compared by no chain of pairs; expected every method to be")
    separated = bool(not _reached(total).all())
    added = 0.5 * (total + total.T > 0) * separated
    log_odds = _maximum(total + added)
    scores, information = _scores(wins, log_odds, space)
    added_score, added_information = _scores(added, log_odds, space)
    full = information.sum(0) + added_information
    covariance = np.full((k - 1, k - 1), np.nan)
    left = full - information
    if n >= 3 and np.linalg.eigvalsh(left).min() > 1e-9 * np.trace(full):
        steps = np.linalg.solve(left, scores[..., None])[..., 0]
        extra = np.linalg.solve(full, added_score)
        covariance = (n - 1) / n * steps.T @ steps + np.outer(extra, extra)
    half = stats.t.ppf(0.975, n - 1) if n > 1 else np.nan
    family = pairs(k, reference)
    by_pair = np.array([space[a] - space[b] for a, b in family])
    difference = np.array([log_odds[a] - log_odds[b] for a, b in family])
    se, pair_se = _standard_errors(space, covariance), _standard_errors(by_pair, covariance)
    t = difference / pair_se
    p = 2 * stats.t.sf(np.abs(t), n - 1)
    f, overall_p = _no_preference(_scores(wins, np.zeros(k), space)[0])
    return Strengths(
        log_odds,
        log_odds - half * se,
        log_odds + half * se,
        family,
        difference,
        difference - half * pair_se,
        difference + half * pair_se,
        t,
        float(n - 1),
        p,
        np.minimum(len(family) * p, 1.0),
        holm(p),
        f,
        (k - 1, n - k + 1),
        overall_p,
        separated,
        n,
    )


def _choices(wins: Array) -> Array:
    """Wins of the participants who chose at all."""
    wins = np.asarray(wins, dtype=float)
    if wins.ndim != 3 or wins.shape[1] != wins.shape[2] or wins.shape[1] < 2:
        raise ValueError(
            f"wins are of shape {wins.shape}, expected (participants, methods, methods) of two or more methods"
        )
    if not (np.isfinite(wins).all() and (wins >= 0).all()):
        raise ValueError("wins hold a negative or missing number, expected counts")
    if np.trace(wins.sum(0)) > 0:
        raise ValueError("a method is chosen over itself, expected 0 on the diagonal of wins")
    chosen = wins[wins.sum((1, 2)) > 0]
    if not chosen.size:
        raise ValueError("nobody has chosen, expected at least one win")
    return chosen


def _reached(wins: Array) -> NDArray[np.bool_]:
    """Whether a chain of wins leads from each method to each other one, shape (k, k)."""
    return np.linalg.matrix_power((wins > 0) + np.eye(wins.shape[0]), wins.shape[0]) > 0


def _scores(wins: Array, log_odds: Array, space: Array) -> tuple[Array, Array]:
    """Gradient (…, d) and information (…, d, d) of the log-likelihood of wins (…, k, k) along the columns of space (k, d)."""
    from scipy.special import expit

    share = expit(log_odds[:, None] - log_odds)
    trials = wins + np.swapaxes(wins, -1, -2)
    weight = trials * share * (1 - share)
    laplacian = weight.sum(-1)[..., None] * np.eye(len(log_odds)) - weight
    return (wins - trials * share).sum(-1) @ space, space.T @ laplacian @ space


def _maximum(wins: Array) -> Array:
    """Log-odds of mean 0 at the maximum of the likelihood, by Newton's steps, shape (k,)."""
    space = contrasts(wins.shape[0])
    log_odds = np.zeros(wins.shape[0])
    for _ in range(200):
        step = space @ np.linalg.solve(*_scores(wins, log_odds, space)[::-1])
        size = np.abs(step).max()
        log_odds += step / max(1.0, size)  # Newton's step alone may leap past a far maximum
        if size < 1e-10:
            break
    return log_odds


def _standard_errors(directions: Array, covariance: Array) -> Array:
    """Standard errors along directions (rows, d); NaN where nothing varies."""
    variance = np.einsum("pi,ij,pj->p", directions, covariance, directions)
    return np.sqrt(np.where(variance > 1e-18, variance, np.nan))


def _no_preference(scores: Array) -> tuple[float, float]:
    """F of Hotelling's T² of participants' scores (n, d), and p by their signs.

    With a basis Q of the columns of the scores, (n, r), T² grows with |Qᵀs|², s the signs, all 1 as observed.
    """
    n, d = scores.shape
    if n < 3 or n <= d:
        return np.nan, np.nan
    left, size, _ = np.linalg.svd(scores, full_matrices=False)
    basis = left[:, size > 1e-9 * max(1.0, size[0])]
    observed = float((basis.sum(0) ** 2).sum())
    full = basis.shape[1] == d and observed < n * (1 - 1e-9)
    f = (n - d) / d * observed / (n - observed) if full else np.nan
    if n <= N_ENUMERATED:
        signs = 1 - 2.0 * (np.arange(2 ** (n - 1))[:, None] >> np.arange(n) & 1)  # the last is 1: −s is as s
    else:
        signs = 1 - 2.0 * np.random.default_rng(0).integers(0, 2, (N_PATTERNS, n), dtype=np.int8)
        signs[0] = 1
    return f, float(np.mean(((signs @ basis) ** 2).sum(1) >= observed - 1e-9 * n))
