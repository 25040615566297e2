"""WebSockets of a study's pages: a participant's, to stroke on, to answer on, or both, and the operator's.

No page gets anything of methods: trials go out by number, textures by name where the study file says so.
"""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from starlette.websockets import WebSocket

from foten.runtime.live.devices import SOUND_RATE_HZ
from foten.runtime.stylus import PressureCalibration
from foten.studio.messages import CALIBRATION, PLAYING_FIELDS, Protocol, RefusedError, parse_events
from foten.studio.websocket import STAYS, BlockQueue, PageSocket, pressure_calibration
from foten.study.session import NotYetError, Session

if TYPE_CHECKING:
    from foten.study.study_server import StudyServer

REFRESH_S = 0.5  # between two pictures of the study
MISSED, EVENT_BYTES = b"m", 32
BEFORE_MISSED = struct.Struct(
    "<cBii"
)  # `MISSED`, surface, trial and number in the trial of the first event that follows
ELSEWHERE, NOT_ALLOWED = 4001, 4002  # codes of a WebSocket's end, of those that are free for programs
JOIN_AGAIN = 1012  # a page connects again by itself
JOIN_S = 10.0  # from a connection to its page's joining
SIDES = ("virtual", "real")
LETTERS = "ABCDEFGHJKMNPQRSTUVWXYZ"  # of a code, that are not taken for one another
CODE_LENGTH = 5
PARTICIPANT = Protocol(
    {
        # A fresh code is drawn by the page of a new participant, where there is no operator.
        "join": ((), ("code", "fresh", "role", "rate_hz", "volume_db", "again", *CALIBRATION)),
        "done": (("step",), ("values", "seconds", "underruns", "answers")),
        "side": (("side",), ("interval",)),
        "count": (("step", "underruns"), ()),
    },
    {
        **PLAYING_FIELDS,
        "role": ("all", "stroke", "answer"),
        "side": SIDES,
        "interval": (0, 2),
        "again": (0, 1e7),
        "seconds": (0.0, 1e6),
        "underruns": (0, 1e6),
        "code": None,
        "fresh": None,
        "step": None,
    },
)
OPERATOR = Protocol(
    {
        "begin": ((), ()),
        "hold": (("number",), ()),
        "go": (("number",), ()),
        "side": (("number", "side"), ()),
        "allow": (("number", "request"), ()),
        "refuse": (("number", "request"), ()),
        "return": (("code",), ()),
    },
    {"code": None, "number": (1, 1e6), "side": SIDES, "request": (1, 1e9)},
)


