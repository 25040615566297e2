"""A long stroke through everything, with a tablet that misbehaves: is every sample finite, every fault counted, no memory lost?

    python benchmarks/soak.py [--texture T.foten] [--hours 1] [--ratio 12] [--csv FILE]

A pen draws for a simulated hour, ten times as fast as real time or faster, through stylus, kernel, change of rate, ring and a
sink that plays nowhere. Of its events some are lost, doubled, NaN, late by half a second, or of a pressure that cannot be; now
and then its clock begins anew, the pen is out of reach and comes back elsewhere, or more events come at once than can wait.
What was done to it is counted here, what was noticed there. Exit 1 where a count differs, a sample is not finite or memory
grows.
"""

import math
import os
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from bench import parser_of, report, untrained
from foten.models.texture_file import read_texture
from foten.runtime.live.devices import NullSink
from foten.runtime.live.live import Live
from foten.runtime.renderer import Renderer
from foten.runtime.stylus import Stylus

EVENTS_HZ = 133.0
WAITING = 256  # events that the kernel keeps, foten.h
CLOCK_IS_BELIEVED = 8  # late events in succession that begin a new clock, foten.h
SHARES = {"lost": 0.02, "doubled": 0.02, "not a number": 0.01, "late": 0.01, "too firm": 0.01}
EVERY_S = {"clock begins anew": 97.0, "out of reach": 41.0, "flood": 61.0}
SETTLED = 0.1  # of the time, after which memory is to stay
MAY_GROW = 256 * 1024  # bytes; what Python's own threads come and go with


class FastSink(NullSink):
    """Sink that takes samples so many times as fast as real time."""

    def __init__(self, rate_hz: float, ratio: float) -> None:
        super().__init__(rate_hz)
        self._period_s /= ratio


class Tablet:
    """A pen that circles at changing speed and pressure, and what is done to its events."""

    def __init__(self, stylus: Stylus, seed: int = 0) -> None:
        self._stylus, self._draw = stylus, np.random.default_rng(seed)
        self._due = self._clock = 0.0  # when the next event is due, and by how much the device's time is ahead of it
        self._at = np.zeros(2)
        self._waiting = 0
        self._good_since_fault = 0
        self._next = dict(EVERY_S)
        self.done: Counter[str] = Counter()

    def until(self, t: float) -> None:
        """Tell of every event before a time [s]; all that waited has been rendered since the last call."""
        self._waiting = 0
        while self._due < t:
            self._event(self._due)
            self._due += self._draw.uniform(0.6, 1.4) / EVENTS_HZ

    def _event(self, t: float) -> None:
        speed = 150 + 140 * math.sin(0.9 * t)
        self._at += speed / EVENTS_HZ * np.array([math.cos(0.7 * t), math.sin(0.7 * t)])
        pressure = 0.45 + 0.4 * math.sin(0.37 * t)
        happens = self._draw.random()
        # Faults of the tablet itself wait for a good event before and after, so that each can be told apart.
        if self._good_since_fault > 20:
            for name, due in self._next.items():
                if t >= due:
                    self._next[name] = t + EVERY_S[name]
                    return self._fault(name, t, pressure)
        for name, share in SHARES.items():
            if happens < share and self._good_since_fault > 1:
                return self._fault(name, t, pressure)
            happens -= share
        self._good_since_fault += 1
        self._push(t, pressure)

    def _fault(self, name: str, t: float, pressure: float) -> None:
        """What a fault makes of an event, or puts in its place."""
        self._good_since_fault = 0
        self.done[name] += 1
        match name:
            case "doubled":
                self._push(t, pressure)
                self._push(t, pressure)
            case "not a number":
                self._stylus.push(*self._draw.permutation([math.nan, math.inf, 0.5, t + self._clock]))
            case "late":
                self._push(t - 0.5, pressure)
            case "too firm":
                self._push(t, 1.0 + pressure)
            case "clock begins anew":
                self._clock = -t
                for k in range(CLOCK_IS_BELIEVED):
                    self._push(t + 0.0005 * k, pressure)
            case "out of reach":
                self._due += 0.5
                self._at += 60.0
                self._push(self._due, pressure)
            case "flood":
                for k in range(WAITING + 50):
                    self._push(t + 1e-5 * k, pressure)

    def _push(self, t: float, pressure: float) -> None:
        if self._waiting == WAITING:
            self.done["dropped"] += 1
        else:
            self._waiting += 1
        self._stylus.push(*self._at, pressure, t + self._clock)

    def expected(self) -> dict[str, int]:
        """What the stylus has to have counted, by the names of foten_stylus_stats."""
        return {
            "n_refused": self.done["not a number"],
            "n_late": self.done["doubled"] + self.done["late"] + CLOCK_IS_BELIEVED * self.done["clock begins anew"],
            "n_dropped": self.done["dropped"],
            "n_clipped": self.done["too firm"],
            "n_jumps": self.done["out of reach"],
        }


