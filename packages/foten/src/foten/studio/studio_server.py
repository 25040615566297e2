"""Server of the studio: its page, the textures, and WebSockets for strokes that are rendered here and for captures.

Each page has its own state, which is freed when the page is lost.
"""

import asyncio
import contextlib
import mimetypes
from collections.abc import AsyncIterator, Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket

from foten import __version__
from foten.runtime.actuator import ActuatorProfile
from foten.runtime.live.devices import SOUND_RATE_HZ
from foten.runtime.renderer import Renderer
from foten.runtime.stylus import PressureCalibration
from foten.studio.access import Access, Guarded
from foten.studio.capture_server import CapturePage, TrainingQueue, why_not
from foten.studio.levels import gains_db
from foten.studio.live_contact import Contact
from foten.studio.messages import STROKE, RefusedError
from foten.studio.page_files import page_files
from foten.studio.players import OutputDevice, Player, RoundRobinRenderer
from foten.studio.shelf import Shelf
from foten.studio.websocket import MAX_MESSAGES_PER_S, BlockQueue, PageSocket, pressure_calibration, serve_page

MAX_PAGES = 64  # that stroke at once
MAX_COMPARED = 16  # methods
MAX_CAPTURING = 8  # pages at once, each of which holds its sound or waits for its texture
CAPTURES = Path("captures")  # below where the server is started
MAX_TUNING_WAIT_S = 2.0  # for the sliders of other pages; one search for what they say takes 10 s
STATE_S = 1.0  # between two reports of how rendering keeps up


class Studio:
    """The textures of a server, its folder of captures and its output, and the pages that are there."""

    def __init__(self, shelf: Shelf, captures: Path = CAPTURES, output_device: OutputDevice | None = None) -> None:
        self.shelf = shelf
        self.players: dict[str, Callable[[float], Player]] = {
            "stream": RoundRobinRenderer().player,
            "device": (output_device or OutputDevice()).player,
        }
        self.trainings = TrainingQueue(captures, shelf)
        self.capture_pages: set[CapturePage] = set()
        self._matching = asyncio.Lock()
        self._tuning = asyncio.Lock()
        self.pages: set[StrokePage] = set()
        self.n_refused = 0

    def app(self, access: Access) -> ASGIApp:
        """Application, behind its access."""
        routes = [
            Route("/textures.json", self._textures),
            Route("/textures/{key}", self._texture),
            Route("/pictures/{name}", self._picture),
            Route("/gains", self._gains),  # ?texture=A&texture=B
            Route("/tuned", self._tuned, methods=["POST"]),  # ?texture=A&brighter=0.5&other=B&at=0.3&exact=1
            Route("/state", self._state),
            WebSocketRoute("/stroke", self._stroke),
            WebSocketRoute("/capture", self._capture),
            Route("/{name:path}", self._file),
        ]
        return Guarded(Starlette(routes=routes, lifespan=self._lifespan), access)

    @contextlib.asynccontextmanager
    async def _lifespan(self, _app: Starlette) -> AsyncIterator[None]:
        yield
        for page in list(self.pages):
            await page.leave()
        await self.trainings.close()

    async def _textures(self, _request: Request) -> Response:
        return JSONResponse({**self.shelf.listed(), "cannot_train": why_not()})

    async def _texture(self, request: Request) -> Response:
        entry = self.shelf.get(request.path_params["key"])
        if entry is None:
            return missing(f"there is no texture {request.path_params['key'][:80]!r} here")
        return FileResponse(entry.path, media_type="application/octet-stream")

    async def _picture(self, request: Request) -> Response:
        path = self.shelf.files().get(f"pictures/{request.path_params['name']}")
        return missing("there is no such picture here") if path is None else FileResponse(path)

    async def _gains(self, request: Request) -> Response:
        keys = request.query_params.getlist("texture")
        entries = [self.shelf.get(key) for key in keys]
        if not 2 <= len(keys) <= MAX_COMPARED or None in entries:
            return missing(f"expected 2 to {MAX_COMPARED} textures of this server")

        def gains() -> list[float]:
            renderers = [Renderer(entry.path) for entry in entries if entry is not None]
            return gains_db(renderers, [1 / renderer.native_texture.info.acceleration_sd for renderer in renderers])

        try:
            async with self._matching:  # a page that asks again and again waits for itself alone
                return JSONResponse({"gains_db": await asyncio.to_thread(gains)})
        except ValueError as error:
            return missing(f"cannot be compared: {error}")

    async def _tuned(self, request: Request) -> Response:
        from foten.studio import tuning

        query = request.query_params
        entry, other = self.shelf.get(query.get("texture", "")), self.shelf.get(query.get("other", ""))
        if entry is None or ("other" in query and other is None):
            return missing("there is no such texture here")
        try:
            moves, exact = tuning.moves_of(query), query.get("exact") == "1"
            async with asyncio.timeout(MAX_TUNING_WAIT_S) as waiting, self._tuning:
                waiting.reschedule(None)
                data = await asyncio.to_thread(
                    tuning.tuned, entry.path, None if other is None else other.path, moves, exact
                )
        except TimeoutError:
            return PlainTextResponse("another texture is being moved: try again in some seconds\n", status_code=503)
        except (OSError, ValueError) as error:
            return missing(f"{entry.name} cannot be moved so: {error}")
        return Response(data, media_type="application/octet-stream")

    async def _state(self, _request: Request) -> Response:
        pages = [page.state() for page in self.pages]
        return JSONResponse({"foten": __version__, "n_refused": self.n_refused, "pages": pages})

    async def _file(self, request: Request) -> Response:
        return page_file(page_files(), request.path_params["name"] or "index.html")

    async def _stroke(self, socket: WebSocket) -> None:
        await serve_page(socket, self.pages, MAX_PAGES, lambda socket: StrokePage(self, socket))

    async def _capture(self, socket: WebSocket) -> None:
        pages = self.capture_pages
        await serve_page(socket, pages, MAX_CAPTURING, lambda socket: CapturePage(socket, self.trainings, pages))


