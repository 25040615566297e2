"""Raw channels to a trace: synchronise, filter, one axis, whole blocks (Sec. III-c)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from foten.dsp import Array
from foten.dsp.dft321 import dft321
from foten.dsp.filters import Biquads, Sections, butterworth, delay_s, filter_recorded
from foten.dsp.kinematics import at_rate, speed_of, velocity
from foten.dsp.perception import RATES_HZ
from foten.dsp.resample import decimate
from foten.recording.recording import LIMITS, UNITS, Channel, Recording, common_span_s, counted
from foten.recording.split import MIN_BLOCKS
from foten.recording.trace import CHANNELS, Trace

MAX_HIGHPASS_ORDER = 20
SHORT_BLOCKS_MS = (2000.0, 1000.0, 500.0, 200.0, 100.0)  # of a recording too short for the defaults
SHORTEST_MS = 200.0  # block that holds enough windows of foten-plus at 1 kHz
BLOCKS_OF_TAKE = 6  # of the shortest take: what is left over at its end is a twelfth of it on the mean
ENOUGH_BLOCKS = 9  # of a split: two validate and two test
JUDGED_BLOCKS = 23  # of a split: five test, from which intervals are drawn
MIN_ALONE_S = 4.0  # of a recording by itself, that blocks are chosen for unasked
MAX_TRIMMED = 0.1  # share of a recording that may be trimmed unasked
ENOUGH_SAMPLES = 5000  # to train on, by our choice; below it a higher rate is suggested
WRONG_SIGN = (5.0, 0.5)  # mm/s, N; what noise takes a magnitude below zero at most


@dataclass(frozen=True)
class PreprocessConfig:
    """How a recording becomes a trace.

    Differs from the paper: its band of 20 to 1000 Hz cannot exist at 1 kHz; what remains is the high-pass. Speed and force pass
    one low-pass of 20 Hz in training and rendering, where the paper has 25 and 20 Hz, as has the recipe `paper`.
    """

    rate_hz: float = 1000.0  # of the trace; Sec. III-c
    trim_ms: float = 2000.0  # discarded at both ends; Sec. III-c
    block_ms: float = 2000.0  # unit of the split, 2000 samples at 1 kHz; Sec. VI
    highpass_hz: float = 20.0  # of the acceleration: gravity and hand movement; Sec. III-c
    highpass_order: int = 2
    lowpass_hz: float = 20.0  # of speed and force in training; Sec. V-b
    render_lowpass_hz: float = 20.0  # of speed and force in rendering; Sec. V-b
    dft321_ms: float = 64.0  # windows in which three axes become one; 0: each block at once, which leaves seams
    zero_phase: bool = False  # forwards and backwards; looks into the future
    force_units: bool = False  # take values beyond `LIMITS`

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not isinstance(value, bool) and not (type(value) in (int, float) and math.isfinite(value)):
                raise ValueError(f"{name} is {value!r}, expected a finite number")
        if not self.rate_hz > 0:
            raise ValueError(f"rate is {self.rate_hz:g} Hz, expected a positive number")
        if self.trim_ms < 0 or not self.block_ms > 0:
            raise ValueError(f"trim is {self.trim_ms:g} ms and block {self.block_ms:g} ms, expected ≥ 0 and > 0")
        if self.dft321_ms and not self.dft321_ms * self.rate_hz >= 2000:
            raise ValueError(
                f"dft321_ms is {self.dft321_ms:g}, expected 0 or two samples and more, {2000 / self.rate_hz:g} ms"
            )
        half = self.rate_hz / 2
        for name in ("highpass_hz", "lowpass_hz", "render_lowpass_hz"):
            cutoff = getattr(self, name)
            if not 0 < cutoff < half:
                raise ValueError(f"{name} is {cutoff:g} Hz, expected between 0 and half the rate, {half:g} Hz")
        if self.highpass_order > MAX_HIGHPASS_ORDER:
            raise ValueError(f"highpass_order is {self.highpass_order}, expected {MAX_HIGHPASS_ORDER} at most")
        # The filters' own check, before a long recording is read.
        butterworth("highpass", self.highpass_hz, self.rate_hz, self.highpass_order)

    @classmethod
    def of_card(cls, settings: Mapping[str, Any]) -> PreprocessConfig:
        """Configuration of a texture's card; before `dft321_ms` was written down, all of a block was transformed at once."""
        return cls(**{"dft321_ms": 0.0, **settings})

    @property
    def block(self) -> int:
        """Samples in a block."""
        return max(1, round(self.block_ms * self.rate_hz / 1000))

    @property
    def shortest_s(self) -> float:
        """Time that every channel has to cover for a training [s]."""
        return (2 * self.trim_ms + MIN_BLOCKS * self.block_ms) / 1000

    @property
    def delay_ms(self) -> float:
        """Delay of speed and force by their causal low-pass when rendering [ms]."""
        return 1000 * delay_s(butterworth("lowpass", self.render_lowpass_hz, self.rate_hz), self.rate_hz)


