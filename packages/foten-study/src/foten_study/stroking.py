"""The pen of a participant: its events go to the sound, to the measures of the trial, and to the database."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from foten.runtime.stylus import PressureCalibration
from foten.studio.messages import RefusedError
from foten.studio.websocket import BlockQueue
from foten_study.orders import Trial
from foten_study.participant_store import ParticipantStore
from foten_study.protocol import State
from foten_study.running_study import RunningStudy
from foten_study.strokes import TrialLog, conditions_of
from foten_study.trial_sound import TrialSound


class StrokedPage(Protocol):
    """A page that is stroked on."""

    rate_hz: float
    volume_db: float
    calibration: PressureCalibration
    blocks: BlockQueue


class Stroking:
    """What is stroked in the present trial, and in those before that an outage kept.

    Args:
        on_stored: is told how many events of a trial are stored by now.
    """

    def __init__(self, study: RunningStudy, number: int, on_stored: Callable[[int, int], None]) -> None:
        self._study, self._number = study, number
        self.kept = ParticipantStore(study.store, number, study.on_disk, on_stored)
        self.sound, self.log = TrialSound(study, number), TrialLog()
        self.page: StrokedPage | None = None  # that is played for
        self.trouble = ""  # why nothing plays

    def resume(self, trial: Trial) -> None:
        """Take over what was stroked in a trial before the server began."""
        parts = self._study.store.parts(self._number, trial.number)
        self.log.resume(parts)
        self.kept.count(trial.number, sum(len(part.events) for part in parts))

    def begin_trial(self) -> None:
        """Measure anew."""
        self.log = TrialLog()

    async def push(
        self, page: StrokedPage, state: Callable[[], State], changing: asyncio.Lock, events: NDArray[np.float64]
    ) -> bool:
        """Take in events of the pen; the first of a trial make its surfaces ready. Whether they are rendered.

        Args:
            state: the present one.
            changing: is held by who changes the step, or opens or ends what plays.
        """
        if (trial := state().trial) is None:
            return False
        if state().held or state().side == "real":  # they were on their way
            self.kept.count(trial.number, len(events))
            return False
        if self.sound.contact is None:
            async with changing:
                if self.sound.contact is None and state().trial is trial:
                    await self._open(page, trial, state)
        if self.sound.has_stopped:
            async with changing:
                await self._end_stopped()
        if self.sound.contact is None or state().trial is not trial:
            return False
        self.sound.contact.push(events)
        interval = state().interval
        self.kept.of_trial(trial.number).events.append((interval, events))
        self.log.events.append((interval, events))
        self.kept.count(trial.number, len(events))
        return True

    async def push_missed(
        self, page: StrokedPage, state: State, number: int, interval: int, first: int, events: NDArray[np.float64]
    ) -> None:
        """Take in events that a server did not store before it was killed, or that fell into its absence: not rendered.

        Those of a trial that was answered meanwhile are stored, and are not in its rating's measures.

        Args:
            number: of their trial.
            first: number of the first one in the trial, as the page counts: what was taken is not taken twice.
        """
        present = state.step["id"]
        trial = next((step["trial"] for step in state.steps if step["id"] == f"trial:{number}"), None)
        if trial is None or f"trial:{number}" not in (present, *state.done):
            raise RefusedError(f"events of trial {number}, which was not shown")
        log = self.log if present == f"trial:{number}" else TrialLog()  # of now: the trial may end meanwhile
        methods = self._study.design.kind.surfaces(trial)
        if not interval < len(methods):
            raise RefusedError(f"events of surface {interval + 1}, expected one of {len(methods)}")
        events = await self.kept.events_not_taken(number, first, events)
        if not len(events):
            return
        texture = self._study.stimuli.bytes_of[trial.texture, methods[interval]]
        conditions = await asyncio.to_thread(conditions_of, events, texture, page.calibration)
        self.kept.add_missed(number, interval, first, events, conditions)
        log.conditions.extend(conditions)
        log.events.append((interval, events))
        await self.kept.save_when_due()

    async def _open(self, page: StrokedPage, trial: Trial, state: Callable[[], State]) -> None:
        log, kept, plays_in_page = self.log, self.kept, self._study.plays_in_page

        def on_block(samples: NDArray[np.float32], gain: float, speed: float, force: float) -> None:
            log.conditions.append((speed, force))
            kept.of_trial(trial.number).conditions.append((state().interval, speed, force))
            if plays_in_page:
                page.blocks.put(samples * np.float32(gain), speed, force)  # the page bends what is too loud

        try:
            opened = self.sound.open(page.rate_hz, page.calibration, trial, state().interval, on_block)
            log.contacts.append(await opened)
        except (OSError, ValueError) as error:
            raise self._unplayable(error) from error
        self.page, self.trouble, self.kept.saved_at_s = page, "", time.monotonic()

    async def _end_stopped(self) -> None:
        """Refuse an event of a contact whose output ended by itself; the next one begins another."""
        if not self.sound.has_stopped:  # it was ended meanwhile
            return
        self.log.n_stopped += 1
        try:
            await self.sound.close()
        except (OSError, ValueError, RuntimeError) as error:
            raise self._unplayable(error) from error
        raise self._unplayable(OSError("the output ended by itself"))

    async def put_under_pen(self, trial: Trial, interval: int) -> None:
        """Render another surface of the trial from now on."""
        try:
            await self.sound.put_under_pen(trial, interval)
        except (OSError, ValueError) as error:
            raise self._unplayable(error) from error
        self.trouble = ""

    def _unplayable(self, error: Exception) -> RefusedError:
        self.trouble = f"nothing can be played: {error}"
        return RefusedError(self._study.design.language.say("cannot_play"))

    async def end(self) -> None:
        """End playing, and save the strokes."""
        await self.kept.save()
        with contextlib.suppress(OSError, ValueError, RuntimeError):
            await self.sound.close()

    async def measured(self, trial: Trial, page: StrokedPage | None) -> dict[str, Any]:
        """What is stored with the answer to a trial, beside it."""
        log, level_db = self.log.summary(), await self.sound.level_db(trial)
        if level_db is not None:
            log["level_db"] = level_db
        if page is not None:
            curve = page.calibration
            log |= {"volume_db": page.volume_db, "rate_hz": page.rate_hz, "newtons": curve.a, "steepness": curve.b}
        return log

    @property
    def contact_s(self) -> tuple[float, ...]:
        """Seconds in contact with each of the trial's surfaces."""
        return tuple(self.log.contact_s(interval) for interval in range(self._study.design.n_surfaces))
