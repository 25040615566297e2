"""The paper's results, to print beside ours. Source: Tables I to III; no unit is stated for its errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Reported:
    """One method's figures as the paper prints them; None where it prints none.

    Attributes:
        mae, gfc: mean over its twelve textures; the GFC in %.
        gpu_ms, cpu_ms: of one inference.
        epoch_s: of one epoch of training.
    """

    mae: float | None = None
    gfc: float | None = None
    gpu_ms: float | None = None
    cpu_ms: float | None = None
    epoch_s: float | None = None


PAPER: Mapping[str, Reported] = {
    "ar": Reported(0.400, 86.28),
    "fnn": Reported(0.378, 87.83),
    "dstn": Reported(0.201, 90.33, 1.38, 1.89, 44.35),
    "ldhtd": Reported(0.178, 91.02, 1.13, 1.26, 27.45),
    "gan": Reported(0.298, 88.65, 1.72, 2.37, 85.71),
    "foten": Reported(0.149, 92.15, 0.96, 1.11, 10.26),
    "ten": Reported(0.318, 86.77, 0.87, 1.07, 8.92),
    "ten-mfcc": Reported(0.281, 90.28),
    "ten-wavelet": Reported(0.284, 86.18),
    "foten-d": Reported(0.193, 90.64, 1.16, 1.39, 14.81),
}
"""By model."""
