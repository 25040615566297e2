"""The participants of a running study: who has begun, on which devices they go on, and the operator's page about them."""

import asyncio
import contextlib
import itertools
import secrets
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from starlette.websockets import WebSocket

from foten.studio.access import Admitted, is_same
from foten.studio.messages import Protocol, RefusedError
from foten.studio.websocket import PageSocket
from foten_study.loading import RunningStudy
from foten_study.protocol import SIDES
from foten_study.session import CODE_LENGTH, LETTERS, ParticipantPage, Session

REFRESH_S = 0.5  # between two pictures of the study
KEEP_PLACE_S = 600.0  # from the last message of its page, where no step was completed
SAVE_AGAIN_S = 5.0  # between two tries to write strokes that the disk had no room for
NOT_ALLOWED, RETURNED = 4002, 4003  # codes of a WebSocket's end, of those that are free for programs
JOIN_AGAIN = 1012  # a page connects again by itself
PLACES = {"all": ("stroke", "answer"), "stroke": ("stroke",), "answer": ("answer",)}  # that a page of a role takes
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


class Participants:
    """Sessions of a study by the number of the participant; `admitted` are devices, also of a server before this one."""

    def __init__(self, study: RunningStudy, admitted: Admitted, operator_link: Callable[[], str]) -> None:
        self._study, self._admitted, self._operator_link = study, admitted, operator_link
        self.say: Callable[[str], None] = lambda line: None  # to who began the server
        self.operators: set[OperatorPage] = set()
        self._requests = itertools.count(1)  # of devices that ask to go on where another was
        self._beginning = asyncio.Lock()
        self.sessions = {number: Session(study, number, code) for code, number in study.store.codes().items()}

    async def begin(self, code: str | None = None) -> Session:
        """Session of a new participant under its page's code; ValueError where all have begun, OSError of the disk."""
        code = code or "".join(secrets.choice(LETTERS) for _ in range(CODE_LENGTH))
        async with self._beginning:  # two pages may ask with one code
            known = next((session for session in list(self.sessions.values()) if session.code == code), None)
            if known is not None:
                return known
            for session in list(self.sessions.values()):
                if not session.state.done and time.monotonic() - session.last_message_at > KEEP_PLACE_S:
                    with contextlib.suppress(RefusedError):  # it has answered by now
                        await self.return_place(session)

            def join() -> Session:
                number = self._study.store.join(code)
                self.sessions[number] = Session(self._study, number, code)
                return self.sessions[number]

            new: Session = await self._study.on_disk(join)
            return new

    async def return_place(self, session: Session) -> None:
        """Let the next one have a number and its order; RefusedError where a step was completed, OSError of the disk."""
        async with session.changing:  # not between an answer and its being stored
            if session.state.done or session.returned:
                raise RefusedError(f"participant {session.number} has answered, or is gone: nothing is returned")
            await self._study.on_disk(partial(self._study.store.return_place, session.number))
            session.returned = True
            del self.sessions[session.number]
        self._admitted.drop(f"{session.code} ")
        for page in [*session.pages, *session.asking.values()]:
            page.end(RETURNED, "the place was returned")

    def by_code(self, code: str) -> Session:
        """Session that a code names, or raise RefusedError."""
        for session in list(self.sessions.values()):
            if is_same(code.strip().upper(), session.code):
                return session
        raise RefusedError(self._study.design.language.say("no_such_code"))

    def is_open_to(self, session: Session, page: ParticipantPage) -> bool:
        """Whether a page's device takes its role without being allowed: it had it last, or none had it yet."""
        for place in (f"{session.code} {place}" for place in PLACES[page.role]):
            if page.device and self._admitted.has(place) and not self._admitted.knows(page.device, place):
                return False
        self.give(session, page)
        return True

    def give(self, session: Session, page: ParticipantPage) -> None:
        """Let a page's device be the last that had its role, also for the next server."""
        if page.device is not None:
            for place in PLACES[page.role]:
                self._admitted.put(f"{session.code} {place}", page.device)

    def ask(self, session: Session, page: ParticipantPage, again: bool) -> int:
        """Wait for the operator, who allows what a code alone does not: to go on where another device was."""
        request = next(self._requests)
        session.asking[request] = page
        if not self.operators and not again:
            who = f"participant {session.number}, {session.code}: another device asks to go on"
            self.say(f"{who}, request {request}; allow it at {self._operator_link()}")
        return request

    def decide(self, session: Session, request: int, allowed: bool) -> None:
        """Let a device that asks go on, or not."""
        page = session.asking.pop(request, None)
        if page is None:
            raise RefusedError("that device does not ask any more")
        if allowed:
            self.give(session, page)
            page.end(JOIN_AGAIN, "the operator lets this device go on")
        else:
            page.end(NOT_ALLOWED, "the operator does not let this device go on")

    async def save_again(self) -> None:
        """Write what the disk had no room for, once it has."""
        while True:
            await asyncio.sleep(SAVE_AGAIN_S)
            for session in list(self.sessions.values()):
                if session.n_unsaved:
                    await session.strokes.kept.save()


class OperatorPage(PageSocket):
    """The operator's page; `about` is what it is told of the study."""

    def __init__(self, participants: Participants, socket: WebSocket, about: Callable[[], Mapping[str, Any]]) -> None:
        super().__init__(socket, OPERATOR, self._show)
        self._participants, self._about = participants, about

    async def do(self, message: Mapping[str, Any]) -> None:
        participants, kind = self._participants, message["do"]
        if kind in ("begin", "return"):
            try:
                if kind == "return":  # by its code: the number may be another one's by now
                    await participants.return_place(participants.by_code(str(message["code"])))
                    return
                new = await participants.begin()
            except (ValueError, OSError) as error:
                raise RefusedError(str(error)) from error
            self.say({"started": new.number, "code": new.code})
            return
        session = participants.sessions.get(int(message["number"]))
        if session is None:
            raise RefusedError(f"there is no participant {message['number']}")
        if kind == "side":
            await session.turn(str(message["side"]), "operator")
        elif kind in ("allow", "refuse"):
            participants.decide(session, int(message["request"]), kind == "allow")
        else:
            await session.hold(kind == "hold")

    async def _show(self) -> None:
        while True:
            # Another link after each use: the codes to scan are drawn anew. A thread adds sessions.
            sessions = [session.for_operator() for session in list(self._participants.sessions.values())]
            self.say({**self._about(), "sessions": sessions})
            await asyncio.sleep(REFRESH_S)
