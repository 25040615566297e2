"""What a recording holds and what is wrong with it, found from its numbers alone.

A finding is a *problem* when training on the recording as it is would learn something false, a *note*
otherwise.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp.filters import butterworth, filter_recorded
from foten.dsp.kinematics import speed_of
from foten.recording import felt
from foten.recording.preprocess import WRONG_SIGN, PreprocessConfig, hand_of, times_of
from foten.recording.recording import UNITS, Channel, Recording

CONTACT_N = 0.05  # less force is lift-off
MOVING_MM_S = 5.0  # less speed is rest
SHORTEST_LOSS_S = 0.005  # a shorter loss of contact is noise of the force sensor
HAND_HZ = 20.0  # a hand holds nothing above; the low-pass of Sec. V-b
FRAME_S = 0.05  # of the search for the quietest stretch
TRAINING_HZ = PreprocessConfig().rate_hz  # at which training puts speed and force side by side
CELL_S = 0.05  # a cell of the plane counts as covered from here on
CELL_MM_S, CELL_N = 25.0, 0.5
PLANE_MM_S, PLANE_N = 300.0, 5.0  # the plane that users of textures reach; larger where the recording is
FEWEST_BLOCKS = 5  # that a split needs
N_PLACES = 200  # that a finding lists

PROBLEM, NOTE = "problem", "note"

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Finding:
    """One thing to know about a recording.

    Attributes:
        severity: `problem` or `note`.
        code: a word for programs, e.g. `spikes`.
        channel: which channel, or empty.
        text: a sentence for people.
        places_s: where, seconds from the start, at most `N_PLACES` of them.
    """

    severity: str
    code: str
    channel: str
    text: str
    places_s: tuple[float, ...] = ()


@dataclass(frozen=True)
class ChannelReport:
    """The numbers of one channel, in the unit of `UNITS`; `low` and `high` are the 1st and 99th percentile.

    `noise_floor` is an RMS. Of an acceleration: its level at `rest`, or an upper bound, that of the
    `quietest 5 %`.
    Of a slow signal: from its third `differences`.
    """

    name: str
    unit: str
    rate_hz: float
    regular: bool
    n_samples: int
    duration_s: float
    minimum: float
    maximum: float
    low: float
    high: float
    mean: float
    rms: float
    noise_floor: float
    noise_floor_from: str


@dataclass(frozen=True)
class Coverage:
    """Where in the speed–force plane the recording was, while it moved in contact.

    Attributes:
        speed_edges: of the cells [mm/s], shape (i+1,).
        force_edges: of the cells [N], shape (j+1,).
        seconds: spent in each cell, shape (i, j).
        beyond_s: spent outside the plane.
        speed_range, force_range: 0.1st and 99.9th percentile [mm/s, N].
    """

    speed_edges: NDArray[np.float64]
    force_edges: NDArray[np.float64]
    seconds: NDArray[np.float64]
    beyond_s: float
    speed_range: tuple[float, float]
    force_range: tuple[float, float]

    @property
    def covered(self) -> int:
        """Return the number of cells with `CELL_S` or more."""
        return int((self.seconds >= CELL_S).sum())

    @property
    def fraction(self) -> float:
        """Return the covered part of the plane, in [0, 1]."""
        return self.covered / self.seconds.size


@dataclass(frozen=True)
class Inspection:
    """Everything that `inspect_recording` found.

    `psd` maps an acceleration channel to frequency [Hz] and one-sided density [(m/s²)²/Hz].
    """

    channels: tuple[ChannelReport, ...]
    findings: tuple[Finding, ...]
    coverage: Coverage | None
    psd: Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]] = field(default_factory=dict)
    recording_sha256: str = ""

    @property
    def carried(self) -> dict[float, float]:
        """Return the share of what a hand feels that a rate of the model carries, by rate [Hz]; empty where none is known."""
        rates = [channel.rate_hz for channel in self.channels if channel.name in self.psd]
        return felt.carried(self.psd, min(rates)) if rates else {}

    @property
    def problems(self) -> tuple[Finding, ...]:
        """Return the findings that are problems."""
        return tuple(finding for finding in self.findings if finding.severity == PROBLEM)

    def to_dict(self) -> dict[str, Any]:
        """Return the inspection as plain values for JSON, without the densities."""
        coverage = None
        if self.coverage is not None:
            coverage = {
                "covered_cells": self.coverage.covered,
                "cells": int(self.coverage.seconds.size),
                "fraction": self.coverage.fraction,
                "speed_range_mm_s": list(self.coverage.speed_range),
                "force_range_n": list(self.coverage.force_range),
                "speed_edges_mm_s": self.coverage.speed_edges.tolist(),
                "force_edges_n": self.coverage.force_edges.tolist(),
                "seconds": self.coverage.seconds.tolist(),
                "beyond_s": self.coverage.beyond_s,
            }
        return {
            "recording_sha256": self.recording_sha256,
            "channels": [asdict(channel) for channel in self.channels],
            "coverage": coverage,
            "findings": [asdict(finding) for finding in self.findings],
            "carried_by_rate_hz": {f"{rate:g}": share for rate, share in self.carried.items()},
        }

    def to_text(self) -> str:
        """Return the report for people."""
        lines = [
            f"{'channel':<15}{'unit':>6}{'rate':>10}{'samples':>9}{'lasts':>9}{'from':>11}"
            f"{'to':>11}{'rms':>10}"
            f"{'noise':>11}"
        ]
        for one in self.channels:
            bound = "<" if one.noise_floor_from == "quietest 5 %" else " "
            lines.append(
                f"{one.name:<15}{one.unit:>6}{one.rate_hz:>7.6g} Hz{one.n_samples:>9}{one.duration_s:>7.2f} s"
                f"{one.minimum:>11.4g}{one.maximum:>11.4g}{one.rms:>10.4g} {bound}{one.noise_floor:>9.3g}"
            )
        if self.coverage is not None:
            plane = self.coverage
            lines.append(
                f"speed–force plane: {plane.covered} of {plane.seconds.size} cells visited "
                f"({plane.fraction:.0%}), "
                f"speed {plane.speed_range[0]:.4g} to {plane.speed_range[1]:.4g} mm/s, "
                f"force {plane.force_range[0]:.3g} to {plane.force_range[1]:.3g} N"
            )
        if self.carried:
            best = felt.smallest_rate(self.carried)
            lines.append(f"of what a hand feels, {felt.in_words(self.carried)}; train with --rate {best:g}")
        for severity in (PROBLEM, NOTE):
            lines += [f"{severity:<8} {f.text}" for f in self.findings if f.severity == severity]
        if not self.problems:
            lines.append("no problem found")
        return "\n".join(lines)


def inspect_recording(recording: Recording) -> Inspection:
    """Return what a recording holds and what is wrong with it."""
    findings: list[Finding] = []
    hand = None
    try:
        hand = _hand(recording)
    except ValueError as error:
        findings.append(Finding(PROBLEM, "refused", "", f"training refuses it: {error}"))
    rest = None if hand is None else (hand[0], (hand[1] < MOVING_MM_S) | (hand[2] < CONTACT_N))
    reports = tuple(_report(name, channel, rest) for name, channel in recording.channels.items())
    findings += _missing(recording)
    findings += _durations(recording)
    for name, channel in recording.channels.items():
        findings += _units(name, channel, recording)
        findings += _gaps(name, channel)
        findings += _spikes(name, channel)
        findings += _clipping(name, channel)
        findings += _held(name, channel)
    findings += _order(recording)
    psd = {}
    for name, channel in recording.channels.items():
        if name.startswith("acceleration"):
            findings += _whiteness(name, channel)
            if channel.samples.size >= 64:
                psd[name] = _density(channel)
                findings += _lines(name, *psd[name])
    findings += _signs(recording)
    findings += _contact(recording, hand)
    findings += _above_noise(reports)
    coverage = None if hand is None else _coverage(*hand[1:])
    if coverage is not None:
        findings += _unvisited(coverage)
    return Inspection(reports, tuple(findings), coverage, psd, recording.sha256())


def _places(channel: Channel, indices: NDArray[np.int64]) -> tuple[float, ...]:
    if indices.size > N_PLACES:
        indices = indices[np.linspace(0, indices.size - 1, N_PLACES).astype(np.int64)]
    return tuple(round(float(t), 6) for t in times_of(channel)[indices])


def _runs(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return where stretches of True start and end (one past)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return edges[0::2], edges[1::2]


def _many(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _movement(recording: Recording) -> list[str]:
    """Return the channels that speed is taken from."""
    names = ["speed"] if "speed" in recording else ["position_x", "position_y"]
    return [name for name in names if name in recording]


def _normal(recording: Recording) -> list[str]:
    """Return the channel that force is taken from, or none."""
    return [name for name in ("force", "force_z") if name in recording][:1]


def _span(channel: Channel) -> tuple[float, float]:
    start = 0.0 if channel.times_s is None else float(channel.times_s[0])
    return start, start + channel.duration_s


def _hand(recording: Recording) -> tuple[Array, Array, Array] | None:
    """Return times [s], speed [mm/s] and force [N] at `TRAINING_HZ`, as training takes them, but without delay.

    None where one of them is missing or they share too little time.

    Raises:
        ValueError: the refusal of training, `hand_of`.
    """
    if not _movement(recording) or not _normal(recording):
        return None
    hand = [*_movement(recording), *_normal(recording)]
    spans = [_span(one) for one in [*recording.axes("acceleration"), *map(recording.__getitem__, hand)]]
    start, end = max(start for start, _ in spans), min(end for _, end in spans)
    # What holds up to 20 Hz settles within 50 ms; at the ends the low-pass lacks what came before and after.
    margin = round(TRAINING_HZ / HAND_HZ)
    if (end - start) * TRAINING_HZ < 4 * margin:
        return None
    moved, pressed = hand_of(recording, TRAINING_HZ)
    low = butterworth("lowpass", HAND_HZ, TRAINING_HZ)
    *slow, force = (filter_recorded(low, row, zero_phase=True)[margin:-margin] for row in (*moved, pressed))
    times = (np.ceil(start * TRAINING_HZ - 1e-6) + margin + np.arange(force.size)) / TRAINING_HZ
    return times, speed_of(np.stack(slow)), force


def _report(
    name: str, channel: Channel, rest: tuple[NDArray[np.float64], NDArray[np.bool_]] | None
) -> ChannelReport:
    x = channel.samples
    low, high = np.quantile(x, [0.01, 0.99])
    floor, source = _noise_floor(name, channel, rest)
    return ChannelReport(
        name,
        UNITS[name],
        channel.rate_hz,
        channel.times_s is None,
        x.size,
        channel.duration_s,
        float(x.min()),
        float(x.max()),
        float(low),
        float(high),
        float(x.mean()),
        float(np.sqrt(np.mean(x**2))),
        floor,
        source,
    )


def _noise_floor(
    name: str, channel: Channel, rest: tuple[NDArray[np.float64], NDArray[np.bool_]] | None
) -> tuple[float, str]:
    """Return the RMS of the noise and where it was found: `rest`, `quietest 5 %` or `differences`."""
    x = channel.samples
    if not name.startswith("acceleration"):
        if x.size < 4:
            return 0.0, "differences"
        # White noise of variance s² has third differences of variance (1+9+9+1)·s²; a hand's are next to
        # zero.
        return float(1.4826 * np.median(np.abs(np.diff(x, 3))) / np.sqrt(20)), "differences"
    frame = max(2, round(FRAME_S * channel.rate_hz))
    frames = x[: x.size - x.size % frame].reshape(-1, frame) if x.size >= frame else x[None, :]
    levels = frames.std(axis=1)  # about each frame's mean: gravity is no noise
    if rest is not None:
        starts = times_of(channel)[:: frames.shape[1]][: levels.size]
        times, still = rest[0], rest[1].astype(np.float64)
        quiet = np.all(
            [np.interp(starts + late, times, still, left=0, right=0) == 1 for late in (0, FRAME_S / 2)],
            axis=0,
        )
        if quiet.sum() >= 4:
            return float(np.median(levels[quiet])), "rest"
    return float(np.quantile(levels, 0.05)), "quietest 5 %"


def _missing(recording: Recording) -> Iterable[Finding]:
    config = PreprocessConfig()
    if not recording.axes("acceleration"):
        yield Finding(
            PROBLEM,
            "missing",
            "acceleration",
            "there is no acceleration: nothing to learn from; speed and force can still drive a renderer",
        )
    for axis in recording.axes("acceleration")[:1]:
        if axis.rate_hz < config.rate_hz:
            yield Finding(
                PROBLEM,
                "rate",
                "acceleration",
                f"acceleration was captured at {axis.rate_hz:g} Hz and is never upsampled: train with "
                f"--rate {axis.rate_hz:g} or lower",
            )
    if not _movement(recording):
        yield Finding(PROBLEM, "missing", "speed", "there is no speed, and no position to take it from")
    if not _normal(recording):
        yield Finding(PROBLEM, "missing", "force", "there is no normal force (force or force_z)")


def _durations(recording: Recording) -> Iterable[Finding]:
    config = PreprocessConfig()
    spans = {name: _span(channel) for name, channel in recording.channels.items()}
    fast = next((name for name in recording.channels if name.startswith("acceleration")), "")
    outside = set()
    for name in [*_movement(recording), *_normal(recording)] if fast else []:
        (begins, stops), (first, last) = spans[name], spans[fast]
        if recording[name].times_s is not None and (begins > first + 0.05 or stops < last - 0.05):
            outside.add(name)
            yield Finding(
                NOTE,
                "span",
                name,
                f"{name} covers {begins:.2f} to {stops:.2f} s, {fast} {first:.2f} to {last:.2f} s: training "
                "uses the common part",
            )
    ends = {name: stops for name, (_, stops) in spans.items() if name not in outside}
    early, late = min(ends, key=lambda name: ends[name]), max(ends, key=lambda name: ends[name])
    if ends[late] - ends[early] > max(0.05, 0.01 * ends[late]):
        yield Finding(
            NOTE,
            "durations",
            early,
            f"{early} ends at {ends[early]:.3f} s and {late} at {ends[late]:.3f} s; only the common part is "
            "used; are both rates right?",
        )
    common = min(stops for _, stops in spans.values()) - max(begins for begins, _ in spans.values())
    needed = (2 * config.trim_ms + FEWEST_BLOCKS * config.block_ms) / 1000
    if common < needed:
        yield Finding(
            NOTE,
            "short",
            "",
            f"it lasts {common:.2f} s, and trimming {config.trim_ms / 1000:g} s at both ends and "
            f"{FEWEST_BLOCKS} blocks of {config.block_ms / 1000:g} s take {needed:g} s: train with a shorter "
            "--trim and --block",
        )


def _swing(channel: Channel) -> float:
    return float(np.subtract(*np.quantile(channel.samples, [0.999, 0.001])))


def _units(name: str, channel: Channel, recording: Recording) -> Iterable[Finding]:
    x, unit = channel.samples, UNITS[name]
    peak = float(np.quantile(np.abs(x), 0.999))
    if x.min() == x.max():
        fast = name.startswith("acceleration")
        text = f"{name} is {x[0]:g} {unit} throughout; is the right column mapped?"
        yield Finding(PROBLEM if fast else NOTE, "constant", name, text)
        return
    guess = ""
    if name == "speed":
        if peak < 5:
            guess = f"speed peaks at {peak:.3g}, expected mm/s up to about 350; was it given in m/s?"
        elif peak > 1500:
            guess = f"speed peaks at {peak:.4g}, expected mm/s up to about 350; is it a raw reading?"
    elif name.startswith("position"):
        # A stroke along one axis leaves the others at rest: the one that moves most tells the unit.
        swing = _swing(channel)
        if swing < max(_swing(axis) for axis in recording.axes("position")):
            return
        if swing < 1:
            guess = f"{name} moves by {swing:.3g}, expected mm, tens to hundreds; was it given in m?"
        elif swing > 2000:
            guess = f"{name} moves by {swing:.4g}, expected mm, tens to hundreds; was it given in um?"
    elif name.startswith("force"):
        if peak > 30:
            guess = f"{name} peaks at {peak:.4g}, expected N up to about 10; was it given in mN or gf?"
        elif peak < 0.03 and name in ("force", "force_z"):
            guess = f"{name} peaks at {peak:.3g}, expected N up to about 10; was it given in kN or V?"
    else:
        mean, spread = abs(float(x.mean())), float(x.std())
        if 0.9 < mean < 1.1 and spread < mean:
            guess = f"{name} has a mean of {x.mean():.3g}, which is gravity in g; was it given in g?"
        elif peak < 0.02:
            guess = f"{name} peaks at {peak:.3g} m/s², which hardly any hand feels; was it given in g or V?"
        elif peak > 500:
            guess = f"{name} peaks at {peak:.4g} m/s², expected up to about 100; was it given in mm/s² or mg?"
    if guess:
        yield Finding(PROBLEM, "units", name, guess)


def _gaps(name: str, channel: Channel) -> Iterable[Finding]:
    if channel.times_s is None or channel.times_s.size < 3:
        return
    steps = np.diff(channel.times_s)
    usual = float(np.median(steps))
    gaps = channel.holes()
    if gaps.size:
        longest = int(gaps[np.argmax(steps[gaps])])
        lost = int(np.round(steps[gaps] / usual - 1).sum())
        yield Finding(
            PROBLEM if name.startswith("acceleration") or steps[longest] > 0.1 else NOTE,
            "gaps",
            name,
            f"{name}: {_many(gaps.size, 'gap')} in time, about {lost} samples lost; the longest lasts "
            f"{steps[longest] * 1000:.4g} ms at {channel.times_s[longest]:.3f} s",
            _places(channel, gaps),
        )
    jitter = float(np.median(np.abs(steps - usual)))
    if jitter > 0.05 * usual:
        yield Finding(
            NOTE,
            "jitter",
            name,
            f"{name}: its sampling period of {usual * 1000:.4g} ms varies by {jitter / usual:.0%}",
        )


def _spiky(x: NDArray[np.float64], fast: bool) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the indices of one or two samples that stand alone, and how far each stands from its neighbours.

    A median of five keeps steps and slopes and removes one or two strays, so what it removes is either a
    stray or, in a fast signal, the tips of the vibration: hence the percentile as a measure. On four real
    textures at 10 kHz the largest tip was 4.3 times the 99th percentile.
    """
    from scipy.ndimage import median_filter

    if x.size < 10:
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    removed = np.abs(x - median_filter(x, 5, mode="nearest"))
    swing = float(np.subtract(*np.quantile(x, [0.99, 0.01])))
    usual = float(np.quantile(removed, 0.99 if fast else 0.95))
    found = np.flatnonzero(removed > max(10 * usual, (0.3 if fast else 0.1) * swing, 1e-9))
    return found, removed[found]