def resident_bytes() -> int:
    """The memory of this process that is in use."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def soaked(texture: Any, hours: float, ratio: float) -> dict[str, Any]:
    """What came of it."""
    rate = 8 * float(texture.rate_hz)
    renderer = Renderer(texture, rate)
    stylus = Stylus(renderer)
    tablet = Tablet(stylus)
    seconds = 3600 * hours
    state = {"n": 0, "not finite": 0, "largest": 0.0, "sum": 0.0}
    memory: list[tuple[float, int]] = []

    def render(out: np.ndarray) -> None:
        t = state["n"] / rate
        tablet.until(t)
        out[:] = stylus.render(out.size)
        state["n"] += out.size
        state["not finite"] += int((~np.isfinite(out)).sum())
        state["largest"] = max(state["largest"], float(np.abs(out).max()))
        state["sum"] += float(np.square(out).sum())
        if t >= len(memory) * seconds / 100:
            memory.append((t, resident_bytes()))

    live = Live(render, FastSink(rate, ratio), lead_ms=500.0)
    begin = time.perf_counter()
    reported = begin
    with live:
        while state["n"] / rate < seconds and live.running:
            time.sleep(0.2)
            if time.perf_counter() - reported > 10:
                reported = time.perf_counter()
                print(
                    f"{state['n'] / rate / 60:.1f} of {seconds / 60:.0f} min, "
                    f"{state['n'] / rate / (reported - begin):.1f} times real time",
                    file=sys.stderr,
                )
    took = time.perf_counter() - begin
    settled = [used for t, used in memory if t >= SETTLED * seconds]
    counted = stylus.stats
    return {
        "simulated_s": state["n"] / rate,
        "ratio": state["n"] / rate / took,
        "n_samples": int(state["n"]),
        "n_not_finite": int(state["not finite"]),
        "largest": state["largest"],
        "rms": math.sqrt(state["sum"] / max(1, state["n"])),
        "memory_grew_bytes": max(settled) - settled[0],
        "n_underruns": live.statistics.n_underruns,
        "step": live.statistics.line(),
        "done": dict(tablet.done),
        "expected": tablet.expected(),
        "counted": {name: int(getattr(counted, name)) for name, _ in counted._fields_},
    }


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--texture", type=Path, metavar="T.foten", help="by default an untrained foten-plus")
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--ratio", type=float, default=12.0, help="of simulated to real time; it has to keep 10")
    arguments = parser.parse_args()
    texture = read_texture(arguments.texture) if arguments.texture else untrained("foten-plus")
    result = soaked(texture, arguments.hours, arguments.ratio)
    print(
        f"{result['simulated_s'] / 3600:.2f} h at {result['ratio']:.1f} times real time: {result['n_not_finite']} of "
        f"{result['n_samples']:,} samples not finite, the largest {result['largest']:.3g} m/s² at {result['rms']:.3g} m/s² rms; "
        f"memory grew by {result['memory_grew_bytes'] / 1024:.0f} kB. {result['step'][0].upper()}{result['step'][1:]}.\n"
    )
    counted = [[f"`{name}`", str(count), str(result["counted"][name])] for name, count in result["expected"].items()]
    report([["fault", "done", "counted"], *counted], arguments.csv)
    fine = all(result["counted"][name] == count for name, count in result["expected"].items())
    fine &= result["simulated_s"] >= 3600 * arguments.hours and result["ratio"] >= min(10.0, 0.9 * arguments.ratio)
    if result["n_not_finite"] or not fine or result["memory_grew_bytes"] > MAY_GROW:
        sys.exit(1)


if __name__ == "__main__":
    main()
