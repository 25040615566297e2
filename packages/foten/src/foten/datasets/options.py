"""Options of an import: `--map`, `--unit`, `--rate` and the others."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from foten.recording.recording import UNITS


@dataclass(frozen=True)
class ImportOptions:
    """Options of an import."""

    mapping: tuple[tuple[str, str], ...] = ()
    """(channel, column) pairs, column as `COLUMN` or `FILE:COLUMN`; `time` may come once per file. Empty: by the headers."""
    units: Mapping[str, str] = field(default_factory=dict)  # by channel or `time`: a unit, `*FACTOR`, `LABEL*FACTOR`
    rate_hz: float | None = None  # for channels whose file states no rate and has no time column
    rates_hz: Mapping[str, float] = field(default_factory=dict)  # by channel; overrides what a file states
    fill_gaps_ms: float = 0.0
    """Longest run of NaN, or of rows that are missing by their times, that is filled in position, speed and force; 0: none."""
    force_units: bool = False  # accept values beyond `LIMITS`
    normal: tuple[float, float, float] | None = None
    """Of the surface, in the axes of the force sensor, of any length; the normal force is along it. None: z."""

    def __post_init__(self) -> None:
        names = [name for name, _ in self.mapping]
        for channel in (*names, *self.units, *self.rates_hz):
            if channel not in UNITS and channel != "time":
                close = difflib.get_close_matches(channel, [*UNITS, "time"], n=1, cutoff=0.5)
                hint = f"; did you mean {close[0]}?" if close else ""
                raise ValueError(f"unknown channel {channel!r}, expected time, {', '.join(UNITS)}{hint}")
        if "time" in self.rates_hz:
            raise ValueError("time has no rate; give it to a channel, e.g. --rate force=1000")
        for name in names:
            if names.count(name) > 1 and name != "time":
                raise ValueError(f"{name} is mapped twice")
        for channel, rate in [("of the recording", self.rate_hz), *self.rates_hz.items()]:
            if rate is not None and not (np.isfinite(rate) and rate > 0):
                raise ValueError(f"rate {channel} is {rate:g} Hz, expected above 0")
        if self.normal is not None and not 0 < np.linalg.norm(self.normal) < np.inf:
            raise ValueError(f"the normal is {self.normal}, expected three finite numbers, not all 0")
        if not np.isfinite(self.fill_gaps_ms) or self.fill_gaps_ms < 0:
            raise ValueError(f"gaps to fill are {self.fill_gaps_ms:g} ms, expected 0 or more")


def _pieces(texts: Sequence[str]) -> list[str]:
    return [piece.strip() for text in texts for piece in text.split(",") if piece.strip()]


def parse_pairs(texts: Sequence[str], option: str) -> list[tuple[str, str]]:
    """Pairs of texts `A=B,C=D`; ValueError where a piece has no `=`."""
    pairs = []
    for piece in _pieces(texts):
        key, _, value = piece.partition("=")
        if not key.strip() or not value.strip():
            raise ValueError(f"{option} {piece!r} is not CHANNEL=VALUE (a column name with a comma goes by its number)")
        pairs.append((key.strip(), value.strip()))
    return pairs


def parse_rates(texts: Sequence[str]) -> tuple[float | None, dict[str, float]]:
    """Rate for all channels and rates by channel, of texts `HZ` and `CHANNEL=HZ`; ValueError where one is no number."""
    overall, by_channel = None, {}
    for piece in _pieces(texts):
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


def parse_normal(text: str) -> tuple[float, float, float]:
    """Normal of a text `X,Y,Z`; ValueError where it is none."""
    try:
        x, y, z = map(float, text.split(","))
    except ValueError:
        raise ValueError(f"--normal is {text!r}, expected x,y,z such as 0,0,1") from None
    return x, y, z
