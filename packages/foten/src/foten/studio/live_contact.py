"""The pen of a page on a texture that is rendered here, with a state and a player of its own."""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.runtime.actuator import ActuatorProfile
from foten.runtime.live.live import Samples
from foten.runtime.native import NativeTexture
from foten.runtime.renderer import Renderer
from foten.runtime.stylus import PressureCalibration, Stylus
from foten.studio.players import Player

# The page's own, in `sound.js` and `worklet.js`, so that both paths sound the same.
LOUDNESS = 0.1  # of full scale, of a recording's standard deviation at 0 dB
LINEAR = 0.8  # of full scale; beyond, what leaves is compressed and never reaches it
FADE_S = 512 / 48_000  # of a change from one texture to another
LIFT_S = 1e-4  # after the last event, that the pen is lifted where no event says it
LAST_EVENTS = 16  # repeated for a texture that takes over during a stroke

OnBlock = Callable[[NDArray[np.float32], float, float], None]
"""Takes what was rendered [m/s²] and the speed [mm/s] and force [N] of its last sample, in the rendering thread."""


@dataclass
class _Stroked:
    """A texture under the pen."""

    renderer: Renderer
    stylus: Stylus
    scale: float  # from what is rendered to the player's samples, at 0 dB
    sd: float  # of the recording


