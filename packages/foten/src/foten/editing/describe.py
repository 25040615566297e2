"""Seven figures of a texture, measured on what the kernel renders: those that `editing.edit` sets."""

from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np

from foten.dsp import Array
from foten.dsp.distance import scored_bins
from foten.dsp.level import frame_levels
from foten.models.conditions import MOVING_FORCE, MOVING_SPEED
from foten.models.texture_file import Texture
from foten.runtime.renderer import Renderer

REFERENCE = (100.0, 0.7)  # mm/s and N, where a texture is described, or the nearest that it was learned at
SECONDS = 16.0  # rendered at the reference; half of it at each other condition
SETTLE_SECONDS = 0.5  # of a rendering, its beginning, that is not measured
RESOLUTION_HZ = 5.0  # of the spectrum
EXPONENT_RATIO = 2.0  # speed and force are varied by so much, as far as the trained range allows
MIN_RATIO = 1.2  # less variation than this gives no exponent


@dataclass(frozen=True)
class Description:
    """A texture under a steady hand at one speed and force."""

    speed_mm_s: float
    force_n: float
    level_db: float  # RMS re 1 m/s², or re 1 where the acceleration is relative
    centroid_hz: float  # mean of the power over log frequency, 20 Hz to 1 kHz
    width_octaves: float  # standard deviation of the same
    roughness_db: float  # standard deviation of the level in frames of 40 ms
    period_mm: float | None  # of the surface; None where it does not repeat
    speed_exponent: float | None  # of the level; None where the trained range is too narrow
    force_exponent: float | None

    def to_json(self) -> dict[str, float | None]:
        """Its figures by name."""
        return asdict(self)

    def figures(self, unit: str) -> dict[str, str]:
        """The same for people; `unit` of the acceleration."""

        def grows(name: str, power: float | None) -> str:
            return f"level ~ {name}^{power:.2f}" if power is not None else f"not known: learned at one {name}"

        return {
            "at": f"{self.speed_mm_s:.4g} mm/s, {self.force_n:.3g} N",
            "level": f"{self.level_db:+.1f} dB re 1 {unit}",
            "centroid": f"{self.centroid_hz:.0f} Hz",
            "width": f"{self.width_octaves:.2f} octaves",
            "roughness": f"{self.roughness_db:.2f} dB",
            "period": "none" if self.period_mm is None else f"{self.period_mm:.3g} mm",
            "speed": grows("speed", self.speed_exponent),
            "force": grows("force", self.force_exponent),
        }


@dataclass(frozen=True)
class SteadyFigures:
    """What a rendering under a steady hand measures."""

    rms: float
    centroid_hz: float
    width_octaves: float
    roughness_db: float

    @property
    def level_db(self) -> float:
        """Level [dB re 1]; that of silence is −300 dB."""
        return 20 * float(np.log10(max(self.rms, 1e-15)))


def describe(texture: Texture, seed: int = 0) -> Description:
    """The description of a texture, under the same noise for the same seed."""
    speed, force = reference(texture, "speed"), reference(texture, "force")
    steady = steady_figures(texture, seed)
    return Description(
        speed_mm_s=speed,
        force_n=force,
        level_db=steady.level_db,
        centroid_hz=steady.centroid_hz,
        width_octaves=steady.width_octaves,
        roughness_db=steady.roughness_db,
        period_mm=period_of(texture),
        speed_exponent=_exponent(texture, "speed", lambda end: (end, force), seed),
        force_exponent=_exponent(texture, "force", lambda end: (speed, end), seed),
    )


def _exponent(
    texture: Texture, channel: str, condition: Callable[[float], tuple[float, float]], seed: int
) -> float | None:
    """Power of the level over a channel, whose conditions a function gives; None where it is not known."""
    low, high = varied(texture, channel)
    if high < MIN_RATIO * low:  # learned at one: the level follows the card's power, where it has one
        return texture.extrapolation_exponent(channel) or None
    ends = (rendered(texture, *condition(end), SECONDS / 2, seed) for end in (low, high))
    soft, loud = (max(float(np.square(end).mean()), 1e-30) for end in ends)
    return 0.5 * float(np.log(loud / soft) / np.log(high / low))


