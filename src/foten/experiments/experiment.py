"""An experiment: which methods learn which textures with which settings, and the runs that result."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from foten.families import sizes_of
from foten.recording.preprocess import PreprocessConfig
from foten.train.config import OWN_RECIPES, RECIPES, TrainConfig, check_used

RECORDED = (".h5", ".hdf5")
OF_TRAINING = {one.name for one in fields(TrainConfig)} - {"recipe"}


@dataclass(frozen=True)
class Run:
    """One method on one texture and split, everything resolved: equal runs have equal results.

    Attributes:
        method: its name in tables, on which the result does not depend.
        texture: key of the simulator, or the path of a recording.
        seconds: simulated [s]; None for a recording.
        model, sizes, train, preprocess: of the texture, all sizes and settings.
        split_seed: of the split, and of the simulated recording.
        cell: of the grid, the settings in which it differs from the method's other runs; a name, as `method`.
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
        """Return the name of its row in a table: the method, and its cell of the grid."""
        return " ".join([self.method, ", ".join(f"{k} {v}" for k, v in self.cell.items())]).rstrip()

    @property
    def source(self) -> tuple[str, float | None, int]:
        """Return what determines the recording that is learned from."""
        return self.texture, self.seconds, self.split_seed

    def name(self, recording_sha256: str, foten_version: str) -> str:
        """Return the name of the run's result file: the hash of all that the result depends on."""
        # The recording's digest stands for texture and seconds.
        labels = ("method", "cell", "texture", "seconds")
        resolved = {k: v for k, v in asdict(self).items() if k not in labels}
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
        """Return every run, in the order of the recordings.

        Raises:
            ValueError: a setting is unknown or out of range; the message names the method.
        """
        runs = [
            self._resolved(texture, method, split_seed, dict(zip(self.grid, values, strict=False)))
            for texture in self.textures
            for split_seed in self.split_seeds
            for method in self.methods
            for values in (itertools.product(*self.grid.values()) if method.model != "ar" else [()])
        ]
        labels: dict[str, str] = {}
        for run in runs:
            resolved = {k: v for k, v in asdict(run).items() if k not in ("method", "cell")}
            key = json.dumps(resolved, sort_keys=True)
            if key in labels:
                raise ValueError(f"{labels[key]!r} and {run.label!r} are the same run: leave one of them out")
            labels[key] = run.label
        return runs

    def _resolved(self, texture: str, method: Method, split_seed: int, cell: Mapping[str, Any]) -> Run:
        name = method.name or method.model
        changed = {k: v for k, v in cell.items() if k in OF_TRAINING}
        own_sizes = {**method.sizes, **{k: v for k, v in cell.items() if k not in OF_TRAINING}}
        try:
            preprocess = PreprocessConfig(**self.preprocess)
            if method.model == "ar":
                if method.sizes or method.train or method.recipe:
                    raise ValueError("'ar' is fitted without a recipe and finds its sizes: leave them out")
                sizes, train = {}, {}
            else:
                sizes = sizes_of(method.model, own_sizes).to_card()
                check_used(method.model, {**method.train, **changed})
                given = {**self.train, **method.train, **changed}
                own = OWN_RECIPES.get(method.model, {})
                recipe = RECIPES[method.recipe or self.recipe]
                config = replace(recipe, **{"threads": 1, "seed": split_seed, **own, **given})
                train = asdict(config)
        except (TypeError, ValueError) as error:
            raise ValueError(f"method {name!r}: {error}") from error
        return Run(
            name,
            texture,
            None if texture.endswith(RECORDED) else self.seconds,
            method.model,
            sizes,
            train,
            asdict(preprocess),
            split_seed,
            cell,
        )
