"""The kernel in C, bound with ctypes: the very library that a C, C++ or Unity program loads. See `native/include/foten.h`."""

from __future__ import annotations

import ctypes
import threading
import weakref
from collections.abc import Callable
from ctypes import byref, c_float, c_void_p
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from foten.runtime.binding import (
    DOUBLES,
    FLOATS,
    NO_MEMORY,
    NO_PREDICTOR,
    PREDICTOR,
    NativeActuator,
    NativeStatistics,
    NativeStylusStatistics,
    Options,
    StylusOptions,
    library,
)

PredictionPart = Literal["model", "linear", "rendering"]
_PARTS = get_args(PredictionPart)


@dataclass(frozen=True)
class NativeInfo:
    """What a texture file says of itself.

    Attributes:
        model, texture: names.
        rate_hz: its own.
        window: samples that a prediction is given.
        has_excitation: whether it has a random part.
        trained_speed, trained_force: lowest and highest that it was recorded at [mm/s, N].
        acceleration_sd: of the recording [m/s²].
        lowpass_hz: that the speed and force of the recording went through.
        state_bytes: of a state at the texture's own rate.
        hop: samples that ONNX Runtime is asked for at once; 0 where the kernel runs the model itself.
    """

    model: str
    texture: str
    rate_hz: float
    window: int
    has_excitation: bool
    trained_speed: tuple[float, float]
    trained_force: tuple[float, float]
    acceleration_sd: float
    lowpass_hz: float
    state_bytes: int
    hop: int


class NativeTexture:
    """A texture file made ready for the kernel; any number of states may share it.

    Args:
        data: the file's bytes.

    Raises:
        ValueError: the file is not as it is to be; the message says in what.
        MemoryError: there is none.
    """

    def __init__(self, data: bytes) -> None:
        pointer, why = c_void_p(), ctypes.create_string_buffer(512)
        status = library().foten_model_load(data, len(data), byref(pointer), why, len(why))
        self._failed: list[BaseException] = []
        self._asked: ctypes._FuncPointer | None = None
        if status == NO_PREDICTOR:
            self._asked = _asked(data, self._failed)  # as long as the texture is
            status = library().foten_model_load_with(data, len(data), self._asked, None, byref(pointer), why, len(why))
            self.raise_failed()
        if status == NO_MEMORY:
            raise MemoryError(why.value.decode(errors="replace"))
        if status != 0:
            raise ValueError(why.value.decode(errors="replace"))
        self.pointer = pointer
        info = library().foten_model_info(pointer)
        # Copied: the texts live as long as the texture does.
        self.info = NativeInfo(
            info.model.decode(errors="replace"),
            info.texture.decode(errors="replace"),
            info.rate_hz,
            info.window,
            bool(info.has_excitation),
            tuple(info.trained_speed),
            tuple(info.trained_force),
            info.acceleration_sd,
            info.lowpass_hz,
            info.state_bytes,
            info.hop,
        )
        _freed_with(self, library().foten_model_free, pointer)

    @property
    def asks(self) -> bool:
        """Return whether the kernel asks ONNX Runtime for samples."""
        return self._asked is not None

    def raise_failed(self) -> None:
        """Raise what went wrong while the kernel asked Python for a sample: an interrupt, or an error of the runtime."""
        if self._failed:
            raise self._failed.pop()


