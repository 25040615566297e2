"""Apple's AHAP: a pattern of Core Haptics, in JSON.

An event lasts at most 30 s; the times of points count from their curve's. Source: Apple's documentation of Core Haptics.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from foten.atomic_write import write_json
from foten.dsp import Array
from foten.export.clip import Clip, envelopes_of

KEEPS = "AHAP keeps the envelope, not the waveform"
MAX_EVENT_S = 30.0
MAX_CURVE_POINTS = 16  # as Lofelt's and Meta's tools write them


def write_ahap(clip: Clip, path: Path) -> None:
    """Write a clip: one continuous event for each 30 s, its intensity and sharpness as curves."""
    envelopes = envelopes_of(clip)
    starts = np.arange(0.0, clip.duration_s, MAX_EVENT_S)
    pattern: list[dict[str, Any]] = [
        {
            "Event": {
                "Time": float(start),
                "EventType": "HapticContinuous",
                "EventDuration": float(min(MAX_EVENT_S, clip.duration_s - start)),
                "EventParameters": [
                    {"ParameterID": "HapticIntensity", "ParameterValue": 1.0},
                    {"ParameterID": "HapticSharpness", "ParameterValue": 0.0},
                ],
            }
        }
        for start in starts
    ]
    # Perceived intensity grows with less than the amplitude; Meta's tools take its square root.
    for name, points in (("Intensity", envelopes.amplitude), ("Sharpness", envelopes.frequency)):
        pattern += _curves(f"Haptic{name}Control", points)
    metadata = {"Project": "foten", "Description": json.dumps(dict(clip.about))}
    write_json(path, {"Version": 1.0, "Metadata": metadata, "Pattern": pattern})


def _curves(parameter: str, points: Array) -> list[dict[str, Any]]:
    curves = []
    for at in range(0, len(points) - 1, MAX_CURVE_POINTS - 1):
        some = points[at : at + MAX_CURVE_POINTS]
        begin = round(float(some[0, 0]), 6)
        rows = zip((some[:, 0] - some[0, 0]).round(6).tolist(), np.sqrt(some[:, 1]).round(4).tolist(), strict=True)
        control = [{"Time": time, "ParameterValue": value} for time, value in rows]
        curve = {"ParameterID": parameter, "Time": begin, "ParameterCurveControlPoints": control}
        curves.append({"ParameterCurve": curve})
    return curves
