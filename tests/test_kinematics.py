import numpy as np
import pytest

from foten.dsp.kinematics import at_rate, tangential_speed


def test_a_circle_has_one_speed() -> None:
    times_s = np.arange(240) / 120.0
    turn = 2 * np.pi * 2.0 * times_s  # 2 Hz, radius 10 mm
    speed = tangential_speed(10.0 * np.stack([np.cos(turn), np.sin(turn)]), times_s)
    # Central differences scale a frequency by sin(ωh)/(ωh).
    step = 2 * np.pi * 2.0 / 120.0
    np.testing.assert_allclose(speed[1:-1], 10 * 2 * np.pi * 2.0 * np.sin(step) / step, rtol=1e-9)


def test_a_hand_at_5_hz_loses_less_than_two_percent() -> None:
    times_s = np.arange(480) / 120.0
    positions = 20.0 * np.sin(2 * np.pi * 5.0 * times_s)[None]
    peak = tangential_speed(positions, times_s)[1:-1].max()
    assert 0.98 < peak / (20.0 * 2 * np.pi * 5.0) <= 1.0


def test_uneven_times_keep_a_constant_acceleration_exact() -> None:
    rng = np.random.default_rng(0)
    times_s = np.cumsum(rng.uniform(0.004, 0.015, 100))
    speed = tangential_speed(np.stack([50.0 * times_s**2, 0 * times_s]), times_s)
    # Second order: a parabola is differentiated exactly inside, up to rounding of 1e-14 / 4 ms.
    np.testing.assert_allclose(speed[1:-1], 100.0 * times_s[1:-1], rtol=1e-9)


def test_the_axes_of_the_plane_add_as_a_vector() -> None:
    times_s = np.arange(50) / 120.0
    speed = tangential_speed(np.stack([30.0 * times_s, -40.0 * times_s]), times_s)
    np.testing.assert_allclose(speed, 50.0, rtol=1e-9)


def test_where_the_pen_stands_or_has_no_history_speed_is_zero() -> None:
    np.testing.assert_array_equal(tangential_speed(np.full((2, 10), 7.0), np.arange(10.0)), 0.0)
    np.testing.assert_array_equal(tangential_speed(np.ones((2, 1)), np.array([0.0])), [0.0])
    assert tangential_speed(np.ones((2, 0)), np.array([])).shape == (0,)


def test_a_line_is_interpolated_exactly_and_its_ends_are_held() -> None:
    times_s = np.arange(12) / 120.0 + 0.01
    found = at_rate(3.0 + 5.0 * times_s, times_s, 1000.0, 150)
    grid = np.clip(np.arange(150) / 1000.0, times_s[0], times_s[-1])
    np.testing.assert_allclose(found, 3.0 + 5.0 * grid, rtol=1e-12)  # rounding


def test_no_sample_is_seen_before_its_time_by_more_than_one_interval() -> None:
    step = (np.arange(120) >= 60).astype(float)
    found = at_rate(step, np.arange(120) / 120.0, 1000.0, 1000)
    assert found[: round(59 / 120 * 1000)].max() == pytest.approx(0.0, abs=1e-12)
    assert found[500:].min() == pytest.approx(1.0, abs=1e-12)