def fitting_options(seconds: float, rate_hz: float, captured_hz: float | None = None) -> str:
    """Options of `foten train` that fit a recording: "--rate 10000 --trim 0 --block 200"; empty where none do.

    Args:
        seconds: that every channel covers.
        rate_hz: of the model; for a short recording a higher one, so that there are `ENOUGH_SAMPLES`.
        captured_hz: of the acceleration, which is never upsampled; None leaves the rate as it is, and unnamed.
    """
    config = PreprocessConfig()
    if seconds >= config.shortest_s:
        rate, trim_ms, blocks_ms = rate_hz, config.trim_ms, [config.block_ms]
    else:
        rates = sorted({rate_hz, *(rate for rate in RATES_HZ if rate_hz < rate <= (captured_hz or 0))})
        rate, trim_ms = next((rate for rate in rates if rate * seconds >= ENOUGH_SAMPLES), rates[-1]), 0.0
        usable_ms = 1000 * (seconds - 1 / rate) - config.delay_ms
        blocks_ms = [ms for n in (ENOUGH_BLOCKS, MIN_BLOCKS) for ms in SHORT_BLOCKS_MS if usable_ms >= n * ms]
    if not blocks_ms:
        return ""
    named = "" if captured_hz is None else f"--rate {min(rate, captured_hz):g} "
    return f"{named}--trim {trim_ms:g} --block {blocks_ms[0]:g}"


def blocks_of(shortest_ms: float) -> tuple[float, ...]:
    """Blocks for short recordings of at least some length, longest first [ms]; the longest of all where none is as long."""
    return tuple(block_ms for block_ms in SHORT_BLOCKS_MS if block_ms >= shortest_ms) or SHORT_BLOCKS_MS[:1]


def fitting_cut(recording: Recording, shortest_ms: float = SHORTEST_MS) -> tuple[float, float]:
    """Trim and block [ms] that fit a recording: the defaults of a long one, shorter ones where too few blocks would judge it.

    Nothing is trimmed where that would cost more than a tenth. Each take gives `BLOCKS_OF_TAKE` blocks where it can; one of less
    than a quarter of the usual length is no measure for the others. A single recording of less than `MIN_ALONE_S` needs options
    that a user chooses (`fitting_options`). `shortest_ms` is the block that holds enough windows of the model.
    """
    lengths_ms, config = np.array([1000 * take.duration_s for take in recording.takes]), PreprocessConfig()
    if lengths_ms.size == 1 and lengths_ms[0] < 1000 * MIN_ALONE_S:
        return config.trim_ms, config.block_ms
    usual = lengths_ms >= 0.25 * np.median(lengths_ms)
    trim_ms = config.trim_ms if 2 * config.trim_ms <= MAX_TRIMMED * lengths_ms[usual].min() else 0.0
    usable_ms = np.maximum(0.0, lengths_ms - trim_ms - max(trim_ms, config.delay_ms))

    def fits(block_ms: float) -> bool:
        n = usable_ms // block_ms
        return bool(n.sum() >= JUDGED_BLOCKS and (n.size == 1 or n[usual].min() >= BLOCKS_OF_TAKE))

    blocks_ms = blocks_of(shortest_ms)
    return trim_ms, next(filter(fits, blocks_ms), blocks_ms[-1])


def cut_in_words(trim_ms: float, block_ms: float) -> str:
    """Blocks and trim of a recording, in words."""
    trimmed = f"{trim_ms:g} ms trimmed at both ends" if trim_ms else "nothing trimmed at the ends"
    return f"blocks of {block_ms:g} ms, with {trimmed}"


