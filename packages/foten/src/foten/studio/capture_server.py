"""Captures: sound and events of a pen come in, are written as `foten import --pen` reads them, and are trained from."""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import itertools
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from starlette.websockets import WebSocket

from foten.atomic_write import atomic_write, reason, write_json
from foten.recording.capture_folder import ABOUT, PEN, SOUND, About, file_name
from foten.studio.messages import CAPTURE, RefusedError, parse_capture_bytes
from foten.studio.shelf import Shelf
from foten.studio.websocket import PageSocket
from foten.untrusted import LONGEST_TEXT, brief, check_numbers, parse_json, printable

MAX_CAPTURES = 200  # of one start of the server
MAX_CAPTURE_S = 300.0
MAX_PEN_EVENTS = 2000 * int(MAX_CAPTURE_S)
MAX_CAPTURE_BYTES = 100_000_000  # four minutes at 96 kHz, and the pen's events
MAX_ALL_CAPTURES_BYTES = 4 * MAX_CAPTURE_BYTES  # of all pages
MAX_BACK_S, MAX_LATE_SHARE = 0.1, 0.01  # of an event, in time; of all events: with more the pen has no clock
MAX_LINE_BYTES = 1 << 16  # of what a training prints
MAX_CAPTURE_MESSAGES_PER_S = 12_000.0  # after a pause of a page that goes on recording
COMMAND = (sys.executable, "-m", "foten.cli.train_capture")  # and a folder


def why_not() -> str:
    """What is missing to train here; empty where nothing is."""
    missing = [name for name in ("torch", "h5py") if importlib.util.find_spec(name) is None]
    return (
        f"the server cannot train without {' and '.join(missing)}: pip install './packages/foten[train]'"
        if missing
        else ""
    )


class TrainingQueue:
    """Trains capture folders, one after another, for a shelf; a page that leaves does not end them, the server's end does."""

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
    """A page that captures, one of `pages`; a message that is refused ends its capture, for something of it would be missing."""

    def __init__(self, socket: WebSocket, trainings: TrainingQueue, pages: Iterable[CapturePage]) -> None:
        super().__init__(socket, CAPTURE, max_messages_per_s=MAX_CAPTURE_MESSAGES_PER_S)
        self._trainings, self._pages = trainings, pages
        self._capture: CaptureSession | None = None
        self._is_full = False

    @property
    def n_bytes(self) -> int:
        """Bytes that its capture holds."""
        return 0 if self._capture is None else len(self._capture.sound) + len(self._capture.events)

    def refuse(self, why: str) -> None:
        """End the capture, and say why."""
        self._capture = None
        super().refuse(why)

    async def take_bytes(self, data: bytes) -> None:
        kind, values = parse_capture_bytes(data)
        capture = self._current("sound or events")
        if self._is_full:
            return  # as the page was told
        n_all = sum(page.n_bytes for page in self._pages)
        self._is_full = self.n_bytes + len(data) > MAX_CAPTURE_BYTES or n_all + len(data) > MAX_ALL_CAPTURES_BYTES
        if self._is_full:
            own, all_pages = MAX_CAPTURE_BYTES / 1e6, MAX_ALL_CAPTURES_BYTES / 1e6
            sizes = f"it may have {own:.3g} MB, and those of all pages {all_pages:.3g} MB"
            super().refuse(f"the capture is full, as {sizes}: train from what came before, or save it")
        elif kind == "sound":
            capture.add_sound(values)
        else:
            capture.add_events(values)

    async def do(self, message: Mapping[str, Any]) -> None:
        if message["do"] == "begin":
            if self._trainings.n_saved >= MAX_CAPTURES:
                raise RefusedError(f"{MAX_CAPTURES} captures are kept already: start the server again")
            if missing := why_not():
                raise RefusedError(missing)
            self._capture, self._is_full = CaptureSession(About.of(message)), False
            self.say({"ready": True})
        elif message["do"] == "discard":
            self._capture = None
        else:
            capture = self._current("train")
            try:
                folder = await asyncio.to_thread(capture.write, self._trainings.captures)
            except OSError as error:
                raise RefusedError(f"the capture cannot be kept: {reason(error)}") from error
            self._capture = None
            self._trainings.n_saved += 1
            self.say({"saved": folder.name, "seconds": capture.seconds})
            self._trainings.start(folder, self.say)

    def _current(self, what: str) -> CaptureSession:
        if self._capture is None:
            raise RefusedError(f"{what} before a capture was begun")
        return self._capture


