"""The training loop: the best epoch is kept, what is interrupted goes on, what is lost says so."""

from __future__ import annotations

import dataclasses
import errno
from pathlib import Path

import numpy as np
import pytest
import torch

from foten.families import FotenSizes
from foten.networks import build
from foten.networks.dropout import Dropout, set_dropout
from foten.train.config import TrainConfig
from foten.train.epochs import Epoch, load_progress
from foten.train.fit import TrainingWindows, fit, loss_of, predict

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

    monkeypatch.setattr("foten.train.fit.validated", interrupted)
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
