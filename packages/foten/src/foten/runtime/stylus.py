"""Pen events to conditions: positions and pressures at a tablet's irregular times, to speed and force."""

import threading
from ctypes import byref, c_float, c_void_p
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.runtime.binding import NativeStylusStatistics, StylusOptions, library
from foten.runtime.native import freed_with
from foten.runtime.renderer import Renderer

_FLAT = 1e-300  # steepness of a constant force: for 0 the kernel takes the paper's


@dataclass(frozen=True)
class PressureCalibration:
    """A stylus's normalised pressure to force, F = a·exp(b·p); no force where the stylus does not touch (p = 0).

    Source: Eq. 12, for one tablet; refit it for another (`fit_pressure`).
    Differs from the paper: p = 0 gives 0 N and not 0.13 N, since lifting off must be silent.
    """

    a: float = 0.13  # N
    b: float = 3.32

    def __post_init__(self) -> None:
        if not 0 < self.a < 1e6 or not abs(self.b) < 100:
            raise ValueError(f"the pressure's curve is {self.a} N · exp({self.b} p), which no tablet has")

    def force(self, pressure: Array) -> Array:
        """Force [N] of pressures in 0 … 1, any shape."""
        return np.where(pressure > 0, self.a * np.exp(self.b * pressure), 0.0)


def fit_pressure(pressure: Array, force: Array) -> PressureCalibration:
    """Fit the curve of least mean square error of force to pairs measured on a scale; it needs SciPy, of the extra `data`.

    Args:
        pressure, force: 0 … 1 and [N], shape (n,); pairs without pressure are left out. ValueError for fewer than three pairs, no
            spread of pressure, or a number that cannot be.
    """
    from scipy.optimize import curve_fit

    pressure, force = (np.asarray(values, dtype=np.float64) for values in (pressure, force))
    if pressure.shape != force.shape or pressure.ndim != 1:
        raise ValueError(f"pressure has shape {pressure.shape} and force {force.shape}, expected (n,) both")
    if not (np.isfinite(pressure).all() and np.isfinite(force).all()):
        raise ValueError("a pressure or a force is NaN or infinite")
    if (pressure < 0).any() or (pressure > 1).any() or (force < 0).any():
        raise ValueError("expected pressures from 0 to 1 and forces in N, none negative")
    used = (pressure > 0) & (force > 0)
    p, f = pressure[used], force[used]
    if p.size < 3 or np.ptp(p) < 0.1:
        pairs = f"{p.size} pairs over {np.ptp(p) if p.size else 0:.2g} of pressure"
        raise ValueError(f"{pairs}, expected three or more, over 0.1 or more")
    start = np.polyfit(p, np.log(f), 1)  # fits logarithms, which overrates light forces
    (b, log_a), _ = curve_fit(lambda p, b, log_a: np.exp(b * p + log_a), p, f, start, ftol=1e-12, xtol=1e-12)
    return PressureCalibration(float(np.exp(log_a)), float(b))


class Stylus:
    """Pen on a texture: events from one thread, rendered from another.

        stylus = Stylus(renderer)
        stylus.push(x_mm, y_mm, pressure, t_s)   # as they come from the tablet
        block = stylus.render(480)

    An event counts from the next block on: render in blocks of 20 ms or less. Positions in whole pixels make an audible grain.
    Events that are not finite, late, doubled, out of order or a jump are counted (`stats`) and left out. Beside the 20 Hz
    low-pass speed is 2 to 5 ms late and force 3 to 10 ms, at 240 to 60 events a second that arrive at once.
    """

    def __init__(self, renderer: Renderer, calibration: PressureCalibration | None = None) -> None:
        curve = calibration or PressureCalibration()
        options = StylusOptions(curve.a, curve.b or _FLAT)
        self._pointer = c_void_p(library().foten_stylus_new(renderer.native_texture.pointer, byref(options)))
        if not self._pointer:
            raise MemoryError("no memory for a stylus")
        self._renderer = renderer
        self._pushing = threading.Lock()
        freed_with(self, library().foten_stylus_free, self._pointer)

    def push(self, x_mm: float, y_mm: float, pressure: float, t_s: float) -> None:
        """Take in an event: position [mm], pressure 0 … 1 (0 is lifted), the device's time [s]; from any thread."""
        with self._pushing:  # the kernel's queue takes one thread at a time
            library().foten_stylus_push(self._pointer, x_mm, y_mm, pressure, t_s)

    def next_condition(self) -> tuple[float, float]:
        """Speed [mm/s] and force [N] of the next sample of the texture's own rate."""
        speed, force = c_float(), c_float()
        library().foten_stylus_next(self._pointer, byref(speed), byref(force))
        return speed.value, force.value

    def render_into(self, out: NDArray[np.float32]) -> None:
        """Fill an array (n,) with the next samples [m/s², or an actuator's drive] at the output rate, without allocation."""
        self._renderer.native_state.render(out, self._pointer)

    def render(self, n: int) -> NDArray[np.float32]:
        """Render n samples [m/s², or an actuator's drive] at the output rate."""
        out = np.empty(n, dtype=np.float32)
        self.render_into(out)
        return out

    @property
    def stats(self) -> NativeStylusStatistics:
        """Counts of events."""
        return library().foten_stylus_statistics(self._pointer)
