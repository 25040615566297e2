"""Training job, its recording in scaled blocks, and the result of a training."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import foten
from foten.dsp import Array
from foten.models.conditions import MOVING_FORCE, MOVING_SPEED
from foten.models.model_sizes import ModelSizes
from foten.models.texture_file import Texture
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.recording import Recording
from foten.recording.scaling import Scaling, fit_scaling
from foten.recording.split import MIN_BLOCKS, Split, split_blocks
from foten.recording.trace import Trace
from foten.recording.windows import targets
from foten.training.config import TrainConfig

if TYPE_CHECKING:
    from foten.training.checkpoint import Progress


@dataclass(frozen=True)
class ScaledBlocks:
    """A recording, split in blocks and scaled."""

    trace: Trace
    split: Split
    scaling: Scaling  # of the training blocks
    samples: Array  # acceleration, speed and force, scaled, shape (n_blocks, block, 3)

    @property
    def known(self) -> tuple[int, ...]:
        """The numbers of the blocks that training may look at."""
        return (*self.split.train, *self.split.validation)

    @property
    def flat(self) -> Array:
        """The samples one after the other, shape (n, 3)."""
        return self.samples.reshape(-1, 3)

    @property
    def peak_sd(self) -> float:
        """The largest sample of the training blocks, in standard deviations."""
        return float(np.abs(self.samples[list(self.split.train), :, 0]).max())

    @property
    def saturation(self) -> float:
        """Limit that samples are cut to for safety, well beyond the recording, in standard deviations."""
        return max(12.0, 1.5 * self.peak_sd)

    def training_blocks(self) -> Array:
        """The training blocks in m/s², mm/s and N: (n_train, block, 3)."""
        return self.trace.stacked().reshape(self.samples.shape)[list(self.split.train)]

    def moving(self) -> NDArray[np.bool_]:
        """True where a rendering does not fade, shape (n_blocks, block)."""
        moving = (self.trace.speed >= MOVING_SPEED) & (self.trace.force >= MOVING_FORCE)
        return moving.reshape(self.samples.shape[:2])

    def targets(self, m: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Indices of the training and the validation samples that have m samples of their block before them."""
        block = self.trace.block
        return targets(self.split.train, block, m), targets(self.split.validation, block, m)

    def condition_before(self) -> tuple[Array, Array, Array]:
        """Speed [mm/s] and force [N] of the sample before, (n_blocks, block), and scaled, (n, 2); a block's first has its own."""
        channels = self.trace.blocks(self.trace.speed), self.trace.blocks(self.trace.force), self.samples[..., 1:]
        speed, force, scaled = (np.concatenate([channel[:, :1], channel[:, :-1]], axis=1) for channel in channels)
        return speed, force, scaled.reshape(-1, 2)

    def conditions_with_speed(self) -> Array:
        """Speed and force, scaled, and the speed [mm/s], as the kernel's loop takes them: (n_blocks, block, 3)."""
        speed = self.trace.blocks(self.trace.speed)
        return np.concatenate([self.samples[..., 1:], speed[..., None]], axis=2)


def scaled_blocks(trace: Trace, split: Split) -> ScaledBlocks:
    """A trace scaled by its training blocks."""
    scaling = fit_scaling(trace, split.train)
    samples = scaling.scale(trace.stacked())
    return ScaledBlocks(trace, split, scaling, samples.reshape(trace.n_blocks, trace.block, 3))


@dataclass(frozen=True)
class TrainingJob:
    """A recording, a model, and the configuration of its training."""

    recording: Recording
    model: str  # key of a model or a baseline
    sizes: ModelSizes  # what training chooses is filled in there
    config: TrainConfig
    preprocess: PreprocessConfig = field(default_factory=PreprocessConfig)
    split_method: str = "regrouped"  # as `split_blocks` has it, and the next
    split_seed: int = 0
    texture_name: str = ""  # for the card, as the next
    licence: str = ""
    credit: Mapping[str, str] = field(default_factory=dict)  # by the keys of `CREDIT`

    def blocks(self) -> ScaledBlocks:
        """The recording preprocessed, split and scaled.

        Raises:
            ValueError: it does not fit the configuration; the message names the option.
        """
        trace = preprocess(self.recording, self.preprocess, MIN_BLOCKS)
        return scaled_blocks(trace, split_blocks(trace, self.split_method, self.split_seed))

    def card(self, blocks: ScaledBlocks, device: str) -> dict[str, Any]:
        """The card's entries of recording and configuration; no growth beyond the trained range."""
        recording, trace, split = self.recording, blocks.trace, blocks.split
        low, high = (end(blocks.training_blocks(), axis=(0, 1)).tolist() for end in (np.min, np.max))
        return {
            "rate_hz": trace.rate_hz,
            "trained_range": {"speed": [low[1], high[1]], "force": [low[2], high[2]]},
            "extrapolation_exponents": {"speed": 0.0, "force": 0.0},
            "saturation": blocks.saturation,
            "lowpass_hz": self.preprocess.render_lowpass_hz,
            "delay_ms": self.preprocess.delay_ms,
            "units": {"acceleration": recording.unit("acceleration"), "speed": "mm/s", "force": "N"},
            **{name: getattr(recording, name) for name in ("tool", "sensors", "notes")},
            **{"texture": self.texture_name or recording.texture, "licence": self.licence},
            **self.credit,
            "recording_sha256": trace.recording_sha256,
            **({"takes": takes_entry(recording, trace)} if trace.take_blocks else {}),
            **({"microphone": True} if recording.microphone else {}),
            "preprocess": dict(trace.preprocess),
            "split": asdict(split),
            "split_sha256": split.sha256(),
            "training": {**asdict(self.config), "versions": versions(), "device": device},
        }


def takes_entry(recording: Recording, trace: Trace) -> list[dict[str, Any]]:
    """The card's entry of several takes: the name, digest, length [s] and number of blocks of each."""
    takes = zip(recording.takes, trace.take_blocks, strict=True)
    return [
        {"name": take.name, "sha256": take.sha256(), "seconds": round(take.duration_s, 3), "blocks": n}
        for take, n in takes
    ]


def versions() -> dict[str, str]:
    """The versions that a training depends on."""
    import torch

    return {"foten": foten.__version__, "torch": torch.__version__, "numpy": np.__version__}


@dataclass(frozen=True)
class Trained:
    """A trained texture and the log of its training."""

    texture: Texture
    trace: Trace
    split: Split
    progress: Progress
    linear_mae: float | None = None  # one-step validation error without the network, scaled, where it may lower it


def shortest_block(window: int) -> int:
    """Samples that a block has at least, to hold enough windows."""
    return 5 * window


def check_block(blocks: ScaledBlocks, m: int) -> None:
    """Refuse blocks that are too short to hold enough windows."""
    block = blocks.trace.block
    if block < shortest_block(m):
        raise ValueError(
            f"a block of {block} samples is too short for windows of {m}, expected five times as long: "
            "use a longer --block or a shorter --window"
        )
