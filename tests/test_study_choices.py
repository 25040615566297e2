"""The statistics of choices, against R, and on studies whose answer is known.

R 4.2.2 with psyphy 0.2.3 and BradleyTerry2 1.1.2. Of `wins(n, k)` the log-odds over the first method's, their standard errors
with one participant at a time left out by one step from the full fit, and F:

    wins <- function(n, k) { w <- array(0, c(n, k, k)); for (i in 1:n) for (a in 1:k) for (b in 1:k)
        if (a != b && a + b != n %% 7) w[i, a, b] <- (i^2 * (a + 2 * b) + 3 * a * b * i + 11 * a) %% 7 + a %/% 2; w }
    w <- wins(n, k); p <- t(combn(k, 2)); q <- p[, 2:1, drop = FALSE]
    up <- matrix(apply(w, 1, `[`, p), n, byrow = TRUE); all <- up + matrix(apply(w, 1, `[`, q), n, byrow = TRUE)
    f <- BTm(cbind(colSums(up), colSums(all - up)), factor(p[, 1], 1:k), factor(p[, 2], 1:k),
             subset = colSums(all) > 0, control = glm.control(1e-14, 100))
    x <- outer(p[, 1], 2:k, "==") - outer(p[, 2], 2:k, "=="); r <- plogis(x %*% coef(f)); v <- c(r * (1 - r))
    step <- sapply(1:n, function(i) solve(t(x) %*% (x * (colSums(all) - all[i, ]) * v), t(x) %*% (up[i, ] - all[i, ] * r)))
    coef(f); sqrt((n - 1) / n * rowSums(matrix(step, k - 1)^2))
    u <- (2 * up - all) %*% x; d <- k - 1; (n - d) / (d * (n - 1)) * mahalanobis(colMeans(u), 0, cov(u) / n)

d′ by psyphy's functions, which stop at 1e-4 by themselves, and p halfway between those of "greater" and of 1 − "less":

    sharp <- function(f) { environment(f) <- list2env(list(uniroot = function(...) stats::uniroot(..., tol = 1e-13),
        integrate = function(...) stats::integrate(..., rel.tol = 1e-12)), parent = asNamespace("psyphy")); f }
    mid <- function(test) (test("greater")$p.value + 1 - test("less")$p.value) / 2
    sharp(dprime.oddity)(right / n); mid(function(side) binom.test(right, n, 1 / 3, side)); sharp(dprime.ABX)(H, F)
    i <- 1:n; h <- 5 + (3 * i + s * i^2) %% 5; f <- 2 + (2 * i + s) %% 6
    x <- array(rbind(h, 9 + i %% 3 - h, f, 8 - f), c(2, 2, n))
    mid(function(side) mantelhaen.test(x, alternative = side, exact = TRUE))
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats
from scipy.special import expit, ndtr, ndtri

from foten_study import choice_statistics
from foten_study.choice_statistics import (
    Sensitivity,
    Strengths,
    abx,
    abx_share,
    bradley_terry,
    d_prime_at,
    oddity,
    oddity_share,
)
from foten_study.statistics import Array

SLOW = pytest.mark.slow
ALARMS = 0.0365, 0.0635  # shares of 1,000 null studies within two standard errors of 5 %
COVERED = 0.95 - 3 * np.sqrt(0.05 * 0.95 / 500)  # of 500 intervals at least, with three


def wins(n: int, k: int) -> Array:
    """Counts that R makes too; of 12 participants and 5 methods two pairs are not compared."""
    i, a, b = np.indices((n, k, k)) + 1
    w = (i**2 * (a + 2 * b) + 3 * a * b * i + 11 * a) % 7 + a // 2
    return np.where((a != b) & (a + b != n % 7), w, 0).astype(float)


# Participants and methods: log-odds over the first method's, their standard errors, F of no preference.
STRENGTHS = {
    (6, 3): ([0.547356311647, 0.0404929202641], [0.167397329116, 0.17895244947], 7.22857142857),
    (9, 2): ([0.602175402354], [0.196471420883], 9.75675675676),
    (8, 4): (
        [0.42988628823, 0.198235890267, 0.852773121627],
        [0.195001544702, 0.0784674652646, 0.148837925025],
        28.0068027211,
    ),
    (12, 5): (
        [0.411504969096, 0.189682373455, 0.765810613212, 0.767265787571],
        [0.120992108809, 0.116274043458, 0.168128227816, 0.0821548376595],
        20.815540997,
    ),
    (21, 4): ([0.419319550429, 0.226268570463, 0.803778102962], [0.12247244822, 0.049100638693, 0.090134608975], 114.9),
}


def test_shares_of_all_right_or_none_are_half_an_answer_from_the_end() -> None:
    for n_right, share in ((0.0, 0.1), (2.0, 0.5), (4.0, 0.9)):
        right, trials = np.full((2, 1), n_right), np.full((2, 1), 4.0)
        assert choice_statistics._unbiased_share(np.ones((1, 1)), right, trials)[0] == pytest.approx(share)


@pytest.mark.parametrize("shape", STRENGTHS, ids=str)
def test_strengths_are_those_of_r(shape: tuple[int, int]) -> None:
    n, k = shape
    expected, errors, f = STRENGTHS[shape]
    strengths = bradley_terry(wins(n, k), reference=0)
    assert not strengths.separated
    assert strengths.log_odds.sum() == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(strengths.log_odds[1:] - strengths.log_odds[0], expected, rtol=1e-9)
    np.testing.assert_allclose(strengths.tests["difference"], -np.array(expected), rtol=1e-9)
    np.testing.assert_allclose(strengths.tests["t"], -np.array(expected) / errors, rtol=1e-9)
    half = stats.t.ppf(0.975, n - 1) * np.array(errors)
    np.testing.assert_allclose(strengths.tests["ci95_high"] - strengths.tests["difference"], half, rtol=1e-9)
    assert strengths.overall["f"] == pytest.approx(f, rel=1e-9)
    assert strengths.overall["df"] == (k - 1, n - k + 1)
    every = bradley_terry(wins(n, k))
    assert len(every.tests["pairs"]) == k * (k - 1) / 2
    differences = [every.log_odds[a] - every.log_odds[b] for a, b in every.tests["pairs"]]
    np.testing.assert_allclose(every.tests["difference"], differences)
    np.testing.assert_allclose(every.tests["p"][: k - 1], strengths.tests["p"], rtol=1e-9)
    np.testing.assert_allclose(every.tests["p_bonferroni"], np.minimum(1, len(every.tests["p"]) * every.tests["p"]))


@pytest.mark.parametrize(
    ("right", "trials", "d_prime", "p"),
    [
        ([8, 9], [15, 15], 1.80712095098, 0.00484033779102),
        ([12, 4, 9], [24, 8, 16], 1.57435167921, 0.00398378030716),
        ([99], [100], 6.30946564605, 0.0),
        ([10, 9, 11, 10], [15, 15, 15, 15], 2.32137691668, 8.43318485044e-08),
        ([60, 50, 60], [160, 160, 160], 0.480737101625, 0.166649914127),
    ],
)
def test_sensitivity_by_oddity_is_that_of_r(right: list[int], trials: list[int], d_prime: float, p: float) -> None:
    found = oddity(np.array(right), np.array(trials))
    assert found.share == found.unbiased_share == sum(right) / sum(trials)
    assert found.d_prime == pytest.approx(d_prime, rel=1e-9)
    assert found.p == pytest.approx(p, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(
    ("hits", "false_alarms", "d_prime"),
    [
        ((9, 10), (4, 10), 2.20629226098),
        ((20, 24), (6, 20), 2.16318490919),
        ((30, 32), (15, 32), 2.2839997814),
        ((55, 60), (40, 61), 1.646183153),
        ((119, 120), (3, 120), 5.33759598401),
    ],
)
def test_sensitivity_by_abx_is_that_of_r(hits: tuple[int, int], false_alarms: tuple[int, int], d_prime: float) -> None:
    (h, n_a), (f, n_b) = hits, false_alarms
    assert abx(np.array([[h, n_a - h]]), np.array([[f, n_b - f]])).d_prime == pytest.approx(d_prime, rel=1e-9)


@pytest.mark.parametrize(
    ("n", "s", "p"),
    [
        (2, 0, 0.40014959031),
        (5, 1, 0.44995702472),
        (8, 2, 0.00746063608899),
        (12, 3, 0.514579549636),
        (21, 4, 0.015844819595),
    ],
)
def test_no_association_of_answers_is_tested_as_by_r(n: int, s: int, p: float) -> None:
    i = np.arange(1, n + 1)
    h, f = 5 + (3 * i + s * i**2) % 5, 2 + (2 * i + s) % 6
    assert abx(np.stack([h, 9 + i % 3 - h], 1), np.stack([f, 8 - f], 1)).p == pytest.approx(p, rel=1e-9)


def test_shares_are_those_of_differencing_choosers() -> None:
    """Of 400,000 trials each: three standard errors are 0.0024."""
    rng = np.random.default_rng(0)
    for d_prime in (0.0, 0.7, 1.6, 3.0):
        a, b, x = rng.standard_normal((3, 400_000))
        odd = x + d_prime
        right = np.abs(a - b) < np.minimum(np.abs(odd - a), np.abs(odd - b))
        assert oddity_share(d_prime) == pytest.approx(right.mean(), abs=0.0024)
        b = b + d_prime
        right = np.abs(x - a) < np.abs(x - b)
        assert abx_share(d_prime) == pytest.approx(right.mean(), abs=0.0024)


def test_d_prime_and_share_are_each_other_s_inverse() -> None:
    d_prime = np.array([0.01, 0.3, 1.0, 2.5, 6.0])
    for share_of, chance in ((oddity_share, 1 / 3), (abx_share, 1 / 2)):
        np.testing.assert_allclose(d_prime_at(share_of(d_prime), share_of), d_prime, rtol=1e-6)
        np.testing.assert_array_equal(d_prime_at(np.array([0.0, chance, 1.0]), share_of), [0, 0, np.inf])


def choosers(rng: np.random.Generator, log_odds: Array, n: int, trials: int, sd: float = 0.0) -> Array:
    """Wins of n participants, whose own log-odds have standard deviation sd, in each pair as many trials."""
    k = len(log_odds)
    private = log_odds + sd * rng.standard_normal((n, k))
    first, second = np.triu_indices(k, 1)
    won = rng.binomial(trials, expit(private[:, first] - private[:, second]))
    w = np.zeros((n, k, k))
    w[:, first, second], w[:, second, first] = won, trials - won
    return w


def marginal(log_odds: Array, sd: float) -> Array:
    """Log-odds that choices of very many such participants have."""
    everybody = choosers(np.random.default_rng(0), log_odds, 100_000, 20, sd).sum(0, keepdims=True)
    return bradley_terry(everybody).log_odds


def odd_answers(rng: np.random.Generator, d_prime: Array, trials: int) -> tuple[Array, Array]:
    """Right answers and trials of participants of d_prime (n,)."""
    return rng.binomial(trials, oddity_share(d_prime)), np.full(len(d_prime), trials)


def abx_answers(rng: np.random.Generator, d_prime: Array, leaning: Array, trials: int) -> tuple[Array, Array]:
    """Answers A and B where X is A and where it is B, trials of each; the leaning to A is in units of z."""
    z = ndtri(abx_share(d_prime))
    a_a, b_b = rng.binomial(trials, ndtr(z + leaning)), rng.binomial(trials, ndtr(z - leaning))
    return np.stack([a_a, trials - a_a], 1), np.stack([trials - b_b, b_b], 1)


def coverage_of_strengths(sd: float, n: int, trials: int, studies: int) -> float:
    rng, log_odds = np.random.default_rng(1), np.array([-0.8, -0.3, 0.1, 1.0])
    truth = marginal(log_odds, sd)
    covered = []
    for _ in range(studies):
        found = bradley_terry(choosers(rng, log_odds, n, trials, sd))
        d = np.array([truth[a] - truth[b] for a, b in found.tests["pairs"]])
        covered.append(np.mean((found.tests["ci95_low"] <= d) & (d <= found.tests["ci95_high"])))
    return float(np.mean(covered))


def coverage_of_d_prime(d_prime: float, sd: float, n: int, trials: int, leaning: float, studies: int) -> list[float]:
    """Shares of intervals, by oddity and by ABX of people who lean to A by N(leaning, 0.5), that hold the d′ of the mean share of
    very many participants, whose own are |N(d′, sd)|.
    """

    def by_oddity(rng: np.random.Generator, d: Array) -> Sensitivity:
        return oddity(*odd_answers(rng, d, trials))

    def by_abx(rng: np.random.Generator, d: Array) -> Sensitivity:
        return abx(*abx_answers(rng, d, leaning + 0.5 * rng.standard_normal(len(d)), trials // 2))

    shares = []
    for draw, share_of in ((by_oddity, oddity_share), (by_abx, abx_share)):
        rng = np.random.default_rng(2)
        everybody = np.abs(d_prime + sd * rng.standard_normal(200_000))
        truth = float(d_prime_at(share_of(everybody).mean(), share_of))
        found = [draw(rng, np.abs(d_prime + sd * rng.standard_normal(n))) for _ in range(studies)]
        shares.append(float(np.mean([study.ci95_low <= truth <= study.ci95_high for study in found])))
    return shares


@pytest.mark.parametrize("sd", [pytest.param(0.0, marks=SLOW), 1.0])
def test_intervals_of_strengths_hold_the_truth(sd: float) -> None:
    assert coverage_of_strengths(sd, 12, 3, 500) >= COVERED


@pytest.mark.parametrize(
    ("d_prime", "sd"), [pytest.param(1.0, 0.0, marks=SLOW), (2.0, 0.8), pytest.param(4.5, 0.8, marks=SLOW)]
)
def test_intervals_of_d_prime_hold_the_truth(d_prime: float, sd: float) -> None:
    assert min(coverage_of_d_prime(d_prime, sd, 12, 12, 0.3, 500)) >= COVERED


@SLOW
def test_intervals_hold_the_truth_in_other_studies() -> None:
    """Of few participants too; printed with -s."""
    for n, trials in ((3, 4), (5, 1), (8, 2), (21, 1), (21, 6)):
        for sd in (0.0, 1.0):
            share = coverage_of_strengths(sd, n, trials, 1000)
            print("strengths", n, trials, sd, share)
            assert share >= COVERED
    for n, trials in ((3, 12), (6, 6), (12, 24), (21, 12)):
        for d_prime, sd in ((0.0, 0.0), (1.0, 0.7), (2.5, 1.0), (4.5, 0.0)):
            covered = coverage_of_d_prime(d_prime, sd, n, trials, 0.0, 1000)
            print("oddity, ABX", n, trials, d_prime, sd, covered)
            assert min(covered) >= COVERED


def check_alarms(p: Callable[[np.random.Generator], float], studies: int = 1000) -> None:
    """Check the share of null studies whose p is 0.05 or less; printed with -s."""
    rng = np.random.default_rng(3)
    rate = float(np.mean([p(rng) <= 0.05 for _ in range(studies)]))
    print("false alarms", rate)
    assert ALARMS[0] <= rate <= ALARMS[1], rate


@pytest.mark.parametrize("sd", [0.0, 2.0], ids=["by a coin", "private preferences"])
def test_false_alarms_of_a_preference(sd: float) -> None:
    check_alarms(lambda rng: bradley_terry(choosers(rng, np.zeros(4), 12, 3, sd)).overall["p"])


@pytest.mark.parametrize("leaning", [pytest.param(1 / 3, marks=SLOW), 0.6, pytest.param(0.9, marks=SLOW)])
def test_false_alarms_of_oddity(leaning: float) -> None:
    """Of answerers who take the first interval with this probability, whichever is the odd one."""
    share = np.array([leaning, (1 - leaning) / 2, (1 - leaning) / 2])

    def p(rng: np.random.Generator) -> float:
        odd = rng.integers(0, 3, (21, 12))
        return oddity((odd == rng.choice(3, odd.shape, p=share)).sum(1), np.full(21, 12)).p

    check_alarms(p)


@pytest.mark.parametrize(
    ("leaning", "sd"), [(0.5, 1.0), *(pytest.param(*some, marks=SLOW) for some in ((0.0, 0.0), (1.0, 0.0), (0.0, 2.0)))]
)
def test_false_alarms_of_abx(leaning: float, sd: float) -> None:
    """Of answerers who lean to A, all of them, or each to A or to B."""
    check_alarms(lambda rng: abx(*abx_answers(rng, np.zeros(21), leaning + sd * rng.standard_normal(21), 6)).p)


@SLOW
def test_false_alarms_in_other_studies() -> None:
    """At most 6.35 % of studies, for pairs after Holm's correction too; printed with -s."""
    for k, n, trials, sd in ((2, 21, 1, 0), (2, 12, 4, 2), (3, 8, 1, 0), (3, 21, 4, 2), (4, 8, 4, 0), (4, 21, 1, 2)):
        rng, found = np.random.default_rng(4), []
        for _ in range(1000):
            study = bradley_terry(choosers(rng, np.zeros(k), n, trials, sd))
            found.append((study.overall["p"] <= 0.05, (study.tests["p_holm"] <= 0.05).any()))
        rates = np.mean(found, axis=0)
        print("strengths, pairs", k, n, trials, sd, rates)
        assert rates.max() <= ALARMS[1]