def preprocess(recording: Recording, config: PreprocessConfig | None = None, n_blocks: int | None = None) -> Trace:
    """Trace of a recording: whole blocks of acceleration, speed and force at one rate, of the stretch that every channel covers.

    The low-pass of speed and force is causal, as in rendering; its delay is then cut off to a whole sample. DFT321 joins three
    axes. Of several takes the blocks follow one another; each take is trimmed and filtered by itself. A training needs
    `n_blocks`; None, at the rate of an existing texture, takes one. Source: Sec. III-c, Sec. VI.

    Raises:
        ValueError: a quantity is missing or beyond what a hand can do, the acceleration is slower than the rate or irregular
            in time, speed or force has holes or the wrong sign, or the recording is too short for the trim and the blocks.
    """
    config = config or PreprocessConfig()
    if recording.later_takes:
        return _trace_of_takes(recording, config, n_blocks)
    rate = config.rate_hz
    axes = recording.axes("acceleration")
    if not axes:
        raise ValueError("the recording has no acceleration channel")
    _check_axes(axes, config)
    start, stop = _common(recording, rate)
    highpass = butterworth("highpass", config.highpass_hz, rate, config.highpass_order)
    lowpass = butterworth("lowpass", config.lowpass_hz, rate)
    delay = 0 if config.zero_phase else round(delay_s(lowpass, rate) * rate)
    trim = round(config.trim_ms * rate / 1000)
    usable = stop - start - trim - max(trim, delay)
    if usable < (n_blocks or 1) * config.block:
        covered_s, needed = (stop - start) / rate, counted(n_blocks, "block") if n_blocks else "a block"
        options = fitting_options(covered_s, rate, axes[0].rate_hz if n_blocks else None)
        raise ValueError(
            f"{covered_s:.3g} s are covered by every channel; a trim of {config.trim_ms:g} ms at both ends leaves "
            f"{max(0, usable) / rate:.3g} s, less than {needed} of {config.block_ms:g} ms; "
            + (f"use {options}" if options else "that is too short: record for longer")
        )
    n_dropped = usable % config.block

    def settled(sections: Sections, signal: Array, first: int) -> Array:
        return filter_recorded(sections, signal, zero_phase=config.zero_phase)[first:][: usable - n_dropped]

    decimated = [decimate(axis.samples, axis.rate_hz, rate)[start:stop] for axis in axes]
    vibration = np.stack([settled(highpass, samples, trim) for samples in decimated])
    acceleration = vibration[0]
    if len(axes) > 1:
        acceleration = joined_axes(vibration, config)
    velocities, normal_force = velocity_and_force(recording, rate)
    speed = speed_of(np.stack([settled(lowpass, row, trim + delay) for row in velocities]))
    force = np.maximum(settled(lowpass, normal_force, trim + delay), 0.0)
    if not config.force_units:
        _check_size("speed", float(speed.max()))
        _check_size("force", float(force.max()))
    n_uncovered = max(round(axis.duration_s * rate) for axis in axes) - (stop - start)
    source = recording.sha256(), asdict(config), n_dropped, n_uncovered
    return Trace(acceleration, speed, force, rate, config.block, *source)


def _check_axes(axes: Sequence[Channel], config: PreprocessConfig) -> None:
    if not config.force_units:
        _check_size("acceleration", max(float(np.abs(axis.samples).max()) for axis in axes))
    for axis in axes:
        if axis.times_s is not None:
            raise ValueError(
                "the acceleration was captured at irregular times, expected a steady rate: if only its time stamps are unsteady, "
                "import it again without time and with --rate; if samples were lost, cut the table there and import the pieces "
                "as takes, with --append"
            )
        if axis.rate_hz < config.rate_hz * (1 - 1e-9):
            raise ValueError(
                f"the acceleration was captured at {axis.rate_hz:g} Hz and {config.rate_hz:g} Hz is asked for; it is never "
                f"upsampled: train with --rate {axis.rate_hz:g} or lower"
            )


def joined_axes(vibration: Array, config: PreprocessConfig) -> Array:
    """Axes (n_axes, n) of whole blocks as one (n,)."""
    if config.dft321_ms:
        return dft321(vibration, round(config.dft321_ms * config.rate_hz / 1000))
    return dft321(vibration.reshape(len(vibration), -1, config.block).swapaxes(0, 1)).ravel()


def _trace_of_takes(recording: Recording, config: PreprocessConfig, n_blocks: int | None) -> Trace:
    """Blocks of all takes, each preprocessed by itself: no filter, block or window spans two."""
    traces = []
    for i, take in enumerate(recording.takes, 1):
        try:
            traces.append(preprocess(take, config))
        except ValueError as error:
            raise ValueError(f"take {i}{take.named}: {error}") from error
    blocks = tuple(trace.n_blocks for trace in traces)
    if sum(blocks) < (n_blocks or 1):
        raise ValueError(f"{len(blocks)} takes give {sum(blocks)} blocks of {config.block_ms:g} ms, not {n_blocks}")
    acceleration, speed, force = (np.concatenate([getattr(trace, name) for trace in traces]) for name in CHANNELS)
    n_dropped, n_uncovered = sum(trace.n_dropped for trace in traces), sum(trace.n_uncovered for trace in traces)
    of_all = recording.sha256(), asdict(config), n_dropped, n_uncovered, blocks
    return Trace(acceleration, speed, force, config.rate_hz, traces[0].block, *of_all)


