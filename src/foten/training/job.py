"""What is to be learned from what, and what a training gives."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

import foten
from foten.models.model_sizes import ModelSizes
from foten.models.texture_file import Texture
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.recording import Recording
from foten.recording.split import MIN_BLOCKS, Split, split_blocks
from foten.recording.trace import Trace
from foten.training.blocks import ScaledBlocks, scaled_blocks
from foten.training.config import UNUSED, TrainConfig
from foten.training.loop import Progress


@dataclass(frozen=True)
class TrainingJob:
    """A recording, a model, and how the one is learned by the other."""

    recording: Recording
    model: str  # key of a model or a baseline
    sizes: ModelSizes  # what training chooses is filled in there
    config: TrainConfig
    preprocess: PreprocessConfig = field(default_factory=PreprocessConfig)
    split_method: str = "regrouped"  # as `split_blocks` has it, and the next
    split_seed: int = 0
    texture_name: str = ""  # for the card, as the next
    licence: str = ""

    def blocks(self) -> ScaledBlocks:
        """The recording preprocessed, split and scaled.

        Raises:
            ValueError: it does not fit the configuration; the message names the option.
        """
        trace = preprocess(self.recording, self.preprocess, MIN_BLOCKS)
        return scaled_blocks(trace, split_blocks(trace, self.split_method, self.split_seed))

    def card(self, blocks: ScaledBlocks, device: str) -> dict[str, Any]:
        """The card but for what the model makes of it; no growth beyond the trained range."""
        recording, trace, split = self.recording, blocks.trace, blocks.split
        low, high = (end(blocks.training_blocks(), axis=(0, 1)).tolist() for end in (np.min, np.max))
        unused = UNUSED.get(self.model, ())
        settings = {name: value for name, value in asdict(self.config).items() if name not in unused}
        return {
            "rate_hz": trace.rate_hz,
            "trained_range": {"speed": [low[1], high[1]], "force": [low[2], high[2]]},
            "extrapolation_exponents": {"speed": 0.0, "force": 0.0},
            "saturation": blocks.saturation,
            "lowpass_hz": self.preprocess.render_lowpass_hz,
            "delay_ms": self.preprocess.delay_ms,
            "units": {"acceleration": recording.unit("acceleration"), "speed": "mm/s", "force": "N"},
            "texture": self.texture_name or recording.texture,
            "tool": recording.tool,
            "sensors": recording.sensors,
            "notes": recording.notes,
            "licence": self.licence,
            "recording_sha256": trace.recording_sha256,
            "preprocess": dict(trace.preprocess),
            "split": asdict(split),
            "split_sha256": split.sha256(),
            "training": {**settings, "versions": versions(), "device": device},
        }


def versions() -> dict[str, str]:
    """The versions that a training depends on."""
    import torch

    return {"foten": foten.__version__, "torch": torch.__version__, "numpy": np.__version__}


@dataclass(frozen=True)
class Trained:
    """A trained texture and how it came about."""

    texture: Texture
    trace: Trace
    split: Split
    progress: Progress
    linear_mae: float | None = None  # one-step validation error without the network, scaled, where it may lower it


def check_block(blocks: ScaledBlocks, m: int) -> None:
    """Refuse blocks that are too short to hold enough windows."""
    block = blocks.trace.block
    if block < 5 * m:
        raise ValueError(
            f"a block of {block} samples is too short for windows of {m}, expected five times as long: "
            "use a longer --block or a shorter --window"
        )