def test_signs_hold_where_f_does_not() -> None:
    """21 participants choose once between two methods by a coin: exact rates, over all 22 outcomes."""
    by_f = by_signs = 0.0
    for first in range(22):
        w = np.zeros((21, 2, 2))
        w[:first, 0, 1], w[first:, 1, 0] = 1, 1
        found = bradley_terry(w)
        weight = float(stats.binom.pmf(first, 21, 0.5))
        by_f += weight * (first in (0, 21) or stats.f.sf(found.overall["f"], *found.overall["df"]) <= 0.05)
        by_signs += weight * (found.overall["p"] <= 0.05)
    assert by_f == pytest.approx(0.0784, abs=1e-4)
    assert by_signs == pytest.approx(0.0266, abs=1e-4)  # of the sign test


def test_signs_of_few_participants_and_of_many() -> None:
    """Of two methods p is the sign test's. Beyond 14 participants patterns are drawn, and p is about that of F."""
    w = np.zeros((8, 2, 2))
    w[:7, 0, 1], w[7, 1, 0] = 1, 1
    assert bradley_terry(w).overall["p"] == pytest.approx(2 * 9 / 2**8)
    w = choosers(np.random.default_rng(5), np.array([0.0, 0.2, 0.5]), 15, 4)
    f = bradley_terry(w)
    assert f.overall["p"] == pytest.approx(float(stats.f.sf(f.overall["f"], *f.overall["df"])), rel=0.3)


