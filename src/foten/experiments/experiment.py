"""An experiment: a small TOML file that says which methods learn which textures, and the runs that it stands for."""

from __future__ import annotations

import difflib
import hashlib
import itertools
import json
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from foten.architecture import ARCHITECTURES, ArArchitecture, architecture_from, sizes
from foten.datasets.simulate import LINEAR_FAMILY, TEXTURES
from foten.recording.preprocess import PreprocessConfig
from foten.train.config import OWN_RECIPES, RECIPES, TrainConfig, check_used

RECORDED = (".h5", ".hdf5")
OF_TRAINING = {one.name for one in fields(TrainConfig)} - {"recipe"}
OF_PREPROCESSING = {one.name for one in fields(PreprocessConfig)}


@dataclass(frozen=True)
class Run:
    """One method on one texture and split, everything resolved: equal runs have equal results.

    Attributes:
        method: what tables call it; not part of what the run is, as `cell`.
        texture: key of the simulator, or the path of a recording.
        seconds: simulated [s]; None for a recording.
        model, sizes, train, preprocess: of the texture, all sizes and settings.
        split_seed: of the split, and of the simulated recording.
        cell: of the grid, the settings that tell it from the method's other runs.
    """

    method: str
    texture: str
    seconds: float | None
    model: str
    sizes: Mapping[str, Any]
    train: Mapping[str, Any]
    preprocess: Mapping[str, Any]
    split_seed: int
    cell: Mapping[str, Any] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Return what a row of a table is called: the method, and its cell of the grid."""
        return " ".join([self.method, ", ".join(f"{k} {v}" for k, v in self.cell.items())]).rstrip()

    @property
    def source(self) -> tuple[str, float | None, int]:
        """Return what says which recording is learned from."""
        return self.texture, self.seconds, self.split_seed

    def name(self, recording_sha256: str, foten_version: str) -> str:
        """Return what the run's result file is called: the hash of all that the result depends on."""
        told = ("method", "cell", "texture", "seconds")
        resolved = {k: v for k, v in asdict(self).items() if k not in told}
        resolved |= {"recording_sha256": recording_sha256, "foten": foten_version}
        return hashlib.sha256(json.dumps(resolved, sort_keys=True).encode()).hexdigest()[:16]


