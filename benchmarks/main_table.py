"""Train, judge and tabulate every texture of the README's table and of docs/results.md; resumable, one small JSON a run.

    python benchmarks/main_table.py run [--only PATTERN] [--recordings DIR]
    python benchmarks/main_table.py table [--readme README.md] [--page docs/results.md]

The real recordings are read from the directory of `--recordings` (copper, fabric, leather and wood, as .npz with `speed`,
`force` and `accel` at 10 kHz); they are not part of this repository.
"""

from __future__ import annotations

import argparse
import ast
import dataclasses
import fnmatch
import hashlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from statistics import NormalDist
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import foten
from foten.atomic_write import atomic_write
from foten.datasets.simulate import LINEAR_FAMILY, TEXTURES, simulate
from foten.evaluate.evaluate import evaluate
from foten.evaluate.metrics import kurtosis
from foten.experiments.truth import truth_for
from foten.families import FAMILIES, FotenPlusSizes, FotenSizes
from foten.families.texture_file import Texture, write_texture
from foten.recording.preprocess import PreprocessConfig
from foten.recording.recording import Channel, Recording
from foten.recording.trace import Trace
from foten.train.config import RECIPES
from foten.train.job import TrainingJob
from foten.train.pipeline import train


def source_sha256() -> str:
    """Return the digest of the modules of the package that a run may use, without docstrings and comments."""
    digest, package = hashlib.sha256(), Path(foten.__file__).parent
    waiting, used = [Path(__file__)], set[Path]()
    while waiting:
        for name in _imported(ast.parse(waiting.pop().read_text())):
            path = package.joinpath(*name.split(".")[1:])
            path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
            if path.exists() and path not in used:
                used.add(path)
                waiting.append(path)
    for path in sorted(used):
        tree = ast.parse(path.read_text())
        for node in ast.walk(tree):
            body = getattr(node, "body", None)
            if isinstance(body, list):
                node.body = [part for part in body if not _is_text(part)]  # type: ignore[attr-defined]
        digest.update(f"{path.relative_to(package).as_posix()}\n{ast.dump(tree)}\n".encode())
    return digest.hexdigest()


def _imported(tree: ast.AST) -> Iterator[str]:
    """Return what of the package is imported anywhere under a node, and what may be a module of it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        else:
            continue
        yield from (name for name in names if name.startswith("foten."))


def _is_text(part: ast.stmt) -> bool:
    return isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant)


RESULTS = Path(__file__).parent / "results" / "main_table"
SAME = RESULTS.with_name("same_figures.json")
TRAINING = Path(__file__).parent / "results" / "training.json"
REAL = ("copper", "fabric", "leather", "wood")
SOURCES = source_sha256()  # when the code was loaded, not when a run ends
SEEDS = (1, 2, 3, 4, 5)  # of splits, and the first of simulations: what is chosen by hand is chosen on seed 0


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
    """Return every run."""
    for model in ("foten-plus", "foten"):
        for rate in (10000.0, 2500.0):
            for seed in SEEDS:
                yield from (Run(texture, model, rate, seed) for texture in REAL)
        for seed in SEEDS if model == "foten-plus" else SEEDS[:1]:
            yield from (Run(texture, model, 1000.0, seed) for texture in (*TEXTURES, *LINEAR_FAMILY))


def recording_of(texture: str, rate_hz: float, seed: int, recordings: Path) -> tuple[Recording, PreprocessConfig]:
    """Return a real recording or a simulated one of 64 s, and how it is preprocessed."""
    if texture not in REAL:
        return simulate(texture, 64.0, seed=seed), PreprocessConfig()
    with np.load(recordings / f"{texture}.npz", allow_pickle=False) as columns:
        channels = {
            name: Channel(np.asarray(columns[column], dtype=float), 10_000.0)
            for name, column in (("acceleration", "accel"), ("speed", "speed"), ("force", "force"))
        }
    return Recording(channels, texture=texture), PreprocessConfig(rate_hz=rate_hz, trim_ms=0, block_ms=200)


def execute(run: Run, recordings: Path, keep: Path | None) -> dict[str, Any]:
    """Return the judge's document of one run, with its wall time."""
    recording, preprocess = recording_of(run.texture, run.rate_hz, run.split_seed, recordings)
    config = dataclasses.replace(RECIPES["default"], threads=1, seed=run.split_seed)
    started = time.perf_counter()
    sizes = FAMILIES[run.model]()
    trained = train(TrainingJob(recording, run.model, sizes, config, preprocess, split_seed=run.split_seed))
    if trained.progress.interrupted:
        raise KeyboardInterrupt  # what was trained by then is no result
    seconds = time.perf_counter() - started
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        write_texture(trained.texture, keep / f"{run.name}.foten")
    judgement = evaluate(trained.texture, recording, truth_for(recording, trained.texture))
    return {
        "run": dataclasses.asdict(run),
        "config": dataclasses.asdict(config),
        "source_sha256": SOURCES,
        "training_seconds": seconds,
        "recording": kurtosis_of(judgement.trace),
        "validation_free_run": validation_free_run(trained.texture),
        **judgement.document,
    }