def _spikes(name: str, channel: Channel) -> Iterable[Finding]:
    found, height = _spiky(channel.samples, name.startswith("acceleration"))
    if found.size:
        largest = int(found[np.argmax(height)])
        yield Finding(
            PROBLEM,
            "spikes",
            name,
            f"{name}: {_many(found.size, 'spike')} of one or two samples, the largest "
            f"{channel.samples[largest]:.6g} "
            f"{UNITS[name]} at sample {largest} ({times_of(channel)[largest]:.3f} s)",
            _places(channel, found),
        )


def _leaves(x: Array, start: int, end: int, quantum: float) -> bool:
    """Return whether a signal leaves a flat top, x[start:end] of n samples, more steeply than a rounded one can.

    A smooth top is a parabola. Rounded to steps of q it is flat where it drops by less than q, so at least over a half-width
    of (n−1)/2; n samples further out it then has dropped by at most q·((n−1)/2 + n)²/((n−1)/2)², and one q more by rounding.
    A top that was cut off drops at the slope at which it was cut.
    """
    n = end - start
    most = quantum * (((3 * n - 1) / (n - 1)) ** 2 + 1)
    sides = [side for side in (x[max(0, start - n) : start], x[end : end + n]) if side.size]
    return all(float(np.abs(side - x[start]).max()) > most for side in sides)


