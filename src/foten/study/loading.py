"""A study ready to run: its file, its stimuli, the output, and its database, which has to be of this very file."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foten import __version__
from foten.console import check_folders
from foten.runtime.actuator import read_profile
from foten.studio.players import OutputDevice, white_noise
from foten.study.design import Design, Output, read_design
from foten.study.orders import Trial, planned
from foten.study.schema import create
from foten.study.stimuli import Stimuli, changed, load_stimuli
from foten.study.store import Store


@dataclass(frozen=True)
class Study:
    """A study file, and what it names."""

    path: Path
    text: str
    design: Design
    stimuli: Stimuli
    output: OutputDevice | None  # None where the pages play

    def orders(self) -> list[list[Trial]]:
        """Trials of the participants, and of some more for those who leave."""
        design, counts = self.design, (len(self.design.textures), len(self.design.methods))
        return planned(design.participants, *counts, design.seed, design.practice, design.order)

    def noise(self) -> AbstractContextManager[Any]:
        """A context in which white noise plays, where the study asks for it."""
        noise = self.design.noise
        return nullcontext() if noise is None else white_noise(noise.level_db, noise.device)

    def check_devices(self) -> None:
        """Open what plays once, and give it back."""
        if self.output is not None:
            self.output.check()
        with self.noise():
            pass

    def open_store(self, database: Path, simulated: bool = False) -> Store:
        """The study's database: a new file, or one that is there and is of this very study.

        Raises:
            ValueError: the file is of another study, or its ratings are not simulated as these are.
        """
        if not database.exists():
            check_folders([database])
            design = (self.design.title, self.text, self.path.parent, self.design.seed)
            create(database, *design, self.stimuli.listed, self.orders(), __version__, simulated)
        store = Store(database, __version__)
        try:
            self._check_is_of_this_study(store, simulated)
        except BaseException:
            store.close()
            raise
        return store

    def _check_is_of_this_study(self, store: Store, simulated: bool) -> None:
        database = store.path
        if store.simulated != simulated:
            has = "simulated" if store.simulated else "real"
            raise ValueError(f"{database} holds {has} ratings, which stay apart: give another name with -o")
        if store.study["design"] != self.text:
            raise ValueError(
                f"{self.path} has changed since {database} was begun: bring it back, or begin another with -o"
            )
        if others := changed(self.stimuli.listed, store.stimuli()):
            which = f"{', '.join(others[:3])} is another file than when {database} was begun"
            raise ValueError(f"{which}: bring it back, or begin another")


def load_study(path: Path) -> Study:
    """Study in a TOML file.

    Raises:
        FileNotFoundError, ValueError: as `read_design` and `load_stimuli` do, or the output cannot be as it is described.
    """
    design, text = read_design(path)
    output = _output_device(design.output, path)
    return Study(path, text, design, load_stimuli(design, output is not None and output.calibrated), output)


def _output_device(output: Output, path: Path) -> OutputDevice | None:
    if output.to != "page":
        profile = None if output.actuator is None else read_profile(output.actuator)
        return OutputDevice(output.to, profile, output.gain, output.device, output.channel)
    if any(value is not None for value in (output.actuator, output.gain, output.device, output.channel)):
        raise ValueError(
            f"{path.name}: [output] plays in the page, which has no device, gain or actuator of this machine"
        )
    return None
