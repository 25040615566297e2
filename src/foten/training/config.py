"""Settings of a training: the paper's recipe and ours."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import Any

LOSSES, SCHEDULES, OPTIMISERS = ("huber", "mse", "mae"), ("one_cycle", "constant"), ("muon", "adamw")
INITIAL_WEIGHTS = ("uniform", "glorot")
STORED = ("auto", "always", "never")  # recorded innovations: auto, not of a microphone above 2 kHz; always, of any
MAX_MICROPHONE_HZ = 2000.0  # rate of a texture above which it holds more of speech than we dare to store unasked
WITHHELD = "no recorded innovations are stored: speech near the microphone could be in them"
WARM_START = (45.0, 0.8)  # mm/s, N: mean of early contacts; Sec. V-a


@dataclass(frozen=True)
class TrainConfig:
    """One run of training: the defaults are our recipe; `RECIPES["paper"]` is Sec. IV-e."""

    recipe: str = "default"
    epochs: int = 12  # at most
    patience: int = 10  # epochs without a better validation loss; Sec. IV-e
    trial_epochs: int = 3  # epochs in which a network has to gain something; more than `epochs` for none
    min_gain: float = 1e-3  # of the one-step validation error, over the network before training
    batch: int = 128  # windows
    optimiser: str = "muon"  # orthogonalised momentum for matrices (`training.optimiser`); or "adamw" for all
    matrix_learning_rate: float = 3e-3  # of that, at its highest
    learning_rate: float = 5e-4  # of AdamW, at its highest
    schedule: str = "one_cycle"  # or "constant"
    adam_epsilon: float = 1e-8  # of AdamW
    weight_decay: float = 0.3  # of each step, times its learning rate
    clip_norm: float = 1.0  # of the gradient; 0 for none
    dropout: float = 0.0  # share of hidden values; 0.2 in Sec. IV-e
    initial_weights: str = "uniform"  # as PyTorch draws them; or "glorot", as Keras does (`training.initial_weights`)
    loss: str = "huber"
    delta: float = 1.6  # Huber threshold, scaled; Sec. VI-b
    max_order: int = 240  # samples that the lattice remembers at most; the first of `OF_FOTEN_PLUS`
    table: bool = True  # try reflection coefficients that follow speed and force
    gain_before_filter: bool = True  # try the level before the lattice as well as after it
    tones: bool = True  # try tones of the path
    recorded_innovations: str = "auto"  # tried where noise is told from the recording; or "always" or "never": `STORED`
    seed: int = 0  # of the initial weights, the order of windows and dropout
    threads: int = 2  # each takes a share of every batch; part of what makes a file reproducible

    def __post_init__(self) -> None:
        choices = {"loss": LOSSES, "schedule": SCHEDULES, "optimiser": OPTIMISERS, "initial_weights": INITIAL_WEIGHTS}
        choices["recorded_innovations"] = STORED
        for name, known in choices.items():
            if getattr(self, name) not in known:
                raise ValueError(f"{name} is {getattr(self, name)!r}, expected one of {', '.join(known)}")
        for field in fields(self):
            value = getattr(self, field.name)
            if field.type == "int" and type(value) is not int:
                raise ValueError(f"{field.name} is {value!r}, expected a whole number")
            if field.type == "bool" and type(value) is not bool:
                raise ValueError(f"{field.name} is {value!r}, expected true or false")
            if field.type == "float" and (type(value) not in (int, float) or not math.isfinite(value)):
                raise ValueError(f"{field.name} is {value!r}, expected a finite number")
        for name in ("epochs", "batch", "patience", "trial_epochs", "threads", "max_order"):
            minimum = 0 if name == "epochs" else 1
            if getattr(self, name) < minimum:
                raise ValueError(f"{name} is {getattr(self, name)}, expected {minimum} or more")
        if not 0 <= self.dropout <= 0.9:
            raise ValueError(f"dropout is {self.dropout}, expected from 0 to 0.9")
        if min(self.learning_rate, self.matrix_learning_rate, self.adam_epsilon, self.delta) <= 0:
            raise ValueError("learning rates, adam_epsilon and delta must be positive")
        if self.weight_decay < 0:
            raise ValueError(f"weight decay is {self.weight_decay}, expected 0 or more")


RECIPES: dict[str, TrainConfig] = {
    "default": TrainConfig(),
    "paper": TrainConfig(
        recipe="paper",
        epochs=100,
        trial_epochs=101,
        batch=16,
        optimiser="adamw",
        learning_rate=1e-3,
        schedule="constant",
        adam_epsilon=1e-7,
        weight_decay=0.0,
        clip_norm=0.0,
        dropout=0.2,
        initial_weights="glorot",
        threads=1,  # two halves of 16 windows take longer than all
    ),
}
"""The paper's is Sec. IV-e: Adam at 1e-3, batches of 16, 100 epochs at most, dropout of 0.2, stopped after 10 without a gain.

