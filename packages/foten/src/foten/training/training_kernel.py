"""Training's library in C (`native/training`): a recurrent unit over chunks, and lattices of blocks."""

from collections.abc import Callable
from ctypes import CDLL, Structure, byref, c_double, c_int, c_void_p
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
RECURRENT_NAMES = ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
_ARRAY = c_void_p
_INTEGERS = {"vertex"}
_DOUBLES = {
    *("faster", "firmer", "error_weight", "forward", "backward", "gain"),
    *("scales", "parts", "information", "score", "mean"),
}


def fields(**groups: tuple[str, Any]) -> list[tuple[str, Any]]:
    return [(name, kind) for names, kind in groups.values() for name in names.split()]


class RecurrentUnit(Structure):
    """recurrent_unit."""

    _fields_ = fields(
        counts=("n s n_hidden", c_int), arrays=("weight bias from_input hidden gates candidate_preactivation", _ARRAY)
    )


class LatticeBlocks(Structure):
    """lattice_blocks."""

    _fields_ = fields(
        counts=("n_blocks n n_vertices to_faster to_firmer", c_int),
        numbers=("leak", c_double),
        inputs=("vertex faster firmer error_weight", _ARRAY),
        states=("forward backward gain", _ARRAY),
    )


class Deviations(Structure):
    """deviations."""

    _fields_ = fields(
        counts=("n n_parts n_scales", c_int),
        inputs=("scales parts information score", _ARRAY),
        outputs=("mean", _ARRAY),
    )


def structure_of(kind: type[Structure], **values: Any) -> Any:
    """A C structure of numbers and arrays, which it keeps alive."""
    structure: Any = kind()
    structure.arrays = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
    for name, value in values.items():
        setattr(structure, name, _at(value, name) if name in structure.arrays else value)
    return structure


def _at(array: NDArray[Any], name: str = "") -> int:
    assert array.flags.c_contiguous
    assert array.dtype == (np.float64 if name in _DOUBLES else np.int32 if name in _INTEGERS else np.float32)
    return array.ctypes.data


def pointer(array: NDArray[np.float64]) -> c_void_p:
    """An array of doubles as an argument of a function in C."""
    assert array.flags.c_contiguous
    assert array.dtype == np.float64
    return c_void_p(array.ctypes.data)


def run_in_c(name: str, *arguments: Any) -> None:
    """Run a function of the library, in this processor's instruction set; a MemoryError where there is too little."""
    if _function(name)(*arguments):
        raise MemoryError(f"{name}: no memory for the scratch of a batch")


@cache
def training_library() -> CDLL:
    """Training's library, as it was built with this package; an OSError where there is none, or it does not load."""
    return CDLL(str(kernel_file(*LIBRARIES)))


@cache
def _function(name: str) -> Callable[..., int]:
    return getattr(training_library(), f"{name}_{isa()}")


