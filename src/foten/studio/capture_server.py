"""A page that captures: sound and events in, progress of the training out."""

from __future__ import annotations

import asyncio
import importlib.util
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from starlette.websockets import WebSocket

from foten.atomic_write import reason
from foten.recording.capture_folder import About
from foten.studio.capture_session import CaptureSession
from foten.studio.messages import CAPTURE, RefusedError, parse_capture_bytes
from foten.studio.shelf import Shelf
from foten.studio.websocket import PageSocket
from foten.untrusted import LONGEST_TEXT, brief, check_numbers, parse_json, printable

MAX_CAPTURES = 200  # of one start of the server
MAX_LINE_BYTES = 1 << 16  # of what a training prints
MAX_CAPTURE_MESSAGES_PER_S = 12_000.0  # after a pause of a page that goes on recording
COMMAND = (sys.executable, "-m", "foten.training.train_capture")  # and a folder


def why_not() -> str:
    """What is missing to train here; empty where nothing is."""
    missing = [name for name in ("torch", "h5py") if importlib.util.find_spec(name) is None]
    return f"the server cannot train without {' and '.join(missing)}: pip install 'foten[train]'" if missing else ""


class TrainingQueue:
    """Trains capture folders, one after another; a page that leaves does not end them, the server's end does.

    Args:
        captures: the folder of these folders.
        shelf: takes the textures.
    """

    def __init__(self, captures: Path, shelf: Shelf) -> None:
        self.captures, self._shelf = captures, shelf
        self.n_saved = 0
        self._turn = asyncio.Lock()
        self._running: set[asyncio.Task[None]] = set()

    def start(self, folder: Path, say: Callable[[Mapping[str, Any]], None]) -> None:
        """Train from a folder as soon as no other is trained; `say` takes the lines of `train_capture`, textures as listed."""
        task = asyncio.create_task(self._train(folder, say))
        self._running.add(task)
        task.add_done_callback(self._running.discard)

    async def close(self) -> None:
        """End every training; what was captured stays where it is."""
        for task in (running := list(self._running)):
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)

    async def _train(self, folder: Path, say: Callable[[Mapping[str, Any]], None]) -> None:
        if self._turn.locked():
            say({"stage": "waiting for another training", "share": 0.0})
        async with self._turn:
            # Whatever goes wrong, the page waits for an answer.
            try:
                await self._run(folder, say)
            except Exception as error:
                why = reason(error) if isinstance(error, OSError) else brief(error)
                say({"refused": f"the training failed: {why}"})
                if not isinstance(error, OSError | ValueError):
                    raise  # a fault of ours: the server's log has it too

    async def _run(self, folder: Path, say: Callable[[Mapping[str, Any]], None]) -> None:
        # A process of its own, by a command: what renders here is not disturbed, and ends are clean.
        process = await asyncio.create_subprocess_exec(
            *(*COMMAND, str(folder)),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            limit=MAX_LINE_BYTES,
        )
        assert process.stdout is not None
        assert process.stderr is not None
        errors = asyncio.create_task(process.stderr.read())
        try:
            ended = False
            async for line in process.stdout:
                progress = parse_json(line)
                check_numbers(progress, "its progress")
                for kind in ("playable", "done"):
                    if kind in progress:
                        progress[kind] = self._shelf.put(folder / progress[kind]).listed()
                ended = ended or "done" in progress or "refused" in progress
                say(progress)
            await process.wait()
            if not ended:
                last = (await errors).decode("utf-8", "replace").strip().splitlines()[-1:]
                say({"refused": f"the training died: {printable(''.join(last))[:LONGEST_TEXT] or process.returncode}"})
        finally:
            errors.cancel()
            if process.returncode is None:
                process.kill()
                await process.wait()


class CapturePage(PageSocket):
    """A page that captures; a message that is refused ends its capture, for something of it would be missing."""

    def __init__(self, socket: WebSocket, trainings: TrainingQueue) -> None:
        super().__init__(socket, CAPTURE, MAX_CAPTURE_MESSAGES_PER_S)
        self._trainings = trainings
        self._capture: CaptureSession | None = None
        self._outgoing: asyncio.Queue[Mapping[str, Any]] = asyncio.Queue()

    async def run(self) -> None:
        await self.converse(self._send())

    async def refuse(self, why: str) -> None:
        """End the capture, and say why."""
        self._capture = None
        self.n_refused += 1
        self._outgoing.put_nowait({"refused": why})

    async def take_bytes(self, data: bytes) -> None:
        kind, values = parse_capture_bytes(data)
        capture = self._current("sound or events")
        if kind == "sound":
            capture.add_sound(values.astype(np.float32))
        else:
            capture.add_events(values)

    async def do(self, message: Mapping[str, Any]) -> None:
        if message["do"] == "begin":
            if self._trainings.n_saved >= MAX_CAPTURES:
                raise RefusedError(f"{MAX_CAPTURES} captures are kept already: start the server again")
            if missing := why_not():
                raise RefusedError(missing)
            self._capture = CaptureSession(About.of(message))
            self._outgoing.put_nowait({"ready": True})
        elif message["do"] == "discard":
            self._capture = None
        else:
            capture, self._capture = self._current("train"), None
            try:
                folder = await asyncio.to_thread(capture.write, self._trainings.captures)
            except OSError as error:
                raise RefusedError(f"the capture cannot be kept: {reason(error)}") from error
            self._trainings.n_saved += 1
            self._outgoing.put_nowait({"saved": folder.name, "seconds": capture.seconds})
            self._trainings.start(folder, self._outgoing.put_nowait)

    def _current(self, what: str) -> CaptureSession:
        if self._capture is None:
            raise RefusedError(f"{what} before a capture was begun")
        return self._capture

    async def _send(self) -> None:
        while True:
            await self.say(await self._outgoing.get())
