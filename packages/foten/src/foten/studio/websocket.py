"""A page at a WebSocket: its messages, in order, until it goes; JSON and blocks of samples back."""

import asyncio
import contextlib
import json
import struct
import time
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, TypeVar

import anyio
import numpy as np
from numpy.typing import NDArray
from starlette.websockets import WebSocket, WebSocketDisconnect

from foten.runtime.stylus import PressureCalibration
from foten.studio.messages import (
    MAX_BYTES,
    MAX_EVENTS_PER_S,
    Allowance,
    Protocol,
    RefusedError,
    parse_events,
    parse_message,
)

MAX_REFUSED, MAX_REFUSED_BEFORE = 1000, 20  # messages of a page, after which it is sent away; of one without a place
MAX_MESSAGES_PER_S = 1200.0  # a pen has at most a thousand events a second
MAX_WAITING_BLOCKS = 64  # for a page that does not take them; the oldest go
MAX_WAITING_TEXTS = 200  # and messages, of which none may be left out: the page is sent away, and may come back
GOODBYE_S = 2.0  # for a page that is sent away to take what it was told before
STAYS = 2  # rank of a page that does not go where another has no room; of lower ranks the lowest goes, the oldest first
CONDITION_BYTES = 8  # speed [mm/s] and force [N] before the samples of a block
Sender = Callable[[], Coroutine[Any, Any, None]]


class PageSocket:
    """A page at an accepted socket: a message that is refused is answered with the reason, and changes nothing.

    `senders` run while the page is served. After a second of silence a second's worth of messages may come at once.
    """

    def __init__(
        self, socket: WebSocket, protocol: Protocol, *senders: Sender, max_messages_per_s: float = MAX_MESSAGES_PER_S
    ) -> None:
        self.socket, self.n_refused, self.opened_at = socket, 0, time.monotonic()
        self._protocol, self._senders, self.rank = protocol, senders, STAYS
        self._waiting: asyncio.Queue[str | tuple[int, str]] = asyncio.Queue()
        self._ended = False
        self._receiving = asyncio.timeout(None)
        self._messages, self._events = Allowance(max_messages_per_s), Allowance(MAX_EVENTS_PER_S)

    async def leave(self) -> None:
        """Free what the page had; a second time nothing happens."""

    async def do(self, message: Mapping[str, Any]) -> None:
        """Do what a checked message asks for, or raise RefusedError."""
        raise NotImplementedError

    async def take_bytes(self, data: bytes) -> None:
        """Take in at most `MAX_BYTES` bytes, or raise RefusedError."""
        raise RefusedError("this page sends text alone")

    def is_charged(self, data: bytes | None) -> bool:
        """Whether a message counts against the rate, as it does where nothing else bounds it."""
        return True

    def events_in(self, data: bytes) -> NDArray[np.float64]:
        """Events of a pen in bytes, shape (n, 4), or raise RefusedError."""
        events = parse_events(data)
        if not self._events.take(len(events)):
            raise RefusedError(f"more than {MAX_EVENTS_PER_S:g} events a second")
        return events

    def refuse(self, why: str) -> None:
        """Say why a message was refused."""
        self.n_refused += 1
        self.say({"refused": why})

    def say(self, document: Mapping[str, Any]) -> None:
        """Send a message when the page takes it: who says something does not wait for a page that stalls."""
        if self._waiting.qsize() >= MAX_WAITING_TEXTS:
            self.end(1013, "this page does not take what it is sent")
        if not self._ended:
            self._waiting.put_nowait(json.dumps(document, allow_nan=False))

    def end(self, code: int, why: str) -> None:
        """Send the page away, after what was said before."""
        if not self._ended:
            self._ended = True
            self._waiting.put_nowait((code, why))
            with contextlib.suppress(RuntimeError):  # no message is waited for
                self._receiving.reschedule(asyncio.get_running_loop().time() + GOODBYE_S)

    async def _send(self) -> None:
        with contextlib.suppress(RuntimeError, WebSocketDisconnect):  # the page is gone
            while True:
                message = await self._waiting.get()
                if isinstance(message, str):
                    await self.socket.send_text(message)
                else:
                    await self.socket.close(*message)
                    return

    async def run(self) -> None:
        """Take messages until the page goes, is sent away, or until `MAX_REFUSED` were refused."""
        tasks = [asyncio.create_task(sender()) for sender in (self._send, *self._senders)]
        try:
            while not self._ended:
                async with asyncio.timeout(None) as self._receiving:
                    received = await self.socket.receive()
                if received["type"] == "websocket.disconnect":
                    return
                await self._take(received)
                if self.n_refused > (most := MAX_REFUSED if self.rank == STAYS else MAX_REFUSED_BEFORE):
                    self.end(1008, f"{most} messages were refused")
            await asyncio.wait(tasks[:1], timeout=GOODBYE_S)
        except (WebSocketDisconnect, TimeoutError):  # it is gone, or does not take that it is sent away
            pass
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)  # not `gather`: what cancels this page would be taken for the end of a sender
            for task in tasks:
                _ = task.cancelled() or task.exception()  # the page is gone: nobody is told

    async def _take(self, received: Mapping[str, Any]) -> None:
        try:
            data = received.get("bytes")
            if self.is_charged(data) and not self._messages.take(1):
                raise RefusedError(f"more than {self._messages.per_s:g} messages a second")
            if data is None:
                await self.do(parse_message(received.get("text") or "", self._protocol))
            elif len(data) > MAX_BYTES:
                raise RefusedError(f"the message has {len(data)} bytes, expected {MAX_BYTES} at most")
            else:
                await self.take_bytes(data)
        except RefusedError as refused:
            self.refuse(str(refused))
            await asyncio.sleep(0)  # a page that sends nothing else is told between two messages that are there already