def condition(velocities: Array, normal_force: Array, rate_hz: float, lowpass_hz: float) -> tuple[Array, Array]:
    """Speed [mm/s] and force [N], shapes (n,), through the causal low-pass of rendering, settled on the first sample.

    Of velocities [mm/s], shape (n_axes, n), one axis where only the speed is known, and the normal force [N], shape (n,).
    """
    sections = butterworth("lowpass", lowpass_hz, rate_hz)
    filtered = []
    for signal in (*velocities, normal_force):
        biquads = Biquads(sections)
        biquads.reset(float(signal[0]) if signal.size else 0.0)
        filtered.append(biquads.process(signal))
    return speed_of(np.stack(filtered[:-1])), np.maximum(filtered[-1], 0.0)


def velocity_and_force(recording: Recording, rate_hz: float) -> tuple[Array, Array]:
    """Velocity [mm/s] (n_axes, n) and normal force [N] (n,) at a rate, where both and any acceleration are covered.

    Not yet low-passed. The velocity has the axes x and y where positions were recorded, else the speed alone. Pressing counts
    positive: the sign of a force that is mostly negative is changed. ValueError where one is missing or has holes.
    """
    start, stop = _common(recording, rate_hz)
    for name in (*recording.movement, *recording.normal_force):
        holes = recording[name].holes()
        if holes.size:
            longest_ms = 1000 * float(np.diff(recording[name].times)[holes].max())
            raise ValueError(
                f"{name} has {counted(holes.size, 'hole')} in its times, the longest {longest_ms:.4g} ms; import the "
                "recording again with --fill-gaps MS, or cut it"
            )
    rows = np.stack([_slow(recording[name], rate_hz, stop)[start:] for name in recording.movement])
    if "speed" not in recording:
        rows = velocity(rows, rate_hz)
        if len(rows) == 1:  # a stroke along one axis; a single row would be a speed
            rows = np.concatenate([rows, np.zeros_like(rows)])
    # The signs are those of the raw samples: a filter rings after a sudden stop.
    elif (raw := recording["speed"].samples).min() < -WRONG_SIGN[0]:
        raise ValueError(
            f"speed is negative in {int((raw < 0).sum())} of {raw.size} samples, down to {raw.min():.4g} mm/s; is it one "
            "axis of a velocity? import positions, or its magnitude"
        )
    force = recording[recording.normal_force[0]]
    raw = pressing(force)
    if raw.min() < -WRONG_SIGN[1]:
        span = f"{raw.min():.4g} to {raw.max():.4g} N"
        raise ValueError(f"force runs from {span}, expected 0 or more; is the sensor not zeroed?")
    return rows, _slow(replace(force, samples=raw), rate_hz, stop)[start:]


def pressing(force: Channel) -> Array:
    """Force as captured, pressing positive [N], shape (n,)."""
    return -force.samples if np.median(force.samples) < 0 else force.samples


def _check_size(quantity: str, largest: float) -> None:
    if largest > LIMITS[quantity]:
        unit = UNITS[quantity].replace("^2", "²")
        beyond = f"the {quantity} reaches {largest:.6g} {unit}, beyond any hand ({LIMITS[quantity]:g} {unit})"
        raise ValueError(f"{beyond}; another unit, or spikes? See foten inspect; --force-units takes it as it is")


def _common(recording: Recording, rate_hz: float) -> tuple[int, int]:
    """First sample and the one past the last that acceleration, movement and force cover, at a rate from time 0."""
    if not recording.movement:
        raise ValueError("the recording has no speed and no position_x, position_y channel")
    if not recording.normal_force:
        raise ValueError("the recording has no force and no force_z channel")
    start_s, end_s = common_span_s(recording.used)
    return max(0, math.ceil(start_s * rate_hz - 1e-6)), math.floor(end_s * rate_hz + 1e-6)


def _slow(channel: Channel, rate_hz: float, n: int) -> Array:
    """Speed, position or force at a rate from time 0, shape (n,): averaged from above, interpolated from below."""
    if channel.times_s is None and channel.rate_hz > rate_hz * (1 + 1e-9):
        return decimate(channel.samples, channel.rate_hz, rate_hz)[:n]
    return at_rate(channel.samples, channel.times, rate_hz, n)
