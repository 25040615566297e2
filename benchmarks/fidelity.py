"""Which ingredient of foten-plus pays: each left out or changed, paired with the default over textures and splits; resumable.

    python benchmarks/fidelity.py run [--only PATTERN] [--seeds 0] [--textures a,b] [--recordings DIR]
    python benchmarks/fidelity.py table [--page docs/fidelity.md]

A run trains and judges one texture with one ingredient changed and leaves one small JSON in `results/fidelity`. Where the
texture has nothing of an ingredient that is left out, no tones say, the run is the one that it stands beside, and is not made
again; and the default of a split that `main_table.py` has run is that of `results/main_table`. Runs without a network that
differ in what is fitted after the lattices share those. Several processes share the work best by `--textures`. The table gives,
for each ingredient, the validation error and the figures on the test blocks as ratios to those of what it stands beside on the
same texture and split, made by the same sources, or by such as are known to make the same (`main_table.py run --again`): mean,
standard error over textures (over splits of a single one), number of pairs. A copy is no pair, and where neither rendering uses
its network their free runs are the same and not compared. Ingredients that foten no longer has are of earlier runs alone. Choose
by the columns of the validation blocks; the others report.
"""

from __future__ import annotations

import argparse
import copy
import dataclasses
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import foten.train.foten_plus as training
from foten.datasets.simulate import LINEAR_FAMILY, TEXTURES
from foten.evaluate.evaluate import evaluate
from foten.evaluate.one_step import one_step, predict
from foten.experiments.truth import truth_for
from foten.families import FotenPlusSizes
from foten.recording.windows import targets
from foten.runtime.native import NativeTexture
from foten.train.config import RECIPES, TrainConfig
from foten.train.job import Trained, TrainingJob
from foten.train.linear_part import LinearPart, fit_linear_parts
from foten.train.pipeline import train
from main_table import REAL, SOURCES, alike, at, between, read, recording_of, validation_free_run, work_through
from main_table import RESULTS as MAIN

RESULTS = Path(__file__).parent / "results" / "fidelity"
DEFAULT, BARE, HEAD = "default", "no network", "speed and force at the head alone"
INGREDIENTS: dict[str, dict[str, Any]] = {
    DEFAULT: {},
    BARE: {"train": {"epochs": 0}},
    # What is fitted before the network is judged without one, beside the default without one.
    **{
        name: {"train": {"epochs": 0, **change}, "beside": BARE}
        for name, change in {
            "no tones": {"tones": False},
            "lattice of 20": {"max_order": 20},
            "gain after the filter alone": {"gain_before_filter": False},
            "Gaussian excitation": {"tails": False},
            "no volatility": {"volatility": False},
        }.items()
    },
    "one filter for all speeds": {"train": {"epochs": 0, "table": False, "tones": False}, "beside": "no tones"},
    HEAD: {"sizes": {"condition_in_tokens": False}},
    # Measured when the head alone was given speed and force.
    **{
        name: {
            "train": change.get("train", {}),
            "sizes": {"condition_in_tokens": False},
            "beside": HEAD,
            "earlier": change.get("earlier", False),
        }
        for name, change in {
            "speed and force modulate": {"earlier": True},
            "absolute loss": {"train": {"loss": "mae"}},
            "squared loss": {"train": {"loss": "mse"}},
            "dropout 0.2": {"train": {"dropout": 0.2}},
            "no weight decay": {"train": {"weight_decay": 0.0}},
            "averaged weights": {"earlier": True},
            "cosine and sine of the phase": {"earlier": True},
            "log magnitude": {"earlier": True},
            "bin embedding": {"earlier": True},
        }.items()
    },
    "twice the epochs": {"train": {"epochs": 64, "patience": 20}},
    "four times the learning rate": {"train": {"learning_rate": 2e-3}},
    "fine-tuned on its own output": {"earlier": True},
    **{f"window {m}": {"sizes": {"window": m}} for m in (5, 10, 40, 64)},
}
RENAMED = {"level behind the lattice alone": "gain after the filter alone", "no swell": "no volatility"}
"""Ingredients by the names that they had in earlier results."""
LACKS: dict[str, Callable[[dict[str, Any]], bool]] = {
    "no tones": lambda has: not has["n_tones"],
    "lattice of 20": lambda has: max(has["order"], has["residual_order"] if has["n_tones"] else 0) <= 20,
    "gain after the filter alone": lambda has: not has["gain_before_filter"] and not has["residual_gain_before_filter"],
    "no volatility": lambda has: not has["volatility"],
    "one filter for all speeds": lambda has: has["n_speed"] * has["n_force"] == 1,
}
"""Whether what a texture has, beside an ingredient that is left out, has nothing of it."""
OF_NETWORK = {
    name for name, changed in INGREDIENTS.items() if name == BARE or changed.get("train", {}).get("epochs", 1) > 0
}
"""Ingredients of the network alone: its lattice, tones and excitation without it are the same."""
FIGURES = {
    "validation: one step": "validation.mae_scaled",
    "validation: LSD": "validation_free_run.lsd_db",
    "validation: level error": "validation_free_run.level_error_db",
    "test: one step": "one_step.mae_scaled",
    "test: LSD": "free_run.lsd_db",
    "test: long LSD": "free_run.lsd_long_db",
    "test: level error": "free_run.level_error_db",
}


