"""What is to be learned from what: one frozen value, and what a training gives."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from foten.families.sizes import Sizes
from foten.families.texture_file import Texture
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.recording import Recording
from foten.recording.split import Split, split_blocks
from foten.recording.trace import Trace
from foten.train.blocks import ScaledBlocks, scaled_blocks
from foten.train.card import card_of, versions
from foten.train.config import UNUSED, TrainConfig
from foten.train.epochs import Progress


@dataclass(frozen=True)
class TrainingJob:
    """A recording, a model, and how the one is learned by the other.

    Attributes:
        model: key of `families.FAMILIES`.
        sizes: of the model; what training chooses is filled in there.
        split_method, split_seed: as `split_blocks` has them.
        texture_name, licence: for the card.
    """

    recording: Recording
    model: str
    sizes: Sizes
    config: TrainConfig
    preprocess: PreprocessConfig = field(default_factory=PreprocessConfig)
    split_method: str = "regrouped"
    split_seed: int = 0
    texture_name: str = ""
    licence: str = ""

    def blocks(self) -> ScaledBlocks:
        """Return the recording preprocessed, split and scaled.

        Raises:
            ValueError: it does not fit the configuration; the message names the option.
        """
        trace = preprocess(self.recording, self.preprocess)
        return scaled_blocks(trace, split_blocks(trace, self.split_method, self.split_seed))

    def card(self, blocks: ScaledBlocks, device: str) -> dict[str, Any]:
        """Return the card but for what the model makes of it; no growth beyond the trained range."""
        unused = UNUSED.get(self.model, ())
        settings = {name: value for name, value in asdict(self.config).items() if name not in unused}
        return {
            **card_of(self.recording, blocks, self.preprocess, self.texture_name, self.licence),
            "beyond_exponents": {"speed": 0.0, "force": 0.0},
            "training": {**settings, "versions": versions(), "device": device},
        }


@dataclass(frozen=True)
class Trained:
    """A trained texture and how it came about."""

    texture: Texture
    trace: Trace
    split: Split
    progress: Progress
    linear_mae: float | None = None
    """One-step validation error of the linear part alone, scaled; None without one."""
