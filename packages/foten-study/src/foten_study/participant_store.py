"""A participant's part of the database: what the disk has no room for waits here, and nothing is stored twice."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.studio.messages import RefusedError
from foten_study.store import Store
from foten_study.strokes import Unsaved

SAVE_STROKES_S = 1.0  # between two writings of a stroke
MAX_MISSED = 20 * 60 * 1000  # events of a trial that are sent again: 20 minutes of the fastest pen
OnDisk = Callable[[Callable[[], Any]], Awaitable[Any]]
"""Result of some work with the database."""


class ParticipantStore:
    """What is written of a participant.

    Args:
        on_stored: is told how many events of a trial are stored by now.
    """

    def __init__(self, store: Store, number: int, on_disk: OnDisk, on_stored: Callable[[int, int], None]) -> None:
        self._store, self._number, self._on_disk, self._on_stored = store, number, on_disk, on_stored
        self._unsaved: dict[int, Unsaved] = {}  # by trial, also of those that were rated while the disk was full
        self._n_missed: dict[int, int] = {}  # events that were sent again, by trial
        # Events by trial, as the page counts them: stored, unsaved, or left out.
        self._n_taken: dict[int, int] = {}
        self._refused: list[Callable[[], Any]] = []  # other changes that the disk had no room for, in their order
        self._writing = asyncio.Lock()
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

    def of_trial(self, trial: int) -> Unsaved:
        """What of a trial is to be stored."""
        return self._unsaved.setdefault(trial, Unsaved())

    def n_taken(self, trial: int) -> int:
        """Events of a trial so far, as the page counts them."""
        return self._n_taken.get(trial, 0)

    def count(self, trial: int, n: int) -> None:
        """Count events of a trial."""
        self._n_taken[trial] = self.n_taken(trial) + n

    async def events_not_taken(self, trial: int, first: int, events: NDArray[np.float64]) -> NDArray[np.float64]:
        """Those of some events that a page sends again which are not here yet, the `first` by its number in the trial.

        Raises:
            RefusedError: they are more than a trial can have.
        """
        n_missed = self._n_missed.get(trial, 0) + len(events)
        if n_missed > MAX_MISSED:
            raise RefusedError(f"more than {MAX_MISSED} events of trial {trial} that are sent again")
        self._n_missed[trial] = n_missed
        if trial not in self._n_taken:
            parts = await self._on_disk(partial(self._store.parts, self._number, trial))
            self._n_taken[trial] = sum(len(part.events) for part in parts)
        return events[max(0, self._n_taken[trial] - first) :]

    def add_missed(
        self, trial: int, interval: int, first: int, events: NDArray[np.float64], conditions: list[tuple[float, float]]
    ) -> None:
        """Take in events of `events_not_taken`, and their conditions."""
        unsaved = self.of_trial(trial)
        unsaved.events.append((interval, events))
        unsaved.conditions.extend((interval, *condition) for condition in conditions)
        self._n_taken[trial] = max(self._n_taken[trial], first) + len(events)

    async def save_when_due(self) -> None:
        """Save a second after the last time, or later."""
        if time.monotonic() - self.saved_at_s > SAVE_STROKES_S:
            await self.save()

    async def save(self) -> None:
        """Write what is not in the database yet; where the disk has no room, it is kept and tried again."""
        self.saved_at_s = time.monotonic()
        await self.write()
        for trial, unsaved in list(self._unsaved.items()):
            if not unsaved.events and not unsaved.conditions:
                continue
            self._unsaved[trial] = Unsaved()
            parts = unsaved.parts()
            try:
                await self._on_disk(partial(self._store.add_strokes, self._number, trial, parts))
            except OSError:
                later = self._unsaved[trial]
                self._unsaved[trial] = Unsaved(unsaved.events + later.events, unsaved.conditions + later.conditions)
                continue
            self._on_stored(trial, self._n_taken[trial] - sum(len(events) for _, events in self._unsaved[trial].events))

    def n_unsaved(self, present: int | None) -> int:
        """Events, of the pen in other trials than the present one and others, that the disk has had no room for."""
        strokes = [events for trial, one in self._unsaved.items() if trial != present for _, events in one.events]
        return len(self._refused) + sum(map(len, strokes))
