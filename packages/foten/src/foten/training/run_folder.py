"""The run folder of one training and its display on the terminal."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from foten.atomic_write import atomic_write, reason
from foten.training.checkpoint import Epoch
from foten.training.job import Trained


class RunFolder:
    """Folder of ``config.json``, ``log.csv`` and, at the end, ``split.json`` and ``curves.png``; ``checkpoint.pt`` until then.

    A failure to write after the first line of the log gives a note, and the training goes on.
    """

    def __init__(self, path: Path, on_note: Callable[[str], None] = lambda text: None) -> None:
        self.path, self.checkpoint = path, path / "checkpoint.pt"
        self._on_note, self._noted, self._begun = on_note, False, False
        self._config = ""
        self._epochs: list[Epoch] = []

    def open(self, config: Mapping[str, Any], resume: bool) -> None:
        """Refuse what a run with this configuration cannot use; nothing is written yet.

        Raises:
            ValueError: the path is a file, or there is nothing to resume, or the settings differ.
        """
        if self.path.exists() and not self.path.is_dir():
            raise ValueError(f"the run folder {self.path} is a file")
        self._config = json.dumps(config, indent=1, sort_keys=True) + "\n"
        interrupted = self.checkpoint.exists()
        if interrupted and not resume:
            raise ValueError(f"{self.path} holds an interrupted training: continue with --resume, or delete the folder")
        if resume and not interrupted:
            raise ValueError(f"nothing to resume: {self.checkpoint} does not exist")
        if resume and (self.path / "config.json").read_text() != self._config:
            raise ValueError(f"{self.path} was trained with other settings, see its config.json; resume with those")

    def log(self, epoch: Epoch) -> None:
        """Add one line to the log on disk, a teacher's until its student begins.

        Raises:
            OSError: the first line cannot be written.
        """
        if not self._begun:
            self.path.mkdir(parents=True, exist_ok=True)
            with atomic_write(self.path / "config.json") as part:
                part.write_text(self._config)
        if epoch.epoch == 0:
            self._epochs.clear()
        self._epochs.append(epoch)
        try:
            _write_log(self.path / "log.csv", self._epochs)
        except OSError as error:
            if not self._begun:
                raise
            if not self._noted:
                self._on_note(f"{reason(error)}; the training continues without its log")
            self._noted = True
        self._begun = True

    def close(self, trained: Trained) -> None:
        """Write log, split and curves where the disk allows; delete the checkpoint unless the run was interrupted."""
        try:
            _write_log(self.path / "log.csv", trained.progress.epochs)
            trained.split.save(self.path / "split.json")
            _draw_curves(self.path / "curves.png", trained)
        except OSError as error:
            self._on_note(f"{reason(error)}; the run folder is not complete")
        if not trained.progress.interrupted:
            self.checkpoint.unlink(missing_ok=True)


def _write_log(path: Path, epochs: list[Epoch]) -> None:
    with atomic_write(path) as part, part.open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(Epoch.__dataclass_fields__))
        writer.writeheader()
        writer.writerows(asdict(epoch) for epoch in epochs)


def _draw_curves(path: Path, trained: Trained) -> None:
    from matplotlib.figure import Figure

    epochs, of_spectra = trained.progress.epochs, not trained.texture.predicts_samples
    figure = Figure(figsize=(8, 4), layout="constrained")
    loss, error = figure.subplots(1, 2)
    numbers = [line.epoch for line in epochs]
    validation: dict[str, Any] = {"marker": "s", "ms": 3, "color": "#D55E00"}
    loss.plot(numbers, [line.train_loss for line in epochs], "o-", ms=3, color="#0072B2", label="training")
    loss.plot(numbers, [line.validation_loss for line in epochs], label="validation", **validation)
    loss.set(xlabel="epoch", ylabel="loss of spectra" if of_spectra else "one-step loss")
    losses = [value for line in epochs for value in (line.train_loss, line.validation_loss) if not math.isnan(value)]
    # Within a factor of three a logarithmic axis has no ticks to read; a likelihood may be negative.
    if 0 < 3 * min(losses) < max(losses):
        loss.set_yscale("log")
    error.plot(numbers, [line.validation_mae for line in epochs], label="network", **validation)
    if trained.linear_mae is not None:
        error.axhline(trained.linear_mae, ls="--", color="#009E73", label="without the network")
    what = "validation error of spectra [nat]" if of_spectra else "one-step validation error, scaled"
    error.set(xlabel="epoch", ylabel=what)
    for axes in (loss, error):
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, frameon=False)
        axes.xaxis.get_major_locator().set_params(integer=True)
    with atomic_write(path) as part:
        figure.savefig(part, format="png", dpi=120, metadata={"Software": None})


class TrainingDisplay:
    """The training on stderr: on a terminal a bar with the remaining time, elsewhere a line for each stage and epoch."""

    def __init__(self, epochs: int, unit: str = "sd") -> None:
        self._epochs, self._unit, self._stage = epochs, unit, ""
        self._console = Console(stderr=True)
        done = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[error]}"))
        times = (TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
        self._bar = Progress(*done, *times, console=self._console)
        self._task = self._bar.add_task("reading", total=None, error="")

    def __enter__(self) -> TrainingDisplay:
        if self._console.is_terminal:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._console.is_terminal:
            self._bar.stop()

    def note(self, text: str) -> None:
        self._console.print(text, highlight=False, soft_wrap=True)

    def stage(self, name: str) -> None:
        self._stage = name
        self._bar.update(self._task, description=name)
        if not self._console.is_terminal:
            self.note(f"{name} …")

    def show(self, line: Epoch) -> None:
        train = "        " if math.isnan(line.train_loss) else f"{line.train_loss:.6f}"
        error = f"error {line.validation_mae:.4f} {self._unit}"
        shown = f"{error}, best" if line.best else error
        what = self._stage if self._stage.startswith("training the ") else "training the network"
        self._bar.update(self._task, description=what, total=self._epochs, completed=line.epoch, error=shown)
        if not self._console.is_terminal:
            self.note(
                f"epoch {line.epoch:3d}/{self._epochs}  loss {train} {line.validation_loss:.6f}  "
                f"{error}  {line.seconds:5.1f} s{'  best' if line.best else ''}"
            )
