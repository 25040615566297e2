import numpy as np
import pytest

from foten.datasets.stroking import stroking

SEEDS = range(4)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_hand_stays_on_the_plate_and_in_contact(seed: int) -> None:
    stroke = stroking(64, seed, 1000.0)
    assert stroke.position.min() > 0
    assert stroke.position.max() < 100
    assert stroke.force.min() > 0.1
    assert stroke.force.max() < 4.0
    assert stroke.speed.max() <= 350


def test_a_minute_covers_speed_and_force() -> None:
    medians = []
    for seed in SEEDS:
        stroke = stroking(64, seed, 1000.0)
        medians.append(np.median(stroke.speed))
        cells = np.histogram2d(stroke.speed, stroke.force, [[0, 60, 120, 180, 240], [0.1, 0.5, 1, 2, 3]])[0]
        assert cells.min() > 0  # ms in each of 16 cells
        assert (stroke.speed < 5).mean() < 0.1  # no long pauses
    assert np.mean(medians) == pytest.approx(100, rel=0.15)


def test_reversals_pass_through_standstill() -> None:
    stroke = stroking(64, 0, 1000.0)
    resting = stroke.speed < 2
    stops = np.flatnonzero(resting[1:] & ~resting[:-1])
    assert stops.size > 20
    directions = stroke.velocity / np.maximum(stroke.speed, 1e-9)[:, None]
    inner = stops[(stops > 100) & (stops < len(resting) - 200)]
    turned = np.sum(directions[inner - 100] * directions[inner + 200], axis=1)
    assert (turned < -0.5).sum() > 5  # back the way it came, at least sometimes


def test_velocity_is_the_derivative_of_position() -> None:
    stroke = stroking(10, 1, 10_000.0)
    derivative = np.gradient(stroke.position, axis=0) * 10_000
    # Central difference: h²/6 of the third derivative, which the shortest fast movements put near 1e6 mm/s³.
    np.testing.assert_allclose(derivative[1:-1], stroke.velocity[1:-1], atol=0.01)


def test_speed_and_force_leave_the_texture_band_alone() -> None:
    from scipy.signal import welch

    stroke = stroking(64, 2, 1000.0)
    for signal in (stroke.speed, stroke.force):
        frequency_hz, power = welch(signal, 1000, nperseg=4000)
        assert power[frequency_hz > 20].sum() < 1e-3 * power.sum()


def test_the_rate_samples_one_and_the_same_motion() -> None:
    fine, coarse = stroking(20, 3, 10_000.0), stroking(20, 3, 1000.0)
    np.testing.assert_allclose(fine.position[::10], coarse.position, atol=1e-9)
    np.testing.assert_allclose(fine.force[::10], coarse.force, atol=1e-9)
    np.testing.assert_allclose(fine.tilt[::10], coarse.tilt, atol=1e-9)
