"""An experiment in a TOML file: which methods learn which textures with which settings, and the runs of it."""

from __future__ import annotations

import difflib
import hashlib
import itertools
import json
import re
import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from foten.datasets.hdf5 import load_recording
from foten.models.trainable import TRAINABLE, check_used, recipe_of, trainable_sizes
from foten.recording.preprocess import PreprocessConfig
from foten.recording.recording import Recording
from foten.simulation.simulate import CONTACT, LINEAR_FAMILY, OTHER_LINEAR, TEXTURES, TWO_MASS, check_seconds, simulate
from foten.training.config import FILTERS
from foten.untrusted import MAX_TOML, parse_toml, read_whole

EXPERIMENTS = Path(__file__).with_name("experiments")  # that come along
RECORDED = (".h5", ".hdf5")
MAX_RUNS = 2000  # of a sweep, and of its tables
OF_FIRST_SPLIT = ("stability", "onset")  # measures that are taken of no other split
MEASURES = {
    **{name: f"foten_lab.{name}" for name in OF_FIRST_SPLIT},
    **dict.fromkeys(("listener", "validation_listener"), "foten.evaluate.listener_network"),
}
"""Measures of a texture file beside its evaluation, and the module that only they execute."""
KINDS: dict[str, tuple[Any, str]] = {
    "str": (str, "a text"),
    "float": (int | float, "a number"),
    "tuple": (list, "a list"),
    "Mapping": (dict, "a table"),
}
"""Types of the fields below, and what they are in TOML."""
OF_TRAINING = {name for entry in TRAINABLE.values() for name in entry.settings}
KEYS: dict[str, Collection[str]] = {
    "train": OF_TRAINING,
    "preprocess": [setting.name for setting in fields(PreprocessConfig)],
    "measures": [*MEASURES],
}
"""What may stand in tables and lists of these names."""


@dataclass(frozen=True)
class Run:
    """One method on one texture and split, everything resolved: equal runs have equal results."""

    method: str  # its name in tables, on which the result does not depend
    texture: str  # key of the simulator, or the path of a recording
    seconds: float | None  # simulated [s]; None for a recording
    model: str
    sizes: Mapping[str, Any]  # all of them, as all settings of `train` and `preprocess`
    train: Mapping[str, Any]
    preprocess: Mapping[str, Any]
    split_seed: int  # of the split, and of the simulated recording
    cell: Mapping[str, Any] = field(default_factory=dict)  # of the grid: its own settings; a name, as `method`
    recipe: str = ""  # of several that the method has; a name too
    beside: str = ""  # the method whose figures its own are divided by; a name too
    measures: tuple[str, ...] = ()  # of `MEASURES`

    @property
    def label(self) -> str:
        """Name of its row in a table: the method, and its cell of the grid, which its result holds in alphabetical order too."""
        return " ".join([self.method, ", ".join(f"{k} {v}" for k, v in sorted(self.cell.items()))]).rstrip()

    @property
    def line(self) -> str:
        """What it is, as a sweep lists it."""
        recipe = f" ({self.recipe})" if self.recipe else ""
        return f"{self.label}{recipe}, {texture_name(self.texture)}, split {self.split_seed}"

    @property
    def source(self) -> tuple[str, float | None, int]:
        """What determines the recording that is learned from."""
        return self.texture, self.seconds, self.split_seed

    @property
    def place(self) -> tuple[str, str, str, int]:
        """Its place in tables: row, recipe, texture and split."""
        return self.label, self.recipe, texture_name(self.texture), self.split_seed

    @property
    def configuration(self) -> str:
        """Digest of the settings that the result depends on; the recording's stands for texture and seconds."""
        labels = ("method", "cell", "recipe", "beside", "texture", "seconds")
        settings = {name: value for name, value in asdict(self).items() if name not in labels}
        return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]


def texture_name(texture: str) -> str:
    """Name of a texture: the simulator's key, or a recording's file without folder and suffix."""
    return Path(texture).stem


