"""Recorded innovations, played back: each stretch goes on from a recorded moment that is like the present one.

Every 4 ms it is decided, in integers, whether the stretch goes on: it ends after 80 to 250 ms, or where the hand leaves the speed
and force that it was recorded under. The next one is drawn from the 12 recorded moments that are nearest in log speed, log force,
the growth of both over 40 ms, and the recorded levels over 8 and 40 ms of what was played last. An equal-power fade joins them.
Chance comes from the noise of the sample (`dsp.noise`). So all engines play the same.

Source: image quilting (Efros & Freeman, 2001) and motion-driven concatenation (An, James & Marschner, 2012), of the excitation of
a linear predictor (Un & Magill, 1975).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.recording.split import Split
from foten.recording.trace import Trace

Integers = NDArray[np.int64]

CONTROL_MS = 4.0  # between decisions
FADE_MS = 6.0
OCTAVE = 256  # steps of a logarithm in an octave
SPEED_FLOOR, FORCE_FLOOR = 20.0, 0.05  # mm/s and N, added before a logarithm
SPEED_ORIGIN, FORCE_ORIGIN = 3666, 1452  # logarithms of the floors, in steps
STORED_SHIFT, LEVEL_SHIFT = 3, 4  # bits by which a stored logarithm and a stored level are coarser than a step
N_GROWTH = 10  # decisions back, 40 ms
N_NEAREST = 12  # moments that the next is drawn from
WEIGHTS = (
    23,
    12,
    9,
    5,
    3,
    3,
)  # of differences in steps: .06, .12, .15 and .3 nepers of speed, force, growths, .5 of levels
MAX_DIFFERENCE = 14000  # of a weighted difference: six squares of it fit 31 bits
MIN_LENGTH, MAX_LENGTH = 20, 62  # decisions that a stretch lasts, 80 to 250 ms
MIN_AGE = 6  # decisions before it may be left
MAX_SPEED_DIFFERENCE, MAX_FORCE_DIFFERENCE = 74, 148  # steps between hand and recording, .2 and .4 nepers
MIN_DISTANCE = 15  # moments between the one that is left and the next
N_AHEAD, N_MARGIN = 20, 8  # moments that are recorded after a candidate, and after a moment that is played
CANDIDATE, RUN_START = 1, 2  # flags of a moment
N_TAPS, N_PHASES = 16, 64  # of the interpolation along the path
MAX_PACE = OCTAVE  # steps, of log speed over the recorded one
ONE = 1 << 16  # a sample, of a place in the recording
LEVELS_IN_OCTAVE, LEVEL_ORIGIN = 16, 128  # of a stored level; the stored level of 1
COMPANDING = 255.0  # μ of the μ-law: the codes lie as dense near zero as for 14 bits
MAX_MOMENTS = 1 << 22
NEIGHBOUR_S = 1.25  # away from a block that is judged, what is played: a second, and the longest stretch
MAX_CANDIDATES = 1 << 14


def logarithm(value: Array, floor: float) -> Integers:
    """Log₂ of value + floor, at most 2²⁰, plus 10, in steps rounded down: float64 (…) → (…)."""
    x = np.floor(np.minimum(np.asarray(value, dtype=float) + floor, 2.0**20) * 1024 + 0.5).astype(np.uint64)
    exponent = (np.frexp(x.astype(float))[1] - 1).astype(np.uint64)
    mantissa, steps = x << (np.uint64(31) - exponent), exponent * OCTAVE
    for bit in range(7, -1, -1):
        mantissa = mantissa * mantissa >> np.uint64(31)
        carry = mantissa >> np.uint64(32)
        mantissa >>= carry
        steps += carry << np.uint64(bit)
    return steps.astype(np.int64)


def control_step(rate_hz: float) -> int:
    """Samples between decisions."""
    return max(1, math.floor(CONTROL_MS * rate_hz / 1000 + 0.5))


def fade_length(step: int) -> int:
    """Samples of a fade, from those between decisions."""
    return max(1, math.floor(FADE_MS / CONTROL_MS * step + 0.5))


def interpolation_taps() -> Array:
    """Windowed sinc for each phase between two samples, (N_PHASES, N_TAPS)."""
    z = np.arange(N_PHASES)[:, None] / N_PHASES - np.arange(1 - N_TAPS // 2, N_TAPS // 2 + 1)
    return np.asarray(np.sinc(z) * np.cos(np.pi * z / N_TAPS) ** 2)


@dataclass(frozen=True)
class RecordedInnovations:
    """Innovations over σ in their order, and a moment for every `step` of them."""

    values: Array  # of the 256 codes
    codes: NDArray[np.uint8]  # (n_moments, step)
    moments: NDArray[np.uint8]  # log speed, log force, level over 8 and over 40 ms, flags: (n_moments, 5)
    along_path: bool  # whether it is read at the hand's pace over the recorded one

    @classmethod
    def of(cls, tensors: Mapping[str, NDArray[Any]], along_path: bool) -> RecordedInnovations:
        """Those of a texture; ValueError where they do not fit together."""
        values, codes, moments = (tensors[f"recorded.{name}"] for name in ("values", "innovations", "moments"))
        recorded = cls(values.astype(float), codes, moments, along_path)
        recorded.check()
        return recorded

    def check(self) -> None:
        """Refuse more candidates than are searched, none, and one without enough moments before and after it."""
        run_start, j = self.run_start, self.candidates
        starts = self.moments[:1, 4] & RUN_START
        if len(self.moments) > MAX_MOMENTS or j.size > MAX_CANDIDATES:
            raise ValueError(
                f"{len(self.moments)} recorded moments, expected {MAX_MOMENTS} and {MAX_CANDIDATES} candidates at most"
            )
        if (
            not starts.any()
            or not j.size
            or (j - run_start[j] < N_GROWTH).any()
            or (self.run_end[j] - j < N_AHEAD).any()
        ):
            raise ValueError(
                "the recorded innovations have no candidate, or one too near to where its run begins or ends"
            )

    def tensors(self) -> dict[str, NDArray[Any]]:
        """As a texture file has them."""
        values = self.values.astype(np.float32)
        return {"recorded.values": values, "recorded.innovations": self.codes, "recorded.moments": self.moments}

    @property
    def step(self) -> int:
        """Samples of a moment."""
        return self.codes.shape[1]

    @cached_property
    def innovations(self) -> Array:
        """Innovations over σ, (n_moments · step,)."""
        return self.values[self.codes.ravel()]

    @cached_property
    def run_start(self) -> Integers:
        """First moment of each moment's run, (n_moments,)."""
        starts = np.flatnonzero(self.moments[:, 4] & RUN_START)
        which = np.searchsorted(starts, np.arange(len(self.moments)), side="right") - 1
        return np.asarray(starts[np.maximum(which, 0)]) if starts.size else np.zeros(len(self.moments), dtype=np.int64)

    @cached_property
    def run_end(self) -> Integers:
        """Moment after the last of each moment's run, (n_moments,)."""
        ends = np.append(np.flatnonzero(self.moments[1:, 4] & RUN_START) + 1, len(self.moments))
        return np.asarray(ends[np.searchsorted(ends, np.arange(len(self.moments)), side="right")])

    @cached_property
    def logarithms(self) -> Integers:
        """Recorded log speed and log force in steps, (n_moments, 2)."""
        origin = np.array([SPEED_ORIGIN, FORCE_ORIGIN])
        return (self.moments[:, :2].astype(np.int64) << STORED_SHIFT) + origin

    @cached_property
    def levels(self) -> Integers:
        """Recorded levels in steps, (n_moments, 2)."""
        return self.moments[:, 2:4].astype(np.int64) << LEVEL_SHIFT

    @cached_property
    def candidates(self) -> Integers:
        """Moments that a stretch may begin with."""
        return np.flatnonzero(self.moments[:, 4] & CANDIDATE)

    @cached_property
    def features(self) -> Integers:
        """Log speed, log force, their growths and two levels of each candidate in steps, (n_candidates, 6)."""
        j = self.candidates
        growth = self.logarithms[j] - self.logarithms[j - N_GROWTH]
        return np.concatenate([self.logarithms[j], growth, self.levels[j]], axis=1)

    @cached_property
    def taps(self) -> Array:
        return interpolation_taps()

    def read(self, place: int) -> float:
        """The innovation at a place, in samples times `ONE`."""
        at, phase = place // ONE, place % ONE * N_PHASES // ONE
        if not phase:
            return float(self.innovations[at])
        around = np.clip(np.arange(at + 1 - N_TAPS // 2, at + 1 + N_TAPS // 2), 0, len(self.innovations) - 1)
        return float(self.innovations[around] @ self.taps[phase])


def neighbourhood(split: Split, trace: Trace, block: int) -> tuple[int, int]:
    """Moments, the first and the one after the last, that are not played where a block is rendered beside its recording."""
    step, away = control_step(trace.rate_hz), NEIGHBOUR_S * trace.rate_hz
    times = [run[0] * split.block + step * np.arange(len(run) * split.block // step) for run in runs_of(split, trace)]
    first, end = np.searchsorted(np.concatenate(times), [block * split.block - away, (block + 1) * split.block + away])
    return int(first), int(end)


def neighbourhoods(split: Split | None, trace: Trace, blocks: Sequence[int], n_times: int = 1) -> list[tuple[int, int]]:
    """`neighbourhood` of each block, all of them so many times; none of another recording, which has no split."""
    return [] if split is None else [neighbourhood(split, trace, block) for block in blocks] * n_times


def runs_of(split: Split, trace: Trace) -> list[Integers]:
    """Numbers of the training and validation blocks, those that follow one another in a take together."""
    numbers = np.array(sorted((*split.train, *split.validation)))
    begins = [i for i in range(1, len(numbers)) if numbers[i] > numbers[i - 1] + 1 or not trace.follows(numbers[i])]
    return np.split(numbers, begins)


def encoded(
    innovations: Array, moments: NDArray[np.uint8], largest: float, along_path: bool = False
) -> RecordedInnovations:
    """Innovations (n_moments, step) in 256 codes by the μ-law, symmetric, cut at a largest one."""
    u = np.linspace(-1, 1, 256)
    values = np.sign(u) * (largest or 1.0) * np.expm1(np.abs(u) * np.log1p(COMPANDING)) / COMPANDING
    values = values.astype(np.float32).astype(float)
    codes = np.searchsorted((values[1:] + values[:-1]) / 2, innovations).astype(np.uint8)
    return RecordedInnovations(values, codes, moments, along_path)


class Playback:
    """One stream of recorded innovations; `excluded` is the first moment that is no candidate, and the one after the last."""

    def __init__(self, recorded: RecordedInnovations, excluded: tuple[int, int] = (0, 0)) -> None:
        self.recorded, self.excluded = recorded, excluded
        self.place = self.previous = -1  # in the recording, where it reads and where the stretch before went on
        self.pace = self.previous_pace = ONE  # of each, a sample
        self.n_faded = self.n_fade = fade_length(recorded.step)
        self.n_samples = 0
        self.age = self.length = 0  # decisions
        self.history: list[tuple[int, int]] = []  # log speed and log force at the last decisions, the oldest first

    def advance(self, speed: float, force: float, noise: float | None) -> float:
        """The next innovation over σ, under a speed [mm/s] and force [N], from a standard normal number or None."""
        if self.n_samples % self.recorded.step == 0:
            self._decide(
                int(logarithm(np.array(speed), SPEED_FLOOR)), int(logarithm(np.array(force), FORCE_FLOOR)), noise
            )
        self.n_samples += 1
        if self.place < 0:  # there is no candidate
            return noise or 0.0
        innovation = self.recorded.read(self.place)
        if self.n_faded < self.n_fade:
            angle = 0.5 * np.pi * (self.n_faded + 0.5) / self.n_fade
            innovation = np.sin(angle) * innovation + np.cos(angle) * self.recorded.read(self.previous)
            self.previous += self.previous_pace
            self.n_faded += 1
        self.place += self.pace
        return innovation

    def _decide(self, log_speed: int, log_force: int, noise: float | None) -> None:
        recorded, moment = self.recorded, self.place // ONE // self.recorded.step
        self.history = [*(self.history or [(log_speed, log_force)] * N_GROWTH), (log_speed, log_force)][-N_GROWTH - 1 :]
        self.age += 1
        if self.place >= 0:
            speed_difference, force_difference = np.abs(recorded.logarithms[moment] - (log_speed, log_force))
            strayed = speed_difference > MAX_SPEED_DIFFERENCE or force_difference > MAX_FORCE_DIFFERENCE
            ended = self.age >= self.length or recorded.run_end[moment] - moment < N_MARGIN
            if not ended and not (strayed and self.age >= MIN_AGE):
                self._follow_path(moment, log_speed)
                return
        growth = log_speed - self.history[0][0], log_force - self.history[0][1]
        levels = recorded.levels[moment] if self.place >= 0 else (0, 0)
        weights = np.array(WEIGHTS) * np.array([1, 1, 1, 1, *([int(self.place >= 0)] * 2)])
        difference = np.clip(
            (recorded.features - [log_speed, log_force, *growth, *levels]) * weights, -MAX_DIFFERENCE, MAX_DIFFERENCE
        )
        allowed = (recorded.candidates < self.excluded[0]) | (recorded.candidates >= self.excluded[1])
        if self.place >= 0:
            allowed &= np.abs(recorded.candidates - moment) >= MIN_DISTANCE
        among = np.flatnonzero(allowed)
        if not among.size:
            self.place = -1
            return
        nearest = among[np.argsort(np.square(difference[among]).sum(axis=1), kind="stable")[:N_NEAREST]]
        number = 0 if noise is None else int(abs(noise) * 2.0**32)
        self.length = MIN_LENGTH + number // N_NEAREST % (MAX_LENGTH - MIN_LENGTH + 1)
        self.age = 0
        if self.place >= 0:
            self.previous, self.previous_pace, self.n_faded = self.place, self.pace, 0
        moment = int(recorded.candidates[nearest[number % len(nearest)]])
        self.place = moment * recorded.step * ONE
        self._follow_path(moment, log_speed)

    def _follow_path(self, moment: int, log_speed: int) -> None:
        if self.recorded.along_path:
            ahead = int(np.clip(log_speed - self.recorded.logarithms[moment, 0], -MAX_PACE, MAX_PACE))
            self.pace = int(np.floor(ONE * 2.0 ** (ahead / OCTAVE) + 0.5))
