"""Statistics of choices: strengths of methods by paired comparisons, and how well two are told apart, by oddity and by ABX.

Participants are the unit. The choices of one participant are not independent, so intervals are over participants.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp.inference import student_quantile
from foten_study.statistics import Array, contrasts, pairs, t_tests

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
    tests: dict[str, Any]  # of differences of log-odds, as `statistics.paired_tests` has them
    overall: dict[str, Any]  # Hotelling's T² as `f` of two degrees `df`, and `p` by signs
    separated: bool  # half a win was added to each side of each compared pair
    n_participants: int  # with at least one choice


def bradley_terry(wins: Array, reference: int | None = None) -> Strengths:
    """Strengths by maximum likelihood of Bradley and Terry's model, of all pairs or of a reference with each other method.

    Intervals and t-tests, of n − 1 degrees, are by the delete-one-participant jackknife, with Newton's first step for each. They
    are NaN for fewer than three participants, where all chose alike, and where methods are not connected when one participant
    is left out. Where no chain of wins leads from some method to another half a win is added to each side of each compared pair,
    and counts in the variance as one more participant's.

    `p` of `overall` compares T², of participants' scores at equality, with that of all patterns of signs of their scores; beyond
    14 participants of random ones. It is exact where preferences are spread symmetrically about none, and cannot be below
    2^(1 − n). p of F is too small where scores have few values: of 21 participants with one trial of two methods it was below
    0.05 in 9 % of null studies. T² and p are NaN unless n is above both 2 and k − 1.

    Args:
        wins: how often participant i chose method a over b, shape (n, k, k); half a win each for a tie.

    Raises:
        ValueError: not such counts, nothing chosen, or methods that no chain of comparisons connects.

    Sources: Bradley & Terry, Biometrika 39, 324 (1952); Bell & McCaffrey, Survey Methodology 28, 169 (2002), for the jackknife.
    """
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
    half = student_quantile(n)
    family = pairs(k, reference)
    by_pair = np.array([space[a] - space[b] for a, b in family])
    difference = np.array([log_odds[a] - log_odds[b] for a, b in family])
    se, pair_se = _standard_errors(space, covariance), _standard_errors(by_pair, covariance)
    f, p = _no_preference(_scores(wins, np.zeros(k), space)[0])
    tests = {"pairs": family, "difference": difference, **t_tests(difference / pair_se, n - 1)}
    tests |= {"ci95_low": difference - half * pair_se, "ci95_high": difference + half * pair_se}
    overall = {"f": f, "df": (k - 1, n - k + 1), "p": p}
    return Strengths(log_odds, log_odds - half * se, log_odds + half * se, tests, overall, separated, n)


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

    2 ∫₀^∞ [Φ(−z√3 + d′√(2/3)) + Φ(−z√3 − d′√(2/3))] φ(z) dz, by Owen's T; Macmillan & Creelman, Detection Theory, 2005.
    """
    from scipy import special

    return np.asarray(1 - 4 * special.owens_t(np.asarray(d_prime) / np.sqrt(6), np.sqrt(3)))


def abx_share(d_prime: Array | float) -> Array:
    """Share of right answers of ABX without bias, by the differencing model; Macmillan & Creelman, Detection Theory, 2005."""
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
    """Sensitivity by the oddity task of three intervals, of each participant's right answers and trials, shapes (n,).

    p is the binomial mid-p of all trials. It holds whatever interval participants lean to if the odd one's is drawn anew for each
    trial; if the odd one is in each interval equally often p is too large for those who lean. ValueError for other than counts.
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
    """Sensitivity by ABX, of each participant's answers A and B where X was A, and where it was B, shapes (n, 2).

    The unbiased share is Φ((z(H) − z(F)) / 2), H the share of answers A where X was A and F where it was B, of all trials. Where
    either is 0 or 1 half an answer of each of the four kinds is added, the log-linear correction (Hautus, Behav. Res. Methods
    27, 46, 1995). Leanings that cancel in H and F lower this share; their variance over participants with at least two trials of
    each kind corrects it. p is a conditional mid-p: where nobody can tell, the number of answers A where X was A is, given a
    participant's trials and answers, hypergeometric, whatever the leaning. ValueError for other than counts.
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
    """Unbiased share of groups of participants, and the variance of the first one's by its trials alone.

    `members` (groups, n) is 1 for those in the group; right answers and trials, where X is A and where it is B, are (2, n).
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

    The interval is Wilson's (J. Am. Stat. Assoc. 22, 209, 1927) of the share, with as many trials as would give binomially the
    variance of the delete-one-participant jackknife (`left_out` has the share without each), and t of n − 1 degrees. Of a single
    participant, or where the jackknife finds none, the variance is that by the trials alone. d′ is thus of the mean share. Where
    all answers are right it is that of half an answer wrong, by the log-linear correction, and the interval has no upper end.
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
