"""A sound and a pen's events, recorded by two clocks, as one recording: their taps join them.

The pen knocks on the surface a few times before and after the strokes. Each knock is a transient in the sound and a short touch
in the events. A line through the pairs is delay and drift of the one clock against the other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.filters import butterworth, filter_recorded
from foten.recording.recording import Channel

TAP_S, TAP_MM = 0.3, 3.0  # at most: how long a tap touches, and how far it moves
KNOCK_HZ = 200.0  # above which a knock is looked for: hums are below
FRAME_S = 0.0005  # of the sound's level
RISE = 4.0  # times what was there in the 60 ms before is a knock
BEFORE_S, APART_S = 0.06, 0.04
WIDE_S, NARROW_S = 0.03, 0.012  # between a tap and its knock, before and after the drift is known
MOST_DRIFT = 1e-3  # of two quartzes and whatever lies between; 50 ppm are usual
LEAST_TAPS, LEAST_SHARE = 3, 0.6  # that have to be in the sound


@dataclass(frozen=True)
class PenEvents:
    """What a tablet tells of a pen; all shapes (n,)."""

    times_s: Array  # by the pen's clock, increasing
    x_mm: Array
    y_mm: Array
    pressure: Array  # 0 … 1; 0 is lifted

    def touches(self) -> NDArray[np.int64]:
        """Return the first event of each touch and the one after its last, shape (k, 2)."""
        down = np.concatenate([[False], self.pressure > 0, [False]])
        return np.stack([np.flatnonzero(~down[:-1] & down[1:]), np.flatnonzero(down[:-1] & ~down[1:])], axis=1)

    @property
    def usual_step_s(self) -> float:
        """Return the usual time between two events of a touch [s]."""
        touching = (self.pressure[1:] > 0) & (self.pressure[:-1] > 0)
        steps = np.diff(self.times_s)[touching]
        return float(np.median(steps)) if steps.size else 0.01


@dataclass(frozen=True)
class PenClock:
    """When an event happened by the sound's clock: t · (1 + drift) + delay."""

    delay_s: float
    drift: float
    n_taps: int
    residual_ms: float  # RMS of the taps about the line

    def __call__(self, times_s: Array) -> Array:
        """Return times by the sound's clock [s]."""
        return np.asarray(times_s * (1.0 + self.drift) + self.delay_s)

    def __str__(self) -> str:
        return (
            f"{self.n_taps} taps join the clocks: delay {1000 * self.delay_s:.1f} ms, drift {1e6 * self.drift:+.0f} ppm, "
            f"{self.residual_ms:.1f} ms about the line"
        )


def taps_of(events: PenEvents) -> Array:
    """Return when the taps began by the pen's clock [s], shape (k,): touches that are short and stay in place.

    A tablet looks every so often, so a touch begins half a usual step before it is told, in the mean.
    """
    taps = []
    for first, end in events.touches():
        path = np.hypot(np.diff(events.x_mm[first:end]), np.diff(events.y_mm[first:end])).sum()
        until = events.times_s[min(end, events.times_s.size - 1)]
        if until - events.times_s[first] <= TAP_S and path <= TAP_MM:
            taps.append(events.times_s[first] - 0.5 * events.usual_step_s)
    return np.array(taps)