def padded(n: int) -> int:
    """Length of a row of n numbers, padded."""
    return -(-n // PADDED) * PADDED


def zero_padded(array: NDArray[Any], *shape: int) -> Floats:
    """An array with zeros at the ends of its axes, in float32."""
    out = np.zeros(shape, np.float32)
    out[tuple(slice(n) for n in array.shape)] = array
    return out


def recurrent_weights(
    from_input: NDArray[Any], from_hidden: NDArray[Any], input_bias: NDArray[Any], hidden_bias: NDArray[Any]
) -> tuple[Floats, Floats, Floats, Floats]:
    """Weights and biases of a unit's gates, padded gate by gate and row by row."""
    h, n_inputs = from_hidden.shape[1], from_input.shape[1]
    wide = padded(h)

    def padded_gates(weight: NDArray[Any], *row: int) -> Floats:
        return zero_padded(weight.reshape(GATES, h, *weight.shape[1:]), GATES, wide, *row).reshape(GATES * wide, *row)

    biases = padded_gates(input_bias), padded_gates(hidden_bias)
    return padded_gates(from_input, padded(n_inputs)), padded_gates(from_hidden, wide), *biases


def recurrent_gradients(
    grad_gates: Floats, grad_preactivation: Floats, inputs: Floats, hidden: Floats, h: int, n_inputs: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """Gradients by the weights and biases that `recurrent_weights` pads, without the padding.

    From those by the gates' inputs, (n, s, 3 padded h), and by what the reset multiplies, (n, s, padded h), and from the inputs
    and hidden states of each sample, (n · s, …).
    """
    gates, candidate = (gradient.reshape(len(inputs), -1) for gradient in (grad_gates, grad_preactivation))
    n_reset_update = 2 * candidate.shape[1]
    grad_hidden = np.concatenate([gates[:, :n_reset_update].T @ hidden, candidate.T @ hidden])
    grad_bias = gates.sum(axis=0)
    grad_hidden_bias = np.concatenate([grad_bias[:n_reset_update], candidate.sum(axis=0)])

    def unpadded(gradient: Floats, *row: int) -> Floats:
        rows = gradient.reshape(GATES, -1, *gradient.shape[1:])[:, :h].reshape(-1, *gradient.shape[1:])
        return np.ascontiguousarray(rows[tuple(slice(n) for n in (None, *row))])

    biases = unpadded(grad_bias), unpadded(grad_hidden_bias)
    return unpadded(gates.T @ inputs, n_inputs), unpadded(grad_hidden, h), *biases


def hidden_states(unit: nn.GRU, inputs: Tensor) -> Tensor:
    """Hidden states after each sample, from zeros: (b, n, n_inputs) → (b, n, h), with a gradient by the weights.

    On another device than the CPU, in another precision, and with a gradient by the inputs, it is PyTorch's.
    """
    if inputs.device.type != "cpu" or inputs.dtype != torch.float32 or inputs.requires_grad:
        return unit(inputs)[0]
    return _Hidden.apply(inputs, *(getattr(unit, f"{name}_l0") for name in RECURRENT_NAMES))


class _Hidden(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, inputs: Tensor, *weights: Tensor) -> Tensor:
        arrays = (weight.detach().numpy() for weight in weights)
        input_weight, hidden_weight, input_bias, hidden_bias = recurrent_weights(*arrays)
        s, n, n_inputs = inputs.shape
        h, wide = weights[1].shape[1], hidden_weight.shape[1]
        samples = zero_padded(inputs.detach().numpy().transpose(1, 0, 2), n, s, input_weight.shape[1])
        from_input = samples.reshape(n * s, -1) @ input_weight.T
        from_input += input_bias
        hidden = np.zeros((n + 1, s, wide), np.float32)
        ctx.unit = structure_of(
            RecurrentUnit,
            **{"n": n, "s": s, "n_hidden": wide, "weight": hidden_weight, "bias": hidden_bias, "hidden": hidden},
            from_input=from_input,
            candidate_preactivation=np.empty((n, s, wide), np.float32),
            gates=np.empty((n, s, GATES * wide), np.float32),
        )
        run_in_c("foten_train_unit", byref(ctx.unit))
        ctx.samples, ctx.n_inputs = samples, n_inputs
        return torch.from_numpy(np.ascontiguousarray(hidden[1:, :, :h].transpose(1, 0, 2)))

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor | None, ...]:
        names = ("hidden", "gates", "candidate_preactivation")
        hidden, gates, candidate = (ctx.unit.arrays[name] for name in names)
        n, s, wide = hidden.shape[0] - 1, hidden.shape[1], hidden.shape[2]
        h = grad_outputs[0].shape[2]
        grad_hidden = zero_padded(grad_outputs[0].numpy().transpose(1, 0, 2), n, s, wide)
        run_in_c("foten_train_unit_back", byref(ctx.unit), c_void_p(_at(grad_hidden)))
        ctx.unit = None  # its gates are gradients now
        inputs, before = ctx.samples.reshape(n * s, -1), hidden[:-1].reshape(n * s, -1)
        gradients = recurrent_gradients(gates, candidate, inputs, before, h, ctx.n_inputs)
        return None, *(torch.from_numpy(gradient) for gradient in gradients)
