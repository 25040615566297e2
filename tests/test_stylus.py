"""A pen in: speed and force as the hand's, whatever the tablet tells and when."""

from __future__ import annotations

from ctypes import byref, c_float, c_void_p

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import sosfilt

from foten.dsp.filters import butterworth
from foten.models.texture_file import Texture
from foten.runtime.binding import StylusOptions, library
from foten.runtime.native import NativeTexture
from foten.runtime.renderer import Renderer
from foten.runtime.stylus import PressureCalibration, Stylus, fit_pressure
from foten.simulation.stroking import stroking

RATE = 1000.0
CURVE = PressureCalibration()


@pytest.fixture
def stylus(texture: Texture) -> Stylus:
    return Stylus(Renderer(texture))


def lowpassed(signal: np.ndarray) -> np.ndarray:
    """A signal through the low-pass that recordings went through."""
    rows = [[b0, b1, b2, 1.0, a1, a2] for b0, b1, b2, a1, a2 in butterworth("lowpass", 20.0, RATE)]
    return np.asarray(sosfilt(np.array(rows), signal))


def hands(stylus: Stylus, events: np.ndarray, n: int, late_s: np.ndarray | float = 0.0) -> np.ndarray:
    """Speed and force of n samples, (n, 2), of events (k, 4): x, y, pressure, t, told `late_s` after their time."""
    reported = np.maximum.accumulate(events[:, 3] + late_s)
    out, k = np.empty((n, 2)), 0
    for i in range(n):
        while k < len(events) and reported[k] <= i / RATE:
            stylus.push(*events[k])
            k += 1
        out[i] = stylus.next_condition()
    return out


def stroke_at(times_s: np.ndarray, speed: float = 100.0) -> np.ndarray:
    """Events (k, 4) of a straight stroke [mm/s] along x under a pressure of 0.5."""
    return np.stack([speed * times_s, 0 * times_s, np.full(times_s.size, 0.5), times_s], axis=1)


def lag_of(found: np.ndarray, truth: np.ndarray) -> int:
    """By how many samples a signal comes after another."""
    return int(np.argmax([np.corrcoef(found[lag:], truth[: truth.size - lag])[0, 1] for lag in range(40)]))


@pytest.mark.parametrize(("events_hz", "max_ms"), [(60.0, 8), (120.0, 6), (240.0, 5)])
def test_it_finds_the_speed_and_force_of_a_hand(stylus: Stylus, events_hz: float, max_ms: int) -> None:
    """Truth: the simulated hand's own velocity and force through the same low-pass. Irregular events, told up to 5 ms late."""
    seconds, rng = 12.0, np.random.default_rng(1)
    stroked = stroking(seconds, 3, RATE)
    n = stroked.speed.size
    t = np.arange(n) / RATE
    at = np.arange(0.0, seconds - 0.1, 1 / events_hz)
    at = np.sort(at + rng.uniform(-0.15, 0.15, at.size) / events_hz)
    pressed = np.log(np.maximum(np.interp(at, t, stroked.force), 1.01 * CURVE.a) / CURVE.a) / CURVE.b
    events = np.stack(
        [*(np.interp(at, t, axis) for axis in stroked.position.T), np.clip(pressed, 1e-3, 1.0), at], axis=1
    )
    late = np.minimum(0.002 * np.abs(rng.standard_normal(at.size)), 0.005)
    found = hands(stylus, events, n, late)[500:-500]
    speed = np.hypot(*(lowpassed(axis) for axis in stroked.velocity.T))[500:-500]
    lag = lag_of(found[:, 0], speed)
    assert lag <= max_ms
    error = found[lag:, 0] - speed[: speed.size - lag]
    assert error.std() < 0.05 * speed.std()
    force = lowpassed(np.clip(stroked.force, 1.01 * CURVE.a, CURVE.a * np.exp(CURVE.b)))[500:-500]
    assert lag_of(found[:, 1], force) <= 1000 / events_hz + 5


def test_a_steady_stroke_is_its_speed_and_force(stylus: Stylus) -> None:
    at = np.arange(0.0, 2.0, 1 / 133)
    events = np.stack([80 * at, 60 * at, np.full(at.size, 0.5), at + 1e6], axis=1)  # a device's clock begins anywhere
    found = hands(stylus, events - [0, 0, 0, 1e6], 1900)[-200:]
    np.testing.assert_allclose(found[:, 0], 100.0, rtol=1e-6)
    np.testing.assert_allclose(found[:, 1], CURVE.force(np.array([0.5]))[0], rtol=1e-6)
    assert stylus.stats.n_late == stylus.stats.n_jumps == 0


