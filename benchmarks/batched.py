"""Several textures trained as one batched model, beside one after another: an epoch for each texture.

    python benchmarks/batched.py [--models foten,ten] [--textures 2,6,12] [--seconds 8] [--csv FILE]

Both ways show each network the same windows in the same order under the same dropout; their training losses are compared first.
By the paper's recipe (batches of 16) and by ours (of 128), one thread; on a GPU where there is one. Ratios are of the same run.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
import time
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import torch
from torch import nn

from foten.families import FAMILIES
from foten.networks import build
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.split import split_blocks
from foten.simulation.simulate import TEXTURES, simulate
from foten.train.batched import BATCHED, fit_batched
from foten.train.blocks import scaled_blocks
from foten.train.config import RECIPES
from foten.train.epochs import Progress
from foten.train.fit import TrainingWindows, fit, pick_device, reproducible
from report import add_csv, report

SAME = 0.01  # of a training loss: an epoch by the paper's learning rate makes that much of rounding


def windows_of(texture: str, m: int, seconds: float) -> TrainingWindows:
    """Return what a network learns of a simulated texture."""
    trace = preprocess(simulate(texture, seconds), PreprocessConfig(trim_ms=0, block_ms=1000))
    blocks = scaled_blocks(trace, split_blocks(trace))
    return TrainingWindows(blocks.flat, *blocks.targets(m), m)


def both_ways(model: str, recipe: str, windows: list[TrainingWindows]) -> tuple[float, float]:
    """Return the seconds that an epoch of all takes one after another, and as one."""
    of = RECIPES[recipe]
    configs = [dataclasses.replace(of, epochs=1, threads=1, seed=seed) for seed in range(len(windows))]

    def networks() -> list[nn.Module]:
        made = []
        for config in configs:
            torch.manual_seed(config.seed)
            made.append(build(model, FAMILIES[model]()).to(pick_device()))
        return made

    with reproducible():
        one_by_one, at_once = networks(), networks()
        started = time.perf_counter()
        alone = [fit(*given) for given in zip(one_by_one, windows, configs, strict=True)]
        half_way = time.perf_counter()
        batched = fit_batched(at_once, windows, configs)
        ended = time.perf_counter()
    for one, other in zip(alone, batched, strict=True):
        assert isinstance(other, Progress)
        np.testing.assert_allclose(other.epochs[1].train_loss, one.epochs[1].train_loss, rtol=SAME)
    return half_way - started, ended - half_way


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", type=lambda text: text.split(","), default=["foten", "ten"])
    parser.add_argument("--textures", type=lambda text: [int(n) for n in text.split(",")], default=[2, 6, 12])
    parser.add_argument("--seconds", type=float, default=8.0)
    add_csv(parser)
    arguments = parser.parse_args()
    report(table(measure(parser, arguments)), arguments.csv)


def measure(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Return the seconds of all models, recipes and numbers of textures, of an epoch of each."""
    unknown = set(arguments.models) - set(BATCHED) | {"foten-plus"} & set(arguments.models)
    if unknown:
        parser.error(f"{sorted(unknown)[0]} cannot be measured, expected some of {', '.join(BATCHED)}")
    rows = []
    names = list(TEXTURES)
    for model in arguments.models:
        m = FAMILIES[model]().window
        every = [windows_of(name, m, arguments.seconds) for name in names[: max(arguments.textures)]]
        for recipe in ("paper", "default"):
            for n in arguments.textures:
                alone, batched = both_ways(model, recipe, every[:n])
                rows.append({"model": model, "recipe": recipe, "n": n, "alone_s": alone / n, "batched_s": batched / n})
                print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    print(f"on the {pick_device().type}", file=sys.stderr)
    return rows


def table(rows: list[dict[str, Any]]) -> list[list[str]]:
    """Return the table."""
    cells = [["model", "recipe", "batch", "textures", "one after another [s a texture]", "as one", "ratio"]]
    for row in rows:
        of = [row["model"], row["recipe"], str(RECIPES[row["recipe"]].batch), str(row["n"])]
        cells.append(
            [*of, f"{row['alone_s']:.2f}", f"{row['batched_s']:.2f}", f"{row['batched_s'] / row['alone_s']:.2f}"]
        )
    return cells


if __name__ == "__main__":
    main()
