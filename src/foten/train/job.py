"""What is to be learned from what, what each family makes of it before anything is fitted, and what a training gives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

import foten
from foten.families.sizes import Sizes
from foten.families.texture_file import Texture
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.recording import Recording
from foten.recording.split import MIN_BLOCKS, Split, split_blocks
from foten.recording.trace import Trace
from foten.train.blocks import ScaledBlocks, scaled_blocks
from foten.train.config import UNUSED, TrainConfig
from foten.train.epochs import Epoch, Progress
from foten.train.fit import TrainingWindows, fit

Stage = Callable[[str], None]


@dataclass(frozen=True)
class TrainingJob:
    """A recording, a model, and how the one is learned by the other."""

    recording: Recording
    model: str  # key of `families.FAMILIES`
    sizes: Sizes  # what training chooses is filled in there
    config: TrainConfig
    preprocess: PreprocessConfig = field(default_factory=PreprocessConfig)
    split_method: str = "regrouped"  # as `split_blocks` has it, and the next
    split_seed: int = 0
    texture_name: str = ""  # for the card, as the next
    licence: str = ""

    def blocks(self) -> ScaledBlocks:
        """Return the recording preprocessed, split and scaled.

        Raises:
            ValueError: it does not fit the configuration; the message names the option.
        """
        trace = preprocess(self.recording, self.preprocess, MIN_BLOCKS)
        return scaled_blocks(trace, split_blocks(trace, self.split_method, self.split_seed))

    def card(self, blocks: ScaledBlocks, device: str) -> dict[str, Any]:
        """Return the card but for what the model makes of it; no growth beyond the trained range."""
        recording, trace, split = self.recording, blocks.trace, blocks.split
        low, high = (end(blocks.training_blocks(), axis=(0, 1)).tolist() for end in (np.min, np.max))
        unused = UNUSED.get(self.model, ())
        settings = {name: value for name, value in asdict(self.config).items() if name not in unused}
        return {
            "rate_hz": trace.rate_hz,
            "trained_range": {"speed": [low[1], high[1]], "force": [low[2], high[2]]},
            "beyond_exponents": {"speed": 0.0, "force": 0.0},
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
    """Return the versions that a training depends on."""
    return {"foten": foten.__version__, "torch": torch.__version__, "numpy": np.__version__}


@dataclass(kw_only=True)
class Task:
    """A job after its preparation; one that is done with it needs no more than a texture."""

    job: TrainingJob
    blocks: ScaledBlocks
    playable: Texture | None = None  # a texture already, whose network adds nothing yet
    linear_mae: float | None = None  # its one-step validation error, scaled, where a network may lower it

    def fit(self, on_epoch: Callable[[Epoch], None], checkpoint: Path | None, resume: bool) -> Progress:
        """Fit what is to be fitted, in place; nothing here."""
        return Progress()

    def finish(self, progress: Progress, on_stage: Stage) -> Texture:
        """Return the texture."""
        assert self.playable is not None
        return self.playable


@dataclass(kw_only=True)
class NetworkTask(Task):
    """One with a network, which is fitted in place, and the windows that it is fitted to."""

    network: nn.Module
    windows: TrainingWindows

    def fit(self, on_epoch: Callable[[Epoch], None], checkpoint: Path | None, resume: bool) -> Progress:
        """Fit the network."""
        return fit(self.network, self.windows, self.job.config, on_epoch, checkpoint, resume)


@dataclass(frozen=True)
class Trained:
    """A trained texture and how it came about; `linear_mae` as the task had it."""

    texture: Texture
    trace: Trace
    split: Split
    progress: Progress
    linear_mae: float | None = None
