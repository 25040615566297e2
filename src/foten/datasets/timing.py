"""When samples were taken: from a column of times, from what the file states, or from what the user says."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from foten.datasets.columns import Column
from foten.datasets.options import ImportOptions
from foten.datasets.units import factor_of

JITTER = 0.01  # of a period: less, and times are called regular


def times_of(
    channel: str, path: Path, column: Column, clocks: Sequence[tuple[Path, Column]], options: ImportOptions
) -> tuple[NDArray[np.float64] | None, str]:
    """Return the times [s] of a channel's samples from the time column beside it, or None; and a sentence on their unit.

    Raises:
        ValueError: no column fits, or its times do not rise.
    """
    own = [clock for place, clock in clocks if place == path]
    fitting = [clock for clock in own if clock.n_rows == column.n_rows]
    if not own:
        return None, ""
    if len(fitting) != 1:
        rows = ", ".join(f"{clock.name} {clock.n_rows}" for clock in own)
        if channel in options.rates_hz and not fitting:
            return None, ""
        raise ValueError(
            f"{path.name}: {channel} has {column.n_rows} rows and time has {rows}; expected one time column "
            f"of equal length, or a rate: --rate {channel}=HZ"
        )
    if channel in options.rates_hz:
        raise ValueError(f"{channel} has a time column ({fitting[0].name}) and a --rate; give one of them")
    clock = fitting[0]
    times = clock.samples[: column.samples.size]
    if times.size < column.samples.size or not np.isfinite(times).all():
        bad = int(np.flatnonzero(~np.isfinite(times))[0]) if not np.isfinite(times).all() else times.size
        raise ValueError(f"{path.name}: the time is blank or NaN at sample {bad}")
    steps = np.diff(times)
    bad_steps = np.flatnonzero(steps <= 0)
    if bad_steps.size:
        i = int(bad_steps[0])
        what = "repeats" if steps[i] == 0 else "goes back"
        hint = "are the times rounded? Leave time out and give --rate" if steps[i] == 0 else "are the rows sorted?"
        raise ValueError(
            f"{path.name}: the time {what} at sample {i + 1}: {times[i + 1]:.9g} after {times[i]:.9g} "
            f"({bad_steps.size} such places); {hint}"
        )
    factor, said = factor_of("time", clock.name, clock.unit, options.units.get("time"))
    return times * factor, said


def rate_and_source(
    channel: str,
    path: Path,
    column: Column,
    times: NDArray[np.float64] | None,
    options: ImportOptions,
    columns: Sequence[Column],
) -> tuple[float, str]:
    """Return a channel's rate [Hz], and a sentence where it overrides what the file states.

    Raises:
        ValueError: neither the file nor the user states one.
    """
    if channel in options.rates_hz:
        rate = options.rates_hz[channel]
        if column.rate_hz is not None and abs(rate - column.rate_hz) > 1e-6 * rate:
            return (rate, f"{channel} has the rate given, {rate:g} Hz; {path.name} states {column.rate_hz:g} Hz")
        return rate, ""
    if times is not None:
        if times.size < 2:
            raise ValueError(f"{channel} has 1 sample, expected a recording")
        return rate_of(times), ""
    if column.rate_hz is not None:
        return column.rate_hz, ""
    if options.rate_hz is not None:
        return options.rate_hz, ""
    scalars = [
        c for c in columns if c.samples.size == 1 and re.search(r"(^|[._])(fs|rate|sample_?rate|hz)$", c.name.lower())
    ]
    guess = f"{scalars[0].samples[0]:g}" if scalars else "10000"
    hint = f" (the file has {scalars[0].name} = {guess})" if scalars else ""
    raise ValueError(
        f"{channel}: {path.name} does not say how fast it was sampled; give --rate {guess} or --rate "
        f"{channel}={guess}{hint}, or map its time column: --map time=COLUMN"
    )


def rate_of(times: NDArray[np.float64]) -> float:
    """Return the rate of regular times, whole where their rounding allows it; else 1 / median step."""
    even = (times.size - 1) / (times[-1] - times[0])
    slack = 2 * _last_digit(times) / (times[-1] - times[0]) + 1e-9
    if irregular(times - times[0], even):
        even = 1 / float(np.median(np.diff(times)))
        slack = 1e-6
    return float(round(even)) if round(even) and abs(round(even) / even - 1) <= slack else float(even)


def _last_digit(times: NDArray[np.float64]) -> float:
    """Return the power of ten that all times are multiples of, 0 where there is none down to 1 ns."""
    for digits in range(10):
        scaled = times * 10.0**digits
        # Half a unit in the last place of a double grows with the number itself.
        if np.abs(scaled - np.round(scaled)).max() <= 1e-6 + 4e-16 * np.abs(scaled).max():
            return 10.0**-digits
    return float(np.spacing(np.float32(np.abs(times).max())))  # single precision somewhere on the way


def irregular(times: NDArray[np.float64], rate_hz: float) -> str:
    """Return why times that count from the recording's start are not i / rate, or nothing."""
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
