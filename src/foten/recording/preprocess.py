"""Raw channels to a trace: synchronise, filter, one axis, whole blocks (Sec. III-c)."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from foten.dsp.dft321 import dft321
from foten.dsp.filters import Biquads, butterworth, delay_s, filter_recorded
from foten.dsp.kinematics import at_rate, tangential_speed
from foten.dsp.resample import decimate
from foten.recording.recording import Channel, Recording
from foten.recording.trace import Trace


@dataclass(frozen=True)
class PreprocessConfig:
    """How a recording becomes a trace.

    Differs from the paper: its band of 20 to 1000 Hz cannot exist at 1 kHz, where nothing above 500 Hz does; what
    remains is the high-pass. Speed and force pass one low-pass of 20 Hz in training and in rendering, where the paper
    trains with 25 and renders with 20.
    """

    rate_hz: float = 1000.0  # of the trace; Sec. III-c
    trim_ms: float = 2000.0  # discarded at both ends; Sec. III-c
    block_ms: float = 2000.0  # unit of the split, 2000 samples at 1 kHz; Sec. VI
    highpass_hz: float = 20.0  # of the acceleration: gravity and hand movement; Sec. III-c
    highpass_order: int = 2
    lowpass_hz: float = 20.0  # of speed and force in training; Sec. V-b
    render_lowpass_hz: float = 20.0  # of speed and force in rendering; Sec. V-b
    zero_phase: bool = False  # the paper's offline way; looks into the future

    def __post_init__(self) -> None:
        if not self.rate_hz > 0:
            raise ValueError(f"rate is {self.rate_hz:g} Hz, expected a positive number")
        if self.trim_ms < 0 or not self.block_ms > 0:
            raise ValueError(
                f"trim is {self.trim_ms:g} ms and block {self.block_ms:g} ms, expected ≥ 0 and > 0"
            )
        for name in ("highpass_hz", "lowpass_hz", "render_lowpass_hz"):
            if not 0 < getattr(self, name) < self.rate_hz / 2:
                raise ValueError(
                    f"{name} is {getattr(self, name):g} Hz, expected between 0 and half the rate, {self.rate_hz / 2:g} Hz"
                )
        # The filters' own check, before a long recording is read.
        butterworth("highpass", self.highpass_hz, self.rate_hz, self.highpass_order)

    @property
    def block(self) -> int:
        """Return the samples in a block."""
        return max(1, round(self.block_ms * self.rate_hz / 1000))

    @property
    def delay_ms(self) -> float:
        """Return what the causal low-pass of speed and force delays them by when rendering [ms]."""
        return 1000 * delay_s(butterworth("lowpass", self.render_lowpass_hz, self.rate_hz), self.rate_hz)


def preprocess(recording: Recording, config: PreprocessConfig | None = None) -> Trace:
    """Return the trace of a recording: whole blocks of acceleration, speed and force at one rate.

    The low-pass of speed and force is causal, as in rendering; the whole samples nearest its delay are then cut off,
    so that speed and force stand beside the acceleration that they caused. With three axes, DFT321 makes one of them
    in each block by itself.

    Raises:
        ValueError: a quantity is missing, the acceleration is slower than the rate or irregular in time, or
            the recording is too short for the trim and one block.

    Source: Sec. III-c, Sec. VI.
    """
    config = config or PreprocessConfig()
    rate = config.rate_hz
    axes = recording.axes("acceleration")
    if not axes:
        raise ValueError("the recording has no acceleration channel")
    for axis in axes:
        if axis.times_s is not None:
            raise ValueError("the acceleration was captured at irregular times, expected a steady rate")
        if axis.rate_hz < rate * (1 - 1e-9):
            raise ValueError(
                f"the acceleration was captured at {axis.rate_hz:g} Hz and {rate:g} Hz is asked for; it is never "
                f"upsampled, so use --rate {axis.rate_hz:g} or lower"
            )

    highpass = butterworth("highpass", config.highpass_hz, rate, config.highpass_order)
    lowpass = butterworth("lowpass", config.lowpass_hz, rate)
    delay = 0 if config.zero_phase else round(delay_s(lowpass, rate) * rate)
    n = math.floor(recording.duration_s * rate + 1e-6)
    trim = round(config.trim_ms * rate / 1000)
    usable = min(n - trim, n - delay) - trim
    if usable < config.block:
        raise ValueError(
            f"the recording lasts {recording.duration_s:.3g} s; a trim of {config.trim_ms:g} ms at both ends leaves "
            f"{max(0, usable) / rate:.3g} s, less than one block of {config.block_ms:g} ms; use --trim and --block"
        )

    def settled(signal: NDArray[np.float64], delayed: bool) -> NDArray[np.float64]:
        return signal[trim + delay * delayed :][: usable - usable % config.block]

    vibration = np.stack(
        [
            settled(filter_recorded(highpass, _decimated(axis, rate, n), zero_phase=config.zero_phase), False)
            for axis in axes
        ]
    )
    if len(axes) > 1:
        by_block = vibration.reshape(len(axes), -1, config.block).swapaxes(0, 1)
        acceleration = dft321(by_block).ravel()
    else:
        acceleration = vibration[0]
    speed, force = (
        settled(filter_recorded(lowpass, raw, zero_phase=config.zero_phase), True)
        for raw in (_speed(recording, rate, n), _force(recording, rate, n))
    )
    return Trace(
        acceleration=acceleration,
        speed=np.maximum(speed, 0.0),
        force=np.maximum(force, 0.0),
        rate_hz=rate,
        block=config.block,
        recording_sha256=recording.sha256(),
        preprocess=asdict(config),
        n_dropped=usable % config.block,
    )


def condition(
    speed: NDArray[np.float64], force: NDArray[np.float64], rate_hz: float, lowpass_hz: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a stroke's speed [mm/s] and force [N], shapes (n,), through the causal low-pass of rendering.

    The filter starts settled on the first sample.
    """
    sections = butterworth("lowpass", lowpass_hz, rate_hz)
    filtered = []
    for signal in (speed, force):
        biquads = Biquads(sections)
        biquads.reset(float(signal[0]) if signal.size else 0.0)
        filtered.append(np.maximum(biquads.process(signal), 0.0))
    return filtered[0], filtered[1]


