"""The folder of a captured surface: the sound of a pen on it, the pen's events, and their description."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array

SOUND, PEN, ABOUT = "sound.wav", "pen.csv", "capture.json"


@dataclass(frozen=True)
class About:
    """Description of a capture: `capture.json`."""

    name: str  # of the texture
    rate_hz: float  # of the sound
    newtons: float = 0.13  # a and b of force = a exp(b pressure), Eq. 12
    steepness: float = 3.32
    full_scale_m_s2: float | None = None  # acceleration of a sample of 1; None where it is not known
    input: str = ""  # what the browser calls the input
    n_late_events: int = 0  # out of the order of time; of these only touches and lifts are in the file

    @classmethod
    def of(cls, message: Mapping[str, Any]) -> About:
        """Description in a checked `begin` message."""
        return cls(**{name: value for name, value in message.items() if name != "do"})


@dataclass(frozen=True)
class PenEvents:
    """Events of a pen on a tablet; all shapes (n,)."""

    times_s: Array  # by the pen's clock, increasing
    x_mm: Array
    y_mm: Array
    pressure: Array  # 0 … 1; 0 is lifted

    def touches(self) -> NDArray[np.int64]:
        """First event of each touch and the one after its last, shape (k, 2)."""
        edges = np.diff(self.pressure > 0, prepend=False, append=False)
        return np.flatnonzero(edges).reshape(-1, 2)

    @property
    def usual_step_s(self) -> float:
        """Usual time between two events of a touch [s]."""
        touching = (self.pressure[1:] > 0) & (self.pressure[:-1] > 0)
        steps = np.diff(self.times_s)[touching]
        return float(np.median(steps)) if steps.size else 0.01


def file_name(name: str) -> str:
    """File name of a texture: `Old denim, washed` → `old-denim-washed`."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:60] or "surface"
