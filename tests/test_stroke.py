"""Strokes: from tables and constants to speed and force at the model's rate."""

from __future__ import annotations

import numpy as np
import pytest

from foten.recording.recording import Channel, Recording
from foten.runtime.stroke import Stroke, constant_stroke, recorded_stroke, tabled_stroke
from foten.runtime.stylus import PressureCalibration


def stroke_of(table: dict[str, np.ndarray], rate_hz: float) -> Stroke:
    """The stroke in columns that are called as in a file."""
    names = {"t": "time", "x": "position_x", "y": "position_y"}
    return tabled_stroke({names.get(name, name): samples for name, samples in table.items()}, rate_hz)


def test_a_circle_has_its_speed() -> None:
    """20 mm radius, one turn a second: 40π mm/s everywhere, sampled at 120 Hz."""
    t = np.arange(0, 2, 1 / 120)
    x, y = 20 * np.cos(2 * np.pi * t), 20 * np.sin(2 * np.pi * t)
    stroke = stroke_of({"t": t, "x": x, "y": y, "force": 0 * t + 1}, 1000.0)
    speed, _ = stroke.conditioned(20.0)
    # Chords for arcs take (2π/120)²/6 = 0.05 % off, the low-pass at 1 Hz next to nothing; it settles in 50 ms.
    assert speed[100:-20] == pytest.approx(40 * np.pi, rel=2e-3)


def test_time_may_start_anywhere_and_be_uneven() -> None:
    t = 7.5 + np.array([0.0, 0.1, 0.15, 0.4, 1.0])
    stroke = stroke_of({"t": t, "speed": 100 * (t - 7.5), "force": t}, 500.0)
    assert stroke.force.size == 500
    np.testing.assert_allclose(stroke.velocity[0], 100 * np.arange(500) / 500, atol=1e-6)


def test_conditioning_keeps_a_constant_and_slows_a_step() -> None:
    speed, force = constant_stroke(80.0, 1.2, 0.3, 1000.0).conditioned(20.0)
    assert speed == pytest.approx(80.0, rel=1e-9)
    assert force == pytest.approx(1.2, rel=1e-9)
    assert constant_stroke(80.0, 1.2, 0.001, 1000.0).force.shape == (1,)
    stroke = constant_stroke(80.0, 1.2, 0.3, 1000.0)
    stroke.velocity[0, :100] = 0.0
    speed, _ = stroke.conditioned(20.0)
    half = int(np.argmax(speed > 40.0)) - 100
    assert 8 <= half <= 16  # ms; the low-pass's delay at 0 Hz is 11.2


@pytest.mark.parametrize("values", [(-1.0, 1.0, 1.0), (1.0, float("inf"), 1.0), (1.0, 1.0, 0.0)])
def test_impossible_constants_are_refused(values: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match=r"expected a finite number|less than one sample"):
        constant_stroke(*values, 1000.0)


def test_a_hole_in_the_table_is_told() -> None:
    t = np.concatenate([np.arange(0, 1, 0.01), [5.0]])
    assert stroke_of({"t": t, "speed": t, "force": t}, 100.0).gap_s == pytest.approx(4.01)
    assert stroke_of({"t": t[:-1], "speed": t[:-1], "force": t[:-1]}, 100.0).gap_s == 0


T = np.arange(0.0, 1.0, 0.01)


@pytest.mark.parametrize(
    ("table", "doubts"),
    [
        ({"t": T, "speed": 110 * T, "force": T}, []),
        ({"t": T, "speed": 0 * T, "force": 0 * T}, []),  # at rest, which is meant
        (
            {"t": T, "speed": 0.01 + 0.1 * T, "force": T},
            ["speed peaks at 0.109, expected mm/s up to about 350; was it given in m/s? It is taken as mm/s"],
        ),
        (
            {"t": T, "speed": 110 * T, "force": 50 * T},
            ["force peaks at 49.5, expected N up to about 10; was it given in mN or gf? It is taken as N"],
        ),
        (
            {"t": T, "x": 0.05 * T, "y": 0.1 * T, "pressure": T / T[-1]},
            ["position moves by 0.099, expected mm, tens to hundreds; was it given in m? It is taken as mm"],
        ),
        (
            {"t": np.array([0.0, 1000.0, 2000.0]), "speed": np.full(3, 80.0), "force": np.ones(3)},
            ["the stroke lasts 2000 s in 3 rows; is t in ms? It is taken as s"],
        ),
        ({"t": np.array([0.0, 5.0, 10.0]), "speed": np.full(3, 80.0), "force": np.ones(3)}, []),
        (
            {"t": 100 * T, "speed": 0 * T + 80, "force": 0 * T + 1},
            ["the stroke lasts 99 s in 100 rows; is t in ms? It is taken as s"],
        ),
    ],
)
def test_what_may_be_meant_is_rendered_and_doubted(table: dict[str, np.ndarray], doubts: list[str]) -> None:
    stroke = stroke_of(table, 100.0)
    assert list(stroke.doubts) == doubts
    assert stroke.force.size == round(100 * np.ptp(table["t"]))