def test_leaning_leaves_d_prime() -> None:
    """Of 24,000 trials of each kind by 40 participants, all leaning to A, or half of them to A and half to B."""
    trials, d_prime = 600, 2.0
    z = ndtri(abx_share(d_prime))
    for leaning, tolerance in (([0.0, 0.0], 3e-3), ([0.8, 0.8], 3e-3), ([0.4, -0.4], 0.01), ([0.9, 0.1], 0.01)):
        a_a, b_b = (np.round(trials * ndtr(z + sign * np.repeat(leaning, 20))) for sign in (1, -1))
        found = abx(np.stack([a_a, trials - a_a], 1), np.stack([trials - b_b, b_b], 1))
        assert found.d_prime == pytest.approx(d_prime, rel=tolerance)


def is_unknown(strengths: Strengths) -> bool:
    values = (
        strengths.ci95_low,
        strengths.ci95_high,
        strengths.tests["ci95_low"],
        strengths.tests["t"],
        strengths.tests["p_holm"],
    )
    return bool(np.isnan(np.concatenate(values)).all())


def test_strengths_of_few_participants() -> None:
    alone = bradley_terry(wins(12, 4)[:1])
    total = wins(12, 4)[0]
    assert np.isfinite(alone.log_odds).all()
    won, expected = total.sum(1), (total + total.T) * expit(alone.log_odds[:, None] - alone.log_odds)
    np.testing.assert_allclose(won, expected.sum(1), rtol=1e-9)  # the likelihood's maximum
    assert is_unknown(alone)
    assert np.isnan([alone.overall["f"], alone.overall["p"]]).all()
    assert is_unknown(bradley_terry(wins(12, 4)[:2]))
    three = bradley_terry(wins(12, 4)[:3])
    assert not is_unknown(three)
    assert np.isnan([three.overall["f"], three.overall["p"]]).all()  # as many as there are differences
    idle = np.concatenate([wins(8, 4), np.zeros((5, 4, 4))])
    assert bradley_terry(idle).n_participants == 8
    np.testing.assert_array_equal(bradley_terry(idle).tests["p"], bradley_terry(wins(8, 4)).tests["p"])