P = TypeVar("P", bound=PageSocket)


async def serve_page(socket: WebSocket, pages: set[P], max_pages: int, page_of: Callable[[WebSocket], P]) -> None:
    """Serve a page beside others until it goes; with too many there, it is sent away."""
    await socket.accept()
    if len(pages) >= max_pages:
        first = min(pages, key=lambda page: (page.rank, page.opened_at))
        if first.rank == STAYS:
            await socket.close(1013, f"{max_pages} pages are open already: close one")
            return
        pages.discard(first)
        first.end(1013, "another page needs the place")
    page = page_of(socket)
    pages.add(page)
    try:
        await page.run()
    finally:
        with anyio.CancelScope(shield=True):  # a page that is lost in the middle of something frees its sound too
            await page.leave()
        pages.discard(page)


def pressure_calibration(message: Mapping[str, Any]) -> PressureCalibration:
    """Parameters of Eq. 12 in a checked message, the usual ones where it has none."""
    usual = PressureCalibration()
    return PressureCalibration(float(message.get("newtons", usual.a)), float(message.get("steepness", usual.b)))


class BlockQueue:
    """Blocks on their way to a page: a condition, and samples."""

    def __init__(self, socket: WebSocket) -> None:
        self._socket, self._loop = socket, asyncio.get_running_loop()
        self._waiting: asyncio.Queue[bytes] = asyncio.Queue()
        self.n_unsent = 0  # that the page did not take in time

    def put(self, samples: NDArray[np.float32], speed: float, force: float) -> None:
        """Send a block when there is time, from any thread: speed [mm/s] and force [N], then samples, little-endian float32."""
        block = struct.pack("<ff", speed, force) + samples.astype("<f4").tobytes()
        with contextlib.suppress(RuntimeError):  # the loop has ended, and so does what renders
            self._loop.call_soon_threadsafe(self._put, block)

    def _put(self, block: bytes) -> None:
        self._waiting.put_nowait(block)
        while self._waiting.qsize() > MAX_WAITING_BLOCKS:
            self._waiting.get_nowait()
            self.n_unsent += 1

    async def send(self) -> None:
        """Send what is put in, for ever."""
        while True:
            block = await self._waiting.get()
            # What waits goes out as one message, under the last speed and force: fewer messages where there are many pages.
            while not self._waiting.empty():
                later = self._waiting.get_nowait()
                block = later[:CONDITION_BYTES] + block[CONDITION_BYTES:] + later[CONDITION_BYTES:]
            await self._socket.send_bytes(block)
