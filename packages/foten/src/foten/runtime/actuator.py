"""Actuator profiles: the drive that moves a stylus as rendered, and their identification from a sweep."""

import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from foten.atomic_write import write_json
from foten.dsp import Array
from foten.runtime.binding import NativeActuator
from foten.untrusted import read_profile_json

FORMAT, VERSION = "foten-actuator", 1
MAX_FIGURE = 1e9  # of any unit: no actuator has more
_NEAR_S = 0.02  # search range around the delay of the largest cross-correlation
_MAX_RESIDUAL = 0.15  # share of the acceleration's power, above which it is no answer to the sweep


@dataclass(frozen=True)
class ActuatorProfile:
    """Voice coil on its stylus: acceleration / drive = gain s² / (s² + 2 ζ ω s + ω²).

    Source: McMahan & Kuchenbecker, Haptics Symposium 2014, for the principle; the model is a mass on a spring in a housing.
    """

    name: str = ""
    resonance_hz: float = 0.0  # ω/2π; 0 for none: the drive is acceleration over gain
    damping: float = 0.25  # ζ
    gain: float = 1.0  # far above the resonance [m/s² for one unit of drive]; negative where the wires are turned round
    unit: str = "V"  # of the drive: V, A, or full scale of a sound card
    limit: float = 0.0  # of the drive; 0 for none. From 0.8 of it on the drive bends
    lowest_hz: float = 20.0  # of the high-pass that keeps the drive finite below the resonance
    delay_ms: float = 0.0  # of the amplifier and its interface, as measured; not compensated

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if name in ("name", "unit"):
                continue
            # True for integers of any number of digits, false for NaN.
            if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < MAX_FIGURE:
                raise ValueError(f"{name} of the actuator is {value!r:.30}, expected a number below {MAX_FIGURE:g}")
            if name != "gain" and value < 0:
                raise ValueError(f"{name} of the actuator is {value}, expected 0 or more")
        if self.gain == 0:
            raise ValueError("gain of the actuator is 0, expected m/s² for one unit of drive")
        if not isinstance(self.name, str) or not isinstance(self.unit, str):
            raise ValueError("name and unit of the actuator are text")

    def acceleration(self, hertz: float) -> float:
        """Amplitude [m/s²] of a steady tone for one unit of drive."""
        if not self.resonance_hz:
            return abs(self.gain)
        ratio = self.resonance_hz / hertz
        return abs(self.gain / complex(1 - ratio * ratio, -2 * self.damping * ratio))

    def native(self) -> NativeActuator:
        """The kernel's structure of these figures."""
        return NativeActuator(self.resonance_hz, self.damping, self.gain, self.lowest_hz, self.limit)


def write_profile(profile: ActuatorProfile, path: Path) -> None:
    """Write a profile as JSON, whole or not at all."""
    write_json(path, {"format": FORMAT, "version": VERSION, **asdict(profile)})


def read_profile(path: Path) -> ActuatorProfile:
    """Read the profile in a file, or raise ValueError where it is none, or a figure cannot be."""
    content = read_profile_json(path, FORMAT, VERSION, "an actuator's profile")
    known = sorted(field.name for field in fields(ActuatorProfile))
    if unknown := sorted(content.keys() - known):
        raise ValueError(f"{path.name} has {unknown[0]!r}, expected some of {', '.join(known)}")
    try:
        return ActuatorProfile(**content)
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error


