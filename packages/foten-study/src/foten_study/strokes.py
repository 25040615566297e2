"""The pen of a participant: its events go to the sound, and to the log of the trial, which the database takes over."""

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.runtime.live.devices import SOUND_RATE_HZ
from foten.runtime.live.live import LiveStatistics
from foten.runtime.native import NativeTexture
from foten.runtime.renderer import Renderer
from foten.runtime.stylus import PressureCalibration, Stylus
from foten.studio.live_contact import Contact
from foten.studio.messages import RefusedError
from foten.studio.players import BLOCK_MS
from foten.studio.websocket import BlockQueue
from foten_study.loading import RunningStudy
from foten_study.orders import Trial
from foten_study.participant_store import ParticipantStore, TrialLog
from foten_study.protocol import State
from foten_study.store import MAX_APART_S

SEED_STEP = 10_000_000  # between the noise of two surfaces
OnBlock = Callable[[NDArray[np.float32], float, float, float], None]
"""Takes samples [m/s²], the factor from them to full scale, and the speed and force of the last one, in the rendering thread."""


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


class TrialSound:
    """What is under a participant's pen in a trial. Where the output refuses or has ended all but `close` raise RefusedError."""

    def __init__(self, study: RunningStudy, number: int) -> None:
        self._study, self._number = study, number
        self.contact: Contact | None = None
        self.trouble = ""  # why nothing plays
        self._calibration = PressureCalibration()
        self._level: tuple[Trial, float] | None = None

    async def open(
        self, rate_hz: float, calibration: PressureCalibration, trial: Trial, interval: int, on_block: OnBlock
    ) -> LiveStatistics:
        """Play one of a trial's surfaces; how it goes. All are loaded: each takes as long to be put under the pen."""
        study, self._calibration = self._study, calibration
        with self._refusing():
            player = await asyncio.to_thread(study.player, rate_hz if study.plays_in_page else SOUND_RATE_HZ)
            contact = Contact(player, lambda samples, speed, force: on_block(samples, contact.gain, speed, force))
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
        with self._refusing():
            if self.contact is not None:
                await self._put_under_pen(self.contact, trial, interval)

    @contextlib.contextmanager
    def _refusing(self) -> Iterator[None]:
        try:
            yield
        except (OSError, ValueError, RuntimeError) as error:
            self.trouble = f"nothing can be played: {error}"
            raise RefusedError(self._study.design.language.say("cannot_play")) from error
        self.trouble = ""

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
        return self._study.bytes_of[trial.texture, method], seed

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

    async def end_stopped(self) -> None:
        """Refuse an event of a contact whose output ended by itself; the next one begins another."""
        with self._refusing():
            await self.close()
            raise OSError("the output ended by itself")

    async def close(self) -> None:
        """End playing."""
        contact, self.contact = self.contact, None
        if contact is not None:
            await asyncio.to_thread(contact.close)


@dataclass(frozen=True)
class Tablet:
    """What plays for a page that is stroked on, and its pen."""

    blocks: BlockQueue
    rate_hz: float = SOUND_RATE_HZ
    volume_db: float = 0.0
    calibration: PressureCalibration = field(default_factory=PressureCalibration)


