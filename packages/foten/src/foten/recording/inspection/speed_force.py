"""Speed and force in a recording: losses of contact, signs, and the conditions that it covered."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from foten.dsp import Array
from foten.dsp.filters import butterworth, filter_recorded
from foten.dsp.kinematics import speed_of
from foten.recording.inspection.values import NOTE, UNUSABLE, Coverage, Finding, places, runs
from foten.recording.preprocess import PreprocessConfig, pressing, velocity_and_force
from foten.recording.recording import Recording, common_span_s, counted

CONTACT_N = 0.05  # less force is lift-off
MOVING_MM_S = 5.0  # less speed is rest
MIN_LOSS_S = 0.005  # a shorter loss of contact is noise of the force sensor
HAND_HZ = 20.0  # a hand's movement holds nothing above; the low-pass of Sec. V-b
TRAINING_HZ = PreprocessConfig().rate_hz  # at which training synchronises speed and force
EXTREMES = (0.001, 0.999)  # quantiles that a range of speed or force reaches to
CELL_MM_S, CELL_N = 25.0, 0.5  # of the coverage
USUAL_MM_S, USUAL_N = (300.0, 5.0)  # largest speed and force in use; the coverage is larger where the recording is


@dataclass(frozen=True)
class SpeedForce:
    """Speed and force at `TRAINING_HZ` as training takes them, but zero-phase."""

    times_s: Array  # shape (n,)
    speed: Array  # [mm/s], shape (n,)
    force: Array  # [N], shape (n,)


def speed_force_of(recording: Recording) -> SpeedForce | None:
    """Speed and force; None where one is missing or they share too little time. Raises as `velocity_and_force` does."""
    if not recording.movement or not recording.normal_force:
        return None
    start_s, end_s = common_span_s(recording.used)
    # The low-pass settles within 50 ms; at the ends it lacks the samples before and after.
    margin = round(TRAINING_HZ / HAND_HZ)
    if (end_s - start_s) * TRAINING_HZ < 4 * margin:
        return None
    velocity, normal = velocity_and_force(recording, TRAINING_HZ)
    low = butterworth("lowpass", HAND_HZ, TRAINING_HZ)
    *filtered, force = (filter_recorded(low, row, zero_phase=True)[margin:-margin] for row in (*velocity, normal))
    times = (np.ceil(start_s * TRAINING_HZ - 1e-6) + margin + np.arange(force.size)) / TRAINING_HZ
    return SpeedForce(times, speed_of(np.stack(filtered)), force)


def check_signs(recording: Recording) -> Iterable[Finding]:
    """Yield notes on forces that are counted the other way, and on forces that pull."""
    for name in recording.normal_force:
        if np.median(recording[name].samples) < 0:
            yield Finding(NOTE, "sign", name, f"{name} is negative when pressing; pressing is counted positive")
        low = float(np.quantile(pressing(recording[name]), 0.001))
        if low < -0.2:
            text = f"{name} goes down to {low:.3g} N: has the sensor an offset, or does the tool pull?"
            yield Finding(NOTE, "sign", name, text)


def check_contact(recording: Recording, speed_force: SpeedForce | None) -> Iterable[Finding]:
    """Yield a note where contact is lost while the tool moves."""
    for name in recording.normal_force:
        channel = recording[name]
        times, lost = channel.times, pressing(channel) < CONTACT_N
        if speed_force is not None:
            lost = lost & (np.interp(times, speed_force.times_s, speed_force.speed) > MOVING_MM_S)
        starts, ends = runs(lost)
        lengths = (ends - starts) / channel.rate_hz
        lasting = lengths >= MIN_LOSS_S
        starts, lengths = starts[lasting], lengths[lasting]
        if starts.size:
            longest = int(np.argmax(lengths))
            lasts = f"{lengths.sum():.3g} s together, the longest {lengths[longest]:.3g} s at {times[starts[longest]]:.2f} s"
            where = f"(force below {CONTACT_N:g} N while moving) in {counted(starts.size, 'place')}"
            text = f"contact is lost {where}, {lasts}"
            yield Finding(NOTE, "contact", name, text, places(channel, starts))


def coverage_of(speed_force: SpeedForce) -> Coverage | None:
    """Time spent at each speed and force while moving in contact; None where the tool never did."""
    stroking = (speed_force.speed > MOVING_MM_S) & (speed_force.force > CONTACT_N)
    if stroking.sum() < 2:
        return None
    conditions, cells, ranges = (speed_force.speed[stroking], speed_force.force[stroking]), [], []
    for samples, cell, usual in zip(conditions, (CELL_MM_S, CELL_N), (USUAL_MM_S, USUAL_N), strict=True):
        low, high = np.quantile(samples, EXTREMES).tolist()
        ranges.append((low, high))
        top = min(max(usual, high), 2 * usual)
        cells.append(np.arange(0, np.ceil(top / cell - 1e-9) + 1) * cell)
    counts, *_ = np.histogram2d(*conditions, bins=cells)
    return Coverage(cells[0], cells[1], counts / TRAINING_HZ, ranges[0], ranges[1])


def at_rest(speed_force: SpeedForce) -> Finding:
    """Finding on a recording in which the tool never moves in contact."""
    quickest, heaviest = float(speed_force.speed.max()), float(speed_force.force.max())
    if quickest <= MOVING_MM_S:
        hint = "; was it given in m/s? Then import it with --unit speed=m/s" if quickest > 0.01 else ""
        text = f"speed never exceeds {quickest:.3g} mm/s, so the tool rests from begin to end{hint}"
        return Finding(UNUSABLE, "rest", "speed", text)
    if heaviest <= CONTACT_N:
        text = f"force never exceeds {heaviest:.3g} N, so the tool never presses: was the sensor on?"
        return Finding(UNUSABLE, "rest", "force", text)
    return Finding(UNUSABLE, "rest", "", "the tool never presses while it moves: do speed and force belong together?")


def check_ranges(coverage: Coverage) -> Iterable[Finding]:
    """Yield notes on speeds and forces in common use that the recording does not cover."""
    (slow, quick), (light, heavy) = coverage.speed_range, coverage.force_range
    fades = "below it the texture fades, it is not learnt"
    grows = "above it the level grows by a fitted power law, or is held, it is not learnt"
    if slow > 30:
        yield Finding(NOTE, "range", "speed", f"never slower than {slow:.0f} mm/s: {fades}")
    if quick < 150:
        yield Finding(NOTE, "range", "speed", f"never faster than {quick:.0f} mm/s: {grows}")
    if light > 0.5:
        yield Finding(NOTE, "range", "force", f"never lighter than {light:.2g} N: {fades}")
    if heavy < 6:
        yield Finding(NOTE, "range", "force", f"force above {heavy:.2g} N never visited: {grows}")
    if not coverage.fraction:
        held = f"{coverage.speed_in_words} and {coverage.force_in_words}"
        text = f"nothing of the plane up to {coverage.speed_edges[-1]:g} mm/s and {coverage.force_edges[-1]:g} N was visited"
        yield Finding(UNUSABLE, "coverage", "", f"{text}, only {held}: are the units right?")
    elif coverage.fraction < 0.15:
        conditions = f"the plane up to {coverage.speed_edges[-1]:g} mm/s and {coverage.force_edges[-1]:g} N"
        text = f"only {coverage.fraction:.0%} of {conditions} was visited: vary speed and force separately"
        yield Finding(NOTE, "coverage", "", text)
