"""For Android: a waveform of amplitudes, and an envelope of amplitude and frequency, in one JSON file.

    val vibration = VibrationEffect.createWaveform(timings, amplitudes, -1)     // "waveform", since Android 8
    val builder = VibrationEffect.WaveformEnvelopeBuilder()                     // "envelope", Android 16
    envelope.forEach { builder.addControlPoint(it.amplitude, it.frequency_hz, it.duration_ms) }

Keeps the envelope, not the waveform. Frequencies that a phone's profile does not have it leaves out: clamp them to
`getFrequencyProfile()`.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from foten.atomic_write import atomic_write
from foten.export.clip import Clip, envelopes_of

KEEPS = "Android's formats keep the envelope, not the waveform"
STEP_MS = 10  # of the waveform of amplitudes


def write_android(clip: Clip, path: Path) -> None:
    """Write a clip."""
    envelopes = envelopes_of(clip)
    times, levels = envelopes.amplitude.T
    n = max(1, int(np.ceil(1000 * clip.duration_s / STEP_MS)))
    middles = (np.arange(n) + 0.5) * STEP_MS / 1000
    amplitudes = np.round(255 * np.sqrt(np.interp(middles, times, levels))).astype(int)
    points = np.unique(np.maximum(1, np.round(1000 * times).astype(int)))
    durations = np.diff(points, prepend=0)
    document = {
        "format": "foten-android",
        "version": 1,
        "about": dict(clip.about),
        "waveform": {"timings_ms": [STEP_MS] * n, "amplitudes": amplitudes.tolist()},
        "envelope": [
            {"amplitude": round(float(a), 4), "frequency_hz": round(float(f), 1), "duration_ms": int(d)}
            for a, f, d in zip(
                np.interp(points / 1000, times, levels), envelopes.hertz(points / 1000), durations, strict=True
            )
        ],
    }
    with atomic_write(path) as part:
        part.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
