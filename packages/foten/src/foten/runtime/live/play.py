"""A stroke over a texture, live: what `foten play` does."""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.atomic_write import atomic_write
from foten.dsp import Array
from foten.recording.preprocess import condition
from foten.runtime.actuator import ActuatorProfile
from foten.runtime.live.devices import SOUND_RATE_HZ, DaqSink, NullSink, OscSink, SoundSink, UdpSink
from foten.runtime.live.live import Live, LiveStatistics, Read, Samples, Sink
from foten.runtime.live.sinks import float_wav
from foten.runtime.renderer import Renderer
from foten.runtime.stroke import Stroke

LOUDNESS = 0.1  # of full scale, of a sound's standard deviation, where no gain is given
CIRCLES_A_SECOND = 0.5
MIN_RATE_HZ = 8000.0  # sent to a device that takes any rate: a lower one leaves images and steps that can be felt
MAX_WAV_SAMPLES = 2**30 - 1024

ConditionAt = Callable[[NDArray[np.int64]], tuple[Array, Array]]
"""Speed [mm/s] and force [N] at samples of the texture's own rate, counted from 0; shapes (n,)."""


@dataclass(frozen=True)
class Played:
    """Result of playing."""

    statistics: LiveStatistics  # of the rendering and its ring
    delays_ms: dict[str, float]  # from stroke to output, by name
    counted: dict[str, int]  # by the kernel
    n_cut: int  # samples beyond what the sink takes
    n_device_underruns: int  # times that a sound card itself missed samples
    n_late: int  # blocks that a paced sink left out after the machine stalled
    interrupted: bool  # by Ctrl-C


def circling(speeds: tuple[float, float], forces: tuple[float, float], rate_hz: float) -> ConditionAt:
    """Conditions of a circle, slower and faster, lighter and firmer, over the middle of a trained range."""

    def condition_at(at: NDArray[np.int64]) -> tuple[Array, Array]:
        # 1.618 of each other, so that speed and force do not keep step.
        turns = np.outer([CIRCLES_A_SECOND, CIRCLES_A_SECOND / 1.618], at / rate_hz)
        share = 0.5 - 0.4 * np.cos(2 * np.pi * turns)
        (slow, fast), (light, firm) = speeds, forces
        return slow + share[0] * (fast - slow), light + share[1] * (firm - light)

    return condition_at


def holding(speed: float, force: float) -> ConditionAt:
    """Conditions of one speed [mm/s] and force [N]."""
    return lambda at: (np.full(at.size, speed), np.full(at.size, force))


def along(stroke: Stroke, lowpass_hz: float) -> ConditionAt:
    """Conditions of a stroke, over and over; the low-pass of rendering rounds the step from its end to its beginning."""
    n = stroke.force.size
    speed, force = condition(np.tile(stroke.velocity, 2), np.tile(stroke.force, 2), stroke.rate_hz, lowpass_hz)

    def condition_at(at: NDArray[np.int64]) -> tuple[Array, Array]:
        i = np.where(at < n, at, n + at % n)
        return speed[i], force[i]

    return condition_at


def rendering(renderer: Renderer, condition: ConditionAt) -> Read:
    """Function that fills an array (n,) with the next samples, the same in blocks of any size."""
    state, ratio = renderer.native_state, renderer.texture_rate / renderer.rate
    waiting = np.zeros(0, dtype=np.float32)  # samples that the last array had no room for
    n = 0

    def render(out: Samples) -> None:
        nonlocal waiting, n
        while waiting.size < out.size:
            at = np.arange(n, n + math.ceil((out.size - waiting.size) * ratio))
            n += at.size
            waiting = np.concatenate([waiting, state.render_stroke(*condition(at))])
        out[:] = waiting[: out.size]
        waiting = waiting[out.size :]

    return render