class Contact:
    """Vibration of a pen's events, given to a player from `open` to `close`.

    `on_block` is given each block before the volume, for the page to draw or to play.
    """

    def __init__(self, player: Player, on_block: OnBlock) -> None:
        self._on_block = on_block
        self.player = player
        self._actuator, self._full_scale = player.actuator, 1.0
        self._loaded: dict[tuple[bytes, int], Renderer] = {}  # by texture and seed
        self._stroked: _Stroked | None = None
        self._previous: _Stroked | None = None
        self._fade = np.linspace(1.0, 0.0, max(2, round(FADE_S * player.rate_hz)), dtype=np.float32)
        self._faded = 0  # samples of it that are behind
        self._volume, self._volume_was = 1.0, None  # type: float, float | None
        self._last: deque[list[float]] = deque(maxlen=LAST_EVENTS)
        # Of what is rendered, of the events, and of the beginning and the end; taken in this order's reverse.
        self._changing, self._pushing, self._starting = threading.Lock(), threading.Lock(), threading.Lock()
        self._started = self._closed = False

    def load(self, textures: Sequence[tuple[bytes, int]]) -> None:
        """Keep textures ready, each with a seed: `open` then takes as long for one as for another; ValueError as there."""
        native = {texture: NativeTexture(texture) for texture in dict.fromkeys(texture for texture, _ in textures)}
        for texture, seed in textures:
            self._loaded[texture, seed] = self._renderer(native[texture], seed)

    def _renderer(self, texture: bytes | NativeTexture, seed: int) -> Renderer:
        return Renderer(texture, rate=self.player.rate_hz, seed=seed, actuator=self._actuator)

    def open(
        self, texture: bytes, calibration: PressureCalibration, seed: int = 0, volume_db: float | None = None
    ) -> None:
        """Put a texture under the pen, in the middle of a stroke too; the first one begins to play. A volume of None stays.

        Raises:
            ValueError: it is no texture file, or its rate and the player's do not go together.
            OSError: the player's device refuses, or the contact was closed meanwhile.
        """
        loaded = self._loaded.get((texture, seed))
        renderer = loaded or self._renderer(texture, seed)
        sd = float(renderer.native_texture.info.acceleration_sd)
        with self._pushing, self._changing:
            if loaded is not None:
                loaded.reset()  # it may have been under the pen before
            stroked = _Stroked(renderer, self._stylus(renderer, calibration), self._scale(sd), sd)
            self._previous, self._stroked, self._faded = self._stroked, stroked, 0
            if volume_db is not None:
                self.set_volume(volume_db)
        with self._starting:
            if self._closed:
                raise OSError("the page has left")
            if not self._started:
                self._started = True
                self.player.start(self._render)

    def _scale(self, sd: float) -> float:
        if self.player.calibrated:
            return 1.0
        return 1 / self._full_scale if self._actuator is not None else LOUDNESS / sd

    def _stylus(self, renderer: Renderer, calibration: PressureCalibration) -> Stylus:
        """A stylus that knows the last events."""
        stylus = Stylus(renderer, calibration)
        for event in self._last:
            stylus.push(*event)
        return stylus

    def calibrate(self, calibration: PressureCalibration) -> None:
        """Take another curve of pressure from now on."""
        with self._pushing, self._changing:
            if self._stroked is not None:
                self._stroked.stylus = self._stylus(self._stroked.renderer, calibration)

    def actuate(self, actuator: ActuatorProfile | None, full_scale: float = 1.0) -> None:
        """Render an actuator's drive from now on, of which so much is full scale; None renders acceleration. Where the player has
        an actuator of its own, that stays.
        """
        if self.player.actuator is not None:
            return
        with self._changing:
            self._actuator, self._full_scale = actuator, full_scale
            if self._stroked is not None:
                self._stroked.renderer.native_state.set_actuator(None if actuator is None else actuator.native())
                self._stroked.scale = self._scale(self._stroked.sd)

    def set_volume(self, db: float) -> None:
        """Set the volume [dB]."""
        self._volume = 10.0 ** (db / 20.0)

    @property
    def gain(self) -> float:
        """Factor from m/s², or an actuator's drive, to the player's samples."""
        return self._volume * (self._stroked.scale if self._stroked is not None else 1.0)

    def push(self, events: NDArray[np.float64]) -> None:
        """Take in events: x, y [mm], pressure, t [s], shape (n, 4)."""
        with self._pushing:
            for event in events.tolist():
                self._last.append(event)
                if self._stroked is not None:
                    self._stroked.stylus.push(*event)

    def lift(self) -> None:
        """Lift the pen where it is."""
        if self._last and self._last[-1][2] > 0:
            x, y, _, t = self._last[-1]
            self.push(np.array([[x, y, 0.0, t + LIFT_S]]))

    @property
    def stylus_counts(self) -> dict[str, int]:
        """Events that the stylus counted, by kind."""
        return {} if self._stroked is None else self._stroked.stylus.stats.by_name()

    def close(self) -> None:
        """End playing for good, and give the device back; raises what it died of."""
        with self._starting:
            self._closed = True
        self.player.stop()

    def _render(self, out: Samples) -> None:
        with self._changing:
            stroked = self._stroked
            assert stroked is not None
            stroked.stylus.render_into(out)
            self._on_block(out, *stroked.renderer.condition)
            out *= stroked.scale
            if self._previous is not None:
                self._cross(out, self._previous)
            volume = self._volume if self._volume_was is None else self._volume_was, self._volume
            self._volume_was = self._volume
        out *= np.linspace(*volume, out.size, dtype=np.float32)
        if not self.player.calibrated:
            limit(out)

    def _cross(self, out: Samples, previous: _Stroked) -> None:
        """Fade from the previous texture to the present one."""
        leaving, share = np.empty_like(out), np.zeros_like(out)
        previous.stylus.render_into(leaving)
        part = self._fade[self._faded : self._faded + out.size]
        share[: part.size] = part
        out += share * (previous.scale * leaving - out)
        self._faded += out.size
        if self._faded >= self._fade.size:
            self._previous = None


def limit(samples: Samples) -> None:
    """Compress, in place, what is beyond `LINEAR` of full scale."""
    size = np.abs(samples)
    if size.max(initial=0.0) <= LINEAR:
        return
    room = 1 - LINEAR
    beyond = np.sign(samples) * (LINEAR + room * np.tanh((size - LINEAR) / room))
    np.copyto(samples, beyond.astype(np.float32), where=size > LINEAR)
