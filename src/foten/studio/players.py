"""What plays a contact: a device of this machine, or one thread that renders for all pages in turn, each for its own speaker."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from foten.runtime.actuator import ActuatorProfile
from foten.runtime.live.devices import SOUND_RATE_HZ
from foten.runtime.live.live import Live, LiveStatistics, Read, Samples
from foten.runtime.live.play import gain_for, sink_of

DEVICE_BLOCK_MS, DEVICE_LEAD_MS = 4.0, 12.0
TURN_MS = 8.0  # that is rendered at once for each page
MOST_BEHIND_S = 0.2  # that a machine which stood still catches up with


class Player(Protocol):
    """Takes samples from `render`, which fills an array with the next ones, from a start to a stop."""

    rate_hz: float
    calibrated: bool  # it takes what is rendered as it is, at a volume of 0 dB; else full scale, at a usual loudness
    actuator: ActuatorProfile | None  # that hangs on it
    statistics: LiveStatistics

    @property
    def running(self) -> bool:
        """Return whether it plays; where it ended by itself, `stop` says why."""

    def start(self, render: Read) -> None:
        """Begin; raises what a device does where it refuses."""

    def stop(self) -> None:
        """End, and raise what rendering died of; a second time nothing happens."""


@dataclass(frozen=True)
class OutputDevice:
    """What is wired to this machine: an output as `foten play` names it, and the actuator on it.

    Where the actuator or a gain is known, a page's 0 dB is the acceleration as it was recorded.

    Raises:
        ValueError: the output is none, is a file, or its unit and the actuator's do not go together.
    """

    to: str = "sound"
    actuator: ActuatorProfile | None = None
    gain: float | None = None  # full scale or volts for one of what is rendered
    device: str | None = None
    channel: int | None = None

    def __post_init__(self) -> None:
        if Path(self.to).suffix.lower() == ".wav":
            raise ValueError(
                f"a page plays in real time, and {self.to} is a file: the red dot of the page records strokes"
            )
        if self.calibrated:
            gain_for(self.actuator, self.gain, 1.0, self.to)

    @property
    def calibrated(self) -> bool:
        """Return whether an output is known for what is rendered, and not for full scale alone."""
        return self.to != "sound" or self.actuator is not None or self.gain is not None

    def check(self) -> None:
        """Open the output once, and give it back.

        Raises:
            OSError: it is not there.
            ValueError: it names none, or one without devices and channels of which some were given.
        """
        self.player(SOUND_RATE_HZ).stop()

    def player(self, rate_hz: float) -> DevicePlayer:
        """Return what plays on it.

        Raises:
            OSError: it is not there, or refuses the rate.
        """
        return DevicePlayer(self, rate_hz)


class DevicePlayer:
    """An output of this machine: its sound card, an NI-DAQ, or a program that takes samples."""

    def __init__(self, wired: OutputDevice, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self.calibrated, self.actuator = wired.calibrated, wired.actuator
        self.statistics = LiveStatistics()
        gain = gain_for(wired.actuator, wired.gain, 1.0, wired.to) if wired.calibrated else 1.0
        self._sink = sink_of(wired.to, rate_hz, gain, None, wired.device, wired.channel)
        self._live: Live | None = None

    @property
    def running(self) -> bool:
        """Return whether it plays."""
        return self._live is not None and self._live.running

    def start(self, render: Read) -> None:
        """Begin to play."""
        self._live = Live(render, self._sink, block_ms=DEVICE_BLOCK_MS, lead_ms=DEVICE_LEAD_MS)
        self.statistics = self._live.statistics
        self._live.start()

    def stop(self) -> None:
        """End, and give the device back."""
        live, self._live = self._live, None
        if live is not None:
            live.stop()
        else:
            self._sink.stop()


class Turns:
    """One thread that renders 8 ms for each of its players in turn, every 8 ms, while it has any.

    A thread for each would spend its time on waiting for Python's lock: twenty pages fell so far behind that the server refused
    events, as `benchmarks/studio_load.py` showed.
    """

    def __init__(self, turn_ms: float = TURN_MS) -> None:
        self.turn_s = turn_ms / 1000
        self._changing = threading.Lock()
        self._players: list[TurnPlayer] = []
        self._thread: threading.Thread | None = None

    def player(self, rate_hz: float) -> TurnPlayer:
        """Return a player that takes its turns here."""
        return TurnPlayer(self, rate_hz)

    def add(self, player: TurnPlayer) -> None:
        """Give a player its turns."""
        with self._changing:
            self._players.append(player)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="foten-turns", daemon=True)
                self._thread.start()

    def remove(self, player: TurnPlayer) -> None:
        """Take a player's turns away; it is in none of them any more when this returns."""
        with self._changing:
            if player in self._players:
                self._players.remove(player)

    def _run(self) -> None:
        due = time.perf_counter()
        while self._turn(due):
            due += self.turn_s
            now = time.perf_counter()
            if now > due + MOST_BEHIND_S:
                self._skip(int((now - due) / self.turn_s))
                due = now
            elif now < due:
                time.sleep(due - now)

    def _skip(self, n: int) -> None:
        """Count turns that are left out, after the machine stood still, as missed."""
        with self._changing:
            for player in self._players:
                player.statistics.n_missed += n

    def _turn(self, due: float) -> bool:
        """Render for each player; return whether there is any."""
        with self._changing:
            if not self._players:
                self._thread = None
                return False
            for player in list(self._players):
                if not player.take_turn(due + self.turn_s):
                    self._players.remove(player)
            return True


class TurnPlayer:
    """A page's own speaker: `render` itself hands on what it makes. `n_missed` counts blocks that came after their time."""

    def __init__(self, turns: Turns, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self.calibrated = False
        self.actuator: ActuatorProfile | None = None
        self._turns = turns
        self._block = np.zeros(max(1, round(turns.turn_s * rate_hz)), dtype=np.float32)
        self._render: Read | None = None
        self._failed: BaseException | None = None
        self.statistics = LiveStatistics(block_ms=1000 * self._block.size / rate_hz)

    @property
    def running(self) -> bool:
        """Return whether it takes turns."""
        return self._render is not None and self._failed is None

    def start(self, render: Read) -> None:
        """Begin to take turns."""
        self._render = render
        self._turns.add(self)

    def stop(self) -> None:
        """End, and raise what rendering died of."""
        self._turns.remove(self)
        failed, self._failed = self._failed, None
        if failed is not None:
            raise failed

    def take_turn(self, deadline: float) -> bool:
        """Render a block that is due at a time of `perf_counter`; return whether there is to be another."""
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


def white_noise(level_db: float, device: str | None) -> Live:
    """Return white noise on a sound card of this machine, to be played as a context, so that an actuator is not heard.

    Args:
        level_db: its RMS [dB of full scale].
        device: name or number of the sound card; None for the usual one.

    Raises:
        OSError: there is none.
    """
    rng, rms = np.random.default_rng(), np.float32(10 ** (level_db / 20))

    def render(out: Samples) -> None:
        np.clip(rms * rng.standard_normal(out.size, dtype=np.float32), -1.0, 1.0, out=out)

    return Live(render, sink_of("sound", SOUND_RATE_HZ, 1.0, None, device), lead_ms=100.0)
