"""The training loop: the best epoch is kept, what is interrupted goes on, what is lost says so."""

from __future__ import annotations

import dataclasses
import errno
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from foten.training.networks import build

from foten.baselines.sizes import TRAINABLE
from foten.models.foten.sizes import FotenSizes
from foten.training.config import OWN_RECIPES, RECIPES, UNUSED, TrainConfig, check_used
from foten.training.dropout import Dropout, set_dropout
from foten.training.loop import Epoch, Progress, goes_on, load_progress
from foten.training.window_fit import TrainingWindows, fit, loss_of, predict

SIZES = FotenSizes(window=12, d_model=8, n_heads=2, n_layers=2, d_feedforward=16, head=(16, 8), spectral_width=8)
QUICK = TrainConfig(epochs=3, batch=64, threads=1)


def windows_of(samples: np.ndarray, m: int = 12) -> TrainingWindows:
    n = np.arange(m, len(samples))
    return TrainingWindows(samples, n[: len(n) // 2], n[len(n) // 2 :], m)


def untrained() -> torch.nn.Module:
    torch.manual_seed(0)
    return build("foten", SIZES)


def white(n: int = 600, seed: int = 4) -> TrainingWindows:
    return windows_of(np.random.default_rng(seed).standard_normal((n, 3)))


def test_losses_are_those_of_equation_14() -> None:
    r = torch.linspace(-5, 5, 101, dtype=torch.float64)
    huber = loss_of(TrainConfig(delta=1.6))(r, torch.zeros_like(r))
    expected = torch.where(r.abs() <= 1.6, r**2 / 2, 1.6 * r.abs() - 1.6**2 / 2).mean()
    assert float(huber) == pytest.approx(float(expected), rel=1e-12)
    assert float(loss_of(TrainConfig(loss="mae"))(r, 0 * r)) == pytest.approx(float(r.abs().mean()), rel=1e-12)
    assert float(loss_of(TrainConfig(loss="mse"))(r, 0 * r)) == pytest.approx(float((r**2).mean()), rel=1e-12)


def test_a_target_of_its_own_is_learned_and_reported_in_its_unit() -> None:
    """A target that is not the acceleration, and errors in acceleration of ten times as much."""
    samples = np.random.default_rng(3).standard_normal((400, 3))
    network = untrained()
    windows = dataclasses.replace(windows_of(samples), target=samples[:, 1], unit=np.full(400, 10.0))
    line = fit(network, windows, TrainConfig(epochs=0, loss="mae", threads=1)).epochs[0]
    missed = np.abs(samples[windows.validation, 1] - predict(network, windows, windows.validation)).mean()
    assert line.validation_loss == pytest.approx(missed, rel=1e-5)
    assert line.validation_mae == pytest.approx(10 * missed, rel=1e-5)


def test_the_best_epoch_is_kept_and_patience_ends_the_training() -> None:
    network, windows = untrained(), white()
    config = TrainConfig(epochs=60, patience=3, batch=64, schedule="constant", threads=1)
    progress = fit(network, windows, config)
    best = min(progress.epochs, key=lambda line: line.validation_loss)
    assert progress.best is best
    assert progress.epochs[-1].epoch == best.epoch + 3  # white noise: only overfitting is left
    error = np.abs(windows.samples[windows.validation, 0] - predict(network, windows, windows.validation)).mean()
    assert error == pytest.approx(best.validation_mae, rel=1e-5)


def test_dropout_on_two_threads_gives_the_same_network_twice() -> None:
    states = []
    for _ in range(3):
        network = untrained()
        fit(network, white(), TrainConfig(epochs=1, batch=64, dropout=0.5, threads=2))
        states.append(network.head_1.weight.detach().numpy().copy())
    assert np.array_equal(states[0], states[1])
    assert np.array_equal(states[0], states[2])


def test_dropout_keeps_the_mean_and_drops_its_share() -> None:
    dropout = Dropout()
    set_dropout(dropout, 0.2)
    values = torch.ones(100_000)
    dropped = dropout(values)
    # 100 000 draws of a share of 0.2: standard error 0.0013.
    assert float((dropped == 0).float().mean()) == pytest.approx(0.2, abs=0.006)
    assert float(dropped.max()) == pytest.approx(1.25, rel=1e-4)
    assert torch.equal(dropout.eval()(values), values)


def interrupting(at: int) -> object:
    def on_epoch(line: Epoch) -> None:
        if line.epoch == at:
            raise KeyboardInterrupt

    return on_epoch


def test_an_interrupted_training_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    config = dataclasses.replace(QUICK, dropout=0.3)
    expected, checkpoint = untrained(), tmp_path / "checkpoint.pt"
    log = fit(expected, white(), config)
    stopped = fit(untrained(), white(), config, interrupting(2), checkpoint)  # type: ignore[arg-type]
    assert stopped.interrupted
    assert [line.epoch for line in stopped.epochs] == [0, 1, 2]
    resumed, shown = untrained(), list[Epoch]()
    again = fit(resumed, white(), config, shown.append, checkpoint, resume=True)
    assert [line.epoch for line in shown] == [0, 1, 2, 3]
    assert [line.validation_loss for line in again.epochs] == [line.validation_loss for line in log.epochs]
    for name, tensor in expected.state_dict().items():
        assert torch.equal(tensor, resumed.state_dict()[name]), name


def test_an_interrupt_before_anything_was_validated_goes_on_to_the_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> tuple[float, float]:
        raise KeyboardInterrupt

    monkeypatch.setattr("foten.training.window_fit.validated", interrupted)
    with pytest.raises(KeyboardInterrupt):
        fit(untrained(), white(), QUICK)


def full_disk(path: Path, *_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device", str(path))


def test_a_full_disk_costs_the_checkpoint_and_not_the_training(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A note in one line, however many checkpoints could not be written; the network is that of any other disk."""
    expected, network, checkpoint = untrained(), untrained(), tmp_path / "checkpoint.pt"
    fit(expected, white(), QUICK)
    monkeypatch.setattr(Path, "write_bytes", full_disk)
    progress = fit(network, white(), QUICK, checkpoint=checkpoint)
    assert [line.epoch for line in progress.epochs] == [0, 1, 2, 3]
    assert progress.notes == [f"{checkpoint}: no space left on device; the training went on without its checkpoint"]
    assert not list(tmp_path.iterdir())
    for name, tensor in expected.state_dict().items():
        assert torch.equal(tensor, network.state_dict()[name]), name


def test_a_disk_that_fills_up_leaves_the_checkpoint_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checkpoint = tmp_path / "checkpoint.pt"
    parts = {"network": untrained()}

    def on_epoch(line: Epoch) -> None:
        if line.epoch == 2:
            monkeypatch.setattr(Path, "write_bytes", full_disk)

    progress = fit(parts["network"], white(), QUICK, on_epoch, checkpoint)
    assert len(progress.notes) == 1
    saved = torch.load(checkpoint, weights_only=True)
    assert [line["epoch"] for line in saved["epochs"]] == [0, 1]


def test_what_is_not_finite_is_named() -> None:
    samples = np.random.default_rng(0).standard_normal((400, 3))
    samples[50, 0] = np.inf  # seen in training alone
    with pytest.raises(ValueError, match="the training loss is not finite"):
        fit(untrained(), windows_of(samples), QUICK)
    samples[350, 0] = np.nan
    with pytest.raises(ValueError, match="the validation loss is not finite"):
        fit(untrained(), windows_of(samples), QUICK)


def test_a_checkpoint_that_is_another_runs_is_refused(tmp_path: Path) -> None:
    path, network = tmp_path / "checkpoint.pt", untrained()
    torch.save({"config": vars(QUICK), "network": {}}, path)
    with pytest.raises(ValueError, match=r"checkpoint\.pt is of another version of foten"):
        load_progress(path, QUICK, {"network": network})
    fit(network, white(), QUICK, checkpoint=path)
    with pytest.raises(ValueError, match=r"checkpoint\.pt was written by a run with other settings"):
        load_progress(path, dataclasses.replace(QUICK, batch=32), {"network": network})
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(ValueError, match=r"checkpoint\.pt is damaged"):
        load_progress(path, QUICK, {"network": network})


CONFIG = replace(RECIPES["default"], probation=3, min_gain=1e-3, patience=4)


def progress(errors: list[float]) -> Progress:
    """Return what has been after some epochs, from epoch 0 on, given their validation errors."""
    best = min(range(len(errors)), key=errors.__getitem__)
    lines = [Epoch(n, 1.0, error, error, 0.1, n == best or n == 0) for n, error in enumerate(errors)]
    return Progress(lines, best_loss=errors[best])


def test_a_network_that_gains_nothing_is_stopped_at_the_end_of_its_probation_and_says_so() -> None:
    assert goes_on(progress([1.0]), CONFIG)
    assert goes_on(progress([1.0, 0.9999, 0.9998]), CONFIG)
    given = progress([1.0, 0.9999, 0.9998, 0.9995])
    assert not goes_on(given, CONFIG)
    assert given.notes == [
        "the network gains 0.05 % on the validation blocks in 3 epochs, less than 0.1 %: its training stops there"
    ]


@pytest.mark.parametrize("errors", [[1.0, 1.0, 0.9985, 1.0], [1.0, 0.9, 0.8, 0.7]])
def test_a_network_that_gained_something_goes_on(errors: list[float]) -> None:
    given = progress(errors)
    assert goes_on(given, CONFIG)
    assert not given.notes


def test_patience_ends_what_probation_let_pass() -> None:
    assert goes_on(progress([1.0, 0.9, 0.91, 0.92, 0.93]), CONFIG)
    assert not goes_on(progress([1.0, 0.9, 0.91, 0.92, 0.93, 0.94]), CONFIG)


def test_the_papers_recipe_has_no_probation() -> None:
    paper = RECIPES["paper"]
    assert paper.probation > paper.epochs


def test_the_papers_recipe_is_the_papers() -> None:
    paper = RECIPES["paper"]
    assert (paper.epochs, paper.patience, paper.batch, paper.learning_rate) == (100, 10, 16, 1e-3)
    assert (paper.loss, paper.delta, paper.schedule) == ("huber", 1.6, "constant")
    assert (paper.weight_decay, paper.clip_norm, paper.dropout) == (0.0, 0.0, 0.2)
    named = {"window": 20, "d_model": 32, "n_heads": 4, "n_layers": 3, "d_feedforward": 128, "head": (256, 64)}
    assert FotenSizes() == FotenSizes(**named)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"loss": "l2"}, "expected one of huber, mse, mae"),
        ({"schedule": "step"}, "one_cycle"),
        ({"batch": 0}, "batch is 0"),
        ({"epochs": -1}, "epochs is -1"),
        ({"dropout": 1.0}, "dropout is 1.0"),
        ({"learning_rate": 0.0}, "must be positive"),
        ({"batch": 2.5}, "batch is 2.5, expected a whole number"),
        ({"epochs": True}, "epochs is True, expected a whole number"),
        ({"seed": "1"}, "seed is '1', expected a whole number"),
        ({"delta": float("inf")}, "delta is inf, expected a finite number"),
    ],
)
def test_what_cannot_be_is_refused(change: dict[str, object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        TrainConfig(**change)  # type: ignore[arg-type]


def test_recipes_change_what_a_config_has() -> None:
    for model, changed in (OWN_RECIPES | UNUSED).items():
        assert model in TRAINABLE
        assert set(changed) <= set(vars(RECIPES["paper"]))


def test_settings_that_mean_nothing_to_a_model_are_refused() -> None:
    check_used("foten", ["loss", "dropout"])
    check_used("gan", ["epochs", "batch", "learning_rate"])
    with pytest.raises(ValueError, match="clip-norm means nothing to gan"):
        check_used("gan", ["epochs", "clip_norm"])
