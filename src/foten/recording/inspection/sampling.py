"""Checks of how a recording was sampled: missing channels, rates, durations, gaps in time, repeated values."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from foten.recording.inspection.hand import force_channels, movement_channels, span
from foten.recording.inspection.values import NOTE, PROBLEM, Finding, counted, places
from foten.recording.preprocess import PreprocessConfig
from foten.recording.recording import Channel, Recording

FEWEST_BLOCKS = 5  # that a split needs


def check_missing(recording: Recording) -> Iterable[Finding]:
    """Yield problems where acceleration, speed or force is missing, or the acceleration slower than the default rate."""
    axes = recording.axes("acceleration")
    if not axes:
        text = "there is no acceleration: nothing to learn from; speed and force can still drive a renderer"
        yield Finding(PROBLEM, "missing", "acceleration", text)
    elif axes[0].rate_hz < PreprocessConfig().rate_hz:
        text = (
            f"acceleration was captured at {axes[0].rate_hz:g} Hz and is never upsampled: train with "
            f"--rate {axes[0].rate_hz:g} or lower"
        )
        yield Finding(PROBLEM, "rate", "acceleration", text)
    if not movement_channels(recording):
        yield Finding(PROBLEM, "missing", "speed", "there is no speed, and no position to take it from")
    if not force_channels(recording):
        yield Finding(PROBLEM, "missing", "force", "there is no normal force (force or force_z)")


def check_durations(recording: Recording) -> Iterable[Finding]:
    """Yield notes where channels cover different times, or all of them too little."""
    spans = {name: span(channel) for name, channel in recording.channels.items()}
    fast = next((name for name in recording.channels if name.startswith("acceleration")), "")
    outside = set()
    for name in [*movement_channels(recording), *force_channels(recording)] if fast else []:
        (start, end), (first, last) = spans[name], spans[fast]
        if recording[name].times_s is not None and (start > first + 0.05 or end < last - 0.05):
            outside.add(name)
            text = f"{name} covers {start:.2f} to {end:.2f} s, {fast} {first:.2f} to {last:.2f} s: training uses the common part"
            yield Finding(NOTE, "span", name, text)
    ends = {name: end for name, (_, end) in spans.items() if name not in outside}
    early, late = min(ends, key=lambda name: ends[name]), max(ends, key=lambda name: ends[name])
    if ends[late] - ends[early] > max(0.05, 0.01 * ends[late]):
        text = (
            f"{early} ends at {ends[early]:.3f} s and {late} at {ends[late]:.3f} s; only the common part is used; "
            "are both rates right?"
        )
        yield Finding(NOTE, "durations", early, text)
    config = PreprocessConfig()
    common = min(end for _, end in spans.values()) - max(start for start, _ in spans.values())
    needed = (2 * config.trim_ms + FEWEST_BLOCKS * config.block_ms) / 1000
    if common < needed:
        text = (
            f"it lasts {common:.2f} s, and trimming {config.trim_ms / 1000:g} s at both ends and {FEWEST_BLOCKS} blocks of "
            f"{config.block_ms / 1000:g} s take {needed:g} s: train with a shorter --trim and --block"
        )
        yield Finding(NOTE, "short", "", text)


def check_gaps(name: str, channel: Channel) -> Iterable[Finding]:
    """Yield findings on lost samples and on unsteady sampling, from the times of a channel."""
    if channel.times_s is None or channel.times_s.size < 3:
        return
    steps = np.diff(channel.times_s)
    usual = float(np.median(steps))
    gaps = channel.holes()
    if gaps.size:
        longest = int(gaps[np.argmax(steps[gaps])])
        lost = int(np.round(steps[gaps] / usual - 1).sum())
        text = (
            f"{name}: {counted(gaps.size, 'gap')} in time, about {lost} samples lost; the longest lasts "
            f"{steps[longest] * 1000:.4g} ms at {channel.times_s[longest]:.3f} s"
        )
        severity = PROBLEM if name.startswith("acceleration") or steps[longest] > 0.1 else NOTE
        yield Finding(severity, "gaps", name, text, places(channel, gaps))
    jitter = float(np.median(np.abs(steps - usual)))
    if jitter > 0.05 * usual:
        text = f"{name}: its sampling period of {usual * 1000:.4g} ms varies by {jitter / usual:.0%}"
        yield Finding(NOTE, "jitter", name, text)


def check_repeats(name: str, channel: Channel) -> Iterable[Finding]:
    """Yield a finding where each value is repeated several times, or the last one kept while a sensor was silent."""
    x = channel.samples
    if x.size < 100 or x.min() == x.max():
        return
    changes = np.flatnonzero(np.diff(x)) + 1
    steps = np.diff(changes)
    if steps.size < 20:
        return
    usual = int(np.median(steps))
    if usual >= 2 and np.mean(steps == usual) > 0.8:
        text = (
            f"{name} changes only every {usual} samples: it was captured at {channel.rate_hz / usual:.4g} Hz "
            "and each value repeated"
        )
        yield Finding(NOTE, "repeated", name, text)
        return
    # A quantised slow signal pauses often and briefly; a sensor that fell silent pauses rarely and long.
    long = np.flatnonzero(steps > max(10.0, 10 * float(np.quantile(steps, 0.99))))
    kept = x[changes[long]]
    long = long[(kept != 0) & (kept < x.max()) & (kept > x.min())]
    if long.size:
        text = (
            f"{name} stands still to the last digit in {counted(long.size, 'place')}, the longest for "
            f"{steps[long].max() / channel.rate_hz * 1000:.4g} ms: did the sensor fall silent?"
        )
        severity = PROBLEM if name.startswith("acceleration") else NOTE
        yield Finding(severity, "frozen", name, text, places(channel, changes[long]))
