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


def _row(documents: list[dict[str, Any]], figure: Any) -> tuple[float, float | None]:
    """Return mean and standard error over split seeds; no error for one."""
    values = np.array([figure(document) for document in documents], dtype=float)
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else None


def _cell(value: tuple[float, float | None], digits: int) -> str:
    mean, error = value
    return f"{mean:.{digits}f}" + ("" if error is None else f" ± {error:.{digits}f}")


def _reference(documents: list[dict[str, Any]], name: str) -> str:
    if documents[0]["references"][name]["mae_scaled"] is None:
        return "–"
    return _cell(_row(documents, lambda d: d["references"][name]["mae_scaled"]), 4)


def _free(documents: list[dict[str, Any]], name: str, key: str) -> str:
    return _cell(_row(documents, lambda d: d[name][key]), 2)


def table() -> str:
    """Return the table as Markdown, from the result files alone."""
    groups: dict[tuple[str, float], dict[str, list[dict[str, Any]]]] = {}
    for path in sorted(RESULTS.glob("*.json")):
        document = json.loads(path.read_text())
        run = document["run"]
        groups.setdefault((run["texture"], run["rate_hz"]), {}).setdefault(run["model"], []).append(document)
    lines = [
        "| texture | rate | splits | zero | AR(20) | best AR | bound | `foten` | `foten-plus` | ÷ AR(20) | ÷ shortcut "
        "| LSD | LSD of AR(20) | LSD ceiling | level bias | worst sample |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    order = [*REAL, *LINEAR_FAMILY, *TEXTURES]
    for texture, rate in sorted(groups, key=lambda key: (order.index(key[0]), key[1])):
        models = groups[texture, rate]
        plus, paper = models.get("foten-plus", []), models.get("foten", [])
        if not plus:
            continue

        ratio = _row(plus, lambda d: d["one_step"]["mae_scaled"] / d["references"]["ar"]["mae_scaled"])
        earned = _row(plus, lambda d: d["validation"]["mae_scaled"] / d["validation"]["mae_scaled_shortcut"])
        cells = [
            texture,
            f"{rate / 1000:g} kHz",
            str(len(plus)),
            _reference(plus, "zero"),
            _reference(plus, "ar"),
            _reference(plus, "ar_best"),
            _reference(plus, "bound_window"),
            _cell(_row(paper, lambda d: d["one_step"]["mae_scaled"]), 4) if paper else "–",
            _cell(_row(plus, lambda d: d["one_step"]["mae_scaled"]), 4),
            _cell(ratio, 3),
            _cell(earned, 3),
            _free(plus, "free_run", "lsd_db"),
            _free(plus, "free_run_ar", "lsd_db"),
            _free(plus, "ceiling", "lsd_db"),
            _free(plus, "free_run", "level_bias_db"),
            f"{max(d['free_run']['max_sd'] for d in plus):.1f}",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def write_table(arguments: argparse.Namespace) -> None:
    text = table()
    if arguments.readme is None:
        print(text)
        return
    begin, end = "<!-- main_table -->", "<!-- /main_table -->"
    before, _, rest = arguments.readme.read_text().partition(begin)
    _, _, after = rest.partition(end)
    arguments.readme.write_text(f"{before}{begin}\n{text}\n{end}{after}")


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
    tabulate = commands.add_parser("table")
    tabulate.add_argument("--readme", type=Path, help="put the table between its markers in this file")
    tabulate.set_defaults(command=write_table)
    arguments = parser.parse_args()
    arguments.command(arguments)


if __name__ == "__main__":
    main()
