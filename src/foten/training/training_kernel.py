"""Training's library in C, bound with ctypes: a recurrent unit over chunks, and roll-outs. `native/training`.

Both are loops of small matrices over hundreds of samples, which PyTorch runs one small operation at a time. A step of likelihood,
its head included, takes 0.4 of the time that it takes there (`benchmarks/random_part.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from ctypes import CDLL, Structure, byref, c_double, c_float, c_int, c_void_p
from functools import cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from foten.runtime.binding import isa, kernel_file

LIBRARIES = ("libfoten_training.so", "libfoten_training.dylib", "libfoten_training.dll")
Floats = NDArray[np.float32]
PADDED = 16  # numbers that rows are padded to a multiple of
GATES = 3

_ARRAY, _DOUBLES = c_void_p, ("phase_increment", "phase")


def _fields(**groups: tuple[str, Any]) -> list[tuple[str, Any]]:
    return [(name, kind) for names, kind in groups.values() for name in names.split()]


class RecurrentUnit(Structure):
    """recurrent_unit."""

    _fields_ = _fields(
        counts=("n s n_hidden", c_int), arrays=("weight bias from_input hidden gates candidate_preactivation", _ARRAY)
    )


class RolloutBatch(Structure):
    """rollout_batch."""

    _fields_ = _fields(
        counts=("n s p n_inputs n_hidden head_width n_components n_out gain_before_filter with_phase", c_int),
        numbers=("innovation_limit leak", c_float),
        weights=("from_input input_bias from_hidden hidden_bias head head_bias out out_bias", _ARRAY),
        inputs=("reflections cosines level logs chosen normal", _ARRAY),
        path=("phase_increment", _ARRAY),
        phase_params=("period_jitter phase_leak max_jitter_drive", c_double),
        states=("states", _ARRAY),
        phase=("phase", _ARRAY),
        outputs=("network head_output out_output gates candidate_preactivation innovation residual", _ARRAY),
    )


class RolloutGradients(Structure):
    """rollout_gradients."""

    _fields_ = _fields(
        inputs=("by_residual drawn", _ARRAY), limit=("adjoint_limit", c_float), outputs=("by_head by_out", _ARRAY)
    )


def structure_of(kind: type[Structure], **values: Any) -> Any:
    """A structure of numbers and arrays, which it keeps alive."""
    structure: Any = kind()
    structure.arrays = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
    for name, value in values.items():
        setattr(structure, name, _at(value, name) if name in structure.arrays else value)
    return structure


def _at(array: NDArray[Any], name: str = "") -> int:
    assert array.flags.c_contiguous
    assert array.dtype == (np.float64 if name in _DOUBLES else np.float32)
    return array.ctypes.data


def run_in_c(name: str, *arguments: Any) -> None:
    """Run a function of the instruction set that is used here.

    Raises:
        MemoryError: there is too little.
    """
    if _function(name)(*arguments):
        raise MemoryError(f"{name}: no memory for the scratch of a batch")


@cache
def training_library() -> CDLL:
    """Training's library, as it was built with this package.

    Raises:
        OSError: there is none, or it does not load.
    """
    return CDLL(str(kernel_file(*LIBRARIES)))


@cache
def _function(name: str) -> Callable[..., int]:
    function: Callable[..., int] = getattr(training_library(), f"{name}_{isa()}")
    return function


def padded(n: int) -> int:
    """How many numbers a row of n lies in."""
    return -(-n // PADDED) * PADDED


def widened(array: NDArray[Any], *shape: int) -> Floats:
    """An array with zeros at the ends of its axes, in float32."""
    out = np.zeros(shape, np.float32)
    out[tuple(slice(n) for n in array.shape)] = array
    return out


def recurrent_weights(weights: Mapping[str, NDArray[Any]]) -> tuple[Floats, Floats, Floats, Floats]:
    """Weights and biases of a unit's gates, from inputs and from hidden states, padded gate by gate and row by row."""
    of_input, of_hidden, input_bias, hidden_bias = (
        weights[name] for name in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
    )
    h, n_inputs = of_hidden.shape[1], of_input.shape[1]
    wide = padded(h)

    def laid(weight: NDArray[Any], *row: int) -> Floats:
        return widened(weight.reshape(GATES, h, *weight.shape[1:]), GATES, wide, *row).reshape(GATES * wide, *row)

    return laid(of_input, padded(n_inputs)), laid(of_hidden, wide), laid(input_bias), laid(hidden_bias)


