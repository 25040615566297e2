"""Times and rate of samples, from a column, the file or the user, and gaps in them; ValueError where they are impossible."""

import re
import shlex
from collections.abc import Sequence

import numpy as np

from foten.datasets.bounds import MAX_FILLED
from foten.datasets.columns import Column
from foten.datasets.options import ImportOptions
from foten.datasets.units import factor_of, quantity
from foten.dsp import Array
from foten.recording.recording import Channel, counted

MAX_JITTER = 0.01  # of a period, in regular times
MIN_VALUES = 10  # of a sensor slower than the rows
MAX_OFF = 0.25  # of its period, that its values may lie from an even grid; a lost one leaves half a period
FILLED = ("position", "speed", "force")  # quantities that change slowly


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
    is_rate = re.compile(r"(^|[._])(fs|rate|sample_?rate|hz)$", re.IGNORECASE)
    scalars = [c for c in columns if c.samples.size == 1 and is_rate.search(c.name)]
    guess = f"{scalars[0].samples[0]:g}" if scalars else "HZ"
    hint = f" (the file has {scalars[0].name} = {guess})" if scalars else ""
    clocks = [c.name for c in columns if c is not column and c.n_rows == column.n_rows and rises(c)]
    clock = "add a time column to the mapping: time=COLUMN"
    if clocks:
        mapping = ",".join(f"{name}={reference}" for name, reference in (("time", clocks[0]), *options.mapping))
        clock = f"{clocks[0]} always rises: if it is the time, --map {shlex.quote(mapping)}"
    raise ValueError(
        f"{channel}: {column.file.name} does not say how fast it was sampled; {clock}; or give --rate {guess}, of this "
        f"channel alone --rate {channel}={guess}{hint}"
    )


def rises(column: Column) -> bool:
    """Whether a column always rises, as a time does."""
    return column.samples.size > 1 and bool((np.diff(column.samples) > 0).all())


def rate_of(times: Array) -> float:
    """Rate of regular times, whole where their rounding allows it; else 1 / median step."""
    span = max(float(times[-1] - times[0]), 1e-290)  # so that no rate is beyond a float64
    even = (times.size - 1) / span
    slack = 2 * _last_digit(times) / span + 1e-9
    if irregular(times - times[0], even):
        even = 1 / max(float(np.median(np.diff(times))), 1e-290)
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


def of_slower_sensor(channel: Channel) -> tuple[Channel, float]:
    """Channel without its blank rows where the others are those of a sensor slower than the rows; and rows from value to value.

    They are where all lie within a row of a straight line in time, and nearer to it than a lost value would leave them.
    """
    known, times = np.flatnonzero(~np.isnan(channel.samples)), channel.times
    if known.size < MIN_VALUES or known.size == channel.samples.size:
        return channel, 1.0
    number, first = np.arange(known.size), times[known[0]]
    period, offset = np.polyfit(number, times[known] - first, 1).tolist()
    row = float(np.median(np.diff(times)))
    even = first + offset + period * number
    if np.abs(times[known] - even).max() > min(row, MAX_OFF * period):
        return channel, 1.0
    # The ends are known to a row, so the rate to two rows in the whole.
    rate_hz = (
        float(round(1 / period)) if abs(round(1 / period) * period - 1) * known.size * period <= 2 * row else 1 / period
    )
    return Channel(channel.samples[known], rate_hz, even), float(np.diff(known).mean())


def irregular(times: Array, rate_hz: float) -> str:
    """Reason why times that count from the recording's start are not i / rate, or nothing."""
    period = 1 / rate_hz
    tolerance = max(MAX_JITTER * period, min(_last_digit(times), period / 2))
    if abs(times[0]) > tolerance:
        return f"it starts at {times[0] * 1000:.4g} ms"
    if times.size > 1:
        even = np.arange(times.size) * ((times[-1] - times[0]) / (times.size - 1)) + times[0]
        worst = float(np.abs(times - even).max())
        if worst > tolerance:
            return f"samples lie up to {worst * 1000:.4g} ms from an even grid of {rate_hz:g} Hz"
    return ""


def filled(name: str, channel: Channel, gap_ms: float, column: Column) -> tuple[Channel, str]:
    """Channel whose gaps are straight lines, and a sentence on them; refused where they are longer than allowed.

    A gap is of samples that are NaN, and in position, speed and force of rows that the times leave out, too. `gap_ms` is the
    longest that is filled; `column` has the row numbers.
    """
    samples, times, fills = channel.samples, channel.times, quantity(name) in FILLED
    known = np.flatnonzero(~np.isnan(samples))

    def place(sample: int) -> str:
        in_rows = samples.size == column.samples.size  # a slower sensor's are not
        return f"{times[sample]:.6g} s{column.row_of(sample) if in_rows else ''}"

    infinite = np.flatnonzero(np.isinf(samples))
    if infinite.size:
        n_infinite = counted(infinite.size, "infinite sample")
        raise ValueError(f"{name} has {n_infinite}, the first at {place(int(infinite[0]))}")
    if not known.size or known[0] > 0 or known[-1] < samples.size - 1:
        end = "start" if np.isnan(samples[0]) else "end"
        raise ValueError(f"{name} is NaN or blank at its {end}: nothing to draw a line from; cut the file there")
    holes = channel.holes() if fills else known[:0]
    is_gap = np.diff(known) > 1
    is_gap[np.searchsorted(known, holes, side="right") - 1] = True
    if not is_gap.any():
        return channel, ""
    steps = np.diff(times)
    period = float(np.median(steps))
    longest_ms = 1000 * float(np.diff(times[known])[is_gap].max() - period)
    what = (
        f"{name}: samples are missing, NaN or blank in {counted(int(is_gap.sum()), 'gap')}, the longest {longest_ms:.4g} ms, "
        f"the first after {place(int(known[:-1][is_gap][0]))}"
    )
    if not fills:
        raise ValueError(f"{what}; only position, speed and force may have gaps filled")
    if longest_ms > gap_ms + 1e-6:
        would = max(1, int(np.ceil(longest_ms - 1e-6)))
        raise ValueError(
            f"{what}; --fill-gaps {would} would draw straight lines there; or cut the table there and import the pieces as "
            "takes, with --append"
        )
    if not (n_added := float((steps[holes] / period).sum())) <= MAX_FILLED:
        raise ValueError(f"{what}; {n_added:.3g} samples would fill them, expected {MAX_FILLED:,} at most")
    added = [np.linspace(times[i], times[i + 1], round(steps[i] / period), endpoint=False)[1:] for i in holes]
    evened = np.sort(np.concatenate([times, *added]))
    of_line = np.interp(evened, times[known], samples[known])
    n_filled = counted(evened.size - known.size, "sample")
    return Channel(of_line, channel.rate_hz, None if channel.times_s is None else evened), (
        f"{what}; {n_filled} on straight lines put there, up to {gap_ms:g} ms allowed"
    )