def steady_figures(texture: Texture, seed: int = 0) -> SteadyFigures:
    """The figures of a texture at its reference."""
    steady = rendered(texture, reference(texture, "speed"), reference(texture, "force"), SECONDS, seed)
    rms = float(np.sqrt(np.square(steady).mean()))
    centroid_hz, width = centroid_and_width(*spectrum(steady, texture.rate_hz), texture.rate_hz)
    roughness = float(frame_levels(steady, texture.rate_hz, max(rms, 1e-15)).std())
    return SteadyFigures(rms, centroid_hz, width, roughness)


def reference(texture: Texture, channel: str) -> float:
    """The speed [mm/s] or force [N] that a texture is described at."""
    low, high = texture.trained_range(channel)
    rest = MOVING_SPEED if channel == "speed" else MOVING_FORCE
    return float(np.clip(REFERENCE[channel == "force"], max(low, rest), max(high, rest)))


def varied(texture: Texture, channel: str) -> tuple[float, float]:
    """The ends of speed [mm/s] or force [N] that an exponent is measured between."""
    low, high = texture.trained_range(channel)
    centre, root = reference(texture, channel), np.sqrt(EXPONENT_RATIO)
    least = max(low, MOVING_SPEED if channel == "speed" else MOVING_FORCE)
    first = max(least, centre / root)
    last = min(max(high, least), first * EXPONENT_RATIO)
    return max(least, min(first, last / EXPONENT_RATIO)), last


def period_of(texture: Texture) -> float | None:
    """Length after which a surface repeats [mm]; None where a texture has no tones."""
    if not texture.card["sizes"].get("n_tones"):
        return None
    return float(2 * np.pi / (texture.tensors["tones.phase_params"][0] * texture.rate_hz))


def rendered(texture: Texture, speed_mm_s: float, force_n: float, seconds: float, seed: int = 0) -> Array:
    """Acceleration [m/s²] under a steady hand, (n,), without its beginning."""
    renderer = Renderer(texture, seed=seed)
    n = round((SETTLE_SECONDS + seconds) * texture.rate_hz)
    return renderer.render(speed_mm_s, force_n, n)[round(SETTLE_SECONDS * texture.rate_hz) :].astype(np.float64)


def spectrum(signal: Array, rate_hz: float) -> tuple[Array, Array]:
    """Frequencies [Hz] and power densities (k,) of a signal (n,), to 5 Hz: Welch's mean over half overlapping Hann windows."""
    n = min(len(signal), max(64, round(rate_hz / RESOLUTION_HZ)))
    starts = np.arange(0, len(signal) - n + 1, max(1, n // 2))
    window = np.hanning(n + 1)[:-1]
    frames = signal[starts[:, None] + np.arange(n)]
    power = np.square(np.abs(np.fft.rfft((frames - frames.mean(axis=1, keepdims=True)) * window, axis=1))).mean(axis=0)
    density = power * (2 / (rate_hz * np.square(window).sum()))
    return np.asarray(np.fft.rfftfreq(n, 1 / rate_hz), dtype=np.float64), np.asarray(density)


def centroid_and_width(frequencies: Array, density: Array, rate_hz: float) -> tuple[float, float]:
    """Mean [Hz] and standard deviation [octave] of the power over log frequency, of the scored bins."""
    bins = scored_bins(frequencies, rate_hz)
    octave, power = np.log2(frequencies[bins]), density[bins] / max(float(density[bins].sum()), 1e-300)
    mean = float(octave @ power)
    return float(2**mean), float(np.sqrt(max(0.0, float(np.square(octave - mean) @ power))))