@pytest.mark.parametrize(
    ("table", "match"),
    [
        ({"speed": 9000 * T, "force": T}, "in another unit"),
        ({"speed": 0 * T, "force": 200 * T}, "in mN or grams"),
        ({"speed": -T, "force": T}, "are magnitudes"),
        ({"speed": T, "pressure": 3 * T}, "expected 0 to 1"),
        ({"t": 1e-4 * T, "speed": T, "force": T}, "is t in seconds"),
        ({"t": 1e4 * T, "speed": T, "force": T}, "is t in ms"),
    ],
)
def test_a_stroke_of_no_hand_is_refused(table: dict[str, np.ndarray], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        stroke_of({"t": T, **table}, 1000.0)


def test_pressure_goes_by_the_curve_of_its_tablet() -> None:
    columns = {"time": np.arange(3.0), "speed": np.full(3, 80.0), "pressure": np.full(3, 0.5)}
    usual, refitted = (tabled_stroke(columns, 100.0, curve) for curve in (None, PressureCalibration(0.2, 1.0)))
    np.testing.assert_allclose(usual.force, 0.13 * np.exp(3.32 * 0.5))
    np.testing.assert_allclose(refitted.force, 0.2 * np.exp(0.5))
    force = {name: column for name, column in columns.items() if name != "pressure"} | {"force": np.ones(3)}
    with pytest.raises(ValueError, match="the stroke has forces, and a pressure's curve is given"):
        tabled_stroke(force, 100.0, PressureCalibration())


def pen(t: np.ndarray, offset: float = 0.0, force: float = 1.0) -> dict[str, np.ndarray]:
    return {"t": t, "x": 80 * t + offset, "y": 0 * t, "force": np.full(t.size, force)}


def rows(*parts: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def test_a_pen_that_the_tablet_does_not_report_is_lifted() -> None:
    """80 mm/s for a second, unheard of for a second and 200 mm away, 80 mm/s again."""
    table = rows(pen(np.arange(0, 1, 0.01)), pen(np.arange(2, 3, 0.01), 200.0))
    stroke = stroke_of(table, 1000.0)
    assert stroke.n_lifted == 1
    assert stroke.gap_s == 0
    speed, force = stroke.conditioned(20.0)
    assert force[1100:1950] == pytest.approx(0, abs=1e-3)
    assert speed[1100:1950] == pytest.approx(0, abs=0.1)
    assert speed.max() < 85  # the low-pass overshoots by 4 %
    for contact in (slice(200, 900), slice(2100, 2900)):
        assert speed[contact] == pytest.approx(80, rel=1e-3)
        assert force[contact] == pytest.approx(1, rel=1e-3)


def test_a_pen_may_land_elsewhere_but_not_jump_in_contact() -> None:
    up = pen(np.array([1.0]), 300.0, force=0.0)
    table = rows(pen(np.arange(0, 1, 0.01)), up, pen(np.arange(1.01, 2, 0.01), 300.0))
    stroke = stroke_of(table, 1000.0)
    assert stroke.n_lifted == 1
    assert float(np.abs(stroke.velocity).max()) == pytest.approx(80, rel=1e-3)
    table = rows(pen(np.arange(0, 1, 0.01)), pen(np.arange(1, 2, 0.01), 300.0))
    with pytest.raises(ValueError, match=r"speed reaches 3.* mm/s"):
        stroke_of(table, 1000.0)


def test_a_recorded_hand_needs_no_acceleration() -> None:
    recording = Recording({"speed": Channel(np.full(1000, 80.0), 1000.0), "force": Channel(np.ones(120), 120.0)})
    speed, force = recorded_stroke(recording, 500.0).conditioned(20.0)
    assert speed.size == force.size == 500
    assert speed == pytest.approx(80.0)