def _clipping(name: str, channel: Channel) -> Iterable[Finding]:
    x = channel.samples
    starts, ends = _runs(np.concatenate([[False], np.diff(x) == 0]))
    starts = starts - 1  # the first of the equal samples
    lengths = ends - starts
    if not lengths.size or x.min() == x.max():
        return
    values = x[starts]
    quantum = float(np.median(np.diff(np.unique(x))))
    for extreme, what in ((float(x.max()), "highest"), (float(x.min()), "lowest")):
        others = lengths[(values != x.max()) & (values != x.min())]
        # A coarse or slow sensor repeats every value; only tops much flatter than its other flats are cut
        # off.
        usual = float(np.quantile(others, 0.99)) if others.size > 20 else 1.0
        bounded = extreme == 0 or (name == "speed" and extreme < MOVING_MM_S)
        if bounded:
            continue
        cut = np.array(
            [
                i
                for i in np.flatnonzero((values == extreme) & (lengths >= 3))
                if _leaves(x, starts[i], ends[i], quantum)
            ],
            dtype=np.int64,
        )
        flat = lengths[cut]
        if flat.size and flat.max() >= 3 * usual and (flat.size > 1 or flat.max() >= 5):
            yield Finding(
                PROBLEM,
                "clipping",
                name,
                f"{name} is clipped: it stays at its {what} value, {extreme:.5g} {UNITS[name]}, for "
                f"{_many(int(flat.sum()), 'sample')} "
                f"in {_many(flat.size, 'place')}: the sensor or its amplifier was at its limit",
                _places(channel, starts[cut]),
            )


