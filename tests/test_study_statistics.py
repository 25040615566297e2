"""The statistics of ratings, against R and pingouin, and on studies whose answer is known.

R 4.2.2, on `data(n, a, b)` as a matrix Y with a row for each participant and columns of methods within textures:

    id <- expand.grid(m = factor(1:a), t = factor(1:b)); f <- lm(Y ~ 1); f0 <- update(f, ~ 0)
    anova(f, f0, M = ~ m + t, X = ~ t, idata = id, test = "Spherical")   # of m: F, p, and p by Greenhouse and Geisser
    mauchly.test(f, M = ~ m + t, X = ~ t, idata = id)
    friedman.test(Y); wilcox.test(Y[, 1], Y[, 2], paired = TRUE); t.test(Y[, 1], Y[, 2], paired = TRUE)

pingouin 0.7.0, on the same in long form: `rm_anova(table, "y", ["m", "t"], "s", detailed=True, effsize="ng2")` for ε and
generalised η² (`effsize="np2"` for partial η²), and `intraclass_corr(table, "t", "r", "y")`. Both give the same F and p.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy import stats

import foten_study.statistics as statistics
from foten.dsp.inference import holm
from foten_study.statistics import Array, anova, friedman, paired_tests, wilcoxon_tests
from foten_study.variance import PAPER_PARTICIPANTS, Raters, needed, paper_raters, power, raters_for


def data(n: int, a: int, b: int) -> Array:
    """Numbers that R makes too."""
    i, j, k = np.indices((n, a, b))
    y = 50 + 9 * np.sin(3.1 * i + 1) + 4 * j * (1 + np.sin(i)) / 2 + 2 * np.sin(2.3 * k)
    y = y + 6 * np.sin(12.9898 * i + 78.233 * j + 37.719 * k + 1.3 * j * k) + 3 * np.sin(5.5 * i * (k + 1))
    return y


# Shape, and of each effect: F, ε, p, p corrected, generalised η², partial η², Mauchly's p (R's).
ANOVAS = {
    (8, 3, 1): [(11.26177397, 0.7501247118, 0.001215865506, 0.003802212978, 0.1737960317, 0.6166856511, 0.2965919585)],
    (12, 4, 1): [(3.09243417, 0.5444258504, 0.04028734589, 0.07846467697, 0.06580735193, 0.2194393199, 0.03069018931)],
    (5, 2, 2): [
        (7.244804224, 1.0, 0.05456642268, 0.05456642268, 0.0961507377, 0.6442801564, 1.0),
        (1.235226231, 1.0, 0.3286914362, 0.3286914362, 0.01495990505, 0.2359451486, 1.0),
        (1.455409347, 1.0, 0.2941327076, 0.2941327076, 0.005542455177, 0.2667827939, 1.0),
    ],
    (21, 4, 12): [
        (12.87054193, 0.4358829373, 1.348910066e-06, 0.0005957232391, 0.06858760391, 0.3915524714, np.nan),
        (8.466450817, 0.3581129998, 2.113470151e-12, 1.089142759e-05, 0.04367472565, 0.2974185602, np.nan),
        (1.053984833, 0.05914100026, 0.3875004897, 0.3568151010, 0.009619839347, 0.05006106166, np.nan),
    ],
    (9, 4, 3): [
        (4.4871669, 0.4810120491, 0.01229691649, 0.04569947799, 0.05279152506, 0.35934227, 2.855419332e-05),
        (4.793228739, 0.9065029356, 0.02338183416, 0.02783287253, 0.03073354425, 0.374669197, 0.683180772),
        (4.145799052, 0.2751596668, 0.001962531025, 0.0462011155, 0.04965442459, 0.3413360483, np.nan),
    ],
}


@pytest.mark.parametrize("shape", ANOVAS, ids=str)
def test_an_analysis_of_variance_is_that_of_r_and_pingouin(shape: tuple[int, int, int]) -> None:
    n, a, b = shape
    effects = anova(data(*shape))
    degrees = [(a - 1, (a - 1) * (n - 1)), (b - 1, (b - 1) * (n - 1)), ((a - 1) * (b - 1), (a - 1) * (b - 1) * (n - 1))]
    assert len(effects) == len(ANOVAS[shape])
    for effect, expected, df in zip(effects, ANOVAS[shape], degrees, strict=False):
        assert effect["df"] == df
        values = (
            effect["f"],
            effect["epsilon"],
            effect["p"],
            effect["p_corrected"],
            effect["generalised_eta2"],
            effect["partial_eta2"],
        )
        # Both print ten digits; R's and this sine differ in the last bits of a large argument.
        np.testing.assert_allclose(np.array(values, dtype=float), expected[:6], rtol=2e-7)
        # With two contrasts the second term is none; else R's differs, as `_mauchly` says.
        if not np.isnan(expected[6]):
            np.testing.assert_allclose(float(effect["mauchly_p"]), expected[6], rtol=1e-6 if df[0] <= 2 else 0.05)


def test_many_studies_at_once_are_those_one_by_one() -> None:
    studies = np.stack([data(9, 4, 3), data(9, 4, 3)[::-1] ** 1.1, data(9, 4, 3) * 2])
    at_once = anova(studies)
    for i, study in enumerate(studies):
        for one, many in zip(anova(study), at_once, strict=True):
            np.testing.assert_allclose(many["f"][i], one["f"], rtol=1e-10)
            np.testing.assert_allclose(many["p_corrected"][i], one["p_corrected"], rtol=1e-8)


def test_what_cannot_be_computed_is_nan() -> None:
    same = np.full((5, 3), 7.0)
    (effect,) = anova(same[..., None])
    assert np.isnan([effect["f"], effect["p"], friedman(same)["p"], friedman(same)["chi2"]]).all()
    assert wilcoxon_tests(same)["p"].tolist() == [1.0, 1.0, 1.0]


def test_adjusted_p_values_are_those_of_statsmodels(monkeypatch: pytest.MonkeyPatch) -> None:
    statsmodels = pytest.importorskip("statsmodels.stats.multitest")
    monkeypatch.setattr("gc.collect", lambda *_: 0)  # which theirs does at each call
    rng = np.random.default_rng(0)
    for m in (1, 3, 6, 12):
        p = rng.uniform(0, 0.2, (20, m))
        expected = [statsmodels.multipletests(row, method="holm")[1] for row in p]
        np.testing.assert_allclose(holm(p), expected, rtol=1e-12)
    # p.adjust(c(0.01, 0.04, 0.03, 0.005, 0.5, 0.02), "holm") of R
    np.testing.assert_allclose(
        holm(np.array([0.01, 0.04, 0.03, 0.005, 0.5, 0.02])), [0.05, 0.09, 0.09, 0.03, 0.5, 0.08]
    )


def test_pairs_by_t_and_by_ranks_are_those_of_r() -> None:
    y = data(12, 4, 1)[..., 0]
    paired, signed = paired_tests(y), wilcoxon_tests(y)
    assert paired["pairs"] == signed["pairs"] == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    t = [0.05051914788, -4.083607779, -1.668819601, -2.056132934, -3.168701084, 0.2705381283]
    p = [0.9606143754, 0.001809073399, 0.1233347927, 0.06429260695, 0.008939276629, 0.7917551144]
    low = [-5.0807572, -6.9123312, -9.0453476, -9.546546, -6.8124437, -4.2155069]
    high = [5.3194733, -2.0706689, 1.2438929, 0.32482971, -1.2277273, 5.3970523]
    by_ranks = [1.0, 0.00048828125, 0.1098632813, 0.05224609375, 0.00927734375, 0.791015625]
    for values, expected in (
        (paired["t"], t),
        (paired["p"], p),
        (paired["ci95_low"], low),
        (paired["ci95_high"], high),
        (signed["p"], by_ranks),
    ):
        np.testing.assert_allclose(values, expected, rtol=1e-6)
    d = y[:, 0] - y[:, 2]
    assert paired["dz"][1] == pytest.approx(d.mean() / d.std(ddof=1))
    assert signed["rank_biserial"][1] == pytest.approx(-1.0)  # all of them lower
    assert statistics.pairs(4, reference=3) == [(3, 0), (3, 1), (3, 2)]
    against = paired_tests(y, reference=3)
    np.testing.assert_allclose(against["t"], [-t[2], -t[4], -t[5]], rtol=1e-6)
    np.testing.assert_allclose(against["p_bonferroni"], np.minimum(1, 3 * against["p"]))


def test_equal_differences_share_their_ranks() -> None:
    """By hand: of 1, 2, 2, 2, 3, 5, 5 the ranks are 1, 3, 3, 3, 5, 6.5, 6.5, and a zero is left out. p is the share of the 2⁷
    signs whose rank sum lies as far from its mean; of many, the normal one with variance n(n + 1)(2n + 1)/24 − Σ(t³ − t)/48.
    """
    d, ranks = np.array([1.0, -2, 2, 2, 0, 3, 5, -5]), np.array([1, 3, 3, 3, 5, 6.5, 6.5])
    test = wilcoxon_tests(np.column_stack([d, np.zeros(8)]))
    assert test["w"][0] == 3 + 6.5
    assert test["rank_biserial"][0] == pytest.approx((28 - 2 * 9.5) / 28)
    sums = np.array(list(product((0, 1), repeat=7))) @ ranks
    assert test["p"][0] == pytest.approx(np.mean(np.abs(sums - 14) >= 4.5))
    many = np.repeat(d, 9)  # 63 differences: 9 of 1, 27 of 2, 9 of 3, 18 of 5
    ranks_of = {1: 5, 2: 23, 3: 41, 5: 54.5}
    down = 9 * ranks_of[2] + 9 * ranks_of[5]
    variance = 63 * 64 * 127 / 24 - sum(t**3 - t for t in (9, 27, 9, 18)) / 48
    test = wilcoxon_tests(np.column_stack([many, np.zeros(72)]))
    assert test["w"][0] == down
    assert test["p"][0] == pytest.approx(2 * stats.norm.sf((63 * 64 / 4 - down) / np.sqrt(variance)), rel=1e-9)


def test_friedman_is_that_of_r() -> None:
    for shape, chi2, p in (((8, 3, 1), 9.75, 0.007635094219), ((12, 4, 1), 11.5, 0.009307797106)):
        test = friedman(data(*shape)[..., 0])
        assert test["chi2"] == pytest.approx(chi2, rel=1e-9)
        assert test["p"] == pytest.approx(p, rel=1e-9)
    ties = np.array([[1, 1, 2], [2, 3, 3], [1, 2, 2], [5, 5, 6]])  # friedman.test: chi-squared = 6
    assert friedman(ties)["chi2"] == pytest.approx(6.0, rel=1e-9)


def test_reliability_is_that_of_pingouin() -> None:
    single, mean, _ = statistics.reliability(data(8, 3, 1)[..., 0])
    assert single == pytest.approx(0.201007, abs=1e-6)
    assert mean == pytest.approx(0.668061, abs=1e-6)
    opposite = np.tile(np.array([10.0, 40.0, 90.0, 20.0]), (6, 1))
    opposite[2] = 100 - opposite[2]
    assert statistics.reliability(opposite)[2][2] == pytest.approx(-1.0)


def test_a_mixed_model_of_complete_ratings_is_the_analysis_of_variance() -> None:
    """Where every variance is positive; REML stops within a thousandth."""
    raters = Raters(
        np.full((3, 5), 50.0) + np.array([0, 4, 7])[:, None], correlation=0.4, by_method=0.3, by_texture=0.3
    )
    y = raters.draw(np.random.default_rng(3), 15)
    participant, method, texture = (index.ravel() for index in np.indices(y.shape))
    model = statistics.mixed_model(participant, method, texture, y.ravel())
    assert model["converged"]
    for term, effect in zip(model["terms"], anova(y), strict=True):
        assert (term["name"], tuple(term["df"])) == (effect["name"], effect["df"])
        assert term["f"] == pytest.approx(float(effect["f"]), rel=5e-3)
        assert term["p"] == pytest.approx(float(effect["p"]), rel=0.05, abs=1e-6)


def test_a_mixed_model_takes_ratings_that_are_not_complete() -> None:
    y = raters_for(3, 4, difference=15.0).draw(np.random.default_rng(4), 14)
    rated = np.random.default_rng(5).random(y.shape) < 0.8
    participant, method, texture = (axis[rated] for axis in np.indices(y.shape))
    model = statistics.mixed_model(participant, method, texture, y[rated])
    assert model["terms"][0]["name"] == "method"
    assert model["terms"][0]["p"] < 1e-4 < 1e-3 < model["terms"][1]["p"]


def test_raters_are_as_their_model_says() -> None:
    raters = Raters(np.full((4, 6), 50.0), sd=8.0, correlation=0.35, by_method=0.2, by_texture=0.1)
    y = raters.draw(np.random.default_rng(0), 4000)
    flat = y.reshape(4000, -1)
    assert flat.std(0).mean() == pytest.approx(8.0, rel=0.02)
    r = np.corrcoef(y[:, 0, 0], y[:, 1, 1])[0, 1]
    assert r == pytest.approx(0.35, abs=0.05)
    assert (y[:, 0, 2] - y[:, 3, 2]).std() == pytest.approx(raters.sd_of_difference, rel=0.04)


def test_power_is_that_of_the_noncentral_t() -> None:
    """Of two methods on one texture, where nothing is adjusted and nothing is cut."""
    raters = raters_for(2, 1, difference=6.0, sd=9.0, correlation=0.4)
    for n in (8, 21):
        delta = 6.0 / raters.sd_of_difference * np.sqrt(n)
        critical = stats.t.ppf(0.975, n - 1)
        exact = stats.nct.sf(critical, n - 1, delta) + stats.nct.cdf(-critical, n - 1, delta)
        found = power(raters, n, 4000, 0)
        assert found["pair"] == pytest.approx(exact, abs=0.025)  # three standard errors
        assert found["method"] == pytest.approx(found["pair"], abs=1e-9)


def test_power_for_the_effects_of_the_paper() -> None:
    """With its 21 participants all three effects are found; with fewer, fewer pairs."""
    raters = paper_raters()
    assert raters.means[-1].mean() == pytest.approx(80.14)
    found = power(raters, PAPER_PARTICIPANTS, 300, 0)
    assert min(found[name] for name in ("method", "texture", "method × texture")) > 0.95
    rows, smallest = needed(raters_for(4, 12, 8.75), 200, 0)
    assert rows[0]["pair"] < rows[-1]["pair"]
    assert smallest is not None
    assert 12 < smallest < 40


def test_error_rates_of_null_studies() -> None:
    """2,000 studies of 21 × 4 × 12 in which nothing differs, at α = 0.05: at most 6 % for every test, which is two standard
    errors above 5 %. Greenhouse and Geisser's correction of the interaction is conservative: there are 33 contrasts of 21
    participants.
    """
    null = Raters(np.full((4, 12), 60.0))
    y = null.draw(np.random.default_rng(1), 21, 2000)
    rates = {effect["name"]: float((effect["p_corrected"] < 0.05).mean()) for effect in anova(y)}
    rates["one way"] = float((anova(y.mean(-1, keepdims=True))[0]["p_corrected"] < 0.05).mean())
    by_texture = paired_tests(np.moveaxis(y, -1, -3))
    rates["pairs, not adjusted"] = float((by_texture["p"] < 0.05).mean())
    for name in ("p_holm", "p_bonferroni"):
        rates[name] = float((by_texture[name] < 0.05).any(-1).mean())
    rates["Friedman"] = float((friedman(y.mean(-1))["p"] < 0.05).mean())
    rates["Wilcoxon, Holm"] = float(np.mean([(wilcoxon_tests(one.mean(-1))["p_holm"] < 0.05).any() for one in y[:500]]))
    assert max(rates.values()) <= 0.06, rates
    assert rates["method × texture"] < 0.02
    assert min(rates[name] for name in ("one way", "method", "pairs, not adjusted", "Friedman")) > 0.03


@pytest.mark.slow
def test_error_rates_of_the_mixed_model() -> None:
    """As above; 2,000 fits take some five minutes."""
    null = Raters(np.full((4, 12), 60.0))
    y = null.draw(np.random.default_rng(2), 21, 2000)
    index = [axis.ravel() for axis in np.indices(y.shape[1:])]
    found = np.array([[term["p"] < 0.05 for term in statistics.mixed_model(*index, one.ravel())["terms"]] for one in y])
    rates = found.mean(0)
    print(dict(zip(("method", "texture", "method × texture"), rates, strict=True)))
    assert rates.max() <= 0.06
