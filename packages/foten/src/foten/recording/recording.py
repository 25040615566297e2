"""Raw capture of one texture: named channels, each with its own rate and unit."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

AXES = ("x", "y", "z")

UNITS: Mapping[str, str] = {
    "acceleration": "m/s^2",
    **{f"acceleration_{axis}": "m/s^2" for axis in AXES},
    "speed": "mm/s",
    **{f"position_{axis}": "mm" for axis in AXES},
    "force": "N",
    **{f"force_{axis}": "N" for axis in AXES},
}
"""Every channel a recording may have, with the unit it is stored in. `z` is the surface normal."""

RELATIVE = "relative"
"""The unit of an acceleration that is not calibrated: 1 is its RMS while the tool touches."""

LIMITS: Mapping[str, float] = {"speed": 5000.0, "acceleration": 1000.0, "force": 500.0, "position": 10_000.0}
"""Beyond these no hand stroked a surface: mm/s, m/s², N, mm."""


def range_in_words(channel: str, low: float, high: float) -> str:
    """Range of speeds or forces, to two digits and speeds in whole mm/s: "5 to 330 mm/s"."""
    first, last = (float(f"{round(end) if channel == 'speed' else end:.2g}") for end in (low, high))
    return f"{first:g} to {last:g} {UNITS[channel]}"


def counted(count: int, what: str) -> str:
    """Number with its noun: "1 gap", "2 gaps"."""
    return f"{count} {what}{'' if count == 1 else 's'}"


HOLE = 1.5  # median steps between two times; more, and samples were lost


@dataclass(frozen=True)
class Channel:
    """One sensor signal."""

    samples: NDArray[np.float64]  # shape (n,), in the unit that `UNITS` gives for the channel's name
    rate_hz: float  # samples a second; with `times_s`, the nominal rate
    times_s: NDArray[np.float64] | None = None  # shape (n,), only where the capture was irregular; else i / rate_hz

    def __post_init__(self) -> None:
        if self.samples.ndim != 1 or self.samples.size == 0:
            raise ValueError(f"a channel has shape {self.samples.shape}, expected (n,) with n > 0")
        if not np.isfinite(self.rate_hz) or self.rate_hz <= 0:
            raise ValueError(f"rate is {self.rate_hz} Hz, expected a positive number")
        if self.times_s is not None and self.times_s.shape != self.samples.shape:
            raise ValueError(f"{self.times_s.size} times for {self.samples.size} samples")

    @property
    def times(self) -> NDArray[np.float64]:
        """Time of each sample [s], shape (n,)."""
        return np.arange(self.samples.size) / self.rate_hz if self.times_s is None else self.times_s

    @property
    def span_s(self) -> tuple[float, float]:
        """Start and end of the channel [s], one sample period past the last sample."""
        start = 0.0 if self.times_s is None else float(self.times_s[0])
        return start, start + self.duration_s

    @property
    def duration_s(self) -> float:
        """Time that the channel covers [s], one sample period past the last sample."""
        if self.times_s is None:
            return self.samples.size / self.rate_hz
        return float(self.times_s[-1] - self.times_s[0]) + 1 / self.rate_hz

    def holes(self) -> NDArray[np.int64]:
        """Samples after which others were lost; a step counts by five samples on either side, not by one late time stamp."""
        if self.times_s is None or self.times_s.size < 3:
            return np.zeros(0, dtype=np.int64)
        times = self.times_s
        period = float(np.median(np.diff(times)))
        long = np.flatnonzero(np.diff(times) > HOLE * period)
        reach = np.arange(5)
        after, before = long[:, None] + 1 + reach, long[:, None] - reach
        landed = np.where(after < times.size, times[np.minimum(after, times.size - 1)] - reach * period, np.nan)
        left = np.where(before >= 0, times[np.maximum(before, 0)] + reach * period, np.nan)
        return long[np.nanmedian(landed, axis=1) - np.nanmedian(left, axis=1) > HOLE * period]


def common_span_s(channels: Iterable[Channel]) -> tuple[float, float]:
    """Start and end of the time that all channels cover [s]; the end lies before the start where there is none."""
    starts, ends = zip(*(channel.span_s for channel in channels), strict=True)
    return max(starts), min(ends)


@dataclass(frozen=True)
class Recording:
    """Raw capture of one texture, each sensor at its own rate, in one take or several.

    The fields are those of the first take; `takes` has each by itself. What reads channels without looking at `takes` sees the
    first alone.
    """

    channels: Mapping[str, Channel]  # by name; names and units are those of `UNITS`
    texture: str = ""  # what was stroked, as the user calls it
    tool: str = ""
    sensors: str = ""
    notes: str = ""
    simulation: Mapping[str, Any] | None = None  # parameters of the simulator that made it
    history: tuple[str, ...] = ()  # what was done to the samples on the way in, one sentence each
    calibrated: bool = True  # False where the acceleration is in relative units
    microphone: bool = False  # whether one heard the acceleration, which then may hold speech from nearby
    name: str = ""  # of the take, where there are several: the file that it came from
    later_takes: tuple[Recording, ...] = ()  # each with its own times

    def __post_init__(self) -> None:
        unknown = sorted(set(self.channels) - set(UNITS))
        if unknown:
            raise ValueError(f"unknown channel {unknown[0]!r}, expected one of {', '.join(UNITS)}")
        if not self.channels:
            raise ValueError("the recording has no channel")
        object.__setattr__(self, "channels", MappingProxyType(dict(self.channels)))
        for i, take in enumerate(self.later_takes, 2):
            if set(take.channels) != set(self.channels):
                have, expected = (", ".join(sorted(of.channels)) for of in (take, self))
                raise ValueError(f"take {i}{take.named} has the channels {have}, expected as the first: {expected}")
            if take.calibrated != self.calibrated:
                raise ValueError(f"take {i}{take.named} and the first are in m/s² and relative units: expected one")

    def __getitem__(self, name: str) -> Channel:
        return self.channels[name]

    def __contains__(self, name: str) -> bool:
        return name in self.channels

    @property
    def named(self) -> str:
        """The take's name in a message: " (denim-3.csv)", or nothing."""
        return f" ({self.name})" if self.name else ""

    @property
    def takes(self) -> tuple[Recording, ...]:
        """Each take by itself."""
        return (replace(self, later_takes=()), *self.later_takes)

    def axes(self, quantity: str) -> list[Channel]:
        """Channels of one quantity: its axes x, y, z where recorded, else the scalar, else none."""
        names = [f"{quantity}_{axis}" for axis in AXES if f"{quantity}_{axis}" in self] or [quantity]
        return [self[name] for name in names if name in self]

    @property
    def movement(self) -> list[str]:
        """Names of the channels that speed is taken from; empty where there is none."""
        names = ["speed"] if "speed" in self else ["position_x", "position_y"]
        return [name for name in names if name in self]

    @property
    def normal_force(self) -> list[str]:
        """Name of the channel that normal force is taken from; empty where there is none."""
        return [name for name in ("force", "force_z") if name in self][:1]

    @property
    def used(self) -> list[Channel]:
        """Channels that a trace is made of: acceleration, movement and normal force."""
        return [*self.axes("acceleration"), *(self[name] for name in (*self.movement, *self.normal_force))]

    @property
    def duration_s(self) -> float:
        """Time covered by every channel [s], of all takes."""
        return sum(min(channel.duration_s for channel in take.channels.values()) for take in self.takes)

    def unit(self, name: str) -> str:
        """Unit of a channel's samples."""
        return UNITS[name] if self.calibrated or not name.startswith("acceleration") else RELATIVE

    def sha256(self) -> str:
        """Digest of the samples, rates and times, whatever file held them."""
        digest = hashlib.sha256()
        for name in sorted(self.channels):
            channel = self.channels[name]
            digest.update(f"{name} {float(channel.rate_hz)!r} {channel.samples.size}\n".encode())
            for values in (channel.samples, channel.times_s):
                if values is not None:
                    digest.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
        for take in self.later_takes:
            digest.update(take.sha256().encode())
        return digest.hexdigest()


def joined_takes(recordings: Sequence[Recording]) -> Recording:
    """One recording of several of the same surface, each a take or more; tool and texts are those of the first.

    The texture is named as all are: `clip1` and `clip2` are `clip`. The simulator's parameters hold for one take alone and are
    left out. ValueError where channels or units differ, or one is there twice.
    """
    first, *others = (replace(take, simulation=None) for recording in recordings for take in recording.takes)
    digests = [take.sha256() for take in (first, *others)]
    for i, take in enumerate(others, 2):
        if take.sha256() in digests[: i - 1]:
            raise ValueError(f"take {i}{take.named} repeats take {digests.index(take.sha256()) + 1}: leave it out")
    if not others:
        return recordings[0]
    names = [recording.texture for recording in recordings]
    unnumbered = {name.rstrip(" _-(0123456789)") for name in names}
    common = unnumbered.pop() if len(set(names)) > len(unnumbered) == 1 else ""
    microphone = any(recording.microphone for recording in recordings)
    return replace(first, later_takes=tuple(others), texture=common or names[0], microphone=microphone)
