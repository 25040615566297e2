"""What this machine has for rendering, and what is missing, with what to do."""

import importlib.metadata
import importlib.util
import math
import platform
import subprocess
import sys
import time
from dataclasses import dataclass

import numpy as np

from foten.runtime.bench import reason
from foten.runtime.binding import isa, library
from foten.runtime.live.devices import sound_devices
from foten.runtime.renderer import EXAMPLE


@dataclass(frozen=True)
class Check:
    """Result of one check."""

    name: str
    result: str
    fine: bool | None = None  # whether rendering can do with it; None for information


def checks() -> list[Check]:
    """Results, what rendering needs first."""
    python = f"{platform.python_version()} on {platform.system()} {platform.machine()}, NumPy {np.__version__}"
    daq = _package(
        "NI-DAQ", "nidaqmx", "nidaqmx", "package nidaqmx is not installed: pip install './packages/foten[daq]'"
    )
    without = "PyTorch is not installed, and rendering does not need it: pip install './packages/foten[train]' to train"
    training = _package("training", "torch", "PyTorch", without)
    return [Check("python", python), _kernel(), *_start_up(), _clock(), _sound(), daq, training]


def _kernel() -> Check:
    try:
        version = library().foten_version().decode()
        return Check("kernel", f"{version}, instruction set {isa()}", fine=True)
    except OSError as error:
        return Check("kernel", str(error), fine=False)


def _start_up() -> list[Check]:
    """Times to import and to the first sample in a fresh process, beside `import numpy` in one; the shortest of five."""
    programs = {
        "import numpy": "import numpy",
        "import foten": "import foten; foten.Renderer",
        "first sample": f"import foten; foten.Renderer({str(EXAMPLE)!r}).step(80.0, 0.8)",
    }
    shortest = dict.fromkeys(programs, math.inf)
    for _ in range(5):
        for name, program in programs.items():
            begin = time.perf_counter()
            done = subprocess.run([sys.executable, "-c", program], check=False, capture_output=True, text=True)
            if done.returncode != 0:
                return [Check(name, reason(done), fine=False)]
            shortest[name] = min(shortest[name], time.perf_counter() - begin)
    numpy = shortest.pop("import numpy")
    return [
        Check(name, f"{1000 * seconds:.0f} ms, {seconds / numpy:.2f} times 'import numpy'", fine=seconds <= 2 * numpy)
        for name, seconds in shortest.items()
    ]


def _clock() -> Check:
    """Lateness of a thread that asks to be woken every 2 ms."""
    late = []
    due = time.perf_counter()
    for _ in range(250):
        due += 0.002
        time.sleep(max(0.0, due - time.perf_counter()))
        late.append(time.perf_counter() - due)
    p50, p99, largest = (1000 * np.percentile(late, [50, 99, 100])).tolist()
    advice = "" if largest < 8 else "; the usual lead of 10 ms may be too short here"
    result = f"late by {p50:.2f} ms (p50), {p99:.2f} ms (p99), {largest:.2f} ms at most{advice}"
    return Check("timer", result, fine=largest < 8)


def _sound() -> Check:
    try:
        devices = [f"{device.name} ({device.host}{', the usual one' * device.default})" for device in sound_devices()]
    except Exception as error:  # PortAudio's own too
        return Check("sound", str(error))
    return Check("sound", ", ".join(devices) if devices else "PortAudio is here, and no device to play on")


def _package(name: str, package: str, title: str, missing: str) -> Check:
    if importlib.util.find_spec(package) is None:
        return Check(name, missing)
    return Check(name, f"{title} {importlib.metadata.version(package)}")
