"""Seconds to the same validation error of the same network: the paper's recipe against ours, in one run.

    python benchmarks/training.py [--texture towel] [--seconds 60] [--model foten] [--paper-epochs 40]
        [--save benchmarks/results/training.json]

Both train one network on one simulated recording with the same split and initial weights, each with the number of
threads that suits it. The target is the lowest validation loss that the paper's recipe reaches in the epochs given to
it (it stops by itself after 10 without a better one); what is compared is the wall time until each is at or below it,
and at losses 1 and 3 % above it. Prints a ratio for each.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "2")

import torch

from foten.architecture import ARCHITECTURES
from foten.datasets.simulate import simulate
from foten.models import build
from foten.recording.preprocess import preprocess
from foten.recording.scaling import fit_scaling
from foten.recording.split import split_blocks
from foten.recording.windows import targets
from foten.train.config import RECIPES, TrainConfig
from foten.train.fit import Data, Epoch, fit, pick_device, reproducible
from foten.whole_file import whole_file


def history(key: str, data: Data, config: TrainConfig) -> list[Epoch]:
    """Return the log of one training from the same initial weights."""
    with reproducible():
        torch.manual_seed(config.seed)
        network = build(key, ARCHITECTURES[key]()).to(pick_device())

        def say(line: Epoch) -> None:
            print(
                f"{config.recipe:8s} epoch {line.epoch:3d} validation loss {line.validation_loss:.6f} "
                f"error {line.validation_mae:.4f} sd {line.seconds:.1f} s",
                file=sys.stderr,
                flush=True,
            )

        return fit(network, data, config, say).epochs


def seconds_to(epochs: list[Epoch], loss: float) -> float | None:
    """Return the wall time until the validation loss is at or below one, None where it never is."""
    elapsed = 0.0
    for line in epochs:
        elapsed += line.seconds
        if line.validation_loss <= loss:
            return elapsed
    return None


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--texture", default="towel")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--model", default="foten", choices=["foten"])
    parser.add_argument("--paper-epochs", type=int, default=40)
    parser.add_argument("--save", type=Path, metavar="FILE", help="keep the result as JSON there")
    arguments = parser.parse_args()
    trace = preprocess(simulate(arguments.texture, arguments.seconds + 4.0))
    split = split_blocks(trace)
    scaling = fit_scaling(trace, split.train)
    m = ARCHITECTURES[arguments.model]().window
    data = Data(
        scaling.scale(trace.stacked()),
        targets(split.train, trace.block, m),
        targets(split.validation, trace.block, m),
        m,
    )
    logs = {
        "ours": history(arguments.model, data, RECIPES["default"]),
        "paper": history(
            arguments.model,
            data,
            dataclasses.replace(RECIPES["paper"], epochs=arguments.paper_epochs),
        ),
    }
    lowest = min(line.validation_loss for line in logs["paper"])
    rows = []
    for above in (1.0, 1.01, 1.03):
        times = {name: seconds_to(epochs, above * lowest) for name, epochs in logs.items()}
        ratio = times["paper"] / times["ours"] if times["paper"] and times["ours"] else None
        rows.append({"loss": above * lowest, "seconds": times, "ratio": ratio})
    result = {
        "texture": arguments.texture,
        "model": arguments.model,
        "threads": {name: RECIPES[key].threads for name, key in (("ours", "default"), ("paper", "paper"))},
        "device": pick_device().type,
        "n_train_windows": len(data.train),
        "seconds_per_epoch": {
            name: sum(line.seconds for line in epochs[1:]) / max(1, len(epochs) - 1)
            for name, epochs in logs.items()
        },
        "lowest_validation_loss": {
            name: min(line.validation_loss for line in epochs) for name, epochs in logs.items()
        },
        "total_seconds": {name: sum(line.seconds for line in epochs) for name, epochs in logs.items()},
        "time_to_loss": rows,
    }
    if arguments.save is not None:
        with whole_file(arguments.save) as part:
            part.write_text(json.dumps(result, indent=1) + "\n")
    print(f"{arguments.model} on {arguments.texture}, {len(data.train)} windows")
    for name in logs:
        print(
            f"{name:6s} {result['threads'][name]} threads, {result['seconds_per_epoch'][name]:.1f} s an epoch, "
            f"{result['total_seconds'][name]:.0f} s in all, "
            f"lowest validation loss {result['lowest_validation_loss'][name]:.6f}"
        )
    for row in rows:
        paper, ours = row["seconds"]["paper"], row["seconds"]["ours"]
        ratio = "–" if row["ratio"] is None else f"{row['ratio']:.1f}"
        print(
            f"to {row['loss']:.6f}: paper {paper and round(paper)} s, ours {ours and round(ours)} s, ratio {ratio}"
        )


if __name__ == "__main__":
    main()
