"""A sound and a pen's events, recorded by two clocks, joined by taps before and after the strokes.

Each tap is a knock in the sound and a short touch in the events; a line through the pairs gives delay and drift.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.datasets.bounds import MAX_FILLED
from foten.dsp import Array
from foten.dsp.filters import butterworth, filter_recorded
from foten.dsp.level import rms
from foten.recording.capture_folder import PenEvents
from foten.recording.recording import Channel

MAX_TAP_S, MAX_TAP_MM = 0.3, 3.0  # at most: how long a tap touches, and how far it moves
KNOCK_HZ = 200.0  # above which a knock is looked for: hums are below
FRAME_S = 0.0005  # of the sound's level
MIN_RISE = 4.0  # of the level over what was there before, at a knock
QUIET_S = 0.06  # before a knock
N_RISE = 3  # frames in which a knock rises
MAX_APART_S = 0.012  # between a tap and its knock
MAX_DRIFT, USUAL_DRIFT = 1e-3, 1e-4  # of two quartzes and whatever lies between
MAX_GAP_S = 0.12  # between events of a stroke, over which a hand is still smooth
MAX_COMPARED = 10_000_000  # touches with knocks
MIN_TAPS, MIN_TAP_SHARE = 3, 0.6  # that have to be in the sound

Pairs = tuple[NDArray[np.int64], NDArray[np.int64]]
NO_PAIRS: Pairs = (np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))


@dataclass(frozen=True)
class PenClock:
    """Time of an event by the sound's clock: t · (1 + drift) + delay."""

    delay_s: float
    drift: float
    n_taps: int
    residual_ms: float  # RMS of the taps about the line

    def __call__(self, times_s: Array) -> Array:
        """Times by the sound's clock [s]."""
        return np.asarray(times_s * (1.0 + self.drift) + self.delay_s)

    def __str__(self) -> str:
        late = f"{abs(1000 * self.delay_s):.1f} ms {'late' if self.delay_s <= 0 else 'early'}"
        fast = f"{abs(1e6 * self.drift):.0f} ppm {'fast' if self.drift <= 0 else 'slow'}"
        apart = f"taps lie {self.residual_ms:.1f} ms about the line"
        return f"{self.n_taps} taps join the clocks: the pen's is {late} and {fast}; {apart}"


