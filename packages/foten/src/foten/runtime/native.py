"""The kernel in C, as C, C++ and Unity programs load it: textures and streaming states. See `native/include/foten.h`."""

from __future__ import annotations

import ctypes
import math
import weakref
from collections.abc import Callable
from ctypes import byref, c_float, c_void_p
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from foten.models.texture_file import Texture
from foten.runtime import binding
from foten.runtime.binding import NativeActuator, NativeStatistics, library

PredictionPart = Literal["model", "linear"]


@dataclass(frozen=True)
class NativeInfo:
    """Entries of a texture file's card that rendering uses."""

    model: str
    texture: str
    rate_hz: float  # its own
    window: int  # samples of history of a prediction
    has_excitation: bool
    trained_speed: tuple[float, float]  # lowest and highest recorded [mm/s]
    trained_force: tuple[float, float]  # lowest and highest recorded [N]
    acceleration_sd: float  # of the recording [m/s²]
    lowpass_hz: float  # of the recording's speed and force
    state_bytes: int  # of a state at the texture's own rate
    asks_predictor: bool  # whether ONNX Runtime makes each sample


class NativeTexture:
    """Texture file loaded by the kernel, for any number of states; ValueError says what is wrong in it, and in which file."""

    def __init__(self, texture: bytes | Texture) -> None:
        data, file = (texture, "") if isinstance(texture, bytes) else (texture.to_bytes(), texture.file)
        self.pointer, why = c_void_p(), ctypes.create_string_buffer(512)
        ends = byref(self.pointer), why, len(why)
        self._failed: list[BaseException] = []
        status = library().foten_model_load(data, len(data), *ends)
        if status == binding.NO_PREDICTOR:
            self._callback = _onnx_callback(data, self._failed)  # which has to live as long as the texture
            status = library().foten_model_load_with(data, len(data), self._callback, None, *ends)
            self.raise_failed()
        if status != 0:
            message = f"{file}: {why.value.decode(errors='replace')}".removeprefix(": ")
            raise (MemoryError if status == binding.NO_MEMORY else ValueError)(message)
        info = library().foten_model_info(self.pointer)
        fields = {name: getattr(info, name) for name, *_ in binding.Info._fields_}
        fields |= {name: fields[name].decode(errors="replace") for name in ("model", "texture")}
        fields |= {name: tuple(fields[name]) for name in ("trained_speed", "trained_force")}
        fields |= {name: bool(fields[name]) for name in ("has_excitation", "asks_predictor")}
        self.info = NativeInfo(**fields)
        freed_with(self, library().foten_model_free, self.pointer)

    def raise_failed(self) -> None:
        """Raise an interrupt, or an error of ONNX Runtime, that came while the kernel asked for a sample."""
        if self._failed:
            raise self._failed.pop()


