"""Apple's AHAP: a pattern of Core Haptics, in JSON.

Source: Apple's documentation of Core Haptics. A curve has at most 16 points, as Lofelt's and Meta's tools write them; an event
lasts at most 30 s. The times of points count from their curve's.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from foten.atomic_write import write_json
from foten.dsp import Array
from foten.export.clip import Clip, envelopes_of

KEEPS = "AHAP keeps the envelope, not the waveform"
MAX_EVENT_S = 30.0
MAX_CURVE_POINTS = 16  # of a curve


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
    # What skin feels grows with less than the amplitude: the square root is what Meta's tools use.
    for name, points in (("Intensity", envelopes.amplitude), ("Sharpness", envelopes.frequency)):
        pattern += _curves(f"Haptic{name}Control", points, np.sqrt)
    document = {
        "Version": 1.0,
        "Metadata": {"Project": "foten", "Description": json.dumps(dict(clip.about))},
        "Pattern": pattern,
    }
    write_json(path, document)


def _curves(parameter: str, points: Array, mapped: Any) -> list[dict[str, Any]]:
    curves = []
    for at in range(0, len(points) - 1, MAX_CURVE_POINTS - 1):
        some = points[at : at + MAX_CURVE_POINTS]
        control = [
            {"Time": round(float(t - some[0, 0]), 6), "ParameterValue": round(float(mapped(value)), 4)}
            for t, value in some
        ]
        curve = {"ParameterID": parameter, "Time": round(float(some[0, 0]), 6), "ParameterCurveControlPoints": control}
        curves.append({"ParameterCurve": curve})
    return curves
