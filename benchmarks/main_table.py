"""Train, judge and tabulate every texture of the README's table; resumable, one small JSON a run.

    python benchmarks/main_table.py run [--only PATTERN] [--recordings DIR]
    python benchmarks/main_table.py table [--readme README.md]

The real recordings are read from the directory of `--recordings` (copper, fabric, leather and wood, as .npz with `speed`,
`force` and `accel` at 10 kHz); they are not part of this repository.
"""

from __future__ import annotations

import argparse
import dataclasses
import fnmatch
import json
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from foten.architecture import ARCHITECTURES
from foten.datasets.simulate import LINEAR_FAMILY, TEXTURES, simulate
from foten.evaluate.evaluate import evaluate
from foten.experiments.truth import truth_for
from foten.recording.preprocess import PreprocessConfig
from foten.recording.recording import Channel, Recording
from foten.texture_file import write_texture
from foten.train.config import RECIPES
from foten.train.train import train_texture

RESULTS = Path(__file__).parent / "results" / "main_table"
REAL = ("copper", "fabric", "leather", "wood")


@dataclasses.dataclass(frozen=True)
class Run:
    """One texture, model, rate and split."""

    texture: str
    model: str
    rate_hz: float
    split_seed: int

    @property
    def name(self) -> str:
        return f"{self.texture}-{self.rate_hz:g}-{self.model}-{self.split_seed}"


def runs() -> Iterator[Run]:
    """Return every run, the shorter ones first."""
    for seed in range(5):
        for model in ("foten-plus", "foten"):
            for rate in (2500.0, 10000.0):
                yield from (Run(texture, model, rate, seed) for texture in REAL)
    for texture in TEXTURES:
        yield Run(texture, "foten-plus", 1000.0, 0)
    for seed in range(5):
        yield from (Run(texture, "foten-plus", 1000.0, seed) for texture in LINEAR_FAMILY)
    for texture in TEXTURES:
        yield Run(texture, "foten", 1000.0, 0)


def execute(run: Run, recordings: Path, keep: Path | None, epochs: int | None) -> dict[str, Any]:
    """Return the judge's document of one run, with its wall time."""
    if run.texture in REAL:
        with np.load(recordings / f"{run.texture}.npz", allow_pickle=False) as columns:
            recording = Recording(
                {
                    name: Channel(np.asarray(columns[column], dtype=float), 10_000.0)
                    for name, column in (("acceleration", "accel"), ("speed", "speed"), ("force", "force"))
                },
                texture=run.texture,
            )
        preprocess = PreprocessConfig(rate_hz=run.rate_hz, trim_ms=0, block_ms=200)
    else:
        recording = simulate(run.texture, 64.0)
        preprocess = PreprocessConfig()
    config = dataclasses.replace(RECIPES["default"], threads=1, seed=run.split_seed)
    if epochs is not None:
        config = dataclasses.replace(config, epochs=epochs)
    started = time.perf_counter()
    trained = train_texture(
        recording, run.model, ARCHITECTURES[run.model](), config, preprocess, split_seed=run.split_seed
    )
    seconds = time.perf_counter() - started
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        write_texture(trained.texture, keep / f"{run.name}.foten")
    judgement = evaluate(trained.texture, recording, truth_for(recording, trained.texture))
    return {"run": dataclasses.asdict(run), "training_seconds": seconds, **judgement.document}


def run_all(arguments: argparse.Namespace) -> None:
    RESULTS.mkdir(parents=True, exist_ok=True)
    for run in runs():
        path = RESULTS / f"{run.name}.json"
        if path.exists() or not fnmatch.fnmatch(run.name, arguments.only):
            continue
        if run.texture in REAL and not (arguments.recordings / f"{run.texture}.npz").exists():
            print(f"{run.name}: skipped, no {run.texture}.npz in {arguments.recordings}", file=sys.stderr)
            continue
        # Claimed by name, so that several processes share the work.
        claim = path.with_suffix(".running")
        try:
            claim.touch(exist_ok=False)
        except FileExistsError:
            continue
        try:
            document = execute(run, arguments.recordings, arguments.keep, arguments.epochs)
            temporary = path.with_suffix(".part")
            temporary.write_text(json.dumps(document, indent=1) + "\n")
            temporary.replace(path)
        finally:
            claim.unlink(missing_ok=True)
        free, ceiling = document["free_run"]["lsd_db"], document["ceiling"]["lsd_db"]
        print(
            f"{run.name}: mae {document['one_step']['mae_scaled']:.4f} ar {document['references']['ar']['mae_scaled']:.4f} "
            f"lsd {free} ceiling {ceiling} ar {document['free_run_ar']['lsd_db']} "
            f"bias {document['free_run']['level_bias_db']} ({document['training_seconds']:.0f} s)",
            file=sys.stderr,
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True)
    run = commands.add_parser("run")
    run.add_argument("--only", default="*", help="run names to match, as TEXTURE-RATE-MODEL-SEED")
    run.add_argument("--recordings", type=Path, default=Path("recordings"))
    run.add_argument("--keep", type=Path, help="directory for the texture files")
    run.add_argument("--epochs", type=int)
    run.set_defaults(command=run_all)
    arguments = parser.parse_args()
    arguments.command(arguments)


if __name__ == "__main__":
    main()
