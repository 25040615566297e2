"""Networks fitted to windows: what they learn from, the loss, dropout and threads."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from foten.models.foten.sizes import FotenSizes
from foten.models.trainable import TRAINABLE
from foten.training.checkpoint import Checkpoint, Epoch
from foten.training.config import WindowConfig
from foten.training.dropout import Dropout, set_dropout
from foten.training.initial_weights import draw_glorot
from foten.training.loop import Monitor
from foten.training.window_fit import DeviceWindows, TrainingWindows, fit_windows, loss_of, predict
from foten_lab.baselines.networks import build

SIZES = FotenSizes(window=12, d_model=8, n_heads=2, n_layers=2, d_feedforward=16, head=(16, 8), spectral_width=8)
QUICK = WindowConfig(epochs=3, batch=64, threads=1)


def windows_of(samples: np.ndarray, m: int = 12) -> TrainingWindows:
    n = np.arange(m, len(samples))
    return TrainingWindows(samples, n[: len(n) // 2], n[len(n) // 2 :], m)


def untrained() -> torch.nn.Module:
    torch.manual_seed(0)
    return build(SIZES)


def white(n: int = 600, seed: int = 4) -> TrainingWindows:
    return windows_of(np.random.default_rng(seed).standard_normal((n, 3)))


def test_losses_are_those_of_equation_14() -> None:
    r = torch.linspace(-5, 5, 101, dtype=torch.float64)
    huber = torch.where(r.abs() <= 1.6, r**2 / 2, 1.6 * r.abs() - 1.6**2 / 2).mean()
    for name, expected in {"huber": huber, "mae": r.abs().mean(), "mse": (r**2).mean()}.items():
        loss = loss_of(WindowConfig(delta=1.6, loss=name))(r, torch.zeros_like(r))
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
    line = fit_windows(network, windows, WindowConfig(epochs=0, loss="mae", threads=1), Monitor()).epochs[0]
    error = np.abs(samples[windows.validation, 1] - predict(network, windows, windows.validation)).mean()
    assert line.validation_loss == pytest.approx(error, rel=1e-5)
    assert line.validation_mae == pytest.approx(error, rel=1e-5)


def test_two_threads_learn_what_one_does_and_give_the_same_network_twice() -> None:
    """Without dropout, of which each share draws its own, they differ by the rounding of another sum."""
    losses = []
    for threads, dropout in ((1, 0.0), (2, 0.0), (2, 0.5), (2, 0.5)):
        config = WindowConfig(epochs=2, batch=64, dropout=dropout, threads=threads)
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


@pytest.fixture(scope="module")
def foten() -> nn.Module:
    torch.manual_seed(3)
    network = build(FotenSizes())
    draw_glorot(network)
    return network


def limit_of(weight: torch.Tensor) -> float:
    """The largest of many uniform numbers is next to their limit."""
    return float(weight.detach().abs().max())


@pytest.mark.parametrize(
    ("name", "inputs_and_outputs"),
    [
        ("head_1", 66 + 256),
        ("head_2", 256 + 64),
        ("temporal.layers.0.feedforward_in", 32 + 128),
        ("temporal.layers.0.attention_in", 4 * 32 + 8 * 32),  # as Keras counts a kernel (32, 4, 8)
        ("temporal.layers.0.attention_out", 8 * 4 + 32 * 4),  # and (4, 8, 32)
    ],
)
def test_a_kernel_is_uniform_within_glorots_limit(foten: nn.Module, name: str, inputs_and_outputs: int) -> None:
    layer = foten.get_submodule(name)
    limit = math.sqrt(6 / inputs_and_outputs)
    assert isinstance(layer, nn.Linear)
    assert 0.98 * limit < limit_of(layer.weight) <= limit
    assert float(layer.weight.detach().std()) == pytest.approx(limit / math.sqrt(3), rel=0.05)
    assert not layer.bias.detach().any()


@pytest.mark.parametrize(
    ("name", "inputs_and_outputs"),
    [("query_in", 4 * 32 + 8 * 32), ("memory_in", 4 * 32 + 8 * 32), ("memory_out", 8 * 4 + 32 * 4)],
)
def test_a_decoders_attention_is_counted_as_an_encoders(name: str, inputs_and_outputs: int) -> None:
    torch.manual_seed(6)
    network = build(TRAINABLE["foten-d"].sizes())
    draw_glorot(network)
    limit = math.sqrt(6 / inputs_and_outputs)
    assert 0.98 * limit < limit_of(network.get_submodule(f"decoder.{name}").get_parameter("weight")) <= limit


def test_normalisations_stay_as_they_are(foten: nn.Module) -> None:
    norms = [module for module in foten.modules() if isinstance(module, nn.LayerNorm)]
    assert norms
    assert all((norm.weight == 1).all() and not norm.bias.any() for norm in norms)


def test_recurrent_layers_are_orthogonal_and_forget_gates_open() -> None:
    torch.manual_seed(4)
    network = build(TRAINABLE["dstn"].sizes())
    draw_glorot(network)
    lstm = network.get_submodule("decoder")
    assert isinstance(lstm, nn.LSTM)
    units = lstm.hidden_size
    kernel, recurrent = (parameter.detach() for parameter in (lstm.weight_ih_l0, lstm.weight_hh_l0))
    torch.testing.assert_close(recurrent.T @ recurrent, torch.eye(units), atol=1e-5, rtol=0)
    limit = math.sqrt(6 / (kernel.shape[0] + kernel.shape[1]))
    assert 0.98 * limit < limit_of(kernel) <= limit
    bias = (lstm.bias_ih_l0 + lstm.bias_hh_l0).detach().split(units)
    assert [float(gate.mean()) for gate in bias] == [0.0, 1.0, 0.0, 0.0]
    convolution = network.get_submodule("convolution_1")
    assert isinstance(convolution, nn.Conv1d)
    assert limit_of(convolution.weight) <= math.sqrt(6 / (5 * (3 + convolution.out_channels)))
    assert limit_of(convolution.weight) > 0.95 * math.sqrt(6 / (5 * (3 + convolution.out_channels)))


@pytest.mark.parametrize(("initial_weights", "is_zero"), [("glorot", True), ("uniform", False)])
def test_a_training_begins_with_the_weights_that_it_is_asked_for(initial_weights: str, is_zero: bool) -> None:
    torch.manual_seed(5)
    network = build(FotenSizes(window=8))
    n = np.arange(8, 40)
    windows = TrainingWindows(np.random.default_rng(0).standard_normal((40, 3)), n[:16], n[16:], 8)
    fit_windows(network, windows, WindowConfig(epochs=0, initial_weights=initial_weights), Monitor())
    assert (not network.get_submodule("head_1").get_parameter("bias").any()) == is_zero
