"""Settings of a training: what every training has, what gradient steps add, and the recipes of networks of windows."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from foten.models.model_sizes import ModelSizes

FILTERS: dict[str, dict[str, float]] = {"default": {}, "paper": {"lowpass_hz": 25.0}}
"""Recipes, and the settings of `PreprocessConfig` that each changes: the paper trains with speed and force below 25 Hz
(Sec. III-c), and renders with 20 (Sec. V-b).
"""


@dataclass(frozen=True)
class TrainConfig:
    """Settings of one training; a model's own are those of its subclass."""

    recipe: str = "default"
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {}

    def __post_init__(self) -> None:
        for field in fields(self):
            name, value = field.name, getattr(self, field.name)
            if name in self.choices and value not in self.choices[name]:
                raise ValueError(f"{name} is {value!r}, expected one of {', '.join(self.choices[name])}")
            if field.type is int and type(value) is not int:
                raise ValueError(f"{name} is {value!r}, expected a whole number")
            if field.type is bool and type(value) is not bool:
                raise ValueError(f"{name} is {value!r}, expected true or false")
            if field.type is float and (type(value) not in (int, float) or not math.isfinite(value)):
                raise ValueError(f"{name} is {value!r}, expected a finite number")

    def check_at_least(self, minimum: int, *names: str) -> None:
        """Refuse settings below a minimum."""
        for name in names:
            if getattr(self, name) < minimum:
                raise ValueError(f"{name} is {getattr(self, name)}, expected {minimum} or more")

    def check_positive(self, *names: str) -> None:
        """Refuse settings that are 0 or less."""
        for name in names:
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} is {getattr(self, name)}, expected more than 0")


@dataclass(frozen=True)
class LoopConfig(TrainConfig):
    """A training in epochs (`training.loop`)."""

    epochs: int = 12  # at most
    patience: int = 10  # epochs without a better validation loss; Sec. IV-e
    batch: int = 128  # windows
    learning_rate: float = 5e-4  # of Adam, at its highest
    seed: int = 0  # of the initial weights, the order of windows and dropout

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_at_least(0, "epochs")
        self.check_at_least(1, "patience", "batch")
        self.check_positive("learning_rate")


@dataclass(frozen=True)
class GradientConfig(LoopConfig):
    """A loop whose batches are shared by threads and whose steps are AdamW's."""

    schedule: str = "one_cycle"  # or "constant"
    adam_epsilon: float = 1e-8
    weight_decay: float = 0.3  # of each step, times its learning rate
    clip_norm: float = 1.0  # of the gradient; 0 for none
    threads: int = 2  # each takes a share of every batch; part of what makes a file reproducible
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {"schedule": ("one_cycle", "constant")}

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_at_least(1, "threads")
        self.check_at_least(0, "weight_decay")
        self.check_positive("adam_epsilon")


@dataclass(frozen=True)
class WindowConfig(GradientConfig):
    """A network that predicts from windows: the defaults are our recipe, `PAPER` changes them to Sec. IV-e."""

    trial_epochs: int = 3  # epochs in which a network has to gain something; more than `epochs` for none
    min_gain: float = 1e-3  # of the one-step validation error, over the network before training
    optimiser: str = "muon"  # orthogonalised momentum for matrices (`training.loop.Optimiser`); or "adamw" for all
    matrix_learning_rate: float = 3e-3  # of that, at its highest
    dropout: float = 0.0  # share of hidden values; 0.2 in Sec. IV-e
    initial_weights: str = "uniform"  # as PyTorch draws them; or "glorot", as Keras does (`training.initial_weights`)
    loss: str = "huber"
    delta: float = 1.6  # Huber threshold, scaled; Sec. VI-b
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {
        **GradientConfig.choices,
        "loss": ("huber", "mse", "mae"),
        "optimiser": ("muon", "adamw"),
        "initial_weights": ("uniform", "glorot"),
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_at_least(1, "trial_epochs")
        if not 0 <= self.dropout <= 0.9:
            raise ValueError(f"dropout is {self.dropout}, expected from 0 to 0.9")
        self.check_positive("matrix_learning_rate", "delta")


PAPER: dict[str, Any] = {
    "recipe": "paper",
    "epochs": 100,
    "trial_epochs": 101,
    "batch": 16,
    "optimiser": "adamw",
    "learning_rate": 1e-3,
    "schedule": "constant",
    "adam_epsilon": 1e-7,
    "weight_decay": 0.0,
    "clip_norm": 0.0,
    "dropout": 0.2,
    "initial_weights": "glorot",
    "threads": 1,  # two halves of 16 windows take longer than all
}
"""Sec. IV-e: Adam at 1e-3, batches of 16, 100 epochs at most, dropout of 0.2, stopped after 10 without a gain.

It trained in Keras (TensorFlow 2.8) and does not restate its defaults, which are taken here: Glorot's initial weights, and Adam's
ε of 1e-7. Differs from the paper: Keras adds that ε before the second moment is corrected for its start, here it is added after;
its ε of a layer normalisation is 1e-3, here it is 1e-5.
"""


def window_recipes(**changed: Any) -> dict[str, TrainConfig]:
    """Recipes of a network of windows, ours and the paper's, with its own settings."""
    return {"default": WindowConfig(**changed), "paper": WindowConfig(**(PAPER | changed))}


@dataclass(frozen=True)
class Trainable:
    """What training needs to know of a model."""

    sizes: type[ModelSizes]
    recipes: Mapping[str, TrainConfig]  # by name, "default" among them
    fit: str  # module:function of (job, monitor) -> Trained, imported on demand

    @property
    def settings(self) -> set[str]:
        """Names of the settings that it has."""
        return {setting.name for setting in fields(self.recipes["default"])} - {"recipe"}

    @property
    def has_network(self) -> bool:
        """Whether it is trained in epochs, with a log and a checkpoint."""
        return isinstance(self.recipes["default"], LoopConfig)
