"""What plays a contact: a device of this machine, or one thread that renders for all pages in turn, each for its own speaker."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from foten.runtime.actuator import ActuatorProfile
from foten.runtime.live.devices import SOUND_RATE_HZ
from foten.runtime.live.live import Live, LiveStatistics, Read, Samples
from foten.runtime.live.play import gain_for, sink_of

DEVICE_BLOCK_MS, DEVICE_LEAD_MS = 4.0, 12.0
BLOCK_MS = 8.0  # that is rendered at once for each page
MAX_BEHIND_S = 0.2  # that a machine which stood still catches up with


@dataclass(frozen=True)
class OutputDevice:
    """An output that is wired to this machine, as `foten play` names it, and its actuator; ValueError for what does not fit.

    Where the actuator or a gain is known, a page's 0 dB is the acceleration as it was recorded.
    """

    to: str = "sound"
    actuator: ActuatorProfile | None = None
    gain: float | None = None  # full scale or volts for one of what is rendered
    device: str | None = None
    channel: int | None = None

    def __post_init__(self) -> None:
        if Path(self.to).suffix.lower() == ".wav":
            raise ValueError(f"a page plays in real time, and {self.to} is a file: its red dot records strokes")
        if self.calibrated:
            gain_for(self.actuator, self.gain, 1.0, self.to)

    @property
    def calibrated(self) -> bool:
        """Whether its output is known per m/s², and not per full scale alone."""
        return self.to != "sound" or self.actuator is not None or self.gain is not None

    def check(self) -> None:
        """Open the output once, and give it back; OSError where it is missing, ValueError where its options do not fit."""
        self.player(SOUND_RATE_HZ).stop()

    def player(self, rate_hz: float) -> DevicePlayer:
        """Player on it; OSError where it is missing, or refuses the rate."""
        return DevicePlayer(self, rate_hz)


class DevicePlayer:
    """Plays what is rendered on an output of this machine: its sound card, an NI-DAQ, or a program that takes samples.

    `calibrated` says that it takes what is rendered as it is, at a volume of 0 dB; else full scale, at a usual loudness.
    """

    def __init__(self, output: OutputDevice, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self.calibrated, self.actuator = output.calibrated, output.actuator
        self.statistics = LiveStatistics()
        gain = gain_for(output.actuator, output.gain, 1.0, output.to) if output.calibrated else 1.0
        self._sink = sink_of(output.to, rate_hz, gain, output.device, output.channel)
        self._live: Live | None = None

    @property
    def running(self) -> bool:
        """Whether it plays; where it ended by itself, `stop` says why."""
        return self._live is not None and self._live.running

    def start(self, render: Read) -> None:
        """Begin to take samples from `render`; raises what the device does where it refuses."""
        self._live = Live(render, self._sink, block_ms=DEVICE_BLOCK_MS, lead_ms=DEVICE_LEAD_MS)
        self.statistics = self._live.statistics
        self._live.start()

    def stop(self) -> None:
        """End, and raise what rendering died of; a second time nothing happens."""
        live, self._live = self._live, None
        (live or self._sink).stop()


class RoundRobinRenderer:
    """One thread that renders 8 ms for each of its players in turn, every 8 ms, while it has any.

    Threads of their own would wait for Python's lock: twenty pages then fall behind (`benchmarks/pages.py load`).
    """

    block_s = BLOCK_MS / 1000

    def __init__(self) -> None:
        self._changing = threading.Lock()
        self._players: list[RoundRobinPlayer] = []
        self._thread: threading.Thread | None = None

    def player(self, rate_hz: float) -> RoundRobinPlayer:
        """Player whose blocks are rendered here."""
        return RoundRobinPlayer(self, rate_hz)

    def add(self, player: RoundRobinPlayer) -> None:
        """Render for a player from now on."""
        with self._changing:
            self._players.append(player)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="foten-round-robin", daemon=True)
                self._thread.start()

    def remove(self, player: RoundRobinPlayer) -> None:
        """Render for a player no more, once this returns."""
        with self._changing:
            if player in self._players:
                self._players.remove(player)

    def _run(self) -> None:
        due = time.perf_counter()
        while self._render_all(due):
            due += self.block_s
            behind = time.perf_counter() - due
            if behind > MAX_BEHIND_S:  # blocks are left out, and missed
                with self._changing:
                    for player in self._players:
                        player.statistics.n_missed += int(behind / self.block_s)
                due += behind
            elif behind < 0:
                time.sleep(-behind)

    def _render_all(self, due: float) -> bool:
        """Render a block for each player; whether there is any."""
        with self._changing:
            if not self._players:
                self._thread = None
                return False
            for player in list(self._players):
                if not player.render_block(due + self.block_s):
                    self._players.remove(player)
            return True


class RoundRobinPlayer:
    """A page's own speaker: `render` itself hands on what it makes. `n_missed` counts blocks that came after their time."""

    def __init__(self, renderer: RoundRobinRenderer, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self.calibrated = False
        self.actuator: ActuatorProfile | None = None
        self._renderer = renderer
        self._block = np.zeros(max(1, round(renderer.block_s * rate_hz)), dtype=np.float32)
        self._render: Read | None = None
        self._failed: BaseException | None = None
        self.statistics = LiveStatistics(block_ms=1000 * self._block.size / rate_hz)

    @property
    def running(self) -> bool:
        return self._render is not None and self._failed is None

    def start(self, render: Read) -> None:
        self._render = render
        self._renderer.add(self)

    def stop(self) -> None:
        self._renderer.remove(self)
        failed, self._failed = self._failed, None
        if failed is not None:
            raise failed

    def render_block(self, deadline: float) -> bool:
        """Render a block that is due at a time of `perf_counter`; whether there is to be another."""
        assert self._render is not None
        begin = time.perf_counter()
        try:
            self._render(self._block)
        except BaseException as error:  # raised by `stop`, in the thread that waits for it
            self._failed = error
            return False
        end = time.perf_counter()
        self.statistics.block.add(end - begin)
        self.statistics.n_samples += self._block.size
        self.statistics.n_missed += end > deadline
        return True


Player = DevicePlayer | RoundRobinPlayer


def white_noise(level_db: float, device: str | None) -> Live:
    """White noise of an RMS [dB re full scale] on a sound card, as a context in which it plays: it masks an actuator's sound."""
    rng, rms = np.random.default_rng(), np.float32(10 ** (level_db / 20))

    def render(out: Samples) -> None:
        np.clip(rms * rng.standard_normal(out.size, dtype=np.float32), -1.0, 1.0, out=out)

    return Live(render, sink_of("sound", SOUND_RATE_HZ, 1.0, device), lead_ms=100.0)
