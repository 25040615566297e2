"""Seconds to the same validation error of the same network: the paper's recipe against ours, in one run.

    python benchmarks/training.py [--texture towel] [--seconds 60] [--model foten] [--paper-epochs 40]
        [--csv FILE]
    python benchmarks/training.py --commands [FOTEN …] [--texture towel] [--seconds 60] [--times 1] [--csv FILE]

All train one network on one simulated recording with the same split and initial weights, each with the number of
threads that suits it; ours also with the paper's dropout, since leaving that out is part of why ours is faster. The
target is the lowest validation loss that the paper's recipe reaches in the epochs given to it (it stops by itself after
10 without a better one); what is compared is the wall time until each is at or below it, and at losses 1 and 3 %
above it. Also times `foten train` with its defaults on the same recording.

`--commands` times what a user waits for, of foten-plus: until `foten train` has written a playable file and until it
is done, and `foten evaluate` without pictures; of this installation and, in turn, of others, such as the `foten` of the
state before. On a machine that others use too, the processor's time says more than the clock's.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

os.environ.setdefault("OMP_NUM_THREADS", "2")

import torch

from foten.baselines.networks import build
from foten.datasets.hdf5 import write_recording
from foten.models.trainable import TRAINABLE, recipe_of
from foten.recording.preprocess import preprocess
from foten.recording.recording import Recording
from foten.recording.split import split_blocks
from foten.simulation.simulate import simulate
from foten.training.checkpoint import Epoch
from foten.training.config import WindowConfig
from foten.training.job import scaled_blocks
from foten.training.loop import Monitor, pick_device
from foten.training.reproducible import reproducible
from foten.training.window_fit import TrainingWindows, fit_windows, one_step_windows
from result_table import add_csv, report

FOTEN = Path(sys.executable).with_name("foten")


def history(name: str, model: str, windows: TrainingWindows, config: WindowConfig) -> list[Epoch]:
    """The log of one training from the same initial weights."""
    with reproducible():
        torch.manual_seed(config.seed)
        network = build(TRAINABLE[model].sizes()).to(pick_device())

        def say(line: Epoch) -> None:
            print(
                f"{name:22s} epoch {line.epoch:3d} validation loss {line.validation_loss:.6f} "
                f"error {line.validation_mae:.4f} sd {line.seconds:.1f} s",
                file=sys.stderr,
                flush=True,
            )

        return fit_windows(network, windows, config, Monitor(on_epoch=say)).epochs


def seconds_to(epochs: list[Epoch], loss: float) -> float | None:
    """The wall time until the validation loss is at or below one, None where it never is."""
    elapsed = 0.0
    for line in epochs:
        elapsed += line.seconds
        if line.validation_loss <= loss:
            return elapsed
    return None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--texture", default="towel")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--model", default="foten", choices=["foten"])
    parser.add_argument("--paper-epochs", type=int, default=40)
    parser.add_argument("--commands", nargs="*", type=Path, metavar="FOTEN", help="time commands alone, these too")
    parser.add_argument("--times", type=int, default=1, help="of each command")
    add_csv(parser)
    arguments = parser.parse_args()
    recording = simulate(arguments.texture, arguments.seconds + 4.0)
    if arguments.commands is not None:
        report(commands_table(recording, [FOTEN, *arguments.commands] * arguments.times), arguments.csv)
        return
    trace = preprocess(recording)
    blocks, m = scaled_blocks(trace, split_blocks(trace)), TRAINABLE[arguments.model].sizes().window
    windows = one_step_windows(blocks, m)
    ours, paper = recipe_of(arguments.model), recipe_of(arguments.model, "paper", epochs=arguments.paper_epochs)
    assert isinstance(ours, WindowConfig)
    assert isinstance(paper, WindowConfig)
    arms = {
        "ours": ours,
        f"ours with dropout {paper.dropout:g}": dataclasses.replace(ours, dropout=paper.dropout),
        "paper": paper,
    }
    command = command_seconds(recording, FOTEN).done[0]
    print(f"foten train, {arguments.seconds:g} s of {arguments.texture}: {command:.0f} s", file=sys.stderr)
    logs = {name: history(name, arguments.model, windows, config) for name, config in arms.items()}
    report(table(arms, logs), arguments.csv)
    print(f"{len(windows.train)} windows, {pick_device().type}; foten train: {command:.0f} s", file=sys.stderr)


def table(arms: dict[str, WindowConfig], logs: dict[str, list[Epoch]]) -> list[list[str]]:
    """The seconds of each recipe, and those to the lowest loss of the paper's."""
    lowest = min(line.validation_loss for line in logs["paper"])
    cells = [["recipe", "threads", "s an epoch", "s in all", "lowest loss", "s to the paper's lowest", "paper's ÷ its"]]
    paper = seconds_to(logs["paper"], lowest)
    for name, epochs in logs.items():
        seconds, total = seconds_to(epochs, lowest), sum(line.seconds for line in epochs)
        row = [name, str(arms[name].threads), f"{total / max(1, len(epochs) - 1):.1f}", f"{total:.0f}"]
        row.append(f"{min(line.validation_loss for line in epochs):.5f}")
        row += ["never", "–"] if seconds is None or paper is None else [f"{seconds:.0f}", f"{paper / seconds:.1f}"]
        cells.append(row)
    return cells


class CommandSeconds(NamedTuple):
    """Seconds by the clock and of the processor: from the start of `foten train` and of `foten evaluate`."""

    playable: tuple[float, float]
    done: tuple[float, float]
    judged: tuple[float, float]


def commands_table(recording: Recording, commands: Sequence[Path]) -> list[list[str]]:
    """The seconds of each command, one after the other."""
    cells = [["foten", *(f"{what} [{of}]" for what in CommandSeconds._fields for of in ("s", "s of the processor"))]]
    for command in commands:
        cells.append([str(command), *(f"{part:.1f}" for pair in command_seconds(recording, command) for part in pair)])
        print(*cells[-1], file=sys.stderr)
    return cells


def command_seconds(recording: Recording, foten: Path) -> CommandSeconds:
    """The time of `foten train REC.h5 -o T.foten` and `foten evaluate` with their defaults, start and proof included."""
    with tempfile.TemporaryDirectory() as folder:
        path, texture = Path(folder) / "recording.h5", Path(folder) / "texture.foten"
        write_recording(recording, path)
        playable, done = seconds_of([foten, "train", path, "-o", texture], texture)
        _, judged = seconds_of([foten, "evaluate", texture, path], texture)
    return CommandSeconds(playable, done, judged)


def seconds_of(command: Sequence[str | Path], file: Path) -> tuple[tuple[float, float], tuple[float, float]]:
    """Seconds by the clock and of the processor until a file is there, and until a command has ended."""
    started, ticks, first = time.perf_counter(), os.sysconf("SC_CLK_TCK"), None
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    own = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"}  # which is set above
    process = subprocess.Popen([str(part) for part in command], stdout=sys.stderr, env=own)
    while process.poll() is None:
        if first is None and file.exists():
            fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
            first = time.perf_counter() - started, (int(fields[11]) + int(fields[12])) / ticks
        time.sleep(0.01)
    if process.returncode:
        raise SystemExit(f"{command[0]} {command[1]} failed")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    last = time.perf_counter() - started, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return first or last, last


if __name__ == "__main__":
    main()
