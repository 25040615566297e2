"""A texture in real time: a thread that renders ahead into a ring, and a sink that plays from it."""

from __future__ import annotations

import atexit
import sys
import threading
import time
import weakref
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Samples = NDArray[np.float32]
Read = Callable[[Samples], None]

BLOCK_MS = 2.0  # rendered at once: a condition is set between blocks
LEAD_MS = 10.0  # rendered ahead of what is played: the delay, and how long a busy machine may pause
FADE_MS = 5.0  # to silence where the ring runs empty, half a period of 100 Hz: a step would click
SWITCH_S = 0.0005  # that another thread keeps Python's lock while one renders live; Python's own 5 ms are too long
_BINS = np.concatenate([[0.0], np.geomspace(1e-7, 1.0, 701)])  # s; 2.3 % apart


class Ring:
    """Ring of float32 samples, without a lock: each counter is written by one thread, after its samples are in place.

    Where there are no more, it fades to silence in `n_fade` samples; new ones rise in as many.
    """

    def __init__(self, size: int, n_fade: int) -> None:
        self._samples = np.zeros(size, dtype=np.float32)
        self._n_written = self._n_read = 0
        # The reader's own: gains of a rise, the step that it is at, and the sample that a fade begins from.
        self._gains = (0.5 - 0.5 * np.cos(np.pi * np.arange(n_fade + 1) / n_fade)).astype(np.float32)
        self._step, self._last = n_fade, np.float32(0.0)

    @property
    def level(self) -> int:
        """Number of samples that wait to be read."""
        return self._n_written - self._n_read

    def write(self, samples: Samples) -> int:
        """Take in as many samples as there is room for, and return how many."""
        size = self._samples.size
        n, at = min(samples.size, size - self.level), self._n_written % size
        first = min(n, size - at)
        self._samples[at : at + first] = samples[:first]
        self._samples[: n - first] = samples[first:n]
        self._n_written += n
        return n

    def read_into(self, out: Samples) -> int:
        """Fill an array with waiting samples and then a fade to silence, and return how many were waiting."""
        size = self._samples.size
        n, at = min(out.size, self.level), self._n_read % size
        first = min(n, size - at)
        out[:first] = self._samples[at : at + first]
        out[first:n] = self._samples[: n - first]
        self._n_read += n
        self._fade(out, n)
        return n

    def _fade(self, out: Samples, n: int) -> None:
        """Let the first n samples rise after silence, and the others fall to it from the last of them."""
        if n:
            self._last = out[n - 1]
            rising = min(n, self._gains.size - 1 - self._step)
            out[:rising] *= self._gains[self._step + 1 : self._step + 1 + rising]
            self._step += rising
        falling = min(out.size - n, self._step)
        gains = self._gains[self._step - falling : self._step]
        np.multiply(gains[::-1], self._last, out=out[n : n + falling])
        out[n + falling :] = 0.0
        self._step -= falling


@dataclass
class Timing:
    """Histogram of durations in 700 bins from 0.1 µs to 1 s: percentiles within 2.3 %, the largest exactly."""

    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_BINS.size, dtype=np.int64))
    largest_s: float = 0.0

    def add(self, seconds: float) -> None:
        """Count a duration."""
        self.counts[np.searchsorted(_BINS, seconds) - 1 if seconds > 0 else 0] += 1
        self.largest_s = max(self.largest_s, seconds)

    def percentile_s(self, percent: float) -> float:
        """Percentile [s], the upper end of its bin; NaN where nothing was counted."""
        total = int(self.counts.sum())
        if total == 0:
            return float("nan")
        at = int(np.searchsorted(np.cumsum(self.counts), percent / 100 * total))
        return float(min(_BINS[min(at + 1, _BINS.size - 1)], self.largest_s))


@dataclass
class LiveStatistics:
    """Counts and times of a rendering in real time."""

    block: Timing = field(default_factory=Timing)  # rendering of a block
    block_ms: float = 0.0  # that a block plays
    n_samples: int = 0  # rendered
    n_missed: int = 0  # blocks that took longer to render than to play
    n_underruns: int = 0  # times that the sink asked for more than there was
    n_lacking: int = 0  # samples that faded to silence, or were silent, instead
    min_ms: float = float("inf")  # that the ring held, once it had been full

    def line(self) -> str:
        """One line for people."""
        times = " / ".join(f"{1000 * self.block.percentile_s(p):.2f}" for p in (50, 99, 99.9))
        rendered = f"blocks of {self.block_ms:g} ms rendered in {times} ms (p50 / p99 / p99.9)"
        counts = f"{self.n_missed} late, {self.n_underruns} under-runs, ring at least {self.min_ms:.1f} ms"
        return f"{rendered}, at most {1000 * self.block.largest_s:.2f} ms; {counts}"


