"""Server of a study: the participants' page, the operator's page by the key in its link, and their WebSockets."""

import asyncio
import contextlib
import html
import io
import json
import secrets
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from string import Template
from typing import Any
from urllib.parse import quote

from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import FileResponse, HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket

from foten.runtime.live.live import Live
from foten.studio.access import COOKIE, Access, Admitted, Guarded, is_same
from foten.studio.messages import RefusedError
from foten.studio.page_files import page_files
from foten.studio.studio_server import missing, page_file
from foten.studio.websocket import serve_page
from foten_study.loading import Markers, RunningStudy, Study
from foten_study.participants import OperatorPage, Participants
from foten_study.session import ParticipantPage, Session
from foten_study.store import Store

OPERATOR_COOKIE = "foten-operator"
OPERATOR = "operator"  # a kind of those who were let in
MAX_PAGES, MAX_OPERATOR_PAGES = 64, 16
PAGES = Path(__file__).with_name("pages")
PAGE, OPERATOR_PAGE = "study.html", "operator.html"
SHARED = ("studio.css", "pad.js", "settings.js", "stream.js")  # not the kernel, whose bytes name models


class StudyServer:
    """A study that runs, with its database; `admitted` are devices and operators, also of a server before this one."""

    def __init__(
        self, store: Store, study: Study, admitted: Admitted | None = None, markers: Markers | None = None
    ) -> None:
        self.study = RunningStudy(store, study, markers)
        self.store, self.design = store, study.design
        self.admitted = admitted or Admitted()
        self._pictures = study.pictures
        self.operator_key = secrets.token_urlsafe(16)
        self.link: Callable[..., str]  # by which the next device comes in, as `Access.link` gives it
        self.noise: Live | None = None  # that masks the sound of the actuator
        self.participants = Participants(self.study, self.admitted, lambda: self.operator_link)
        self._has_devices = False
        self.pages: set[ParticipantPage] = set()
        self._downloading = ThreadPoolExecutor(1, thread_name_prefix="foten-download")  # which keeps no answer waiting

    @property
    def sessions(self) -> dict[int, Session]:
        """Sessions of those who have begun, by number."""
        return self.participants.sessions

    def app(self, access: Access) -> ASGIApp:
        """Application, behind its access."""
        self.link, self._has_devices = partial(access.link, access.hosts[0]), access.token is not None
        routes = [
            Route("/operator", self._operator),
            Route("/pictures/{number}", self._picture),
            Route("/codes/{code}.svg", self._code),
            Route("/data.zip", self._data),
            WebSocketRoute("/session", self._serve_page),
            WebSocketRoute("/operate", self._serve_operator),
            Route("/{name:path}", self._file),
        ]
        app = Starlette(routes=routes, lifespan=self._lifespan)
        return Guarded(app, access, self.admitted, self.design.language.say("link_used"))

    @contextlib.asynccontextmanager
    async def _lifespan(self, _app: Starlette) -> AsyncIterator[None]:
        again = asyncio.create_task(self.participants.save_again())
        yield
        again.cancel()
        for session in list(self.sessions.values()):
            await session.end_contact()
        self._downloading.shutdown()
        self.study.disk.shutdown()

    async def _file(self, request: Request) -> Response:
        name = request.path_params["name"]
        return HTMLResponse(self._page()) if name in ("", PAGE) else page_file(study_files(), name)

    def _page(self) -> str:
        """The participants' page in their language, which it has before any connection."""
        language = self.design.language
        values = {"language": language.code, "dir": language.dir, "title": self.design.title}
        values |= {name: language.say(name) for name in ("simulated", "progress", "no_script", "set_up")}
        words = json.dumps(dict(language.words), ensure_ascii=False).replace("<", "\\u003c")  # nothing ends the script
        escaped = {name: html.escape(value) for name, value in values.items()}
        return Template((PAGES / PAGE).read_text(encoding="utf-8")).substitute(escaped, words=words)

    async def _picture(self, request: Request) -> Response:
        picture = self._pictures.get(request.path_params["number"]) if self.design.setup.show_names else None
        if picture is None:
            return missing("there is no such picture here")
        return Response(picture[1], media_type=picture[0])

    async def _operator(self, request: Request) -> Response:
        key = request.query_params.get("key")
        if key is not None and is_same(key, self.operator_key):
            response = RedirectResponse("/operator", status_code=303)
            secure = request.url.scheme == "https"
            response.set_cookie(
                OPERATOR_COOKIE, self.admitted.add(OPERATOR), httponly=True, samesite="lax", secure=secure
            )
            return response
        if not self._is_operator(request):
            why = "this page is the operator's: open the link that the server printed\n"
            return PlainTextResponse(why, status_code=403)
        return FileResponse(PAGES / OPERATOR_PAGE, media_type="text/html")

    async def _code(self, request: Request) -> Response:
        """A code to scan, which opens a participant's page."""
        if not self._is_operator(request):
            return missing("this is the operator's")
        import segno

        try:
            query = {"code": self.participants.by_code(request.path_params["code"]).code}
        except RefusedError as error:
            return missing(str(error))
        if (role := request.query_params.get("role")) in ("stroke", "answer"):
            query["role"] = role
        drawn = io.BytesIO()
        segno.make(self.link(**query), error="l").save(drawn, kind="svg", scale=8, border=2)
        return Response(drawn.getvalue(), media_type="image/svg+xml")

    async def _data(self, request: Request) -> Response:
        """All answers so far, with their methods, to be saved."""
        if not self._is_operator(request):
            return missing("this is the operator's")
        from foten_study.record import zipped

        def packed() -> bytes:
            with Store(self.store.path, read_only=True) as store:
                return zipped(store)

        try:
            data = await asyncio.get_running_loop().run_in_executor(self._downloading, packed)
        except ValueError as error:
            return missing(str(error))
        named = f"attachment; filename*=UTF-8''{quote(f'{self.store.path.stem}.zip')}"  # a header is in Latin-1
        return Response(data, media_type="application/zip", headers={"content-disposition": named})

    def device_of(self, connection: HTTPConnection) -> str | None:
        """Secret of the device that a page is on; None for a server of this machine alone, which is one device."""
        return connection.cookies.get(COOKIE) if self._has_devices else None

    @property
    def operator_link(self) -> str:
        """Address of the operator's page, by the newest link."""
        return self.link("operator", other=True, key=self.operator_key)

    def _is_operator(self, connection: HTTPConnection) -> bool:
        return self.admitted.knows(connection.cookies.get(OPERATOR_COOKIE), OPERATOR)

    async def _serve_page(self, socket: WebSocket) -> None:
        study, door = self.study, self.participants
        await serve_page(
            socket, self.pages, MAX_PAGES, lambda one: ParticipantPage(study, door, one, self.device_of(one))
        )

    def _about(self) -> dict[str, Any]:
        """What an operator's page is told of the study."""
        design, noise = self.design, self.noise
        about = {"title": design.title, "planned": design.participants, "simulated": self.store.simulated}
        about |= {name: getattr(design.setup, name) for name in ("operator", "screens", "real_checked")}
        return {**about, "link": self.link(), "noise_ended": noise is not None and not noise.running}

    async def _serve_operator(self, socket: WebSocket) -> None:
        if self._is_operator(socket):
            people, about = self.participants, self._about
            await serve_page(socket, people.operators, MAX_OPERATOR_PAGES, lambda one: OperatorPage(people, one, about))
        else:
            await socket.close(1008, "this is the operator's")


def study_files() -> dict[str, Path]:
    """Files beside the participants' page by name."""
    shared = page_files()
    files = {path.name: path for path in PAGES.iterdir() if path.suffix != ".html"}
    return files | {name: shared[name] for name in SHARED}
