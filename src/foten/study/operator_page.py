"""The operator's page at the WebSocket: who is where, and a hand on the trials. It gets nothing of methods, and sends

{"do": "begin"}
{"do": "hold" | "go", "number": 3}
{"do": "side", "number": 3, "side": "real" | "virtual"}
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from starlette.websockets import WebSocket

from foten.studio.messages import Protocol, RefusedError
from foten.studio.websocket import PageSocket
from foten.study.participant_page import SIDES

if TYPE_CHECKING:
    from foten.study.study_server import StudyServer

REFRESH_S = 0.5  # between two pictures of the study
OPERATOR = Protocol(
    {"begin": ((), ()), "hold": (("number",), ()), "go": (("number",), ()), "side": (("number", "side"), ())},
    {"number": (1, 1e6), "side": SIDES},
)


class OperatorPage(PageSocket):
    """The operator's page."""

    def __init__(self, server: StudyServer, socket: WebSocket) -> None:
        super().__init__(socket, OPERATOR)
        self._server = server

    async def run(self) -> None:
        await self.converse(self._show())

    async def do(self, message: Mapping[str, Any]) -> None:
        server, kind = self._server, message["do"]
        if kind == "begin":
            new = await server.begin()
            await self.say({"started": new.number, "code": new.code})
            return
        session = server.sessions.get(int(message["number"]))
        if session is None:
            raise RefusedError(f"there is no participant {message['number']}")
        if kind == "side":
            await session.turn(str(message["side"]), "operator")
        else:
            await session.hold(kind == "hold")

    async def _show(self) -> None:
        server = self._server
        design = server.design
        about = {"title": design.title, "planned": design.participants, "simulated": server.store.simulated}
        about |= {"operator": design.setup.operator, "screens": design.setup.screens}
        while True:
            # Another link after each use: the codes to scan are drawn anew.
            sessions = [session.for_operator() for session in server.sessions.values()]
            await self.say({**about, "link": server.link(), "sessions": sessions})
            await asyncio.sleep(REFRESH_S)