class NativeState:
    """One hand on a texture. Its calls release the interpreter's lock; each state belongs to one thread at a time.

    Args:
        texture: what is touched.
        rate_hz: of what is rendered; None for the texture's own.
        seed, stream: of the noise, 0 … 2⁶⁴ − 1.
        excitation: False leaves the random part out.
        smooth: puts the hand that is set through the low-pass that the recording's went through.

    Raises:
        ValueError: the rate is not from a twentieth of the texture's to 400 times it.
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
        own = texture.info.rate_hz
        rate = own if rate_hz is None else rate_hz
        if not own / 20 <= rate <= 400 * own:
            raise ValueError(f"the rate is {rate_hz} Hz, expected {own / 20:g} to {400 * own:g} Hz for this texture")
        options = Options(rate, seed, stream, not excitation, smooth)
        pointer = library().foten_state_new(texture.pointer, byref(options))
        if not pointer:
            raise MemoryError("no memory for another hand on the texture")
        self._texture = texture  # the state needs it as long as it lives
        self._pointer = c_void_p(pointer)
        self._hands = np.empty((2, 0), dtype=np.float32)
        _freed_with(self, library().foten_state_free, self._pointer)

    @property
    def delay_s(self) -> float:
        """Return by how much the change of rate delays slow vibration [s]."""
        return float(library().foten_delay_s(self._pointer))

    @property
    def statistics(self) -> NativeStatistics:
        """Return what was counted since the last reset."""
        counts: NativeStatistics = library().foten_statistics(self._pointer)
        return counts

    def set_actuator(self, actuator: NativeActuator | None) -> None:
        """Render what drives an actuator from now on, or acceleration again.

        Raises:
            ValueError: the rate is less than 4000 Hz or 16 times the resonance, or a figure cannot be.
        """
        if library().foten_set_actuator(self._pointer, None if actuator is None else byref(actuator)) != 0:
            raise ValueError(
                "the actuator's figures cannot be, or the output rate is below 4000 Hz or 16 times its resonance; "
                "render at 8000 Hz?"
            )

    def reset(self, seed: int) -> None:
        """Begin again with a seed, as if the first hand had been there for long."""
        library().foten_reset(self._pointer, seed)

    def start(
        self, acceleration: NDArray[np.floating], speed: NDArray[np.floating], force: NDArray[np.floating]
    ) -> None:
        """Go on from a recorded window [m/s², mm/s, N], each of shape (window,).

        Raises:
            ValueError: a shape is another, or a number is not finite.
        """
        n = self._texture.info.window
        columns = [np.ascontiguousarray(column, dtype=np.float32) for column in (acceleration, speed, force)]
        if any(column.shape != (n,) for column in columns):
            raise ValueError(f"the window has shapes {[column.shape for column in columns]}, expected ({n},) each")
        if library().foten_start(self._pointer, *(column.ctypes.data_as(FLOATS) for column in columns)) != 0:
            raise ValueError("the window to start from holds NaN or infinity")

    def run_scaled(
        self,
        window: NDArray[np.float64],
        condition: NDArray[np.float64],
        noise: NDArray[np.float64] | None,
        limit: float,
        out: NDArray[np.float64],
    ) -> None:
        """Go on from a scaled window (window, 3) under scaled hands (n, 3), filling `out` (n,): see `run_loops`."""
        window_, hands, filled = (array.ctypes.data_as(DOUBLES) for array in (window, condition, out))
        if library().foten_start_scaled(self._pointer, window_) != 0:
            raise ValueError("the windows to start from hold NaN or infinity")
        drawn = None if noise is None else noise.ctypes.data_as(DOUBLES)
        library().foten_run_scaled(self._pointer, hands, drawn, limit, len(out), filled)
        self._texture.raise_failed()

    def predict(self, samples: NDArray[np.float64], part: PredictionPart, out: NDArray[np.float64]) -> None:
        """Predict recorded samples (n, 3) one step ahead, filling `out` (n − window, 3): see `predict_blocks`."""
        given, filled = (array.ctypes.data_as(DOUBLES) for array in (samples, out))
        status = library().foten_predict(self._pointer, given, len(samples), _PARTS.index(part), filled)
        self._texture.raise_failed()
        if status != 0:
            raise ValueError("the samples hold NaN or infinity, or are fewer than a window")

    def set_hand(self, speed: float, force: float) -> None:
        """Tell where the hand is [mm/s, N], from any thread; what is negative is 0, what is not finite left out; both count."""
        library().foten_set_condition(self._pointer, speed, force)

    def render(self, out: NDArray[np.float32]) -> None:
        """Fill an array with acceleration [m/s²] at the state's rate, under the hand that was last set."""
        library().foten_render(self._pointer, _filled(out), out.size)
        self._texture.raise_failed()

    def render_stylus(self, stylus: NativeStylus, out: NDArray[np.float32]) -> None:
        """Fill an array with acceleration [m/s²] at the state's rate, under the hand of a stylus."""
        library().foten_render_stylus(self._pointer, stylus.pointer, _filled(out), out.size)
        self._texture.raise_failed()

    def render_stroke(self, speed: NDArray[np.floating], force: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the acceleration [m/s²] at the state's rate for a stroke at the texture's own rate [mm/s, N], shapes (n,)."""
        speed, force = (np.ascontiguousarray(channel, dtype=np.float32) for channel in (speed, force))
        if speed.shape != force.shape or speed.ndim != 1:
            raise ValueError(f"speed has shape {speed.shape} and force {force.shape}, expected (n,) both")
        out = np.empty(library().foten_rendered(self._pointer, speed.size), dtype=np.float32)
        speeds, forces, filled = (array.ctypes.data_as(FLOATS) for array in (speed, force, out))
        n = library().foten_render_stroke(self._pointer, speeds, forces, speed.size, filled)
        self._texture.raise_failed()
        return out[:n]


class NativeStylus:
    """A pen's events into the hand that a state is rendered under; pushed from any thread, rendered from another.

    Args:
        texture: whose rate and low-pass it goes by.
        newtons, steepness: a [N] and b of F = a·exp(b·p); of each 0 for the paper's.
    """

    def __init__(self, texture: NativeTexture, newtons: float, steepness: float) -> None:
        pointer = library().foten_stylus_new(texture.pointer, byref(StylusOptions(newtons, steepness)))
        if not pointer:
            raise ValueError(f"the pressure's curve is {newtons} N · exp({steepness} p), which no tablet has")
        self.pointer = c_void_p(pointer)
        self._pushing = threading.Lock()
        _freed_with(self, library().foten_stylus_free, self.pointer)

    def push(self, x_mm: float, y_mm: float, pressure: float, t_s: float) -> None:
        """Tell of an event: position [mm], pressure 0 … 1 (0 is lifted), the device's time [s]."""
        with self._pushing:  # the kernel's queue is for one thread at a time
            library().foten_stylus_push(self.pointer, x_mm, y_mm, pressure, t_s)

    def next(self) -> tuple[float, float]:
        """Return speed [mm/s] and force [N] at the next sample of the texture's own rate."""
        speed, force = c_float(), c_float()
        library().foten_stylus_next(self.pointer, byref(speed), byref(force))
        return speed.value, force.value

    @property
    def statistics(self) -> NativeStylusStatistics:
        """Return what was counted."""
        counts: NativeStylusStatistics = library().foten_stylus_statistics(self.pointer)
        return counts


def _freed_with(owner: object, free: Callable[[c_void_p], None], pointer: c_void_p) -> None:
    """Free what the kernel made when its owner goes, but not as the interpreter ends: a thread may be rendering still."""
    weakref.finalize(owner, free, pointer).atexit = False


def _asked(data: bytes, failed: list[BaseException]) -> ctypes._FuncPointer:
    """Return what the kernel asks for the samples after a window, of a file whose model it has no code for.

    An exception cannot pass through the kernel: it is put aside, the kernel is answered at once from then on, and whoever
    called it raises it. That includes Ctrl-C, which Python delivers in here.
    """
    from foten.families.texture_file import texture_from_bytes
    from foten.runtime.onnx_predictor import OnnxPredictor

    texture = texture_from_bytes(data)
    predictor = OnnxPredictor(texture.sizes, texture.tensors)
    shape = (1, predictor.window, 3)

    def answer(_: int | None, window: ctypes._Pointer[c_float], following: ctypes._Pointer[c_float], n: int) -> None:
        # Of as many as the kernel has room for, whatever this side reads in the card.
        out = np.ctypeslib.as_array(following, (n,))
        out[:] = np.nan
        if failed:
            return
        try:
            predictor.predict_into(np.ctypeslib.as_array(window, shape), out)
        except BaseException as error:  # which would be printed and lost
            failed.append(error)

    return PREDICTOR(answer)


def _filled(array: NDArray[np.float32]) -> ctypes._Pointer[c_float]:
    if array.dtype != np.float32 or not array.flags.c_contiguous or not array.flags.writeable:
        raise ValueError(f"the array is {array.dtype}, expected float32 without gaps, to be written to")
    return array.ctypes.data_as(FLOATS)
