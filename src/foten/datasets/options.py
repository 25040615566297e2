"""What the user says about the files: `--map`, `--unit`, `--rate` and the others."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from foten.recording.recording import UNITS


@dataclass(frozen=True)
class ImportOptions:
    """What the user says about the files.

    Attributes:
        mapping: (channel, column) pairs, column as `COLUMN` or `FILE:COLUMN`; `time` may come once per file.
            Empty: guessed from the headers.
        units: by channel (or `time`): a unit, or `*FACTOR`, or `LABEL*FACTOR`.
        rate_hz: for channels whose file states no rate and has no time column.
        rates_hz: by channel; overrides what a file states.
        fill_gaps_ms: longest run of NaN, or of rows that are missing by their times, that is filled in position, speed and
            force; 0 fills none.
        force_units: accept values beyond `LIMITS`.
        texture, tool, sensors, notes: free text.
    """

    mapping: tuple[tuple[str, str], ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    rate_hz: float | None = None
    rates_hz: Mapping[str, float] = field(default_factory=dict)
    fill_gaps_ms: float = 0.0
    force_units: bool = False
    texture: str = ""
    tool: str = ""
    sensors: str = ""
    notes: str = ""

    def __post_init__(self) -> None:
        for channel in (*(name for name, _ in self.mapping), *self.units, *self.rates_hz):
            if channel not in UNITS and channel != "time":
                close = difflib.get_close_matches(channel, [*UNITS, "time"], n=1)
                hint = f"; did you mean {close[0]}?" if close else ""
                raise ValueError(f"unknown channel {channel!r}, expected time, {', '.join(UNITS)}{hint}")
        if "time" in self.rates_hz:
            raise ValueError("time has no rate; give it to a channel, e.g. --rate force=1000")
        names = [name for name, _ in self.mapping if name != "time"]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"{name} is mapped twice")
        for channel, rate in [("", self.rate_hz), *self.rates_hz.items()]:
            if rate is not None and not (np.isfinite(rate) and rate > 0):
                raise ValueError(f"rate {channel or 'of the recording'} is {rate:g} Hz, expected above 0")
        if not np.isfinite(self.fill_gaps_ms) or self.fill_gaps_ms < 0:
            raise ValueError(f"gaps to fill are {self.fill_gaps_ms:g} ms, expected 0 or more")


def parse_pairs(texts: Sequence[str], option: str) -> list[tuple[str, str]]:
    """Return `A=B,C=D` texts as pairs.

    Raises:
        ValueError: a piece without `=`.
    """
    pairs = []
    for piece in (piece.strip() for text in texts for piece in text.split(",")):
        if not piece:
            continue
        key, equals, value = piece.partition("=")
        if not equals or not key.strip() or not value.strip():
            raise ValueError(
                f"{option} {piece!r} is not CHANNEL=VALUE (a column whose name holds a comma goes by its number)"
            )
        pairs.append((key.strip(), value.strip()))
    return pairs


def parse_rates(texts: Sequence[str]) -> tuple[float | None, dict[str, float]]:
    """Return `HZ` and `CHANNEL=HZ` texts as the rate for all and the rates by channel.

    Raises:
        ValueError: not a number.
    """
    overall, by_channel = None, {}
    for piece in (piece.strip() for text in texts for piece in text.split(",")):
        if not piece:
            continue
        channel, equals, number = piece.rpartition("=")
        try:
            rate = float(number)
        except ValueError:
            raise ValueError(f"--rate {piece!r} is not HZ or CHANNEL=HZ, e.g. --rate 10000") from None
        if equals:
            by_channel[channel.strip()] = rate
        else:
            overall = rate
    return overall, by_channel
