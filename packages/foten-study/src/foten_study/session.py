"""A participant while the study runs: the page at its socket, and the session that carries out what `protocol` says."""

from __future__ import annotations

import asyncio
import math
import struct
import time
from collections.abc import Mapping
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from starlette.websockets import WebSocket

from foten.runtime.live.devices import SOUND_RATE_HZ
from foten.studio.messages import RefusedError, parse_events
from foten.studio.websocket import STAYS, BlockQueue, PageSocket, pressure_calibration
from foten_study import protocol
from foten_study.loading import RunningStudy
from foten_study.orders import Trial
from foten_study.protocol import PARTICIPANT, Change, Measured, Moment, NotYetError, Step
from foten_study.strokes import Stroking, Tablet

COME_BACK_S = 5.0  # for the tablet of two screens, before an answer is taken without it
MISSED, EVENT_BYTES = b"m", 32
# `MISSED`, surface, trial and number in the trial of the first event that follows.
BEFORE_MISSED = struct.Struct("<cBii")
ELSEWHERE = 4001  # code of a WebSocket's end, of those that are free for programs
JOIN_S = 10.0  # from a connection to its page's joining
LETTERS = "ABCDEFGHJKMNPQRSTUVWXYZ"  # of a code, that are not taken for one another
CODE_LENGTH = 5


