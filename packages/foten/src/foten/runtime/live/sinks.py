"""Where a rendered vibration goes: WAV, CSV, NPZ and a picture, each written whole or not at all."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from foten.atomic_write import atomic_write
from foten.dsp import Array
from foten.dsp.distance import highest_with_power
from foten.dsp.resample import interpolate, rate_ratio

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AUDIBLE_HZ = 48_000
AUDIBLE_PEAK = 0.7  # of full scale
HEADER = "t [s],acceleration [m/s^2],speed [mm/s],force [N]"  # of a CSV; foten import reads it
SPECTROGRAM_S = 0.064  # window of the picture
SPECTROGRAM_DB = 60.0  # its range below the loudest


def write_rendered(
    path: Path, acceleration: Array, speed: Array, force: Array, rate_hz: float, about: Mapping[str, Any]
) -> None:
    """Write a rendered stroke [m/s², mm/s, N], shapes (n,), and what made it, as .wav (float32), .csv, .npz or .png."""
    check_suffix(path)
    with atomic_write(path) as part:
        match path.suffix.lower():
            case ".wav":
                part.write_bytes(float_wav(acceleration, rate_hz, about))
            case ".csv":
                rows = np.stack([np.arange(acceleration.size) / rate_hz, acceleration, speed, force], axis=1)
                np.savetxt(part, rows, "%.9g", ",", header=HEADER, comments="")
            case ".npz":
                of_stroke: dict[str, Any] = {"acceleration": acceleration, "speed": speed, "force": force}
                text = np.array(json.dumps(dict(about), sort_keys=True))
                with part.open("wb") as file:
                    np.savez_compressed(file, **of_stroke, rate_hz=np.array(rate_hz), about=text)
            case ".png":
                figure = picture(acceleration, speed, force, rate_hz, about)
                figure.savefig(part, format="png", dpi=120, metadata={"Software": None})


def check_suffix(path: Path) -> None:
    """Raise ValueError where a path's suffix is none of the known formats."""
    if path.suffix.lower() not in (".wav", ".csv", ".npz", ".png"):
        raise ValueError(f"cannot write {path.name}: expected .wav, .csv, .npz or .png")


def write_audible(path: Path, acceleration: Array, rate_hz: float) -> float:
    """Write the vibration as sound, 48 kHz and 16 bits, its peak at 0.7 of full scale; the gain [full scale per m/s²]."""
    sound = interpolate(acceleration, audible_factor(rate_hz))
    peak = float(np.abs(sound).max(initial=0.0))
    gain = AUDIBLE_PEAK / peak if peak > 0 else 1.0
    with atomic_write(path) as part:
        part.write_bytes(pcm_wav(sound * gain, AUDIBLE_HZ))
    return gain


def audible_factor(rate_hz: float) -> Fraction:
    """Ratio of 48 kHz to a rate, to 100 ppm, or raise ValueError where that is below 1 or no simple ratio."""
    if rate_hz > AUDIBLE_HZ:
        raise ValueError(f"the model's rate is {rate_hz:g} Hz, expected at most {AUDIBLE_HZ} Hz for sound")
    return rate_ratio(float(AUDIBLE_HZ), rate_hz, tolerance=1e-4)


def float_wav(samples: NDArray[np.floating], rate_hz: float, about: Mapping[str, Any]) -> bytes:
    """Mono WAV of 32-bit floats, of samples (n,); its header holds a whole rate, and its comment the exact one."""
    fact = struct.pack("<4sII", b"fact", 4, samples.size)  # which only floats need, as the size of no extension
    return _wav(3, samples.astype("<f4"), rate_hz, b"\0\0", fact, _comment(rate_hz, about))


def pcm_wav(samples: Array, rate_hz: int, about: Mapping[str, Any] | None = None) -> bytes:
    """Mono WAV of 16 bits, of samples (n,) whose full scale is 1, with a comment where there is one."""
    comment = b"" if about is None else _comment(rate_hz, about)
    return _wav(1, np.round(samples * 32767).astype("<i2"), rate_hz, b"", b"", comment)


