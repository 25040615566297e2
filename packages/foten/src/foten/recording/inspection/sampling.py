"""Checks of how a recording was sampled: missing channels, durations, gaps, repeated values, rows in a wrong order."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from foten.recording.inspection.one_channel import slow_noise
from foten.recording.inspection.speed_force import HAND_HZ
from foten.recording.inspection.values import NOTE, PROBLEM, UNUSABLE, Finding, places, swing
from foten.recording.preprocess import MIN_ALONE_S, PreprocessConfig
from foten.recording.recording import UNITS, Channel, Recording, counted
from foten.recording.split import MIN_BLOCKS

MIN_STILL_S = 0.1  # of a position, that a hand which turns round does not take
MAX_JITTER = 0.05  # of the sampling period, its median deviation


def check_missing(recording: Recording) -> Iterable[Finding]:
    """Yield problems where acceleration, speed or force is missing, or the acceleration slower than the default rate."""
    axes = recording.axes("acceleration")
    if not axes:
        yield Finding(UNUSABLE, "missing", "acceleration", "there is no acceleration to learn from")
    elif axes[0].rate_hz < PreprocessConfig().rate_hz:
        rate = f"{axes[0].rate_hz:g}"
        text = f"acceleration was captured at {rate} Hz and is never upsampled: train with --rate {rate} or lower"
        yield Finding(PROBLEM, "rate", "acceleration", text)
    if not recording.movement:
        yield Finding(UNUSABLE, "missing", "speed", "there is no speed, and no position to take it from")
    if not recording.normal_force:
        yield Finding(UNUSABLE, "missing", "force", "there is no normal force (force or force_z)")


def check_durations(recording: Recording) -> Iterable[Finding]:
    """Yield notes where a channel covers less time than others do."""
    starts, ends = np.array([channel.span_s for channel in recording.channels.values()]).T
    first, last = starts.min(), ends.max()
    slack = max(0.05, 0.01 * last)
    for name, start, end in zip(recording.channels, starts, ends, strict=True):
        if start > first + slack or end < last - slack:
            covers = f"{name} covers {start:.2f} to {end:.2f} s, of {first:.2f} to {last:.2f} s"
            text = f"{covers}: training uses the common part; are all rates right?"
            yield Finding(NOTE, "durations", name, text)


def check_short(seconds: float, options: str) -> Iterable[Finding]:
    """Yield a note where all channels cover too little for a cut that is chosen unasked, with the options that fit if any do."""
    config = PreprocessConfig()
    if seconds < min(MIN_ALONE_S, config.shortest_s):
        advice = f"train with {options}" if options else "too short to learn from; record for longer"
        needs = f"{config.trim_ms / 1000:g} s off both ends, {MIN_BLOCKS} blocks of {config.block_ms / 1000:g} s"
        text = f"it lasts {seconds:.2f} s, and {needs} take {config.shortest_s:g} s: {advice}"
        yield Finding(NOTE if options else UNUSABLE, "short", "", text)


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
        lasts = f"{steps[longest] * 1000:.4g} ms at {channel.times_s[longest]:.3f} s"
        text = f"{name}: {counted(gaps.size, 'gap')} in time, about {lost} samples lost; the longest lasts {lasts}"
        severity = PROBLEM if name.startswith("acceleration") or steps[longest] > 0.1 else NOTE
        yield Finding(severity, "gaps", name, text, places(channel, gaps))
    if (jitter := np.median(np.abs(steps - usual))) > MAX_JITTER * usual:
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
        captured_hz = channel.rate_hz / usual
        text = f"{name} changes only every {usual} samples: it was captured at {captured_hz:.4g} Hz and each value repeated"
        yield Finding(NOTE, "repeated", name, text)
        return
    # A quantised slow signal pauses often and briefly; a sensor that fell silent pauses rarely and long.
    # A hand that turns round stands still for a moment, to the last digit of a tracker.
    least = MIN_STILL_S * channel.rate_hz if name.startswith("position") else 10.0
    long = np.flatnonzero(steps > max(least, 10 * float(np.quantile(steps, 0.99))))
    frozen = x[changes[long]]
    long = long[(frozen != 0) & (frozen < x.max()) & (frozen > x.min())]
    if long.size:
        longest = f"the longest for {steps[long].max() / channel.rate_hz * 1000:.4g} ms"
        text = f"{name} stands still to the last digit in {counted(long.size, 'place')}, {longest}: did the sensor fall silent?"
        severity = PROBLEM if name.startswith("acceleration") else NOTE
        yield Finding(severity, "frozen", name, text, places(channel, changes[long]))


def check_order(recording: Recording) -> Iterable[Finding]:
    """Yield problems where rows are probably not in the order of time, and findings on single jumps.

    Rows in a wrong order jump at many places, and in all slow channels at the same rows, over much of the range, or at
    multiples of a length. A finding needs many jumps and one of the other three.
    """
    channels = recording.channels.items()
    slow = {name: c for name, c in channels if not name.startswith("acceleration") and c.samples.size >= 100}
    jumps = {name: _jumps(name, channel) for name, channel in slow.items()}
    many = {name: at for name, (at, _, _) in jumps.items() if at.size >= max(10, 0.001 * slow[name].samples.size)}
    for name, channel in slow.items():
        at, threshold, share = jumps[name]
        evidence = []
        if (correlation := _neighbour_correlation(name, channel)) < 0.8:
            evidence.append(f"neighbours correlate by {correlation:.2f}: no smooth movement, or noise alone")
        if name in many and share > 0.1:
            evidence.append(f"{at.size} jumps by {share:.0%} of its range, faster than a hand moves")
        if name in many and (piece := _piece(at)):
            evidence.append(f"jumps at multiples of {piece} samples, as if pieces of {piece} rows were shuffled")
        # The axes of one sensor jump together under any impact; different sensors do where rows were shuffled.
        sensor = name.split("_")[0]
        for other in [other for other in many if other.split("_")[0] != sensor and name in many]:
            common = np.isin(at, many[other]).mean()
            is_beside = slow[other].samples.size == channel.samples.size
            if is_beside and common > max(0.25, 3 * many[other].size / channel.samples.size):
                evidence.append(f"{common:.0%} of its jumps at the same rows as in {other}")
        what, where = f"jumps by more than {threshold:.3g} {UNITS[name]}", counted(at.size, "place")
        if evidence:
            text = f"{name}: the rows are probably not in time order: {'; '.join(evidence)}"
            yield Finding(PROBLEM, "order", name, text, places(channel, at))
        elif at.size and name.startswith("position"):  # a jump of a position becomes a speed that was not there
            text = f"{name} {what} in {where}; were lost markers written as 0? Blank them and import with --fill-gaps"
            yield Finding(PROBLEM, "jumps", name, text, places(channel, at))
        elif at.size:
            text = f"{name} {what} in {where}, faster than a hand moves; nothing to do where the sensor feels the vibration"
            yield Finding(NOTE, "jumps", name, text, places(channel, at))


def _jumps(name: str, channel: Channel) -> tuple[NDArray[np.int64], float, float]:
    """Samples before each jump of a slow signal, the smallest size of a jump, and the median one by the range.

    A sine of range r and frequency f moves at most π·f·r a second. A jump exceeds that and the sensor's noise, and the samples
    on both sides of it move far less. A stroke there and back takes 200 ms or more, so positions move slower.
    """
    from scipy.ndimage import median_filter

    x = median_filter(channel.samples, 5, mode="nearest")
    spread = swing(x, 0.005)
    fastest_hz = HAND_HZ / 4 if name.startswith("position") else HAND_HZ
    # Eight standard deviations: no Gaussian noise steps as far in an hour at 10 kHz.
    noise = 8 * slow_noise(channel.samples)
    threshold = min(np.pi * fastest_hz * spread / channel.rate_hz, 0.5 * spread) + noise
    steps = np.abs(np.diff(x))
    around = np.lib.stride_tricks.sliding_window_view(np.pad(steps, 4, mode="reflect"), 9)
    at = np.flatnonzero(steps > threshold)
    at = at[steps[at] > 6 * np.median(around[at], axis=1)]
    return at, threshold, float(np.median(steps[at]) / spread) if at.size and spread else 0.0


def _neighbour_correlation(name: str, channel: Channel) -> float:
    """Correlation of neighbouring samples in a slow channel, 1 where it moves too little to say."""
    low, high = np.quantile(channel.samples, [0.005, 0.995])
    threshold = {"speed": 20.0, "force": 0.5, "force_z": 0.5, "position_x": 10.0, "position_y": 10.0}
    if channel.rate_hz < 100 or high - low < threshold.get(name, np.inf):
        return 1.0
    x = np.clip(channel.samples, low, high)  # so that a spike is not all there is
    return float(np.corrcoef(x[:-1], x[1:])[0, 1])


def _piece(jumps: NDArray[np.int64]) -> int:
    """Largest number of which 80 % of the jumps are multiples, up to a shift, or 0."""
    jumps = jumps[:500]
    # Fewer jumps, or lengths that fit into them only a few times, would agree by chance.
    if jumps.size < 15:
        return 0
    lengths = range(3, min(2000, int(jumps[-1] - jumps[0]) // 4))
    return max((length for length in lengths if np.bincount(jumps % length).max() > 0.8 * jumps.size), default=0)
