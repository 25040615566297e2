"""MPEG's HJIF (ISO/IEC 23090-31): the waveform sample by sample, or a chirp that follows its envelopes.

Source: the reference software: a curve needs three keyframes or more and position 0, and its last sample is not rendered, so
that one more is written; a vectorial wave counts in milliseconds.
"""

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
        "description": "; ".join(str(clip.about[key]) for key in ("texture", "made") if key in clip.about),
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
    values = enumerate(drive.round(6).tolist())
    keyframes = [{"relative_position": i, "amplitude_modulation": value} for i, value in values]
    effect = {"effect_type": "Basis", "position": 0, "keyframes": keyframes}
    return {"band_type": "Curve", "curve_type": "Linear", "effects": [effect]}


def _chirp(clip: Clip) -> dict[str, Any]:
    envelopes = envelopes_of(clip)
    points_s = np.concatenate([envelopes.amplitude[:, 0], envelopes.frequency[:, 0]])
    times = np.unique(np.round(1000 * points_s).astype(int))
    # An amplitude here is that of a sine, whose RMS is less by √2.
    amplitude = np.minimum(1.0, 2**0.5 * np.interp(times / 1000, *envelopes.amplitude.T)).round(4)
    hertz = np.round(envelopes.hertz(times / 1000)).astype(int)
    members = ("relative_position", "amplitude_modulation", "frequency_modulation")
    rows = zip(times.tolist(), amplitude.tolist(), hertz.tolist(), strict=True)
    keyframes = [dict(zip(members, row, strict=True)) for row in rows]
    effect = {"effect_type": "Basis", "position": 0, "phase": 0.0, "base_signal": "Sine", "keyframes": keyframes}
    return {"band_type": "VectorialWave", "effects": [effect]}
