"""The training kernel in C: its structures are those of its source, its layers PyTorch's, its roll-outs the definition's."""

from __future__ import annotations

import ctypes
import gc
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.stats import norm
from torch import Tensor

from foten.models.foten import transformer
from foten.models.foten.transformer import EncoderLayer
from foten.models.foten_plus.definition import Mixture
from foten.training import encoder_kernel
from foten.training import training_kernel as kernel
from foten.training.dropout import bits_from, random_bits, set_dropout
from foten.training.training_kernel import MAX_ADJOINT, WEIGHT_NAMES, Rollout, RolloutInputs, RolloutState

C_SOURCES = Path(__file__).parents[1] / "native/training"


@pytest.mark.parametrize("of", ["portable", kernel.isa()])
@pytest.mark.parametrize(("n_inputs", "n_hidden", "s"), [(5, 48, 7), (9, 6, 1), (5, 17, 64)])
def test_hidden_states_and_gradients_are_pytorchs(
    n_inputs: int, n_hidden: int, s: int, of: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of its own unit, in every instruction set, whatever rows are padded to: to what float32 leaves of 40 samples."""
    monkeypatch.setattr(kernel, "_function", lambda name: getattr(kernel.training_library(), f"{name}_{of}"))
    torch.manual_seed(3)
    unit = torch.nn.GRU(n_inputs, n_hidden, batch_first=True)
    inputs, weight = 2 * torch.randn(s, 40, n_inputs), torch.randn(s, 40, n_hidden)
    (theirs, _), ours = unit(inputs), kernel.hidden_states(unit, inputs)
    torch.testing.assert_close(ours, theirs, atol=1e-5, rtol=0)
    expected, gradients = (torch.autograd.grad((x * weight).sum(), list(unit.parameters())) for x in (theirs, ours))
    for gradient, other in zip(gradients, expected, strict=True):
        torch.testing.assert_close(gradient, other, atol=1e-4 * float(other.abs().max()), rtol=0)


def test_hidden_states_in_double_are_pytorchs_own() -> None:
    unit = torch.nn.GRU(5, 6, batch_first=True).double()
    inputs = torch.randn(2, 9, 5, dtype=torch.float64)
    assert torch.equal(kernel.hidden_states(unit, inputs), unit(inputs)[0])


@pytest.mark.parametrize(
    "structure",
    [
        *(kernel.RecurrentUnit, kernel.RolloutBatch, kernel.RolloutGradients, kernel.LatticeBlocks, kernel.Deviations),
        *(encoder_kernel.EncoderLayer, encoder_kernel.EncoderGradients),
    ],
)
def test_structures_are_laid_out_as_in_c(structure: type[ctypes.Structure]) -> None:
    """By their source, under the name of the docstring: each member by name, in its place, as number or as array."""
    name = str(structure.__doc__).removesuffix(".")
    source = "".join(path.read_text(encoding="utf-8") for path in C_SOURCES.glob("*.c"))
    source = re.sub(r"/\*.*?\*/", "", source, flags=re.S)
    (body,) = re.findall(r"typedef struct \{([^}]*)\} " + name + ";", source)
    kinds = {"int": ctypes.c_int, "float": ctypes.c_float, "double": ctypes.c_double}
    members, arrays = [], {}
    for declared in filter(None, (line.strip() for line in body.split(";"))):
        kind, names = re.fullmatch(r"(?:const )?(int|float|double|short) (.*)", declared, re.S).groups()  # type: ignore[union-attr]
        for member in (name.strip() for name in names.split(",")):
            members.append((member.lstrip("*"), ctypes.c_void_p if member[0] == "*" else kinds[kind]))
            arrays |= {member[1:]: kind} if member[0] == "*" else {}
    assert structure._fields_ == members
    assert {array for array, kind in arrays.items() if kind == "double"} == kernel._DOUBLES & set(arrays)
    assert {array for array, kind in arrays.items() if kind == "int"} == kernel._INTEGERS & set(arrays)
    assert f"GATES = {kernel.GATES} " in source


Inputs = tuple[RolloutInputs, RolloutState]


def streams(s: int, n: int, p: int, rng: np.random.Generator, gain_before: bool) -> Inputs:
    def single(values: np.ndarray) -> np.ndarray:
        return values.astype(np.float32)

    reflections = np.ascontiguousarray(single(rng.uniform(-0.7, 0.7, (s, n, p))).transpose(1, 2, 0))
    level, logs = single(rng.uniform(0.5, 2.0, (s, n))), single(rng.standard_normal((s, n, 2)))
    states, hidden, inputs = (single(rng.standard_normal(shape)) for shape in ((s, p), (s, 6), (s, 5)))
    return RolloutInputs(reflections, level, logs, gain_before, 50.0), RolloutState(states, hidden, inputs)


def weights(k: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    shapes = [(18, 5), (18, 6), (18,), (18,), (7, 11), (7,), (3 * k, 7), (3 * k,)]
    return {
        name: (0.4 * rng.standard_normal(shape)).astype(np.float32)
        for name, shape in zip(WEIGHT_NAMES, shapes, strict=True)
    }


def mixture_of(out: np.ndarray) -> Mixture:
    """What outputs (s, 3k) of a network say."""
    logit, mean, log_scale = np.split(out.astype(float), 3, axis=1)
    weight = np.exp(logit)
    return Mixture(weight / weight.sum(axis=1, keepdims=True), mean, np.exp(6 * np.tanh(log_scale / 6)))


@pytest.mark.parametrize("gain_before", [False, True])
@pytest.mark.parametrize("p", [1, 2, 9])
@pytest.mark.parametrize("of_isa", ["portable", kernel.isa()])
def test_gradients_are_those_of_finite_differences(
    of_isa: str, p: int, gain_before: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of one Gaussian, whose draw μ + s z moves with the weights; of a mixture the draw's own derivative is below.

    In float32 a central difference of 1e-2 is good to a per cent of the largest.
    """
    monkeypatch.setattr(kernel, "_function", lambda name: getattr(kernel.training_library(), f"{name}_{of_isa}"))
    rng = np.random.default_rng(3)
    inputs, state = streams(3, 12, p, rng, gain_before)
    at, of = weights(1, rng), rng.standard_normal((3, 12)).astype(np.float32)

    def loss(changed: dict[str, np.ndarray]) -> float:
        return float((Rollout(changed, inputs, state, np.random.default_rng(4)).residual.astype(float) * of).sum())

    gradients = Rollout(at, inputs, state, np.random.default_rng(4)).gradients(of, np.inf)
    for name, gradient in gradients.items():
        largest = float(np.abs(gradient).max())
        for number in rng.choice(gradient.size, min(6, gradient.size), replace=False):
            ends = []
            for step in (-1e-2, 1e-2):
                changed = {**at, name: at[name].copy()}
                changed[name].flat[number] += step
                ends.append(loss(changed))
            assert float(gradient.flat[number]) == pytest.approx((ends[1] - ends[0]) / 2e-2, abs=0.02 * largest + 1e-3)


def test_a_chaotic_stream_does_not_drown_the_others() -> None:
    """Weights eight times as large let a difference grow with each sample; held, a gradient is of the size of one sample's."""
    rng = np.random.default_rng(8)
    inputs, state = streams(3, 400, 2, rng, False)
    at = {name: 8 * weight for name, weight in weights(1, rng).items()}
    of = np.ones((3, 400), np.float32)
    free, held = (
        max(float(np.abs(part).max()) for part in Rollout(at, inputs, state, drawn).gradients(of, limit).values())
        for limit, drawn in ((np.inf, np.random.default_rng(1)), (MAX_ADJOINT, np.random.default_rng(1)))
    )
    assert free > 1e6
    assert held < 1e4


def test_a_draw_moves_as_its_quantile_does() -> None:
    """∂e/∂θ at one probability, against the definition's quantile at the same z."""
    rng = np.random.default_rng(5)
    inputs, state = streams(40, 1, 3, rng, False)
    run = Rollout(weights(4, rng), inputs, state, rng)
    derivative, out = run._draw_derivatives()[0], run._out[0].astype(float)
    now = mixture_of(out)
    z = norm.ppf((now.weight * norm.cdf((run.innovation[0][:, None] - now.mean) / now.scale)).sum(axis=1))
    for column in range(out.shape[1]):
        step = np.zeros_like(out)
        step[:, column] = 1e-5
        expected = (mixture_of(out + step).quantile(z) - mixture_of(out - step).quantile(z)) / 2e-5
        np.testing.assert_allclose(derivative[:, column], expected, rtol=2e-3, atol=2e-4)


def test_draws_are_distributed_as_the_network_says() -> None:
    """Kolmogorov and Smirnov's distance of 20,000 draws from one mixture of four; 1.95 / √n is its 0.1 % quantile."""
    n, rng = 20_000, np.random.default_rng(9)
    inputs, state = streams(1, 1, 1, rng, False)
    run = Rollout(weights(4, rng), inputs, state, rng, n)
    mixture = mixture_of(run._out[0, :1])
    assert 1 - (mixture.weight**2).sum() > 0.5  # which no component alone is
    drawn = np.sort(run.innovation[0].astype(float))
    below = (mixture.weight * norm.cdf((drawn[:, None] - mixture.mean) / mixture.scale)).sum(axis=1)
    assert np.abs(below - (np.arange(n) + 0.5) / n).max() < 1.95 / np.sqrt(n)


Layer = Callable[[EncoderLayer], tuple[Tensor, list[Tensor]]]


def encoded(tokens: Tensor, last_only: bool, weight: Tensor, seed: int) -> Layer:
    """What a layer makes of tokens, and the gradients of a weighted sum of that by tokens and weights."""

    def run(layer: EncoderLayer) -> tuple[Tensor, list[Tensor]]:
        generator = torch.Generator().manual_seed(seed)
        given = tokens.clone().requires_grad_()
        with bits_from(partial(random_bits, generator=generator)):
            out = layer(given, last_only=last_only)
        return out.detach(), list(torch.autograd.grad((out * weight).sum(), [given, *layer.parameters()]))

    return run


@pytest.mark.parametrize("of", ["portable", kernel.isa()])
@pytest.mark.parametrize("dropout", [0.0, 0.2])
@pytest.mark.parametrize("last_only", [False, True])
@pytest.mark.parametrize(
    ("b", "n", "width", "heads", "fed"),
    [(16, 20, 32, 4, 128), (3, 25, 32, 8, 64), (1, 1, 16, 1, 16), (50, 5, 48, 4, 32), (2, 33, 64, 4, 48)],
)
def test_layer_in_c_is_pytorchs(
    *,
    of: str,
    dropout: float,
    last_only: bool,
    b: int,
    n: int,
    width: int,
    heads: int,
    fed: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In every instruction set, within what float32 leaves; the reference is the same layer in float64."""
    monkeypatch.setattr(kernel, "_function", lambda name: getattr(kernel.training_library(), f"{name}_{of}"))
    torch.manual_seed(5)
    layer = EncoderLayer(width, heads, fed, pre_norm=True)
    for parameter in layer.parameters():
        parameter.data.add_(0.1 * torch.randn_like(parameter))
    set_dropout(layer, dropout)
    tokens, weight = torch.randn(b, n, width), torch.randn(b, 1 if last_only else n, width)
    calls = 0

    def counted(*arguments: Any) -> Tensor:
        nonlocal calls
        calls += 1
        return original(*arguments)

    original = transformer.encoded
    monkeypatch.setattr(transformer, "encoded", counted)
    ours, gradients = encoded(tokens, last_only, weight, 7)(layer)
    theirs, expected = encoded(tokens.double(), last_only, weight.double(), 7)(layer.double())
    assert calls == 1
    torch.testing.assert_close(ours.double(), theirs, atol=1e-5, rtol=0)
    for gradient, other in zip(gradients, expected, strict=True):
        torch.testing.assert_close(gradient.double(), other, atol=2e-5 * float(other.abs().max()) + 1e-6, rtol=0)


def test_a_layer_whose_way_back_is_not_needed_gives_the_same_bits() -> None:
    """It keeps of a group of windows what it keeps of all else: 1024 windows in a validation would take 40 MB a layer."""
    torch.manual_seed(5)
    layer, tokens = EncoderLayer(32, 4, 128, pre_norm=True), torch.randn(67, 20, 32)
    for last_only in (False, True):
        with torch.no_grad():
            alone = layer(tokens, last_only=last_only)
        assert torch.equal(alone, layer(tokens, last_only=last_only))


def test_a_layer_gives_its_memory_back_without_the_garbage_collector() -> None:
    """What it keeps held its own output once, so that each step took fresh memory, at twice the time."""
    layer, tokens = EncoderLayer(32, 4, 128, pre_norm=True), torch.randn(16, 20, 32)
    gc.collect()
    gc.disable()
    try:
        layer(tokens).sum().backward()
        assert not [kept for kept in gc.get_objects() if type(kept) is encoder_kernel.EncoderLayer]
    finally:
        gc.enable()
