"""A pen on a simulated surface: what a microphone on it hears, and where the pen is, by one true clock."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.io.wavfile

from foten.datasets.simulate import TEXTURES, vibration
from foten.datasets.stroking import Stroking, stroking
from foten.dsp import Array
from foten.dsp.resample import interpolate, rate_ratio
from foten.recording.recording import Channel, Recording
from foten.runtime.stylus import PressureCalibration

RATE_HZ, SOUND_HZ = 10_000.0, 48_000.0
FULL_SCALE = 60.0  # m/s² of a sample of 1
STROKES_S, LIFT_S = 6.0, 0.4  # of each stroke, and the pen in the air after it
TAP_S = 0.07
BEGIN_S, CUE_S = 18.0, 8.0  # of the first tap, and of a click this much before it
CALIBRATION = PressureCalibration()


@dataclass(frozen=True)
class Performance:
    """Taps, strokes, taps; times by the sound's clock [s]."""

    plan: Array  # t [s], x, y [mm], pressure, shape (n, 4), 1000 a second
    sound: Array  # of full scale, at `SOUND_HZ`
    strokes_s: tuple[float, float]  # first to last
    recording: Recording  # of the strokes, with a true sensor on everything
    taps_s: Array

    def write_sound(self, path: Path) -> None:
        """Write the sound with 16 bits."""
        samples = np.clip(np.round(32767 * self.sound), -32768, 32767).astype(np.int16)
        scipy.io.wavfile.write(path, round(SOUND_HZ), samples)


def performed(key: str, seconds: float, seed: int = 0) -> Performance:
    """Return a performance on a texture of the simulator: a click as a cue, taps, strokes, taps."""
    rng = np.random.default_rng([seed, 7])
    hand = stroking(seconds, seed, RATE_HZ)
    at = np.arange(hand.force.size) / RATE_HZ
    touching = at % (STROKES_S + LIFT_S) < STROKES_S
    low, high = CALIBRATION.force(np.array([0.03, 1.0]))
    force = np.clip(hand.force, low, high)
    stroke = Stroking(RATE_HZ, hand.position, hand.velocity, force, hand.tilt)
    felt = vibration(TEXTURES[key], stroke, rng)[:, 2] * touching
    felt += 0.02 * rng.standard_normal(felt.size)
    before, after = BEGIN_S + np.array([0.0, 0.6, 1.2]), BEGIN_S + 3.0 + seconds + np.array([1.0, 1.6, 2.2])
    start, end = BEGIN_S + 3.0, BEGIN_S + 3.0 + seconds
    taps = np.concatenate([before, after])

    n = round((end + 5.0) * RATE_HZ)
    acceleration = 0.02 * rng.standard_normal(n)
    first = round(start * RATE_HZ)
    acceleration[first : first + felt.size] = felt
    ring = np.arange(int(0.02 * RATE_HZ)) / RATE_HZ
    landings = np.concatenate([taps, [BEGIN_S - CUE_S], start + np.arange(0.0, seconds, STROKES_S + LIFT_S)])
    for tap in landings:
        k = round(tap * RATE_HZ)
        acceleration[k : k + ring.size] += 15.0 * np.exp(-ring / 0.003) * np.sin(2 * np.pi * 900 * ring)
    sound = interpolate(acceleration, rate_ratio(SOUND_HZ, RATE_HZ)) / FULL_SCALE

    times = np.arange(0.0, end + 4.0, 1e-3)
    pressure = np.zeros(times.size)
    x, y = np.full(times.size, 30.0), np.full(times.size, 40.0)
    for tap in taps:
        pressure[(times >= tap) & (times < tap + TAP_S)] = 0.5
    during = (times >= start) & (times < end)
    moment = times[during] - start
    x[during], y[during] = (np.interp(moment, at, hand.position[:, axis]) for axis in (0, 1))
    pressed = np.log(force / CALIBRATION.a) / CALIBRATION.b
    pressure[during] = np.where(moment % (STROKES_S + LIFT_S) < STROKES_S, np.interp(moment, at, pressed), 0.0)
    plan = np.stack([times, x, y, pressure], axis=1)

    channels = {
        "acceleration": Channel(acceleration[first : first + felt.size], RATE_HZ),
        "position_x": Channel(hand.position[:, 0].copy(), RATE_HZ),
        "position_y": Channel(hand.position[:, 1].copy(), RATE_HZ),
        "force": Channel(np.where(touching, force, 0.0), RATE_HZ),
    }
    return Performance(plan, sound, (start, end), Recording(channels, texture=key), taps)