@dataclass(frozen=True)
class Method:
    """A row of a table: a model, what it changes of the experiment's settings, and what it is called.

    Attributes:
        name: in tables; the model's key by default.
        recipe: of training; None for the experiment's.
        train, sizes: changes of the recipe and of the model's sizes.
    """

    model: str
    name: str = ""
    recipe: str | None = None
    train: Mapping[str, Any] = field(default_factory=dict)
    sizes: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Experiment:
    """Methods × textures × splits × a grid of settings.

    Attributes:
        title: of its tables.
        textures: keys of the simulator, or recordings (.h5), looked for beside the file.
        methods: rows.
        note: what tables say below, of what was reduced for one.
        seconds: that textures are simulated for [s].
        split_seeds: of the splits; of simulated textures other strokes too.
        recipe: of training.
        train, preprocess: changes of the recipe and of `PreprocessConfig`.
        grid: settings by name, each a list: of training, or sizes where a model has them. Every combination is run.
    """

    title: str
    textures: tuple[str, ...]
    methods: tuple[Method, ...]
    note: str = ""
    seconds: float = 60.0
    split_seeds: tuple[int, ...] = (1,)
    recipe: str = "default"
    train: Mapping[str, Any] = field(default_factory=dict)
    preprocess: Mapping[str, Any] = field(default_factory=dict)
    grid: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)

    def runs(self) -> list[Run]:
        """Return every run, those on one recording together.

        Raises:
            ValueError: a setting is unknown or out of range; the message names the method.
        """
        found = [
            self._resolved(texture, method, split_seed, dict(zip(self.grid, values, strict=False)))
            for texture in self.textures
            for split_seed in self.split_seeds
            for method in self.methods
            for values in (itertools.product(*self.grid.values()) if method.model != "ar" else [()])
        ]
        names: dict[str, str] = {}
        for run in found:
            values = json.dumps(
                {k: v for k, v in asdict(run).items() if k not in ("method", "cell")}, sort_keys=True
            )
            if values in names:
                raise ValueError(
                    f"{names[values]!r} and {run.label!r} are the same run: leave one of them out"
                )
            names[values] = run.label
        return found

    def _resolved(self, texture: str, method: Method, split_seed: int, cell: Mapping[str, Any]) -> Run:
        name = method.name or method.model
        changed = {k: v for k, v in cell.items() if k in OF_TRAINING}
        own_sizes = {**method.sizes, **{k: v for k, v in cell.items() if k not in OF_TRAINING}}
        try:
            preprocess = PreprocessConfig(**self.preprocess)
            if method.model == "ar":
                if method.sizes or method.train or method.recipe:
                    raise ValueError("'ar' is fitted without a recipe and finds its sizes: leave them out")
                architecture, train = None, {}
            else:
                architecture = architecture_from(method.model, own_sizes)
                assert not isinstance(architecture, ArArchitecture)
                check_used(method.model, {**method.train, **changed})
                given = {**self.train, **method.train, **changed}
                config = replace(
                    RECIPES[method.recipe or self.recipe],
                    **{
                        "threads": 1,
                        "seed": split_seed,
                        **OWN_RECIPES.get(method.model, {}),
                        **given,
                    },
                )
                train = asdict(config)
        except (TypeError, ValueError) as error:
            raise ValueError(f"method {name!r}: {error}") from error
        return Run(
            name,
            texture,
            None if texture.endswith(RECORDED) else self.seconds,
            method.model,
            {} if architecture is None else sizes(architecture),
            train,
            asdict(preprocess),
            split_seed,
            cell,
        )


def find_experiment(name: str) -> Path:
    """Return the path of an experiment: a file, or by its name one that comes with foten.

    Raises:
        FileNotFoundError: there is neither.
    """
    ours = Path(__file__).parent
    if Path(name).suffix == ".toml":
        return Path(name)
    if (ours / f"{name}.toml").exists():
        return ours / f"{name}.toml"
    known = ", ".join(sorted(path.stem for path in ours.glob("*.toml")))
    raise FileNotFoundError(f"no experiment {name!r}, expected a .toml file or one of {known}")


def read_experiment(path: Path) -> Experiment:
    """Return the experiment in a TOML file.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is no TOML, has an unknown key, or a value does not fit; one line says which.
    """
    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    if path.is_dir():
        raise ValueError(f"{path} is a folder, expected a .toml file")
    try:
        found = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path.name}: this is not TOML ({error})") from error
    try:
        return _experiment(found, path.parent)
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error