@pytest.mark.parametrize(
    ("reported", "meant"), [((0, 0), (0.13, 3.32)), ((0, 2), (0.13, 2)), ((0.2, 0), (0.2, 3.32)), ((0.2, 2), (0.2, 2))]
)
def test_what_is_left_out_of_a_curve_is_the_papers(
    texture: Texture, reported: tuple[float, float], meant: tuple[float, float]
) -> None:
    """A steepness by itself was dropped."""
    native, speed, force = NativeTexture(texture.to_bytes()), c_float(), c_float()
    stylus = c_void_p(library().foten_stylus_new(native.pointer, byref(StylusOptions(*reported))))
    library().foten_stylus_push(stylus, 0.0, 0.0, 0.5, 0.0)
    for _ in range(1000):
        library().foten_stylus_next(stylus, byref(speed), byref(force))
    library().foten_stylus_free(stylus)
    assert force.value == pytest.approx(meant[0] * np.exp(meant[1] * 0.5), rel=1e-6)


def test_the_force_of_a_pressure_is_equation_12() -> None:
    """Oracle: 0.13 N · exp(3.32 p) by hand; without contact none."""
    force = PressureCalibration().force(np.array([0.0, 1e-9, 0.25, 0.5, 1.0]))
    np.testing.assert_allclose(force, [0.0, 0.13, 0.298131, 0.683710, 3.595846], rtol=3e-6)
    np.testing.assert_allclose(PressureCalibration(0.2, -1.0).force(np.array([0.5])), 0.121306, rtol=1e-5)


def test_a_force_may_be_the_same_at_any_pressure(texture: Texture) -> None:
    stylus = Stylus(Renderer(texture), PressureCalibration(0.8, 0.0))
    stylus.push(0.0, 0.0, 0.5, 0.0)
    assert [stylus.next_condition()[1] for _ in range(1000)][-1] == pytest.approx(0.8, rel=1e-6)


def test_lifting_is_quiet_and_landing_elsewhere_is_no_stroke(stylus: Stylus) -> None:
    """Speed and force fall and rise as the low-pass does: never faster than it lets a step."""
    first = stroke_at(np.arange(0.0, 1.0, 0.01))
    lifted = np.array([[100.0, 0.0, 0.0, 1.0]])
    second = first + np.array([5000.0, 300.0, 0.0, 1.5])
    found = hands(stylus, np.concatenate([first, lifted, second]), 2600)
    assert found[1200:1500, 0].max() < 0.1
    assert found[1200:1500, 1].max() < 1e-3
    assert found[:, 0].max() < 1.06 * 100  # a second-order low-pass overshoots a step by 4.3 %
    step = lowpassed(np.ones(200))
    fastest = np.diff(step, prepend=0.0).max()
    assert np.abs(np.diff(found[:, 1])).max() < 1.05 * fastest * CURVE.force(np.array([0.5]))[0]
    np.testing.assert_allclose(found[2400:2480, 0], 100.0, rtol=1e-3)


@pytest.mark.parametrize("events_hz", [60.0, 120.0, 240.0])
@pytest.mark.parametrize("angle", [0.0, 0.6])
def test_a_pen_that_stops_does_not_turn_back(stylus: Stylus, events_hz: float, angle: float) -> None:
    """The tablet goes on telling the same place. A second-order low-pass undershoots a step by 4.3 %, and nothing adds to it."""
    at = np.arange(0.0, 1.0, 1 / events_hz)
    path = 200 * np.minimum(at, 0.5)
    events = np.stack([np.cos(angle) * path, np.sin(angle) * path, np.full(at.size, 0.5), at], axis=1)
    speed = hands(stylus, events, 990)[:, 0]
    falling = 500 + int(np.argmax(speed[500:] < 100))
    lowest = falling + int(np.argmax(np.diff(speed[falling:]) > 0))
    assert speed[lowest:].max() < 1.05 * 0.043 * 200


def test_a_pen_that_rests_is_still_and_pressed(stylus: Stylus) -> None:
    """Browsers tell nothing of a pen that does not move."""
    events = stroke_at(np.arange(0.0, 0.5, 0.008))
    found = hands(stylus, events, 1500)
    assert found[-300:, 0].max() < 1e-3
    np.testing.assert_allclose(found[-300:, 1], CURVE.force(np.array([0.5]))[0], rtol=1e-6)


