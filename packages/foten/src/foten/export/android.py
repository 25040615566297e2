"""For Android: a waveform of amplitudes, and an envelope of amplitude and frequency, in one JSON file.

Source: Android's reference of `VibratorEnvelopeEffectInfo` and `WaveformEnvelopeBuilder`; docs/tutorials/page.md plays it.
"""

from pathlib import Path

import numpy as np

from foten.atomic_write import write_json
from foten.dsp import Array
from foten.export.clip import Clip, envelopes_of

STEP_MS = 10  # of the waveform of amplitudes
MIN_POINT_MS = 20  # from one control point to the next; a phone may guarantee no less
KEEPS = (
    f"Android's formats keep the envelope, not the waveform: control points at least {MIN_POINT_MS} ms apart, of which a phone "
    "takes 16 or more at once (getMaxSize()); clamp their frequencies to its getFrequencyProfile()"
)


def write_android(clip: Clip, path: Path) -> None:
    """Write a clip; one shorter than 20 ms has one control point, of 20 ms."""
    envelopes = envelopes_of(clip)
    times, levels = envelopes.amplitude.T
    n = max(1, int(np.ceil(1000 * clip.duration_s / STEP_MS)))
    middles = (np.arange(n) + 0.5) * STEP_MS / 1000
    amplitudes = np.round(255 * np.sqrt(np.interp(middles, times, levels))).astype(int)
    last = max(MIN_POINT_MS, round(1000 * clip.duration_s))
    points = np.round(np.linspace(0, last, last // MIN_POINT_MS + 1)).astype(int)[1:]
    each_ms = (np.arange(last) + 0.5) / 1000
    document = {
        "format": "foten-android",
        "version": 1,
        "about": dict(clip.about),
        "waveform": {"timings_ms": [STEP_MS] * n, "amplitudes": amplitudes.tolist()},
        "envelope": [
            {"amplitude": round(float(a), 4), "frequency_hz": round(float(f), 1), "duration_ms": int(d)}
            for a, f, d in zip(
                _around(points, np.interp(each_ms, times, levels)),
                _around(points, envelopes.hertz(each_ms)),
                np.diff(points, prepend=0),
                strict=True,
            )
        ],
    }
    write_json(path, document)


def _around(points: Array, values: Array) -> Array:
    """Mean of values, one a ms, around each point [ms]: from halfway to the one before to halfway to the next."""
    begins = np.concatenate([points[:1] // 2, (points[:-1] + points[1:]) // 2])
    return np.add.reduceat(values, begins) / np.diff(begins, append=values.size)
