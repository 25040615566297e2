"""Closed-loop roll-outs of an innovation network, sample by sample, and their gradient.

In the closed loop of `models.foten_plus.definition` each innovation is drawn from the network's mixture, goes through the
lattice, and is taken in again. With the numbers of chance held, every sample is a smooth function of the weights, and its
derivative goes back through network, lattice and draws to all that came before. Of a draw e from a density p with distribution
function F, held at one probability, it is

    ∂e/∂θ = −(∂F/∂θ) / p(e)

A loop of 500 samples is 500 steps of small matrices, so it is written out in C, forward and backward (`training_kernel`): in
NumPy it took four times as long.

Speed, force and the phase of tones are given, the latter drawn as a rendering draws it; neither has a gradient.

Source: Figurnov, Mohamed & Mnih, "Implicit reparameterization gradients" (NeurIPS 2018), for ∂e/∂θ; the rest ours.
"""

from __future__ import annotations

from collections.abc import Mapping
from ctypes import byref
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from scipy.special import ndtr

from foten.dsp import Array
from foten.dsp.lattice import LEAK
from foten.dsp.tones import MAX_JITTER_DRIVE
from foten.models.foten_plus.definition import Tones
from foten.models.foten_plus.sizes import LOG_SCALE_LIMIT
from foten.training.training_kernel import (
    GATES,
    Floats,
    RolloutBatch,
    RolloutGradients,
    of_gates,
    of_recurrent,
    padded,
    recurrent_weights,
    run_in_c,
    structure_of,
    widened,
)

PARTS = (
    *("recurrent.weight_ih_l0", "recurrent.weight_hh_l0", "recurrent.bias_ih_l0", "recurrent.bias_hh_l0"),
    *("head.weight", "head.bias", "out.weight", "out.bias"),
)
_MIN_DENSITY = 1e-12
# Times the gradient of a sample by itself (root mean square) is the most that what came after a sample may add for one stream.
# Where the closed loop is chaotic, as rubber that squeals and blades of grass are, it grows without end on the way back: a few
# streams of 64 then say 10¹⁰ times as much as all others, and training goes astray. Of 0.3, 1, 3 and 10 the validation blocks
# were nearest with 1 or 3.
MAX_ADJOINT = 3.0


@dataclass(frozen=True)
class RolloutInputs:
    """What does not depend on the network in s roll-outs of n samples: arrays are known from sample to sample."""

    reflections: Floats  # k of each sample's lattice, (s, n, p)
    level: Floats  # ℓ of each sample, (s, n)
    logs: Floats  # log speed and log force that go with each sample, (s, n, 2)
    gain_before_filter: bool
    innovation_limit: float
    tones: Tones | None = None
    # By how much the path moves the phase up to each sample and the sample after [rad], (s, n + 1).
    phase_increment: Array | None = None


@dataclass(frozen=True)
class RolloutState:
    """Where roll-outs begin, s of them."""

    states: Floats  # of the lattice, (s, p)
    hidden: Floats  # of the network, (s, n_hidden)
    inputs: Floats  # of the network at the last sample, (s, 5 or more)
    phase: Array | None = None  # of tones at the first sample [rad], (s,)


Streams = TypeVar("Streams", bound="RolloutInputs | RolloutState")


def repeated(streams: Streams, times: int) -> Streams:
    """The same streams several times, one after another."""
    arrays = {name: value for name, value in vars(streams).items() if isinstance(value, np.ndarray)}
    several: dict[str, Any] = {name: np.tile(array, (times, *[1] * (array.ndim - 1))) for name, array in arrays.items()}
    return replace(streams, **several)


def _tones_of(inputs: RolloutInputs) -> dict[str, Any]:
    """How the phase of tones moves, by the kernel's names; nothing of a surface without any."""
    if inputs.tones is None:
        return {}
    assert inputs.phase_increment is not None
    return {
        "phase_increment": np.ascontiguousarray(inputs.phase_increment.T),
        "period_jitter": inputs.tones.period_jitter,
        "phase_leak": inputs.tones.phase_leak,
        "max_jitter_drive": MAX_JITTER_DRIVE,
    }