@dataclasses.dataclass(frozen=True)
class Run:
    """One texture and rate, one split, one ingredient changed."""

    texture: str
    rate_hz: float
    seed: int
    ingredient: str

    @property
    def name(self) -> str:
        return f"{self.texture}-{self.rate_hz:g}-{self.seed}-{self.ingredient.replace(' ', '_')}"


def runs(seeds: list[int], textures: list[str]) -> Iterator[Run]:
    """Return every run, those of one texture, rate and split in a row, what others stand beside first."""
    for seed in seeds:
        for texture in textures:
            for rate in (10_000.0, 2500.0) if texture in REAL else (1000.0,):
                yield from (
                    Run(texture, rate, seed, ingredient)
                    for ingredient, changed in INGREDIENTS.items()
                    if not changed.get("earlier")
                )


class LinearParts:
    """The linear parts of the last texture, rate and split, by what they were fitted with.

    For runs without a network alone: fitting leaves PyTorch's generator elsewhere, which the weights of one are drawn from.
    """

    def __init__(self) -> None:
        self.of: tuple[Any, ...] = ()
        self.kept: dict[tuple[Any, ...], list[LinearPart]] = {}

    @contextmanager
    def shared(self, run: Run) -> Iterator[None]:
        """Let training without a network take what was fitted for this texture, rate and split before."""
        if self.of != (run.texture, run.rate_hz, run.seed):
            self.of, self.kept = (run.texture, run.rate_hz, run.seed), {}

        def parts(sizes: Any, blocks: Any, config: TrainConfig, *more: Any) -> list[LinearPart]:
            if config.epochs > 0:
                return fit_linear_parts(sizes, blocks, config, *more)
            fitted_with = (sizes, config.max_order, config.table, config.gain_before_filter)
            # The first is that without tones, whether there are some or not.
            if not config.tones and (*fitted_with, True) in self.kept:
                return copy.deepcopy(self.kept[*fitted_with, True][:1])
            key = (*fitted_with, config.tones)
            if key not in self.kept:
                self.kept[key] = fit_linear_parts(sizes, blocks, config, *more)
            return copy.deepcopy(self.kept[key])

        training.fit_linear_parts = parts
        try:
            yield
        finally:
            training.fit_linear_parts = fit_linear_parts


LINEAR_PARTS = LinearParts()


def execute(run: Run, recordings: Path) -> dict[str, Any]:
    """Return the figures of one run."""
    changed = INGREDIENTS[run.ingredient]
    beside = dataclasses.replace(run, ingredient=changed.get("beside", DEFAULT))
    path = RESULTS / f"{beside.name}.json"
    if run.ingredient in LACKS and path.exists():
        document = read(path)
        if document["source_sha256"] == SOURCES and LACKS[run.ingredient](document["has"]):
            return {**document, "run": dataclasses.asdict(run), "same_as": beside.ingredient, "training_seconds": 0.0}
    recording, preprocess = recording_of(run.texture, run.rate_hz, run.seed, recordings)
    config = dataclasses.replace(RECIPES["default"], **{"threads": 1, "seed": run.seed, **changed.get("train", {})})
    sizes = FotenPlusSizes(**changed.get("sizes", {}))
    job = TrainingJob(recording, "foten-plus", sizes, config, preprocess, split_seed=run.seed)
    started = time.perf_counter()
    with LINEAR_PARTS.shared(run):
        trained = train(job)
    if trained.progress.interrupted:
        raise KeyboardInterrupt  # what was trained by then is no result
    seconds = time.perf_counter() - started
    document = evaluate(trained.texture, recording, truth_for(recording, trained.texture)).document
    kept = {key: {k: v for k, v in document[key].items() if k != "intervals"} for key in ("one_step", "free_run")}
    return {
        "run": dataclasses.asdict(run),
        "training_seconds": seconds,
        "config": dataclasses.asdict(config),
        "versions": trained.texture.card["training"]["versions"],
        "source_sha256": SOURCES,
        "validation": validation(trained, document["first_scored"]),
        "validation_free_run": validation_free_run(trained.texture),
        "has": {
            **trained.texture.sizes.to_card(),
            "volatility": float(trained.texture.tensors["excitation.volatility"][1]),
        },
        **kept,
        "ceiling": {k: v for k, v in document["ceiling"].items() if k != "intervals"},
        "ar_best": document["references"]["ar_best"]["mae_scaled"],
        "wavelength_mm": trained.texture.card["metrics"]["linear_part"]["wavelength_mm"],
    }


