"""A texture under one stroke, at any output rate, in real time."""

from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foten.models.texture_file import Texture
from foten.runtime.actuator import ActuatorProfile
from foten.runtime.binding import NativeStatistics
from foten.runtime.native import NativeState, NativeTexture
from foten.untrusted import read_whole

# Comes with the package: a woven steel mesh, learned with the default recipe from `foten simulate steel-mesh-1`.
EXAMPLE = Path(__file__).parents[1] / "textures" / "steel-mesh-1.foten"


class Renderer:
    """Texture under one stroke: speed and force in, acceleration out.

        renderer = foten.Renderer("denim.foten", rate=48_000, seed=0)
        block = renderer.render(speed_mm_s=80.0, force_n=0.8, n=480)

    After construction it allocates only the arrays that it returns, and takes no lock of Python's; a model that ONNX Runtime runs
    does both in each sample. The same seed and stroke give the same bytes, whatever the sizes of the blocks.

    Args:
        texture: a texture file, its bytes, or a texture in memory, which the kernel may have loaded.
        rate: of the output [Hz]; None for the texture's own.
        seed: of the excitation, 0 … 2⁶⁴ − 1.
        stream: of the noise; two contacts with one texture need different ones to be independent.
        excitation: False runs the deterministic loop.
        actuator: renders its drive; None renders acceleration.
        smooth: low-pass constant conditions at 20 Hz, as the recordings were (11 ms late): for conditions in steps, as of a game
            at 60 Hz. Arrays are taken as they are.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is no texture file, is damaged, or fails its own proof; a rate or seed is out of range.
    """

    def __init__(
        self,
        texture: str | PathLike[str] | bytes | Texture | NativeTexture,
        rate: float | None = None,
        seed: int = 0,
        stream: int = 0,
        excitation: bool = True,
        actuator: ActuatorProfile | None = None,
        smooth: bool = False,
    ) -> None:
        _check_uint64("seed", seed)
        _check_uint64("stream", stream)
        self.native_texture = _native(texture)
        self.native_state = NativeState(self.native_texture, rate, seed, stream, excitation, smooth)
        if actuator is not None:
            self.native_state.set_actuator(actuator.native())
        self.seed = seed
        self.texture_rate = self.native_texture.info.rate_hz
        self.rate = self.texture_rate if rate is None else float(rate)

    @property
    def delay_ms(self) -> float:
        """Delay of slow vibration by the change of rate [ms]."""
        return 1000 * self.native_state.delay_s

    @property
    def condition(self) -> tuple[float, float]:
        """Speed [mm/s] and force [N] of the last sample; from the thread that renders."""
        return self.native_state.condition

    @property
    def stats(self) -> NativeStatistics:
        """Counts since the last reset, in samples of the texture's own rate."""
        return self.native_state.statistics

    def counted(self) -> dict[str, int]:
        """Counts by name."""
        return self.stats.by_name()

    def reset(self, seed: int | None = None) -> None:
        """Begin again, with the same seed or another one."""
        self.seed = self.seed if seed is None else seed
        _check_uint64("seed", self.seed)
        self.native_state.reset(self.seed)

    def render_into(self, out: NDArray[np.float32], speed_mm_s: float, force_n: float) -> None:
        """Fill an array (n,) with the next acceleration [m/s²] under a constant condition, without allocation."""
        self.native_state.set_condition(speed_mm_s, force_n)
        self.native_state.render(out)

    def step(self, speed_mm_s: float, force_n: float) -> float:
        """Next acceleration [m/s²] at the output rate."""
        return float(self.render(speed_mm_s, force_n, 1)[0])

    def render(self, speed_mm_s: ArrayLike, force_n: ArrayLike, n: int | None = None) -> NDArray[np.float32]:
        """Acceleration [m/s²] at the output rate, going on from the last call, shape (n,).

        Args:
            speed_mm_s, force_n: a number each, held for n samples; or, one or both, arrays (k,) at the texture's own rate, for
                k · rate / texture_rate samples, give or take one that the next call has.
            n: how many samples of the output, for constant conditions.

        Raises:
            ValueError: a speed or force is negative, NaN or infinite; neither arrays nor n were given, or both.
        """
        speed, force = (np.asarray(value, dtype=np.float32) for value in (speed_mm_s, force_n))
        for name, value, unit in (("speed", speed, "mm/s"), ("force", force, "N")):
            if not np.isfinite(value).all() or (value < 0).any():
                wrong = f"a {name} is negative, NaN or infinite"
                raise ValueError(f"{wrong}, expected a finite number of {unit}, 0 or more")
        if speed.ndim == 0 and force.ndim == 0:
            if n is None or n < 0:
                raise ValueError(f"n is {n}, expected how many samples to render under a hand that is held")
            out = np.empty(n, dtype=np.float32)
            self.render_into(out, float(speed), float(force))
            return out
        if n is not None:
            raise ValueError("n was given beside arrays, which have their own length")
        return self.native_state.render_stroke(*np.broadcast_arrays(speed, force))


def _check_uint64(name: str, value: int) -> None:
    if not 0 <= value < 2**64:
        raise ValueError(f"{name} is {value}, expected 0 to 2⁶⁴ − 1")


def _native(texture: str | PathLike[str] | bytes | Texture | NativeTexture) -> NativeTexture:
    if isinstance(texture, NativeTexture):
        return texture
    if isinstance(texture, bytes | Texture):
        return NativeTexture(texture)
    path = Path(texture)
    data = read_whole(path)
    try:
        return NativeTexture(data)
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error