class Session:
    """A participant of a study that runs.

    A step that was answered is in the database before the next is shown; where a participant is, the database knows.
    """

    def __init__(self, study: RunningStudy, number: int, code: str) -> None:
        self.study, self.number, self.code = study, number, code
        self.pages: set[ParticipantPage] = set()
        self.asking: dict[int, ParticipantPage] = {}  # to go on where another device was, by the number of the request
        self.returned = False  # the place, to the next participant
        self.trouble = ""  # for the operator: why the last answer was not stored
        # Where an operator gives out the codes, a place waits for its first page.
        self.last_message_at = math.inf if study.design.setup.operator else time.monotonic()
        self._alone_since_s = time.monotonic()  # without a page to stroke on, where there is none
        self.changing = asyncio.Lock()
        self.strokes = Stroking(study, number, self._say_stored, lambda: self.state, self.changing)
        store = study.store
        self.state = protocol.begin(study.design, store.trials(number), store.done(number))
        if (trial := self.state.trial) is not None:  # as it was before the server ended
            self.strokes.resume(trial)
            sides, since = store.switches(number, trial.number), store.shown(number, trial.number)
            self.state = protocol.resumed(self.state, sides, since, moment())

    async def _apply(self, change: Change) -> None:
        """Carry out what follows from a message; whoever changes a step has `_changing`."""
        for name, about in change.first:
            await getattr(self, name)(**about)
        if change.state.done != self.state.done:
            self.strokes.kept.begin_trial()
        self.state = change.state
        for name, about in change.then:
            await getattr(self, name)(**about)

    async def finish(self, step_id: str, message: Mapping[str, Any]) -> Mapping[str, Any] | None:
        """Take the answers of a step, into the database; a reply to the page, if any. RefusedError as `protocol.finish`."""
        async with self.changing:
            if self.returned and step_id not in self.state.done:
                raise RefusedError(self.study.design.language.say("no_such_code"))
            measured = await self._measured()
            change = protocol.finish(self.study.design, self.state, step_id, message, measured, moment())
            await self._apply(change)
            return change.reply

    async def _measured(self) -> Measured:
        if (trial := self.state.trial) is None:
            return Measured()
        stroking = [page for page in self.pages if page.strokes]
        coming = any(page.n_again > 0 for page in stroking)
        if not stroking and self.study.design.setup.screens > 1:
            coming = time.monotonic() - self._alone_since_s < COME_BACK_S
        log = await self.strokes.measured(trial, stroking[0].tablet if stroking else None)
        return Measured(self.strokes.contact_s, coming, log)

    async def turn(self, side: str, marked_by: str, interval: int | None = None) -> None:
        """Go over to another surface."""
        async with self.changing:  # an answer or a hold that came now would end the contact
            await self._apply(protocol.turn(self.study.design, self.state, moment(), side, marked_by, interval))

    async def hold(self, held: bool) -> None:
        """Hold the trial that is shown, or let it go on."""
        async with self.changing:
            await self._apply(protocol.hold(self.state, held))

    async def push(self, page: ParticipantPage, events: NDArray[np.float64]) -> None:
        """Take in events of the pen."""
        if await self.strokes.push(page.tablet, events):
            await self._apply(protocol.pen(self.state, down=bool(events[-1, 2] > 0)))
            await self.strokes.kept.save_when_due()

    async def leave(self, page: ParticipantPage) -> None:
        """Go on without a page: its strokes are saved, and its trial stays where it is."""
        self.pages.discard(page)
        if page.strokes:
            self._alone_since_s = time.monotonic()
        async with self.changing:
            if self.strokes.tablet is page.tablet:
                await self.end_contact()
                self.strokes.tablet = None

    def shown(self) -> Step:
        """The step as a participant's page gets it."""
        touched = [i for i, seconds in enumerate(self.strokes.contact_s) if seconds]
        page = protocol.shown(self.study.design, self.state, touched, self.strokes.kept.n_taken)
        return {**page, "simulated": self.study.store.simulated}

    def for_operator(self) -> dict[str, Any]:
        """What the operator's page gets."""
        page = protocol.described(self.study.design, self.state)
        page |= {"number": self.number, "code": self.code, "pages": sorted(page.role for page in self.pages)}
        contact = self.strokes.sound.contact
        if n := self.n_unsaved:
            page["n_unsaved"] = n
        if self.asking:
            page["asks"] = min(self.asking)
        if trouble := self.trouble or self.strokes.sound.trouble:
            page["trouble"] = trouble
        if contact is not None:
            live = contact.player.statistics  # how long a block takes would tell methods apart
            page |= {"n_missed": live.n_missed, "n_underruns": live.n_underruns}
        return page

    async def begin_showing(self) -> None:
        """Count from when the step is shown first."""
        await self._apply(protocol.showing(self.state, moment()))

    async def show(self) -> None:
        """Show the step on all pages."""
        for page in list(self.pages):
            await page.show()

    async def end_contact(self) -> None:
        """End playing, and save the strokes."""
        await self._apply(protocol.lift(self.state))
        await self.strokes.end()

    @property
    def n_unsaved(self) -> int:
        """Events, of the pen and others, that the disk has had no room for."""
        return self.strokes.kept.n_unsaved(None if self.state.trial is None else self.state.trial.number)

    async def put_under_pen(self) -> None:
        """Render the surface that the pen is on now."""
        await self.strokes.sound.put_under_pen(self.state.step["trial"], self.state.interval)

    async def save_strokes(self) -> None:
        """Save the strokes."""
        await self.strokes.kept.save()

    async def write(self, what: str, values: tuple[Any, ...]) -> None:
        """Store something of the participant by a method of the store, when the disk has room."""
        await self.strokes.kept.write(partial(getattr(self.study.store, what), self.number, *values))

    async def lift(self) -> None:
        """The pen has left what is rendered."""
        if self.strokes.sound.contact is not None:
            self.strokes.sound.contact.lift()

    async def store(self, step: str, **answers: Any) -> None:
        """Store a step with its answers."""
        try:
            await self.study.on_disk(partial(self.study.store.take_step, self.number, step, **answers))
        except OSError as error:
            self.trouble = str(error)
            raise NotYetError(self.study.design.language.say("not_stored")) from error
        self.trouble = self.strokes.sound.trouble = ""

    async def mark(self, event: str, trial: Trial, **about: Any) -> None:
        """Send a marker of a trial, where somebody asked for them."""
        if self.study.markers is not None:
            texture = self.study.design.textures[trial.texture].key
            self.study.markers.send(event, participant=self.number, trial=trial.number, texture=texture, **about)

    def _say_stored(self, trial: int, n: int) -> None:
        for page in [page for page in self.pages if page.strokes]:
            page.say({"stored": n, "trial": f"trial:{trial}"})


class Door(Protocol):
    """Where a page comes in: `participants.Participants`."""

    def by_code(self, code: str) -> Session: ...
    async def begin(self, code: str | None = None) -> Session: ...
    def is_open_to(self, session: Session, page: ParticipantPage) -> bool: ...
    def ask(self, session: Session, page: ParticipantPage, again: bool) -> int: ...


