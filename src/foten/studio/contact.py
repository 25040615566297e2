"""A page's hand on a texture that is rendered here: its own state, its own player."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from foten.runtime.actuator import ActuatorProfile
from foten.runtime.live.live import LiveStatistics, Samples
from foten.runtime.renderer import Renderer
from foten.runtime.stylus import PressureCalibration, Stylus
from foten.studio.players import Player

LOUDNESS = 0.1  # of full scale, of a recording's standard deviation at 0 dB; the page has the same

OnBlock = Callable[[NDArray[np.float32], float, float], None]
"""Given what was rendered [m/s²] and the speed [mm/s] and force [N] of its last sample, in the rendering thread."""


class Contact:
    """Events in, vibration out of a sink, from `open` to `close`.

    Args:
        player: takes what is rendered, in full scale or, where it is calibrated, as it is.
        on_block: is given each block before the volume, for the page to draw or to play.
    """

    def __init__(self, player: Player, on_block: OnBlock) -> None:
        self._on_block = on_block
        self._player, self._rate_hz = player, player.rate_hz
        self._hand: tuple[Renderer, Stylus, float] | None = None
        self._actuator = player.actuator
        self._volume = 1.0
        self._changing = threading.Lock()
        self._started = False

    def open(self, texture: bytes, calibration: PressureCalibration) -> None:
        """Put a texture under the pen; the first one begins to play.

        Raises:
            ValueError: it is no texture file, or its rate and the player's do not go together.
            OSError: the player's device refuses.
        """
        renderer = Renderer(texture, rate=self._rate_hz, actuator=self._actuator)
        scale = 1.0 if self._player.calibrated else LOUDNESS / renderer.native_texture.info.acceleration_sd
        with self._changing:
            self._hand = renderer, Stylus(renderer, calibration), scale
        if not self._started:
            self._started = True
            self._player.start(self._render)

    def calibrate(self, calibration: PressureCalibration) -> None:
        """Take another curve of pressure from now on."""
        with self._changing:
            if self._hand is not None:
                renderer, _, scale = self._hand
                self._hand = renderer, Stylus(renderer, calibration), scale

    def actuate(self, actuator: ActuatorProfile) -> None:
        """Render an actuator's drive from now on, but where the player has one of its own."""
        if self._player.actuator is None:
            self._actuator = actuator
            with self._changing:
                if self._hand is not None:
                    self._hand[0].native_state.set_actuator(actuator.native())

    def set_volume(self, db: float) -> None:
        """Set the volume [dB]."""
        self._volume = 10.0 ** (db / 20.0)

    def push(self, events: NDArray[np.float64]) -> None:
        """Take in events: x, y [mm], pressure, t [s], shape (n, 4)."""
        if self._hand is not None:
            stylus = self._hand[1]
            for event in events.tolist():
                stylus.push(*event)

    @property
    def running(self) -> bool:
        """Return whether it plays; where it ended by itself, `close` says why."""
        return self._player.running

    @property
    def statistics(self) -> LiveStatistics:
        """Return what rendering in real time did."""
        return self._player.statistics

    @property
    def counted(self) -> dict[str, int]:
        """Return what the stylus counted of its events."""
        if self._hand is None:
            return {}
        stats = self._hand[1].stats
        return {name: int(getattr(stats, name)) for name, *_ in type(stats)._fields_}

    def close(self) -> None:
        """End playing and give the device back; raises what it died of."""
        self._started = False
        self._player.stop()

    def _render(self, out: Samples) -> None:
        with self._changing:
            assert self._hand is not None
            renderer, stylus, scale = self._hand
            stylus.render_into(out)
        self._on_block(out, *renderer.condition)
        out *= scale * self._volume  # and what is beyond a device's range, the device cuts