def validation_free_run(texture: Texture) -> dict[str, Any]:
    """Return how far the free run is from the validation blocks [dB], as its card says; none of a model without excitation.

    And whether a rendering uses the network.
    """
    names = ("lsd_db", "level_error_db")
    metrics, sizes = texture.card["metrics"], texture.sizes
    known: dict[str, Any] = {name: metrics[f"validation_{name}"] for name in names if f"validation_{name}" in metrics}
    if isinstance(sizes, FotenPlusSizes):
        known["network_in_loop"] = sizes.renders_with_network
    return known


def read(path: Path) -> dict[str, Any]:
    """Return a result, under today's names whenever it was made."""
    document: dict[str, Any] = json.loads(path.read_text())
    if "heard" in document:
        free_run = document.pop("heard")
        network = {"network_in_loop": free_run.pop("network")} if "network" in free_run else {}
        document["validation_free_run"] = free_run | network
    for before, today in (("network_heard", "network_in_loop"), ("rest_m_s2", "still_m_s2")):
        if before in document:
            document[today] = document.pop(before)
    return document


def kurtosis_of(trace: Trace, n_draws: int = 2000) -> dict[str, Any]:
    """Return the kurtosis of a recording, and the central 95 % of it over blocks drawn anew."""
    blocks = trace.blocks(trace.acceleration)
    rng = np.random.default_rng(0)
    drawn = [kurtosis(blocks[rng.integers(0, len(blocks), len(blocks))]) for _ in range(n_draws)]
    low, high = np.percentile(drawn, [2.5, 97.5])
    return {"kurtosis": kurtosis(blocks), "kurtosis_low": float(low), "kurtosis_high": float(high)}


def work_through(
    runs: Iterable[Any],
    results: Path,
    arguments: argparse.Namespace,
    execute: Callable[[Any], dict[str, Any]],
    line: Callable[[dict[str, Any]], str],
) -> None:
    """Execute the runs that have no result yet and match `--only`, and keep one JSON each."""
    results.mkdir(parents=True, exist_ok=True)
    for run in runs:
        path = results / f"{run.name}.json"
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
            print(f"{run.name}: skipped, another process is at it (or died: {claim.name})", file=sys.stderr)
            continue
        try:
            document = execute(run)
            with atomic_write(path) as part:
                part.write_text(json.dumps(document, indent=1) + "\n")
        finally:
            claim.unlink(missing_ok=True)
        seconds = document["training_seconds"]
        print(f"{run.name}: {line(document)} ({seconds:.0f} s)", file=sys.stderr, flush=True)


def run_again(arguments: argparse.Namespace) -> None:
    """Execute results of an earlier state of the sources again, replace them, and keep which are equal to the last digit."""
    for run in runs():
        path = RESULTS / f"{run.name}.json"
        if not path.exists() or not fnmatch.fnmatch(run.name, arguments.only):
            continue
        before = read(path)
        if before["source_sha256"] == SOURCES:
            continue
        keep(path, execute(run, arguments.recordings, arguments.keep))


def _known(value: Any) -> Any:
    """Return a JSON value without the keys that have none: a figure that later states know of, and this run has not."""
    if not isinstance(value, dict):
        return value
    return {key: _known(of) for key, of in value.items() if of is not None}