class CaptureSession:
    """Sound and events as they come in, until they are written."""

    def __init__(self, about: About) -> None:
        self.about = about
        # Bytes, since an array for each message of one sample takes 155 of them.
        self.sound, self.events = bytearray(), bytearray()
        self._n_samples = self._n_events = 0
        self._latest_s = -np.inf

    @property
    def seconds(self) -> float:
        """Duration of the sound [s]."""
        return self._n_samples / self.about.rate_hz

    def add_sound(self, samples: NDArray[Any]) -> None:
        """Take in the next samples, of which full scale is 1; RefusedError where the sound gets longer than `MAX_CAPTURE_S`."""
        if self._n_samples + samples.size > MAX_CAPTURE_S * self.about.rate_hz:
            raise RefusedError(f"the capture is longer than {MAX_CAPTURE_S:g} s")
        self.sound += samples.astype("<f4").tobytes()
        self._n_samples += samples.size

    def add_events(self, events: NDArray[np.float64]) -> None:
        """Take in the next events: x, y [mm], pressure, t [s], shape (n, 4); RefusedError for too many, or one of long ago."""
        if self._n_events + len(events) > MAX_PEN_EVENTS:
            raise RefusedError(f"the capture has more than {MAX_PEN_EVENTS} events")
        latest_s = np.maximum.accumulate(np.append(self._latest_s, events[:, 3]))
        back_s = float((latest_s[1:] - events[:, 3]).max())
        if back_s > MAX_BACK_S:
            back = f"one is {1000 * back_s:.0f} ms back, expected {1000 * MAX_BACK_S:g} at most"
            raise RefusedError(f"the events are not in the order of their times: {back}")
        self._latest_s = float(latest_s[-1])
        self.events += events.astype("<f8").tobytes()
        self._n_events += len(events)

    def write(self, captures: Path) -> Path:
        """Write sound, events and `About` to a new folder below `captures`; RefusedError for none, or many late events."""
        import scipy.io.wavfile

        if not self._n_samples or not self._n_events:
            raise RefusedError("there is no sound yet" if self._n_events else "the pen has not touched yet")
        events, n_late = in_order(np.frombuffer(self.events, "<f8").reshape(-1, 4))
        if n_late > MAX_LATE_SHARE * self._n_events:
            late = f"{n_late} of {self._n_events} came late, expected {100 * MAX_LATE_SHARE:g} % at most"
            raise RefusedError(f"the events are not in the order of their times: {late}")
        folder = _new_folder(captures, self.about.name)
        with atomic_write(folder / SOUND) as part:
            scipy.io.wavfile.write(part, round(self.about.rate_hz), np.frombuffer(self.sound, "<f4"))
        with atomic_write(folder / PEN) as part:
            rows = events[:, [3, 0, 1, 2]]
            np.savetxt(part, rows, "%.6f", ",", header="t [s],x [mm],y [mm],pressure", comments="")
        write_json(folder / ABOUT, asdict(replace(self.about, n_late_events=n_late)))
        return folder


def in_order(events: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
    """Events (n, 4), times last, in increasing order (k, 4), and how many came late: after an event of a later time.

    A late event is left out; a late touch or lift counts at the time of the event before it: without it two touches would be one.
    Of events of one time the last counts; a touch and the lift before it may have one time.
    """
    times = np.round(events[:, 3], 6)  # as the file has them
    latest = np.maximum.accumulate(times)
    late = times < latest
    down = events[:, 2] > 0
    touches_or_lifts = down != np.append(False, down[:-1])
    ordered = np.column_stack([events[:, :3], latest])[~late | touches_or_lifts]
    last = np.append(np.diff(ordered[:, 3]) > 0, True)
    return ordered[last], int(late.sum())


def _new_folder(captures: Path, name: str) -> Path:
    stem = file_name(name)
    for n in itertools.count(1):
        folder = captures / (stem if n == 1 else f"{stem}-{n}")
        with contextlib.suppress(FileExistsError):
            folder.mkdir(parents=True)
            break
    return folder