def sweep(
    seconds: float, rate_hz: float, low_hz: float = 20.0, high_hz: float = 500.0, amplitude: float = 1.0
) -> Array:
    """Exponential sine sweep, shape (seconds · rate_hz,), to drive an actuator for `identify`; it fades in and out."""
    if not 0 < seconds < math.inf or not 0 < rate_hz < math.inf:
        raise ValueError(f"the sweep lasts {seconds} s at {rate_hz} Hz, expected positive numbers")
    if not 0 < low_hz < high_hz < rate_hz / 2:
        band = f"{low_hz:g} to {high_hz:g} Hz"
        raise ValueError(f"the sweep runs from {band}, expected to lie between 0 and {rate_hz / 2:g} Hz")
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    slope = math.log(high_hz / low_hz) / seconds
    out = amplitude * np.sin(2 * np.pi * low_hz / slope * np.expm1(slope * t))
    n = min(out.size // 2, round(0.05 * rate_hz))
    fade = 0.5 - 0.5 * np.cos(np.pi * np.arange(n) / n)
    out[:n] *= fade
    out[-n:] *= 1 - fade
    return np.asarray(out)


def identify(
    drive: Array,
    acceleration: Array,
    rate_hz: float,
    low_hz: float = 25.0,
    high_hz: float = 400.0,
    name: str = "",
    unit: str = "V",
    limit: float = 0.0,
) -> tuple[ActuatorProfile, float]:
    """Profile of least squared error over the band of a measured sweep, and the residual share of the acceleration's power.

    A share above a few hundredths says that the actuator is not such a resonator, or was driven too hard.

    Args:
        drive, acceleration: what was played, and the stylus's [m/s²], shape (n,); one may begin before the other.
        low_hz, high_hz: band of the sweep.
        name, unit, limit: of the profile; the limit is what amplifier and coil bear.

    Raises:
        ValueError: the arrays cannot be a measurement, or the acceleration is not the answer to that drive.
    """
    drive, acceleration = (np.asarray(signal, dtype=np.float64) for signal in (drive, acceleration))
    if drive.shape != acceleration.shape or drive.ndim != 1 or drive.size < 64:
        shapes = f"drive has shape {drive.shape} and acceleration {acceleration.shape}"
        raise ValueError(f"{shapes}, expected (n,) both, 64 samples or more")
    if not np.isfinite([drive, acceleration]).all():
        raise ValueError("the drive or the acceleration holds NaN or infinity; were samples lost?")
    n = 2 * drive.size  # room for what rings on behind the end
    x, y = np.fft.rfft(drive, n), np.fft.rfft(acceleration, n)
    hertz = np.fft.rfftfreq(n, 1 / rate_hz)
    used = (hertz >= low_hz) & (hertz <= high_hz)
    if not used.any() or not np.abs(x[used]).max() > 0 or not np.abs(y[used]).max() > 0:
        raise ValueError(f"nothing was driven or measured from {low_hz:g} to {high_hz:g} Hz; is the recording silent?")
    lag = int(np.abs(np.fft.irfft(np.where(used, y * np.conj(x), 0.0), n)).argmax())
    near = (lag if lag < n // 2 else lag - n) / rate_hz
    x, y, s = x[used], y[used], np.asarray(2j * np.pi * hertz[used], dtype=np.complex128)
    # Coarse, then fine.
    delays = near + np.arange(-_NEAR_S, _NEAR_S, 0.25 / high_hz)
    for _ in range(4):
        tried = [_resonator(x * np.exp(-s * delay), y, s) for delay in delays]
        best = int(np.argmin([residual for _, residual in tried]))
        (gain, w, damping), residual = tried[best]
        delay = float(delays[best])
        delays = delay + (delays[1] - delays[0]) / 4 * np.arange(-4, 5)
    if residual > _MAX_RESIDUAL:
        explained = f"no resonator explains more than {100 * (1 - residual):.0f} % of what was recorded"
        raise ValueError(f"{explained}, expected the drive's answer above the noise; are both at the same rate?")
    delay_ms = max(0.0, 1000 * delay)
    return ActuatorProfile(name, w / (2 * np.pi), damping, gain, unit, limit, delay_ms=delay_ms), residual


def _resonator(
    x: NDArray[np.complex128], y: NDArray[np.complex128], s: NDArray[np.complex128]
) -> tuple[tuple[float, float, float], float]:
    """Gain, ω and ζ of y = gain s² x / (s² + 2 ζ ω s + ω²), and the share of y's power that is residual.

    Linear least squares of y·(s² + a s + b) = gain s² x, weighted by the denominator of the fit before (Sanathanan & Koerner,
    IEEE Trans. AC 8, 1963).
    """
    scale = float(np.abs(s).mean())
    s = s / scale
    columns = np.stack([s * s * x, -s * y, -y, s * s * y], axis=1)
    weight = np.ones(s.size)
    for _ in range(12):
        weighted = columns * weight[:, None]
        weighted = np.concatenate([weighted.real, weighted.imag])
        gain, a, b = np.linalg.lstsq(weighted[:, :3], weighted[:, 3], rcond=None)[0]
        b, a = max(b, 1e-12), max(a, 1e-9)
        weight = 1 / np.abs(s * s + a * s + b)
    residual = np.linalg.norm(y - gain * s * s * x / (s * s + a * s + b)) ** 2 / np.linalg.norm(y) ** 2
    w = math.sqrt(b)
    return (float(gain), w * scale, float(a / (2 * w))), float(residual)