def keep(path: Path, result: dict[str, Any]) -> None:
    """Keep a result and, where it replaces one that an earlier state of the sources made of the same, whether it is equal."""
    before = read(path) if path.exists() else result
    of_one = before.get("texture_sha256") == result.get("texture_sha256") or path.parent == RESULTS
    if before["source_sha256"] != SOURCES and of_one:
        differ = sorted(
            name
            for name in result.keys() | before.keys()
            if name not in ("source_sha256", "training_seconds", "times_real_time")
            and json.dumps(_known(result.get(name))) != json.dumps(_known(before.get(name)))
        )
        outcome = "other " + ", ".join(differ) if differ else "equal"
        print(f"{path.stem}: {outcome}", file=sys.stderr, flush=True)
        made_again = _made_again()
        by_today = made_again.setdefault(SOURCES, {"equal": {}, "differ": {}})
        name = path.stem if path.parent == RESULTS else f"{path.parent.name}/{path.stem}"
        by_today["differ" if differ else "equal"].setdefault(before["source_sha256"], []).append(name)
        with atomic_write(SAME) as part:
            part.write_text(json.dumps(made_again, indent=1) + "\n")
    with atomic_write(path) as part:
        part.write_text(json.dumps(result, indent=1) + "\n")


def run_all(arguments: argparse.Namespace) -> None:
    if arguments.again:
        run_again(arguments)
        return

    def line(document: dict[str, Any]) -> str:
        return (
            f"mae {document['one_step']['mae_scaled']:.4f} ar {document['references']['ar']['mae_scaled']:.4f} "
            f"lsd {document['free_run']['lsd_db']} ceiling {document['ceiling']['lsd_db']} "
            f"ar {document['free_run_ar']['lsd_db']} bias {document['free_run']['level_bias_db']}"
        )

    work_through(runs(), RESULTS, arguments, lambda run: execute(run, arguments.recordings, arguments.keep), line)


@dataclasses.dataclass(frozen=True)
class Figure:
    """A figure of the judge's documents of a model by its path, over another one where `over` is given."""

    path: str
    digits: int
    over: str = ""
    model: str = "foten-plus"

    def __call__(self, document: dict[str, Any]) -> float | None:
        values = [at(document, path) for path in (self.path, self.over) if path]
        if any(value is None for value in values):
            return None
        return float(values[0] if len(values) == 1 else values[0] / values[1])

    def cell(self, documents: list[dict[str, Any]]) -> str:
        """Return mean ± standard error over split seeds, "(one)" for one, a dash where the figure is not known."""
        values = [self(document) for document in documents]
        if not values or any(value is None for value in values):
            return "–"
        mean = f"{np.mean(values):.{self.digits}f}"
        if len(values) == 1:
            return f"{mean} (one)"
        return f"{mean} ± {np.std(values, ddof=1) / np.sqrt(len(values)):.{self.digits}f}"

    def mean(self, by_texture: list[list[dict[str, Any]]]) -> str:
        """Return the mean over textures, each texture's mean over its splits counting once, ± its standard error."""
        values = [[self(document) for document in documents] for documents in by_texture]
        if not all(v and None not in v for v in values):
            return "–"
        mean, error = mean_and_error(values)
        return f"{mean:.{self.digits}f}" + ("" if error is None else f" ± {error:.{self.digits}f}")


def mean_and_error(by_texture: Iterable[list[float]]) -> tuple[float, float | None]:
    """Return the mean over textures of their means over splits, and its standard error by theirs; None where a split is alone."""
    arrays = [np.array(values) for values in by_texture]
    errors = [values.std(ddof=1) / np.sqrt(values.size) if values.size > 1 else None for values in arrays]
    mean = float(np.mean([values.mean() for values in arrays]))
    if None in errors:
        return mean, None
    return mean, float(np.sqrt(np.square(errors).sum()) / len(arrays))


@dataclasses.dataclass(frozen=True)
class Share:
    """In how many of the runs something is so; None where a run does not say."""

    so: Callable[[dict[str, Any]], bool | None]
    model: str = "foten-plus"

    def cell(self, documents: list[dict[str, Any]]) -> str:
        so = [self.so(document) for document in documents]
        return "–" if None in so or not so else f"{sum(so)} of {len(so)}"

    def mean(self, by_texture: list[list[dict[str, Any]]]) -> str:
        return self.cell([document for documents in by_texture for document in documents])