class NativeState:
    """One contact with a texture, for one thread at a time; its calls release the interpreter's lock.

    The options are those of `Renderer`; the rate is from a twentieth of the texture's to 400 times it.
    """

    def __init__(
        self,
        texture: NativeTexture,
        rate_hz: float | None = None,
        seed: int = 0,
        stream: int = 0,
        excitation: bool = True,
        smooth: bool = False,
    ) -> None:
        base_hz = texture.info.rate_hz
        rate = base_hz if rate_hz is None else rate_hz
        low, high = base_hz / 20, 400 * base_hz
        if not low <= rate <= high:
            raise ValueError(f"the rate is {rate_hz} Hz, expected {low:g} to {high:g} Hz for this texture")
        options = binding.Options(rate, seed, stream, not excitation, smooth)
        self._texture = texture  # which has to live as long as the state
        self.pointer = c_void_p(library().foten_state_new(texture.pointer, byref(options)))
        if not self.pointer:
            raise MemoryError("no memory for another hand on the texture")
        freed_with(self, library().foten_state_free, self.pointer)

    @property
    def delay_s(self) -> float:
        """Delay of slow vibration by the change of rate [s]."""
        return float(library().foten_delay_s(self.pointer))

    @property
    def condition(self) -> tuple[float, float]:
        """Speed [mm/s] and force [N] of the last sample; from the rendering thread."""
        speed, force = c_float(), c_float()
        library().foten_condition(self.pointer, byref(speed), byref(force))
        return speed.value, force.value

    @property
    def statistics(self) -> NativeStatistics:
        """Counts since the last reset."""
        return library().foten_statistics(self.pointer)

    def set_actuator(self, actuator: NativeActuator | None) -> None:
        """Render what drives an actuator from now on, or acceleration again; ValueError for figures or a rate that cannot be."""
        if library().foten_set_actuator(self.pointer, None if actuator is None else byref(actuator)) != 0:
            why = "the actuator's figures cannot be, or the output rate is below 4000 Hz or 16 times its resonance"
            raise ValueError(f"{why}; render at 8000 Hz?")

    def reset(self, seed: int) -> None:
        """Begin again with a seed, as if the first condition had been there for long."""
        library().foten_reset(self.pointer, seed)

    def start(self, *window: NDArray[np.floating]) -> None:
        """Go on from a recorded window: acceleration, speed and force [m/s², mm/s, N], each of shape (window,)."""
        n = self._texture.info.window
        columns = [np.ascontiguousarray(column, dtype=np.float32) for column in window]
        if any(column.shape != (n,) for column in columns):
            raise ValueError(f"the window has shapes {[column.shape for column in columns]}, expected ({n},) each")
        if library().foten_start(self.pointer, *(column.ctypes for column in columns)) != 0:
            raise ValueError("the window to start from holds NaN or infinity")

    def exclude(self, first: int, end: int) -> None:
        """Play no recorded moment from `first` to before `end`, until the next reset."""
        library().foten_exclude_recorded(self.pointer, first, end)

    def predict(self, samples: NDArray[np.float64], part: PredictionPart, out: NDArray[np.float64]) -> None:
        """Predict recorded samples (n, 3) one step ahead, filling `out` (n − window, 4): see `predict_blocks`."""
        which = get_args(PredictionPart).index(part)
        status = library().foten_predict(self.pointer, samples.ctypes, len(samples), which, out.ctypes)
        self._texture.raise_failed()
        if status != 0:
            raise ValueError("the samples hold NaN or infinity, or are fewer than a window")

    def set_condition(self, speed: float, force: float) -> None:
        """Set the condition [mm/s, N] from any thread: a negative one is 0, one that is not finite left out; both count."""
        library().foten_set_condition(self.pointer, speed, force)

    def render(self, out: NDArray[np.float32], stylus: c_void_p | None = None) -> None:
        """Fill an array with acceleration [m/s²] at the state's rate, under the condition last set, or the kernel's stylus."""
        if out.dtype != np.float32 or not out.flags.c_contiguous or not out.flags.writeable:
            raise ValueError(f"the array is {out.dtype}, expected float32 without gaps, to be written to")
        if stylus is None:
            library().foten_render(self.pointer, out.ctypes, out.size)
        else:
            library().foten_render_stylus(self.pointer, stylus, out.ctypes, out.size)
        self._texture.raise_failed()

    def render_stroke(self, speed: NDArray[np.floating], force: NDArray[np.floating]) -> NDArray[np.float32]:
        """Acceleration [m/s²] at the state's rate for a stroke at the texture's own rate [mm/s, N], shapes (n,)."""
        speed, force = (np.ascontiguousarray(channel, dtype=np.float32) for channel in (speed, force))
        if speed.shape != force.shape or speed.ndim != 1:
            raise ValueError(f"speed has shape {speed.shape} and force {force.shape}, expected (n,) both")
        out = np.empty(library().foten_rendered(self.pointer, speed.size), dtype=np.float32)
        n = library().foten_render_stroke(self.pointer, speed.ctypes, force.ctypes, speed.size, out.ctypes)
        self._texture.raise_failed()
        return out[:n]


def freed_with(owner: object, free: Callable[[c_void_p], None], pointer: c_void_p) -> None:
    """Free a kernel's object with its owner, but not as the interpreter ends: a thread may be rendering still."""
    weakref.finalize(owner, free, pointer).atexit = False


def _onnx_callback(data: bytes, failed: list[BaseException]) -> ctypes._FuncPointer:
    """Function that gives the kernel the sample after a window, for a model that it has no code for.

    An exception cannot pass through the kernel: it is kept for the kernel's caller. So is Ctrl-C, which Python delivers here.
    """
    from foten.models.texture_file import texture_from_bytes
    from foten.runtime.onnx_predictor import OnnxPredictor

    texture = texture_from_bytes(data)
    predictor = OnnxPredictor(texture.sizes, texture.tensors)
    shape = (1, predictor.window, binding.PREDICTOR_INPUTS)

    def answer(_: int | None, window: ctypes._Pointer[c_float]) -> float:
        if failed:
            return math.nan
        try:
            return predictor.next_sample(np.ctypeslib.as_array(window, shape))
        except BaseException as error:  # ctypes would print and drop it
            failed.append(error)
            return math.nan

    return binding.PREDICTOR(answer)
