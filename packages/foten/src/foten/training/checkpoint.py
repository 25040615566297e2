"""Log of a training, and its state on disk, from which a stopped one goes on."""

from __future__ import annotations

import io
import math
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from foten.atomic_write import atomic_write, reason
from foten.training.config import TrainConfig


@dataclass(frozen=True)
class Epoch:
    """One line of the log; epoch 0 is the network before training.

    Losses are one-step; of foten-plus they are the nll of innovations [nat]. `validation_mae` is of scaled acceleration, of a
    model of spectra of log magnitudes [nat].
    """

    epoch: int
    train_loss: float
    validation_loss: float
    validation_mae: float
    seconds: float
    best: bool


@dataclass
class Progress:
    """Log of a loop, its best weights, and its notes."""

    epochs: list[Epoch] = field(default_factory=list)
    best_loss: float = math.inf
    best_state: dict[str, Tensor] = field(default_factory=dict)
    interrupted: bool = False
    notes: list[str] = field(default_factory=list)  # about the training, beside its log, a line each

    @property
    def best(self) -> Epoch:
        """The epoch whose weights are kept."""
        return next(line for line in reversed(self.epochs) if line.best)

    def include(self, later: Progress) -> None:
        """Take over the interruption and the new notes of a later loop of the same training."""
        self.interrupted |= later.interrupted
        self.notes += [note for note in later.notes if note not in self.notes]

    def add(self, network: nn.Module, epoch: int, train_loss: float, loss: float, error: float, seconds: float) -> None:
        """Add an epoch to the log, and keep the network's weights where its validation loss is the lowest yet."""
        best = loss < self.best_loss
        if best:
            self.best_loss = loss
            self.best_state = {name: tensor.detach().clone() for name, tensor in network.state_dict().items()}
        self.epochs.append(Epoch(epoch, train_loss, loss, error, seconds, best))


class Checkpoint:
    """State of a training, written after each epoch: of one loop, or of several by name.

    Raises:
        ValueError: there is one to go on from, and it is damaged or was written under another configuration.
    """

    def __init__(
        self, path: Path, config: TrainConfig, resume: bool = False, about: Mapping[str, Any] | None = None
    ) -> None:
        """`about` is what else has to be the same to go on: numbers, texts and dictionaries of them."""
        self._path, self._loops, self._started = path, dict[str, Any](), time.perf_counter()
        self._of = {"config": asdict(config), "about": dict(about or {})}
        if not resume:
            return
        try:
            content = dict(torch.load(path, weights_only=True, map_location="cpu"))
        except Exception as error:  # of many kinds, by what the bytes are
            raise ValueError(f"{path.name} is damaged and cannot be resumed; delete it and start again") from error
        if not {"loops", *self._of} <= content.keys():
            raise ValueError(f"{path.name} is of another version of foten; delete it and start again")
        if {key: content[key] for key in self._of} != self._of:
            raise ValueError(f"{path.name} was written by a run with other settings; resume with the same ones")
        self._loops = dict(content["loops"])

    @classmethod
    def going_on(cls, path: Path, config: TrainConfig, about: Mapping[str, Any]) -> Checkpoint:
        """The checkpoint at a path to go on from where it is of this very training, otherwise a new one."""
        if path.exists():
            with suppress(ValueError):
                return cls(path, config, resume=True, about=about)
        return cls(path, config, about=about)

    def elapsed_s(self) -> float:
        """How long the training has taken, what an earlier process did included, and what was done twice counted once."""
        return time.perf_counter() - self._started

    def load(self, name: str, parts: Mapping[str, Any]) -> Progress:
        """Log of a loop, every part put into its state; an empty one where the loop had not begun."""
        if name not in self._loops:
            return Progress()
        state = self._loops[name]
        if set(state["parts"]) != set(parts):
            raise ValueError(f"{self._path.name} is of another version of foten; delete it and start again")
        try:
            for key, part in parts.items():
                part.load_state_dict(state["parts"][key])
            torch.set_rng_state(state["random"])  # which the initial weights of a network after this one come from
            self._started = time.perf_counter() - state["seconds"]
        except KeyError as error:
            raise ValueError(f"{self._path.name} is of another version of foten; delete it and start again") from error
        return Progress([Epoch(**line) for line in state["epochs"]], state["best_loss"], state["best_state"])

    def save(self, name: str, parts: Mapping[str, Any], progress: Progress) -> None:
        """Write the state and log of a loop beside those of the loops before it; a full disk gives one note."""
        self._loops[name] = {
            "parts": {key: part.state_dict() for key, part in parts.items()},
            "random": torch.get_rng_state(),
            "seconds": self.elapsed_s(),
            "epochs": [asdict(epoch) for epoch in progress.epochs],
            "best_loss": progress.best_loss,
            "best_state": progress.best_state,
        }
        content = io.BytesIO()  # PyTorch's own writer does not say that a disk is full
        torch.save({**self._of, "loops": self._loops}, content)
        try:
            with atomic_write(self._path) as part:
                part.write_bytes(content.getbuffer())
        except OSError as error:
            if not progress.notes:
                progress.notes.append(f"{reason(error)}; the training went on without its checkpoint")