def of_gates(by_gates: Floats, h: int) -> Floats:
    """Gradients by the weights of gates without their padding: (3 · padded h, …) → (3h, …)."""
    return np.ascontiguousarray(by_gates.reshape(GATES, -1, *by_gates.shape[1:])[:, :h]).reshape(
        -1, *by_gates.shape[1:]
    )


def of_recurrent(by_input: Floats, by_preactivation: Floats, inputs: Floats, hidden: Floats) -> tuple[Floats, ...]:
    """Gradients by weights from inputs and from hidden states, and by both biases, padded.

    From those by what goes into the gates, (n, s, 3h), and by what the reset multiplies, (n, s, h), and from inputs and hidden
    numbers that were given, (n · s, …).
    """
    gates, candidate = (gradient.reshape(len(inputs), -1) for gradient in (by_input, by_preactivation))
    two = 2 * candidate.shape[1]
    of_hidden = np.concatenate([gates[:, :two].T @ hidden, candidate.T @ hidden])
    sums = gates.sum(axis=0)
    return gates.T @ inputs, of_hidden, sums, np.concatenate([sums[:two], candidate.sum(axis=0)])


def hidden_states(unit: nn.GRU, inputs: Tensor) -> Tensor:
    """What a unit's hidden states are after each sample, from zeros: (b, n, n_inputs) → (b, n, h), with a gradient.

    Of its weights, not of the inputs. On another device than the CPU, and in another precision, it is PyTorch's.
    """
    if inputs.device.type != "cpu" or inputs.dtype != torch.float32 or inputs.requires_grad:
        out: Tensor = unit(inputs)[0]
        return out
    out = _Hidden.apply(inputs, unit.weight_ih_l0, unit.weight_hh_l0, unit.bias_ih_l0, unit.bias_hh_l0)
    return out


class _Hidden(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, inputs: Tensor, *weights: Tensor) -> Tensor:
        names = ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
        of_input, of_hidden, input_bias, hidden_bias = recurrent_weights(
            {name: weight.detach().numpy() for name, weight in zip(names, weights, strict=True)}
        )
        s, n, n_inputs = inputs.shape
        h, wide = weights[1].shape[1], of_hidden.shape[1]
        samples = widened(inputs.detach().numpy().transpose(1, 0, 2), n, s, of_input.shape[1])
        from_input = samples.reshape(n * s, -1) @ of_input.T
        from_input += input_bias
        hidden = np.zeros((n + 1, s, wide), np.float32)
        arrays = {
            "from_input": from_input,
            "hidden": hidden,
            "candidate_preactivation": np.empty((n, s, wide), np.float32),
        }
        arrays["gates"] = np.empty((n, s, GATES * wide), np.float32)
        ctx.unit = structure_of(RecurrentUnit, n=n, s=s, n_hidden=wide, weight=of_hidden, bias=hidden_bias, **arrays)
        run_in_c("foten_train_unit", byref(ctx.unit))
        ctx.samples, ctx.n_inputs = samples, n_inputs
        return torch.from_numpy(np.ascontiguousarray(hidden[1:, :, :h].transpose(1, 0, 2)))

    @staticmethod
    def backward(ctx: Any, *of_outputs: Tensor) -> tuple[Tensor | None, ...]:
        names = ("hidden", "gates", "candidate_preactivation")
        samples, hidden, gates, candidate = ctx.samples, *(ctx.unit.arrays[name] for name in names)
        n, s, wide = hidden.shape[0] - 1, hidden.shape[1], hidden.shape[2]
        h = of_outputs[0].shape[2]
        by_hidden = widened(of_outputs[0].numpy().transpose(1, 0, 2), n, s, wide)
        run_in_c("foten_train_unit_back", byref(ctx.unit), c_void_p(_at(by_hidden)))
        ctx.unit = None  # its gates are gradients now
        weights = of_recurrent(gates, candidate, samples.reshape(n * s, -1), hidden[:-1].reshape(n * s, -1))
        sums = (
            of_gates(weights[0], h)[:, : ctx.n_inputs],
            of_gates(weights[1], h)[:, :h],
            *(of_gates(bias, h) for bias in weights[2:]),
        )
        return None, *(torch.from_numpy(np.ascontiguousarray(gradient)) for gradient in sums)
