"""A rendered stroke for other formats: a drive within ±1, and its envelopes."""

import heapq
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from foten.dsp import Array

RATE_HZ = 8000.0  # that clips are rendered at: what MPEG's tools take, and beyond what skin feels
MIN_FREQUENCY_HZ, MAX_FREQUENCY_HZ = 30.0, 600.0  # of the envelope of frequency, 0 and 1
MAX_POINTS_PER_S = 60.0
STEP_S = 0.001  # of the envelopes
ATTACK_S, HOLD_S, RELEASE_S = 0.0001, 0.0015, 0.1
N_FFT, OVERLAP = 1024, 8
MIN_TRIANGLE_AREA = 1e-8  # of a triangle that a point spans with its neighbours


@dataclass(frozen=True)
class Clip:
    """One stroke of a texture."""

    drive: Array  # within ±1, shape (n,)
    rate_hz: float
    full_scale: float  # m/s², or an actuator's drive, that 1 is
    about: Mapping[str, Any]  # texture, stroke, seed, version

    @property
    def duration_s(self) -> float:
        """Duration [s]."""
        return self.drive.size / self.rate_hz


def clip_of(samples: Array, rate_hz: float, about: Mapping[str, Any], full_scale: float | None = None) -> Clip:
    """Clip of a rendered stroke, cut at full scale or scaled to its peak; ValueError for less than two samples."""
    if samples.size < 2:
        raise ValueError(f"the stroke has {samples.size} samples, expected two or more")
    if full_scale is not None and not 0 < full_scale < np.inf:
        raise ValueError(f"full scale is {full_scale:g}, expected a positive number of m/s²")
    peak = float(np.abs(samples).max())
    scale = full_scale or peak or 1.0
    return Clip(np.clip(samples / scale, -1.0, 1.0), rate_hz, scale, about)


@dataclass(frozen=True)
class Envelopes:
    """Amplitude and frequency over time, each reduced to the points that matter; shapes (k, 2): seconds and 0 … 1."""

    amplitude: Array
    frequency: Array  # 0 is `MIN_FREQUENCY_HZ`, 1 is `MAX_FREQUENCY_HZ`

    def hertz(self, at_s: Array) -> Array:
        """Frequency [Hz] at times [s]."""
        share = np.interp(at_s, self.frequency[:, 0], self.frequency[:, 1])
        return np.asarray(MIN_FREQUENCY_HZ + share * (MAX_FREQUENCY_HZ - MIN_FREQUENCY_HZ))


def envelopes_of(clip: Clip) -> Envelopes:
    """Envelopes of a clip, an RMS follower and the centroid of the spectrum below 1 kHz, of at most `MAX_POINTS_PER_S`.

    Source: the published defaults of Meta's haptics SDK (constants); the reduction is Visvalingam and Whyatt's (1993).
    """
    times, amplitude = _followed(clip)
    frequency = np.interp(times, *_centroids(clip))
    max_points = max(2, int(MAX_POINTS_PER_S * clip.duration_s))
    reduced = (_reduced(np.stack([times, values], axis=1), max_points) for values in (amplitude, frequency))
    return Envelopes(*reduced)


def _followed(clip: Clip) -> tuple[Array, Array]:
    """Times [s] and the level there, 0 … 1: it rises within the attack, holds, and falls within the release."""
    n = max(1, round(STEP_S * clip.rate_hz))
    squares = np.square(clip.drive - clip.drive.mean())
    squares = np.append(squares, np.zeros(-squares.size % n)).reshape(-1, n).mean(axis=1)
    level = np.minimum(np.sqrt(squares), 1.0)
    rise, fall, held = np.exp(-STEP_S / ATTACK_S), np.exp(-STEP_S / RELEASE_S), 0.0
    out, now = np.empty(level.size), 0.0
    for i, value in enumerate(level):
        if value >= now:
            now, held = value + (now - value) * rise, HOLD_S
        elif held > 0:
            held -= STEP_S
        else:
            now = value + (now - value) * fall
        out[i] = now
    times = np.append(np.arange(level.size) * STEP_S, clip.duration_s)
    return np.minimum(times, clip.duration_s), np.append(out, out[-1])


def _centroids(clip: Clip) -> tuple[Array, Array]:
    """Times [s] and the spectrum's centroid there, 0 … 1."""
    hop = N_FFT // OVERLAP
    padded = np.pad(clip.drive, (N_FFT // 2, N_FFT))
    n = 1 + clip.drive.size // hop
    frames = np.lib.stride_tricks.sliding_window_view(padded, N_FFT)[::hop][:n]
    hertz = np.fft.rfftfreq(N_FFT, 1 / clip.rate_hz)
    used = hertz <= 1000.0
    window = np.hanning(N_FFT)
    power = np.stack([np.abs(np.fft.rfft(frame * window))[used] for frame in frames])
    total = power.sum(axis=1)
    centroid = np.divide(power @ hertz[used], total, out=np.full(n, MIN_FREQUENCY_HZ), where=total > 0)
    share = (centroid - MIN_FREQUENCY_HZ) / (MAX_FREQUENCY_HZ - MIN_FREQUENCY_HZ)
    return np.arange(n) * hop / clip.rate_hz, np.clip(share, 0.0, 1.0)


def _reduced(points: Array, max_points: int) -> Array:
    """Points without those that span the smallest triangles, taken out one after the other."""
    n = len(points)
    rows = points.tolist()
    before, after = [i - 1 for i in range(n)], [i + 1 for i in range(n)]

    def area(i: int) -> float:
        (x0, y0), (x1, y1), (x2, y2) = rows[before[i]], rows[i], rows[after[i]]
        return float(0.5 * abs((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)))

    areas = [np.inf, *map(area, range(1, n - 1)), np.inf]
    smallest = [(areas[i], i) for i in range(1, n - 1)]
    heapq.heapify(smallest)
    n_left = n
    while smallest and n_left > 2:
        size, i = heapq.heappop(smallest)
        if size != areas[i]:
            continue  # it was another one's neighbour since
        if size > MIN_TRIANGLE_AREA and n_left <= max_points:
            break
        areas[i], n_left = -1.0, n_left - 1
        after[before[i]], before[after[i]] = after[i], before[i]
        for near in (before[i], after[i]):
            if 0 < near < n - 1:
                areas[near] = area(near)
                heapq.heappush(smallest, (areas[near], near))
    return points[[i for i in range(n) if areas[i] >= 0]]
