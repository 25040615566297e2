"""Files whose readers are libraries in C, each read in a process of its own, which a damaged file may crash."""

from __future__ import annotations

import contextlib
import json
import os
import pkgutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from foten.datasets.columns import RefusedError
from foten.dsp import Array
from foten.untrusted import brief, check_regular

Contents = tuple[Any, list[Array]]
"""Contents of a file: a JSON value, and arrays that it refers to by their order."""

READERS = {"HDF5": "foten.datasets.contents:hdf5_contents", "MATLAB": "foten.datasets.contents:matlab_contents"}
"""Functions from a path to `Contents`, by format; they run in the other process alone."""

MAX_CPU_S = 15  # for one file, and one more for each
BYTES_PER_CPU_S = 10 << 20  # in it; the slowest compression gives 20 MB
MAX_MEMORY_BYTES = 8 << 30  # for one file; the largest that is read takes 5
_START = "import sys; sys.path[:] = {path!r}; from foten.datasets.isolated import answer; answer(*sys.argv[1:])"


def read_isolated(kind: str, path: Path) -> Contents:
    """Contents of a file, read by another process; ValueError where it is damaged, ModuleNotFoundError without the library."""
    check_regular(path)
    with path.open("rb") as file:
        if not file.read(1):
            raise ValueError(f"{path.name} is empty")
    command = [sys.executable, "-c", _START.format(path=sys.path), kind, str(path.absolute())]
    silent, pipe = subprocess.DEVNULL, subprocess.PIPE
    with subprocess.Popen(command, stdin=silent, stdout=pipe, stderr=silent) as process:
        stream: Any = process.stdout
        try:
            answer = json.loads(stream.readline())
            arrays = [np.empty(shape) for shape in answer.pop("shapes")]
            for array in arrays:
                if stream.readinto(array) < array.nbytes:
                    raise EOFError
        except (EOFError, ValueError):
            answer = {"damaged": "its library crashes on it, or does not end"}
        finally:
            process.kill()
    match answer:
        case {"missing": library}:
            raise ModuleNotFoundError(f"No module named {library!r}", name=library)
        case {"damaged": why}:
            raise ValueError(f"{path.name} is truncated, damaged or no {kind} file ({why})")
        case {"refused": sentence}:
            raise ValueError(sentence)
    return answer["contents"], arrays


def answer(kind: str, name: str) -> None:
    """Write contents of a file to the standard output, as one line of JSON and the arrays after it."""
    path = Path(name)
    with contextlib.suppress(ModuleNotFoundError):  # on Windows
        _limit(path.stat().st_size)
    pipe = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints is no answer
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
    pipe.write(json.dumps({**answer, "shapes": [array.shape for array in arrays]}).encode() + b"\n")
    for array in arrays:
        pipe.write(np.ascontiguousarray(array, dtype=np.float64).data)
    pipe.flush()


def _limit(file_bytes: int) -> None:
    """Limit this process, so that no file takes all time or memory of the machine."""
    import resource

    max_cpu_s = MAX_CPU_S + file_bytes // BYTES_PER_CPU_S
    for resource_kind, limit in ((resource.RLIMIT_CPU, max_cpu_s), (resource.RLIMIT_AS, MAX_MEMORY_BYTES)):
        with contextlib.suppress(ValueError, OSError):  # a lower limit stands already
            resource.setrlimit(resource_kind, (limit, limit))
