"""Adaptive measurements find what simulated people hold, faster than chance would."""

import numpy as np
import pytest

from foten_study.adaptive import Comparison, Detection, LevelSearch, PreferenceSearch

WRONG = 0.1  # share of answers that are drawn


def test_a_threshold_is_found_though_some_answers_are_drawn() -> None:
    rng, errors, said = np.random.default_rng(0), [], []
    for _ in range(20):
        threshold = rng.uniform(-40, 0)
        search = LevelSearch(-60.0, 20.0, expected=(-20.0, 15.0))
        for _ in range(20):
            level = search.stimulus()
            right = rng.random() < float(Detection()(level, np.array(threshold), np.array(0.2), np.array(0.0)))
            search.answer(level, bool(rng.random() < 1 / 3 if rng.random() < WRONG else right))
        errors.append(search.point - threshold)
        said.append(search.sd)
    assert abs(np.mean(errors)) < 2.5
    assert np.median(np.abs(errors)) < 3
    assert 0.4 < np.mean(said) / np.sqrt(np.mean(np.square(errors))) < 2  # it says how well it knows


def test_what_tells_most_is_near_the_threshold() -> None:
    assert LevelSearch(-60.5, 20.0)._point.max() == 19.5
    before = LevelSearch(-60.0, 20.0, expected=(-20.0, 6.0))
    assert (before.point, before.sd) == pytest.approx((-20.0, 6.0), abs=0.01)
    search = LevelSearch(-60.0, 20.0)
    for _ in range(30):
        level = search.stimulus()
        search.answer(level, level > -20)
    assert search.point == pytest.approx(-20, abs=3)
    assert abs(search.stimulus() + 20) < 10
    assert search.n_answers == 30


def test_a_point_of_equal_strength_is_found() -> None:
    rng, errors = np.random.default_rng(2), []
    for _ in range(30):
        point, search = rng.normal(-20, 6), LevelSearch(-60.0, 0.0, Comparison(), (-20.0, 6.0))
        for _ in range(12):
            level = search.stimulus()
            stronger = rng.random() < float(Comparison()(level, np.array(point), np.array(0.5), np.array(0.0)))
            search.answer(level, bool(rng.random() < 0.5 if rng.random() < WRONG else stronger))
        errors.append(search.point - point)
    assert abs(np.mean(errors)) < 1.5
    assert np.median(np.abs(errors)) < 2


def test_psychometric_functions_are_what_they_say() -> None:
    slope, lapse = np.array(0.2), np.array(0.0)
    assert float(Detection(0.5)(-300.0, np.array(0.0), slope, lapse)) == pytest.approx(0.5)
    assert float(Detection(0.5)(0.0, np.array(0.0), slope, lapse)) == pytest.approx(0.5 + 0.5 * (1 - np.exp(-1)))
    assert float(Comparison()(3.0, np.array(3.0), slope, np.array(0.1))) == pytest.approx(0.5)
    assert float(Comparison()(99.0, np.array(0.0), np.array(1.0), np.array(0.1))) == pytest.approx(0.95)


def choices(ideal: np.ndarray, n: int, seed: int, adaptive: bool) -> float:
    """Distance of what was found from an ideal point, in just noticeable differences."""
    rng, search = np.random.default_rng(seed), PreferenceSearch(len(ideal), seed=seed)
    for _ in range(n):
        first, second = search.pair() if adaptive else rng.uniform(-1, 1, (2, len(ideal)))
        nearer = np.linalg.norm(second - ideal) - np.linalg.norm(first - ideal)
        prefers = rng.random() < 1 / (1 + np.exp(-1.5 * nearer / 0.2))
        search.answer(first, second, bool(rng.random() < 0.5 if rng.random() < WRONG else prefers))
    return float(np.linalg.norm(search.point - ideal)) / 0.2


def test_a_preference_is_found_by_fewer_choices_than_at_random() -> None:
    ideals = np.random.default_rng(1).uniform(-0.8, 0.8, (6, 3))
    ours, drawn = ([choices(ideal, 15, i, adaptive) for i, ideal in enumerate(ideals)] for adaptive in (True, False))
    begun = np.linalg.norm(ideals, axis=1).mean() / 0.2
    assert np.mean(ours) < 0.5 * begun
    assert np.mean(ours) < 0.85 * np.mean(drawn)


def test_particles_that_are_drawn_anew_have_the_mean_and_spread_of_before() -> None:
    """Liu and West's shrinkage takes from the variance what its jitter adds: without it ten drawings leave 0.98¹⁰, 0.82."""
    search, rng = PreferenceSearch(2, seed=0), np.random.default_rng(0)
    search._points = rng.normal([0.2, -0.1], [0.1, 0.05], search._points.shape)
    mean, sd = search.point, search.sd
    for _ in range(10):
        search._draw_anew()
    # Of 4000 particles a drawing moves the deviation by 1/√8000, ten of them by 3.5 %, and the mean by a twentieth of it.
    np.testing.assert_allclose(search.sd, sd, rtol=3 * 0.035)
    np.testing.assert_allclose(search.point, mean, atol=3 * 0.05 * sd.max())


def test_the_same_seed_asks_the_same() -> None:
    first, second = (PreferenceSearch(3, seed=4).pair() for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="a range of 4 dB"):
        LevelSearch(0.0, 2.0)
    with pytest.raises(ValueError, match=r"guess is 0\.9"):
        Detection(0.9)
