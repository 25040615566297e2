"""The server of a study: a participant's pages, the operator's page, and the trials between them.

    GET  /                participants' page; its files
    GET  /pictures/N      the picture of a texture
    WS   /session         a participant's page (`study_messages` below)
    GET  /operator        the operator's page, by the key in its link
    WS   /operate         what it shows, and does

What a participant's page is given says nothing of methods: trials by number, textures by name where the study file says so, and
samples. A step that was answered is in the database before the next one is shown; where a participant is, the database knows.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import io
import json
import secrets
import struct
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from http.cookies import SimpleCookie
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import anyio
import numpy as np
from numpy.typing import NDArray
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from foten.runtime.live.devices import SOUND_RATE_HZ
from foten.runtime.stylus import PressureCalibration
from foten.studio.access import Access, Guarded
from foten.studio.live_contact import Contact
from foten.studio.messages import (
    EVENTS_A_SECOND,
    MESSAGES_A_SECOND,
    MOST_BYTES,
    OPERATOR,
    SESSION,
    Allowance,
    RefusedError,
    parse_events,
    parse_message,
)
from foten.studio.players import Player, Turns, Wired
from foten.studio.server import content_type, missing, page_files
from foten.studio.websocket import Blocks, converse
from foten.study.design import Design, Question
from foten.study.orders import Trial
from foten.study.stimuli import Measured, Stimuli
from foten.study.store import Rated, Store

OPERATOR_COOKIE = "foten-operator"
LETTERS = "ABCDEFGHJKMNPQRSTUVWXYZ"  # that are not taken for one another
CODE_LETTERS = 5
MOST_PAGES = 64
ELSEWHERE = 4001  # the code of a WebSocket's end, of those that are ours to give
KEPT_S = 3.0  # between two writings of a stroke
SHOWN_S = 0.5  # between two pictures of the study for the operator
PAGE = Path(__file__).with_name("pages")
OPERATOR_PAGE = "operator.html"
SHARED = (
    "studio.css",
    "pad.js",
    "settings.js",
    "stream.js",
)  # with the studio's page; not the kernel, whose bytes name models
Step = dict[str, Any]


def steps_of(design: Design, trials: Sequence[Trial]) -> list[Step]:
    """Return what a participant goes through, in order: each step has an `id` and a `kind`."""
    steps: list[Step] = []
    if design.consent.strip():
        steps.append({"id": "consent", "kind": "consent", "text": design.consent})
    steps += _asking(design.questions, "start")
    steps.append({"id": "instructions", "kind": "instructions", "text": design.instructions})
    counted = sum(not trial.practice for trial in trials)
    for trial in trials:
        n = trial.number
        steps.append({"id": f"trial:{n}", "kind": "trial", "n": n, "of": counted, "trial": trial})
        if n < 1 or n == counted:
            continue
        steps += _asking(design.questions, n)
        if design.break_every and n % design.break_every == 0:
            steps.append({"id": f"break:{n}", "kind": "break", "n": n, "of": counted})
    return [*steps, *_asking(design.questions, "end"), {"id": "end", "kind": "end"}]


def _asking(questions: Sequence[Question], at: str | int) -> list[Step]:
    asked = [question for question in questions if question.at == at]
    return [{"id": f"questions:{at}", "kind": "questions", "questions": asked}] if asked else []


class StudyServer:
    """A study that runs.

    Args:
        store: its database.
        design, stimuli: as the database has them.
        wired: what plays here; None where the pages do.
        pictures: as the study file names them.
    """

    def __init__(self, store: Store, design: Design, stimuli: Stimuli, wired: Wired | None) -> None:
        self.store, self.design, self.stimuli, self.wired = store, design, stimuli, wired
        self.operator_key = secrets.token_urlsafe(16)
        self.gains = {key: one.gain_db for key, one in store.stimuli().items()}
        turns = Turns()
        self.player: Callable[[float], Player] = turns.player if wired is None else wired.player
        self.link: Callable[[str], str] = lambda query: f"/?{query}"  # by which the next device comes in
        self.sessions: dict[int, Session] = {}
        self.pages: set[ParticipantPage] = set()
        # One thread: SQLite waits for the disk, which the sound must not.
        self.disk = ThreadPoolExecutor(1, thread_name_prefix="foten-store")
        for code, number in store.codes().items():
            self._session(number, code)

    def _session(self, number: int, code: str) -> Session:
        self.sessions[number] = Session(self, number, code, self.store.trials(number), self.store.done(number))
        return self.sessions[number]

    async def on_disk(self, work: Callable[[], Any]) -> Any:
        """Return what some work with the database comes to."""
        return await asyncio.get_running_loop().run_in_executor(self.disk, work)

    async def begin(self, code: str | None = None) -> Session:
        """Return the session of a new participant, under a code that the page drew: one that asks again is the same.

        Raises:
            RefusedError: the design has no more.
        """
        if code is None:
            code = "".join(secrets.choice(LETTERS) for _ in range(CODE_LETTERS))
        elif len(code) != CODE_LETTERS or not set(code) <= set(LETTERS):
            raise RefusedError(f"join: fresh is {code[:40]!r}, expected {CODE_LETTERS} letters")
        for session in self.sessions.values():
            if session.code == code:
                return session
        try:
            return await self.on_disk(lambda: self._session(self.store.join(code), code))
        except (ValueError, OSError) as error:
            raise RefusedError(str(error)) from error

    def by_code(self, code: str) -> Session:
        """Return the session that a code names, or raise RefusedError."""
        for session in self.sessions.values():
            if hmac.compare_digest(session.code.encode(), code.strip().upper().encode()):
                return session
        raise RefusedError("there is no such code; the operator's page shows it")

    def app(self, access: Access) -> ASGIApp:
        """Return the application, behind its access."""
        routes = [
            Route("/operator", self._operator),
            Route("/pictures/{number:int}", self._picture),
            Route("/codes/{code}.svg", self._code),
            WebSocketRoute("/session", self._serve_page),
            WebSocketRoute("/operate", self._serve_operator),
            Route("/{name:path}", self._file),
        ]
        return Guarded(Starlette(routes=routes, lifespan=self._lifespan), access)

    @contextlib.asynccontextmanager
    async def _lifespan(self, _app: Starlette) -> AsyncIterator[None]:
        yield
        for session in self.sessions.values():
            await session.end_contact(keep=True)
        self.disk.shutdown()

    async def _file(self, request: Request) -> Response:
        name = request.path_params["name"] or "study.html"
        path = study_files().get(name)
        if path is None or name == OPERATOR_PAGE:
            return missing(f"there is no {name[:80]!r} here")
        return FileResponse(path, media_type=content_type(path))

    async def _picture(self, request: Request) -> Response:
        number = request.path_params["number"]
        textures = self.design.textures
        path = textures[number].picture if number < len(textures) else None
        shown = path is not None and self.design.setup.show_names
        return FileResponse(path) if path is not None and shown else missing("there is no such picture here")

    async def _operator(self, request: Request) -> Response:
        key = request.query_params.get("key")
        if key is not None and hmac.compare_digest(key.encode(), self.operator_key.encode()):
            moved = RedirectResponse("/operator", status_code=303)
            secure = request.url.scheme == "https"
            moved.set_cookie(OPERATOR_COOKIE, self.operator_key, httponly=True, samesite="lax", secure=secure)
            return moved
        if not self._is_operator(request.headers.get("cookie", "")):
            return PlainTextResponse(
                "this page is the operator's: open the link that the server printed\n", status_code=403
            )
        return FileResponse(PAGE / OPERATOR_PAGE, media_type="text/html")

    async def _code(self, request: Request) -> Response:
        """Return a code to scan, which opens a participant's page."""
        if not self._is_operator(request.headers.get("cookie", "")):
            return missing("this is the operator's")
        import segno

        try:
            query = {"code": self.by_code(request.path_params["code"]).code}
        except RefusedError as error:
            return missing(str(error))
        role = request.query_params.get("role", "all")
        if role in ("stroke", "answer"):
            query["role"] = role
        drawn = io.BytesIO()
        segno.make(self.link(urlencode(query)), error="l").save(drawn, kind="svg", scale=8, border=2)
        return Response(drawn.getvalue(), media_type="image/svg+xml")

    def _is_operator(self, cookies: str) -> bool:
        try:
            morsel = SimpleCookie(cookies).get(OPERATOR_COOKIE)
        except ValueError:
            return False
        return morsel is not None and hmac.compare_digest(morsel.value.encode(), self.operator_key.encode())

    async def _serve_page(self, socket: WebSocket) -> None:
        await socket.accept()
        if len(self.pages) >= MOST_PAGES:
            await socket.close(1013, f"{MOST_PAGES} pages are open already: close one")
            return
        page = ParticipantPage(self, socket)
        self.pages.add(page)
        try:
            await page.run()
        finally:
            with anyio.CancelScope(shield=True):
                await page.leave()
            self.pages.discard(page)

    async def _serve_operator(self, socket: WebSocket) -> None:
        if not self._is_operator(socket.headers.get("cookie", "")):
            await socket.close(1008, "this is the operator's")
            return
        await socket.accept()
        await OperatorPage(self, socket).run()