class ParticipantPage(PageSocket):
    """A page of a session, which it joins by its code."""

    def __init__(self, server: StudyServer, socket: WebSocket) -> None:
        self._server, self.blocks = server, BlockQueue(socket)
        super().__init__(socket, PARTICIPANT, self.blocks.send, self._expect_join)
        self._session: Session | None = None
        self._fresh: str | None = None  # code of the new participant who began here
        self._asks: Session | None = None  # where another device was
        self._request = 0  # its number, also of one that was decided
        self.rank = 0
        self.n_again = 0  # events that it still has to send again
        self.device = server.device_of(socket)
        self.role, self.rate_hz, self.volume_db = "all", SOUND_RATE_HZ, 0.0
        self.calibration = PressureCalibration()

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
            events = parse_events(data[BEFORE_MISSED.size :])
            await self._stroking().push_missed(self, trial, interval, first, events)
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
            session.count_underruns(str(message["step"]), int(message["underruns"]))

    async def _finish(self, session: Session, message: Mapping[str, Any]) -> None:
        """Take an answer; a refusal says whether it may be sent again as it is."""
        before = session.step["id"]
        try:
            feedback = await session.finish(str(message["step"]), message)
        except RefusedError as refused:
            again = isinstance(refused, NotYetError)
            self.say({"refused": str(refused), "step": message["step"], "again": again})
            return
        if feedback is not None:
            self.say({"feedback": feedback})
        if session.step["id"] != before:
            await session.show()
        else:
            await self.show()

    async def _join(self, message: Mapping[str, Any]) -> None:
        code = message.get("code")
        session = await self._begin(message.get("fresh")) if code is None else self._server.by_code(str(code))
        await self.leave()
        self.role = str(message.get("role", "all"))
        self.rate_hz = float(message.get("rate_hz", SOUND_RATE_HZ))
        self.volume_db = float(message.get("volume_db", 0.0))
        self.n_again = int(message.get("again", 0))
        self.calibration = pressure_calibration(message)
        if not session.is_open_to(self.device, self.role):
            self._ask(session)
            return
        session.give(self.device, self.role)
        for other in list(session.pages):  # a tab that was forgotten, or this page before its connection was lost
            if other.strokes == self.strokes or "all" in (other.role, self.role):
                await other.leave()
                other.end(ELSEWHERE, "open on another page")
        self._session, self.rank, session.last_message_at = session, STAYS, time.monotonic()
        session.pages.add(self)
        self.say({"joined": session.code, "plays": self._server.output is None})
        await self.show()

    def _ask(self, session: Session) -> None:
        """Wait for the operator, who allows what a code alone does not: to go on where another device was."""
        server, asks_again = self._server, self._request > 0
        self._asks, self._request, self.rank = session, next(server.requests), 1
        session.asking[self._request] = self
        self.say({"asks": self._request})
        if not server.operators and not asks_again:
            who = f"participant {session.number}, {session.code}: another device asks to go on"
            server.say(f"{who}, request {self._request}; allow it at {server.operator_link}")

    async def _begin(self, fresh: str | None) -> Session:
        """Session of a new participant; why there is none in the participant's words."""
        design = self._server.design
        if design.setup.operator:
            raise RefusedError(design.language.say("ask_for_code"))
        if fresh is not None and (len(fresh) != CODE_LENGTH or not set(fresh) <= set(LETTERS)):
            raise RefusedError(f"join: fresh is {fresh[:40]!r}, expected {CODE_LENGTH} letters")
        if self._fresh not in (None, fresh):
            raise RefusedError("join: a new participant has begun on this connection; open another")
        self._fresh = fresh or ""
        try:
            return await self._server.begin(fresh)
        except ValueError as error:
            raise RefusedError(design.language.say("all_begun")) from error
        except OSError as error:
            raise RefusedError(design.language.say("cannot_begin")) from error

    async def show(self) -> None:
        """Show the step."""
        session = self._session
        if session is None:
            return
        self.say({"step": session.shown()})
        await session.begin_showing()


def is_missed(data: bytes) -> bool:
    """Whether bytes are of events that are sent again."""
    return data.startswith(MISSED) and len(data) % EVENT_BYTES == BEFORE_MISSED.size


class OperatorPage(PageSocket):
    """The operator's page."""

    def __init__(self, server: StudyServer, socket: WebSocket) -> None:
        super().__init__(socket, OPERATOR, self._show)
        self._server = server

    async def do(self, message: Mapping[str, Any]) -> None:
        server, kind = self._server, message["do"]
        if kind in ("begin", "return"):
            try:
                if kind == "return":  # by its code: the number may be another one's by now
                    await server.by_code(str(message["code"])).return_place()
                    return
                new = await server.begin()
            except (ValueError, OSError) as error:
                raise RefusedError(str(error)) from error
            self.say({"started": new.number, "code": new.code})
            return
        session = server.sessions.get(int(message["number"]))
        if session is None:
            raise RefusedError(f"there is no participant {message['number']}")
        if kind == "side":
            await session.turn(str(message["side"]), "operator")
        elif kind in ("allow", "refuse"):
            page = session.asking.pop(int(message["request"]), None)
            if page is None:
                raise RefusedError("that device does not ask any more")
            if kind == "allow":
                session.give(page.device, page.role)
                page.end(JOIN_AGAIN, "the operator lets this device go on")
            else:
                page.end(NOT_ALLOWED, "the operator does not let this device go on")
        else:
            await session.hold(kind == "hold")

    async def _show(self) -> None:
        server = self._server
        design = server.design
        about = {"title": design.title, "planned": design.participants, "simulated": server.store.simulated}
        about |= {name: getattr(design.setup, name) for name in ("operator", "screens", "real_checked")}
        while True:
            # Another link after each use: the codes to scan are drawn anew.
            sessions = [session.for_operator() for session in list(server.sessions.values())]  # a thread adds others
            silent = server.noise is not None and not server.noise.running
            self.say({**about, "link": server.link(), "sessions": sessions, "noise_ended": silent})
            await asyncio.sleep(REFRESH_S)