def _decimated(channel: Channel, rate: float, n: int) -> NDArray[np.float64]:
    return decimate(channel.samples, channel.rate_hz, rate)[:n]


def _slow(channel: Channel, rate: float, n: int) -> NDArray[np.float64]:
    """Return a speed or force channel at the trace's rate: anti-aliased from above, interpolated from below."""
    if channel.times_s is None and channel.rate_hz >= rate:
        return _decimated(channel, rate, n)
    return at_rate(channel.samples, _times(channel), rate, n)


def _times(channel: Channel) -> NDArray[np.float64]:
    if channel.times_s is not None:
        return channel.times_s
    return np.arange(channel.samples.size) / channel.rate_hz


def _speed(recording: Recording, rate: float, n: int) -> NDArray[np.float64]:
    if "speed" in recording:
        return _slow(recording["speed"], rate, n)
    plane = [recording[f"position_{axis}"] for axis in "xy" if f"position_{axis}" in recording]
    if not plane:
        raise ValueError("the recording has no speed and no position_x, position_y channel")
    times = _times(plane[0])
    return at_rate(tangential_speed(np.stack([axis.samples for axis in plane]), times), times, rate, n)


def _force(recording: Recording, rate: float, n: int) -> NDArray[np.float64]:
    """Return the force along the surface normal, which is the z axis, pressing counted positive."""
    name = "force" if "force" in recording else "force_z"
    if name not in recording:
        raise ValueError("the recording has no force and no force_z channel")
    force = _slow(recording[name], rate, n)
    return -force if np.median(force) < 0 else force
