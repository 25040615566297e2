"""A job after its preparation: a network, what it is to be fitted to, and what makes a texture of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from torch import nn

from foten.families.texture_file import Texture
from foten.train.blocks import ScaledBlocks
from foten.train.epochs import Epoch, Progress
from foten.train.fit import TrainingWindows, fit
from foten.train.job import TrainingJob

Stage = Callable[[str], None]


@dataclass(kw_only=True)
class Task:
    """What each family adds to: one that is done with its preparation needs no more than a texture.

    Attributes:
        playable: a texture already, whose network adds nothing yet; None without one.
        linear_mae: one-step validation error of what is playable, scaled; None without a network to compare it with.
    """

    job: TrainingJob
    blocks: ScaledBlocks
    playable: Texture | None = None
    linear_mae: float | None = None

    def fit(self, on_epoch: Callable[[Epoch], None], checkpoint: Path | None, resume: bool) -> Progress:
        """Fit what is to be fitted, in place; nothing here."""
        return Progress()

    def finish(self, progress: Progress, on_stage: Stage) -> Texture:
        """Return the texture."""
        assert self.playable is not None
        return self.playable


@dataclass(kw_only=True)
class NetworkTask(Task):
    """One with a network.

    Attributes:
        network: fitted in place.
        windows: what it is fitted to.
    """

    network: nn.Module
    windows: TrainingWindows

    def fit(self, on_epoch: Callable[[Epoch], None], checkpoint: Path | None, resume: bool) -> Progress:
        """Fit the network."""
        return fit(self.network, self.windows, self.job.config, on_epoch, checkpoint, resume)
