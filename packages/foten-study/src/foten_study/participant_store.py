"""What is stroked in trials, measured, and a participant's part of the database, where nothing is stored twice."""

import asyncio
import contextlib
import math
import time
from collections import Counter, defaultdict
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.runtime.live.live import LiveStatistics, Timing
from foten.studio.messages import RefusedError
from foten_study.store import MAX_APART_S, Store, Stroked

MIN_CONTACT_N = 0.01  # of force, below which the pen does not count as in contact
SAVE_STROKES_S = 1.0  # between two writings of a stroke
MAX_MISSED = 20 * 60 * 1000  # events of a trial that are sent again: 20 minutes of the fastest pen
OnDisk = Callable[[Callable[[], Any]], Awaitable[Any]]


@dataclass
class TrialLog:
    """A trial through all its contacts: a lost connection or a hold begins another contact."""

    events: list[tuple[int, NDArray[np.float64]]] = field(default_factory=list)  # of the pen, by surface
    # Surface, speed [mm/s] and force [N] at each block's end; the rendering thread adds to them.
    conditions: list[tuple[int, float, float]] = field(default_factory=list)
    n_saved: tuple[int, int] = (0, 0)  # items of both that are in the database
    contacts: list[LiveStatistics] = field(default_factory=list)
    n_stopped: int = 0  # times that the output ended by itself
    n_contacts_before: int = 0  # 1 where there was any contact before the server began

    def resume(self, parts: Iterable[Stroked]) -> None:
        """Take over what was stroked before the server began."""
        for part in parts:
            self.events.append((part.interval, part.events))
            self.conditions += [(part.interval, speed, force) for speed, force in part.conditions.tolist()]
        self.n_saved, self.n_contacts_before = self.size, int(bool(self.conditions))

    @property
    def size(self) -> tuple[int, int]:
        """Items of events and of conditions so far."""
        return len(self.events), len(self.conditions)

    def unsaved(self, size: tuple[int, int]) -> list[Stroked]:
        """Parts that are not in the database: events in their order, and behind them the conditions of each surface."""
        events, conditions_of = (slice(*ends) for ends in zip(self.n_saved, size, strict=True))
        parts = [Stroked(interval, run) for interval, run in _runs(self.events[events])]
        conditions = np.array(self.conditions[conditions_of]).reshape(-1, 3)
        for interval in np.unique(conditions[:, 0]):
            of_interval = conditions[conditions[:, 0] == interval, 1:]
            parts.append(Stroked(int(interval), np.zeros((0, 4)), of_interval))
        return parts

    def n_unsaved(self) -> int:
        """Events that are not in the database."""
        return sum(len(events) for _, events in self.events[self.n_saved[0] :])

    def contact_s(self, interval: int) -> float:
        """Seconds in contact with one of the surfaces."""
        return sum(contact_s(run) for number, run in _runs(self.events) if number == interval)

    def summary(self) -> dict[str, Any]:
        """Seconds in contact, by the pen's own clock; of its blocks the 10th, 50th and 90th percentile of speed [mm/s] and
        force [N]; p99 of a block's rendering [ms], blocks that came late, under-runs, and times that the output ended.
        """
        block = Timing()
        for contact in self.contacts:
            block.counts += contact.block.counts
            block.largest_s = max(block.largest_s, contact.block.largest_s)
        every = np.array(list(self.conditions)).reshape(-1, 3)[:, 1:]
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
            "n_contacts": len(self.contacts) + self.n_contacts_before,
        }


def _runs(events: list[tuple[int, NDArray[np.float64]]]) -> list[tuple[int, NDArray[np.float64]]]:
    """Events joined while they are of one surface."""
    runs = groupby(events, lambda one: one[0])
    return [(interval, np.concatenate([part for _, part in run])) for interval, run in runs]


def contact_s(events: NDArray[np.float64]) -> float:
    """Seconds that a pen was on the surface: between events (n, 4) that are no further apart than those of a pen."""
    apart = np.diff(events[:, 3])
    return float(apart[(events[:-1, 2] > 0) & (apart > 0) & (apart <= MAX_APART_S)].sum())


class ParticipantStore:
    """What is written of a participant; `on_stored` is told how many events of a trial are stored by now."""

    def __init__(self, store: Store, number: int, on_disk: OnDisk, on_stored: Callable[[int, int], None]) -> None:
        self._store, self._number, self._on_disk, self._on_stored = store, number, on_disk, on_stored
        # By trial: the present one, and those that were rated while the disk was full.
        self.logs: defaultdict[int, TrialLog] = defaultdict(TrialLog)
        self.n_taken: Counter[int] = Counter()  # events by trial, as the page counts them: stored, unsaved, or left out
        self._n_missed: Counter[int] = Counter()  # events that were sent again, by trial
        self._refused: list[Callable[[], Any]] = []  # other changes that the disk had no room for, in their order
        self._writing, self._saving = asyncio.Lock(), asyncio.Lock()
        self.saved_at_s = 0.0

    async def write(self, *changes: Callable[[], Any]) -> None:
        """Write changes, and those before that the disk refused: a full disk does not stop a hand, the answer will say it."""
        async with self._writing:
            waiting, self._refused = [*self._refused, *changes], []
            try:
                while waiting:
                    await self._on_disk(waiting[0])
                    del waiting[0]
            except OSError:
                self._refused = waiting

    async def events_not_taken(self, trial: int, first: int, events: NDArray[np.float64]) -> NDArray[np.float64]:
        """Events sent again, the `first` by its number, that are not here yet; RefusedError where they are too many."""
        if self._n_missed[trial] + len(events) > MAX_MISSED:
            raise RefusedError(f"more than {MAX_MISSED} events of trial {trial} that are sent again")
        self._n_missed[trial] += len(events)
        if trial not in self.n_taken:
            parts = await self._on_disk(partial(self._store.parts, self._number, trial))
            self.n_taken[trial] = sum(len(part.events) for part in parts)
        return events[max(0, self.n_taken[trial] - first) :]

    async def save_when_due(self) -> None:
        """Save a second after the last time, or later."""
        if time.monotonic() - self.saved_at_s > SAVE_STROKES_S:
            await self.save()

    async def save(self) -> None:
        """Write what is not in the database yet; where the disk has no room, it is kept and tried again."""
        self.saved_at_s = time.monotonic()
        await self.write()
        async with self._saving:
            for trial, log in list(self.logs.items()):
                if (size := log.size) == log.n_saved:
                    continue
                parts = log.unsaved(size)
                with contextlib.suppress(OSError):
                    await self._on_disk(partial(self._store.add_strokes, self._number, trial, parts))
                    log.n_saved = size
                    self._on_stored(trial, self.n_taken[trial] - log.n_unsaved())

    def begin_trial(self) -> None:
        """Leave the logs of trials behind, but for what the disk had no room for."""
        self.logs = defaultdict(TrialLog, {trial: log for trial, log in self.logs.items() if log.size != log.n_saved})

    def n_unsaved(self, present: int | None) -> int:
        """Events, of the pen in other trials than the present one and others, that the disk has had no room for."""
        return len(self._refused) + sum(log.n_unsaved() for trial, log in self.logs.items() if trial != present)
