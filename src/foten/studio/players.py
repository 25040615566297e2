"""What plays a contact: this machine's sound card, or one thread that renders for all pages in turn, each for its own speaker."""

from __future__ import annotations

import threading
import time
from typing import Protocol

import numpy as np

from foten.runtime.live.devices import SoundSink
from foten.runtime.live.live import Live, LiveStatistics, Read

DEVICE_BLOCK_MS, DEVICE_LEAD_MS = 4.0, 12.0
TURN_MS = 8.0  # that is rendered at once for each page
MOST_BEHIND_S = 0.2  # that a machine which stood still catches up with


class Player(Protocol):
    """Takes samples from `render`, which fills an array with the next ones, from a start to a stop."""

    rate_hz: float
    statistics: LiveStatistics

    def start(self, render: Read) -> None:
        """Begin; raises what a device does where it refuses."""

    def stop(self) -> None:
        """End, and raise what rendering died of; a second time nothing happens."""


class DevicePlayer:
    """The sound card of this machine.

    Raises:
        OSError: there is none, or it refuses the rate.
    """

    def __init__(self, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self.statistics = LiveStatistics()
        self._sink = SoundSink(1.0, rate_hz=rate_hz)
        self._live: Live | None = None

    def start(self, render: Read) -> None:
        """Begin to play."""
        self._live = Live(render, self._sink, block_ms=DEVICE_BLOCK_MS, lead_ms=DEVICE_LEAD_MS)
        self.statistics = self._live.statistics
        self._live.start()

    def stop(self) -> None:
        """End, and give the card back."""
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
        self._turns = turns
        self._block = np.zeros(max(1, round(turns.turn_s * rate_hz)), dtype=np.float32)
        self._render: Read | None = None
        self._failed: BaseException | None = None
        self.statistics = LiveStatistics(block_ms=1000 * self._block.size / rate_hz)

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
