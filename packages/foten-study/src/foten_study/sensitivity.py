"""Sensitivity: how well participants tell two methods apart, by three-interval oddity and by ABX.

Participants are the unit. The choices of one participant are not independent, so intervals are over participants.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from foten_study.statistics import Array


@dataclass(frozen=True)
class Sensitivity:
    """How well participants tell two methods apart."""

    share: float  # of right answers
    unbiased_share: float  # as of participants without a leaning to an answer; d′ is of this one
    d_prime: float
    ci95_low: float
    ci95_high: float  # infinite where all answers are right
    p: float  # of the hypothesis that nobody can tell them apart
    n_participants: int  # with at least one trial
    n_trials: int


def oddity_share(d_prime: Array | float) -> Array:
    """Share of right answers where the odd one of three intervals is looked for, by the differencing model.

    Of standard normal variables, one of mean d′, the two nearest are taken for alike. The share is
    2 ∫₀^∞ [Φ(−z√3 + d′√(2/3)) + Φ(−z√3 − d′√(2/3))] φ(z) dz, here by Owen's T, the share of a wedge.

    Source: Macmillan & Creelman, Detection Theory, 2nd ed., 2005.
    """
    from scipy import special

    return np.asarray(1 - 4 * special.owens_t(np.asarray(d_prime) / np.sqrt(6), np.sqrt(3)))


def abx_share(d_prime: Array | float) -> Array:
    """Share of right answers of ABX without bias, by the differencing model.

    Source: Macmillan & Creelman, Detection Theory, 2nd ed., 2005.
    """
    from scipy.special import ndtr

    a, b = np.asarray(d_prime) / np.sqrt(2), np.asarray(d_prime) / np.sqrt(6)
    return np.asarray(ndtr(a) * ndtr(b) + ndtr(-a) * ndtr(-b))


def d_prime_at(share: Array | float, share_of: Callable[[Array], Array]) -> Array:
    """d′ at which `oddity_share` or `abx_share` is share; 0 at or below chance, infinite at 1."""
    share = np.asarray(share, dtype=float)
    low, high = np.zeros_like(share), np.full_like(share, 40.0)  # where either share is 1
    for _ in range(60):
        middle = (low + high) / 2
        below = share_of(middle) < share
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.where(share >= 1, np.inf, np.where(share > share_of(np.zeros(())), low, 0.0))


def oddity(right: Array, trials: Array) -> Sensitivity:
    """Sensitivity by the oddity task of three intervals; `_sensitivity` says how.

    p is the binomial mid-p of all trials. It holds whatever interval participants lean to if the odd one's is drawn anew for each
    trial; if the odd one is in each interval equally often p is too large for those who lean.

    Args:
        right: number of right answers of each participant, shape (n,).
        trials: number of trials, shape (n,).

    Raises:
        ValueError: not such counts, or no trial.
    """
    from scipy import stats

    right, trials = _counts("right answers", right, 1), _counts("trials", trials, 1)
    if right.shape != trials.shape:
        raise ValueError(
            f"there are {right.size} numbers of right answers and {trials.size} of trials, expected as many"
        )
    if (right > trials).any():
        i = int(np.argmax(right > trials))
        raise ValueError(f"participant {i} has {right[i]:.0f} right answers of {trials[i]:.0f} trials")
    if not trials.any():
        raise ValueError("there is no trial, expected at least one")
    right, trials = right[trials > 0], trials[trials > 0]
    n_right, n_trials = right.sum(), trials.sum()
    share = min(n_right / n_trials, _max_share(n_trials))
    left_out = (n_right - right) / np.maximum(n_trials - trials, 1)
    p = stats.binom.sf(n_right, n_trials, 1 / 3) + stats.binom.pmf(n_right, n_trials, 1 / 3) / 2
    variance = share * (1 - share) / n_trials
    return _sensitivity(float(n_right / n_trials), share, left_out, variance, trials, oddity_share, float(p))


def abx(x_a: Array, x_b: Array) -> Sensitivity:
    """Sensitivity by ABX; `_sensitivity` says how.

    The unbiased share is Φ((z(H) − z(F)) / 2), H the share of answers A where X was A and F where it was B, of all trials. Where
    either is 0 or 1 half an answer of each of the four kinds is added, the log-linear correction. Leanings of participants that
    cancel in H and F lower this share; their variance over participants with at least two trials of each kind corrects it.

    p is a conditional mid-p: where nobody can tell, answers do not depend on X, so that, given a participant's trials and
    answers, the number of answers A where X was A is hypergeometric, whatever the leaning.

    Args:
        x_a: answers A and answers B of each participant where X was A, shape (n, 2).
        x_b: the same where X was B.

    Raises:
        ValueError: not such counts, or no trial of one of the kinds.

    Source: Hautus, Behavior Research Methods, Instruments, & Computers 27, 46 (1995), for the correction.
    """
    x_a, x_b = _counts("answers where X is A", x_a, 2), _counts("answers where X is B", x_b, 2)
    if x_a.shape != x_b.shape:
        raise ValueError(
            f"answers are of {len(x_a)} participants where X is A, of {len(x_b)} where X is B, expected as many"
        )
    for name, answers in (("A", x_a), ("B", x_b)):
        if not answers.any():
            raise ValueError(f"there is no trial where X is {name}, expected at least one")
    active = (x_a + x_b).any(1)
    x_a, x_b = x_a[active], x_b[active]
    right, trials = np.stack([x_a[:, 0], x_b[:, 1]]), np.stack([x_a.sum(1), x_b.sum(1)])
    n = len(x_a)
    shares, variance = _unbiased_share(np.concatenate([np.ones((1, n)), 1 - np.eye(n)]), right, trials)
    share_right = float(right.sum() / trials.sum())
    return _sensitivity(
        share_right, shares[0], shares[1:], variance, trials.sum(0), abx_share, _no_association(x_a, x_b)
    )


def _counts(name: str, counts: Array, n_axes: int) -> Array:
    """Counts (n,) or (n, 2) as floating-point numbers."""
    counts = np.asarray(counts, dtype=float)
    if counts.ndim != n_axes or counts.shape[1:] not in ((), (2,)):
        raise ValueError(
            f"{name} are of shape {counts.shape}, expected {('(participants,)', '(participants, 2)')[n_axes - 1]}"
        )
    if not (np.isfinite(counts).all() and (counts >= 0).all() and (counts % 1 == 0).all()):
        raise ValueError(f"{name} hold a negative, broken or missing number, expected counts")
    return counts


def _max_share(n_trials: float) -> float:
    """Share by the log-linear correction where all answers are right, so that d′ is finite."""
    return float((n_trials + 0.5) / (n_trials + 1))


def _unbiased_share(members: Array, right: Array, trials: Array) -> tuple[Array, float]:
    """Unbiased share of groups of participants (groups, n), and the variance of the first one's by its trials alone.

    Args:
        members: 1 for those in the group, else 0.
        right: right answers where X is A and where it is B, shape (2, n).
        trials: trials, of the same shape.
    """
    from scipy.special import ndtr, ndtri

    n_right, n_trials = members @ right.T, members @ trials.T
    extreme = ((n_right == 0) | (n_right == n_trials)).any(1, keepdims=True)
    share = (n_right + 0.5 * extreme) / (n_trials + extreme)
    z = ndtri(share)
    middle = z.mean(1)
    slope = _density(middle)
    unbiased = ndtr(middle)
    # Where a participant's two shares are p ± u, Φ((z(p + u) + z(p − u)) / 2) is p + u² z(p) / (2 φ(z(p))) + O(u⁴); u is
    # half the leaning, and its variance what the leanings vary by beyond their trials.
    repeated = (trials > 1).all(0)
    n_repeated = members[:, repeated].sum(1)
    by_participant = right[:, repeated] / trials[:, repeated]
    leaning = by_participant[0] - by_participant[1]
    noise = (by_participant * (1 - by_participant) / (trials[:, repeated] - 1)).sum(0)
    count = np.maximum(n_repeated, 2)
    total, squares, noises = (members[:, repeated] @ np.stack([leaning, leaning**2, noise], axis=1)).T
    spread = (squares - total**2 / count) / (count - 1) - noises / count
    unbiased += np.where(n_repeated > 1, spread, 0) * middle / (8 * slope)
    variance = float((slope[0] ** 2 / 4 * share[0] * (1 - share[0]) / n_trials[0] / _density(z[0]) ** 2).sum())
    max_share = _max_share(float(trials.sum()))
    return np.clip(unbiased, 1 - max_share, max_share), variance


def _density(z: Array) -> Array:
    """Density of the standard normal distribution."""
    return np.asarray(np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi))


def _no_association(x_a: Array, x_b: Array) -> float:
    """Mid-p of as many answers A where X was A, or more, given each participant's trials and answers."""
    from scipy.special import gammaln

    below, distribution = 0, np.ones(1)  # of the sum over participants, which begins at below
    for (a_a, a_b), (b_a, b_b) in zip(x_a, x_b, strict=True):
        n_a, n_b, n_answers = a_a + a_b, b_a + b_b, a_a + b_a
        hits = np.arange(max(0, n_answers - n_b), min(n_a, n_answers) + 1)
        log = -sum(gammaln(count + 1) for count in (hits, n_a - hits, n_answers - hits, n_b - n_answers + hits))
        weight = np.exp(log - log.max())
        below += int(hits[0])
        distribution = np.convolve(distribution, weight / weight.sum())
    observed = int(x_a[:, 0].sum()) - below
    return float(min(1.0, distribution[observed + 1 :].sum() + distribution[observed] / 2))


