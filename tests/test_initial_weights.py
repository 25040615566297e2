"""Initial weights as Keras draws them: limits by Glorot's formula, zero biases, orthogonal recurrences."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import nn

from foten.baselines.graph import build
from foten.baselines.sizes import TRAINABLE
from foten.models.foten.sizes import FotenSizes
from foten.training.config import TrainConfig
from foten.training.initial_weights import draw_glorot
from foten.training.loop import Monitor
from foten.training.window_fit import TrainingWindows, fit_windows


@pytest.fixture(scope="module")
def foten() -> nn.Module:
    torch.manual_seed(3)
    network = build("foten", FotenSizes())
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
    network = build("foten-d", TRAINABLE["foten-d"]())
    draw_glorot(network)
    limit = math.sqrt(6 / inputs_and_outputs)
    assert 0.98 * limit < limit_of(network.get_submodule(f"decoder.{name}").get_parameter("weight")) <= limit


def test_normalisations_stay_as_they_are(foten: nn.Module) -> None:
    norms = [module for module in foten.modules() if isinstance(module, nn.LayerNorm)]
    assert norms
    assert all((norm.weight == 1).all() and not norm.bias.any() for norm in norms)


def test_recurrent_layers_are_orthogonal_and_forget_gates_open() -> None:
    torch.manual_seed(4)
    network = build("dstn", TRAINABLE["dstn"]())
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
    network = build("foten", FotenSizes(window=8))
    n = np.arange(8, 40)
    windows = TrainingWindows(np.random.default_rng(0).standard_normal((40, 3)), n[:16], n[16:], 8)
    fit_windows(network, windows, TrainConfig(epochs=0, initial_weights=initial_weights), Monitor())
    assert (not network.get_submodule("head_1").get_parameter("bias").any()) == is_zero
