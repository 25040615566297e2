"""The training kernel in C: its structures are those of its source, its unit is PyTorch's."""

from __future__ import annotations

import ctypes
import re
from pathlib import Path

import pytest
import torch

from foten.training import training_kernel as kernel

C_SOURCE = Path(__file__).parents[1] / "native/training/training_kernel.c"


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


@pytest.mark.parametrize("structure", [kernel.RecurrentUnit, kernel.RolloutBatch, kernel.RolloutGradients])
def test_structures_are_laid_out_as_in_c(structure: type[ctypes.Structure]) -> None:
    """By their source, under the name of the docstring: each member by name, in its place, as number or as array."""
    name = str(structure.__doc__).removesuffix(".")
    source = re.sub(r"/\*.*?\*/", "", C_SOURCE.read_text(encoding="utf-8"), flags=re.S)
    (body,) = re.findall(r"typedef struct \{([^}]*)\} " + name + ";", source)
    kinds = {"int": ctypes.c_int, "float": ctypes.c_float, "double": ctypes.c_double}
    members, doubles = [], []
    for declared in filter(None, (line.strip() for line in body.split(";"))):
        kind, names = re.fullmatch(r"(?:const )?(int|float|double) (.*)", declared, re.S).groups()  # type: ignore[union-attr]
        for member in (name.strip() for name in names.split(",")):
            members.append((member.lstrip("*"), ctypes.c_void_p if member[0] == "*" else kinds[kind]))
            doubles += [member[1:]] if kind == "double" and member[0] == "*" else []
    assert structure._fields_ == members
    assert set(doubles) <= set(kernel._DOUBLES)
    assert not {array for array, of in members if of is ctypes.c_void_p and array not in doubles} & set(kernel._DOUBLES)
    assert f"GATES = {kernel.GATES} " in source
