"""An experiment: which methods learn which textures with which settings, read from a TOML file, and the runs that result."""

from __future__ import annotations

import difflib
import hashlib
import itertools
import json
import re
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from foten.baselines.sizes import TRAINABLE, trainable_sizes
from foten.datasets.hdf5 import load_recording
from foten.recording.preprocess import PreprocessConfig
from foten.recording.recording import Recording
from foten.simulation.simulate import CONTACT, LINEAR_FAMILY, TEXTURES, simulate
from foten.training.config import OWN_RECIPES, RECIPES, TrainConfig, check_used

RECORDED = (".h5", ".hdf5")
OF_FIRST_SPLIT = ("stability", "onset")
MEASURES = {
    **{name: f"foten.experiments.{name}" for name in OF_FIRST_SPLIT},
    **dict.fromkeys(("listener", "validation_listener"), "foten.evaluate.listener_network"),
}
"""Measures of a texture file beside its evaluation, and the module that only they execute.

Of the first split of each texture, those of `OF_FIRST_SPLIT`; of every split what listeners can tell.
"""
KINDS: dict[str, tuple[Any, str]] = {
    "str": (str, "a text"),
    "float": (int | float, "a number"),
    "tuple": (list, "a list"),
    "Mapping": (dict, "a table"),
}
"""Types of the fields below, and what they are in TOML."""
OF_TRAINING = {setting.name for setting in fields(TrainConfig)} - {"recipe"}


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
    measures: tuple[str, ...] = ()  # what is measured of its texture file beside the evaluation, of `MEASURES`

    @property
    def label(self) -> str:
        """Name of its row in a table: the method, and its cell of the grid."""
        return " ".join([self.method, ", ".join(f"{k} {v}" for k, v in self.cell.items())]).rstrip()

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
    """Name of a texture: of a recording, its file's without folder and suffix."""
    return Path(texture).stem


def recording_of(run: Run) -> Recording:
    """What a run learns from."""
    if run.seconds is None:
        return load_recording(Path(run.texture))
    return simulate(run.texture, run.seconds, seed=run.split_seed)


@dataclass(frozen=True)
class Method:
    """A row of a table: a model, what it changes of the experiment's settings, and what it is called."""

    model: str
    name: str = ""  # in tables; the model's key by default
    recipe: str | None = None  # of training; None for the experiment's
    train: Mapping[str, Any] = field(default_factory=dict)  # changes of the recipe
    sizes: Mapping[str, Any] = field(default_factory=dict)  # changes of the model's
    # Changes of the above by name, each of a recipe that it may name: tables show the one that is best on validation.
    recipes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    beside: str = ""  # the name of the method that this one is a change of: their ratios are a table
    split_seeds: tuple[int, ...] | None = None  # None for the experiment's
    measures: tuple[str, ...] = ()  # of `MEASURES`, beside the evaluation

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
    # Lists of settings of training, or of sizes where a model has them, by name: every combination is run.
    grid: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)

    def runs(self) -> list[Run]:
        """Every run, in the order of the recordings.

        Raises:
            ValueError: a setting is unknown or out of range; the message names the method.
        """
        return [
            self._resolved(texture, method, split_seed, dict(zip(self.grid, values, strict=False)), recipe)
            for texture in self.textures
            for split_seed in self.split_seeds
            for method in self.methods
            if method.split_seeds is None or split_seed in method.split_seeds
            for recipe in method.recipes or [""]
            for values in (itertools.product(*self.grid.values()) if method.model != "ar" else [()])
        ]

    def _resolved(self, texture: str, method: Method, split_seed: int, cell: Mapping[str, Any], recipe: str) -> Run:
        name, model = method.title, method.model
        changes = dict(method.recipes.get(recipe, {}))
        base = changes.pop("recipe", method.recipe or self.recipe)
        changed = {**method.train, **changes, **{k: v for k, v in cell.items() if k in OF_TRAINING}}
        sizes = {**method.sizes, **{k: v for k, v in cell.items() if k not in OF_TRAINING}}
        train: dict[str, Any] = {}
        try:
            preprocess = asdict(PreprocessConfig(**self.preprocess))
            if model != "ar":
                sizes = trainable_sizes(model, sizes).to_card()
                settings = {"threads": 1, "seed": split_seed, **OWN_RECIPES.get(model, {}), **self.train, **changed}
                check_used(model, changed, settings.get("loss", RECIPES[base].loss))
                train = asdict(replace(RECIPES[base], **settings))
            elif sizes or changed or method.recipe or method.recipes:
                raise ValueError("'ar' is fitted without a recipe and finds its sizes: leave them out")
        except (TypeError, ValueError) as error:
            raise ValueError(f"method {name!r}: {error}") from error
        seconds = None if texture.endswith(RECORDED) else float(self.seconds)
        first = split_seed == self.split_seeds[0]
        measures = tuple(name for name in method.measures if first or name not in OF_FIRST_SPLIT)
        return Run(
            name, texture, seconds, model, sizes, train, preprocess, split_seed, cell, recipe, method.beside, measures
        )


def experiments() -> dict[str, str]:
    """Titles of the experiments that come with foten, by name."""
    paths = sorted(Path(__file__).parent.glob("*.toml"), key=lambda path: path.stem)
    return {path.stem: tomllib.loads(path.read_text(encoding="utf-8"))["title"] for path in paths}


def experiment_path(name: str) -> Path:
    """Path of an experiment: a file, or by its name one that comes with foten.

    Raises:
        FileNotFoundError: there is neither.
    """
    if Path(name).suffix == ".toml":
        return Path(name)
    path = Path(__file__).with_name(f"{name}.toml")
    if path.exists():
        return path
    raise FileNotFoundError(f"no experiment {name!r}, expected a .toml file or one of {', '.join(experiments())}")