def recording_of(run: Run) -> Recording:
    """What a run learns from; each simulated texture is stroked by a hand of its own, and by another for each split.

    Under one hand the test blocks of all textures would be of the same speeds, and textures no replicates of one another.
    """
    if run.seconds is None:
        return load_recording(Path(run.texture))
    return simulate(run.texture, run.seconds, seed=zlib.crc32(f"{run.texture} {run.split_seed}".encode()))


@dataclass(frozen=True)
class Method:
    """A model, what it changes of the experiment's settings, and its name: a row of a table."""

    model: str
    name: str = ""  # in tables; the model's key by default
    recipe: str | None = None  # of training; None for the experiment's
    train: Mapping[str, Any] = field(default_factory=dict)  # changes of the recipe
    sizes: Mapping[str, Any] = field(default_factory=dict)  # changes of the model's
    # Changes of the above by name, each of a recipe that it may name: tables show the one that is best on validation.
    recipes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    beside: str = ""  # the name of the method that this one is a change of: their ratios are a table
    split_seeds: tuple[int, ...] | None = None  # None for the experiment's
    measures: tuple[str, ...] = ()  # of `MEASURES`

    @property
    def title(self) -> str:
        """Name in tables."""
        return self.name or self.model


@dataclass(frozen=True)
class Experiment:
    """Methods × textures × splits × a grid of settings."""

    title: str  # of its tables
    textures: tuple[str, ...]  # keys of the simulator, or recordings (.h5)
    methods: tuple[Method, ...]  # rows
    note: str = ""  # what tables say above, of what was reduced for one
    seconds: float = 60.0  # that textures are simulated for
    split_seeds: tuple[int, ...] = (1,)  # of the splits; of simulated textures other strokes too
    recipe: str = "default"  # of training
    train: Mapping[str, Any] = field(default_factory=dict)  # changes of the recipe
    preprocess: Mapping[str, Any] = field(default_factory=dict)  # changes of `PreprocessConfig`
    recipes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # of each method that has none of its own
    # Grids: lists of settings of training, or of sizes where a model has them, by name; every combination of each is run.
    grid: tuple[Mapping[str, Sequence[Any]], ...] = ()

    def runs(self) -> list[Run]:
        """Every run, in the order of the recordings.

        Raises:
            ValueError: a setting is unknown or out of range; the message names the method. Or there are too many runs.
        """
        every_run = (
            self._resolved(texture, method, split_seed, cell, recipe)
            for texture in self.textures
            for split_seed in self.split_seeds
            for method in self.methods
            if method.split_seeds is None or split_seed in method.split_seeds
            for recipe in self._recipes(method) or [""]
            for cell in (self._cells() if TRAINABLE[method.model].has_network else [{}])
        )
        if len(runs := list(itertools.islice(every_run, MAX_RUNS + 1))) > MAX_RUNS:
            raise ValueError(f"it has more than {MAX_RUNS} runs (textures × splits × methods × settings): split it")
        return runs

    def _cells(self) -> Iterator[dict[str, Any]]:
        cells = ((grid, values) for grid in self.grid or [{}] for values in itertools.product(*grid.values()))
        return (dict(zip(grid, values, strict=True)) for grid, values in cells)

    def _recipes(self, method: Method) -> Mapping[str, Mapping[str, Any]]:
        return method.recipes or (self.recipes if TRAINABLE[method.model].has_network else {})

    def _resolved(self, texture: str, method: Method, split_seed: int, cell: Mapping[str, Any], recipe: str) -> Run:
        name, model = method.title, method.model
        changes = dict(self._recipes(method).get(recipe, {}))
        base = changes.pop("recipe", method.recipe or self.recipe)
        changed = {**method.train, **changes, **{k: v for k, v in cell.items() if k in OF_TRAINING}}
        sizes = {**method.sizes, **{k: v for k, v in cell.items() if k not in OF_TRAINING}}
        train: dict[str, Any] = {}
        try:
            recipe_filter = FILTERS["paper" if "paper" in (base, self.recipe) else base]
            preprocess = asdict(PreprocessConfig(**{**recipe_filter, **self.preprocess}))
            if TRAINABLE[model].has_network:
                sizes = trainable_sizes(model, sizes).to_card()
                config, settings = recipe_of(model, base), {"threads": 1, "seed": split_seed, **self.train, **changed}
                check_used(model, changed, settings.get("loss", getattr(config, "loss", None)))
                used = {name: value for name, value in settings.items() if name in TRAINABLE[model].settings}
                train = asdict(replace(config, **used))
            elif sizes or changed or method.recipe or method.recipes:
                raise ValueError(f"{model!r} is fitted without a recipe and finds its sizes: leave them out")
        except (TypeError, ValueError) as error:
            raise ValueError(f"method {name!r}: {error}") from error
        seconds = None if texture.endswith(RECORDED) else float(self.seconds)
        first = split_seed == self.split_seeds[0]
        measures = tuple(name for name in method.measures if first or name not in OF_FIRST_SPLIT)
        return Run(
            name, texture, seconds, model, sizes, train, preprocess, split_seed, cell, recipe, method.beside, measures
        )


