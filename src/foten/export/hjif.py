"""MPEG's HJIF (ISO/IEC 23090-31): the waveform sample by sample, or a chirp that follows its envelopes.

Source: the members that the reference software reads and what its synthesizer does: a curve needs three keyframes or more and
position 0, and its last sample is not rendered, so that one more is written; a vectorial wave counts in milliseconds. A stroke
is a vibration in time; what MPEG calls a vibrotactile texture counts along the surface, and has no duration.
"""

from __future__ import annotations

import datetime
import json
from pathlib import Path
from typing import Any

import numpy as np

from foten.atomic_write import write_json
from foten.export.clip import MAX_FREQUENCY_HZ, MIN_FREQUENCY_HZ, Clip, envelopes_of

KEEPS = "HJIF as a curve keeps the waveform to 16 bits"
KEEPS_PARAMETRIC = "parametric HJIF keeps the envelope, as one tone of changing frequency, not the waveform"


def write_hjif(clip: Clip, path: Path, parametric: bool = False) -> None:
    """Write a clip: a keyframe a sample, or, `parametric`, amplitude and frequency at the points of its envelopes."""
    if parametric:
        band, timescale, (low, high) = _chirp(clip), 1000, (int(MIN_FREQUENCY_HZ), int(MAX_FREQUENCY_HZ))
    else:
        band, timescale, (low, high) = _curve(clip), round(clip.rate_hz), (0, round(clip.rate_hz / 2))
    band |= {"lower_frequency_limit": low, "upper_frequency_limit": high}
    channel = {
        "id": 0,
        "description": str(clip.about.get("stroke", "")),
        "gain": 1.0,
        "mixing_coefficient": 1.0,
        "body_part_mask": 0,
        "frequency_sampling": round(clip.rate_hz),
        "sample_count": int(clip.drive.size),
        "bands": [band],
    }
    perception = {
        "id": 0,
        "avatar_id": 1,
        "description": str(clip.about.get("texture", "")),
        "perception_modality": "Vibrotactile",
        "unit_exponent": -3,  # both are what a reader takes where they are left out; the timescale counts
        "perception_unit_exponent": 0,
        "reference_devices": [],
        "effect_library": [],
        "channels": [channel],
    }
    document = {
        "version": "2023",
        "profile": "Simple Parametric" if parametric else "Main",
        "level": 1,
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "description": json.dumps(dict(clip.about)),
        "timescale": timescale,
        "avatars": [{"id": 1, "lod": 0, "type": "Vibration"}],
        "perceptions": [perception],
        "syncs": [],
    }
    write_json(path, document, indent=None)


def _curve(clip: Clip) -> dict[str, Any]:
    drive = np.append(clip.drive, np.zeros(max(1, 3 - clip.drive.size)))
    keyframes = [
        {"relative_position": i, "amplitude_modulation": round(float(value), 6)} for i, value in enumerate(drive)
    ]
    effect = {"effect_type": "Basis", "position": 0, "keyframes": keyframes}
    return {"band_type": "Curve", "curve_type": "Linear", "effects": [effect]}


def _chirp(clip: Clip) -> dict[str, Any]:
    envelopes = envelopes_of(clip)
    times = np.unique(
        np.round(1000 * np.concatenate([envelopes.amplitude[:, 0], envelopes.frequency[:, 0]])).astype(int)
    )
    amplitude = np.interp(times / 1000, envelopes.amplitude[:, 0], envelopes.amplitude[:, 1])
    hertz = np.round(envelopes.hertz(times / 1000)).astype(int)
    keyframes = [
        # An amplitude here is that of a sine, whose RMS is less by √2.
        {
            "relative_position": int(t),
            "amplitude_modulation": round(min(1.0, float(a) * 2**0.5), 4),
            "frequency_modulation": int(f),
        }
        for t, a, f in zip(times, amplitude, hertz, strict=True)
    ]
    effect = {"effect_type": "Basis", "position": 0, "phase": 0.0, "base_signal": "Sine", "keyframes": keyframes}
    return {"band_type": "VectorialWave", "effects": [effect]}
