"""How a network is trained: the paper's recipe is the paper's, and what cannot be or means nothing is refused."""

from __future__ import annotations

import pytest

from foten.models.foten.sizes import FotenSizes
from foten.training.config import RECIPES, TrainConfig, check_used, recipe_of


def test_the_papers_recipe_is_the_papers() -> None:
    paper = RECIPES["paper"]
    assert (paper.epochs, paper.patience, paper.batch, paper.learning_rate) == (100, 10, 16, 1e-3)
    assert (paper.loss, paper.delta, paper.schedule) == ("huber", 1.6, "constant")
    assert (paper.weight_decay, paper.clip_norm, paper.dropout) == (0.0, 0.0, 0.2)
    assert (paper.initial_weights, paper.adam_epsilon) == ("glorot", 1e-7)  # Keras' defaults
    assert paper.trial_epochs > paper.epochs  # none
    named = {"window": 20, "d_model": 32, "n_heads": 4, "n_layers": 3, "d_feedforward": 128, "head": (256, 64)}
    assert FotenSizes() == FotenSizes(**named)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"loss": "l2"}, "expected one of huber, mse, mae"),
        ({"schedule": "step"}, "one_cycle"),
        ({"optimiser": "sgd"}, "expected one of muon, adamw"),
        ({"initial_weights": "he"}, "expected one of uniform, glorot"),
        ({"adam_epsilon": 0.0}, "must be positive"),
        ({"batch": 0}, "batch is 0"),
        ({"epochs": -1}, "epochs is -1"),
        ({"dropout": 1.0}, "dropout is 1.0"),
        ({"learning_rate": 0.0}, "must be positive"),
        ({"batch": 2.5}, "batch is 2.5, expected a whole number"),
        ({"epochs": True}, "epochs is True, expected a whole number"),
        ({"seed": "1"}, "seed is '1', expected a whole number"),
        ({"tones": "no"}, "tones is 'no', expected true or false"),
        ({"delta": float("inf")}, "delta is inf, expected a finite number"),
    ],
)
def test_what_cannot_be_is_refused(change: dict[str, object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        TrainConfig(**change)  # type: ignore[arg-type]


@pytest.mark.parametrize("model", ["foten-plus", "gan"])
def test_the_papers_recipe_is_refused_where_nothing_of_it_would_be_left(model: str) -> None:
    with pytest.raises(ValueError, match=f"of networks that are trained on windows, and {model} is not"):
        recipe_of(model, "paper")
    assert recipe_of("dstn", "paper").batch == 16


def test_settings_that_mean_nothing_to_a_model_are_refused() -> None:
    check_used("foten", ["loss", "dropout"])
    check_used("gan", ["epochs", "batch", "learning_rate"])
    with pytest.raises(ValueError, match="delta is the threshold of the huber loss, and the loss is mae"):
        check_used("foten", ["delta"], "mae")
    check_used("foten", ["delta"], "huber")
    with pytest.raises(ValueError, match="clip-norm means nothing to gan"):
        check_used("gan", ["epochs", "clip_norm"])
    with pytest.raises(ValueError, match="max-order means nothing to foten"):
        check_used("foten", ["max_order"])
