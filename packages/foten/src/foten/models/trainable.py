"""Models that can be trained, by key, and the training of one: recording to texture."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib import import_module
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any

from foten.models.foten_plus.config import FotenPlusConfig
from foten.models.model_sizes import ModelSizes
from foten.models.registry import MODELS, checked_sizes
from foten.training.config import FILTERS, Trainable, TrainConfig, window_recipes

if TYPE_CHECKING:
    from foten.training.job import Trained, TrainingJob
    from foten.training.loop import Monitor

GROUP = "foten.models"  # of the entry points of other packages, each a dict as below
COMPARED = ("ten-mfcc", "ten-wavelet", "foten-d", "fnn", "dstn", "hapinf", "ldhtd", "dftnet", "gan")  # of foten-lab
TRAINABLE: dict[str, Trainable] = {
    "foten-plus": Trainable(MODELS["foten-plus"], {"default": FotenPlusConfig()}, "foten.models.foten_plus.fit:fit"),
    "foten": Trainable(MODELS["foten"], window_recipes(), "foten.models.foten.fit:fit"),
    "ten": Trainable(MODELS["ten"], window_recipes(delta=2.0), "foten.models.foten.fit:fit"),
    "ar": Trainable(MODELS["ar"], {"default": TrainConfig()}, "foten.models.piecewise_ar.fit:fit"),
    **{key: model for entry in entry_points(group=GROUP) for key, model in entry.load().items()},
}


def trainable(model: str) -> Trainable:
    """The entry of a model; ValueError where there is none of that key."""
    if model in COMPARED and model not in TRAINABLE:
        raise ValueError(
            f"{model} is in the package foten-lab: pip install './packages/foten[train]' './packages/foten-lab[sweep]'"
        )
    if model not in TRAINABLE:
        raise ValueError(f"unknown model {model!r}, expected one of {', '.join(TRAINABLE)}")
    return TRAINABLE[model]


def trainable_sizes(model: str, values: Mapping[str, Any]) -> ModelSizes:
    """The sizes of a model from values by name.

    Raises:
        ValueError: the model or a size is unknown, or a size is out of range.
    """
    return checked_sizes(model, trainable(model).sizes, values)


def recipe_of(model: str, recipe: str = "default", **changed: Any) -> TrainConfig:
    """A recipe of a model, with settings that are changed.

    Raises:
        ValueError: it has no such recipe, or a setting that it does not use is changed.
    """
    recipes = trainable(model).recipes
    if recipe not in FILTERS:
        raise ValueError(f"unknown recipe {recipe!r}, expected one of {', '.join(FILTERS)}")
    if recipe not in recipes:
        raise ValueError(
            f"the paper's recipe (Sec. IV-e) is of networks that are trained on windows, and {model} is not: leave recipe out, "
            "or take another model, such as foten"
        )
    check_used(model, changed, changed.get("loss", getattr(recipes[recipe], "loss", None)))
    return replace(recipes[recipe], **changed)


def check_used(model: str, names: Iterable[str], loss: str | None = None) -> None:
    """Refuse settings that a model, or its loss, does not use."""
    for name in names:
        if name not in TRAINABLE[model].settings:
            raise ValueError(f"{name.replace('_', '-')} means nothing to {model}: leave it out")
        if name == "delta" and loss != "huber":
            raise ValueError(f"delta is the threshold of the huber loss, and the loss is {loss}: leave it out")


def train(job: TrainingJob, monitor: Monitor | None = None) -> Trained:
    """A texture learned from a recording.

    Raises:
        ValueError: the recording does not fit the configuration; the message names the option.
    """
    from foten.training.loop import Monitor
    from foten.training.reproducible import reproducible

    with reproducible():
        module, _, name = TRAINABLE[job.model].fit.partition(":")
        return getattr(import_module(module), name)(job, monitor or Monitor())
