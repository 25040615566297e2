"""A texture under a hand: speed and force in, acceleration out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.dsp.noise import gaussian
from foten.render.closed_loop import ClosedLoop
from foten.render.engine import engine_for
from foten.render.forecast import Engine
from foten.render.window_state import NoiseState
from foten.texture_file import CLOSED_LOOP_TOLERANCE, ONE_STEP_TOLERANCE, Texture

Array = NDArray[np.float64]

FADE_SPEED = 5.0  # mm/s; a texture fades below this, or below its trained range where that ends higher
FADE_FORCE = 0.1  # N
FURTHEST = 2.0  # times the trained range's end, that the level grows to
_NOISE_BLOCK = 4096  # samples of noise drawn at a time
_TO_BEGIN = 2**63  # the first noise number of those that streams begin with: no rendering lasts that long


@dataclass
class RenderStatistics:
    """What a synthesizer did to its input and output since the last reset.

    Attributes:
        n: samples rendered, over all streams.
        n_speed_beyond, n_force_beyond: samples whose speed or force lay above the trained range.
        n_speed_clamped, n_force_clamped: of those the ones above twice the range, where nothing changes any more.
        n_below_range: samples below the trained range, where the vibration fades.
        n_saturated: samples that the saturator cut.
    """

    n: int = 0
    n_speed_beyond: int = 0
    n_force_beyond: int = 0
    n_speed_clamped: int = 0
    n_force_clamped: int = 0
    n_below_range: int = 0
    n_saturated: int = 0


class Synthesizer:
    """A texture rendered sample by sample, on one stream or on several independent ones.

    The acceleration is the closed loop's output times a fade that falls linearly to zero, with speed below the trained
    range (at least below 5 mm/s) and with force likewise (at least below 0.1 N): a still pen does not buzz, whatever
    was recorded. The loop itself runs on, so that the texture is there again with the first movement.

    Above the trained range the loop sees the range's end, tones go on with the path, and the level grows by a power law of the
    training blocks, up to twice the range. It grows behind the loop, so that a jump back is soft at once. On simulated surfaces
    recorded in half of the hand's range (`benchmarks/outside.py`) that came nearest the truth of what was tried.

    Differs from the paper: it clamps to the recorded range on both sides (Sec. VIII), and so vibrates at rest and does not
    grow.

    Args:
        texture: from `read_texture`.
        seed: of the excitation, 0 … 2⁶⁴ − 1.
        n_streams: independent streams; stream s draws the noise of stream s.
        excitation: False runs the deterministic loop.

    Raises:
        ValueError: the engine does not reproduce the texture's golden windows.
    """

    def __init__(self, texture: Texture, seed: int = 0, n_streams: int = 1, excitation: bool = True) -> None:
        if not 0 <= seed < 2**64:
            raise ValueError(f"seed is {seed}, expected 0 to 2⁶⁴ − 1")
        if n_streams < 1:
            raise ValueError(f"n_streams is {n_streams}, expected 1 or more")
        self.texture = texture
        self.seed = seed
        self.n_streams = n_streams
        self.excitation = excitation and texture.has_excitation
        self._engine = engine_for(texture)
        prove(texture, self._engine)
        self._scaling = texture.scaling
        self._low = np.array([texture.trained_range("speed")[0], texture.trained_range("force")[0]])
        self._high = np.array([texture.trained_range("speed")[1], texture.trained_range("force")[1]])
        self._fade = np.maximum(self._low, [FADE_SPEED, FADE_FORCE])
        self._exponents = np.array([texture.beyond_exponent("speed"), texture.beyond_exponent("force")])
        self.reset()

    def reset(self, windows: Array | None = None) -> None:
        """Start again with the first number of the noise, under the first hand or from given scaled windows (n_streams, m, 3).

        With excitation a stroke begins as if its first hand had been there for long (`State.begin`), the chance of which is in
        the noise numbers from 2⁶³ on. Without, or where a model knows only what it heard, it goes on from the warm start, as it
        does from given windows, without a change; a model of noise knows their hand alone.
        """
        given = windows is not None
        self._fresh = not given and self.excitation
        if windows is None:
            windows = self.texture.tensors["warm_start"][None]
        if not np.isfinite(windows).all():
            raise ValueError("the windows to start from hold NaN or infinity")
        start = np.broadcast_to(windows, (self.n_streams, self.texture.window, 3)).astype(np.float64)
        state = self._engine.start(start)
        if isinstance(state, NoiseState) and given:
            state.listen(self._numbers(_TO_BEGIN, state.n_to_begin) * self.excitation)
        self._loop = ClosedLoop(state, float(self.texture.card["saturation"]))
        self._position = 0
        self._noise = np.empty((self.n_streams, 0))
        self.statistics = RenderStatistics()

    def step(self, speed: float, force: float) -> float:
        """Return the next acceleration [m/s²] of a single stream at a speed [mm/s] and a force [N]."""
        return float(self.render(np.array([speed]), np.array([force]))[0])

    def render(self, speed: Array, force: Array) -> Array:
        """Return the acceleration [m/s²] for a stroke at the model's rate, continuing from the last call.

        Args:
            speed: [mm/s], shape (n,) for all streams alike, or (n_streams, n).
            force: [N], the same shape.

        Returns:
            Shape (n,) with one stream, else (n_streams, n).

        Raises:
            ValueError: a speed or force is negative, NaN or infinite; the shapes differ.
        """
        condition = self._checked(speed, force)
        n = condition.shape[1]
        clamped = np.clip(condition, self._low, self._high)
        heeded = np.minimum(condition, FURTHEST * self._high)
        scaled = (clamped - self._scaling.mean[1:]) / np.array(self._scaling.sd[1:])
        given = np.concatenate([scaled, heeded[..., :1]], axis=-1)
        if self._fresh and n > 0:
            state = self._loop.state
            state.begin(given[:, 0], self._numbers(_TO_BEGIN, state.n_to_begin))
            self._fresh = False
        vibration = self._loop.run(given, self._draw(n) if self.excitation else None)
        fade = np.minimum(condition / self._fade, 1.0).prod(axis=-1)
        growth = (np.maximum(heeded / self._high, 1.0) ** self._exponents).prod(axis=-1)
        self._count(condition, clamped, heeded)
        out = self._scaling.unscale_acceleration(vibration) * fade * growth
        return out[0] if self.n_streams == 1 else out

    def _checked(self, speed: Array, force: Array) -> Array:
        condition = np.stack(
            np.broadcast_arrays(np.asarray(speed, dtype=float), np.asarray(force, dtype=float)), axis=-1
        )
        if condition.ndim == 2:
            condition = np.repeat(condition[None], self.n_streams, axis=0)
        if condition.ndim != 3 or condition.shape[0] != self.n_streams:
            raise ValueError(f"speed has shape {np.shape(speed)}, expected (n,) or ({self.n_streams}, n)")
        if not np.isfinite(condition).all() or (condition < 0).any():
            wrong = (~np.isfinite(condition) | (condition < 0)).any(axis=(0, 1))
            name, unit = ("speed", "mm/s") if wrong[0] else ("force", "N")
            raise ValueError(
                f"a {name} is negative, NaN or infinite, expected a finite number of {unit}, 0 or more"
            )
        return condition

    def _draw(self, n: int) -> Array:
        """Return the next n noise numbers of each stream, shape (n_streams, n)."""
        missing = n - self._noise.shape[1]
        if missing > 0:
            more = self._numbers(self._position + self._noise.shape[1], max(missing, _NOISE_BLOCK))
            self._noise = np.concatenate([self._noise, more], axis=1)
        drawn, self._noise = self._noise[:, :n], self._noise[:, n:]
        self._position += n
        return drawn

    def _numbers(self, first: int, n: int) -> Array:
        """Return n noise numbers of each stream from a first one on, shape (n_streams, n)."""
        return np.stack([gaussian(self.seed, stream, first, n) for stream in range(self.n_streams)])

    def _count(self, condition: Array, clamped: Array, heeded: Array) -> None:
        beyond, above = condition > self._high, condition > heeded
        self.statistics.n += condition.shape[0] * condition.shape[1]
        self.statistics.n_speed_beyond += int(beyond[..., 0].sum())
        self.statistics.n_force_beyond += int(beyond[..., 1].sum())
        self.statistics.n_speed_clamped += int(above[..., 0].sum())
        self.statistics.n_force_clamped += int(above[..., 1].sum())
        self.statistics.n_below_range += int((condition < clamped).any(axis=-1).sum())
        self.statistics.n_saturated = self._loop.n_saturated


def prove(texture: Texture, engine: Engine) -> None:
    """Replay a texture's golden windows through an engine.

    Raises:
        ValueError: one step differs by more than 1e-5, or the closed loop by more than 1e-4 (scaled).
    """
    tensors = texture.tensors
    windows = tensors["golden.windows"].astype(np.float64)
    checks = [("one step", engine.predict(windows), tensors["golden.one_step"], ONE_STEP_TOLERANCE)]
    scale = engine.start(windows).forecast().scale
    if scale is not None:
        checks.append(("the excitation", scale, tensors["golden.sigma"], ONE_STEP_TOLERANCE))
    loop = ClosedLoop(engine.start(tensors["warm_start"][None].astype(np.float64)))
    closed = loop.run(tensors["golden.condition"][None].astype(np.float64), gaussian(0, 0, 0, 64)[None])[0]
    checks.append(("64 closed-loop steps", closed, tensors["golden.closed_loop"], CLOSED_LOOP_TOLERANCE))
    for name, got, expected, tolerance in checks:
        # Relative where the output is large: 24 bits are 6e-8 of it in every operation.
        error = float((np.abs(got - expected) / np.maximum(1.0, np.abs(expected))).max())
        if not error <= tolerance:
            raise ValueError(
                f"the texture file fails its own proof: {name} differs by {error:.2g} scaled from what was trained, "
                f"expected at most {tolerance:g}; is the file damaged, or from another version of foten?"
            )