def _held(name: str, channel: Channel) -> Iterable[Finding]:
    """Find repeated values: each k times, or the last one kept while a sensor was silent."""
    x = channel.samples
    if x.size < 100 or x.min() == x.max():
        return
    changes = np.flatnonzero(np.diff(x)) + 1
    steps = np.diff(changes)
    if steps.size < 20:
        return
    usual = int(np.median(steps))
    if usual >= 2 and np.mean(steps == usual) > 0.8:
        yield Finding(
            NOTE,
            "repeated",
            name,
            f"{name} changes only every {usual} samples: it was captured at {channel.rate_hz / usual:.4g} Hz "
            "and each value repeated",
        )
        return
    # A quantised slow signal pauses often and briefly; a sensor that fell silent pauses rarely and long.
    long = np.flatnonzero(steps > max(10.0, 10 * float(np.quantile(steps, 0.99))))
    long = long[(x[changes[long]] != 0) & (x[changes[long]] < x.max()) & (x[changes[long]] > x.min())]
    if long.size:
        yield Finding(
            PROBLEM if name.startswith("acceleration") else NOTE,
            "frozen",
            name,
            f"{name} stands still to the last digit in {_many(long.size, 'place')}, the longest for "
            f"{steps[long].max() / channel.rate_hz * 1000:.4g} ms: did the sensor fall silent?",
            _places(channel, changes[long]),
        )