def study_files() -> dict[str, Path]:
    """Return the files of the study's pages by name."""
    return {path.name: path for path in PAGE.iterdir() if path.is_file()} | {
        name: page_files()[name] for name in SHARED
    }


class NotYetError(RefusedError):
    """An answer that is good, and can be given again as it is a little later."""


class Session:
    """One participant: where they are, their pages, and the contact of the trial that is shown."""

    def __init__(self, server: StudyServer, number: int, code: str, trials: Sequence[Trial], done: set[str]) -> None:
        self.server, self.number, self.code = server, number, code
        self.steps = steps_of(server.design, trials)
        self.done = done
        self.pages: set[ParticipantPage] = set()
        self.held = False
        self.side = "virtual"
        self.n_switches = 0
        self.shown_at = 0.0
        self.contact: Contact | None = None
        self._page: ParticipantPage | None = None  # that the contact plays for
        self._events: list[NDArray[np.float64]] = []
        self._kept_at = 0.0
        self._measured = Measured()
        self._changing = asyncio.Lock()
        self._arrive()
        step = self.step
        if step["kind"] == "trial":  # as it was before the server ended
            self.n_switches = server.store.switches(number, step["trial"].number)
            self._measured.resumed = len(server.store.strokes(number, step["trial"].number)) > 0

    @property
    def step(self) -> Step:
        """Return the first step that is not behind the participant."""
        return next((step for step in self.steps if step["id"] not in self.done), self.steps[-1])

    def _arrive(self) -> None:
        """A step begins: with an operator, a trial waits until the real sample lies there."""
        self.held = self.step["kind"] == "trial" and self.server.design.setup.operator
        self.side, self.n_switches, self.shown_at = "virtual", 0, 0.0
        self._measured = Measured()

    def shown(self) -> dict[str, Any]:
        """Return what a participant's page is told of the step: nothing of methods."""
        design, step = self.server.design, self.step
        public: dict[str, Any] = {name: value for name, value in step.items() if name not in ("trial", "questions")}
        public |= {"title": design.title, "simulated": self.server.store.simulated, "held": self.held}
        if step["kind"] == "questions":
            public["questions"] = [
                {"key": q.key, "text": q.text, "kind": q.kind, "options": list(q.options), "required": q.required}
                for q in step["questions"]
            ]
        if step["kind"] == "trial":
            trial: Trial = step["trial"]
            texture = design.textures[trial.texture]
            public |= {
                "practice": trial.practice,
                "question": design.rating.question,
                "real_side": design.setup.real_side,
            }
            public |= {"lowest": design.rating.lowest, "highest": design.rating.highest, "side": self.side}
            public |= {"least_s": design.rating.least_seconds, "screens": design.setup.screens}
            if design.setup.show_names:
                public |= {"name": texture.name, "picture": f"pictures/{trial.texture}" if texture.picture else None}
        return public

    async def tell(self) -> None:
        """Show the step on all pages."""
        for page in list(self.pages):
            await page.show()

    async def finish(self, step_id: str, message: Mapping[str, Any]) -> None:
        """Take the answers of a step, into the database, and go on; a step that is behind already is left as it is.

        Raises:
            RefusedError: it is not this step's turn, or an answer is missing or wrong, or cannot be stored.
        """
        async with self._changing:
            if step_id in self.done:
                return  # said again by a page that did not learn that it was taken
            step = self.step
            if step_id != step["id"]:
                raise RefusedError(f"it is the turn of {step['id']}, not of {step_id[:40]!r}")
            if step["kind"] == "end":
                return
            await self._store(step, message)
            self.done.add(step_id)
            await self.end_contact(keep=False)
            self._arrive()
            if self.step["kind"] == "end":
                with contextlib.suppress(OSError):
                    await self.server.on_disk(lambda: self.server.store.take_step(self.number, "end"))

    async def _store(self, step: Step, message: Mapping[str, Any]) -> None:
        store, number = self.server.store, self.number
        given: dict[str, Any] = {}
        if step["kind"] == "consent":
            given["consent"] = step["text"]
        elif step["kind"] == "questions":
            given |= _answered(step["questions"], message.get("answers", {}))
        elif step["kind"] == "trial":
            trial: Trial = step["trial"]
            if "rating" not in message:
                raise RefusedError("done: rating is missing")
            if self.held:
                raise NotYetError("the operator holds this trial; your answer is kept here")
            least = self.server.design.rating.least_seconds
            here = time.monotonic() - self.shown_at if self.shown_at else 0.0
            # The page has counted on while the server was away.
            if max(here, float(message.get("seconds") or 0.0)) < least - 0.25:
                raise RefusedError(f"explore both surfaces for {least:g} s first")
            await self.keep_strokes()
            given["rated"] = trial.number, self._rated(message)
        try:
            await self.server.on_disk(lambda: store.take_step(number, step["id"], **given))
        except OSError as error:
            raise NotYetError(f"not stored, and your answer is kept here: {error}") from error

    def _rated(self, message: Mapping[str, Any]) -> Rated:
        live = [] if self.contact is None else [self.contact.statistics]
        about = self._measured.about(live)
        if self.server.wired is None:  # the sound runs dry in the tablet, if anywhere: its page says so
            about["n_underruns"] = None if "underruns" not in message else int(message["underruns"])
        if self.shown_at:
            about["shown_s"] = round(time.monotonic() - self.shown_at, 3)
        stroking = next((page for page in self.pages if page.strokes), None)
        if stroking is not None:
            about |= {
                "volume_db": stroking.volume_db,
                "rate_hz": stroking.rate_hz,
                "n_unsent": stroking.blocks.n_unsent,
            }
            stroking.blocks.n_unsent = 0
        seconds = message.get("seconds")
        return Rated(float(message["rating"]), None if seconds is None else float(seconds), self.n_switches, about)

    async def turn(self, side: str, marked_by: str) -> None:
        """The hand goes over to the real or the virtual surface; on the real one the virtual one is silent."""
        step = self.step
        if step["kind"] != "trial" or self.held or side == self.side:
            return
        self.side = side
        self.n_switches += 1
        trial = step["trial"].number
        with contextlib.suppress(OSError):  # a full disk does not stop a hand; the answer will say it
            await self.server.on_disk(lambda: self.server.store.add_switch(self.number, trial, side, marked_by))
        if side == "real" and self.contact is not None:
            self.contact.lift()
        await self.tell()

    async def hold(self, held: bool) -> None:
        """Hold the trial that is shown, or let it go on."""
        self.held = held and self.step["kind"] == "trial"
        if self.held:
            await self.end_contact(keep=True)
        await self.tell()

    async def push(self, page: ParticipantPage, events: NDArray[np.float64]) -> None:
        """Take in events of the pen; the first of a trial make its texture ready."""
        step = self.step
        if step["kind"] != "trial" or self.held or self.side == "real":
            return
        if self.contact is None:
            async with self._changing:
                if self.contact is None and self.step is step:
                    await self._open(page, step["trial"])
        if self.contact is not None:
            self.contact.push(events)
            self._events.append(events)
            if time.monotonic() - self._kept_at > KEPT_S:
                await self.keep_strokes()

    async def _open(self, page: ParticipantPage, trial: Trial) -> None:
        server, key = self.server, (trial.texture, trial.method)
        rate_hz = page.rate_hz if server.wired is None else SOUND_RATE_HZ
        loop = asyncio.get_running_loop()
        silent = server.wired is not None
        conditions = self._measured.conditions
        volume_db = server.design.output.volume_db + server.gains[key]

        def on_block(samples: NDArray[np.float32], speed: float, force: float) -> None:
            conditions.append((speed, force))
            if not silent:
                block = samples * np.float32(contact.gain)  # the page bends what is too loud
                with contextlib.suppress(RuntimeError):
                    loop.call_soon_threadsafe(
                        page.blocks.put, struct.pack("<ff", speed, force) + block.astype("<f4").tobytes()
                    )

        try:
            player = await asyncio.to_thread(server.player, rate_hz)
            contact = Contact(player, on_block)
            contact.set_volume(volume_db)
            data, seed = server.stimuli.bytes_of[key], 1000 * self.number + trial.number + 500
            await asyncio.to_thread(contact.open, data, page.calibration, seed)
        except (OSError, ValueError) as error:
            raise RefusedError(f"nothing can be played: {error}") from error
        self._measured.block_s = player.statistics.block_ms / 1000
        self.contact, self._page, self._kept_at = contact, page, time.monotonic()

    async def keep_strokes(self) -> None:
        """Write the events that are not in the database yet."""
        events, self._events = self._events, []
        self._kept_at = time.monotonic()
        step = self.step
        if not events or step["kind"] != "trial":
            return
        number, trial, every = self.number, step["trial"].number, np.concatenate(events)
        with contextlib.suppress(OSError):
            await self.server.on_disk(lambda: self.server.store.add_strokes(number, trial, every))

    async def end_contact(self, keep: bool) -> None:
        """End playing, and keep the strokes where the trial goes on later."""
        if keep:
            await self.keep_strokes()
        else:
            self._events = []
        contact, self.contact = self.contact, None
        if contact is not None:
            self._measured.parts.append(contact.statistics)
            with contextlib.suppress(OSError, ValueError, RuntimeError):
                await asyncio.to_thread(contact.close)

    async def leave(self, page: ParticipantPage) -> None:
        """A page is gone: what it stroked is kept, and its trial stays where it is."""
        self.pages.discard(page)
        if self._page is page:
            await self.end_contact(keep=True)
            self._page = None

    def for_operator(self) -> dict[str, Any]:
        """Return what the operator is shown: the texture, and nothing of the method."""
        step = self.step
        shown: dict[str, Any] = {"number": self.number, "code": self.code, "step": step["id"], "kind": step["kind"]}
        shown |= {"n": sum(one.startswith("trial:") and int(one[6:]) > 0 for one in self.done)}
        shown |= {"of": sum(one["kind"] == "trial" and one["n"] > 0 for one in self.steps), "held": self.held}
        shown |= {"pages": sorted(page.role for page in self.pages), "side": self.side, "switches": self.n_switches}
        if step["kind"] == "trial":
            texture = self.server.design.textures[step["trial"].texture]
            shown |= {"texture": texture.name, "real": texture.real, "practice": step["trial"].practice}
        if self.contact is not None:
            live = self.contact.statistics  # how long a block takes would tell methods apart
            shown |= {"n_missed": live.n_missed, "n_underruns": live.n_underruns}
        return shown