def test_participants_who_choose_alike_have_no_interval() -> None:
    alike = np.repeat(wins(8, 4)[:1], 6, axis=0)
    found = bradley_terry(alike)
    assert is_unknown(found)
    assert np.isnan(found.overall["f"])
    assert found.overall["p"] == 2 / 2**6


def test_separated_choices() -> None:
    """Ten choose the first method, always: at ten and a half wins to a half. p is above the sign test's 0.002."""
    w = np.zeros((10, 2, 2))
    w[:, 0, 1] = 1
    found = bradley_terry(w)
    assert found.separated
    assert found.tests["difference"][0] == pytest.approx(np.log(10.5 / 0.5))
    assert 0.002 < found.tests["p"][0] < 0.05
    assert found.overall["p"] == pytest.approx(2 / 2**10)
    w = wins(8, 4)
    w[:, :3, 3] = 0  # nobody prefers another to the last
    found = bradley_terry(w)
    assert found.separated
    assert found.log_odds.argmax() == 3
    assert np.isfinite(found.tests["ci95_high"]).all()


def test_a_pair_that_is_not_compared_is_known_by_the_others() -> None:
    w = np.zeros((6, 3, 3))
    w[:, 0, 1], w[:, 1, 0] = [3, 2, 3, 3, 2, 3], [1, 2, 1, 1, 2, 1]
    w[:, 1, 2], w[:, 2, 1] = [2, 3, 3, 2, 3, 3], [2, 1, 1, 2, 1, 1]
    found = bradley_terry(w)
    assert found.tests["difference"][1] == pytest.approx(np.log(16 / 8) + np.log(16 / 8))
    w[:, 1, 2] = w[:, 2, 1] = 0
    with pytest.raises(ValueError, match="methods 0 and 2 are compared by no chain of pairs"):
        bradley_terry(w)
    w[0, 1, 2] = w[0, 2, 1] = 2  # one participant alone
    found = bradley_terry(w)
    assert found.tests["difference"][2] == pytest.approx(0, abs=1e-9)
    assert is_unknown(found)