class Interval(Figure):
    """Where a figure of the recording lies with 95 %, mean of both ends over splits."""

    def cell(self, documents: list[dict[str, Any]]) -> str:
        low, high = (np.mean([at(document, f"{self.path}_{end}") for document in documents]) for end in ("low", "high"))
        return f"{low:.{self.digits}f} to {high:.{self.digits}f}"

    def mean(self, by_texture: list[list[dict[str, Any]]]) -> str:
        return ""


def at(document: dict[str, Any], path: str) -> Any:
    for key in path.split("."):
        document = document[key]
    return document


ERROR, BEST = "one_step.mae_scaled", "references.ar_best.mae_scaled"
SUMMARY = {
    "one step ÷ best AR": Figure(ERROR, 3, BEST),
    "that of `foten`": Figure(ERROR, 3, BEST, "foten"),
    "one step ÷ bound": Figure(ERROR, 3, "references.bound_window.mae_scaled"),
    "LSD ÷ AR(20)": Figure("free_run.lsd_db", 3, "free_run_ar.lsd_db"),
    "LSD ÷ ceiling": Figure("free_run.lsd_db", 3, "ceiling.lsd_db"),
    "long LSD": Figure("free_run.lsd_long_db", 2),
    "of its ceiling": Figure("ceiling.lsd_long_db", 2),
    "level error ÷ ceiling": Figure("free_run.level_error_db", 3, "ceiling.level_error_db"),
    "kurtosis": Figure("free_run.kurtosis", 2),
    "recorded": Interval("recording.kurtosis", 2),
    "network in the loop": Share(lambda document: document["validation_free_run"].get("network_in_loop")),
}
ONE_STEP = {
    "zero": Figure("references.zero.mae_scaled", 3),
    "AR(20)": Figure("references.ar.mae_scaled", 4),
    "best AR": Figure(BEST, 4),
    "bound of m": Figure("references.bound_window.mae_scaled", 4),
    "`foten`": Figure(ERROR, 4, model="foten"),
    "`foten-plus`": Figure(ERROR, 4),
    "÷ AR(20)": Figure(ERROR, 3, "references.ar.mae_scaled"),
    "÷ best AR": Figure(ERROR, 3, BEST),
    "÷ bound": Figure(ERROR, 3, "references.bound_window.mae_scaled"),
    "÷ lattice": Figure(ERROR, 3, "references.lattice.mae_scaled"),
    "on validation": Figure("validation.mae_scaled", 3, "validation.mae_scaled_lattice"),
}
FREE_RUN = {
    "LSD": Figure("free_run.lsd_db", 2),
    "LSD of AR(20)": Figure("free_run_ar.lsd_db", 2),
    "LSD of the ceiling": Figure("ceiling.lsd_db", 2),
    "LSD ÷ AR(20)": Figure("free_run.lsd_db", 3, "free_run_ar.lsd_db"),
    "LSD ÷ ceiling": Figure("free_run.lsd_db", 3, "ceiling.lsd_db"),
    "LSD of `foten`": Figure("free_run_deterministic.lsd_db", 1, model="foten"),
    "long LSD": Figure("free_run.lsd_long_db", 2),
    "of its ceiling": Figure("ceiling.lsd_long_db", 2),
    "long LSD ÷ AR(20)": Figure("free_run.lsd_long_db", 3, "free_run_ar.lsd_long_db"),
}
LEVEL = {
    "level bias": Figure("free_run.level_bias_db", 2),
    "level error": Figure("free_run.level_error_db", 2),
    "level error ÷ AR(20)": Figure("free_run.level_error_db", 3, "free_run_ar.level_error_db"),
    "level error ÷ ceiling": Figure("free_run.level_error_db", 3, "ceiling.level_error_db"),
    "level correlation": Figure("free_run.level_corr", 3),
    "correlation of the ceiling": Figure("ceiling.level_corr", 3),
    "kurtosis": Figure("free_run.kurtosis", 2),
    "kurtosis recorded": Figure("recording.kurtosis", 2),
    "its 95 %": Interval("recording.kurtosis", 2),
    "within": Share(lambda document: abs(_in_interval(document)) <= 1),
    "of the test blocks": Figure("free_run.kurtosis_recorded", 2),
}
KINDS = {
    "real four": (REAL, 10_000.0),
    "linear family": (tuple(LINEAR_FAMILY), 1000.0),
    "simulated twelve": (tuple(TEXTURES), 1000.0),
}
Groups = dict[tuple[str, float], dict[str, list[dict[str, Any]]]]


