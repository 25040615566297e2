"""What a texture's card says of the recording, whichever model learned from it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from foten.recording.preprocess import PreprocessConfig
from foten.recording.recording import Recording
from foten.train.prepared import Prepared


def recorded_peak(prepared: Prepared) -> float:
    """Return the largest sample of the training blocks, in standard deviations."""
    return float(np.abs(prepared.samples[list(prepared.split.train), :, 0]).max())


def saturation_of(prepared: Prepared) -> float:
    """Return what samples are cut to, for safety only: well beyond what was recorded, in standard deviations."""
    return max(12.0, 1.5 * recorded_peak(prepared))


def card_of(
    recording: Recording,
    prepared: Prepared,
    preprocess_config: PreprocessConfig,
    texture_name: str,
    licence: str,
) -> dict[str, Any]:
    """Return the card's entries about a recording, its preprocessing and its split."""
    trace, split = prepared.trace, prepared.split
    low, high = (
        [end(trace.blocks(channel)[list(split.train)]).item() for channel in (trace.speed, trace.force)]
        for end in (np.min, np.max)
    )
    return {
        "rate_hz": trace.rate_hz,
        "trained_range": {"speed": [low[0], high[0]], "force": [low[1], high[1]]},
        "saturation": saturation_of(prepared),
        "lowpass_hz": preprocess_config.render_lowpass_hz,
        "delay_ms": preprocess_config.delay_ms,
        "texture": texture_name or recording.texture,
        "tool": recording.tool,
        "sensors": recording.sensors,
        "notes": recording.notes,
        "licence": licence,
        "recording_sha256": trace.recording_sha256,
        "preprocess": dict(trace.preprocess),
        "split": asdict(split),
        "split_sha256": split.sha256(),
    }
