"""Bounds of a recording: beyond them a file is damaged, or a rate or a unit is wrong, and a check raises a ValueError."""

from collections.abc import Mapping

import numpy as np

from foten.datasets.units import quantity
from foten.dsp import Array
from foten.recording.inspection.one_channel import unit_doubt
from foten.recording.recording import LIMITS, UNITS, Channel, counted

MAX_SAMPLE = 1e12  # of a sample in any unit; a converter of 32 bits counts to 4e9
MAX_DURATION_S = 7200.0  # of a channel: two hours
MIN_DURATION_S = 0.1
MIN_RATE_HZ, MAX_RATE_HZ = 1.0, 1e7  # on average; of the steps between samples
MAX_FILLED = 10_000_000  # samples on lines between those of a file


def check_size(where: str, samples: Array) -> None:
    """Check that samples or times are not beyond `MAX_SAMPLE`: their sums and squares stay finite."""
    largest = int(np.abs(samples).argmax())
    if abs(samples[largest]) > MAX_SAMPLE:
        raise ValueError(f"{where}: sample {largest} is {samples[largest]:.4g}, expected below {MAX_SAMPLE:g}")


def check_length(where: str, channel: Channel) -> None:
    """Check that a channel lasts no longer than a hand strokes, and has a rate that a sensor has."""
    if channel.rate_hz > MAX_RATE_HZ:
        raise ValueError(f"{where}: the rate is {channel.rate_hz:g} Hz, expected {MAX_RATE_HZ:g} at most; is it right?")
    longest_s = min(MAX_DURATION_S, channel.samples.size / MIN_RATE_HZ)
    if not channel.duration_s <= longest_s:
        lasts = f"{counted(channel.samples.size, 'sample')} at {channel.rate_hz:g} Hz, {channel.duration_s:.4g} s"
        hint = "is the rate right, or was the time given in ms?"
        raise ValueError(f"{where}: {lasts}, expected {longest_s:g} s at most; {hint}")
    if channel.span_s[0] > MAX_DURATION_S:
        raise ValueError(
            f"{where}: it starts at {channel.span_s[0]:g} s, expected {MAX_DURATION_S:g} at most: subtract its first time"
        )


def check_overlap(channels: Mapping[str, Channel]) -> None:
    """Check that no channel starts when another has ended."""
    starts, ends = ({name: channel.span_s[k] for name, channel in channels.items()} for k in (0, 1))
    late, early = max(starts, key=lambda name: starts[name]), min(ends, key=lambda name: ends[name])
    if starts[late] >= ends[early]:
        when = f"{starts[late]:.6g} s, when {early} has ended ({ends[early]:.6g} s)"
        hint = "were their clocks different? If they were started together, leave time out and give --rate"
        raise ValueError(f"{late} starts at {when}; {hint}")


def check_channel(name: str, channel: Channel, force_units: bool) -> str:
    """Check a channel's length and values; return a sentence where values beyond the limits were let through."""
    check_size(name, channel.samples)
    check_length(name, channel)
    kind, unit = quantity(name), UNITS[name]
    size, limit = np.abs(channel.samples), LIMITS[kind]
    n_beyond, largest = int((size > limit).sum()), int(size.argmax())
    what = f"{name} reaches {channel.samples[largest]:.6g} {unit} at sample {largest}"
    if n_beyond and not force_units:
        if n_beyond <= 0.01 * size.size:
            raise ValueError(
                f"{what}, beyond any hand ({limit:g} {unit}), in {n_beyond} of {size.size} samples: "
                "spikes? --force-units imports them as they are, and foten inspect shows where"
            )
        raise ValueError(
            f"{what}, expected below {limit:g} {unit}; {name} {unit_doubt(kind, float(np.quantile(size, 0.99)))} "
            f"Give its unit, or the sensitivity of a raw reading: --unit {name}=V*FACTOR (--force-units imports it all the same)"
        )
    if channel.duration_s < MIN_DURATION_S:
        raise ValueError(
            f"{name} is too short: {counted(size.size, 'sample')} at {channel.rate_hz:g} Hz, {channel.duration_s * 1000:.3g} ms, "
            f"expected {MIN_DURATION_S * 1000:g} ms or more; is the rate right?"
        )
    if not n_beyond:
        return ""
    return f"{what}; {counted(n_beyond, 'sample')} beyond {limit:g} {unit} let through (--force-units)"
