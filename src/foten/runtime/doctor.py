"""What this machine has for rendering, and what is missing, with what to do."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import platform
import re
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from foten.runtime.bench import reason
from foten.runtime.example import EXAMPLE

_TRIALS = 5


@dataclass(frozen=True)
class Check:
    """One thing that was looked at.

    Attributes:
        name: of it.
        result: what is so.
        fine: whether rendering can do with it; None where it is only information.
    """

    name: str
    result: str
    fine: bool | None = None


def checks() -> list[Check]:
    """Return the results, in the order of what a user needs."""
    return [_python(), _kernel(), _size(), *_start_up(), _clock(), _sound(), _daq(), _training()]


def _python() -> Check:
    return Check(
        "python", f"{platform.python_version()} on {platform.system()} {platform.machine()}, NumPy {np.__version__}"
    )


def _kernel() -> Check:
    from foten.runtime.binding import isa, library

    try:
        version = library().foten_version().decode()
        return Check("kernel", f"{version}, instruction set {isa()}", fine=True)
    except OSError as error:
        return Check("kernel", str(error), fine=False)


def _size() -> Check:
    """Bytes of what an installation without extras brings: this package and all that it needs."""
    sizes: dict[str, int] = {}
    recorded: set[Path] = set()
    waiting = ["foten"]
    while waiting:
        name = waiting.pop().lower()
        if name in sizes:
            continue
        sizes[name] = 0
        try:
            distribution = importlib.metadata.distribution(name)
        except importlib.metadata.PackageNotFoundError:  # run from its sources
            continue
        paths = [Path(str(file.locate())) for file in distribution.files or []]
        recorded.update(paths)
        sizes[name] = sum(path.stat().st_size for path in paths if path.is_file())
        asked = [line for line in distribution.requires or [] if "extra ==" not in line]
        waiting += [re.split(r"[^A-Za-z0-9._-]", line, maxsplit=1)[0] for line in asked]
    # Of an editable install the sources lie elsewhere.
    for folder in importlib.util.find_spec("foten").submodule_search_locations or []:  # type: ignore[union-attr]
        sizes["foten"] += sum(
            path.stat().st_size
            for path in Path(folder).rglob("*")
            if path.is_file() and "__pycache__" not in path.parts and path not in recorded
        )
    largest = sorted(sizes, key=lambda name: -sizes[name])
    summary = ", ".join(f"{name} {sizes[name] / 1e6:.1f}" for name in largest if sizes[name] > 5e5)
    return Check("size", f"{sum(sizes.values()) / 1e6:.0f} MB: {summary}")


def _start_up() -> list[Check]:
    """Time to import and to the first sample in a fresh process, beside `import numpy` in one; the least of five in turn."""
    programs = {
        "import numpy": "import numpy",
        "import foten": "import foten; foten.Renderer",
        "first sample": f"import foten; foten.Renderer({str(EXAMPLE)!r}).step(80.0, 0.8)",
    }
    times: dict[str, list[float]] = {name: [] for name in programs}
    for _ in range(_TRIALS):
        for name, program in programs.items():
            begin = time.perf_counter()
            done = subprocess.run([sys.executable, "-c", program], check=False, capture_output=True, text=True)
            if done.returncode != 0:
                return [Check(name, reason(done), fine=False)]
            times[name].append(time.perf_counter() - begin)
    least = {name: min(values) for name, values in times.items()}
    numpy = least["import numpy"]
    return [
        Check(name, f"{1000 * seconds:.0f} ms, {seconds / numpy:.2f} times 'import numpy'", fine=seconds <= 2 * numpy)
        for name, seconds in least.items()
        if name != "import numpy"
    ]


def _clock() -> Check:
    """How late a thread is that asks to be woken every 2 ms."""
    late = []
    due = time.perf_counter()
    for _ in range(250):
        due += 0.002
        time.sleep(max(0.0, due - time.perf_counter()))
        late.append(time.perf_counter() - due)
    p50, p99, largest = 1000 * np.percentile(late, 50), 1000 * np.percentile(late, 99), 1000 * max(late)
    advice = "" if largest < 8 else "; the usual lead of 10 ms may be too short here"
    return Check(
        "timer",
        f"late by {p50:.2f} ms (p50), {p99:.2f} ms (p99), {largest:.2f} ms at most{advice}",
        fine=bool(largest < 8),
    )


def _sound() -> Check:
    from foten.runtime.live.sound import sound_library

    try:
        sounddevice: Any = sound_library()
        devices = [device["name"] for device in sounddevice.query_devices() if device["max_output_channels"] > 0]
    except Exception as error:  # PortAudio's own too: whatever it is, it is told and the rest is looked at
        return Check("sound", str(error))
    return Check("sound", ", ".join(devices) if devices else "PortAudio is here, and no device to play on")


def _daq() -> Check:
    if importlib.util.find_spec("nidaqmx") is None:
        return Check("NI-DAQ", "package nidaqmx is not installed: pip install 'foten[daq]'")
    return Check("NI-DAQ", f"nidaqmx {_version('nidaqmx')}")


def _training() -> Check:
    if importlib.util.find_spec("torch") is None:
        return Check(
            "training", "PyTorch is not installed, and rendering does not need it: pip install 'foten[train]' to train"
        )
    return Check("training", f"PyTorch {_version('torch')}")


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "of an unknown version"


def as_documents(checks: list[Check]) -> list[dict[str, Any]]:
    """Return the checks as JSON values."""
    return [asdict(check) for check in checks]
