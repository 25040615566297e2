"""Time of a rendered sample on this machine, and contacts that a core holds."""

import json
import os
import re
import signal
import subprocess
import sys
import time
import timeit
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from foten.models.texture_file import read_texture
from foten.runtime.binding import isa, library
from foten.runtime.native import NativeState, NativeTexture

INSTRUCTION_SETS = ("avx512", "avx2", "neon", "portable")
_WARM_UP = 200  # samples
_TIMED = """
import json, sys
from dataclasses import asdict
from pathlib import Path
from foten.runtime.bench import time_steps
from foten.runtime.binding import isa
path, n, name = sys.argv[1:]
if isa() == name:  # else this processor has it not, and another one stands in
    print(json.dumps(asdict(time_steps(Path(path), int(n)))))
"""


@dataclass(frozen=True)
class StepTimes:
    """Times of single samples of the texture's own rate [µs], under a hand that moves."""

    isa: str  # the instruction set; "onnxruntime" where that runs the model
    rate_hz: float  # of the texture
    n: int
    p50_us: float
    p99_us: float
    p999_us: float
    largest_us: float
    contacts: float  # that one core holds at that rate, by the median


def time_steps(path: Path, n: int) -> StepTimes:
    """Time n samples of a texture file in this process's instruction set."""
    texture = NativeTexture(path.read_bytes())
    state = NativeState(texture)
    out = np.empty(1, dtype=np.float32)
    turn = np.linspace(0, 20 * np.pi, n + _WARM_UP)
    speed = np.interp(np.sin(turn), [-1, 1], texture.info.trained_speed)
    force = np.interp(np.cos(0.7 * turn), [-1, 1], texture.info.trained_force)
    times = []
    for condition in zip(speed, force, strict=True):
        state.set_condition(*condition)
        begin = time.perf_counter_ns()
        state.render(out)
        times.append(time.perf_counter_ns() - begin)
    us = np.array(times[_WARM_UP:]) / 1000
    p50, p99, p999, largest = np.percentile(us, [50, 99, 99.9, 100]).tolist()
    rate = texture.info.rate_hz
    return StepTimes(isa(), rate, n, p50, p99, p999, largest, 1e6 / rate / p50)


def time_all(path: Path, n: int) -> list[StepTimes]:
    """Times in each instruction set that this processor has, best first, each in a process of its own; OSError if one ends."""
    if NativeTexture(read_texture(path)).info.asks_predictor:
        # ONNX Runtime chooses its own instructions.
        return [replace(time_steps(path, n), isa="onnxruntime")]
    times = []
    for name in INSTRUCTION_SETS:
        done = subprocess.run(
            [sys.executable, "-c", _TIMED, str(path), str(n), name],
            env={**os.environ, "FOTEN_ISA": name},
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode != 0:
            raise OSError(f"timing {name}: {reason(done)}")
        if done.stdout:
            times.append(StepTimes(**json.loads(done.stdout)))
    return times


def reason(done: subprocess.CompletedProcess[str]) -> str:
    """Reason why a program in Python ended, in one line: the message of its exception, or the signal."""
    if done.returncode < 0:
        return f"ended by a signal, {signal.strsignal(-done.returncode)}"
    *_, last = ["", *done.stderr.strip().splitlines()]
    return re.sub(r"^[\w.]+: ", "", last) or f"ended with status {done.returncode}"


def as_table(times: list[StepTimes]) -> str:
    """Table of times, as text."""
    lines = [f"{'':12s}{'p50':>9s}{'p99':>9s}{'p99.9':>9s}{'max':>10s}   contacts a core"]
    for step in times:
        figures = "".join(f"{getattr(step, name):9.2f}" for name in ("p50_us", "p99_us", "p999_us"))
        lines.append(f"{step.isa:12s}{figures}{step.largest_us:10.1f}   {step.contacts:.0f} at {step.rate_hz:g} Hz")
    empty_us = 1e6 * np.median(timeit.repeat(library().foten_abi, number=1, repeat=2000))
    lines.append(f"in µs a sample, called one by one from Python; a call that does nothing takes {empty_us:.2f}")
    return "\n".join(lines)