def test_what_a_pen_did_before_it_stood_still_adds_nothing_to_its_next_movement(texture: Texture) -> None:
    """Still for 180 ms, less than ten usual steps of 20 ms: the same stroke goes on, from a velocity of 0."""
    at = np.arange(0.0, 1.0, 0.02)
    after = []
    for speed in (0.0, 100.0, -100.0):
        before = stroke_at(at, speed)
        next_steps = before[-1] + stroke_at(0.18 + 0.02 * np.arange(4), 50.0) * [1, 1, 0, 1]
        stylus = Stylus(Renderer(texture))
        after.append(hands(stylus, np.concatenate([before, next_steps]), 1200)[-70:, 0])
        assert stylus.stats.n_jumps == 0
    # It counts as still after three steps: the low-pass has 90 ms to forget 100 mm/s, by √2 e^(−2π·20 Hz/√2·t).
    np.testing.assert_allclose(after[1:], [after[0]] * 2, atol=0.05)
    assert after[0].max() > 10


def test_what_is_wrong_is_counted_and_does_no_harm(texture: Texture, stylus: Stylus) -> None:
    events = stroke_at(np.arange(0.0, 2.0, 0.008))
    clean = hands(Stylus(Renderer(texture)), events, 1900)
    rng = np.random.default_rng(0)
    spoiled = []
    for event in events:
        spoiled.append(event)
        if rng.random() < 0.2:
            spoiled.append(event)  # doubled
        if rng.random() < 0.2:
            spoiled.append(np.where(rng.random(4) < 0.5, np.nan, event) * [1, 1, np.inf, 1])
        if rng.random() < 0.1:
            spoiled.append(event - [0, 0, 0, 0.5])  # late by half a second
    out, k = np.empty((1900, 2)), 0
    for i in range(1900):
        while k < len(spoiled) and (not np.isfinite(spoiled[k][3]) or spoiled[k][3] <= i / RATE):
            stylus.push(*spoiled[k])
            k += 1
        out[i] = stylus.next_condition()
    np.testing.assert_allclose(out, clean, rtol=1e-9, atol=1e-9)
    assert stylus.stats.n_late > 20
    assert stylus.stats.n_refused > 20
    assert stylus.stats.n == len(events[events[:, 3] <= 1.899])


def test_a_clock_that_begins_anew_is_followed(stylus: Stylus) -> None:
    events = stroke_at(np.arange(0.0, 1.0, 0.008))
    hands(stylus, events, 1000)
    found = hands(stylus, events, 1000)  # a second earlier than the last
    np.testing.assert_allclose(found[-200:, 0], 100.0, rtol=1e-3)
    assert stylus.stats.n_late == 8  # those after which it is believed


def test_more_than_can_wait_is_dropped_and_pressure_is_cut(stylus: Stylus) -> None:
    for i in range(300):
        stylus.push(i, 0.0, 1.5, 0.001 * i)
    assert stylus.stats.n_dropped == 300 - 256
    assert stylus.stats.n_clipped == 256
    assert np.isfinite(stylus.next_condition()).all()


def test_events_that_came_at_once_do_not_make_jumps_of_the_rest(stylus: Stylus) -> None:
    """A tablet that kept 200 events back and told them within 2 ms: the usual step fell to nothing, and each event was a jump.

    Its own steps are longer than the 40 ms that a gap lasts at least, so that only the usual one tells them from a gap.
    """
    for k in range(200):
        stylus.push(1e-3 * k, 0.0, 0.5, 1e-5 * k)
    stylus.next_condition()
    at = np.arange(0.01, 2.0, 0.045)
    found = hands(stylus, stroke_at(at), 2000)
    assert stylus.stats.n_jumps == 0
    np.testing.assert_allclose(found[-200:, 0], 100.0, rtol=1e-3)


@pytest.mark.parametrize(
    ("step_s", "gap_s", "n_jumps"), [(0.001, 0.035, 0), (0.001, 0.045, 1), (0.008, 0.075, 0), (0.008, 0.085, 1)]
)
def test_a_gap_of_ten_usual_steps_and_of_40_ms_is_a_pen_out_of_reach(
    stylus: Stylus, step_s: float, gap_s: float, n_jumps: int
) -> None:
    """What was moved in the gap is no stroke then: the velocity of the first event after it is unknown, and 0."""
    before = stroke_at(np.arange(0.0, 1.0, step_s))
    landed = before[-1] + np.array([100 * gap_s, 0.0, 0.0, gap_s])
    found = hands(stylus, np.concatenate([before, [landed]]), int(1000 * landed[3]) + 22)
    assert stylus.stats.n_jumps == n_jumps
    assert found[-1, 0] < 10 if n_jumps else found[-1, 0] > 60  # the low-pass takes 17 ms for most of a step


