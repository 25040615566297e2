"""The sound of a trial: a contact for the page that strokes, with all surfaces of the trial loaded."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from foten.runtime.live.devices import SOUND_RATE_HZ
from foten.runtime.live.live import LiveStatistics
from foten.runtime.stylus import PressureCalibration
from foten.studio.live_contact import Contact
from foten_study.orders import Trial
from foten_study.running_study import RunningStudy

SEED_STEP = 10_000_000  # between the noise of two surfaces
OnBlock = Callable[[NDArray[np.float32], float, float, float], None]
"""Takes samples [m/s²], the factor from them to full scale, and the speed and force of the last one, in the rendering thread."""


class TrialSound:
    """What is under a participant's pen, from the first event of a trial to its end.

    `open`, `put_under_pen` and `close` raise OSError, ValueError or RuntimeError where the output refuses or has ended.
    """

    def __init__(self, study: RunningStudy, number: int) -> None:
        self._study, self._number = study, number
        self.contact: Contact | None = None
        self._calibration = PressureCalibration()
        self._level: tuple[Trial, float] | None = None

    async def open(
        self, rate_hz: float, calibration: PressureCalibration, trial: Trial, interval: int, on_block: OnBlock
    ) -> LiveStatistics:
        """Begin to play one of a trial's surfaces, for a page of some rate; how it goes from now on.

        All surfaces are loaded: each takes as long to be put under the pen.
        """
        study = self._study
        player = await asyncio.to_thread(study.player, rate_hz if study.plays_in_page else SOUND_RATE_HZ)
        contact = Contact(player, lambda samples, speed, force: on_block(samples, contact.gain, speed, force))
        self._calibration = calibration
        try:
            surfaces = [self._surface(trial, i) for i in range(study.design.n_surfaces)]
            await asyncio.to_thread(contact.load, surfaces)
            await self._put_under_pen(contact, trial, interval)
        except BaseException:  # a device that stays open refuses the next event too
            with contextlib.suppress(OSError, ValueError, RuntimeError):
                await asyncio.to_thread(contact.close)
            raise
        self.contact = contact
        return player.statistics

    async def put_under_pen(self, trial: Trial, interval: int) -> None:
        """Render another of the trial's surfaces from now on, where one is rendered."""
        if self.contact is not None:
            await self._put_under_pen(self.contact, trial, interval)

    async def _put_under_pen(self, contact: Contact, trial: Trial, interval: int) -> None:
        design, kind = self._study.design, self._study.design.kind
        volume_db = design.output.volume_db + self._study.gains[trial.texture, kind.surfaces(trial)[interval]]
        level_db = await self.level_db(trial)
        if level_db is not None and kind.gain_db is not None:
            volume_db += kind.gain_db(design.task, level_db, interval == trial.target)
        texture, seed = self._surface(trial, interval)
        await asyncio.to_thread(contact.open, texture, self._calibration, seed, volume_db)

    def _surface(self, trial: Trial, interval: int) -> tuple[bytes, int]:
        """Texture file of a surface of a trial, and the seed of its noise, of which no two have the same."""
        method = self._study.design.kind.surfaces(trial)[interval]
        seed = 1000 * self._number + trial.number + 500 + SEED_STEP * interval
        return self._study.stimuli.bytes_of[trial.texture, method], seed

    async def level_db(self, trial: Trial) -> float | None:
        """Level of a trial that the answers before it lead to [dB]; None where levels are fixed."""
        study, kind, of = self._study, self._study.design.kind, (self._number, trial.texture, trial.method)
        if kind.level_db is None:
            return None
        if self._level is None or self._level[0] != trial:
            answers = [] if trial.practice else await study.on_disk(partial(study.store.levels, *of))
            self._level = trial, kind.level_db(study.design.task, answers, trial.practice)
        return self._level[1]

    @property
    def has_stopped(self) -> bool:
        """Whether the output ended by itself."""
        return self.contact is not None and not self.contact.player.running

    async def close(self) -> None:
        """End playing."""
        contact, self.contact = self.contact, None
        if contact is not None:
            await asyncio.to_thread(contact.close)