class StrokePage(PageSocket):
    """A page that strokes: events and settings in, what is rendered for it back."""

    def __init__(self, studio: Studio, socket: WebSocket) -> None:
        self._studio, self._blocks = studio, BlockQueue(socket)
        senders = self._blocks.send, self._send_state
        super().__init__(socket, STROKE, *senders, max_messages_per_s=MAX_MESSAGES_PER_S)
        self._contact: Contact | None = None
        self._opening: Contact | None = None  # that does not play yet
        self._calibration = PressureCalibration()
        self._texture, self._sink, self._rate_hz = "", "", 0.0
        self._n_events = 0

    async def leave(self) -> None:
        contacts = [contact for contact in (self._contact, self._opening) if contact is not None]
        self._contact = self._opening = None
        for contact in contacts:
            with contextlib.suppress(OSError, ValueError, RuntimeError):  # the page was sent why it died
                await asyncio.to_thread(contact.close)

    def state(self) -> dict[str, Any]:
        """How the page does, for people."""
        known: dict[str, Any] = {"texture": self._texture, "sink": self._sink, "n_events": self._n_events}
        known |= {"n_refused": self.n_refused, "n_unsent": self._blocks.n_unsent}
        if (contact := self._contact) is not None:
            live = contact.player.statistics
            known |= {"block_ms": live.block_ms, "n_missed": live.n_missed, "n_underruns": live.n_underruns}
            times = {f"block_p{p}_ms": 1000 * live.block.percentile_s(p) for p in (50, 99)}
            known |= {name: None if np.isnan(value) else value for name, value in times.items()}
            known["stylus"] = contact.stylus_counts
        return known

    def refuse(self, why: str) -> None:
        self._studio.n_refused += 1
        super().refuse(why)

    async def take_bytes(self, data: bytes) -> None:
        events = self.events_in(data)
        if self._contact is None:
            raise RefusedError("events before a texture was opened")
        self._contact.push(events)
        self._n_events += len(events)

    async def do(self, message: Mapping[str, Any]) -> None:
        kind = message["do"]
        if {"newtons", "steepness"} & message.keys():
            self._calibration = pressure_calibration(message)
        if kind == "open":
            await self._open(message)
        elif kind == "close":
            await self.leave()
            self.say({"closed": True})
        elif self._contact is None:
            raise RefusedError(f"{kind} before a texture was opened")
        elif kind == "calibrate":
            self._contact.calibrate(self._calibration)
        elif kind == "actuate":
            self._actuate(message)
        if self._contact is not None and "volume_db" in message:
            self._contact.set_volume(float(message["volume_db"]))

    async def _open(self, message: Mapping[str, Any]) -> None:
        entry = self._studio.shelf.get(message["texture"])
        if entry is None:
            raise RefusedError(f"there is no texture {message['texture'][:80]!r} here")
        sink = message.get("sink", "stream")
        rate_hz = float(message.get("rate_hz", SOUND_RATE_HZ))
        if self._contact is not None and (sink, rate_hz) != (self._sink, self._rate_hz):
            await self.leave()
        try:
            data = await asyncio.to_thread(entry.path.read_bytes)
            contact = self._contact
            if contact is None:
                player = await asyncio.to_thread(self._studio.players[sink], rate_hz)
                contact = self._opening = Contact(player, self._blocks.put)
            await asyncio.to_thread(contact.open, data, self._calibration)
            self._contact, self._opening = contact, None
        except (OSError, ValueError) as error:
            await self.leave()
            raise RefusedError(f"{entry.key} cannot be played: {error}") from error
        self._texture, self._sink, self._rate_hz = entry.key, sink, rate_hz
        self.say({"opened": entry.key, "sink": sink, "rate_hz": rate_hz})

    def _actuate(self, message: Mapping[str, Any]) -> None:
        assert self._contact is not None
        figures: dict[str, Any] = {name: value for name, value in message.items() if name not in ("do", "full_scale")}
        try:
            actuator = ActuatorProfile(**figures) if figures else None
            self._contact.actuate(actuator, float(message.get("full_scale", 1.0)))
        except ValueError as error:
            raise RefusedError(str(error)) from error

    async def _send_state(self) -> None:
        while True:
            await asyncio.sleep(STATE_S)
            contact = self._contact
            if contact is None:
                continue
            self.say({"state": self.state()})
            if not contact.player.running and contact is self._contact:
                self._contact = None
                try:
                    await asyncio.to_thread(contact.close)
                except (OSError, ValueError, RuntimeError) as error:
                    self.say({"refused": f"{self._texture} plays no more: {error}"})


_TYPES = {".mjs": "text/javascript", ".js": "text/javascript", ".wasm": "application/wasm", ".html": "text/html"}


def page_file(files: Mapping[str, Path], name: str) -> Response:
    """A file of a page, of the type that it has whatever this machine's registry says."""
    path = files.get(name)  # looked up, not joined: a name with dots and slashes is none of these
    if path is None:
        return missing(f"there is no {name[:80]!r} here")
    return FileResponse(path, media_type=_TYPES.get(path.suffix) or mimetypes.guess_type(name)[0])


def missing(why: str) -> Response:
    """Answer that something is not here, in a line."""
    return PlainTextResponse(f"{why}\n", status_code=404)