def _jumps(name: str, channel: Channel) -> tuple[NDArray[np.int64], float, float]:
    """Return after which samples a slow signal jumps, the least size of a jump, the usual one by the range.

    A hand's signal of range r that holds nothing above f moves at most π·f·r a second (a sine of that
    range). A jump exceeds that and the sensor's noise, and is a step: the samples on both sides of it move
    far less. Spikes are removed before. Positions move slower than speed and force do: a stroke to and fro
    takes 200 ms or more.
    """
    from scipy.ndimage import median_filter

    x = median_filter(channel.samples, 5, mode="nearest")
    swing = float(np.subtract(*np.quantile(x, [0.995, 0.005])))
    fastest_hz = HAND_HZ / 4 if name.startswith("position") else HAND_HZ
    noise = _noise_floor(name, channel, None)[0]
    # Eight standard deviations: no Gaussian noise steps as far in an hour at 10 kHz.
    least = min(np.pi * fastest_hz * swing / channel.rate_hz, 0.5 * swing) + 8 * noise
    steps = np.abs(np.diff(x))
    around = np.lib.stride_tricks.sliding_window_view(np.pad(steps, 4, mode="reflect"), 9)
    at = np.flatnonzero(steps > least)
    at = at[steps[at] > 6 * np.median(around[at], axis=1)]
    return at, least, float(np.median(steps[at]) / swing) if at.size and swing else 0.0