class ParticipantPage(PageSocket):
    """A page of a session, which it joins by its code."""

    def __init__(self, study: RunningStudy, door: Door, socket: WebSocket, device: str | None) -> None:
        self._study, self._door, self.device = study, door, device
        self.tablet = Tablet(BlockQueue(socket))
        super().__init__(socket, PARTICIPANT, self.tablet.blocks.send, self._expect_join)
        self._session: Session | None = None
        self._fresh: str | None = None  # code of the new participant who began here
        self._asks: Session | None = None  # where another device was
        self._request = 0  # its number, also of one that was decided
        self.rank = 0
        self.n_again = 0  # events that it still has to send again
        self.role = "all"

    @property
    def strokes(self) -> bool:
        """Whether it is stroked on."""
        return self.role != "answer"

    async def _expect_join(self) -> None:
        await asyncio.sleep(JOIN_S)
        if not self.rank:
            self.end(1008, f"no code was given within {JOIN_S:g} s")

    async def leave(self) -> None:
        if self._asks is not None:
            self._asks.asking.pop(self._request, None)
        session, self._session, self.rank = self._session, None, 0
        if session is not None:
            await session.leave(self)

    def is_charged(self, data: bytes | None) -> bool:
        return data is None or not is_missed(data)  # those of an outage come at once; `Session` bounds them

    async def take_bytes(self, data: bytes) -> None:
        if not is_missed(data):
            await self._stroking().push(self, self.events_in(data))
            return
        try:
            _, interval, trial, first = BEFORE_MISSED.unpack_from(data)
            events, session = parse_events(data[BEFORE_MISSED.size :]), self._stroking()
            await session.strokes.push_missed(self.tablet, trial, interval, first, events)
        finally:
            self.n_again -= len(data) // EVENT_BYTES

    def _stroking(self) -> Session:
        """Session that is stroked on here, or raise RefusedError."""
        if self._session is None or not self.strokes:
            raise RefusedError("events of a page that does not stroke")
        return self._session

    async def do(self, message: Mapping[str, Any]) -> None:
        kind, session = message["do"], self._session
        if session is not None:
            session.last_message_at = time.monotonic()
        if kind == "join":
            await self._join(message)
        elif session is None:
            raise RefusedError(f"{kind} before a code was given")
        elif kind == "done":
            await self._finish(session, message)
        elif kind == "side":
            await session.turn(str(message["side"]), "participant", message.get("interval"))
        elif kind == "count":
            session.state = protocol.count_underruns(session.state, str(message["step"]), int(message["underruns"]))

    async def _finish(self, session: Session, message: Mapping[str, Any]) -> None:
        """Take an answer; a refusal says whether it may be sent again as it is."""
        before = session.state.step["id"]
        try:
            reply = await session.finish(str(message["step"]), message)
        except RefusedError as refused:
            again = isinstance(refused, NotYetError)
            self.say({"refused": str(refused), "step": message["step"], "again": again})
            return
        if reply is not None:
            self.say(reply)
        await (session.show() if session.state.step["id"] != before else self.show())

    async def _join(self, message: Mapping[str, Any]) -> None:
        code = message.get("code")
        session = await self._begin(message.get("fresh")) if code is None else self._door.by_code(str(code))
        await self.leave()
        self.role = str(message.get("role", "all"))
        sound = float(message.get("rate_hz", SOUND_RATE_HZ)), float(message.get("volume_db", 0.0))
        self.tablet = Tablet(self.tablet.blocks, *sound, pressure_calibration(message))
        self.n_again = int(message.get("again", 0))
        if not self._door.is_open_to(session, self):
            self._asks, self.rank = session, 1
            self._request = self._door.ask(session, self, again=self._request > 0)
            self.say({"asks": self._request})
            return
        for other in list(session.pages):  # a tab that was forgotten, or this page before its connection was lost
            if other.strokes == self.strokes or "all" in (other.role, self.role):
                await other.leave()
                other.end(ELSEWHERE, "open on another page")
        self._session, self.rank, session.last_message_at = session, STAYS, time.monotonic()
        session.pages.add(self)
        self.say({"joined": session.code, "plays": self._study.plays_in_page})
        await self.show()

    async def _begin(self, fresh: str | None) -> Session:
        """Session of a new participant; why there is none in the participant's words."""
        design = self._study.design
        if design.setup.operator:
            raise RefusedError(design.language.say("ask_for_code"))
        if fresh is not None and not (len(fresh) == CODE_LENGTH and set(fresh) <= set(LETTERS)):
            raise RefusedError(f"join: fresh is {fresh[:40]!r}, expected {CODE_LENGTH} letters")
        if self._fresh not in (None, fresh):
            raise RefusedError("join: a new participant has begun on this connection; open another")
        self._fresh = fresh or ""
        try:
            return await self._door.begin(fresh)
        except ValueError as error:
            raise RefusedError(design.language.say("all_begun")) from error
        except OSError as error:
            raise RefusedError(design.language.say("cannot_begin")) from error

    async def show(self) -> None:
        """Show the step."""
        if (session := self._session) is not None:
            self.say({"step": session.shown()})
            await session.begin_showing()


def is_missed(data: bytes) -> bool:
    """Whether bytes are of events that are sent again."""
    return data.startswith(MISSED) and len(data) % EVENT_BYTES == BEFORE_MISSED.size


def moment() -> Moment:
    """Now."""
    return Moment(time.monotonic(), time.time())
