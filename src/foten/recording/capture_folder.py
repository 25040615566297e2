"""The folder of a captured surface: the sound of a pen on it, the pen's events, and what is known of both."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

SOUND, PEN, ABOUT = "sound.wav", "pen.csv", "capture.json"


@dataclass(frozen=True)
class About:
    """What is known of a capture: `capture.json`."""

    name: str  # of the texture
    rate_hz: float  # of the sound
    newtons: float = 0.13  # a and b of force = a exp(b pressure), Eq. 12
    steepness: float = 3.32
    full_scale_m_s2: float | None = None  # acceleration of a sample of 1; None where it is not known
    input: str = ""  # what the browser calls the input
    n_late_events: int = 0  # that came after one of a later time, and are not in the file but for touches and lifts

    @classmethod
    def of(cls, message: Mapping[str, Any]) -> About:
        """`About` of a checked message `begin`."""
        return cls(**{name: value for name, value in message.items() if name != "do"})


def file_name(name: str) -> str:
    """A texture's name as a file's: `Old denim, washed` → `old-denim-washed`."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:60] or "surface"
