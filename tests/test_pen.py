"""Two clocks joined by taps: delay and drift that were put in are found, within 3 ms at 200 events a second."""

from __future__ import annotations

import numpy as np
import pytest

from foten.datasets.pen import PenEvents, joined, knocks_of, landings_of, pen_channels
from foten.dsp import Array

RATE_HZ = 48_000.0
TAPS = (0.8, 1.3, 1.9, 20.4, 20.9, 21.5)  # by the pen's clock [s]


def captured(
    delay_s: float = 0.08, drift: float = 50e-6, rate_hz: float = 200.0, seed: int = 0, noise: float = 0.003
) -> tuple[PenEvents, Array]:
    """Return a capture: taps, four strokes with a rough sound, taps; the sound starts `delay_s` before the pen's clock."""
    rng = np.random.default_rng(seed)
    touches = [(at, at + 0.07) for at in TAPS] + [(4.0 + 3.8 * i, 7.2 + 3.8 * i) for i in range(4)]
    times = np.arange(0.0, 23.0, 1.0 / rate_hz) + rng.uniform(-0.2, 0.2, int(23.0 * rate_hz)) / rate_hz
    pressure, x = np.zeros(times.size), np.zeros(times.size)
    for begin, end in touches:
        during = (times >= begin) & (times < end)
        strokes = end - begin > 1
        pressure[during] = 0.4 if strokes else 0.5
        x[during] = 60 + 40 * np.sin(4 * (times[during] - begin)) if strokes else 20.0
    sound = noise * rng.standard_normal(int(24.0 * RATE_HZ))
    for begin, end in touches:
        at, until = (round(RATE_HZ * (t * (1 + drift) + delay_s)) for t in (begin, end))
        if end - begin < 1:
            ring = np.arange(int(0.02 * RATE_HZ)) / RATE_HZ
            sound[at : at + ring.size] += 0.5 * np.exp(-ring / 0.003) * np.sin(2 * np.pi * 900 * ring)
        else:
            sound[at:until] += 0.06 * rng.standard_normal(until - at)
    return PenEvents(times, x, np.zeros(times.size), pressure), sound


@pytest.mark.parametrize("delay_s", [0.08, -0.3, 1.4])
@pytest.mark.parametrize("drift", [0.0, 50e-6, -200e-6])
def test_delay_and_drift_are_found(delay_s: float, drift: float) -> None:
    worst = 0.0
    for seed in range(3):
        events, sound = captured(delay_s, drift, seed=seed)
        clock = joined(events, sound, RATE_HZ)
        assert clock.n_taps == len(TAPS)
        t = np.linspace(0.0, 23.0, 100)
        worst = max(worst, float(np.abs(clock(t) - (t * (1 + drift) + delay_s)).max()))
    assert worst < 0.003  # s: what the issue of a capture allows at 200 events a second


def test_short_touches_in_place_are_taps_and_strokes_are_none() -> None:
    events, _ = captured()
    landings, off_by, is_tap = landings_of(events)
    np.testing.assert_allclose(landings[is_tap], TAPS, atol=0.0036)  # half of a step of 5 ms, and its jitter
    assert (np.abs(landings[is_tap] - TAPS) <= off_by[is_tap]).all()
    assert (~is_tap).sum() == 4


def test_a_knock_is_where_it_begins() -> None:
    _, sound = captured(delay_s=0.0, drift=0.0)
    knocks = knocks_of(sound, RATE_HZ)
    for tap in TAPS:
        assert np.abs(knocks - tap).min() < 0.001


def test_a_hum_and_a_loud_room_do_not_matter() -> None:
    events, sound = captured(noise=0.02)
    hum = 0.3 * np.sin(2 * np.pi * 50 * np.arange(sound.size) / RATE_HZ)
    clock = joined(events, sound + hum, RATE_HZ)
    assert clock.delay_s == pytest.approx(0.08, abs=0.003)


def test_what_is_not_of_one_stroke_is_refused() -> None:
    events, sound = captured()
    with pytest.raises(ValueError, match=r"\d of 6 taps are in the sound, expected 4 or more"):
        joined(events, 0.01 * np.random.default_rng(1).standard_normal(sound.size), RATE_HZ)
    few = PenEvents(
        *(values[events.times_s < 1.5] for values in (events.times_s, events.x_mm, events.y_mm, events.pressure))
    )
    with pytest.raises(ValueError, match="the pen tapped 2 times, expected 3 or more"):
        joined(few, sound, RATE_HZ)


def test_the_pen_by_the_clock_of_the_sound_without_taps_and_silent_in_the_air() -> None:
    events, sound = captured()
    channels = pen_channels(events, joined(events, sound, RATE_HZ), lambda pressure: 2.0 * pressure)
    position, force = channels["position_x"], channels["force"]
    assert position.times_s is not None
    begins = 4.0 * (1 + 50e-6) + 0.08
    assert position.times_s[0] == pytest.approx(begins, abs=0.01)
    speed = np.abs(np.diff(position.samples) / np.diff(position.times_s))
    assert speed.max() < 1.3 * 160  # mm/s, of the strokes, whose clock jitters; the way back in the air would be 1000s
    in_air = force.samples == 0
    assert in_air.sum() == 2 * 3
    assert np.interp(begins + 3.5, position.times_s, force.samples) == 0.0
    assert np.interp(begins + 1.0, position.times_s, force.samples) == pytest.approx(0.8)
