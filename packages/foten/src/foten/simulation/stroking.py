"""Simulated unconstrained stroking of a plate, a function of seed and length; any rate samples the same motion."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from foten.dsp import Array

PLATE_MM = 100.0  # Sec. III-b: 100 x 100 mm
MARGIN_MM = 12.0  # targets stay this far from the edge, so that curved strokes do too
PEAK_SPEED_MM_S = (20.0, 340.0)  # of a movement
SKEW = 0.35  # of the peaks, log-uniform at 1; less favours fast movements
STROKE_S = (0.3, 0.75)  # a shorter one would reach the texture's band, from 20 Hz
PEAK_TO_MEAN = 1.875  # speed of a minimum-jerk movement
OVERLAP = 0.4  # of the shorter of two movements
REVERSAL_SHARE = 0.35  # of movements that wait for the one before to end, so that the speed passes through zero
BOW = 0.06  # standard deviation of the sideways bend, in lengths of the movement
MEAN_FORCE_N = (0.2, 3.0)  # of a stroke
FORCE_WOBBLE = 0.28  # largest log-deviation: e^0.28 keeps 0.2 to 3.0 N within 0.1 to 4 N
TILT_RAD = 0.07  # rms of each of the two angles by which the tool leans


@dataclass(frozen=True)
class Stroking:
    """One stroking, sampled."""

    rate_hz: float  # samples a second
    position: Array  # of the tip on the plate [mm], shape (n, 2)
    velocity: Array  # of the tip [mm/s], shape (n, 2)
    force: Array  # normal force [N], shape (n,), always positive
    tilt: Array  # how far the tool leans along x and y [rad], shape (n, 2)

    @property
    def speed(self) -> Array:
        """Tangential speed [mm/s], shape (n,)."""
        return np.hypot(self.velocity[:, 0], self.velocity[:, 1])


@lru_cache(maxsize=1)
def stroking(seconds: float, seed: int, rate_hz: float) -> Stroking:
    """Human-like stroking: overlapping point-to-point movements under a wandering force.

    Each movement has the minimum-jerk profile 10u³ - 15u⁴ + 6u⁵; overlapping ones are added, which stays on the plate.
    Speed and force hold nothing above about 10 Hz; the median speed is near 100 mm/s.
    """
    rng = np.random.default_rng([seed, 1])  # 1: the hand; the texture and the sensors draw from other streams
    n = round(seconds * rate_hz)
    target = rng.uniform(MARGIN_MM, PLATE_MM - MARGIN_MM, 2)
    steps, velocity = np.zeros((2, n, 2))  # what movements displace, where they end
    steps[0] = target
    middles_s, log_means, movements = [], [], []
    end_s, duration_s = 0.0, 0.0
    while end_s < seconds:
        previous_s = duration_s
        displacement, duration_s = _movement(target, rng)
        reverses = rng.random() < REVERSAL_SHARE
        start_s = end_s - (0 if reverses else OVERLAP * min(duration_s, previous_s))
        end_s = start_s + duration_s
        # Minimum jerk, bent sideways by some share of its length.
        sideways = rng.normal(0, BOW) * np.array([-displacement[1], displacement[0]])
        first, stop = (min(max(0, int(np.ceil(t * rate_hz))), n) for t in (start_s, end_s))
        u = (np.arange(first, stop) / rate_hz - start_s)[:, None] / duration_s
        hump = u * (1 - u)
        movements.append((slice(first, stop), displacement * u**3 * (10 - 15 * u + 6 * u**2) + sideways * 64 * hump**3))
        steps[stop : stop + 1] += displacement
        velocity[first:stop] += (displacement * 30 * hump**2 + sideways * 192 * hump**2 * (1 - 2 * u)) / duration_s
        target = target + displacement
        middles_s.append(start_s + duration_s / 2)
        log_means.append(rng.uniform(*np.log(MEAN_FORCE_N)))

    position = np.cumsum(steps, axis=0)
    for samples, moved in movements:
        position[samples] += moved

    from scipy.interpolate import PchipInterpolator

    times_s = np.arange(n) / rate_hz
    log_force = np.full(n, log_means[0])
    if len(middles_s) > 1:  # monotone between the strokes' means, so that it never overshoots them
        log_force = PchipInterpolator(middles_s, log_means)(np.clip(times_s, middles_s[0], middles_s[-1]))
    log_force += FORCE_WOBBLE * np.tanh(0.6 * _wander(times_s, seconds, 5.0, rng))
    tilt = TILT_RAD * np.stack([_wander(times_s, seconds, 0.4, rng) for _ in range(2)], axis=1)
    stroke = Stroking(rate_hz, position, velocity, np.exp(log_force), tilt)
    for array in (stroke.position, stroke.velocity, stroke.force, stroke.tilt):
        array.flags.writeable = False
    return stroke


def stepped_stroking(knots: Sequence[tuple[float, float, float]], rate_hz: float) -> Stroking:
    """Stroke along x, on straight lines between knots of time [s], velocity [mm/s] and force [N]: steps, reversals, taps.

    From the first knot's time, which is 0, to the last one's. Not bounded by the plate. ValueError where times do not rise.
    """
    times_s, velocities, forces = np.array(knots, dtype=np.float64).T
    if times_s[0] != 0 or (np.diff(times_s) <= 0).any():
        raise ValueError(f"the knots are at {', '.join(f'{t:g}' for t in times_s)} s, expected 0 and rising times")
    at = np.arange(round(times_s[-1] * rate_hz)) / rate_hz
    velocity, force = (np.interp(at, times_s, values) for values in (velocities, forces))
    position = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]))]) / rate_hz
    still = np.zeros_like(at)
    return Stroking(
        rate_hz, np.stack([position, still], axis=1), np.stack([velocity, still], axis=1), force, np.zeros((at.size, 2))
    )


def _movement(start: Array, rng: np.random.Generator) -> tuple[Array, float]:
    """Displacement [mm] and duration [s] of the next movement; its target is on the plate."""
    slow, fast = PEAK_SPEED_MM_S
    peak = slow * (fast / slow) ** (rng.random() ** SKEW)
    length = peak * rng.uniform(*STROKE_S) / PEAK_TO_MEAN
    angles = rng.uniform(0, 2 * np.pi, 24)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    edge = np.where(directions > 0, PLATE_MM - MARGIN_MM, MARGIN_MM)
    reach = np.min((edge - start) / directions, axis=1)
    enough = np.flatnonzero(reach >= length)
    chosen = enough[0] if enough.size else np.argmax(reach)
    length = min(length, reach[chosen])
    return length * directions[chosen], max(PEAK_TO_MEAN * length / peak, STROKE_S[0])


def _wander(times_s: Array, seconds: float, cutoff_hz: float, rng: np.random.Generator) -> Array:
    """Smooth noise of about unit variance: a cubic spline through white knots at twice the cutoff."""
    from scipy.interpolate import CubicSpline

    n_knots = int(2 * cutoff_hz * seconds) + 4
    return CubicSpline(np.arange(n_knots) / (2 * cutoff_hz), rng.standard_normal(n_knots))(times_s)
