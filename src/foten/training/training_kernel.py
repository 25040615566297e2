"""Training's library in C (`native/training`): a recurrent unit over chunks, closed-loop roll-outs, and lattices of blocks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from ctypes import CDLL, Structure, byref, c_double, c_float, c_int, c_void_p
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import ndtr
from torch import Tensor, nn

from foten.dsp import Array
from foten.dsp.lattice import LEAK
from foten.dsp.tones import MAX_JITTER_DRIVE
from foten.models.foten_plus.definition import Tones
from foten.models.foten_plus.sizes import LOG_SCALE_LIMIT
from foten.runtime.binding import isa, kernel_file

LIBRARIES = ("libfoten_training.so", "libfoten_training.dylib", "libfoten_training.dll")
Floats = NDArray[np.float32]
PADDED = 16  # numbers that rows are padded to a multiple of
GATES = 3
RECURRENT_NAMES = ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
WEIGHT_NAMES = (
    *(f"recurrent.{name}_l0" for name in RECURRENT_NAMES),
    *("head.weight", "head.bias", "out.weight", "out.bias"),
)
_ARRAY = c_void_p
_INTEGERS = {"vertex"}
_DOUBLES = {
    *("phase_increment", "phase", "faster", "firmer", "error_weight", "forward", "backward", "gain"),
    *("scales", "parts", "information", "score", "mean"),
}
_MIN_DENSITY = 1e-12
# Bound of what later samples add to a sample's gradient in one stream, times the root mean square of the gradients by single
# samples: where the closed loop is chaotic they grow without bound on the way back, and a few streams would outweigh all others.
MAX_ADJOINT = 3.0


def fields(**groups: tuple[str, Any]) -> list[tuple[str, Any]]:
    return [(name, kind) for names, kind in groups.values() for name in names.split()]


class RecurrentUnit(Structure):
    """recurrent_unit."""

    _fields_ = fields(
        counts=("n s n_hidden", c_int), arrays=("weight bias from_input hidden gates candidate_preactivation", _ARRAY)
    )


class RolloutBatch(Structure):
    """rollout_batch."""

    _fields_ = fields(
        counts=("n s p n_inputs n_hidden head_width n_components n_out gain_before_filter with_phase", c_int),
        numbers=("innovation_limit leak", c_float),
        weights=("from_input input_bias from_hidden hidden_bias head head_bias out out_bias", _ARRAY),
        inputs=("reflections cosines level logs chosen normal phase_increment", _ARRAY),
        phase_params=("period_jitter phase_leak max_jitter_drive", c_double),
        states=("states phase", _ARRAY),
        outputs=("network head_output out_output gates candidate_preactivation innovation residual", _ARRAY),
    )


class RolloutGradients(Structure):
    """rollout_gradients."""

    _fields_ = fields(
        inputs=("by_residual drawn", _ARRAY), limit=("adjoint_limit", c_float), outputs=("by_head by_out", _ARRAY)
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


@dataclass(frozen=True)
class RolloutInputs:
    """Inputs of s roll-outs of n samples that do not depend on the network."""

    reflections: Floats  # k of each sample's lattice, (n, p, s)
    level: Floats  # ℓ of each sample, (s, n)
    logs: Floats  # log speed and log force that go with each sample, (s, n, 2)
    gain_before_filter: bool
    innovation_limit: float
    tones: Tones | None = None
    # By how much the speed moves the phase up to each sample and the sample after [rad], (s, n + 1).
    phase_increment: Array | None = None


@dataclass(frozen=True)
class RolloutState:
    """Initial states of s roll-outs."""

    states: Floats  # of the lattice, (s, p)
    hidden: Floats  # of the network, (s, n_hidden)
    inputs: Floats  # of the network at the last sample, (s, 5 or more)
    phase: Array | None = None  # of tones at the first sample [rad], (s,)


class Rollout:
    """s streams of n samples in the closed loop of `models.foten_plus.definition`, each of which the network has drawn.

    Each of the inputs is rolled out `times` times, all of them once before any of them twice. `residual` is the lattice's
    output, (s, n), in scaled acceleration; `phase` that of the tones at each sample [rad], (s, n); `innovation` what was drawn,
    (n, s).

    At fixed random numbers every sample is a smooth function of the weights. A draw e from a density p with distribution
    function F, at fixed probability, has ∂e/∂θ = −(∂F/∂θ) / p(e). Speed, force and the phase of tones have no gradient.

    Source: Figurnov, Mohamed & Mnih, "Implicit reparameterization gradients" (NeurIPS 2018), for ∂e/∂θ; the rest ours.
    """

    def __init__(
        self,
        weights: Mapping[str, Floats],
        inputs: RolloutInputs,
        state: RolloutState,
        rng: np.random.Generator,
        times: int = 1,
    ) -> None:
        *recurrent, w_1, b_1, w_2, b_2 = (weights[name] for name in WEIGHT_NAMES)

        def each(array: NDArray[Any], axis: int = 0) -> NDArray[Any]:
            return np.ascontiguousarray(np.concatenate([array] * times, axis=axis))

        cosines = np.sqrt(1 - inputs.reflections * inputs.reflections)
        reflections, cosines = each(inputs.reflections, 2), each(cosines, 2)
        n, p, s = reflections.shape
        k, n_hidden, n_inputs, head_width = len(b_2) // 3, recurrent[1].shape[1], state.inputs.shape[1], len(b_1)
        self._sizes = n_hidden, n_inputs, head_width, 3 * k
        chosen, normal = rng.random((n, s, 1), np.float32), rng.standard_normal((n, s, 1), np.float32)
        from_input, from_hidden, input_bias, hidden_bias = recurrent_weights(*recurrent)
        h, m, w, o = from_hidden.shape[1], from_input.shape[1], padded(head_width), padded(3 * k)
        head = np.zeros((w, h + m), np.float32)
        head[:head_width, :n_hidden], head[:head_width, h : h + n_inputs] = w_1[:, :n_hidden], w_1[:, n_hidden:]
        network = np.zeros((n + 1, s, h + m), np.float32)
        network[0, :, :n_hidden], network[0, :, h : h + n_inputs] = each(state.hidden), each(state.inputs)
        level = each(inputs.level.T, 1)
        self._scale = np.ones_like(level) if inputs.gain_before_filter else level
        phase, tones = np.zeros((n, s)), dict[str, Any]()
        if inputs.tones is not None:
            assert inputs.phase_increment is not None
            assert state.phase is not None
            phase[0] = each(state.phase)
            tones = {name: getattr(inputs.tones, name) for name in ("period_jitter", "phase_leak")}
            tones |= {"phase_increment": each(inputs.phase_increment.T, 1)}
        rows = {"head_output": (w,), "out_output": (o,), "gates": (GATES * h,), "candidate_preactivation": (h,)}
        outputs = {**rows, "innovation": (), "residual": ()}
        self._run = structure_of(
            RolloutBatch,
            **{"n": n, "s": s, "p": p, "n_inputs": m, "n_hidden": h, "head_width": w, "n_components": k, "n_out": o},
            gain_before_filter=inputs.gain_before_filter,
            with_phase=bool(tones),
            innovation_limit=inputs.innovation_limit,
            leak=LEAK,
            **{"from_input": from_input, "input_bias": input_bias},
            **{"from_hidden": from_hidden, "hidden_bias": hidden_bias},
            **{"head": head, "head_bias": zero_padded(b_1, w)},
            **{"out": zero_padded(w_2, o, w), "out_bias": zero_padded(b_2, o)},
            **{"reflections": reflections, "cosines": cosines, "level": level},
            logs=each(inputs.logs.transpose(1, 0, 2), 1),
            **{"chosen": chosen, "normal": normal, "network": network, "phase": phase, **tones},
            max_jitter_drive=MAX_JITTER_DRIVE,
            states=zero_padded(each(state.states).T, p + 1, s),
            **{name: np.empty((n, s, *row), np.float32) for name, row in outputs.items()},
        )
        run_in_c("foten_train_rollout", byref(self._run))
        self.innovation: Floats = self._run.arrays["innovation"]
        self._out: Floats = self._run.arrays["out_output"][..., : 3 * k]
        self.residual: Floats = (self._run.arrays["residual"] * self._scale).T
        self.phase = phase.T

    def gradients(self, grad_residual: Floats, max_adjoint: float = MAX_ADJOINT) -> dict[str, Floats]:
        """The gradient of a loss by each of the weights, from that by the residual (s, n); callable once."""
        assert self._run is not None
        run, self._run = self._run, None
        arrays = run.arrays
        n, s, h = arrays["candidate_preactivation"].shape
        by_residual = np.ascontiguousarray(grad_residual.T * self._scale, dtype=np.float32)
        back = structure_of(
            RolloutGradients,
            by_residual=by_residual,
            drawn=zero_padded(self._draw_derivatives(), *arrays["out_output"].shape),
            adjoint_limit=max_adjoint * float(np.sqrt(np.square(by_residual).mean())),
            by_head=np.empty_like(arrays["head_output"]),
            by_out=np.empty_like(arrays["out_output"]),
        )
        run_in_c("foten_train_rollout_back", byref(run), byref(back))
        n_hidden, n_inputs, width, n_out = self._sizes
        network = arrays["network"].reshape((n + 1) * s, -1)
        before, gates, candidate = network[:-s], arrays["gates"], arrays["candidate_preactivation"]
        grad_head, grad_out = (back.arrays[name].reshape(n * s, -1) for name in ("by_head", "by_out"))
        grad_both = (grad_head.T @ before)[:width]
        gradients = (
            *recurrent_gradients(gates, candidate, network[s:, h:], before[:, :h], n_hidden, n_inputs),
            np.concatenate([grad_both[:, :n_hidden], grad_both[:, h : h + n_inputs]], axis=1),
            grad_head.sum(axis=0)[:width],
            (grad_out.T @ arrays["head_output"].reshape(n * s, -1))[:n_out, :width],
            grad_out.sum(axis=0)[:n_out],
        )
        return {name: np.ascontiguousarray(part) for name, part in zip(WEIGHT_NAMES, gradients, strict=True)}

    def _draw_derivatives(self) -> Floats:
        """∂e/∂(outputs of the network) of every draw, (n, s, 3k)."""
        logit, mean, raw = np.split(self._out, 3, axis=2)
        weight = np.exp(logit - logit.max(axis=2, keepdims=True))
        weight /= weight.sum(axis=2, keepdims=True)
        squashed = np.tanh(raw / LOG_SCALE_LIMIT)
        scale = np.exp(LOG_SCALE_LIMIT * squashed)
        z = (self.innovation[..., None] - mean) / scale
        dense = weight / scale * np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi).astype(np.float32)
        density = dense.sum(axis=2, keepdims=True) + _MIN_DENSITY
        share = dense / density
        # By Σ w Φ(±z), of whichever tail is the smaller: 1 less a small number has few digits.
        sign = np.where(self.innovation[..., None] > 0, -1.0, 1.0).astype(np.float32)
        below = ndtr(sign * z)
        share_below = sign * weight * (below - (weight * below).sum(axis=2, keepdims=True))
        return np.concatenate([-share_below / density, share, share * z * scale * (1 - squashed * squashed)], axis=2)