def summary() -> str:
    """Return the README's table as Markdown, from the result files alone."""
    groups, states = _groups()
    return "\n\n".join([_rows(groups, SUMMARY), *_earlier_states(states, "named in docs/results.md")])


def tables() -> str:
    """Return all tables as Markdown, from the result files alone."""
    groups, states = _groups()
    parts = [
        f"**{title}**\n\n{_rows(groups, columns)}"
        for title, columns in (
            ("One step", ONE_STEP),
            ("Free run: spectrum", FREE_RUN),
            ("Free run: level and kurtosis", LEVEL),
        )
    ]
    aims = f"**What was aimed at**\n\n{_aims(groups)}"
    return "\n\n".join([aims, *parts, *_earlier_states(states), *_training()])


@dataclasses.dataclass(frozen=True)
class Aim:
    """What a figure is to be at most, or at least, on the mean of some textures and on each of them."""

    title: str
    kind: str
    figure: Callable[[dict[str, Any]], float | None]
    mean: float | None = None
    each: float | None = None
    at_least: bool = False
    seeds: tuple[int, ...] = SEEDS

    def row(self, groups: Groups) -> str:
        """Return aim and figure: the mean over textures of means over splits, and the worst texture's; ± standard errors."""
        textures, rate = KINDS[self.kind]
        values = {
            texture: [
                self.figure(document)
                for document in groups.get((texture, rate), {}).get("foten-plus", [])
                if document["run"]["split_seed"] in self.seeds
            ]
            for texture in textures
        }
        known = {texture: [x for x in v if x is not None] for texture, v in values.items() if v and None not in v}
        of = self.kind
        if self.seeds != SEEDS:
            of += f", splits {self.seeds[0]} to {self.seeds[-1]}"
        if len(known) < len(textures):
            of += f", {len(known)} of {len(textures)} so far"
        if not known:
            return f"| {self.title} | {of} | {self._asked(self.mean)} | – | {self._asked(self.each)} | – |"
        worst = (min if self.at_least else max)(known, key=lambda texture: float(np.mean(known[texture])))
        mean = self._reached(known.values(), self.mean)
        each = f"{self._reached([known[worst]], self.each)} ({worst})"
        return f"| {self.title} | {of} | {self._asked(self.mean)} | {mean} | {self._asked(self.each)} | {each} |"

    def _asked(self, aim: float | None) -> str:
        return "" if aim is None else f"{'≥' if self.at_least else '≤'} {aim:g}"

    def _reached(self, by_texture: Iterable[list[float]], aim: float | None) -> str:
        value, error = mean_and_error(by_texture)
        text = f"{value:.3f}" + ("" if error is None else f" ± {error:.3f}")
        if aim is None:
            return text
        if error is not None and abs(value - aim) < error:
            return f"{text} ○"
        return f"{text} {'✓' if (value >= aim if self.at_least else value <= aim) else '✗'}"


def _behind_ceiling(document: dict[str, Any]) -> float | None:
    ours, ceiling = (at(document, f"{of}.level_corr") for of in ("free_run", "ceiling"))
    return None if None in (ours, ceiling) else ours - ceiling


def _in_interval(document: dict[str, Any]) -> float:
    """Return where the kurtosis lies in the recording's interval, from −1 to 1."""
    low, high = (document["recording"][f"kurtosis_{end}"] for end in ("low", "high"))
    return float((2 * at(document, "free_run.kurtosis") - low - high) / (high - low))


def _over_its_end(end: str) -> Callable[[dict[str, Any]], float]:
    """Return the kurtosis of the free run over that end of the recording's interval."""

    def ratio(document: dict[str, Any]) -> float:
        return float(at(document, "free_run.kurtosis") / document["recording"][f"kurtosis_{end}"])

    return ratio


