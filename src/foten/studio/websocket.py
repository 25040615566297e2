"""What every page at a WebSocket has in common: messages in until it goes, and blocks of samples out."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from foten.studio.messages import MOST_REFUSED

MOST_WAITING = 64  # blocks for a page that does not take them; the oldest go
CONDITION_BYTES = 8  # speed [mm/s] and force [N] before the samples of a block, little-endian float32 as they are


async def converse(
    socket: WebSocket,
    take: Callable[[Mapping[str, Any]], Awaitable[None]],
    n_refused: Callable[[], int],
    *beside: Coroutine[Any, Any, None],
) -> None:
    """Take each message of a page until it goes, or until `MOST_REFUSED` were refused; what is sent to it runs beside."""
    tasks = [asyncio.create_task(one) for one in beside]
    try:
        while True:
            received = await socket.receive()
            if received["type"] == "websocket.disconnect":
                return
            await take(received)
            if n_refused() > MOST_REFUSED:
                await socket.close(1008, f"{MOST_REFUSED} messages were refused")
                return
    except WebSocketDisconnect:
        pass
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


class Blocks:
    """Blocks on their way to a page: a condition, and samples. They are put in from the event loop's thread."""

    def __init__(self, socket: WebSocket) -> None:
        self._socket = socket
        self._waiting: asyncio.Queue[bytes] = asyncio.Queue()
        self.n_unsent = 0  # that the page did not take in time

    def put(self, block: bytes) -> None:
        """Send a block when there is time."""
        self._waiting.put_nowait(block)
        while self._waiting.qsize() > MOST_WAITING:
            self._waiting.get_nowait()
            self.n_unsent += 1

    async def send(self) -> None:
        """Send what is put in, for ever."""
        while True:
            block = await self._waiting.get()
            # What waits goes out together, under the last speed and force: fewer messages where there are many pages.
            while not self._waiting.empty():
                later = self._waiting.get_nowait()
                block = later[:CONDITION_BYTES] + block[CONDITION_BYTES:] + later[CONDITION_BYTES:]
            await self._socket.send_bytes(block)
