"""The result of an inspection: numbers of each channel, findings, coverage of speed and force."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array, perception
from foten.recording.preprocess import cut_in_words
from foten.recording.recording import Channel, counted, range_in_words

UNUSABLE, PROBLEM, NOTE = "unusable", "problem", "note"
N_PLACES = 200  # that a finding lists
CELL_S = 0.05  # a cell counts as covered from this time on
MIN_COVERED = 0.25  # of the cells; a recording that covers less is little of what hands do


@dataclass(frozen=True)
class Finding:
    """One thing to know about a recording."""

    severity: str  # `unusable`: nothing can be learned; `problem`: training would learn something false; else `note`
    code: str  # a word for programs, e.g. `spikes`
    channel: str  # or empty
    text: str  # a sentence for people
    places_s: tuple[float, ...] = ()  # times from the start of the take [s], at most `N_PLACES`
    take: int = 1  # the first that it is of


@dataclass(frozen=True)
class ChannelReport:
    """The numbers of one channel, in the unit of `UNITS`."""

    name: str
    unit: str
    rate_hz: float
    regular: bool
    n_samples: int
    duration_s: float
    minimum: float
    maximum: float
    mean: float
    rms: float
    noise_floor: float  # RMS
    noise_floor_from: str  # the level at `rest`, as an upper bound the `quietest 5 %`, or third `differences`


@dataclass(frozen=True)
class Coverage:
    """Time spent at each speed and force, while moving in contact."""

    speed_edges: Array  # of the cells [mm/s], shape (i+1,)
    force_edges: Array  # of the cells [N], shape (j+1,)
    seconds: Array  # spent in each cell, shape (i, j)
    speed_range: tuple[float, float]  # 0.1st and 99.9th percentile [mm/s]
    force_range: tuple[float, float]  # likewise [N]

    @property
    def speed_in_words(self) -> str:
        """Range of speed: "5 to 330 mm/s"."""
        return range_in_words("speed", *self.speed_range)

    @property
    def force_in_words(self) -> str:
        """Range of force: "0.18 to 3.2 N"."""
        return range_in_words("force", *self.force_range)

    @property
    def covered(self) -> int:
        """Number of cells with `CELL_S` or more."""
        return int((self.seconds >= CELL_S).sum())

    @property
    def fraction(self) -> float:
        """Covered share of the cells, in [0, 1]."""
        return self.covered / self.seconds.size


@dataclass(frozen=True)
class Inspection:
    """The result of `inspect_recording`."""

    channels: tuple[ChannelReport, ...]
    findings: tuple[Finding, ...]
    coverage: Coverage | None
    psd: Mapping[str, tuple[Array, Array]]  # of each acceleration: frequency [Hz], one-sided density [(m/s²)²/Hz]
    carried: Mapping[float, float]  # share of the perceived power that each rate [Hz] keeps; empty where none is known
    options: str  # of `foten train` that fit the recording; empty where it is too short for any
    recording_sha256: str
    takes_s: tuple[float, ...] = ()  # time that each covers, where there are several
    cut_ms: tuple[float, float] | None = None  # trim and block that training chooses; None where it chooses none

    @property
    def problems(self) -> tuple[Finding, ...]:
        """Findings that are more than notes."""
        return tuple(finding for finding in self.findings if finding.severity != NOTE)

    @property
    def unusable(self) -> str:
        """Why nothing sensible can be learned from it; empty where something can."""
        return next((finding.text for finding in self.findings if finding.severity == UNUSABLE), "")

    @property
    def verdict(self) -> str:
        """What it is good for, in a line."""
        if self.unusable or self.coverage is None:
            return f"record again: {self.unusable or 'speed or force is missing'}"
        n = len(self.problems)
        usable = f"usable with care ({counted(n, 'problem')} above)" if n else "usable"
        text = f"{usable} from {self.coverage.speed_in_words} and from {self.coverage.force_in_words}"
        if self.coverage.fraction < MIN_COVERED:
            text += ", a small part of what hands do: vary speed and force separately"
        return text

    def to_dict(self) -> dict[str, Any]:
        """Inspection as plain values for JSON, without the densities."""
        coverage = self.coverage and {
            "covered_cells": self.coverage.covered,
            "cells": int(self.coverage.seconds.size),
            "fraction": self.coverage.fraction,
            "speed_range_mm_s": list(self.coverage.speed_range),
            "force_range_n": list(self.coverage.force_range),
            "speed_edges_mm_s": self.coverage.speed_edges.tolist(),
            "force_edges_n": self.coverage.force_edges.tolist(),
            "seconds": self.coverage.seconds.tolist(),
        }
        return {
            "recording_sha256": self.recording_sha256,
            "channels": [asdict(channel) for channel in self.channels],
            "coverage": coverage,
            "findings": [asdict(finding) for finding in self.findings],
            "carried_by_rate_hz": {f"{rate:g}": share for rate, share in self.carried.items()},
            "options": self.options,
            "takes_s": list(self.takes_s),
            "trim_ms": self.cut_ms and self.cut_ms[0],
            "block_ms": self.cut_ms and self.cut_ms[1],
            "usable": not self.unusable,
            "verdict": self.verdict,
        }

    def to_text(self) -> str:
        """Inspection as a table of the channels and a line for each finding."""
        heads = {"unit": 6, "rate": 10, "samples": 9, "lasts": 9, "from": 11, "to": 11, "rms": 10, "noise": 11}
        lines = []
        if self.takes_s:
            shortest, longest = f"{min(self.takes_s):.3g}", f"{max(self.takes_s):.3g}"
            lengths = shortest if shortest == longest else f"{shortest} to {longest}"
            lines.append(f"{len(self.takes_s)} takes of {lengths} s")
        lines += [f"{'channel':<15}" + "".join(f"{head:>{width}}" for head, width in heads.items())]
        for channel in self.channels:
            floor = f"{'<' * (channel.noise_floor_from == 'quietest 5 %')}{channel.noise_floor:.3g}"
            lines.append(
                f"{channel.name:<15}{channel.unit:>9}{channel.rate_hz:>9.6g} Hz{channel.n_samples:>9}{channel.duration_s:>7.2f} s"
                f"{channel.minimum:>11.4g}{channel.maximum:>11.4g}{channel.rms:>10.4g}{floor:>11}"
            )
        if self.coverage is not None:
            cells = self.coverage
            visited = f"{cells.covered} of {cells.seconds.size} cells visited ({cells.fraction:.0%})"
            ranges = f"speed {self.coverage.speed_in_words}, force {self.coverage.force_in_words}"
            lines.append(f"speed–force plane: {visited}, while moving in contact {ranges}")
        if self.carried:
            advice = f"; train with {self.options}" if self.options else ""
            lines.append(f"of the perceived power, {perception.in_words(self.carried)}{advice}")
        if self.cut_ms is not None:
            lines.append(f"training cuts it into {cut_in_words(*self.cut_ms)}; --block and --trim choose others")
        for severity in (UNUSABLE, PROBLEM, NOTE):
            lines += [f"{severity:<8} {f.text}" for f in self.findings if f.severity == severity]
        return "\n".join([*lines, self.verdict])


def places(channel: Channel, indices: NDArray[np.int64]) -> tuple[float, ...]:
    """Times of some samples [s], thinned evenly to `N_PLACES`."""
    if indices.size > N_PLACES:
        indices = indices[np.linspace(0, indices.size - 1, N_PLACES).astype(np.int64)]
    return tuple(round(float(t), 6) for t in channel.times[indices])


def runs(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Starts of stretches of True, and ends, one past the last."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    return edges[0::2], edges[1::2]


def swing(samples: Array, tail: float) -> float:
    """Range of a signal without a share of its samples at either end."""
    low, high = np.quantile(samples, [tail, 1 - tail])
    return float(high - low)