def _answered(questions: Sequence[Question], answers: Any) -> dict[str, dict[str, str]]:
    """Return answers and private answers, or raise RefusedError where one is missing or is none."""
    public: dict[str, str] = {}
    private: dict[str, str] = {}
    if not isinstance(answers, dict):
        raise RefusedError("answers are no object")
    for question in questions:
        given = answers.get(question.key, "")
        if not isinstance(given, str) or len(given) > 2000:
            raise RefusedError(f"{question.text}: expected up to 2000 characters")
        given = given.strip()
        if not given:
            if question.required:
                raise RefusedError(f"{question.text}: an answer is missing")
            continue
        if question.kind in ("number", "slider") and not _is_number(given):
            raise RefusedError(f"{question.text}: {given[:40]!r} is no number")
        if question.kind == "choice" and given not in question.options:
            raise RefusedError(f"{question.text}: {given[:40]!r} is none of the choices")
        (private if question.private else public)[question.key] = given
    return {"answers": public, "private": private}


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


class ParticipantPage:
    """A page at the WebSocket: a tablet to stroke on, a screen to answer on, or both."""

    def __init__(self, server: StudyServer, socket: WebSocket) -> None:
        self._server, self._socket = server, socket
        self.blocks = Blocks(socket)
        self._session: Session | None = None
        self.role, self.rate_hz, self.volume_db = "all", SOUND_RATE_HZ, 0.0
        self.calibration = PressureCalibration()
        self._n_refused = 0
        self._events, self._messages = Allowance(EVENTS_A_SECOND), Allowance(MESSAGES_A_SECOND)

    @property
    def strokes(self) -> bool:
        """Return whether it is stroked on."""
        return self.role != "answer"

    async def run(self) -> None:
        """Serve the page until it goes."""
        await converse(self._socket, self._take, lambda: self._n_refused, self.blocks.send())

    async def leave(self) -> None:
        """The page is gone: what it stroked is kept, and its trial stays where it is."""
        session, self._session = self._session, None
        if session is not None:
            await session.leave(self)

    async def _take(self, received: Mapping[str, Any]) -> None:
        try:
            if not self._messages.take(1):
                raise RefusedError(f"more than {MESSAGES_A_SECOND:g} messages a second")
            data = received.get("bytes")
            if data is not None:
                await self._push(data)
            else:
                await self._do(parse_message(received.get("text") or "", SESSION))
        except RefusedError as refused:
            self._n_refused += 1
            await self.say({"refused": str(refused)})

    async def _finish(self, session: Session, message: Mapping[str, Any]) -> None:
        """Take an answer; the page is told whether one that is refused may be given again as it is."""
        before = session.step["id"]
        try:
            await session.finish(str(message["step"]), message)
        except RefusedError as refused:
            again = isinstance(refused, NotYetError)
            await self.say({"refused": str(refused), "step": message["step"], "again": again})
            return
        if session.step["id"] != before:
            await session.tell()
        else:
            await self.show()

    async def _push(self, data: bytes) -> None:
        if len(data) > MOST_BYTES:
            raise RefusedError(f"the message has {len(data)} bytes, expected {MOST_BYTES} at most")
        events = parse_events(data)
        if self._session is None or not self.strokes:
            raise RefusedError("events of a page that does not stroke")
        if not self._events.take(len(events)):
            raise RefusedError(f"more than {EVENTS_A_SECOND:g} events a second")
        await self._session.push(self, events)

    async def _do(self, message: Mapping[str, Any]) -> None:
        kind = message["do"]
        if kind == "join":
            await self._join(message)
            return
        session = self._session
        if session is None:
            raise RefusedError(f"{kind} before a code was given")
        if kind == "done":
            await self._finish(session, message)
        elif kind == "side":
            await session.turn(str(message["side"]), "participant")

    async def _join(self, message: Mapping[str, Any]) -> None:
        server = self._server
        code = message.get("code")
        if code is None and server.design.setup.operator:
            raise RefusedError("ask the operator for a code")
        session = await server.begin(message.get("fresh")) if code is None else server.by_code(str(code))
        await self.leave()
        self.role = str(message.get("role", "all"))
        self.rate_hz = float(message.get("rate_hz", SOUND_RATE_HZ))
        self.volume_db = float(message.get("volume_db", 0.0))
        usual = PressureCalibration()
        self.calibration = PressureCalibration(
            float(message.get("newtons", usual.a)), float(message.get("steepness", usual.b))
        )
        for other in list(session.pages):  # a tab that was forgotten, or this one before its connection was lost
            if other.strokes == self.strokes or "all" in (other.role, self.role):
                await other.make_way()
        self._session = session
        session.pages.add(self)
        await self.say({"joined": session.code, "plays": server.wired is None})
        await self.show()

    async def make_way(self) -> None:
        """Another page goes on with this one's participant."""
        await self.leave()
        with contextlib.suppress(RuntimeError, WebSocketDisconnect):
            await self._socket.close(ELSEWHERE, "open on another page")

    async def show(self) -> None:
        """Show the step."""
        session = self._session
        if session is None:
            return
        if session.step["kind"] == "trial" and not session.held and not session.shown_at:
            session.shown_at = time.monotonic()
        await self.say({"step": session.shown()})

    async def say(self, document: Mapping[str, Any]) -> None:
        """Send a message; a page that is gone is not told."""
        with contextlib.suppress(RuntimeError, WebSocketDisconnect):
            await self._socket.send_text(json.dumps(document, allow_nan=False))