def _order(recording: Recording) -> Iterable[Finding]:
    """Find rows that are not in the order of time, from how speed, force and position jump.

    A recording in order has hardly any jump, wherever it was taken. Rows in a wrong order jump where pieces
    meet: in many places, in all slow channels at the same rows, over much of the range, and where the pieces
    are equally long at multiples of that. One of these besides the number makes the finding.
    """
    jumps = {
        name: _jumps(name, channel)
        for name, channel in recording.channels.items()
        if not name.startswith("acceleration") and channel.samples.size >= 100
    }
    many = {
        name: at
        for name, (at, _, _) in jumps.items()
        if at.size >= max(10, 0.001 * recording[name].samples.size)
    }
    for name, (at, least, size) in jumps.items():
        channel = recording[name]
        memory = _memory(name, channel)
        if memory < 0.8:
            yield Finding(
                PROBLEM,
                "order",
                name,
                f"{name}: the rows are probably not in time order: neighbours have little to do with each "
                f"other "
                f"(correlation {memory:.2f}), where a hand moves smoothly; or it is noise alone",
            )
            continue
        if not at.size:
            continue
        shared = [
            other
            for other, there in many.items()
            if other != name
            and name in many
            and recording[other].samples.size == channel.samples.size
            # Many more common rows than chance gives.
            and np.isin(at, there).mean() > max(0.25, 3 * there.size / channel.samples.size)
        ]
        piece = _piece(at)
        if name not in many or not (shared or piece or size > 0.1):
            # A position that jumps becomes a speed that was not there.
            position = name.startswith("position")
            yield Finding(
                PROBLEM if position else NOTE,
                "jumps",
                name,
                f"{name} jumps by more than {least:.3g} {UNITS[name]} between two samples in "
                f"{_many(at.size, 'place')}, faster than a hand moves"
                + (
                    "; were lost markers written as 0? Blank them and import with --fill-gaps"
                    if position
                    else ""
                ),
                _places(channel, at),
            )
            continue
        text = (
            f"{name}: the rows are probably not in time order: {at.size} jumps larger than {least:.3g} "
            f"{UNITS[name]} between neighbours, where a hand moves smoothly, typically "
            f"{np.median(np.diff(at)):.0f} "
            "samples apart"
        )
        if piece:
            text += (
                f", nearly all at multiples of {piece} samples, as if pieces of {piece} rows were shuffled"
            )
        if shared:
            text += f"; {np.isin(at, many[shared[0]]).mean():.0%} of them at the same rows as in {shared[0]}"
        yield Finding(PROBLEM, "order", name, text, _places(channel, at))


def _memory(name: str, channel: Channel) -> float:
    """Return the correlation of neighbours in a slow channel, 1 where it moves too little to tell."""
    low, high = np.quantile(channel.samples, [0.005, 0.995])
    least = {"speed": 20.0, "force": 0.5, "force_z": 0.5, "position_x": 10.0, "position_y": 10.0}
    if channel.rate_hz < 100 or high - low < least.get(name, np.inf):
        return 1.0
    x = np.clip(channel.samples, low, high)  # so that a spike is not all there is
    return float(np.corrcoef(x[:-1], x[1:])[0, 1])


