"""Rows that are not in the order of time, from how speed, force and position jump."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from foten.recording.inspection.hand import HAND_HZ
from foten.recording.inspection.noise import slow_noise
from foten.recording.inspection.values import NOTE, PROBLEM, Finding, counted, places
from foten.recording.recording import UNITS, Channel, Recording


def check_order(recording: Recording) -> Iterable[Finding]:
    """Yield problems where rows are probably not in the order of time, and findings on single jumps.

    Rows in order hardly ever jump. Rows in a wrong order jump where pieces meet: at many places, in all slow channels at the
    same rows, over much of the range, and at multiples of the length where all pieces are equally long. A finding needs many
    jumps and one of the other three.
    """
    jumps = {
        name: _jumps(name, channel)
        for name, channel in recording.channels.items()
        if not name.startswith("acceleration") and channel.samples.size >= 100
    }
    many = {name: at for name, (at, _, _) in jumps.items() if at.size >= max(10, 0.001 * recording[name].samples.size)}
    for name, (at, least, size) in jumps.items():
        channel = recording[name]
        correlation = _neighbour_correlation(name, channel)
        if correlation < 0.8:
            text = (
                f"{name}: the rows are probably not in time order: neighbours have little to do with each other "
                f"(correlation {correlation:.2f}), where a hand moves smoothly; or it is noise alone"
            )
            yield Finding(PROBLEM, "order", name, text)
            continue
        if not at.size:
            continue
        shared = [
            other
            for other, there in many.items()
            if other != name
            and name in many
            and recording[other].samples.size == channel.samples.size
            # Many more common rows than chance gives.
            and np.isin(at, there).mean() > max(0.25, 3 * there.size / channel.samples.size)
        ]
        piece = _piece(at)
        if name not in many or not (shared or piece or size > 0.1):
            yield _single_jumps(name, channel, at, least)
            continue
        text = (
            f"{name}: the rows are probably not in time order: {at.size} jumps larger than {least:.3g} {UNITS[name]} between "
            f"neighbours, where a hand moves smoothly, typically {np.median(np.diff(at)):.0f} samples apart"
        )
        if piece:
            text += f", nearly all at multiples of {piece} samples, as if pieces of {piece} rows were shuffled"
        if shared:
            text += f"; {np.isin(at, many[shared[0]]).mean():.0%} of them at the same rows as in {shared[0]}"
        yield Finding(PROBLEM, "order", name, text, places(channel, at))


def _single_jumps(name: str, channel: Channel, at: NDArray[np.int64], least: float) -> Finding:
    text = (
        f"{name} jumps by more than {least:.3g} {UNITS[name]} between two samples in {counted(at.size, 'place')}, "
        "faster than a hand moves"
    )
    if name.startswith("position"):  # a jump of a position becomes a speed that was not there
        text += "; were lost markers written as 0? Blank them and import with --fill-gaps"
        return Finding(PROBLEM, "jumps", name, text, places(channel, at))
    return Finding(NOTE, "jumps", name, text, places(channel, at))


def _jumps(name: str, channel: Channel) -> tuple[NDArray[np.int64], float, float]:
    """Return the samples before each jump of a slow signal, the least size of a jump, and the median one by the range.

    A signal of range r that holds nothing above f moves at most π·f·r a second, as a sine of that range does. A jump exceeds
    that and the sensor's noise, and is a step: the samples on both sides of it move far less. Spikes are removed before.
    Positions move slower than speed and force: a stroke there and back takes 200 ms or more.
    """
    from scipy.ndimage import median_filter

    x = median_filter(channel.samples, 5, mode="nearest")
    swing = float(np.subtract(*np.quantile(x, [0.995, 0.005])))
    fastest_hz = HAND_HZ / 4 if name.startswith("position") else HAND_HZ
    # Eight standard deviations: no Gaussian noise steps as far in an hour at 10 kHz.
    noise = 8 * slow_noise(channel.samples)
    least = min(np.pi * fastest_hz * swing / channel.rate_hz, 0.5 * swing) + noise
    steps = np.abs(np.diff(x))
    around = np.lib.stride_tricks.sliding_window_view(np.pad(steps, 4, mode="reflect"), 9)
    at = np.flatnonzero(steps > least)
    at = at[steps[at] > 6 * np.median(around[at], axis=1)]
    return at, least, float(np.median(steps[at]) / swing) if at.size and swing else 0.0


def _neighbour_correlation(name: str, channel: Channel) -> float:
    """Return the correlation of neighbouring samples in a slow channel, 1 where it moves too little to say."""
    low, high = np.quantile(channel.samples, [0.005, 0.995])
    least = {"speed": 20.0, "force": 0.5, "force_z": 0.5, "position_x": 10.0, "position_y": 10.0}
    if channel.rate_hz < 100 or high - low < least.get(name, np.inf):
        return 1.0
    x = np.clip(channel.samples, low, high)  # so that a spike is not all there is
    return float(np.corrcoef(x[:-1], x[1:])[0, 1])


def _piece(jumps: NDArray[np.int64]) -> int:
    """Return the largest number of which 80 % of the jumps are multiples, up to a shift, or 0."""
    jumps = jumps[:500]
    best = 0
    # Fewer jumps, or lengths that fit into them only a few times, would agree by chance.
    if jumps.size >= 15:
        for length in range(3, min(2000, int(jumps[-1] - jumps[0]) // 4)):
            if np.bincount(jumps % length).max() > 0.8 * jumps.size:
                best = length
    return best