def of_lines(runs: Iterable[Run], only: Sequence[str]) -> list[Run]:
    """Runs whose line contains one of some texts, all runs where there is no text.

    Raises:
        ValueError: a text is in no line.
    """
    runs = list(runs)
    for text in only:
        if not any(text in run.line for run in runs):
            raise ValueError(f"--only {text!r} is in no line of --dry-run, such as {runs[0].line!r}")
    return [run for run in runs if not only or any(text in run.line for text in only)]


def experiments() -> dict[str, str]:
    """Titles of the experiments that come with foten, by name."""
    paths = sorted(EXPERIMENTS.glob("*.toml"), key=lambda path: path.stem)
    return {path.stem: parse_toml(path.read_bytes())["title"] for path in paths}


def experiment_path(name: str) -> Path:
    """Path of an experiment: a file, or by its name one that comes with foten.

    Raises:
        FileNotFoundError: there is neither.
    """
    path = Path(name) if name.endswith(".toml") else EXPERIMENTS / f"{name}.toml"
    if not name.endswith(".toml") and not path.exists():
        raise FileNotFoundError(f"no experiment {name!r}, expected a .toml file or one of {', '.join(experiments())}")
    return path


def read_experiment(path: Path, recordings: Path | None = None) -> Experiment:
    """Experiment in a TOML file.

    Args:
        recordings: folder of its recordings; by default that of the file.

    Raises:
        OSError: there is none.
        ValueError: it is no TOML, or has an unknown key or a value that does not fit.
    """
    text = read_whole(path, 4 * MAX_TOML)
    try:
        experiment = _experiment(parse_toml(text), recordings or path.parent)
        experiment.runs()  # refuses settings that do not fit
        return experiment
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error


