"""Files whose readers are libraries in C, read in a process of their own: a damaged file can crash it, and nothing else.

One process serves all files until one crashes, since importing the libraries takes a third of a second. It reads each file in a
fork of itself, so that no file meets what another has left behind; where there is no fork, it ends after one file.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import pkgutil
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from foten.datasets.columns import RefusedError
from foten.dsp import Array
from foten.untrusted import brief, check_regular

Contents = tuple[Any, list[Array]]
"""What a file holds: a JSON value, and arrays that it refers to by their order."""

READERS = {"HDF5": "foten.datasets.contents:hdf5_contents", "MATLAB": "foten.datasets.contents:matlab_contents"}
"""Functions from a path to `Contents`, by format; they run in the other process alone."""

MAX_CPU_S = 15  # of processor time for one file, and one more for each
BYTES_PER_CPU_S = 10 << 20  # in it; the slowest compression gives 20 MB
MAX_MEMORY_BYTES = 8 << 30  # of memory for one file; the largest that is read takes 5
_FORKS = hasattr(os, "fork")
_START = "import sys; sys.path[:] = {path!r}; from foten.datasets.isolated import serve; serve()"
_LOCK = threading.Lock()
_running: list[subprocess.Popen[bytes]] = []
if _FORKS:
    os.register_at_fork(after_in_child=_running.clear)  # a fork of this program may not ask its parent's process


def read_isolated(kind: str, path: Path) -> Contents:
    """Contents of a file, read by another process.

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
        answer, arrays = _ask(kind, path)
    match answer:
        case {"missing": library}:
            raise ModuleNotFoundError(f"No module named {library!r}", name=library)
        case {"damaged": why}:
            raise ValueError(f"{path.name} is truncated, damaged or no {kind} file ({why})")
        case {"refused": sentence}:
            raise ValueError(sentence)
    return answer["contents"], arrays


def _ask(kind: str, path: Path) -> Contents:
    """Answer of the process that reads, and the arrays in it."""
    if not _running or _running[0].poll() is not None:
        _close()
        command = [sys.executable, "-c", _START.format(path=sys.path)]
        pipe = subprocess.PIPE
        _running.append(subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL))
    process: Any = _running[0]  # with both pipes, which its type leaves open
    serves_on = False
    try:
        process.stdin.write(json.dumps([kind, str(path.absolute())]).encode() + b"\n")
        process.stdin.flush()
        answer = json.loads(process.stdout.readline())
        arrays = [np.empty(size) for size in answer.pop("sizes")]
        for array in arrays:
            if process.stdout.readinto(array.data) < array.nbytes:
                raise EOFError
        serves_on = _FORKS
        return answer, arrays
    except (EOFError, OSError, ValueError):
        return {"damaged": "its library crashes on it, or does not end"}, []
    finally:
        if not serves_on:  # interrupted halfway too: what is left in the pipe would be taken for the next answer
            _close()


@atexit.register
def _close() -> None:
    """End the process that reads."""
    while _running:
        with contextlib.suppress(OSError), _running.pop() as process:
            process.kill()


def serve() -> None:
    """Answer what `read_isolated` asks on the standard input, until that ends or a file crashes its library."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints is no answer
    for line in sys.stdin.buffer:
        kind, name = json.loads(line)
        path = Path(name)
        with contextlib.suppress(ModuleNotFoundError):
            pkgutil.resolve_name(READERS[kind])  # before the fork, so that the library is imported once
        if _FORKS:
            child = os.fork()
            if child:
                if os.waitpid(child, 0)[1]:
                    return  # that the answers end says that it crashed
                continue
            _limit(path.stat().st_size)
        _answer(answers, kind, path)
        os._exit(0)


def _limit(file_bytes: int) -> None:
    """Limit this process, so that no file takes all time or memory of the machine."""
    import resource

    max_cpu_s = MAX_CPU_S + file_bytes // BYTES_PER_CPU_S
    for resource_kind, limit in ((resource.RLIMIT_CPU, max_cpu_s), (resource.RLIMIT_AS, MAX_MEMORY_BYTES)):
        with contextlib.suppress(ValueError, OSError):  # a lower limit stands already
            resource.setrlimit(resource_kind, (limit, limit))


def _answer(answers: BinaryIO, kind: str, path: Path) -> None:
    arrays: list[Array] = []
    try:
        contents, arrays = pkgutil.resolve_name(READERS[kind])(path)
        answer = {"contents": contents}
    except ModuleNotFoundError as error:
        answer = {"missing": (error.name or "").split(".")[0]}
    except RefusedError as error:
        answer = {"refused": str(error)}
    except MemoryError:
        answer = {"damaged": "it says that it holds more than the memory does"}
    except Exception as error:  # a damaged file raises a dozen kinds, RuntimeError, KeyError and TypeError among them
        answer = {"damaged": brief(error)}
    answers.write(json.dumps({**answer, "sizes": [array.size for array in arrays]}).encode() + b"\n")
    for array in arrays:
        answers.write(np.ascontiguousarray(array, dtype=np.float64).data)
    answers.flush()
