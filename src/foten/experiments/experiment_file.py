"""Reading an experiment from a TOML file, and checking it."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from foten.datasets.simulate import LINEAR_FAMILY, TEXTURES
from foten.experiments.experiment import OF_TRAINING, RECORDED, Experiment, Method
from foten.families import FAMILIES
from foten.recording.preprocess import PreprocessConfig
from foten.train.config import RECIPES

OF_PREPROCESSING = {one.name for one in fields(PreprocessConfig)}


def experiment_path(name: str) -> Path:
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
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path.name}: this is not TOML ({error})") from error
    try:
        return _experiment(content, path.parent)
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error


def _experiment(content: dict[str, Any], folder: Path) -> Experiment:
    _check_keys(content, {one.name for one in fields(Experiment)}, "the file")
    for name in ("title", "textures", "methods"):
        if not content.get(name):
            raise ValueError(f"there is no {name!r}, expected title, textures and methods")
    _check_types(content, ("title", "note", "recipe"), str, "a text")
    _check_types(content, ("textures", "methods"), list, "a list")
    methods = tuple(map(_method, content["methods"]))
    if len({method.name or method.model for method in methods}) < len(methods):
        raise ValueError("two methods have the same name: give them a 'name' each")
    if content.get("recipe", "default") not in RECIPES:
        raise ValueError(f"unknown recipe {content['recipe']!r}, expected one of {', '.join(RECIPES)}")
    textures = tuple(_texture(one, folder) for one in content["textures"])
    if len({Path(one).stem for one in textures}) < len(textures):
        raise ValueError("two textures have the same name, which tables could not tell apart")
    for name in ("train", "grid", "preprocess"):
        _check_types(content, (name,), dict, f"a table, [{name}]")
    grid = content.get("grid", {})
    if "recipe" in content.get("train", {}):
        raise ValueError("'recipe' stands beside [train], not in it")
    _check_keys(content.get("train", {}), OF_TRAINING, "[train]")
    _check_keys(content.get("preprocess", {}), OF_PREPROCESSING, "[preprocess]")
    if grid and all(method.model == "ar" for method in methods):
        raise ValueError("a grid is of networks, and 'ar' finds its sizes: leave it out")
    for name, values in grid.items():
        if not isinstance(values, list) or not values:
            raise ValueError(f"{name!r} in the grid is {values!r}, expected a list")
    seeds = content.get("split_seeds", [1])
    if not isinstance(seeds, list) or not all(type(seed) is int and seed >= 0 for seed in seeds) or not seeds:
        raise ValueError(f"split_seeds is {seeds!r}, expected a list of whole numbers")
    if len(set(seeds)) < len(seeds):
        raise ValueError(f"split_seeds is {seeds!r}, expected each once")
    seconds = content.get("seconds", 60.0)
    if type(seconds) not in (int, float) or not 1 <= seconds <= 3600:
        raise ValueError(f"seconds is {seconds!r}, expected 1 to 3600")
    networks = [method.model for method in methods if method.model != "ar"]
    sizes = {one.name for model in networks for one in fields(FAMILIES[model])}
    _check_keys(grid, OF_TRAINING | sizes, "[grid]")
    resolved = {
        "textures": textures,
        "methods": methods,
        "split_seeds": tuple(seeds),
        "grid": {name: tuple(values) for name, values in grid.items()},
        "seconds": float(seconds),
    }
    return Experiment(**{**content, **resolved})


def _method(content: object) -> Method:
    if isinstance(content, str):
        content = {"model": content}
    if not isinstance(content, dict):
        raise ValueError(f"a method is {content!r}, expected a model's name or a table")
    _check_keys(content, {one.name for one in fields(Method)}, "a method")
    _check_types(content, ("model", "name", "recipe"), str, "a text", " of a method")
    _check_types(content, ("train", "sizes"), dict, "a table", " of a method")
    _check_keys(content.get("train", {}), OF_TRAINING, "'train' of a method")
    if content.get("model") not in FAMILIES:
        raise ValueError(f"unknown model {content.get('model')!r}, expected one of {', '.join(FAMILIES)}")
    if content.get("recipe") is not None and content["recipe"] not in RECIPES:
        raise ValueError(f"unknown recipe {content['recipe']!r}, expected one of {', '.join(RECIPES)}")
    return Method(**content)


def _texture(content: object, folder: Path) -> str:
    if isinstance(content, str) and content.endswith(RECORDED):
        path = folder / content
        if not path.exists():
            raise ValueError(f"there is no recording {content} beside the file")
        return str(path)
    if not isinstance(content, str) or content not in {*TEXTURES, *LINEAR_FAMILY}:
        known = ", ".join([*TEXTURES, *LINEAR_FAMILY])
        raise ValueError(f"unknown texture {content!r}, expected a recording, .h5, or one of {known}")
    return content


def _check_types(content: Mapping[str, Any], names: Collection[str], kind: type, expected: str, of: str = "") -> None:
    for name in names:
        if name in content and not isinstance(content[name], kind):
            raise ValueError(f"{name!r}{of} is {content[name]!r}, expected {expected}")


def _check_keys(content: Mapping[str, Any], known: Collection[str], where: str) -> None:
    unknown = sorted(set(content) - set(known))
    if unknown:
        near = difflib.get_close_matches(unknown[0], known, 1)
        expected = f"{near[0]!r}?" if near else f"one of {', '.join(sorted(known))}"
        raise ValueError(f"unknown key {unknown[0]!r} in {where}, expected {expected}")
