"""Settings of the training of foten-plus; its epochs are of 100 steps, its batches of chunks."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from foten.training.config import GradientConfig

MAX_MICROPHONE_HZ = 2000.0  # rate of a texture above which it holds more of speech than we dare to store unasked
WITHHELD = "no recorded innovations are stored: speech near the microphone could be in them"


@dataclass(frozen=True)
class FotenPlusConfig(GradientConfig):
    """One training of foten-plus."""

    patience: int = 4
    batch: int = 64
    learning_rate: float = 4e-3
    weight_decay: float = 0.1
    max_order: int = 240  # samples that the lattice remembers at most
    table: bool = True  # try reflection coefficients that follow speed and force
    gain_before_filter: bool = True  # try the level before the lattice as well as after it
    tones: bool = True  # try tones of the path
    # Tried where noise is told from the recording: auto, not of a microphone above 2 kHz; always, of any; never.
    recorded_innovations: str = "auto"
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {
        **GradientConfig.choices,
        "recorded_innovations": ("auto", "always", "never"),
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_at_least(1, "max_order")


def withholds_recording(microphone: bool, rate_hz: float, recorded_innovations: str) -> bool:
    """Whether a texture's file holds no recorded innovations, since they could hold speech, unless they are asked for."""
    return microphone and rate_hz > MAX_MICROPHONE_HZ and recorded_innovations == "auto"