def _wav(kind: int, samples: NDArray[Any], rate_hz: float, extension: bytes, fact: bytes, comment: bytes) -> bytes:
    rate, width, data = round(rate_hz), samples.dtype.itemsize, samples.tobytes()
    form = struct.pack("<HHIIHH", kind, 1, rate, width * rate, width, 8 * width) + extension
    head = b"WAVE" + struct.pack("<4sI", b"fmt ", len(form)) + form + fact
    body = head + struct.pack("<4sI", b"data", len(data)) + data + comment
    return b"RIFF" + struct.pack("<I", len(body)) + body


def _comment(rate_hz: float, about: Mapping[str, Any]) -> bytes:
    """Chunk behind the samples that holds, as JSON, what made them, with the unit and the exact rate."""
    text = json.dumps({"unit": "m/s^2", "rate_hz": rate_hz, **about}, sort_keys=True).encode() + b"\0"
    text += b"\0" * (len(text) % 2)
    return struct.pack("<4sI4s4sI", b"LIST", len(text) + 12, b"INFO", b"ICMT", len(text)) + text


def picture(acceleration: Array, speed: Array, force: Array, rate_hz: float, about: Mapping[str, Any]) -> Figure:
    """Figure of a rendered stroke: waveform, spectrogram, speed and force on one time axis."""
    from matplotlib.figure import Figure

    t = np.arange(acceleration.size) / rate_hz
    limits = (0, t[-1] or 1)
    figure = Figure(figsize=(9, 7), layout="constrained")
    waveform, spectrum, condition = figure.subplots(3, 1)
    waveform.plot(t, acceleration, lw=0.5, color="#0072B2")
    waveform.set(ylabel="acceleration [m/s²]", title=f"{about.get('texture') or 'texture'}, rendered", xlim=limits)
    highest = min(1000.0, rate_hz / 2)
    if acceleration.size >= 64:
        n = min(max(32, round(SPECTROGRAM_S * rate_hz)), acceleration.size // 4)
        hop = max(1, n // 8)
        # Mirrored at both ends, so that a frame lies around every sample.
        padded = np.pad(acceleration, (n // 2, n // 2 + hop), mode="reflect")
        frames = np.lib.stride_tricks.sliding_window_view(padded, n)[: acceleration.size + hop : hop]
        power = np.abs(np.fft.rfft(frames * np.hanning(n), axis=1)) ** 2
        top = float(power.max()) or 1.0
        level = 10 * np.log10(np.maximum(power / top, 10 ** (-SPECTROGRAM_DB / 10)))
        frequencies = np.arange(n // 2 + 1, dtype=np.float64) * rate_hz / n
        begin, edge = -0.5 * hop / rate_hz, 0.5 * rate_hz / n
        extent = (begin, begin + len(frames) * hop / rate_hz, -edge, frequencies[-1] + edge)
        image = spectrum.imshow(level.T, origin="lower", aspect="auto", cmap="magma", extent=extent)
        figure.colorbar(image, ax=spectrum, label="dB re loudest", pad=0.01)
        highest = max(highest, highest_with_power(frequencies, power.mean(axis=0), rate_hz))
    above = "" if highest == rate_hz / 2 else "\nwhere 99.9 % of the power lies"
    spectrum.set(ylabel=f"frequency [Hz]{above}", ylim=(0, highest), xlim=limits)
    condition.plot(t, speed, color="#009E73")
    condition.set(ylabel="speed [mm/s]", xlabel="time [s]", xlim=limits, ylim=(0, 1.05 * float(speed.max()) or 1))
    condition.yaxis.label.set_color("#009E73")
    press = condition.twinx()
    press.plot(t, force, color="#D55E00")
    press.set(ylabel="force [N]", ylim=(0, 1.15 * float(force.max()) or 1))
    press.yaxis.label.set_color("#D55E00")
    return figure