FOUR, TWELVE, LINEAR = "real four", "simulated twelve", "linear family"
UNSEEN = (3, 4, 5)  # splits of the simulated twelve on which nothing was decided
AIMS = (
    Aim("one step ÷ best AR", FOUR, SUMMARY["one step ÷ best AR"], mean=0.995, each=1.0),
    Aim("one step ÷ bound", LINEAR, SUMMARY["one step ÷ bound"], mean=1.01),
    *(
        aim
        for seeds in (SEEDS, UNSEEN)
        for aim in (
            Aim("one step ÷ best AR", TWELVE, SUMMARY["one step ÷ best AR"], mean=0.95, seeds=seeds),
            Aim("LSD ÷ ceiling", TWELVE, SUMMARY["LSD ÷ ceiling"], mean=1.05, each=1.15, seeds=seeds),
            Aim("long LSD [dB]", TWELVE, SUMMARY["long LSD"], mean=1.0, seeds=seeds),
            Aim("long LSD of the ceiling [dB]", TWELVE, SUMMARY["of its ceiling"], seeds=seeds),
            Aim("level error ÷ ceiling", TWELVE, SUMMARY["level error ÷ ceiling"], mean=1.15, seeds=seeds),
            Aim("level correlation − ceiling", TWELVE, _behind_ceiling, mean=-0.03, at_least=True, seeds=seeds),
        )
    ),
    *(
        aim
        for kind in (LINEAR, FOUR)
        for aim in (
            Aim("level error ÷ ceiling", kind, SUMMARY["level error ÷ ceiling"], mean=1.15),
            Aim("level correlation − ceiling", kind, _behind_ceiling, mean=-0.03, at_least=True),
        )
    ),
    Aim("LSD ÷ AR(20)", FOUR, SUMMARY["LSD ÷ AR(20)"], mean=0.95),
    Aim("long LSD ÷ AR(20)", FOUR, FREE_RUN["long LSD ÷ AR(20)"], mean=0.95),
    Aim("kurtosis ÷ the upper end of the recorded 95 %", FOUR, _over_its_end("high"), each=1.0),
    Aim("kurtosis ÷ the lower end", FOUR, _over_its_end("low"), each=1.0, at_least=True),
)


def _aims(groups: Groups) -> str:
    lines = ["| figure | of | aim for the mean | mean | aim for each | worst |", "|" + "---|" * 6]
    return "\n".join([*lines, *(aim.row(groups) for aim in AIMS), *_other_aims()])


def _other_aims() -> Iterator[str]:
    """Return the rows of what `stability.py` and `onset.py` have measured, and of what a sample costs."""
    attacked, onsets = (
        [read(path) for path in sorted((RESULTS.parent / name).glob("*.json"))] for name in ("stability", "onset")
    )
    cost = FotenPlusSizes().multiply_adds() / FotenSizes().multiply_adds()
    yield f"| multiply-adds of the default network ÷ the paper's | | ≤ 1.25 | {cost:.3f} {_mark(cost <= 1.25)} | | |"
    if attacked:
        bounded = [one["attack_finite"] and one["attack_later_max_sd"] <= one["attack_bound_sd"] for one in attacked]
        worst = max(attacked, key=lambda one: one["forgets_s"] or np.inf)
        hits, steps = (sum(one[name] for one in attacked) for name in ("n_saturated", "samples"))
        of = f"{len(attacked)} texture files"
        yield f"| 10⁶ steps of attack: within the proven bound | {of} | all | {sum(bounded)} {_mark(all(bounded))} | | |"
        yield f"| samples cut in normal strokes | {of} | 0 | {hits} of {steps:,} {_mark(hits == 0)} | | |"
        forgets = worst["forgets_s"]
        text = f"{forgets:.1f} {_mark(True)}" if forgets is not None else f"never {_mark(False)}"
        text += f" ({name_of(worst, 'stability')})"
        yield f"| windows of ±50 sd forgotten to 1 % [s] | {of} | | | ≤ 12 (3 at 10 kHz) | {text} |"
    if onsets:
        of = f"{len(onsets)} texture files"
        for title, figure in (
            ("size of the level 100 ms after a start [dB]", lambda one: abs(one["level_db"][-1])),
            ("spectrum 100 ms after a start [dB]", lambda one: one["spectrum_db"][-1]),
        ):
            worst = max(onsets, key=figure)
            mean = float(np.mean([figure(one) for one in onsets]))
            each = f"{figure(worst):.2f} {_mark(figure(worst) <= 1)} ({name_of(worst, 'onset')})"
            yield f"| {title} | {of} | | {mean:.2f} | ≤ 1 | {each} |"
        clicks = [(one["click_share"] - one["settled_share"]) / one["click_standard_error"] for one in onsets]
        worst = onsets[int(np.argmax(clicks))]
        # What chance exceeds in one of twenty such sets of files.
        limit = NormalDist().inv_cdf(1 - 0.05 / len(onsets))
        yield (
            f"| loud samples in the first 20 ms beyond settled sound's, in standard errors | {of} | | {np.mean(clicks):+.1f} | "
            f"≤ {limit:.1f}, chance | {max(clicks):+.1f} {_mark(max(clicks) <= limit)} ({name_of(worst, 'onset')}) |"
        )