def landings_of(events: PenEvents) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Start of each touch by the pen's clock [s], its largest error [s], and whether it is a tap; (k,) each.

    A touch began between its first event and the one before, or, without events of a pen in the air, a usual step before. A tap
    is short and stays in place.
    """
    touches, step = events.touches(), events.usual_step_s
    first, end = touches.T if touches.size else (touches[:, 0], touches[:, 1])
    since = np.where(first > 0, events.times_s[first] - events.times_s[np.maximum(first - 1, 0)], np.inf)
    gaps = np.where(since <= 2 * step, since, step)
    lasts = events.times_s[np.minimum(end, events.times_s.size - 1)] - events.times_s[first]
    paths = np.array([np.hypot(np.diff(events.x_mm[i:j]), np.diff(events.y_mm[i:j])).sum() for i, j in touches])
    return events.times_s[first] - 0.5 * gaps, 0.5 * gaps, (lasts <= MAX_TAP_S) & (paths <= MAX_TAP_MM)


def knocks_of(sound: Array, rate_hz: float) -> Array:
    """Times at which the sound rises suddenly [s], shape (k,)."""
    quick = filter_recorded(butterworth("highpass", KNOCK_HZ, rate_hz), sound)
    n = max(1, round(FRAME_S * rate_hz))
    level = np.sqrt(np.square(quick[: quick.size // n * n]).reshape(-1, n).mean(axis=1))
    before = round(QUIET_S / FRAME_S)
    floor = max(float(np.percentile(level, 10.0)), 1e-3 * float(level.max(initial=0.0)), 1e-12)
    recent = np.concatenate([np.full(before, floor), level])
    loudest = np.lib.stride_tricks.sliding_window_view(recent, before - N_RISE)[: level.size].max(axis=1)
    rising = np.flatnonzero(level > MIN_RISE * np.maximum(loudest, floor))
    return rising[np.diff(rising, prepend=-np.inf) > N_RISE + 1] * n / rate_hz


def joined(events: PenEvents, sound: Array, rate_hz: float) -> PenClock:
    """Line between the two clocks; ValueError where there are too few taps, or they are not in the sound."""
    landings, off_by, is_tap = landings_of(events)
    taps, knocks = landings[is_tap], knocks_of(sound, rate_hz)
    if taps.size < MIN_TAPS:
        expected = f"expected {MIN_TAPS} or more: tap three times before the strokes and three after"
        raise ValueError(f"the pen tapped {taps.size} times, {expected}")
    if knocks.size * max(landings.size, 200) > MAX_COMPARED:
        raise ValueError(f"{knocks.size} knocks and {landings.size} touches are too many to compare; cut the file")
    n_required = max(MIN_TAPS, int(np.ceil(MIN_TAP_SHARE * taps.size)))
    # By the first taps alone, where the drift does not count yet; then by all.
    tried = (knocks[:, None] - taps[None, : MIN_TAPS + 2]).ravel()
    reach = MAX_APART_S + MAX_DRIFT * (taps - taps[0])
    paired = (_pairs(taps + delay, knocks, reach) for delay in tried)
    best = max(paired, key=lambda pairs: pairs[0].size, default=NO_PAIRS)
    if best[0].size < n_required:
        taps_in = f"{best[0].size} of {taps.size} taps are in the sound, expected {n_required} or more"
        raise ValueError(f"{taps_in}: is it the sound of this stroke, with the microphone on the pen or the surface?")
    n_taps = best[0].size
    drift, delay = _line(taps[best[0]], knocks[best[1]])
    # The landing of each stroke is a knock, too.
    for _ in range(2):
        best = _pairs(landings * (1 + drift) + delay, knocks, np.full(landings.size, MAX_APART_S))
        drift, delay = _line(landings[best[0]], knocks[best[1]])
    off = knocks[best[1]] - (landings[best[0]] * (1 + drift) + delay)
    near = np.abs(off) <= 1.5 * max(events.usual_step_s, FRAME_S)
    if near.sum() < n_required:
        on_line = f"{near.sum()} of {landings.size} touches lie on one line with the sound"
        raise ValueError(f"{on_line}, expected {n_required} or more: was one of the clocks stopped in between?")
    drift, delay = _centre(landings[best[0]][near], knocks[best[1]][near], off_by[best[0]][near])
    off = knocks[best[1]] - (landings[best[0]] * (1 + drift) + delay)
    return PenClock(delay, drift, int(n_taps), 1000 * rms(off))


def _pairs(expected: Array, knocks: Array, within: Array) -> Pairs:
    """Taps that have a knock within reach, and those knocks, by number."""
    if not knocks.size:
        return NO_PAIRS
    after = np.searchsorted(knocks, expected)
    before, after = np.maximum(after - 1, 0), np.minimum(after, knocks.size - 1)
    nearest = np.where(np.abs(knocks[after] - expected) < np.abs(knocks[before] - expected), after, before)
    near = np.flatnonzero(np.abs(knocks[nearest] - expected) <= within)
    return near, nearest[near]


def _line(taps: Array, knocks: Array) -> tuple[float, float]:
    """Drift and delay; no drift where the taps are too near each other to tell."""
    if np.ptp(taps) < 2.0:
        return 0.0, float((knocks - taps).mean())
    slope = float(np.clip(np.polyfit(taps, knocks - taps, 1)[0], -MAX_DRIFT, MAX_DRIFT))
    return slope, float((knocks - taps * (1 + slope)).mean())


def _centre(landings: Array, knocks: Array, off_by: Array) -> tuple[float, float]:
    """Drift and delay in the middle of all lines that pass each touch within its largest error, which is uniform."""
    usual = landings.mean()
    drifts = np.arange(-MAX_DRIFT, MAX_DRIFT, 2e-6) if np.ptp(landings) >= 2.0 else np.zeros(1)
    off = (knocks - landings)[None, :] - drifts[:, None] * (landings - usual)[None, :]
    reach = np.maximum(off_by, FRAME_S)
    while True:
        low, high = (off - reach).max(axis=1), (off + reach).min(axis=1)
        room = np.maximum(0.0, high - low)
        if room.any():
            break
        reach = 1.1 * reach
    share = room * np.exp(-0.5 * np.square(drifts / USUAL_DRIFT))
    share = share / share.sum()
    drift = float(share @ drifts)
    return drift, float(share @ (0.5 * (low + high))) - drift * float(usual)


def _strokes(events: PenEvents) -> list[tuple[int, int]]:
    """First event of each stroke and the one after its last; a gap longer than `MAX_GAP_S` ends one."""
    strokes: list[tuple[int, int]] = []
    for first, end in events.touches()[~landings_of(events)[2]]:
        gaps = first + 1 + np.flatnonzero(np.diff(events.times_s[first:end]) > MAX_GAP_S)
        edges = [int(first), *(int(gap) for gap in gaps), int(end)]
        strokes += [(i, j) for i, j in itertools.pairwise(edges) if j - i >= 2]
    return strokes


def pen_channels(events: PenEvents, clock: PenClock, force: Callable[[Array], Array]) -> dict[str, Channel]:
    """Position [mm] and force [N] of a pen's strokes by the sound's clock, evenly sampled.

    Gaps of up to `MAX_GAP_S` in a stroke are filled. In the air the force is 0 and the position is held, without speed.
    `force` is a function of pressures 0 … 1, (n,) → (n,) [N]. ValueError where the pen only tapped.
    """
    step = events.usual_step_s
    rows: list[Array] = []  # time, x, y, force of each stroke and of each time in the air, shape (4, n)
    for first, end in _strokes(events):
        at, pressure = events.times_s[first:end], events.pressure[first:end]
        x, y = events.x_mm[first:end], events.y_mm[first:end]
        if rows:
            left, last_x, last_y, _ = rows[-1][:, -1]
            x, y = x - x[0] + last_x, y - y[0] + last_y
            middle = 0.5 * (left + at[0])
            air = [min(left + step, middle), max(at[0] - step, middle + 1e-6)]
            rows.append(np.array([air, [last_x] * 2, [last_y] * 2, [0.0] * 2]))
        rows.append(np.stack([at, x, y, force(pressure)]))
    if not rows or rows[0].shape[1] < 2:
        raise ValueError("the pen only tapped, expected strokes between the taps")
    pen_s, *values = np.concatenate(rows, axis=1)
    pen_s = clock(pen_s)
    if not (lasts_s := float(pen_s[-1] - pen_s[0])) <= MAX_FILLED * step:
        raise ValueError(f"the strokes last {lasts_s:.3g} s, an event each {step:.3g} s; expected {MAX_FILLED} at most")
    times = np.arange(pen_s[0], pen_s[-1], step)
    return {
        name: Channel(np.interp(times, pen_s, samples), 1.0 / step, times)
        for name, samples in zip(("position_x", "position_y", "force"), values, strict=True)
    }