It trained in Keras (TensorFlow 2.8) and does not restate its defaults, which are taken here: Glorot's initial weights, and Adam's
ε of 1e-7. Differs from the paper: Keras adds that ε before the second moment is corrected for its start, here it is added after;
its ε of a layer normalisation is 1e-3, here it is 1e-5.
"""

FILTERS: dict[str, dict[str, float]] = {"default": {}, "paper": {"lowpass_hz": 25.0}}
"""Settings of `PreprocessConfig` that a recipe changes: the paper trains with speed and force below 25 Hz (Sec. III-c), and
renders with 20 (Sec. V-b).
"""

OWN_RECIPES: dict[str, dict[str, Any]] = {
    # Epochs are of 100 steps.
    "foten-plus": {
        **{"optimiser": "adamw", "learning_rate": 4e-3, "weight_decay": 0.1, "batch": 64},
        **{"patience": 4, "trial_epochs": 10_000},
    },
    "ten": {"delta": 2.0},
    "ten-wavelet": {"loss": "mse"},
    **{key: {"loss": "mse", "optimiser": "adamw"} for key in ("fnn", "dstn", "hapinf", "ldhtd", "dftnet")},
    # Its epochs are of 50 steps, not of all windows.
    "gan": {"epochs": 60, "patience": 60, "batch": 64, "learning_rate": 2e-4},
}
"""Settings of a recipe that a model changes: losses of Sec. VI-d for TEN's variants, ours for the others."""
UNUSED: dict[str, tuple[str, ...]] = {
    "foten-plus": ("loss", "delta", "dropout", "matrix_learning_rate", "trial_epochs", "min_gain", "initial_weights"),
    "gan": (
        *(
            "loss",
            "delta",
            "dropout",
            "threads",
            "weight_decay",
            "schedule",
            "clip_norm",
            "initial_weights",
            "adam_epsilon",
        ),
        *("optimiser", "matrix_learning_rate", "trial_epochs", "min_gain"),
    ),
}
"""Settings that a model does not use: the loss of foten-plus is a likelihood, that of the GAN its discriminator."""
OF_FOTEN_PLUS = ("max_order", "table", "gain_before_filter", "tones", "recorded_innovations")


def recipe_of(model: str, recipe: str = "default", **changed: Any) -> TrainConfig:
    """A recipe with a model's own settings, and those that are changed; ValueError where it is no recipe of the model."""
    check_recipe(model, recipe)
    return replace(RECIPES[recipe], **(OWN_RECIPES.get(model, {}) | changed))


def check_recipe(model: str, recipe: str) -> None:
    """Refuse a recipe that would leave nothing of itself."""
    if recipe == "paper" and model in UNUSED:
        raise ValueError(
            f"the paper's recipe (Sec. IV-e) is of networks that are trained on windows, and {model} is not: leave recipe out, "
            "or take another model, such as foten"
        )


def unused_settings(model: str) -> tuple[str, ...]:
    """Settings that have no effect on a model."""
    return UNUSED.get(model, ()) + (() if model == "foten-plus" else OF_FOTEN_PLUS)


def check_used(model: str, names: Iterable[str], loss: str = "huber") -> None:
    """Refuse settings that a model, or its loss, does not use."""
    for name in names:
        option = name.replace("_", "-")
        if name in unused_settings(model):
            raise ValueError(f"{option} means nothing to {model}: leave it out")
        if name == "delta" and loss != "huber":
            raise ValueError(f"delta is the threshold of the huber loss, and the loss is {loss}: leave it out")


def withholds_recording(microphone: bool, rate_hz: float, stored: str) -> bool:
    """Whether a texture's file holds no recorded innovations, unless `stored` asks for them, since they could hold speech."""
    return microphone and rate_hz > MAX_MICROPHONE_HZ and stored == "auto"