def _mark(reached: bool) -> str:
    return "✓" if reached else "✗"


def _groups() -> tuple[Groups, dict[str, list[str]]]:
    """Return the documents by texture and rate, then by model, and the names of those that each state of the sources made."""
    groups: Groups = {}
    states: dict[str, list[str]] = {}
    for path in sorted(RESULTS.glob("*.json")):
        document = read(path)
        run = document["run"]
        states.setdefault(document["source_sha256"], []).append(path.stem)
        groups.setdefault((run["texture"], run["rate_hz"]), {}).setdefault(run["model"], []).append(document)
    return groups, states


def _rows(groups: Groups, columns: Mapping[str, Figure | Share]) -> str:
    order = [*REAL, *LINEAR_FAMILY, *TEXTURES]
    head = ["texture", "rate", "splits", *columns]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for texture, rate in sorted(groups, key=lambda key: (-key[1], order.index(key[0]))):
        models = groups[texture, rate]
        if "foten-plus" not in models:
            continue
        cells = [texture, f"{rate / 1000:g} kHz", str(len(models["foten-plus"]))]
        cells += [figure.cell(models.get(figure.model, [])) for figure in columns.values()]
        lines.append(f"| {' | '.join(cells)} |")
    for title, (textures, rate) in KINDS.items():
        by_texture = [groups.get((texture, rate), {}) for texture in textures]
        if all("foten-plus" in models for models in by_texture):
            cells = [f"mean of the {title}", f"{rate / 1000:g} kHz", ""]
            cells += [
                figure.mean([models.get(figure.model, []) for models in by_texture]) for figure in columns.values()
            ]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def name_of(result: dict[str, Any], kind: str) -> str:
    """Return the texture's name of a result that is kept in the folder `kind`, marked where it may come out other today."""
    name = result["file"].split("-foten-plus-")
    split = f", split {name[1]}" if name[1:] and name[1] != "1" else ""
    mark = "" if result["source_sha256"] in {SOURCES, *_vouched(kind)} else " †"
    texture = name[0].removesuffix(f"-{result['rate_hz']:g}")
    return f"{texture}{split}{mark}"


def made_earlier(folder: Path) -> Iterator[str]:
    """Say what the mark of `name_of` is, where one is."""
    if any("†" in name_of(read(path), folder.name) for path in folder.glob("*.json")):
        yield "\n† made by an earlier state of the sources."


def _made_again() -> dict[str, dict[str, dict[str, list[str]]]]:
    """Return by state of the sources which runs of which earlier ones it made again, and came out equal or other."""
    return json.loads(SAME.read_text()) if SAME.exists() else {}


def _vouched(kind: str = "", today: str = SOURCES) -> dict[str, tuple[str, list[str], bool]]:
    """Return the states whose results come out the same today: by which other that is known, of which runs, and whether the
    other made them again, or they those of the other.

    Args:
        kind: of the results: runs of this table, or the folder's name of others.
        today: the state that others are to be the same as.
    """
    vouched: dict[str, tuple[str, list[str], bool]] = {}
    waiting, made_again = [today], _made_again()

    def of_kind(names: list[str]) -> list[str]:
        return [name for name in names if name.rpartition("/")[0] == kind]

    differ = {source for again in made_again.values() for source, names in again["differ"].items() if of_kind(names)}
    while waiting:
        by = waiting.pop()
        pairs = [
            (other, source, of_kind(names), other == by)
            for other, again in made_again.items()
            for source, names in again["equal"].items()
            if by in (other, source)
        ]
        for other, source, names, again in pairs:
            new = source if again else other
            if names and new not in {today, *differ, *vouched}:
                vouched[new] = (by, names, again)
                waiting.append(new)
    return vouched


def alike() -> dict[str, str]:
    """Return for each state one of those whose results come out the same: today's, where it is among them."""
    same: dict[str, str] = {}
    for state in (SOURCES, *sorted(_made_again())):
        if state not in same:
            same |= dict.fromkeys([state, *_vouched(today=state)], state)
    return same