class OperatorPage:
    """The operator's page at the WebSocket."""

    def __init__(self, server: StudyServer, socket: WebSocket) -> None:
        self._server, self._socket = server, socket

    async def run(self) -> None:
        """Serve the page until it goes."""
        showing = asyncio.create_task(self._show())
        try:
            while True:
                text = await self._socket.receive_text()
                try:
                    await self._do(parse_message(text, OPERATOR))
                except RefusedError as refused:
                    await self._socket.send_text(json.dumps({"refused": str(refused)}))
        except (WebSocketDisconnect, RuntimeError, KeyError):
            pass
        finally:
            showing.cancel()
            await asyncio.gather(showing, return_exceptions=True)

    async def _do(self, message: Mapping[str, Any]) -> None:
        server, kind = self._server, message["do"]
        if kind == "begin":
            session = await server.begin()
            await self._socket.send_text(json.dumps({"begun": session.number, "code": session.code}))
            return
        session_of = server.sessions.get(int(message["number"]))
        if session_of is None:
            raise RefusedError(f"there is no participant {message['number']}")
        if kind == "hold":
            await session_of.hold(True)
        elif kind == "go":
            await session_of.hold(False)
        elif kind == "side":
            await session_of.turn(str(message["side"]), "operator")

    async def _show(self) -> None:
        server = self._server
        while True:
            document = {
                "title": server.design.title,
                "planned": server.design.participants,
                "simulated": server.store.simulated,
                "operator": server.design.setup.operator,
                "screens": server.design.setup.screens,
                "link": server.link(""),  # another once it was used: what is shown is made anew
                "sessions": [session.for_operator() for session in server.sessions.values()],
            }
            await self._socket.send_text(json.dumps(document, allow_nan=False))
            await asyncio.sleep(SHOWN_S)
