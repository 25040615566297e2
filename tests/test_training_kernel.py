"""The training kernel in C: its structures are those of its source, its layers PyTorch's."""

from __future__ import annotations

import ctypes
import gc
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from foten.models.foten import transformer
from foten.models.foten.transformer import EncoderLayer
from foten.training import encoder_kernel
from foten.training import training_kernel as kernel
from foten.training.dropout import bits_from, random_bits, set_dropout

C_SOURCES = Path(__file__).parents[1] / "packages/foten/native/training"


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
        *(kernel.RecurrentUnit, kernel.LatticeBlocks, kernel.Deviations),
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