def _sensitivity(
    share_right: float,
    share: float,
    left_out: Array,
    variance: float,
    trials: Array,
    share_of: Callable[[Array], Array],
    p: float,
) -> Sensitivity:
    """d′ of a share, 0 at or below chance, and its interval.

    The interval is Wilson's of the share, with as many trials as would give binomially the variance of the delete-one-participant
    jackknife, and t of n − 1 degrees for the normal quantile. Of a single participant, or where the jackknife finds no
    variance, that variance is of the trials alone. It is then transformed to d′, which is thus of the mean share: participants'
    own d′ may differ. Where all answers are right d′ is that of half an answer wrong, by the log-linear correction, and the
    interval has no upper end.

    Args:
        share_right: of right answers.
        share: that d′ is of.
        left_out: the same without each participant, shape (n,).
        variance: of the share by the trials alone.
        trials: shape (n,).
        share_of: d′ → share.
        p: of no sensitivity.

    Source: Wilson, Journal of the American Statistical Association 22, 209 (1927).
    """
    from scipy import stats

    n = len(trials)
    quantile = stats.t.ppf(0.975, n - 1) if n > 1 else stats.norm.ppf(0.975)
    varied = n > 1 and 0 < share_right < 1  # else what the jackknife sees is the correction alone
    jackknife = (n - 1) / n * ((left_out - share) ** 2).sum() if varied else 0.0
    centre = 1.0 if share_right == 1 else share
    variance = jackknife if jackknife > 1e-18 else variance
    effective = share * (1 - share) / variance if variance > 0 else trials.sum()
    middle = centre * effective + quantile**2 / 2
    half = quantile * np.sqrt(centre * (1 - centre) * effective + quantile**2 / 4)
    ends = (middle + np.array([-half, half])) / (effective + quantile**2)
    d_prime, low, high = (float(value) for value in d_prime_at(np.array([share, *ends]), share_of))
    return Sensitivity(share_right, float(share), d_prime, low, high, p, n, int(trials.sum()))
