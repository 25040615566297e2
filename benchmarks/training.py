"""Seconds to the same validation error of the same network: the paper's recipe against ours, in one run.

    python benchmarks/training.py [--texture towel] [--seconds 60] [--model foten] [--paper-epochs 40]
        [--save benchmarks/results/training.json]

All train one network on one simulated recording with the same split and initial weights, each with the number of
threads that suits it; ours also with the paper's dropout, since leaving that out is part of why ours is faster. The
target is the lowest validation loss that the paper's recipe reaches in the epochs given to it (it stops by itself after
10 without a better one); what is compared is the wall time until each is at or below it, and at losses 1 and 3 %
above it. Also times `foten train` with its defaults on the same recording.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "2")

import torch

from foten.atomic_write import atomic_write
from foten.datasets.hdf5 import write_recording
from foten.datasets.simulate import simulate
from foten.families import FAMILIES
from foten.networks import build
from foten.recording.preprocess import preprocess
from foten.recording.recording import Recording
from foten.recording.split import split_blocks
from foten.train.blocks import scaled_blocks
from foten.train.config import RECIPES, TrainConfig
from foten.train.epochs import Epoch
from foten.train.fit import TrainingWindows, fit, pick_device, reproducible


def history(name: str, model: str, windows: TrainingWindows, config: TrainConfig) -> list[Epoch]:
    """Return the log of one training from the same initial weights."""
    with reproducible():
        torch.manual_seed(config.seed)
        network = build(model, FAMILIES[model]()).to(pick_device())

        def say(line: Epoch) -> None:
            print(
                f"{name:22s} epoch {line.epoch:3d} validation loss {line.validation_loss:.6f} "
                f"error {line.validation_mae:.4f} sd {line.seconds:.1f} s",
                file=sys.stderr,
                flush=True,
            )

        return fit(network, windows, config, say).epochs


def seconds_to(epochs: list[Epoch], loss: float) -> float | None:
    """Return the wall time until the validation loss is at or below one, None where it never is."""
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
    parser.add_argument("--save", type=Path, metavar="FILE", help="keep the result as JSON there")
    arguments = parser.parse_args()
    recording = simulate(arguments.texture, arguments.seconds + 4.0)
    trace = preprocess(recording)
    blocks, m = scaled_blocks(trace, split_blocks(trace)), FAMILIES[arguments.model]().window
    windows = TrainingWindows(blocks.flat, *blocks.targets(m), m)
    paper = dataclasses.replace(RECIPES["paper"], epochs=arguments.paper_epochs)
    arms = {
        "ours": RECIPES["default"],
        f"ours with dropout {paper.dropout:g}": dataclasses.replace(RECIPES["default"], dropout=paper.dropout),
        "paper": paper,
    }
    command = command_seconds(recording)
    print(f"foten train, {arguments.seconds:g} s of {arguments.texture}: {command:.0f} s", file=sys.stderr)
    logs = {name: history(name, arguments.model, windows, config) for name, config in arms.items()}
    lowest = min(line.validation_loss for line in logs["paper"])
    result = {
        "texture": arguments.texture,
        "seconds": arguments.seconds,
        "model": arguments.model,
        "device": pick_device().type,
        "n_train_windows": len(windows.train),
        "foten_train_command_seconds": command,
        "arms": {name: asdict_of(arms[name], epochs, lowest) for name, epochs in logs.items()},
    }
    if arguments.save is not None:
        with atomic_write(arguments.save) as part:
            part.write_text(json.dumps(result, indent=1) + "\n")
    print(
        f"{arguments.model} on {arguments.texture}, {len(windows.train)} windows, lowest of the paper's recipe {lowest:.6f}"
    )
    for name, arm in result["arms"].items():
        print(
            f"{name:22s} {arm['config']['threads']} threads, {arm['seconds_per_epoch']:.1f} s an epoch, "
            f"{arm['total_seconds']:.0f} s in all, lowest {arm['lowest_validation_loss']:.6f}; "
            + "; ".join(
                f"to {above} × paper's lowest {'never' if seconds is None else f'{seconds:.0f} s'}"
                + (
                    ""
                    if seconds is None or name == "paper"
                    else f" (ratio {result['arms']['paper']['seconds_to'][above] / seconds:.1f})"
                )
                for above, seconds in arm["seconds_to"].items()
            )
        )


def asdict_of(config: TrainConfig, epochs: list[Epoch], lowest: float) -> dict[str, Any]:
    """Return one arm as JSON values."""
    return {
        "config": dataclasses.asdict(config),
        "seconds_per_epoch": sum(line.seconds for line in epochs[1:]) / max(1, len(epochs) - 1),
        "total_seconds": sum(line.seconds for line in epochs),
        "lowest_validation_loss": min(line.validation_loss for line in epochs),
        "seconds_to": {f"{above:g}": seconds_to(epochs, above * lowest) for above in (1.0, 1.01, 1.03)},
        "validation_losses": [line.validation_loss for line in epochs],
    }


def command_seconds(recording: Recording) -> float:
    """Return the wall time of `foten train REC.h5 -o T.foten` with its defaults, start and proof included."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.h5"
        write_recording(recording, path)
        started = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "foten.cli", "train", str(path), "-o", str(Path(folder) / "texture.foten")],
            check=True,
            stdout=sys.stderr,
        )
        return time.perf_counter() - started


if __name__ == "__main__":
    main()