def sink_of(where: str, rate_hz: float, gain: float, device: str | None = None, channel: int | None = None) -> Sink:
    """Sink that a text names: sound, null, daq:Dev1/ao0, udp:HOST:PORT or osc:HOST:PORT; ValueError where it names none.

    OSError where the device, its library or the host is missing.
    """
    if where != "sound" and (device is not None or channel is not None):
        raise ValueError(f"--device and --channel are a sound card's, and it is played to {where}")
    kind, _, target = where.partition(":")
    if where == "null":
        return NullSink(rate_hz)
    if where == "sound":
        chosen = int(device) if device is not None and device.isdecimal() else device
        return SoundSink(gain, chosen, rate_hz, channel or 1)
    if kind == "daq" and target:
        return DaqSink(target, rate_hz, gain)
    if kind in ("udp", "osc"):
        host, _, port = target.rpartition(":")
        if host and port.isdecimal() and 0 < int(port) < 65536:
            return (UdpSink if kind == "udp" else OscSink)(host, int(port), rate_hz)
    raise ValueError(f"cannot play to {where!r}, expected sound, null, daq:Dev1/ao0, udp:HOST:PORT or osc:HOST:PORT")


def write_wav(
    renderer: Renderer, condition: ConditionAt, seconds: float, path: Path, about: Mapping[str, Any]
) -> tuple[NDArray[np.float32], bool]:
    """Write a rendering as 32-bit floats with a comment, up to Ctrl-C; its samples (n,), and whether Ctrl-C ended it."""
    n, second = round(seconds * renderer.rate), round(renderer.rate)
    if n > MAX_WAV_SAMPLES:
        raise ValueError(f"{seconds:.0f} s at {renderer.rate:g} Hz are more than a WAV file holds, 4 GB; play fewer")
    render, out, interrupted = rendering(renderer, condition), np.empty(n, dtype=np.float32), False
    try:
        for start in range(0, n, second):
            render(out[start : start + second])
    except KeyboardInterrupt:
        out, interrupted = out[:start], True
    with atomic_write(path) as part:
        part.write_bytes(float_wav(out, renderer.rate, about))
    return out, interrupted


def rate_for(where: str, requested: float | None, texture_rate: float) -> float:
    """Rate to play at [Hz]: the requested one, 48 kHz for sound, else a multiple of the texture's own."""
    if requested is not None:
        return requested
    return SOUND_RATE_HZ if where == "sound" else texture_rate * max(1, math.ceil(MIN_RATE_HZ / texture_rate))


def play(
    renderer: Renderer,
    sink: Sink,
    condition: ConditionAt,
    seconds: float | None,
    lead_ms: float,
    on_start: Callable[[], None],
) -> Played:
    """Play for so many seconds, or until Ctrl-C; `on_start` is called once it plays."""
    interrupted = False
    live = Live(rendering(renderer, condition), sink, lead_ms=lead_ms)
    end = math.inf if seconds is None else time.monotonic() + seconds
    try:
        live.start()
        on_start()
        while live.running and (remaining := end - time.monotonic()) > 0:
            time.sleep(min(0.2, remaining))
    except KeyboardInterrupt:
        interrupted = True
    finally:
        live.stop()
    delays = {"rendered ahead": live.lead_ms}
    if renderer.delay_ms:
        delays["change of rate"] = renderer.delay_ms
    if isinstance(sink, SoundSink):
        delays["sound card, as it says"] = 1000 * sink.latency_s
    else:
        delays["block of the sink"] = 1000 * sink.n_at_once / sink.rate_hz
    n_cut, n_underruns, n_late = (getattr(sink, name, 0) for name in ("n_cut", "n_device_underruns", "n_late"))
    return Played(live.statistics, delays, renderer.counted(), n_cut, n_underruns, n_late, interrupted)


def gain_for(profile: ActuatorProfile | None, requested: float | None, sd: float, where: str) -> float:
    """Gain of a sink: the requested one; else 1 where the unit is the sink's (or ValueError), or a usual loudness for sound."""
    is_daq = where.startswith("daq:")
    if requested is not None:
        if where != "sound" and not is_daq:
            raise ValueError(f"--gain is for sound and daq, and {where} takes what is rendered as it is")
        return requested
    if where == "sound" and profile is None:
        return LOUDNESS / sd
    unit = "m/s²" if profile is None else profile.unit
    if where == "sound" and unit != "full scale":
        ask = f"say with --gain how much of it 1 {unit} is"
        raise ValueError(f"a sound card takes full scale, and the profile drives in {unit}: {ask}")
    if is_daq and unit != "V":
        ask = f"say with --gain how many volts 1 {unit} is, or give a profile in V with --actuator"
        raise ValueError(f"a DAQ takes volts, and what is rendered is in {unit}: {ask}")
    return 1.0
