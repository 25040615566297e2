"""When samples were taken: from a column of times, from what the file states, or from what the user says; and gaps in them.

Lost samples and lost rows of the hand's channels are filled with straight lines where that is asked for. A ValueError says what
is missing, ambiguous or impossible.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from foten.datasets.columns import Column
from foten.datasets.options import ImportOptions
from foten.datasets.units import factor_of, quantity
from foten.dsp import Array
from foten.recording.inspection.values import counted
from foten.recording.recording import Channel

JITTER = 0.01  # of a period: less, and times are called regular
FILLED = ("position", "speed", "force")  # the hand, which is slow; an acceleration is not invented


def times_of(
    channel: str, column: Column, clocks: Sequence[Column], options: ImportOptions
) -> tuple[Array | None, str]:
    """Times [s] of a channel's samples from the time column beside it, or None; and a sentence on their unit."""
    beside = [clock for clock in clocks if clock.file == column.file]
    fitting = [clock for clock in beside if clock.n_rows == column.n_rows]
    if not beside or (channel in options.rates_hz and not fitting):
        return None, ""
    if len(fitting) != 1:
        rows = ", ".join(f"{clock.name} {clock.n_rows}" for clock in beside)
        raise ValueError(
            f"{column.file.name}: {channel} has {column.n_rows} rows and time has {rows}; expected one time column "
            f"of equal length, or a rate: --rate {channel}=HZ"
        )
    clock = fitting[0]
    if channel in options.rates_hz:
        raise ValueError(f"{channel} has a time column ({clock.name}) and a --rate; give one of them")
    times = clock.samples[: column.samples.size]
    bad = np.flatnonzero(~np.isfinite(times))
    if bad.size or times.size < column.samples.size:
        at = int(bad[0]) if bad.size else times.size
        raise ValueError(f"{column.file.name}: the time is blank or NaN at sample {at}{clock.row_of(at)}")
    bad = np.flatnonzero(np.diff(times) <= 0)
    if bad.size:
        before, after = times[bad[0]], times[bad[0] + 1]
        what, hint = "goes back", "are the rows sorted?"
        if before == after:
            what, hint = "repeats", "are the times rounded? Leave time out and give --rate"
            if column.samples[bad[0]] == column.samples[bad[0] + 1]:
                hint = "is the row there twice? Delete one of the two"
        raise ValueError(
            f"{column.file.name}: the time {what} at sample {bad[0] + 1}{clock.row_of(int(bad[0]) + 1)}: {after:.9g} after "
            f"{before:.9g} ({counted(bad.size, 'such place')}); {hint}"
        )
    factor, sentence = factor_of("time", clock.name, clock.unit, options.units.get("time"))
    return times * factor, sentence


def rate_and_source(
    channel: str, column: Column, times: Array | None, options: ImportOptions, columns: Sequence[Column]
) -> tuple[float, str]:
    """Rate of a channel [Hz], and a sentence where it overrides what the file states."""
    stated = column.rate_hz
    if channel in options.rates_hz:
        rate = options.rates_hz[channel]
        if stated is None or abs(rate - stated) <= 1e-6 * rate:
            return rate, ""
        return rate, f"{channel} has the rate given, {rate:g} Hz; {column.file.name} states {stated:g} Hz"
    if times is not None:
        if times.size < 2:
            raise ValueError(f"{channel} has 1 sample, expected a recording")
        return rate_of(times), ""
    known = stated if stated is not None else options.rate_hz
    if known is not None:
        return known, ""
    scalars = [
        c for c in columns if c.samples.size == 1 and re.search(r"(^|[._])(fs|rate|sample_?rate|hz)$", c.name.lower())
    ]
    guess = f"{scalars[0].samples[0]:g}" if scalars else "10000"
    hint = f" (the file has {scalars[0].name} = {guess})" if scalars else ""
    raise ValueError(
        f"{channel}: {column.file.name} does not say how fast it was sampled; give --rate {guess} or --rate "
        f"{channel}={guess}{hint}, or map its time column: --map time=COLUMN"
    )


def rate_of(times: Array) -> float:
    """Rate of regular times, whole where their rounding allows it; else 1 / median step."""
    even = (times.size - 1) / (times[-1] - times[0])
    slack = 2 * _last_digit(times) / (times[-1] - times[0]) + 1e-9
    if irregular(times - times[0], even):
        even = 1 / float(np.median(np.diff(times)))
        slack = 1e-6
    return float(round(even)) if round(even) and abs(round(even) / even - 1) <= slack else float(even)


def _last_digit(times: Array) -> float:
    """Power of ten that all times are multiples of, 0 where there is none down to 1 ns."""
    for digits in range(10):
        scaled = times * 10.0**digits
        # Half a unit in the last place of a double grows with the number itself.
        if np.abs(scaled - np.round(scaled)).max() <= 1e-6 + 4e-16 * np.abs(scaled).max():
            return 10.0**-digits
    return float(np.spacing(np.float32(np.abs(times).max())))  # single precision somewhere on the way


