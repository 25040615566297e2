"""The loop of epochs: the best validation loss kept, a checkpoint after each, and when to stop."""

from __future__ import annotations

import csv
import io
import math
import pickle
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

import torch
from torch import Tensor, nn

from foten.atomic_write import atomic_write, reason
from foten.training.config import TrainConfig


@dataclass(frozen=True)
class Epoch:
    """One line of the log; epoch 0 is the network before training.

    Losses are one-step, of the target's errors (foten-plus: in units of the lattice's innovation, so that a slow light stroke is
    predicted as carefully as a fast hard one); `validation_mae` is of scaled acceleration, or of what else is the target: log
    magnitudes [nat] of a model of spectra.
    """

    epoch: int
    train_loss: float
    validation_loss: float
    validation_mae: float
    seconds: float
    best: bool


@dataclass
class Progress:
    """Everything that a run needs to go on where it stopped."""

    epochs: list[Epoch] = field(default_factory=list)
    best_loss: float = math.inf
    best_state: dict[str, Tensor] = field(default_factory=dict)
    interrupted: bool = False
    notes: list[str] = field(default_factory=list)  # what is to be said of the training beside its log, a line each

    @property
    def best(self) -> Epoch:
        """Return the epoch whose weights are kept."""
        return next(line for line in reversed(self.epochs) if line.best)

    def add(self, network: nn.Module, epoch: int, train_loss: float, loss: float, error: float, seconds: float) -> None:
        """Add an epoch to the log, and keep the network's weights where its validation loss is the lowest yet."""
        best = loss < self.best_loss
        if best:
            self.best_loss = loss
            self.best_state = {name: tensor.detach().clone() for name, tensor in network.state_dict().items()}
        self.epochs.append(Epoch(epoch, train_loss, loss, error, seconds, best))


class Stateful(Protocol):
    """What a checkpoint keeps: a network, an optimiser, a schedule."""

    def state_dict(self) -> dict[str, Any]: ...

    def load_state_dict(self, state: dict[str, Any], /) -> Any: ...


def goes_on(progress: Progress, config: TrainConfig) -> bool:
    """Return whether another epoch may gain anything; where none has, the progress says so in a note.

    None does where the last `patience` epochs brought no better loss, or where the first `probation` ones lowered the error by
    less than `least_gain`: what a lattice leaves of a linear process is noise, and a network learns nothing from it however long.
    """
    epoch, first = progress.epochs[-1].epoch, progress.epochs[0].validation_mae
    if epoch - progress.best.epoch >= config.patience:
        return False
    gained = 1 - min(line.validation_mae for line in progress.epochs) / first if first > 0 else 0.0
    if epoch != config.probation or gained >= config.least_gain:
        return True
    progress.notes.append(
        f"the network gains {100 * gained:.2f} % on the validation blocks in {epoch} epochs, less than "
        f"{100 * config.least_gain:g} %: its training stops there"
    )
    return False


def run_epochs(
    network: nn.Module,
    config: TrainConfig,
    parts: Mapping[str, Stateful],
    one_epoch: Callable[[int], float],
    validate: Callable[[], tuple[float, float]],
    on_epoch: Callable[[Epoch], None],
    checkpoint: Path | None,
    resume: bool,
) -> Progress:
    """Run epochs until there are enough, none gains, or Ctrl-C; leave a network at its best validation loss.

    Args:
        parts: what a checkpoint holds.
        one_epoch: trains for the epoch of that number, and returns its loss.
        validate: returns the validation loss and the error of the log [`Epoch.validation_mae`].

    Raises:
        ValueError: a loss is not finite, or the checkpoint is another run's.
        KeyboardInterrupt: before anything was validated.
    """
    progress = Progress()
    if checkpoint is not None and resume:
        progress = load_progress(checkpoint, config, parts)
        for line in progress.epochs:
            on_epoch(line)

    def finish(epoch: int, train_loss: float, started: float) -> None:
        network.eval()
        loss, error = validate()
        progress.add(network, epoch, train_loss, loss, error, time.perf_counter() - started)
        on_epoch(progress.epochs[-1])

    try:
        if not progress.epochs:
            finish(0, math.nan, time.perf_counter())
        for epoch in range(len(progress.epochs), config.epochs + 1):
            # Of a validation that is not finite, nothing that follows is.
            if not progress.best_state or not goes_on(progress, config):
                break
            started = time.perf_counter()
            network.train()
            finish(epoch, one_epoch(epoch), started)
            if not math.isfinite(progress.epochs[-1].train_loss):
                raise ValueError("the training loss is not finite; is the acceleration full of outliers?")
            if checkpoint is not None:
                try:
                    save_progress(checkpoint, config, parts, progress)
                except OSError as error:  # of a full disk, say: the training is worth more, and one note enough
                    if not progress.notes:
                        progress.notes.append(f"{reason(error)}; the training went on without its checkpoint")
    except KeyboardInterrupt:
        if not progress.best_state:
            raise
        progress.interrupted = True
    if not progress.best_state:
        raise ValueError("the validation loss is not finite; is the acceleration full of outliers?")
    network.load_state_dict(progress.best_state)
    network.eval()
    return progress


def write_log(path: Path, epochs: list[Epoch]) -> None:
    """Write the log as CSV."""
    with atomic_write(path) as part, part.open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(Epoch.__dataclass_fields__))
        writer.writeheader()
        writer.writerows(asdict(epoch) for epoch in epochs)


def save_progress(path: Path, config: TrainConfig, parts: Mapping[str, Stateful], progress: Progress) -> None:
    """Write a checkpoint: the state of every part, and the log."""
    saved = io.BytesIO()  # PyTorch's own writer says of a full disk only that its archive is inconsistent
    torch.save(
        {
            "config": asdict(config),
            "parts": {name: one.state_dict() for name, one in parts.items()},
            "epochs": [asdict(epoch) for epoch in progress.epochs],
            "best_loss": progress.best_loss,
            "best_state": progress.best_state,
        },
        saved,
    )
    with atomic_write(path) as part:
        part.write_bytes(saved.getbuffer())


def load_progress(path: Path, config: TrainConfig, parts: Mapping[str, Stateful]) -> Progress:
    """Return the log of a checkpoint, and put every part into its state; refuse one that is damaged or of other settings.

    Raises:
        ValueError: it is damaged, or was written under another configuration.
    """
    try:
        saved = torch.load(path, weights_only=True, map_location="cpu")
    except (pickle.UnpicklingError, RuntimeError, EOFError, OSError) as error:
        raise ValueError(f"{path.name} is damaged and cannot be resumed; delete it and start again") from error
    if saved.get("config") != asdict(config):
        raise ValueError(f"{path.name} was written by a run with other settings; resume with the same ones")
    if set(saved.get("parts", ())) != set(parts):
        raise ValueError(f"{path.name} is of another version of foten; delete it and start again")
    for name, one in parts.items():
        one.load_state_dict(saved["parts"][name])
    return Progress([Epoch(**line) for line in saved["epochs"]], saved["best_loss"], saved["best_state"])
