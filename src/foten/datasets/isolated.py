"""Files whose readers are libraries in C, read in a process of their own: a damaged file can crash it, and nothing else.

One process serves all files, since importing the libraries takes a third of a second. It reads each file in a fork of
itself, so that no file meets what another has left behind; where there is no fork, it ends after one file.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray

from foten.untrusted import brief, check_regular

Contents = tuple[Any, list[NDArray[np.float64]]]
"""What a file holds: a JSON value, and arrays that it refers to by their order."""

READERS = {"HDF5": "foten.datasets.contents.hdf5_contents", "MATLAB": "foten.datasets.contents.matlab_contents"}
"""Functions from a path to `Contents`, by format; they run in the other process alone."""

LONGEST_S = 15  # of processor time for one file, and one more for each
BYTES_A_SECOND = 10 << 20  # in it; the slowest compression gives 20 MB
LARGEST_BYTES = 8 << 30  # of memory for one file; the largest that is read takes 5
_FORKS = hasattr(os, "fork")
_CRASHED = {"damaged": "its library crashes on it, or does not end"}


def read_isolated(kind: str, path: Path) -> Contents:
    """Return what a file holds.

    Raises:
        FileNotFoundError: there is none.
        OSError: it may not be read.
        ValueError: it is empty, no file, of another format, or damaged.
        ModuleNotFoundError: the library is not installed.
    """
    check_regular(path)
    with path.open("rb") as file:
        if not file.read(1):
            raise ValueError(f"{path.name} is empty")
    with _LOCK:
        answer, arrays = _process().ask(kind, path)
    if "missing" in answer:
        raise ModuleNotFoundError(f"No module named {answer['missing']!r}", name=answer["missing"])
    if "damaged" in answer:
        raise ValueError(f"{path.name} is truncated, damaged or no {kind} file ({answer['damaged']})")
    if "refused" in answer:
        raise ValueError(answer["refused"])
    return answer["contents"], arrays


_START = "import sys; sys.path[:] = {path!r}; from foten.datasets.isolated import serve; serve()"


class _Process:
    """The process that reads; it ends with its input."""

    def __init__(self) -> None:
        start = _START.format(path=sys.path)
        self._process = subprocess.Popen(
            [sys.executable, "-c", start], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        self.owner = os.getpid()

    @property
    def alive(self) -> bool:
        """Return whether this program may ask it."""
        return self.owner == os.getpid() and self._process.poll() is None

    def ask(self, kind: str, path: Path) -> Contents:
        """Return the answer and the arrays in it."""
        sent, got = self._process.stdin, self._process.stdout
        assert sent is not None
        assert got is not None
        try:
            sent.write(json.dumps([kind, os.fspath(path)]).encode() + b"\n")
            sent.flush()
            answer = json.loads(_exactly(got, int.from_bytes(_exactly(got, 8), "little")))
            arrays = [np.empty(size) for size in answer.pop("sizes")]
            for array in arrays:
                _fill(got, array.view(np.uint8).data)
        except (EOFError, OSError, ValueError):
            self.close()
            return _CRASHED, []
        except BaseException:  # interrupted halfway: what is left in the pipe would be taken for the next answer
            self.close()
            raise
        if not _FORKS:
            self.close()
        return answer, arrays

    def close(self) -> None:
        """End the process."""
        if self.owner == os.getpid():
            self._process.kill()
            self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError):
                if pipe:
                    pipe.close()


_LOCK = threading.Lock()
_running: list[_Process] = []


def _process() -> _Process:
    if _running and not _running[0].alive:
        _running.pop().close()
    if not _running:
        _running.append(_Process())
    return _running[0]


@atexit.register
def _close() -> None:
    for process in _running:
        process.close()


def _exactly(pipe: Any, size: int) -> bytes:
    data = bytearray(size)
    _fill(pipe, memoryview(data))
    return bytes(data)


def _fill(pipe: Any, view: memoryview) -> None:
    while view:
        n = pipe.readinto(view)
        if not n:
            raise EOFError
        view = view[n:]


def serve() -> None:
    """Answer what `read_isolated` asks on the standard input, until that ends."""
    # Whatever a library prints is no answer.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    for line in sys.stdin.buffer:
        kind, path = json.loads(line)
        with contextlib.suppress(ModuleNotFoundError):
            _reader(kind)  # before the fork, so that it is imported once
        if not _FORKS:
            _answer(answers, kind, Path(path))
            return
        child = os.fork()
        if child == 0:
            _answer_and_end(answers, kind, Path(path))
        if os.waitpid(child, 0)[1]:
            _send(answers, _CRASHED, [])


def _answer_and_end(answers: BinaryIO, kind: str, path: Path) -> NoReturn:
    status = 1
    try:
        _limit(LONGEST_S + path.stat().st_size // BYTES_A_SECOND)
        _answer(answers, kind, path)
        status = 0
    finally:
        os._exit(status)


def _limit(longest_s: int) -> None:
    """Limit this process, so that no file takes all time or memory of the machine."""
    try:
        import resource
    except ImportError:  # Windows
        return
    for what, most in ((resource.RLIMIT_CPU, longest_s), (resource.RLIMIT_AS, LARGEST_BYTES)):
        with contextlib.suppress(ValueError, OSError):  # a lower limit stands already
            resource.setrlimit(what, (most, most))


def _reader(kind: str) -> Any:
    module, _, name = READERS[kind].rpartition(".")
    return getattr(importlib.import_module(module), name)


def _answer(answers: BinaryIO, kind: str, path: Path) -> None:
    arrays: list[NDArray[np.float64]] = []
    try:
        contents, arrays = _reader(kind)(path)
        answer = {"contents": contents}
    except ModuleNotFoundError as error:
        answer = {"missing": (error.name or "").split(".")[0]}
    except RefusedError as error:
        answer = {"refused": str(error)}
    except MemoryError:
        answer = {"damaged": "it says that it holds more than the memory does"}
    except Exception as error:  # a damaged file raises a dozen kinds, RuntimeError, KeyError and TypeError among them
        answer = {"damaged": brief(error)}
    _send(answers, answer, arrays)


class RefusedError(ValueError):
    """What a reader says of a file in a sentence of its own, with the file's name."""


def _send(answers: BinaryIO, answer: Any, arrays: list[NDArray[np.float64]]) -> None:
    text = json.dumps({**answer, "sizes": [array.size for array in arrays]}).encode()
    answers.write(len(text).to_bytes(8, "little") + text)
    for array in arrays:
        answers.write(np.ascontiguousarray(array, dtype=np.float64).reshape(-1).view(np.uint8).data)
    answers.flush()