def _piece(jumps: NDArray[np.int64]) -> int:
    """Return the largest number of which 80 % of the jumps are multiples, up to a shift, or 0."""
    jumps = jumps[:500]
    best = 0
    # Fewer jumps, or lengths that fit into them only a few times, would agree by chance.
    if jumps.size >= 15:
        for length in range(3, min(2000, int(jumps[-1] - jumps[0]) // 4)):
            if np.bincount(jumps % length).max() > 0.8 * jumps.size:
                best = length
    return best


def _whiteness(name: str, channel: Channel) -> Iterable[Finding]:
    """Find a vibration that no moving tool made: one without memory, or with a pattern fixed to the rows."""
    x = channel.samples[:200_000]
    x = x - x.mean()
    power = float(np.mean(x**2))
    if x.size < 1000 or power == 0:
        return
    explained = {}
    for period in range(2, min(250, x.size // 40)):
        n = x.size // period
        pattern = x[: n * period].reshape(n, period).mean(axis=0)
        # Noise alone explains 1/n of the power in each of its period−1 free means; what exceeds that is the
        # pattern.
        explained[period] = float(np.mean(pattern**2)) / power - 1 / n
    largest = max(explained.values())
    whitened, patterned = x, False
    if largest > 0.05:
        period = next(p for p, part in explained.items() if part >= 0.9 * largest)
        n = x.size // period
        whitened = x[: n * period] - np.tile(x[: n * period].reshape(n, period).mean(axis=0), n)
        patterned = True
    lagged = [float(np.mean(whitened[:-k] * whitened[k:]) / np.mean(whitened**2)) for k in range(1, 6)]
    largest_lag = max(lagged, key=abs)
    white = abs(largest_lag) < 0.12
    if patterned:
        hz = channel.rate_hz / period
        cause = (
            "mains hum?"
            if min(abs(hz / m - round(hz / m)) for m in (50, 60)) < 1e-6 and not white
            else "a processed or generated signal?"
        )
        yield Finding(
            PROBLEM if white else NOTE,
            "pattern",
            name,
            f"{name}: one pattern repeats exactly every {period} samples ({hz:.4g} Hz) throughout and holds "
            f"{largest:.0%} of the power: {cause}",
        )
    if white:
        yield Finding(
            PROBLEM,
            "white",
            name,
            f"{name} has next to no autocorrelation (at lags 1 to 5 at most {abs(largest_lag):.2f}"
            f"{', the pattern aside' if patterned else ''}): was it shuffled, or generated, or is it "
            f"noise alone?",
        )


def _density(channel: Channel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    from scipy.signal import welch

    wanted = 2 ** round(np.log2(channel.rate_hz / 4))  # a resolution of about 4 Hz
    n = int(max(16, min(wanted, channel.samples.size // 4)))
    frequency, density = welch(channel.samples, channel.rate_hz, nperseg=n, detrend="constant")
    return frequency[1:], density[1:]


def _lines(name: str, frequency: NDArray[np.float64], density: NDArray[np.float64]) -> Iterable[Finding]:
    """Find narrow lines of an instrument: 15 dB above the median of the bins around."""
    from scipy.ndimage import median_filter

    if density.size < 64:
        return
    ratio = density / np.maximum(median_filter(density, 31, mode="nearest"), 1e-30)
    peaks = np.flatnonzero((ratio[1:-1] > 30) & (ratio[1:-1] >= ratio[:-2]) & (ratio[1:-1] > ratio[2:])) + 1
    peaks = peaks[frequency[peaks] > HAND_HZ]
    if peaks.size:
        strongest = np.sort(peaks[np.argsort(ratio[peaks])[::-1][:6]])
        yield Finding(
            NOTE,
            "lines",
            name,
            f"{name}: narrow lines at {', '.join(f'{frequency[i]:.4g}' for i in strongest)} Hz"
            f"{' and elsewhere' if peaks.size > strongest.size else ''}, up to "
            f"{10 * np.log10(ratio[peaks].max()):.0f} dB above their surroundings: instruments or mains?",
        )


def _signs(recording: Recording) -> Iterable[Finding]:
    if "speed" in recording:
        negative = np.flatnonzero(recording["speed"].samples < 0)
        if negative.size:
            yield Finding(
                PROBLEM if recording["speed"].samples.min() < -WRONG_SIGN[0] else NOTE,
                "sign",
                "speed",
                f"speed is negative in {_many(negative.size, 'sample')}, down to "
                f"{recording['speed'].samples.min():.4g} mm/s: a speed has no sign; is it one axis of a "
                f"velocity?",
                _places(recording["speed"], negative),
            )
    for name in _normal(recording):
        values = _pressed(recording[name])
        if np.median(recording[name].samples) < 0:
            yield Finding(
                NOTE, "sign", name, f"{name} is negative when pressing; pressing is counted positive"
            )
        low = float(np.quantile(values, 0.001))
        if low < -0.2:
            yield Finding(
                NOTE,
                "sign",
                name,
                f"{name} goes down to {low:.3g} N: has the sensor an offset, or does the tool pull?",
            )


def _pressed(channel: Channel) -> Array:
    """Return a force with pressing counted positive [N], shape (n,), as captured: losses of contact are short."""
    return -channel.samples if np.median(channel.samples) < 0 else channel.samples


def _contact(recording: Recording, hand: tuple[Array, Array, Array] | None) -> Iterable[Finding]:
    names = _normal(recording)
    if not names:
        return
    name = names[0]
    times, lost = times_of(recording[name]), _pressed(recording[name]) < CONTACT_N
    if hand is not None:
        lost = lost & (np.interp(times, hand[0], hand[1]) > MOVING_MM_S)
    starts, ends = _runs(lost)
    lengths = (ends - starts) / recording[name].rate_hz
    starts, lengths = starts[lengths >= SHORTEST_LOSS_S], lengths[lengths >= SHORTEST_LOSS_S]
    if not starts.size:
        return
    longest = int(np.argmax(lengths))
    yield Finding(
        NOTE,
        "contact",
        name,
        f"contact is lost (force below {CONTACT_N:g} N while moving) in {_many(starts.size, 'place')}, "
        f"{lengths.sum():.3g} s together, the longest {lengths[longest]:.3g} s at "
        f"{times[starts[longest]]:.2f} s",
        _places(recording[name], starts),
    )


def _above_noise(reports: Iterable[ChannelReport]) -> Iterable[Finding]:
    for report in reports:
        if not report.name.startswith("acceleration"):
            continue
        vibration = float(np.sqrt(max(report.rms**2 - report.mean**2, 0.0)))
        if report.noise_floor_from != "rest":
            yield Finding(
                NOTE,
                "noise",
                report.name,
                f"{report.name}: no rest was found, so the noise floor is only known to lie below "
                f"{report.noise_floor:.3g} m/s² (the quietest twentieth)",
            )
        elif vibration < 2 * report.noise_floor:
            yield Finding(
                PROBLEM,
                "noise",
                report.name,
                f"{report.name}: its level, {vibration:.3g} m/s², is hardly above the "
                f"{report.noise_floor:.3g} m/s² "
                "at rest: most of it is sensor noise",
            )


def _coverage(v: Array, f: Array) -> Coverage | None:
    stroking = (v > MOVING_MM_S) & (f > CONTACT_N)
    v, f = v[stroking], f[stroking]
    if v.size < 2:
        return None
    v_low, v_high = np.quantile(v, [0.001, 0.999])
    f_low, f_high = np.quantile(f, [0.001, 0.999])

    def edges(high: float, cell: float, least: float) -> NDArray[np.float64]:
        # A spike must not stretch the plane until nothing else is seen.
        top = min(max(least, high), 2 * least)
        return np.asarray(np.arange(0, np.ceil(top / cell - 1e-9) + 1) * cell, dtype=np.float64)

    speed_edges, force_edges = edges(v_high, CELL_MM_S, PLANE_MM_S), edges(f_high, CELL_N, PLANE_N)
    counts, _, _ = np.histogram2d(v, f, bins=[speed_edges, force_edges])
    return Coverage(
        speed_edges,
        force_edges,
        counts / TRAINING_HZ,
        (v.size - counts.sum()) / TRAINING_HZ,
        (float(v_low), float(v_high)),
        (float(f_low), float(f_high)),
    )


def _unvisited(plane: Coverage) -> Iterable[Finding]:
    (slow, quick), (light, heavy) = plane.speed_range, plane.force_range
    if slow > 30:
        yield Finding(
            NOTE,
            "range",
            "speed",
            f"never slower than {slow:.0f} mm/s: below it the texture fades, it is not learnt",
        )
    if quick < 150:
        yield Finding(
            NOTE,
            "range",
            "speed",
            f"never faster than {quick:.0f} mm/s: above it the level grows by a power law, it is not learnt",
        )
    if light > 0.5:
        yield Finding(
            NOTE,
            "range",
            "force",
            f"never lighter than {light:.2g} N: below it the texture fades, it is not learnt",
        )
    if heavy < 6:
        yield Finding(
            NOTE,
            "range",
            "force",
            f"force above {heavy:.2g} N never visited: above it the level grows by a power law, it is not learnt",
        )
    if plane.fraction < 0.15:
        yield Finding(
            NOTE,
            "coverage",
            "",
            f"only {plane.fraction:.0%} of the plane up to {plane.speed_edges[-1]:g} mm/s and "
            f"{plane.force_edges[-1]:g} N was visited: vary speed and force separately when recording",
        )