def validation(trained: Trained, first: int) -> dict[str, float]:
    """Return the one-step error of the exported file on the validation blocks, from sample `first` of each on."""
    texture, trace, blocks = trained.texture, trained.trace, trained.split.validation
    n = targets(blocks, trace.block, first).reshape(len(blocks), -1)
    samples = texture.scaling.scale(trace.stacked())
    predicted = predict(NativeTexture(texture.to_bytes()), samples, n).sample
    return {"mae_scaled": one_step(samples[n, 0], predicted, texture.scaling.sd[0])["mae_scaled"]}


def run_all(arguments: argparse.Namespace) -> None:
    def line(document: dict[str, Any]) -> str:
        return "  ".join(f"{name} {at(document, path):.4f}" for name, path in FIGURES.items())

    chosen = runs(arguments.seeds, arguments.textures)
    work_through(chosen, RESULTS, arguments, lambda run: execute(run, arguments.recordings), line)


def table(arguments: argparse.Namespace) -> None:
    """Print the ratios to what each ingredient stands beside, by kind of texture, or put them into a page."""
    by_run, same = {}, alike()
    for path in sorted(MAIN.glob("*-foten-plus-*.json")):
        d = read(path)
        run = d["run"]
        source = same.get(d["source_sha256"], d["source_sha256"])
        # Its validation error is that of the training, from another sample of each block on.
        by_run[run["texture"], run["rate_hz"], run["split_seed"], DEFAULT, source] = {
            **d,
            "validation": {"mae_scaled": None},
        }
    for path in sorted(RESULTS.glob("*.json")):
        d = read(path)
        *run, ingredient = (d["run"][key] for key in ("texture", "rate_hz", "seed", "ingredient"))
        by_run[(*run, RENAMED.get(ingredient, ingredient), same.get(d["source_sha256"], d["source_sha256"]))] = d
    kinds = {
        "simulated twelve, 1 kHz": (tuple(TEXTURES), 1000.0),
        "linear family, 1 kHz": (tuple(LINEAR_FAMILY), 1000.0),
        "real four, 10 kHz": (REAL, 10_000.0),
        "real four, 2.5 kHz": (REAL, 2500.0),
    }
    tables = []
    for title, (textures, rate) in kinds.items():
        lines = []
        for ingredient, changed in INGREDIENTS.items():
            beside = changed.get("beside", DEFAULT)
            pairs = [
                (d, by_run[texture, hz, seed, beside, source])
                for (texture, hz, seed, name, source), d in by_run.items()
                if name == ingredient != beside and texture in textures and hz == rate
                if (texture, hz, seed, beside, source) in by_run
            ]
            own = [(a, b) for a, b in pairs if "same_as" not in a]
            if pairs:
                of_network = ingredient in OF_NETWORK
                cells = [
                    _ratio(
                        [
                            (a["run"]["texture"], at(a, path), at(b, path))
                            for a, b in own
                            if not (of_network and path.startswith(("validation_free_run", "free_run")))
                            or a["validation_free_run"].get("network_in_loop")
                            or b["validation_free_run"].get("network_in_loop")
                        ]
                    )
                    for path in FIGURES.values()
                ]
                lines.append(f"| {ingredient} | {beside} | {len(pairs)} | {len(own)} | {' | '.join(cells)} |")
        if lines:
            head = f"| {title} | ÷ | of | pairs | {' | '.join(FIGURES)} |\n|" + "---|" * (4 + len(FIGURES))
            tables.append("\n".join([head, *lines]))
    between(arguments.page, "ingredients", "\n\n".join(tables))


def _ratio(pairs: list[tuple[str, float | None, float | None]]) -> str:
    """Return the mean ratio and its standard error, over textures; over splits where there is one texture."""
    by_texture: dict[str, list[float]] = {}
    for texture, a, b in pairs:
        if a is None or b is None:
            return "–"
        by_texture.setdefault(texture, []).append(a / b)
    if not by_texture:
        return "–"
    values = [float(np.mean(ratios)) for ratios in by_texture.values()]
    values = values if len(values) > 1 else next(iter(by_texture.values()))
    if len(values) == 1:
        return f"{values[0]:.3f}"
    return f"{np.mean(values):.3f} ± {np.std(values, ddof=1) / np.sqrt(len(values)):.3f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    run = commands.add_parser("run")
    run.add_argument("--only", default="*", help="run names to match, as TEXTURE-RATE-SEED-INGREDIENT")
    run.add_argument("--seeds", type=lambda text: [int(s) for s in text.split(",")], default=[0])
    run.add_argument("--textures", type=lambda text: text.split(","), default=[*REAL, *LINEAR_FAMILY, *TEXTURES])
    run.add_argument("--recordings", type=Path, default=Path("recordings"))
    run.set_defaults(command=run_all)
    tabulate = commands.add_parser("table")
    tabulate.add_argument("--page", type=Path, help="put the tables between their markers in this file")
    tabulate.set_defaults(command=table)
    arguments = parser.parse_args()
    arguments.command(arguments)


if __name__ == "__main__":
    main()