def irregular(times: Array, rate_hz: float) -> str:
    """Reason why times that count from the recording's start are not i / rate, or nothing."""
    period = 1 / rate_hz
    tolerance = max(JITTER * period, min(_last_digit(times), period / 2))
    if abs(times[0]) > tolerance:
        return f"it starts at {times[0] * 1000:.4g} ms"
    if times.size > 1:
        even = np.arange(times.size) * ((times[-1] - times[0]) / (times.size - 1)) + times[0]
        worst = float(np.abs(times - even).max())
        if worst > tolerance:
            return f"samples lie up to {worst * 1000:.4g} ms from an even grid of {rate_hz:g} Hz"
    return ""


def filled(name: str, channel: Channel, gap_ms: float, column: Column) -> tuple[Channel, str]:
    """Channel without NaN, marker drop-outs filled with straight lines if asked, and a sentence.

    `column` is what the channel was taken from; it knows the rows of the samples.
    """
    samples, missing, clock = channel.samples, np.isnan(channel.samples), channel.times

    def place(sample: int) -> str:
        return f"{clock[sample]:.6g} s{column.row_of(sample)}"

    infinite = np.flatnonzero(np.isinf(samples))
    if infinite.size:
        n = infinite.size
        are = " is" if n == 1 else "s are"
        raise ValueError(f"{name}: {n} sample{are} infinite, the first at {place(int(infinite[0]))}")
    if not missing.any():
        return channel, ""
    first, count = int(missing.argmax()), int(missing.sum())
    what = f"{name}: {count} sample{' is' if count == 1 else 's are'} NaN or blank"
    if quantity(name) not in FILLED:
        raise ValueError(f"{what}, the first at {place(first)}; only position, speed and force may have gaps filled")
    starts, ends = np.flatnonzero(np.diff(missing, prepend=False, append=False)).reshape(-1, 2).T
    # A gap is as long as its lost samples: three of them at 100 Hz are 30 ms.
    lengths = (ends - starts) / channel.rate_hz
    if channel.times_s is not None:
        lengths = clock[np.minimum(ends, clock.size - 1)] - clock[starts]
    longest_ms = lengths.max() * 1000
    if gap_ms == 0:
        raise ValueError(
            f"{what} in {counted(starts.size, 'gap')}, the first at {place(first)}, the longest {longest_ms:.4g} ms; "
            f"--fill-gaps {max(1, int(np.ceil(longest_ms)))} would fill them"
        )
    if missing[0] or missing[-1]:
        end = "start" if missing[0] else "end"
        raise ValueError(f"{name}: NaN or blank at the {end}: nothing to draw a line from; cut the file there")
    long = np.flatnonzero(lengths > gap_ms / 1000 * (1 + 1e-9))
    if long.size:
        i = int(long[0])
        raise ValueError(
            f"{name}: of {counted(starts.size, 'gap')} {long.size} last longer than {gap_ms:g} ms, the first, at "
            f"{place(int(starts[i]))}, {lengths[i] * 1000:.4g} ms"
        )
    without = np.where(missing, np.interp(clock, clock[~missing], samples[~missing]), samples)
    return Channel(without, channel.rate_hz, channel.times_s), (
        f"{name}: {counted(starts.size, 'gap')} ({counted(count, 'sample')}, the longest {longest_ms:.4g} ms) filled "
        f"with straight lines, up to {gap_ms:g} ms allowed"
    )


def bridged(name: str, channel: Channel, gap_ms: float) -> tuple[Channel, str]:
    """Channel with the rows that its times say are missing filled in, if asked, and a sentence."""
    holes = channel.holes()
    if not holes.size or channel.times_s is None or quantity(name) not in FILLED:
        return channel, ""  # an acceleration at irregular times is refused before it is used
    steps = np.diff(channel.times_s)
    period = float(np.median(steps))
    lengths = steps[holes] - period  # as long as what was lost
    longest = int(lengths.argmax())
    places = counted(holes.size, "place")
    worst, since = lengths[longest] * 1000, channel.times_s[holes[longest]]
    what = f"{name}: rows are missing in {places}, the longest {worst:.4g} ms after {since:.4g} s"
    if worst > gap_ms + 1e-6:
        would = max(1, int(np.ceil(worst - 1e-6)))
        raise ValueError(f"{what}; --fill-gaps {would} would draw straight lines there, or cut the file")
    added = [
        np.linspace(channel.times_s[i], channel.times_s[i + 1], round(steps[i] / period), endpoint=False)[1:]
        for i in holes
    ]
    times = np.sort(np.concatenate([channel.times_s, *added]))
    samples = np.interp(times, channel.times_s, channel.samples)
    return Channel(samples, channel.rate_hz, times), (
        f"{what}; {counted(times.size - channel.times_s.size, 'sample')} on straight lines put there, up to {gap_ms:g} ms allowed"
    )
