"""Estimators that shrink: against closed forms, and on chance alone."""

import numpy as np
import pytest

from foten.dsp.shrinkage import NEIGHBOURS, empirical_bayes, james_stein, regression_with_prior, wiener_gain


def test_of_a_value_chance_is_taken_off() -> None:
    """Known to within 0.2, 0.4 counts three quarters: 1 − (0.2/0.4)²."""
    taken = [james_stein(value, 0.2) for value in (0.4, -0.4, 0.15, 0.0)]
    assert taken == pytest.approx([0.3, -0.3, 0.0, 0.0])


def test_the_gain_of_values_in_noise_is_wieners() -> None:
    """τ²/(τ² + v) of τ = 4 and v = 1, to what a median of 21 squares leaves; of noise alone most is taken off."""
    rng = np.random.default_rng(1)
    noise = np.ones(400)
    gain = wiener_gain(rng.normal(0, np.sqrt(17), 400), noise)
    assert (gain[:NEIGHBOURS] == 1).all()
    assert gain[NEIGHBOURS:].mean() == pytest.approx(16 / 17, abs=0.03)
    assert wiener_gain(rng.standard_normal(400), noise)[NEIGHBOURS:].mean() < 0.3


def test_adjustments_are_taken_as_far_as_blocks_agree() -> None:
    """Of errors by chance, alike within a block, less than half is taken; of a term that all blocks show, nearly all."""
    taken, plain = list[np.ndarray](), list[np.ndarray]()
    for seed in range(8):
        rng = np.random.default_rng(seed)
        slopes = np.concatenate([np.ones((24, 40, 1)), rng.standard_normal((24, 40, 5))], axis=2)
        slopes[..., 1] += rng.standard_normal((24, 1))  # a block's speeds are alike
        chance = rng.standard_normal((24, 1)) * 0.5 + rng.standard_normal((24, 40)) * 2.0
        plain.append(np.linalg.lstsq(slopes.reshape(-1, 6), chance.ravel())[0][1:])
        taken.append(empirical_bayes(chance, slopes)[1:])
        found = empirical_bayes(chance + 1.5 * slopes[..., 1], slopes)
        assert found[1] == pytest.approx(1.5, abs=0.4)
    assert np.square(taken).sum() < 0.5 * np.square(plain).sum()


def test_a_law_and_a_recording_are_weighed_by_how_well_they_are_known() -> None:
    """The posterior mean of one slope, in closed form; independent noise, so that nothing is discounted."""
    rng = np.random.default_rng(3)
    logs, prior = rng.normal(0, 0.1, (400, 1)), np.array([[0.95, 0.28]])
    levels = 0.2 * logs[:, 0] + rng.normal(0, 0.5, 400)
    precision = np.square(logs - logs.mean()).sum() / 0.25
    own = float(np.linalg.lstsq(logs - logs.mean(), levels - levels.mean(), rcond=None)[0][0])
    expected = (precision * own + 0.95 / 0.28**2) / (precision + 1 / 0.28**2)
    slope = regression_with_prior(logs, levels, prior)[0]
    assert slope == pytest.approx(expected, abs=0.06)  # the noise is estimated
    assert abs(own - expected) > 0.1
