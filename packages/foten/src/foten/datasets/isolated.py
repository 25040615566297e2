"""Files whose readers are libraries in C, each read in a process of its own, which a damaged file may crash."""

import contextlib
import json
import os
import pkgutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from foten.datasets.columns import Column
from foten.dsp import Array
from foten.untrusted import MAX_INFLATION, MIN_CONTENT, RAISED_BY, brief, check_regular, max_content

Contents = tuple[Any, list[Array]]
"""Contents of a file: a JSON value, and arrays that it refers to by their order."""

READERS = {
    "HDF5": "foten.datasets.contents:hdf5_contents",
    "MATLAB": "foten.datasets.contents:matlab_contents",
    "TDMS": "foten.datasets.contents:tdms_contents",
    ".xlsx": "foten.datasets.tabular:excel_contents",
    "picture": "foten.editing.height_map:picture_contents",
}
"""Functions from a path to `Contents`, by format; they run in the other process alone."""

MAX_CPU_S = 6  # for one file, and one more for each `BYTES_PER_CPU_S` in it
BYTES_PER_CPU_S, BYTES_PER_CPU_S_OF_XLSX = 10 << 20, 300_000  # half of what the slowest compression, and a sheet, give
MIN_MEMORY_BYTES, N_COPIES = 384 << 20, 4  # for the libraries, and times the content that a file may have
_FIELDS = ("name", "rate_hz", "unit", "n_blank", "fault", "preamble")  # of a column
_START = "import sys; sys.path[:] = {path!r}; from foten.datasets.isolated import answer; answer(*sys.argv[1:])"


def read_isolated(kind: str, path: Path) -> Contents:
    """Contents of a file, read by another process; ValueError where it is damaged, ModuleNotFoundError without the library."""
    check_regular(path)
    with path.open("rb") as file:
        if not file.read(1):
            raise ValueError(f"{path.name} is empty")
    content = max_content(path)
    size = max(path.stat().st_size, (content - MIN_CONTENT) // MAX_INFLATION)
    bytes_per_s = BYTES_PER_CPU_S_OF_XLSX if kind == ".xlsx" else BYTES_PER_CPU_S
    limits = MAX_CPU_S + size // bytes_per_s, MIN_MEMORY_BYTES + N_COPIES * content
    command = [sys.executable, "-c", _START.format(path=sys.path), kind, str(path.absolute()), *map(str, limits)]
    silent, pipe = subprocess.DEVNULL, subprocess.PIPE
    env = os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")  # a thread reserves memory
    with subprocess.Popen(command, stdin=silent, stdout=pipe, stderr=silent, env=env) as process:
        stream: Any = process.stdout
        try:
            answer = json.loads(stream.readline())
            arrays = [np.empty(shape) for shape in answer.pop("shapes")]
            for array in arrays:
                if stream.readinto(array) < array.nbytes:
                    raise EOFError
        except (EOFError, ValueError):
            answer = {"damaged": "its library crashes on it"}
        finally:
            process.kill()
    if process.returncode == -getattr(signal, "SIGXCPU", 0):
        answer = {"damaged": f"it takes more than {limits[0]} s of processor time; {RAISED_BY}=10000 gives it longer"}
    match answer:
        case {"missing": library}:
            raise ModuleNotFoundError(f"No module named {library!r}", name=library)
        case {"damaged": why}:
            raise ValueError(f"{path.name} is truncated, damaged or no {kind} file ({why})")
        case {"refused": sentence}:
            raise ValueError(sentence)
    return answer["contents"], arrays


def isolated_columns(kind: str, path: Path) -> list[Column]:
    """Columns of a file, read as by `read_isolated`."""
    read = zip(*read_isolated(kind, path), strict=True)
    return [Column(samples=samples, row_numbers=range(*rows), **fields) for (rows, fields), samples in read]


def contents_of(columns: list[Column]) -> Contents:
    """Contents of which `isolated_columns` makes the columns; their rows are without a gap."""
    rows = [[c.row_numbers[0], c.row_numbers[-1] + 1] if c.row_numbers else [0, 0] for c in columns]
    fields = [{name: getattr(column, name) for name in _FIELDS} for column in columns]
    return list(zip(rows, fields, strict=True)), [column.samples for column in columns]


def answer(kind: str, name: str, max_cpu_s: str, max_memory: str) -> None:
    """Write contents of a file to the standard output, as one line of JSON and the arrays after it."""
    path = Path(name)
    with contextlib.suppress(ModuleNotFoundError):  # on Windows
        import resource

        for limited, limit in ((resource.RLIMIT_CPU, int(max_cpu_s)), (resource.RLIMIT_AS, int(max_memory))):
            with contextlib.suppress(ValueError, OSError):  # a lower limit stands already
                resource.setrlimit(limited, (limit, limit + 1))  # the first one can be told from a crash
    pipe = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints is no answer
    arrays: list[Array] = []
    try:
        contents, arrays = pkgutil.resolve_name(READERS[kind])(path)
        answer = {"contents": contents}
    except ModuleNotFoundError as error:
        answer = {"missing": (error.name or "").split(".")[0]}
    except MemoryError:
        answer = {"damaged": f"it holds more than its size is worth; {RAISED_BY}={int(max_memory) >> 20} raises it"}
    except Exception as error:  # a damaged file raises a dozen kinds, RuntimeError, KeyError and TypeError among them
        is_ours = isinstance(error, ValueError) and str(error).startswith(path.name)
        answer = {"refused": str(error)} if is_ours else {"damaged": brief(error)}
    pipe.write(json.dumps({**answer, "shapes": [array.shape for array in arrays]}).encode() + b"\n")
    for array in arrays:
        pipe.write(np.ascontiguousarray(array, dtype=np.float64).data)
    pipe.flush()
