"""How much a recording may hold: beyond these, a file is damaged, or a rate or a unit is wrong."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foten.recording.recording import Channel

LARGEST = 1e12  # of a sample in any unit; a converter of 32 bits counts to 4e9
LONGEST_S = 14_400.0  # of a channel: four hours
FASTEST_HZ = 1e7


def check_size(where: str, samples: NDArray[np.float64]) -> None:
    """Check that sums and squares of samples or times stay finite.

    Raises:
        ValueError: one is beyond `LARGEST`.
    """
    largest = int(np.abs(samples).argmax())
    if abs(samples[largest]) > LARGEST:
        raise ValueError(f"{where}: sample {largest} is {samples[largest]:.4g}, expected below {LARGEST:g}")


def check_length(where: str, channel: Channel) -> None:
    """Check that a channel lasts no longer than a hand strokes.

    Raises:
        ValueError: it lasts longer than `LONGEST_S`, or is faster than `FASTEST_HZ`.
    """
    if channel.rate_hz > FASTEST_HZ:
        raise ValueError(f"{where}: the rate is {channel.rate_hz:g} Hz, expected {FASTEST_HZ:g} at most; is it right?")
    if not channel.duration_s <= LONGEST_S:
        raise ValueError(
            f"{where}: {channel.samples.size} samples at {channel.rate_hz:g} Hz last {channel.duration_s:.4g} s, expected "
            f"{LONGEST_S:g} s at most; is the rate right, or was the time given in ms?"
        )
