"""Strokes of a trial: how long the pen was in contact, how fast and firmly, and what of it the database does not have yet."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.runtime.live.live import LiveStatistics, Timing
from foten.runtime.native import NativeTexture
from foten.runtime.renderer import Renderer
from foten.runtime.stylus import PressureCalibration, Stylus
from foten.studio.players import BLOCK_MS
from foten_study.store import Stroked

MAX_APART_S = 0.25  # of two events of one contact: a pen at rest sends few
MIN_CONTACT_N = 0.01  # of force, below which the pen does not count as in contact
NO_CONDITIONS: NDArray[np.float64] = np.zeros((0, 2))


@dataclass(frozen=True)
class Unsaved:
    """What of a trial is not in the database yet, each with the number of its surface."""

    events: list[tuple[int, NDArray[np.float64]]] = field(default_factory=list)
    conditions: list[tuple[int, float, float]] = field(default_factory=list)

    def parts(self) -> list[Stroked]:
        """Events in their order, and behind them the conditions of each surface."""
        runs = groupby(self.events, lambda one: one[0])
        parts = [Stroked(interval, np.concatenate([events for _, events in run])) for interval, run in runs]
        conditions = np.array(list(self.conditions)).reshape(-1, 3)
        for interval in np.unique(conditions[:, 0]):
            of_interval = conditions[conditions[:, 0] == interval, 1:]
            parts.append(Stroked(int(interval), np.zeros((0, 4)), of_interval))
        return parts


@dataclass
class TrialLog:
    """A trial through all its contacts: a lost connection or a hold begins another contact."""

    events: list[tuple[int, NDArray[np.float64]]] = field(default_factory=list)  # of the pen, by surface
    conditions: list[tuple[float, float]] = field(default_factory=list)  # speed [mm/s], force [N] at each block's end
    contacts: list[LiveStatistics] = field(default_factory=list)
    n_stopped: int = 0  # times that the output ended by itself
    earlier: NDArray[np.float64] = field(default_factory=lambda: NO_CONDITIONS)  # conditions before the server began

    def resume(self, stroked: Iterable[Stroked]) -> None:
        """Take over what was stroked before the server began."""
        parts = list(stroked)
        self.earlier = np.concatenate([NO_CONDITIONS, *(part.conditions for part in parts)])
        self.events = [(part.interval, part.events) for part in parts]

    def contact_s(self, interval: int) -> float:
        """Seconds in contact with one of the surfaces."""
        runs = groupby(self.events, lambda one: one[0])
        return sum(contact_s(np.concatenate([part for _, part in run])) for number, run in runs if number == interval)

    def summary(self) -> dict[str, Any]:
        """Seconds in contact, by the pen's own clock; of its blocks the 10th, 50th and 90th percentile of speed [mm/s] and
        force [N]; p99 of a block's rendering [ms], blocks that came late, under-runs, and times that the output ended.
        """
        block = Timing()
        for contact in self.contacts:
            block.counts += contact.block.counts
            block.largest_s = max(block.largest_s, contact.block.largest_s)
        every = np.concatenate([self.earlier, np.array(list(self.conditions)).reshape(-1, 2)])
        in_contact = every[every[:, 1] > MIN_CONTACT_N]
        result: dict[str, Any] = {"contact_s": round(sum(map(self.contact_s, {i for i, _ in self.events})), 3)}
        for name, values in zip(("speed_mm_s", "force_n"), in_contact.T, strict=True):
            for percent in (10, 50, 90):
                result[f"{name}_p{percent}"] = round(float(np.percentile(values, percent)), 4) if values.size else None
        p99_ms = 1000 * block.percentile_s(99.0)
        return {
            **result,
            "block_p99_ms": round(p99_ms, 4) if math.isfinite(p99_ms) else None,
            "n_missed": sum(contact.n_missed for contact in self.contacts),
            "n_underruns": sum(contact.n_underruns for contact in self.contacts),
            "n_stopped": self.n_stopped,
            "n_contacts": len(self.contacts) + bool(len(self.earlier)),
        }


def contact_s(events: NDArray[np.float64]) -> float:
    """Seconds that a pen was on the surface: between events (n, 4) that are no further apart than those of a pen."""
    apart = np.diff(events[:, 3])
    return float(apart[(events[:-1, 2] > 0) & (apart > 0) & (apart <= MAX_APART_S)].sum())


def conditions_of(
    events: NDArray[np.float64], texture: bytes, calibration: PressureCalibration
) -> list[tuple[float, float]]:
    """Speed [mm/s] and force [N] at the end of each block of events (n, 4), as a rendering of them would have had.

    What lies further apart than events of one contact is moved together: a page may send any times.
    """
    renderer = Renderer(_native_texture(texture))
    stylus, per_block = Stylus(renderer, calibration), max(1, round(BLOCK_MS / 1000 * renderer.texture_rate))
    times = np.append(0.0, np.cumsum(np.clip(np.diff(events[:, 3]), 0.0, MAX_APART_S)))
    conditions, n = [], 0
    for k in range(math.ceil(float(times[-1]) / BLOCK_MS * 1000) + 1):
        while n < len(events) and times[n] <= k * BLOCK_MS / 1000:
            x, y, pressure = events[n, :3].tolist()
            stylus.push(x, y, pressure, float(times[n]))
            n += 1
        conditions.append([stylus.next_condition() for _ in range(per_block)][-1])
    return conditions


@lru_cache(maxsize=4)
def _native_texture(texture: bytes) -> NativeTexture:
    """Texture in bytes, loaded: strokes of an outage come in many messages."""
    return NativeTexture(texture)