def read_experiment(path: Path, recordings: Path | None = None) -> Experiment:
    """Experiment in a TOML file.

    Args:
        recordings: folder of its recordings; by default that of the file.

    Raises:
        OSError: there is none.
        ValueError: it is no TOML, has an unknown key, or a value does not fit; one line says which.
    """
    try:
        return _experiment(tomllib.loads(path.read_text(encoding="utf-8")), recordings or path.parent)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path.name}: this is not TOML ({error})") from error
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error


def _experiment(content: dict[str, Any], folder: Path) -> Experiment:
    _check(content, Experiment, "the file")
    for name in ("title", "textures", "methods"):
        if not content.get(name):
            raise ValueError(f"there is no {name!r}, expected title, textures and methods")
    methods = tuple(map(_method, content["methods"]))
    names = {method.title for method in methods}
    if len(names) < len(methods):
        raise ValueError("two methods have the same name: give them a 'name' each")
    textures = tuple(_texture(texture, folder) for texture in content["textures"])
    if len(set(map(texture_name, textures))) < len(textures):
        raise ValueError("two textures have the same name, which tables could not tell apart")
    grid = content.get("grid", {})
    _check_keys(content.get("train", {}), OF_TRAINING, "[train]")
    _check_keys(content.get("preprocess", {}), _names(PreprocessConfig), "[preprocess]")
    networks = [method.model for method in methods if method.model != "ar"]  # which finds its sizes
    _check_keys(grid, set().union(*(OF_TRAINING | _names(TRAINABLE[model]) for model in networks)), "[grid]")
    for name, values in grid.items():
        if not isinstance(values, list) or not values:
            raise ValueError(f"{name!r} in the grid is {values!r}, expected a list")
    seeds = _seeds(content.get("split_seeds", [1]))
    for method in methods:
        if not set(method.split_seeds or ()) <= set(seeds):
            raise ValueError(f"method {method.title!r}: its split_seeds are not all among the experiment's")
        if method.beside and method.beside not in names:
            raise ValueError(f"{method.title!r} stands beside {method.beside!r}, which is no method of the file")
    resolved = {"textures": textures, "methods": methods, "split_seeds": seeds}
    return Experiment(**{**content, **resolved, "grid": {name: tuple(values) for name, values in grid.items()}})


def _method(content: object) -> Method:
    if isinstance(content, str):
        content = {"model": content}
    if not isinstance(content, dict):
        raise ValueError(f"a method is {content!r}, expected a model's name or a table")
    _check(content, Method, "a method")
    if content.get("model") not in TRAINABLE:
        raise ValueError(f"unknown model {content.get('model')!r}, expected one of {', '.join(TRAINABLE)}")
    _check_keys(content.get("train", {}), OF_TRAINING, "'train' of a method")
    _check_keys(content.get("measures", []), MEASURES, "'measures' of a method")
    for name, changes in content.get("recipes", {}).items():
        if not isinstance(changes, dict):
            raise ValueError(f"recipe {name!r} of a method is {changes!r}, expected a table")
        _check_keys(changes, OF_TRAINING | {"recipe"}, f"recipe {name!r} of a method")
        _check_recipe(changes)
    lists: dict[str, Any] = {"measures": tuple(content.get("measures", ()))}
    if "split_seeds" in content:
        lists["split_seeds"] = _seeds(content["split_seeds"])
    return Method(**{**content, **lists})


def _seeds(seeds: list[object]) -> tuple[int, ...]:
    if not seeds or not all(type(seed) is int and seed >= 0 for seed in seeds) or len(set(seeds)) < len(seeds):
        raise ValueError(f"split_seeds is {seeds!r}, expected a list of whole numbers, each once")
    return tuple(seeds)  # type: ignore[arg-type]


def _texture(content: object, folder: Path) -> str:
    if isinstance(content, str) and content.endswith(RECORDED):
        if not (folder / content).exists():
            raise ValueError(f"there is no recording {content} in {folder}: give its folder by --recordings")
        return str(folder / content)
    known = [*TEXTURES, *CONTACT, *LINEAR_FAMILY]
    if content not in known:
        raise ValueError(f"unknown texture {content!r}, expected a recording, .h5, or one of {', '.join(known)}")
    return str(content)


def _check(content: Mapping[str, Any], configuration: type, where: str) -> None:
    """Check that a table has no other keys than a dataclass, and values of the kinds of its fields, and a known recipe."""
    _check_keys(content, _names(configuration), where)
    for setting in fields(configuration):
        kind, expected = KINDS[re.findall(r"\w+", str(setting.type))[0]]
        if setting.name in content and not isinstance(content[setting.name], kind):
            raise ValueError(f"{setting.name!r} of {where} is {content[setting.name]!r}, expected {expected}")
    _check_recipe(content)


def _check_recipe(content: Mapping[str, Any]) -> None:
    if content.get("recipe", "default") not in RECIPES:
        raise ValueError(f"unknown recipe {content['recipe']!r}, expected one of {', '.join(RECIPES)}")


def _check_keys(content: Collection[str], known: Collection[str], where: str) -> None:
    unknown = sorted(set(content) - set(known))
    if unknown:
        near = difflib.get_close_matches(unknown[0], known, 1)
        expected = f"{near[0]!r}?" if near else f"one of {', '.join(sorted(known))}"
        raise ValueError(f"unknown key {unknown[0]!r} in {where}, expected {expected}")


def _names(configuration: Any) -> set[str]:
    return {setting.name for setting in fields(configuration)}