class Rollout:
    """s streams of n samples in the closed loop, each of which the network has drawn.

    `residual` is what the lattice plays, (s, n), in scaled acceleration; `phase` that of the tones at each sample [rad], (s, n);
    `innovation` what was drawn, (n, s).
    """

    def __init__(
        self, weights: Mapping[str, Floats], inputs: RolloutInputs, state: RolloutState, rng: np.random.Generator
    ) -> None:
        w_1, b_1, w_2, b_2 = (weights[name] for name in PARTS[4:])
        self._n_components = k = len(b_2) // 3
        s, n, p = inputs.reflections.shape
        chosen, normal = rng.random((n, s, 1), np.float32), rng.standard_normal((n, s, 1), np.float32)
        self._n_hidden, self._n_inputs, self._head_width = weights[PARTS[1]].shape[1], state.inputs.shape[1], len(b_1)
        from_input, from_hidden, input_bias, hidden_bias = recurrent_weights(
            {name.removeprefix("recurrent.").removesuffix("_l0"): weight for name, weight in weights.items()}
        )
        h, m, w, o = from_hidden.shape[1], from_input.shape[1], padded(len(b_1)), padded(3 * k)
        head = np.zeros((w, h + m), np.float32)
        head[: len(b_1), : self._n_hidden] = w_1[:, : self._n_hidden]
        head[: len(b_1), h : h + self._n_inputs] = w_1[:, self._n_hidden :]
        reflections = np.ascontiguousarray(inputs.reflections.transpose(1, 2, 0))
        level = np.ascontiguousarray(inputs.level.T)
        network = np.zeros((n + 1, s, h + m), np.float32)
        network[0, :, : self._n_hidden], network[0, :, h : h + self._n_inputs] = state.hidden, state.inputs
        phase, tones = np.zeros((n, s)), _tones_of(inputs)
        if tones:
            phase[0] = state.phase
        self._scale = np.ones_like(level) if inputs.gain_before_filter else level
        counts = {"n": n, "s": s, "p": p, "n_inputs": m, "n_hidden": h, "head_width": w, "n_components": k, "n_out": o}
        recurrent = {"from_input": from_input, "input_bias": input_bias}
        recurrent |= {"from_hidden": from_hidden, "hidden_bias": hidden_bias}
        heads = {"head": head, "head_bias": widened(b_1, w), "out": widened(w_2, o, w), "out_bias": widened(b_2, o)}
        lattice = {"reflections": reflections, "cosines": np.sqrt(1 - reflections * reflections), "level": level}
        lattice |= {
            "states": widened(state.states.T, p + 1, s),
            "leak": LEAK,
            "innovation_limit": inputs.innovation_limit,
        }
        logs = {"logs": np.ascontiguousarray(inputs.logs.transpose(1, 0, 2))}
        outputs = {
            "head_output": (w,),
            "out_output": (o,),
            "gates": (GATES * h,),
            "candidate_preactivation": (h,),
            "innovation": (),
            "residual": (),
        }
        self._run = structure_of(
            RolloutBatch,
            gain_before_filter=inputs.gain_before_filter,
            with_phase=bool(tones),
            phase=phase,
            network=network,
            chosen=chosen,
            normal=normal,
            **(counts | recurrent | heads | lattice | logs | tones),
            **{name: np.empty((n, s, *row), np.float32) for name, row in outputs.items()},
        )
        run_in_c("foten_train_rollout", byref(self._run))
        self.innovation: Floats = self._run.arrays["innovation"]
        self._out: Floats = self._run.arrays["out_output"][..., : 3 * k]
        self.residual: Floats = (self._run.arrays["residual"] * self._scale).T
        self.phase = phase.T

    def gradients(self, of_residual: Floats, max_adjoint: float = MAX_ADJOINT) -> dict[str, Floats]:
        """The gradient of a loss by each of the weights, from that by the residual (s, n); `max_adjoint` is as above.

        Once, since what a step made is overwritten on the way back.
        """
        assert self._run is not None
        run, self._run = self._run, None
        arrays = run.arrays
        n, s, h = arrays["candidate_preactivation"].shape
        by_residual = np.ascontiguousarray(of_residual.T * self._scale, dtype=np.float32)
        adjoint_limit = max_adjoint * float(np.sqrt(np.square(by_residual).mean()))
        back = structure_of(
            RolloutGradients,
            by_residual=by_residual,
            drawn=widened(self._of_draws(), *arrays["out_output"].shape),
            adjoint_limit=adjoint_limit,
            by_head=np.empty_like(arrays["head_output"]),
            by_out=np.empty_like(arrays["out_output"]),
        )
        run_in_c("foten_train_rollout_back", byref(run), byref(back))
        network = arrays["network"].reshape((n + 1) * s, -1)
        before = network[:-s]
        recurrent = of_recurrent(arrays["gates"], arrays["candidate_preactivation"], network[s:, h:], before[:, :h])
        of_head, of_out = (back.arrays[name].reshape(n * s, -1) for name in ("by_head", "by_out"))
        n_hidden, n_inputs, width, n_out = self._n_hidden, self._n_inputs, self._head_width, 3 * self._n_components
        by_both = (of_head.T @ before)[:width]
        sums = (
            of_gates(recurrent[0], n_hidden)[:, :n_inputs],
            of_gates(recurrent[1], n_hidden)[:, :n_hidden],
            *(of_gates(bias, n_hidden) for bias in recurrent[2:]),
            np.concatenate([by_both[:, :n_hidden], by_both[:, h : h + n_inputs]], axis=1),
            of_head.sum(axis=0)[:width],
            (of_out.T @ arrays["head_output"].reshape(n * s, -1))[:n_out, :width],
            of_out.sum(axis=0)[:n_out],
        )
        return {name: np.ascontiguousarray(gradient) for name, gradient in zip(PARTS, sums, strict=True)}

    def _of_draws(self) -> Floats:
        """∂e/∂(what the network says) of every draw, (n, s, 3k)."""
        logit, mean, raw = np.split(self._out, 3, axis=2)
        weight = np.exp(logit - logit.max(axis=2, keepdims=True))
        weight /= weight.sum(axis=2, keepdims=True)
        bent = np.tanh(raw / LOG_SCALE_LIMIT)
        scale = np.exp(LOG_SCALE_LIMIT * bent)
        z = (self.innovation[..., None] - mean) / scale
        dense = weight / scale * np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi).astype(np.float32)
        density = dense.sum(axis=2, keepdims=True) + _MIN_DENSITY
        share = dense / density
        # From the nearer end, for what is left of 1 far out is no number: Σ w Φ(±z).
        side = np.where(self.innovation[..., None] > 0, -1.0, 1.0).astype(np.float32)
        below = ndtr(side * z)
        share_below = side * weight * (below - (weight * below).sum(axis=2, keepdims=True))
        return np.concatenate([-share_below / density, share, share * z * scale * (1 - bent * bent)], axis=2)