def _experiment(found: dict[str, Any], folder: Path) -> Experiment:
    _check_keys(found, {one.name for one in fields(Experiment)}, "the file")
    for name in ("title", "textures", "methods"):
        if not found.get(name):
            raise ValueError(f"there is no {name!r}, expected title, textures and methods")
    for name in ("title", "note", "recipe"):
        if not isinstance(found.get(name, ""), str):
            raise ValueError(f"{name!r} is {found[name]!r}, expected a text")
    for name in ("textures", "methods"):
        if not isinstance(found[name], list):
            raise ValueError(f"{name!r} is {found[name]!r}, expected a list")
    methods = []
    for one in found["methods"]:
        one = {"model": one} if isinstance(one, str) else one
        if not isinstance(one, dict):
            raise ValueError(f"a method is {one!r}, expected a model's name or a table")
        _check_keys(one, {one.name for one in fields(Method)}, "a method")
        for name in ("model", "name", "recipe"):
            if not isinstance(one.get(name, ""), str):
                raise ValueError(f"{name!r} of a method is {one[name]!r}, expected a text")
        for name in ("train", "sizes"):
            if not isinstance(one.get(name, {}), dict):
                raise ValueError(f"{name!r} of a method is {one[name]!r}, expected a table")
        _check_keys(one.get("train", {}), OF_TRAINING, "'train' of a method")
        if one.get("model") not in ARCHITECTURES:
            raise ValueError(
                f"unknown model {one.get('model')!r}, expected one of {', '.join(ARCHITECTURES)}"
            )
        if one.get("recipe") is not None and one["recipe"] not in RECIPES:
            raise ValueError(f"unknown recipe {one['recipe']!r}, expected one of {', '.join(RECIPES)}")
        methods.append(Method(**one))
    names = [method.name or method.model for method in methods]
    if len(set(names)) < len(names):
        raise ValueError("two methods have the same name: give them a 'name' each")
    if found.get("recipe", "default") not in RECIPES:
        raise ValueError(f"unknown recipe {found['recipe']!r}, expected one of {', '.join(RECIPES)}")
    textures = [_texture(one, folder) for one in found["textures"]]
    stems = [Path(one).stem for one in textures]
    if len(set(stems)) < len(stems):
        raise ValueError("two textures have the same name, which tables could not tell apart")
    for name in ("train", "grid", "preprocess"):
        if not isinstance(found.get(name, {}), dict):
            raise ValueError(f"{name!r} is {found[name]!r}, expected a table, [{name}]")
    if "recipe" in found.get("train", {}):
        raise ValueError("'recipe' stands beside [train], not in it")
    _check_keys(found.get("train", {}), OF_TRAINING, "[train]")
    _check_keys(found.get("preprocess", {}), OF_PREPROCESSING, "[preprocess]")
    if found.get("grid") and all(method.model == "ar" for method in methods):
        raise ValueError("a grid is of networks, and 'ar' finds its sizes: leave it out")
    for name, values in found.get("grid", {}).items():
        if not isinstance(values, list) or not values:
            raise ValueError(f"{name!r} in the grid is {values!r}, expected a list")
    seeds = found.get("split_seeds", [1])
    if not isinstance(seeds, list) or not all(type(seed) is int and seed >= 0 for seed in seeds) or not seeds:
        raise ValueError(f"split_seeds is {seeds!r}, expected a list of whole numbers")
    if len(set(seeds)) < len(seeds):
        raise ValueError(f"split_seeds is {seeds!r}, expected each once")
    seconds = found.get("seconds", 60.0)
    if type(seconds) not in (int, float) or not 1 <= seconds <= 3600:
        raise ValueError(f"seconds is {seconds!r}, expected 1 to 3600")
    of_networks = [method.model for method in methods if method.model != "ar"]
    named = {one.name for model in of_networks for one in fields(ARCHITECTURES[model])}
    _check_keys(found.get("grid", {}), OF_TRAINING | named, "[grid]")
    grid = {name: tuple(values) for name, values in found.get("grid", {}).items()}
    listed = {
        "textures": tuple(textures),
        "methods": tuple(methods),
        "split_seeds": tuple(seeds),
        "grid": grid,
    }
    return Experiment(**{**found, **listed, "seconds": float(seconds)})


def _check_keys(found: Mapping[str, Any], known: Collection[str], where: str) -> None:
    unknown = sorted(set(found) - set(known))
    if unknown:
        near = difflib.get_close_matches(unknown[0], known, 1)
        raise ValueError(
            f"unknown key {unknown[0]!r} in {where}, expected "
            + (f"{near[0]!r}?" if near else f"one of {', '.join(sorted(known))}")
        )


def _texture(one: object, folder: Path) -> str:
    if isinstance(one, str) and one.endswith(RECORDED):
        path = folder / one
        if not path.exists():
            raise ValueError(f"there is no recording {one} beside the file")
        return str(path)
    if not isinstance(one, str) or one not in {*TEXTURES, *LINEAR_FAMILY}:
        known = ", ".join([*TEXTURES, *LINEAR_FAMILY])
        raise ValueError(f"unknown texture {one!r}, expected a recording, .h5, or one of {known}")
    return one