def test_all_right_and_none_right() -> None:
    every = oddity(np.array([10]), np.array([10]))
    assert every.share == 1
    assert every.d_prime == pytest.approx(float(d_prime_at(10.5 / 11, oddity_share)))
    assert every.ci95_low < every.d_prime < every.ci95_high == np.inf
    assert every.p == pytest.approx(3.0**-10 / 2)
    assert oddity(np.array([5, 3, 0]), np.array([9, 9, 0])) == oddity(np.array([5, 3]), np.array([9, 9]))
    every = abx(np.array([[12, 0]] * 4), np.array([[0, 12]] * 4))
    assert every.share == 1
    assert 0 < every.ci95_low < every.d_prime < every.ci95_high == np.inf
    for none in (oddity(np.zeros(3), np.full(3, 8)), abx(np.array([[0, 8]] * 3), np.array([[8, 0]] * 3))):
        assert none.share == none.d_prime == none.ci95_low == 0
        assert none.ci95_high < 2
        assert none.p == pytest.approx(1, abs=1e-4)


def test_a_participant_alone_and_a_trial_alone() -> None:
    """The interval of one participant is Wilson's, as SciPy has it."""
    alone = oddity(np.array([7]), np.array([10]))
    ends = oddity_share(np.array([alone.ci95_low, alone.ci95_high]))
    wilson = stats.binomtest(7, 10).proportion_ci(method="wilson")
    np.testing.assert_allclose(ends, [wilson.low, wilson.high], rtol=1e-6)
    trial = oddity(np.array([1, 0]), np.array([1, 0]))
    assert (trial.n_participants, trial.n_trials, trial.ci95_low, trial.ci95_high) == (1, 1, 0, np.inf)
    assert trial.p == pytest.approx(1 / 6)
    trials = abx(np.array([[1, 0]]), np.array([[0, 1]]))
    assert trials.ci95_low == 0
    assert trials.p == pytest.approx(1 / 4)
    always_a = abx(np.array([[9, 0], [7, 0]]), np.array([[9, 0], [7, 0]]))
    assert (always_a.share, always_a.p) == (0.5, 0.5)
    assert always_a.d_prime < 1e-6


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: bradley_terry(np.ones((3, 2))), r"wins are of shape \(3, 2\), expected \(participants, methods,"),
        (lambda: bradley_terry(-wins(6, 3)), "wins hold a negative or missing number"),
        (lambda: bradley_terry(np.ones((3, 2, 2))), "a method is chosen over itself"),
        (lambda: bradley_terry(np.zeros((3, 2, 2))), "nobody has chosen"),
        (lambda: bradley_terry(wins(6, 3), reference=3), r"the reference is method 3, expected one of 0 … 2"),
        (lambda: oddity(np.ones((2, 2)), np.ones(2)), r"right answers are of shape \(2, 2\), expected \(partic"),
        (lambda: oddity(np.ones(2), np.ones(3)), "there are 2 numbers of right answers and 3 of trials"),
        (lambda: oddity(np.array([1, 3]), np.array([2, 2])), "participant 1 has 3 right answers of 2 trials"),
        (lambda: oddity(np.array([-1.0]), np.ones(1)), "right answers hold a negative"),
        (lambda: oddity(np.zeros(2), np.zeros(2)), "there is no trial"),
        (lambda: abx(np.ones((2, 3)), np.ones((2, 2))), r"where X is A are of shape \(2, 3\), expected \(partic"),
        (lambda: abx(np.ones((2, 2)), np.ones((3, 2))), "answers are of 2 participants where X is A, of 3"),
        (lambda: abx(np.full((2, 2), 0.5), np.ones((2, 2))), "where X is A hold a negative, broken or missing number"),
        (lambda: abx(np.ones((2, 2)), np.zeros((2, 2))), "there is no trial where X is B"),
    ],
)
def test_what_is_not_a_table_of_counts_is_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
