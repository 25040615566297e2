"""Noise floors: the part of a channel that its sensor made."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from foten.recording.inspection.hand import Hand
from foten.recording.inspection.values import NOTE, PROBLEM, ChannelReport, Finding
from foten.recording.preprocess import times_of
from foten.recording.recording import Channel

FRAME_S = 0.05  # in which the level of an acceleration is measured

Array = NDArray[np.float64]


def slow_noise(samples: Array) -> float:
    """Return the RMS of white noise on a slow signal, from its third differences.

    White noise of variance s² has third differences of variance (1+9+9+1)·s²; those of the hand's movement are next to zero.
    """
    if samples.size < 4:
        return 0.0
    return float(1.4826 * np.median(np.abs(np.diff(samples, 3))) / np.sqrt(20))


def noise_floor(name: str, channel: Channel, hand: Hand | None) -> tuple[float, str]:
    """Return the RMS of a channel's noise, and how it was estimated: `rest`, `quietest 5 %` or `differences`."""
    x = channel.samples
    if not name.startswith("acceleration"):
        return slow_noise(x), "differences"
    frame = max(2, round(FRAME_S * channel.rate_hz))
    frames = x[: x.size - x.size % frame].reshape(-1, frame) if x.size >= frame else x[None, :]
    levels = frames.std(axis=1)  # about each frame's mean: gravity is no noise
    if hand is not None:
        starts = times_of(channel)[:: frames.shape[1]][: levels.size]
        still = hand.still.astype(np.float64)
        quiet = np.all(
            [np.interp(starts + late, hand.times_s, still, left=0, right=0) == 1 for late in (0, FRAME_S / 2)], axis=0
        )
        if quiet.sum() >= 4:
            return float(np.median(levels[quiet])), "rest"
    return float(np.quantile(levels, 0.05)), "quietest 5 %"


def check_noise(reports: Iterable[ChannelReport]) -> Iterable[Finding]:
    """Yield a problem for an acceleration hardly above its noise, and a note where the noise has only a bound."""
    for report in reports:
        if not report.name.startswith("acceleration"):
            continue
        vibration = float(np.sqrt(max(report.rms**2 - report.mean**2, 0.0)))
        if report.noise_floor_from != "rest":
            text = (
                f"{report.name}: no rest was found, so the noise floor is only known to lie below {report.noise_floor:.3g} m/s² "
                "(the quietest twentieth)"
            )
            yield Finding(NOTE, "noise", report.name, text)
        elif vibration < 2 * report.noise_floor:
            text = (
                f"{report.name}: its level, {vibration:.3g} m/s², is hardly above the {report.noise_floor:.3g} m/s² "
                "at rest: most of it is sensor noise"
            )
            yield Finding(PROBLEM, "noise", report.name, text)