def _earlier_states(states: dict[str, list[str]], where: str = "") -> Iterator[str]:
    """Say how many results were made by other sources than those that are here, and name them, or say where they are named.

    Those of a state of which some were made again, by today's or by one of which that holds, and none came out other, are not
    named.
    """
    n, vouched = sum(map(len, states.values())), _vouched()
    known = [source for source in sorted(states) if source in vouched]
    if known:
        lines = []
        for source in known:
            by, names, again = vouched[source]
            who = "today's" if by == SOURCES else f"{by[:8]}"
            of = f"of which {who} made {len(names)} again" if again else f"which made {len(names)} of {who} again"
            lines.append(
                f"{len(states[source])} by {source[:8]}, {of}" + ("" if where else f" ({', '.join(sorted(names))})")
            )
        yield (
            f"Of {n} runs, some were made by earlier states of the sources: {'; '.join(lines)}. All that were made again were "
            "equal to the last digit, each pair on one machine."
        )
    earlier = sorted(name for source, names in states.items() if source not in {SOURCES, *vouched} for name in names)
    if earlier:
        splits: dict[str, list[str]] = {}
        for name in earlier:
            of, _, split = name.rpartition("-")
            splits.setdefault(of, []).append(split)
        named = ", ".join(f"{of} ({', '.join(numbers)})" for of, numbers in splits.items())
        yield (
            f"Of {n} runs, {len(earlier)} were made by an earlier state of the sources"
            + (f" ({where})." if where else f"; with their splits: {named}.")
        )


def _training() -> Iterator[str]:
    """Return the table of what `training.py` measured, where it was run."""
    if not TRAINING.exists():
        return
    training = json.loads(TRAINING.read_text())
    about = f"{training['seconds']:g} s of {training['texture']}, {training['n_train_windows']} windows, {training['device']}"
    lines = [
        f"**Training** `{training['model']}` on {about}; `foten train` of `foten-plus` there takes "
        f"{training['foten_train_command_seconds']:.0f} s, start and proof included",
        "",
        "| recipe | threads | s an epoch | s in all | lowest validation loss | s to the paper's lowest | paper's ÷ its |",
        "|" + "---|" * 7,
    ]
    for name, arm in training["arms"].items():
        seconds, paper = (a["seconds_to"]["1"] for a in (arm, training["arms"]["paper"]))
        lines.append(
            f"| {name} | {arm['config']['threads']} | {arm['seconds_per_epoch']:.1f} | {arm['total_seconds']:.0f} | "
            f"{arm['lowest_validation_loss']:.5f} | "
            + ("never | – |" if seconds is None else f"{seconds:.0f} | {paper / seconds:.1f} |")
        )
    yield "\n".join(lines)


def between(page: Path | None, name: str, text: str) -> None:
    """Put text between the markers of that name in a Markdown file, or print it where there is none."""
    if page is None:
        print(text)
        return
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    before, opened, others = page.read_text().partition(begin)
    _, closed, after = others.partition(end)
    if not opened or not closed:
        sys.exit(f"{page.name}: has no {begin} … {end} to put the tables between")
    with atomic_write(page) as part:
        part.write_text(f"{before}{begin}\n{text}\n{end}{after}")


def tabulate_all(arguments: argparse.Namespace) -> None:
    between(arguments.readme, "main_table", summary())
    between(arguments.page, "main_table", tables())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    run = commands.add_parser("run")
    run.add_argument("--only", default="*", help="run names to match, as TEXTURE-RATE-MODEL-SEED")
    run.add_argument("--recordings", type=Path, default=Path("recordings"))
    run.add_argument("--keep", type=Path, help="directory for the texture files")
    run.add_argument(
        "--again", action="store_true", help="execute results of an earlier state again, and keep which are equal"
    )
    run.set_defaults(command=run_all)
    tabulate = commands.add_parser("table")
    tabulate.add_argument("--readme", type=Path, help="put the short table between its markers in this file")
    tabulate.add_argument("--page", type=Path, help="put all tables between their markers in this file")
    tabulate.set_defaults(command=tabulate_all)
    arguments = parser.parse_args()
    arguments.command(arguments)


if __name__ == "__main__":
    main()
