"""Gaps in the hand's channels: lost samples and lost rows, filled with straight lines where that is asked for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foten.datasets.units import quantity
from foten.recording.recording import Channel

FILLED = ("position", "speed", "force")  # the hand, which is slow; an acceleration is not invented


def filled(
    channel: str, samples: NDArray[np.float64], times: NDArray[np.float64] | None, rate_hz: float, gap_ms: float
) -> tuple[NDArray[np.float64], str]:
    """Return samples without NaN, marker drop-outs filled with straight lines if asked, and a sentence.

    Raises:
        ValueError: samples are infinite, or missing where or for longer than they may be filled.
    """
    infinite = np.flatnonzero(np.isinf(samples))
    if infinite.size:
        raise ValueError(f"{channel}: {infinite.size} samples are infinite, the first at {infinite[0]}")
    missing = np.isnan(samples)
    if not missing.any():
        return samples, ""
    first, count = int(np.flatnonzero(missing)[0]), int(missing.sum())
    if quantity(channel) not in FILLED:
        raise ValueError(
            f"{channel}: {count} samples are NaN or blank, the first at {first}; only position, speed and force "
            "may have gaps filled"
        )
    edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]]).astype(np.int8)))
    starts, ends = edges[0::2], edges[1::2]
    clock = np.arange(samples.size) / rate_hz if times is None else times
    # A gap is as long as its lost samples: three of them at 100 Hz are 30 ms.
    lengths = (ends - starts) / rate_hz if times is None else _lengths(clock, starts, ends)
    if gap_ms == 0:
        raise ValueError(
            f"{channel}: {count} samples are NaN or blank in {starts.size} gaps, the first at {first}, the "
            f"longest {lengths.max() * 1000:.4g} ms; --fill-gaps "
            f"{max(1, int(np.ceil(lengths.max() * 1000)))} would fill them"
        )
    if missing[0] or missing[-1]:
        raise ValueError(
            f"{channel}: NaN or blank at the {'start' if missing[0] else 'end'}: nothing to draw a line "
            "from; cut the file there"
        )
    long = np.flatnonzero(lengths > gap_ms / 1000 * (1 + 1e-9))
    if long.size:
        i = int(long[0])
        raise ValueError(
            f"{channel}: {long.size} of {starts.size} gaps are longer than {gap_ms:g} ms, the first at "
            f"sample {starts[i]} ({clock[starts[i]]:.4g} s) lasts {lengths[i] * 1000:.4g} ms"
        )
    without = samples.copy()
    without[missing] = np.interp(clock[missing], clock[~missing], samples[~missing])
    return without, (
        f"{channel}: {starts.size} gaps ({count} samples, the longest {lengths.max() * 1000:.4g} ms) were "
        f"filled with straight lines, up to {gap_ms:g} ms allowed"
    )


def bridged(channel: str, one: Channel, gap_ms: float) -> tuple[Channel, str]:
    """Return a channel with the rows that its times say are missing filled in, if asked, and a sentence.

    Raises:
        ValueError: rows are missing for longer than they may be filled.
    """
    holes = one.holes()
    if not holes.size or one.times_s is None or quantity(channel) not in FILLED:
        return one, ""  # an acceleration at irregular times is refused before it is used
    steps = np.diff(one.times_s)
    period = float(np.median(steps))
    lengths = steps[holes] - period  # as long as what was lost
    longest = int(lengths.argmax())
    places = f"{holes.size} place{'s' * (holes.size > 1)}"
    worst, since = lengths[longest] * 1000, one.times_s[holes[longest]]
    what = f"{channel}: rows are missing in {places}, the longest {worst:.4g} ms after {since:.4g} s"
    if worst > gap_ms + 1e-6:
        would = max(1, int(np.ceil(worst - 1e-6)))
        raise ValueError(f"{what}; --fill-gaps {would} would draw straight lines there, or cut the file")
    added = [
        np.linspace(one.times_s[i], one.times_s[i + 1], round(steps[i] / period), endpoint=False)[1:] for i in holes
    ]
    times = np.sort(np.concatenate([one.times_s, *added]))
    samples = np.interp(times, one.times_s, one.samples)
    return Channel(samples, one.rate_hz, times), (
        f"{what}; {times.size - one.times_s.size} samples on straight lines were put there, up to {gap_ms:g} ms allowed"
    )


def _lengths(clock: NDArray[np.float64], starts: NDArray[np.int64], ends: NDArray[np.int64]) -> NDArray[np.float64]:
    after = np.minimum(ends, clock.size - 1)
    return np.asarray(clock[after] - clock[starts], dtype=np.float64)
