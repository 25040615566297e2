"""The hand in a recording: its speed and force, losses of contact, signs, and the conditions that it covered."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.dsp.filters import butterworth, filter_recorded
from foten.dsp.kinematics import speed_of
from foten.recording.inspection.values import NOTE, PROBLEM, Coverage, Finding, counted, places, runs
from foten.recording.preprocess import WRONG_SIGN, PreprocessConfig, hand_of, times_of
from foten.recording.recording import Channel, Recording

CONTACT_N = 0.05  # less force is lift-off
MOVING_MM_S = 5.0  # less speed is rest
SHORTEST_LOSS_S = 0.005  # a shorter loss of contact is noise of the force sensor
HAND_HZ = 20.0  # a hand's movement holds nothing above; the low-pass of Sec. V-b
TRAINING_HZ = PreprocessConfig().rate_hz  # at which training synchronises speed and force
CELL_MM_S, CELL_N = 25.0, 0.5  # of the coverage
USUAL_MM_S, USUAL_N = (300.0, 5.0)  # largest speed and force in use; the coverage is larger where the recording is

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Hand:
    """Speed and force at `TRAINING_HZ` as training takes them, but zero-phase.

    Attributes:
        times_s: [s], shape (n,).
        speed: [mm/s], shape (n,).
        force: [N], shape (n,).
    """

    times_s: Array
    speed: Array
    force: Array

    @property
    def still(self) -> NDArray[np.bool_]:
        """Return where the tool rests or is lifted, shape (n,)."""
        return (self.speed < MOVING_MM_S) | (self.force < CONTACT_N)


def movement_channels(recording: Recording) -> list[str]:
    """Return the names of the channels that speed is taken from; empty where there is none."""
    names = ["speed"] if "speed" in recording else ["position_x", "position_y"]
    return [name for name in names if name in recording]


def force_channels(recording: Recording) -> list[str]:
    """Return the name of the channel that normal force is taken from; empty where there is none."""
    return [name for name in ("force", "force_z") if name in recording][:1]


def span(channel: Channel) -> tuple[float, float]:
    """Return when a channel starts and ends [s]."""
    start = 0.0 if channel.times_s is None else float(channel.times_s[0])
    return start, start + channel.duration_s


def hand_in(recording: Recording) -> Hand | None:
    """Return speed and force, None where one of them is missing or they share too little time.

    Raises:
        ValueError: training would refuse them, see `hand_of`.
    """
    moved, pressed = movement_channels(recording), force_channels(recording)
    if not moved or not pressed:
        return None
    channels = [*recording.axes("acceleration"), *(recording[name] for name in (*moved, *pressed))]
    starts, ends = zip(*map(span, channels), strict=True)
    start = max(starts)
    # The low-pass settles within 50 ms; at the ends it lacks the samples before and after.
    margin = round(TRAINING_HZ / HAND_HZ)
    if (min(ends) - start) * TRAINING_HZ < 4 * margin:
        return None
    velocity, normal = hand_of(recording, TRAINING_HZ)
    low = butterworth("lowpass", HAND_HZ, TRAINING_HZ)
    *slow, force = (filter_recorded(low, row, zero_phase=True)[margin:-margin] for row in (*velocity, normal))
    times = (np.ceil(start * TRAINING_HZ - 1e-6) + margin + np.arange(force.size)) / TRAINING_HZ
    return Hand(times, speed_of(np.stack(slow)), force)


def check_signs(recording: Recording) -> Iterable[Finding]:
    """Yield findings on negative speeds, forces counted the other way, and forces that pull."""
    if "speed" in recording:
        speed = recording["speed"]
        negative = np.flatnonzero(speed.samples < 0)
        if negative.size:
            lowest = speed.samples.min()
            text = (
                f"speed is negative in {counted(negative.size, 'sample')}, down to {lowest:.4g} mm/s: a speed has no sign; "
                "is it one axis of a velocity?"
            )
            severity = PROBLEM if lowest < -WRONG_SIGN[0] else NOTE
            yield Finding(severity, "sign", "speed", text, places(speed, negative))
    for name in force_channels(recording):
        if np.median(recording[name].samples) < 0:
            text = f"{name} is negative when pressing; pressing is counted positive"
            yield Finding(NOTE, "sign", name, text)
        low = float(np.quantile(_pressing(recording[name]), 0.001))
        if low < -0.2:
            text = f"{name} goes down to {low:.3g} N: has the sensor an offset, or does the tool pull?"
            yield Finding(NOTE, "sign", name, text)


def _pressing(channel: Channel) -> Array:
    """Return the force as captured, pressing positive [N], shape (n,); a low-pass would hide short losses of contact."""
    return -channel.samples if np.median(channel.samples) < 0 else channel.samples


def check_contact(recording: Recording, hand: Hand | None) -> Iterable[Finding]:
    """Yield a note where contact is lost while the tool moves."""
    for name in force_channels(recording):
        channel = recording[name]
        times, lost = times_of(channel), _pressing(channel) < CONTACT_N
        if hand is not None:
            lost = lost & (np.interp(times, hand.times_s, hand.speed) > MOVING_MM_S)
        starts, ends = runs(lost)
        lengths = (ends - starts) / channel.rate_hz
        starts, lengths = starts[lengths >= SHORTEST_LOSS_S], lengths[lengths >= SHORTEST_LOSS_S]
        if starts.size:
            longest = int(np.argmax(lengths))
            text = (
                f"contact is lost (force below {CONTACT_N:g} N while moving) in {counted(starts.size, 'place')}, "
                f"{lengths.sum():.3g} s together, the longest {lengths[longest]:.3g} s at {times[starts[longest]]:.2f} s"
            )
            yield Finding(NOTE, "contact", name, text, places(channel, starts))


def coverage_of(hand: Hand) -> Coverage | None:
    """Return the time spent at each speed and force while moving in contact; None where the tool never did."""
    v, f = hand.speed, hand.force
    stroking = (v > MOVING_MM_S) & (f > CONTACT_N)
    v, f = v[stroking], f[stroking]
    if v.size < 2:
        return None
    (v_low, v_high), (f_low, f_high) = (np.quantile(x, [0.001, 0.999]) for x in (v, f))

    def edges(high: float, cell: float, least: float) -> Array:
        # A spike must not stretch the range until all else is in one cell.
        top = min(max(least, high), 2 * least)
        return np.asarray(np.arange(0, np.ceil(top / cell - 1e-9) + 1) * cell, dtype=np.float64)

    speed_edges, force_edges = edges(v_high, CELL_MM_S, USUAL_MM_S), edges(f_high, CELL_N, USUAL_N)
    counts, _, _ = np.histogram2d(v, f, bins=[speed_edges, force_edges])
    beyond_s = (v.size - counts.sum()) / TRAINING_HZ
    ranges = (float(v_low), float(v_high)), (float(f_low), float(f_high))
    return Coverage(speed_edges, force_edges, counts / TRAINING_HZ, beyond_s, *ranges)


def check_ranges(coverage: Coverage) -> Iterable[Finding]:
    """Yield notes on speeds and forces in common use that the recording does not cover."""
    (slow, quick), (light, heavy) = coverage.speed_range, coverage.force_range
    fades = "below it the texture fades, it is not learnt"
    grows = "above it the level grows by a power law, it is not learnt"
    if slow > 30:
        yield Finding(NOTE, "range", "speed", f"never slower than {slow:.0f} mm/s: {fades}")
    if quick < 150:
        yield Finding(NOTE, "range", "speed", f"never faster than {quick:.0f} mm/s: {grows}")
    if light > 0.5:
        yield Finding(NOTE, "range", "force", f"never lighter than {light:.2g} N: {fades}")
    if heavy < 6:
        yield Finding(NOTE, "range", "force", f"force above {heavy:.2g} N never visited: {grows}")
    if coverage.fraction < 0.15:
        text = (
            f"only {coverage.fraction:.0%} of the plane up to {coverage.speed_edges[-1]:g} mm/s and "
            f"{coverage.force_edges[-1]:g} N was visited: vary speed and force separately when recording"
        )
        yield Finding(NOTE, "coverage", "", text)
