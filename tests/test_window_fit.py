"""Networks fitted to windows: what they learn from, the loss, dropout and threads."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from foten.baselines.graph import build
from foten.models.foten.sizes import FotenSizes
from foten.training.config import TrainConfig
from foten.training.dropout import Dropout, set_dropout
from foten.training.loop import Checkpoint, Epoch, Monitor
from foten.training.window_fit import DeviceWindows, TrainingWindows, fit_windows, loss_of, predict

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
    huber = torch.where(r.abs() <= 1.6, r**2 / 2, 1.6 * r.abs() - 1.6**2 / 2).mean()
    for name, expected in {"huber": huber, "mae": r.abs().mean(), "mse": (r**2).mean()}.items():
        loss = loss_of(TrainConfig(delta=1.6, loss=name))(r, torch.zeros_like(r))
        assert float(loss) == pytest.approx(float(expected), rel=1e-12)


def test_an_epoch_is_all_training_windows_and_no_other() -> None:
    data = white(100)
    first, second = (DeviceWindows(data, untrained()).shuffled(0, epoch).numpy() for epoch in (1, 2))
    assert sorted(first) == sorted(second) == data.train.tolist()
    assert (first != second).any()


def test_a_target_of_its_own_is_learned_and_reported_in_its_unit() -> None:
    samples = np.random.default_rng(3).standard_normal((400, 3))
    network = untrained()
    windows = dataclasses.replace(windows_of(samples), target=samples[:, 1])
    line = fit_windows(network, windows, TrainConfig(epochs=0, loss="mae", threads=1), Monitor()).epochs[0]
    error = np.abs(samples[windows.validation, 1] - predict(network, windows, windows.validation)).mean()
    assert line.validation_loss == pytest.approx(error, rel=1e-5)
    assert line.validation_mae == pytest.approx(error, rel=1e-5)


def test_two_threads_learn_what_one_does_and_give_the_same_network_twice() -> None:
    """Without dropout, of which each share draws its own, they differ by the rounding of another sum."""
    losses = []
    for threads, dropout in ((1, 0.0), (2, 0.0), (2, 0.5), (2, 0.5)):
        config = TrainConfig(epochs=2, batch=64, dropout=dropout, threads=threads)
        last = fit_windows(untrained(), white(), config, Monitor()).epochs[2]
        losses.append([last.train_loss, last.validation_loss])
    assert losses[1] == pytest.approx(losses[0], rel=1e-4)
    assert losses[2] == losses[3]
    assert losses[2] != pytest.approx(losses[1], rel=1e-3)


def test_dropout_keeps_the_mean_and_drops_its_share() -> None:
    dropout = Dropout()
    set_dropout(dropout, 0.2)
    values = torch.ones(100_000)
    dropped = dropout(values)
    # 100 000 draws of a share of 0.2: standard error 0.0013.
    assert float((dropped == 0).float().mean()) == pytest.approx(0.2, abs=0.006)
    assert float(dropped.max()) == pytest.approx(1.25, rel=1e-4)
    assert torch.equal(dropout.eval()(values), values)


def test_a_resumed_training_draws_the_same_order_and_the_same_dropout(tmp_path: Path) -> None:
    config = dataclasses.replace(QUICK, dropout=0.3)
    expected, path = untrained(), tmp_path / "checkpoint.pt"
    log = fit_windows(expected, white(), config, Monitor())

    def interrupt(line: Epoch) -> None:
        if line.epoch == 2:
            raise KeyboardInterrupt

    stopped = Monitor(on_epoch=interrupt, checkpoint=Checkpoint(path, config))
    assert fit_windows(untrained(), white(), config, stopped).interrupted
    resumed = untrained()
    again = fit_windows(resumed, white(), config, Monitor(checkpoint=Checkpoint(path, config, resume=True)))
    assert [line.validation_loss for line in again.epochs] == [line.validation_loss for line in log.epochs]
    for name, tensor in expected.state_dict().items():
        assert torch.equal(tensor, resumed.state_dict()[name]), name