def _experiment(content: dict[str, Any], folder: Path) -> Experiment:
    grid = content.get("grid", [])
    values = _checked({**content, "grid": [grid] if isinstance(grid, dict) else grid}, Experiment, "the file")
    for name in ("title", "textures", "methods"):
        if not values.get(name):
            raise ValueError(f"there is no {name!r}, expected title, textures and methods")
    methods = tuple(map(_method, values["methods"]))
    textures = tuple(_texture(texture, folder) for texture in values["textures"])
    titles = [method.title for method in methods]
    for what, names in (("methods", titles), ("textures", list(map(texture_name, textures)))):
        if len(set(names)) < len(names):
            raise ValueError(f"two {what} have the same name, which tables could not tell apart")
    networks = [method.model for method in methods if TRAINABLE[method.model].has_network]
    sizes = {size.name for model in networks for size in fields(TRAINABLE[model].sizes)}
    _check_recipes(values.get("recipes", {}), "the file")
    for grid in values.get("grid", ()):
        if not isinstance(grid, dict):
            raise ValueError(f"a grid is {grid!r}, expected a table")
        if not networks:
            raise ValueError("a grid is of settings of networks, and the file has none: leave it out")
        _check_known("key", grid, OF_TRAINING | sizes, " in [grid]")
        for name, settings in grid.items():
            if not isinstance(settings, list) or not settings:
                raise ValueError(f"{name!r} in the grid is {settings!r}, expected a list")
    experiment = Experiment(**{**values, "textures": textures, "methods": methods})
    check_seconds(experiment.seconds)
    for method in methods:
        if not set(method.split_seeds or ()) <= set(experiment.split_seeds):
            raise ValueError(f"method {method.title!r}: its split_seeds are not all among the experiment's")
        if method.beside and method.beside not in titles:
            raise ValueError(f"{method.title!r} stands beside {method.beside!r}, which is no method of the file")
    return experiment


def _method(content: object) -> Method:
    if isinstance(content, str):
        content = {"model": content}
    if not isinstance(content, dict):
        raise ValueError(f"a method is {content!r}, expected a model's name or a table")
    values = _checked(content, Method, "a method")
    _check_known("model", [values.get("model")], TRAINABLE)
    _check_recipes(values.get("recipes", {}), "a method")
    return Method(**values)


def _check_recipes(recipes: Mapping[str, Any], where: str) -> None:
    for name, changes in recipes.items():
        if not isinstance(changes, dict):
            raise ValueError(f"recipe {name!r} of {where} is {changes!r}, expected a table")
        _check_known("key", changes, OF_TRAINING | {"recipe"}, f" in recipe {name!r} of {where}")
        _check_known("recipe", [changes.get("recipe", "default")], FILTERS)


def _texture(content: object, folder: Path) -> str:
    if isinstance(content, str) and content.endswith(RECORDED):
        if not (folder / content).exists():
            raise ValueError(f"there is no recording {content} in {folder}: give its folder by --recordings")
        return str(folder / content)
    _check_known("texture", [content], [*TEXTURES, *CONTACT, *TWO_MASS, *LINEAR_FAMILY, *OTHER_LINEAR])
    return str(content)


def _checked(content: Mapping[str, Any], configuration: type, where: str) -> dict[str, Any]:
    """Fields of a dataclass in a table of TOML, lists as tuples; unknown keys and values of another kind are refused."""
    kinds = {setting.name: KINDS[re.findall(r"\w+", str(setting.type))[0]] for setting in fields(configuration)}
    _check_known("key", content, kinds, f" in {where}")
    for name, value in content.items():
        kind, expected = kinds[name]
        if not isinstance(value, kind) or isinstance(value, bool):
            raise ValueError(f"{name!r} of {where} is {value!r}, expected {expected}")
        if name in KEYS:
            _check_known("key", value, KEYS[name], f" in {name!r} of {where}")
    seeds = content.get("split_seeds", [1])
    if not seeds or not all(type(seed) is int and seed >= 0 for seed in seeds) or len(set(seeds)) < len(seeds):
        raise ValueError(f"split_seeds is {seeds!r}, expected a list of whole numbers, each once")
    _check_known("recipe", [content.get("recipe", "default")], FILTERS)
    return {name: tuple(value) if isinstance(value, list) else value for name, value in content.items()}


def _check_known(what: str, names: Iterable[Any], known: Collection[str], where: str = "") -> None:
    unknown = [name for name in names if name not in known]
    if unknown:
        near = difflib.get_close_matches(str(unknown[0]), known, 1)
        expected = f"{near[0]!r}?" if near else f"one of {', '.join(sorted(known))}"
        raise ValueError(f"unknown {what} {unknown[0]!r}{where}, expected {expected}")
