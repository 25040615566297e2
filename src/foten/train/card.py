"""What a texture's card says of the recording, whichever model learned from it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
import torch

import foten
from foten.recording.preprocess import PreprocessConfig
from foten.recording.recording import Recording
from foten.train.blocks import ScaledBlocks


def card_of(
    recording: Recording, blocks: ScaledBlocks, preprocess_config: PreprocessConfig, texture_name: str, licence: str
) -> dict[str, Any]:
    """Return the card's entries about a recording, its preprocessing and its split."""
    trace, split = blocks.trace, blocks.split
    low, high = (
        [end(trace.blocks(channel)[list(split.train)]).item() for channel in (trace.speed, trace.force)]
        for end in (np.min, np.max)
    )
    return {
        "rate_hz": trace.rate_hz,
        "trained_range": {"speed": [low[0], high[0]], "force": [low[1], high[1]]},
        "saturation": blocks.saturation,
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


def versions() -> dict[str, str]:
    """Return the versions that a training depends on."""
    return {"foten": foten.__version__, "torch": torch.__version__, "numpy": np.__version__}
