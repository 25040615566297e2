"""One page that captures: sound and events in, progress of the training out."""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import json
import sys
from collections.abc import AsyncIterator, Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from starlette.websockets import WebSocket, WebSocketDisconnect

from foten.atomic_write import reason
from foten.recording.capture_folder import About
from foten.studio.capture_session import Capture
from foten.studio.messages import CAPTURE, CAPTURED_A_SECOND, Allowance, RefusedError, parse_captured, parse_message
from foten.studio.shelf import Shelf
from foten.studio.websocket import converse
from foten.untrusted import LONGEST_TEXT, brief, check_numbers, parse_json, printable

MOST_CAPTURES = 200  # that are kept from one start of the server
LONGEST_LINE = 1 << 16  # bytes, that a training says
COMMAND = (sys.executable, "-m", "foten.train.captured")  # and a folder


def why_not() -> str:
    """Return what is missing to train here; empty where nothing is."""
    missing = [name for name in ("torch", "h5py") if importlib.util.find_spec(name) is None]
    return f"the server cannot train without {' and '.join(missing)}: pip install 'foten[train]'" if missing else ""


class Trainings:
    """Trains captured folders, one at a time; a page that leaves does not end them, the server's end does.

    Args:
        captures: where they are kept.
        shelf: what is trained goes there.
    """

    def __init__(self, captures: Path, shelf: Shelf) -> None:
        self.captures, self._shelf = captures, shelf
        self.n_kept = 0
        self._one_at_a_time = asyncio.Lock()
        self._running: set[asyncio.Task[None]] = set()

    def start(self, folder: Path, say: Callable[[Mapping[str, Any]], None]) -> None:
        """Train from a folder as soon as no other is trained; `say` is given what `train.captured` says, textures as listed."""
        task = asyncio.create_task(self._train(folder, say))
        self._running.add(task)
        task.add_done_callback(self._running.discard)

    async def close(self) -> None:
        """End every training; what was captured stays where it is."""
        for task in (running := list(self._running)):
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)

    async def _train(self, folder: Path, say: Callable[[Mapping[str, Any]], None]) -> None:
        if self._one_at_a_time.locked():
            say({"stage": "waiting for another training", "share": 0.0})
        async with self._one_at_a_time:
            # Whatever goes wrong, the page waits for an answer.
            try:
                await self._run(folder, say)
            except (OSError, ValueError) as error:
                why = reason(error) if isinstance(error, OSError) else brief(error)
                say({"refused": f"the training failed: {why}"})
            except Exception as error:
                say({"refused": f"the training failed: {type(error).__name__}: {brief(error)}"})
                raise  # a fault of ours: the server's log has it too

    async def _run(self, folder: Path, say: Callable[[Mapping[str, Any]], None]) -> None:
        # A process of its own, by a command: what renders here is not disturbed, and ends are clean.
        process = await asyncio.create_subprocess_exec(
            *(*COMMAND, str(folder)),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            limit=LONGEST_LINE,
        )
        assert process.stdout is not None
        assert process.stderr is not None
        errors = asyncio.create_task(process.stderr.read())
        try:
            ended = False
            async for said in _answers(process.stdout):
                for kind in ("playable", "done"):
                    if kind in said:
                        said[kind] = self._shelf.put(folder / said[kind]).listed()
                ended = ended or "done" in said or "refused" in said
                say(said)
            await process.wait()
            if not ended:
                last = (await errors).decode("utf-8", "replace").strip().splitlines()[-1:]
                say({"refused": f"the training died: {printable(''.join(last))[:LONGEST_TEXT] or process.returncode}"})
        finally:
            errors.cancel()
            if process.returncode is None:
                process.kill()
                await process.wait()


async def _answers(stream: asyncio.StreamReader) -> AsyncIterator[dict[str, Any]]:
    """Return the JSON objects that a training says, one a line.

    Raises:
        ValueError: a line is none, or too long.
    """
    while True:
        try:
            line = await stream.readline()
        except ValueError:
            raise ValueError(f"it said a line of more than {LONGEST_LINE} bytes") from None
        if not line:
            return
        try:
            said = parse_json(line)
            check_numbers(said, "it")
        except ValueError:
            said = None
        if not isinstance(said, dict):
            text = line.decode("utf-8", "replace").strip()
            raise ValueError(f"it said {text[: LONGEST_TEXT // 2]!r}, expected a JSON object")
        yield said


class CapturePage:
    """One page at the WebSocket; a message that is refused ends its capture, for something of it would be missing."""

    def __init__(self, socket: WebSocket, trainings: Trainings) -> None:
        self._socket, self._trainings = socket, trainings
        self._capture: Capture | None = None
        self.n_refused = 0
        self._messages = Allowance(CAPTURED_A_SECOND)
        self._saying: asyncio.Queue[Mapping[str, Any]] = asyncio.Queue()

    async def run(self) -> None:
        """Serve the page until it goes."""
        await converse(self._socket, self._take, lambda: self.n_refused, self._send())

    async def _take(self, received: Mapping[str, Any]) -> None:
        try:
            await self._understand(received)
        except RefusedError as refused:
            self._refuse(str(refused))
        except OSError as error:
            self._refuse(f"the capture cannot be kept: {reason(error)}")

    async def _understand(self, received: Mapping[str, Any]) -> None:
        if not self._messages.take(1):
            raise RefusedError(f"more than {CAPTURED_A_SECOND:g} messages a second")
        data = received.get("bytes")
        if data is not None:
            kind, values = parse_captured(data)
            capture = self._current("what was captured")
            if kind == "sound":
                capture.add_sound(values.astype(np.float32))
            else:
                capture.add_events(values)
            return
        message = parse_message(received.get("text") or "", CAPTURE)
        if message["do"] == "begin":
            if self._trainings.n_kept >= MOST_CAPTURES:
                raise RefusedError(f"{MOST_CAPTURES} captures are kept already: start the server again")
            if missing := why_not():
                raise RefusedError(missing)
            self._capture = Capture(About.of(message))
            self._saying.put_nowait({"ready": True})
        elif message["do"] == "discard":
            self._capture = None
        else:
            capture, self._capture = self._current("train"), None
            folder = await asyncio.to_thread(capture.write, self._trainings.captures)
            self._trainings.n_kept += 1
            self._saying.put_nowait({"kept": folder.name, "seconds": capture.seconds})
            self._trainings.start(folder, self._saying.put_nowait)

    def _refuse(self, why: str) -> None:
        self._capture = None
        self.n_refused += 1
        self._saying.put_nowait({"refused": why})

    def _current(self, what: str) -> Capture:
        if self._capture is None:
            raise RefusedError(f"{what} before a capture was begun")
        return self._capture

    async def _send(self) -> None:
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            while True:
                await self._socket.send_text(json.dumps(await self._saying.get(), allow_nan=False))