def knocks_of(sound: Array, rate_hz: float) -> Array:
    """Return when the sound rises suddenly [s], shape (k,)."""
    quick = filter_recorded(butterworth(2, KNOCK_HZ, rate_hz, "high"), sound)
    n = max(1, round(FRAME_S * rate_hz))
    level = np.sqrt(np.square(quick[: quick.size // n * n]).reshape(-1, n).mean(axis=1))
    before, apart = round(BEFORE_S / FRAME_S), round(APART_S / FRAME_S)
    floor = max(float(np.median(level)), 1e-3 * float(level.max(initial=0.0)), 1e-12)
    recent = np.concatenate([np.full(before, floor), level])
    loudest = np.lib.stride_tricks.sliding_window_view(recent, before)[: level.size].max(axis=1)
    ratio = level / np.maximum(loudest, floor)
    found: list[int] = []
    for i in np.flatnonzero(ratio > RISE):
        if not found or i - found[-1] > apart:
            found.append(int(i))
    return np.array(found, dtype=float) * n / rate_hz


def joined(events: PenEvents, sound: Array, rate_hz: float) -> PenClock:
    """Return the line between the two clocks.

    Raises:
        ValueError: there are too few taps, or they are not in the sound.
    """
    taps, knocks = taps_of(events), knocks_of(sound, rate_hz)
    if taps.size < LEAST_TAPS:
        raise ValueError(
            f"the pen tapped {taps.size} times, expected {LEAST_TAPS} or more: tap three times before the strokes and three after"
        )
    least = max(LEAST_TAPS, int(np.ceil(LEAST_SHARE * taps.size)))
    best = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    # By the first taps alone, near which the drift is nothing yet; then by all.
    reach = taps - taps[0]
    for delay in (knocks[:, None] - taps[None, : LEAST_TAPS + 2]).ravel():
        pairs = _pairs(taps + delay, knocks, WIDE_S + MOST_DRIFT * reach)
        if pairs[0].size > best[0].size or (
            pairs[0].size == best[0].size and _spread(taps, knocks, pairs) < _spread(taps, knocks, best)
        ):
            best = pairs
    if best[0].size < least:
        raise ValueError(
            f"{best[0].size} of {taps.size} taps are in the sound, expected {least} or more: is it the sound of this stroke, and "
            "is the microphone on the pen or the surface?"
        )
    for _ in range(4):
        drift, delay = _line(taps[best[0]], knocks[best[1]])
        best = _pairs(taps * (1 + drift) + delay, knocks, np.full(taps.size, NARROW_S))
        if best[0].size < least:
            raise ValueError(
                f"{best[0].size} of {taps.size} taps lie on one line with the sound's, expected {least} or more: was one of the "
                "clocks stopped in between?"
            )
    drift, delay = _line(taps[best[0]], knocks[best[1]])
    off = knocks[best[1]] - (taps[best[0]] * (1 + drift) + delay)
    return PenClock(delay, drift, int(best[0].size), 1000 * float(np.sqrt(np.square(off).mean())))


Pairs = tuple[NDArray[np.int64], NDArray[np.int64]]


def _pairs(expected: Array, knocks: Array, within: Array) -> Pairs:
    """Return which taps have a knock within reach, and which."""
    if not knocks.size:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    nearest = np.abs(knocks[None, :] - expected[:, None]).argmin(axis=1)
    near = np.flatnonzero(np.abs(knocks[nearest] - expected) <= within)
    return near, nearest[near]


def _line(taps: Array, knocks: Array) -> tuple[float, float]:
    """Return drift and delay; no drift where the taps are too near each other to tell."""
    if np.ptp(taps) < 2.0:
        return 0.0, float((knocks - taps).mean())
    slope, delay = np.polyfit(taps, knocks - taps, 1)
    return float(np.clip(slope, -MOST_DRIFT, MOST_DRIFT)), float(delay)


def _spread(taps: Array, knocks: Array, pairs: Pairs) -> float:
    if not pairs[0].size:
        return np.inf
    drift, delay = _line(taps[pairs[0]], knocks[pairs[1]])
    return float(np.abs(knocks[pairs[1]] - taps[pairs[0]] * (1 + drift) - delay).max())


def pen_channels(events: PenEvents, clock: PenClock, force: Callable[[Array], Array]) -> dict[str, Channel]:
    """Return the position [mm] and force [N] of a pen by the sound's clock, without the taps that joined them.

    In the air a tablet tells nothing: the force is 0 there, and the position stays where it was, so that no speed comes of it.

    Args:
        force: of pressures 0 … 1, shape (n,) → (n,).
    """
    step = events.usual_step_s
    times, x, y, pressed = [], [], [], []
    left = np.zeros(2)  # how far the pen has been moved in the air
    ended: tuple[float, float, float] | None = None
    taps = set(np.round(taps_of(events) + 0.5 * step, 9).tolist())
    for first, end in events.touches():
        if round(float(events.times_s[first]), 9) in taps:
            continue
        began = float(events.times_s[first])
        if ended is not None:
            left = left + (events.x_mm[first] - left[0] - ended[1], events.y_mm[first] - left[1] - ended[2])
            times += [
                min(ended[0] + step, 0.5 * (ended[0] + began)),
                max(began - step, 0.5 * (ended[0] + began) + 1e-6),
            ]
            x += [ended[1], ended[1]]
            y += [ended[2], ended[2]]
            pressed += [0.0, 0.0]
        times += events.times_s[first:end].tolist()
        x += (events.x_mm[first:end] - left[0]).tolist()
        y += (events.y_mm[first:end] - left[1]).tolist()
        pressed += force(events.pressure[first:end]).tolist()
        ended = times[-1], x[-1], y[-1]
    if len(times) < 2:
        raise ValueError("the pen only tapped, expected strokes between the taps")
    at = clock(np.array(times))
    return {
        name: Channel(np.array(values), 1.0 / step, at)
        for name, values in (("position_x", x), ("position_y", y), ("force", pressed))
    }
