"""The sound of a judgement: recorded and synthesized blocks as two WAV files at one gain."""

from __future__ import annotations

import io
import wave
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from foten.dsp.resample import decimate, interpolate
from foten.evaluate.evaluate import Judgement
from foten.evaluate.report.signals import scored_runs

Array = NDArray[np.float64]

AUDIO_HZ = 8000
AUDIO_S = 8.0  # of each player, at most
WAV_HEADER = 44  # bytes
_FADE_S = 0.004  # at block borders, so that the joints do not click
_PEAK = 0.9  # of full scale


def sounds(judgement: Judgement, name: str) -> tuple[bytes, bytes, float]:
    """Return the scored blocks as recorded and as synthesized, two WAV files, and the full scale of both [m/s²].

    8 kHz, 16 bit, one channel, up to 8 s; each block is faded at its ends.
    """
    runs, rate_hz = scored_runs(judgement), judgement.trace.rate_hz
    n_blocks = max(1, int(AUDIO_S * rate_hz / runs["recorded"].shape[2]))
    pair = [
        np.concatenate([_audible(block, rate_hz) for block in runs[key][0, :n_blocks]])[: int(AUDIO_S * AUDIO_HZ)]
        for key in ("recorded", name)
    ]
    peak = max(float(np.abs(samples).max()) for samples in pair)
    full_scale = peak / _PEAK if peak > 0 else 1.0
    first, second = (_wav(samples / full_scale) for samples in pair)
    return first, second, full_scale


def _audible(block: Array, rate_hz: float) -> Array:
    """Return a block at 8 kHz, faded at its ends."""
    factor = Fraction(AUDIO_HZ / rate_hz).limit_denominator(1000)
    # The rate that the factor stands for: within a thousandth of the true one, for an odd rate too.
    source_hz = AUDIO_HZ / float(factor)
    samples = interpolate(block, factor) if factor >= 1 else decimate(block, source_hz, AUDIO_HZ)
    n = min(round(_FADE_S * AUDIO_HZ), len(samples) // 2)
    ramp = (np.arange(n) + 0.5) / n
    samples[:n] *= ramp
    samples[len(samples) - n :] *= ramp[::-1]
    return samples


def _wav(samples: Array) -> bytes:
    buffer = io.BytesIO()
    with wave.open(buffer, "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(AUDIO_HZ)
        file.writeframes(np.round(samples * 32767).astype("<i2").tobytes())
    return buffer.getvalue()