@pytest.mark.parametrize(("speed", "is_jump"), [(4900.0, False), (5100.0, True)])
def test_what_moves_faster_than_5_m_per_second_is_a_jump(stylus: Stylus, speed: float, is_jump: bool) -> None:
    events = stroke_at(np.arange(0.0, 0.5, 0.008), speed)
    found = hands(stylus, events, 500)
    assert stylus.stats.n_jumps == is_jump * (len(events) - 1)
    assert found[-1, 0] == pytest.approx(0.0 if is_jump else speed, rel=1e-3)


def test_a_jump_lets_go_at_once(stylus: Stylus) -> None:
    """Oracle: the low-pass of the velocity that is held, up to the jump and not until the pen counts as still, 25 ms later."""
    events = stroke_at(np.arange(0.0, 0.5, 0.008))
    jump = events[-1] + np.array([1000.0, 0.0, 0.0, 0.008])
    found = hands(stylus, np.concatenate([events, [jump]]), 600)
    first, landed = (int(np.ceil(1000 * time)) for time in (events[1, 3], jump[3]))
    held = np.zeros(600)
    held[first:landed] = 100.0
    np.testing.assert_allclose(found[:, 0], np.abs(lowpassed(held)), atol=1e-4)  # mm/s; speed leaves as float32
    assert stylus.stats.n_jumps == 1
    assert found[-1, 1] == pytest.approx(CURVE.force(np.array([0.5]))[0], rel=1e-6)  # it presses where it landed


def test_late_events_out_of_order_are_no_new_clock(texture: Texture, stylus: Stylus) -> None:
    """A device that sends what it had kept, the newest first: a clock that began anew would run forwards."""
    events = stroke_at(np.arange(0.0, 1.0, 0.008))
    clean = hands(Stylus(Renderer(texture)), events, 990)
    resent = events[39:19:-1]
    found = hands(stylus, np.concatenate([events[:60], resent, events[60:]]), 990)
    np.testing.assert_allclose(found, clean, rtol=1e-9, atol=1e-9)
    assert stylus.stats.n_late == len(resent)


@given(
    events=st.lists(
        st.tuples(*(st.floats(allow_nan=True, allow_infinity=True, width=32) for _ in range(4))), max_size=60
    )
)
@settings(max_examples=60, deadline=None)
def test_no_event_makes_a_hand_that_is_none(texture: Texture, events: list[tuple[float, ...]]) -> None:
    stylus = Stylus(Renderer(texture))
    for event in events:
        stylus.push(*event)
        speed, force = stylus.next_condition()
        assert np.isfinite([speed, force]).all()
        assert min(speed, force) >= 0
    assert np.isfinite(stylus.render(64)).all()


def test_a_rendering_under_a_pen_is_one_under_its_hand(texture: Texture) -> None:
    events = stroke_at(np.arange(0.0, 1.0, 0.008))
    found = hands(Stylus(Renderer(texture)), events[:1], 200)
    pen = Stylus(Renderer(texture, seed=3))
    pen.push(*events[0])
    expected = Renderer(texture, seed=3).render(found[:, 0], found[:, 1])
    np.testing.assert_allclose(pen.render(200), expected, rtol=1e-4, atol=1e-4)


def test_a_curve_of_pressure_is_found_again() -> None:
    rng = np.random.default_rng(0)
    pressure = np.linspace(0.05, 1.0, 15)
    force = 0.2 * np.exp(2.8 * pressure)
    exact = fit_pressure(np.append(0.0, pressure), np.append(0.0, force))
    assert (exact.a, exact.b) == pytest.approx((0.2, 2.8), rel=1e-9)
    noisy = fit_pressure(pressure, force + 0.05 * rng.standard_normal(15))

    def error(a: float, b: float) -> float:
        return float(np.square(a * np.exp(b * pressure) - force).sum())

    assert (noisy.a, noisy.b) == pytest.approx((0.2, 2.8), rel=0.1)
    assert error(noisy.a, noisy.b) < 15 * 0.05**2  # least squares of force: no logarithm overrates the light end
    for wrong, message in (
        ((pressure[:2], force[:2]), "three or more"),
        ((pressure, force[:-1]), "shape"),
        ((pressure * 2, force), "from 0 to 1"),
        ((np.full(5, 0.5), np.ones(5)), "over 0 of pressure"),
        ((np.append(pressure, np.nan), np.append(force, 1.0)), "NaN"),
    ):
        with pytest.raises(ValueError, match=message):
            fit_pressure(*wrong)
    for curve in ((0.0, 3.0), (-1.0, 3.0), (0.1, 500.0), (float("nan"), 1.0)):
        with pytest.raises(ValueError, match="no tablet"):
            PressureCalibration(*curve)
