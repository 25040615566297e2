"""A simulated capture: the sound of a microphone on a pen, and the pen's events on a tablet.

    click ─ 8 s ─ three taps ─ strokes of 6 s with 0.4 s in the air between them ─ three taps

Each tap and the landing of each stroke knock. Pen and microphone have their own clocks.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from foten.atomic_write import atomic_write
from foten.dsp import Array
from foten.dsp.resample import interpolate, rate_ratio
from foten.recording.capture_folder import PEN, SOUND, About, PenEvents
from foten.recording.recording import Channel, Recording
from foten.simulation.simulate import TEXTURES, vibration
from foten.simulation.stroking import stroking

RATE_HZ, SOUND_HZ, PLAN_HZ = 10_000.0, 48_000.0, 1000.0
FULL_SCALE = 60.0  # m/s² of a sample of 1
STROKE_S, LIFT_S = 6.0, 0.4
TAP_S, APART_S = 0.07, 0.6  # of a tap; from one to the next
BEGIN_S, CUE_S = 18.0, 8.0  # of the first tap; of the click before it
PAUSE_S, LAST_S = (3.0, 5.0), 9.0  # before and after the strokes; of the sound after them
NOISE = 0.02  # m/s², of the microphone
KNOCK = (15.0, 900.0, 0.003)  # m/s², Hz, s of its fading
EVENTS_HZ, JITTER = 200.0, 0.2  # of the tablet; of a step
DELAY_S, DRIFT = 0.08, 50e-6  # of the pen's clock
NEWTONS, STEEPNESS = About.newtons, About.steepness  # of the pressure's curve


@dataclass(frozen=True)
class SimulatedCapture:
    """Taps, strokes, taps; times by the sound's clock [s]."""

    plan: Array  # of the pen: t [s], x, y [mm], pressure, shape (n, 4), at `PLAN_HZ`
    sound: Array  # shape (n,), at `SOUND_HZ`, of which 1 is `FULL_SCALE`
    strokes_s: tuple[float, float]  # when they begin and end
    taps_s: Array
    recording: Recording  # of the strokes alone, with a true sensor on everything

    def events(self, rng: np.random.Generator, rate_hz: float = EVENTS_HZ) -> PenEvents:
        """Events of a tablet at this rate, ±20 % of a step, by its clock."""
        times = np.arange(self.plan[0, 0], self.plan[-1, 0], 1.0 / rate_hz)
        times += rng.uniform(-JITTER, JITTER, times.size) / rate_hz
        at = np.clip((times * PLAN_HZ).astype(int), 0, len(self.plan) - 1)
        _, x, y, pressure = self.plan[at].T
        return PenEvents(times * (1.0 + DRIFT) + DELAY_S, x, y, pressure)

    def write(self, folder: Path, rng: np.random.Generator) -> tuple[Path, Path]:
        """Write `sound.wav` (16 bits) and `pen.csv` to a folder, and return their paths."""
        import scipy.io.wavfile

        folder.mkdir(parents=True, exist_ok=True)
        sound, pen = folder / SOUND, folder / PEN
        with atomic_write(sound) as part:
            samples = np.clip(np.round(32767 * self.sound), -32768, 32767).astype(np.int16)
            scipy.io.wavfile.write(part, round(SOUND_HZ), samples)
        events = self.events(rng)
        rows = np.stack([events.times_s, events.x_mm, events.y_mm, events.pressure], axis=1)
        touches = events.pressure > 0
        with atomic_write(pen) as part:  # a tablet reports touches and the end of each
            rows = rows[touches | np.append(False, touches[:-1])]
            np.savetxt(part, rows, "%.6f", ",", header="t [s],x [mm],y [mm],pressure", comments="")
        return sound, pen


def simulate_capture(key: str, seconds: float, seed: int = 0) -> SimulatedCapture:
    """Capture of a simulated texture; ValueError where it is unknown, or `seconds` of strokes are fewer than one has."""
    if key not in TEXTURES:
        raise ValueError(f"unknown texture {key!r}, expected one of {', '.join(TEXTURES)}")
    if not STROKE_S <= seconds <= 600:
        raise ValueError(f"a capture has {STROKE_S:g} to 600 s of strokes, got {seconds:g}")
    rng = np.random.default_rng([seed, 7])
    stroke = stroking(seconds, seed, RATE_HZ)
    at = np.arange(stroke.force.size) / RATE_HZ
    touches = at % (STROKE_S + LIFT_S) < STROKE_S
    low, high = NEWTONS * np.exp(STEEPNESS * np.array([0.03, 0.95]))
    force = np.clip(stroke.force, low, high)
    vibrated = vibration(TEXTURES[key], replace(stroke, force=force), rng)[:, 2]
    vibrated = vibrated * touches + NOISE * rng.standard_normal(vibrated.size)

    start = BEGIN_S + PAUSE_S[0]
    end = start + seconds
    three = APART_S * np.arange(3)
    taps = np.concatenate([BEGIN_S + three, end + PAUSE_S[1] + three])
    acceleration = NOISE * rng.standard_normal(round((end + LAST_S) * RATE_HZ))
    first = round(start * RATE_HZ)
    acceleration[first : first + vibrated.size] = vibrated
    size, hertz, fades_s = KNOCK
    ring = np.arange(int(0.02 * RATE_HZ)) / RATE_HZ
    knock = size * np.exp(-ring / fades_s) * np.sin(2 * np.pi * hertz * ring)
    for landing in [BEGIN_S - CUE_S, *taps, *(start + np.arange(0.0, seconds, STROKE_S + LIFT_S))]:
        k = round(landing * RATE_HZ)
        acceleration[k : k + ring.size] += knock

    times = np.arange(0.0, end + LAST_S, 1.0 / PLAN_HZ)
    x, y = (np.interp(times - start, at, stroke.position[:, axis]) for axis in (0, 1))
    strokes = (times >= start) & (times < end) & ((times - start) % (STROKE_S + LIFT_S) < STROKE_S)
    pressure = np.where(strokes, np.interp(times - start, at, np.log(force / NEWTONS) / STEEPNESS), 0.0)
    for tap in taps:
        pressure[(times >= tap) & (times < tap + TAP_S)] = 0.5

    channels = {
        "acceleration": Channel(vibrated, RATE_HZ),
        "position_x": Channel(stroke.position[:, 0].copy(), RATE_HZ),
        "position_y": Channel(stroke.position[:, 1].copy(), RATE_HZ),
        "force": Channel(np.where(touches, force, 0.0), RATE_HZ),
    }
    return SimulatedCapture(
        np.stack([times, x, y, pressure], axis=1),
        interpolate(acceleration, rate_ratio(SOUND_HZ, RATE_HZ)) / FULL_SCALE,
        (start, end),
        taps,
        Recording(channels, texture=key),
    )
