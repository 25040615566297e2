import numpy as np
import pytest

from foten.dsp.kinematics import at_rate, speed_of, velocity
from foten.recording.preprocess import condition


def test_a_circle_has_one_speed() -> None:
    turn = 2 * np.pi * 2.0 * np.arange(2000) / 1000.0  # 2 Hz, radius 10 mm
    speed = speed_of(velocity(10.0 * np.stack([np.cos(turn), np.sin(turn)]), 1000.0))
    # Central differences scale a frequency by sin(ωh)/(ωh).
    step = 2 * np.pi * 2.0 / 1000.0
    np.testing.assert_allclose(speed[1:-1], 10 * 2 * np.pi * 2.0 * np.sin(step) / step, rtol=1e-9)


def test_where_the_pen_stands_or_has_no_history_speed_is_zero() -> None:
    np.testing.assert_array_equal(velocity(np.full((2, 10), 7.0), 100.0), 0.0)
    np.testing.assert_array_equal(velocity(np.ones((2, 1)), 100.0), np.zeros((2, 1)))
    assert velocity(np.ones((2, 0)), 100.0).shape == (2, 0)


@pytest.mark.parametrize("source_hz", [120.0, 1000.0, 10_000.0])
def test_a_still_pen_reads_no_speed_whatever_noise_its_position_has(source_hz: float) -> None:
    rng = np.random.default_rng(0)
    times_s = np.arange(round(4 * source_hz)) / source_hz
    positions = 0.02 * rng.standard_normal((2, times_s.size))
    at_model = np.stack([at_rate(axis, times_s, 1000.0, 3900) for axis in positions])
    speed, _ = condition(velocity(at_model, 1000.0), np.ones(3900), 1000.0, 20.0)
    # 0.02 mm over 60 Hz of noise, differentiated below 20 Hz, is 0.8 mm/s an axis; far below FADE_SPEED.
    assert speed[200:].mean() < 1.6


def test_a_dense_signal_is_averaged_over_each_period() -> None:
    times_s = np.arange(10_000) / 10_000.0
    noise = np.random.default_rng(1).standard_normal(10_000)
    found = at_rate(noise, times_s, 1000.0, 1000)
    # Ten neighbours averaged, the outermost by half: the deviation falls to about 1/√10.
    assert found[5:-5].std() == pytest.approx(10**-0.5, rel=0.1)
    np.testing.assert_allclose(at_rate(3 * times_s, times_s, 1000.0, 999)[1:], 3 * np.arange(1, 999) / 1000)


def test_a_dense_signal_stays_averaged_beside_a_hole_in_it() -> None:
    """Whether a signal is dense is the usual step's to say: one hole of 20 s makes their mean longer than a sample."""
    times_s = np.concatenate([np.arange(10_000), np.arange(10_000) + 210_000]) / 10_000.0
    noise = np.random.default_rng(1).standard_normal(times_s.size)
    assert at_rate(noise, times_s, 1000.0, 1000)[5:-5].std() == pytest.approx(10**-0.5, rel=0.1)


def test_the_ends_of_a_dense_signal_are_held() -> None:
    """Before its first sample and after its last, and in the periods that it covers by half."""
    times_s = 0.1 + np.arange(10_000) / 10_000.0
    np.testing.assert_allclose(at_rate(np.full(10_000, 3.0), times_s, 1000.0, 1500), 3.0, rtol=1e-9)  # of sums to 3


def test_a_line_is_interpolated_exactly_and_its_ends_are_held() -> None:
    times_s = np.arange(12) / 120.0 + 0.01
    found = at_rate(3.0 + 5.0 * times_s, times_s, 1000.0, 150)
    grid = np.clip(np.arange(150) / 1000.0, times_s[0], times_s[-1])
    np.testing.assert_allclose(found, 3.0 + 5.0 * grid, rtol=1e-12)  # rounding