class Sink(Protocol):
    """Destination that takes samples from `read` in a thread or a callback of its own, at its own pace."""

    rate_hz: float  # at which it takes them
    n_at_once: int  # samples that it takes at most at once
    failed: BaseException | None  # error that ended it, or the rendering, which `Live` sets

    def start(self, read: Read) -> None:
        """Begin to take samples: `read` fills an array, and does not wait."""

    def stop(self) -> None:
        """End, and close what it holds; a second call does nothing."""


class Live:
    """Thread that renders a texture ahead, for a sink to play.

        with Live(stylus.render_into, SoundSink(gain=0.02)) as live:
            ...
        print(live.statistics.line())

    While one runs, Python's threads switch ten times as often. A call that keeps Python's lock for longer than the lead makes a
    gap, which `n_underruns` counts.

    Args:
        render: fills an array with the next samples, in this class's thread.
        block_ms, lead_ms: rendered at once; rendered ahead, or what the sink takes at once where that is more.
    """

    def __init__(self, render: Read, sink: Sink, block_ms: float = BLOCK_MS, lead_ms: float = LEAD_MS) -> None:
        if not 0 < block_ms <= lead_ms <= 1000:
            raise ValueError(f"blocks of {block_ms} ms and a lead of {lead_ms} ms, expected 0 < block ≤ lead ≤ 1000 ms")
        self._render, self._sink, rate = render, sink, sink.rate_hz
        self._block = np.zeros(max(1, round(block_ms * rate / 1000)), dtype=np.float32)
        self._lead = max(round(lead_ms * rate / 1000), sink.n_at_once + self._block.size)
        self._ring = Ring(max(2 * self._block.size, self._lead), n_fade=max(1, round(FADE_MS * rate / 1000)))
        self._stopping, self._wanted, self._filled = threading.Event(), threading.Event(), threading.Event()
        self._failed: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="foten-render", daemon=True)
        self.statistics = LiveStatistics(block_ms=1000 * self._block.size / rate)

    def __enter__(self) -> Live:
        self.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.stop()

    @property
    def running(self) -> bool:
        """Whether it plays: started, not stopped, and neither rendering nor sink has failed."""
        return self._thread.is_alive() and self._failed is None and self._sink.failed is None

    @property
    def lead_ms(self) -> float:
        """Time that is rendered ahead [ms]."""
        return 1000 * self._lead / self._sink.rate_hz

    def start(self) -> None:
        """Fill the ring, then let the sink play; raises what the sink raises."""
        global _usual_s
        if not _playing:
            _usual_s = sys.getswitchinterval()
            sys.setswitchinterval(min(SWITCH_S, _usual_s))
        _playing.add(self)
        self._thread.start()
        self._filled.wait()
        if self._failed is not None:
            return
        try:
            self._sink.start(self._read)
        except BaseException:
            self._end()
            raise

    def stop(self) -> None:
        """End the sink, then the thread, and raise the error of either; a second call does nothing."""
        self._close()
        if failed := self._failed or self._sink.failed:
            raise failed

    def _close(self) -> None:
        self._sink.failed = self._sink.failed or self._failed
        try:
            self._sink.stop()
        finally:
            self._end()

    def _end(self) -> None:
        self._stopping.set()
        self._wanted.set()
        if self._thread.is_alive():
            self._thread.join()
        _playing.discard(self)
        if not _playing:
            sys.setswitchinterval(_usual_s)

    def _read(self, out: Samples) -> None:
        n = self._ring.read_into(out)
        self._wanted.set()
        self.statistics.min_ms = min(self.statistics.min_ms, 1000 * self._ring.level / self._sink.rate_hz)
        if n < out.size:
            self.statistics.n_underruns += 1
            self.statistics.n_lacking += out.size - n

    def _run(self) -> None:
        seconds = self._block.size / self._sink.rate_hz
        try:
            while not self._stopping.is_set():
                if self._ring.level + self._block.size > self._lead:
                    self._filled.set()
                    self._wanted.wait(seconds)
                    self._wanted.clear()
                    continue
                begin = time.perf_counter()
                self._render(self._block)
                took = time.perf_counter() - begin
                self._ring.write(self._block)
                self.statistics.block.add(took)
                self.statistics.n_samples += self._block.size
                self.statistics.n_missed += took > seconds
        except BaseException as error:  # raised by `stop`, in the thread that waits for it
            self._failed = error
        finally:
            self._filled.set()


_playing: weakref.WeakSet[Live] = weakref.WeakSet()
_usual_s = sys.getswitchinterval()  # before the first began


@atexit.register
def _end_all() -> None:
    """End what still plays as the interpreter ends, before what it renders from is freed."""
    for live in list(_playing):
        live._close()