class Stroking:
    """What is stroked in the present trial, and in earlier ones; `changing` is held by who changes the step."""

    def __init__(
        self,
        study: RunningStudy,
        number: int,
        on_stored: Callable[[int, int], None],
        state: Callable[[], State],
        changing: asyncio.Lock,
    ) -> None:
        self._study, self._number, self._state, self._changing = study, number, state, changing
        self.kept = ParticipantStore(study.store, number, study.on_disk, on_stored)
        self.sound = TrialSound(study, number)
        self.tablet: Tablet | None = None  # that is played for

    def resume(self, trial: Trial) -> None:
        """Take over what was stroked in a trial before the server began."""
        self.log.resume(self._study.store.parts(self._number, trial.number))
        self.kept.n_taken[trial.number] += sum(len(events) for _, events in self.log.events)

    @property
    def log(self) -> TrialLog:
        """That of the present trial; of another step an empty one."""
        trial = self._state().trial
        return TrialLog() if trial is None else self.kept.logs[trial.number]

    async def push(self, tablet: Tablet, events: NDArray[np.float64]) -> bool:
        """Take in events of the pen; the first of a trial make its surfaces ready. Whether they are rendered."""
        state = self._state()
        if (trial := state.trial) is None:
            return False
        if state.held or state.side == "real":  # they were on their way
            self.kept.n_taken[trial.number] += len(events)
            return False
        if self.sound.contact is None:
            async with self._changing:
                if self.sound.contact is None and self._state().trial is trial:
                    await self._open(tablet, trial)
        if self.sound.has_stopped:
            async with self._changing:
                if self.sound.has_stopped:  # else it was ended meanwhile
                    self.log.n_stopped += 1
                    await self.sound.end_stopped()
        if self.sound.contact is None or self._state().trial is not trial:
            return False
        self.sound.contact.push(events)
        self.log.events.append((self._state().interval, events))
        self.kept.n_taken[trial.number] += len(events)
        return True

    async def push_missed(
        self, tablet: Tablet, number: int, interval: int, first: int, events: NDArray[np.float64]
    ) -> None:
        """Take in events of a trial that an outage kept, the `first` by its number: not rendered, and none twice.

        Those of a trial that was answered meanwhile are stored, and are not in its rating's measures.
        """
        state, step_id = self._state(), f"trial:{number}"
        trial = next((step["trial"] for step in state.steps if step["id"] == step_id), None)
        if trial is None or step_id not in (state.step["id"], *state.done):
            raise RefusedError(f"events of trial {number}, which was not shown")
        methods = self._study.design.kind.surfaces(trial)
        if not interval < len(methods):
            raise RefusedError(f"events of surface {interval + 1}, expected one of {len(methods)}")
        events = await self.kept.events_not_taken(number, first, events)
        if not len(events):
            return
        texture = self._study.bytes_of[trial.texture, methods[interval]]
        conditions = await asyncio.to_thread(conditions_of, events, texture, tablet.calibration)
        log = self.kept.logs[number]
        log.events.append((interval, events))
        log.conditions.extend((interval, *condition) for condition in conditions)
        self.kept.n_taken[number] = max(self.kept.n_taken[number], first) + len(events)
        await self.kept.save_when_due()

    async def _open(self, tablet: Tablet, trial: Trial) -> None:
        log, plays_in_page = self.log, self._study.plays_in_page

        def on_block(samples: NDArray[np.float32], gain: float, speed: float, force: float) -> None:
            log.conditions.append((self._state().interval, speed, force))
            if plays_in_page:
                tablet.blocks.put(samples * np.float32(gain), speed, force)  # the page bends what is too loud

        interval = self._state().interval
        log.contacts.append(await self.sound.open(tablet.rate_hz, tablet.calibration, trial, interval, on_block))
        self.tablet, self.kept.saved_at_s = tablet, time.monotonic()

    async def end(self) -> None:
        """End playing, and save the strokes."""
        await self.kept.save()
        with contextlib.suppress(OSError, ValueError, RuntimeError):
            await self.sound.close()

    async def measured(self, trial: Trial, tablet: Tablet | None) -> dict[str, Any]:
        """What is stored with the answer to a trial, beside it."""
        log, level_db = self.log.summary(), await self.sound.level_db(trial)
        if level_db is not None:
            log["level_db"] = level_db
        if tablet is not None:
            curve = tablet.calibration
            log |= {"volume_db": tablet.volume_db, "rate_hz": tablet.rate_hz, "newtons": curve.a, "steepness": curve.b}
        return log

    @property
    def contact_s(self) -> tuple[float, ...]:
        """Seconds in contact with each of the trial's surfaces."""
        return tuple(self.log.contact_s(interval) for interval in range(self._study.design.n_surfaces))
