"""A network's own output, sample by sample, and its gradient: what likelihood, which sees recorded samples alone, does not train.

In the closed loop of `reference.foten_plus` each innovation is drawn from the mixture that the network says, goes through the
lattice, and is taken in again. With the numbers of chance held, every sample is a smooth function of the weights, and its
derivative goes back through network, lattice and draws to all that came before. Of a draw e from a density p with distribution
function F, held at one probability, it is

    ∂e/∂θ = −(∂F/∂θ) / p(e)

A loop of 500 samples is 500 steps of small matrices, so it is written out, forward and backward: recorded by PyTorch one
operation at a time, it takes five times as long.

Speed, force and the phase of tones are given, the latter drawn as a rendering draws it; neither has a gradient.

Source: Figurnov, Mohamed & Mnih, "Implicit reparameterization gradients" (NeurIPS 2018), for ∂e/∂θ; the rest ours.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from foten.dsp import Array
from foten.dsp.lattice import LEAK
from foten.dsp.tones import LARGEST_JITTER
from foten.families.foten_plus import LOG_SCALE_LIMIT
from foten.reference.foten_plus import Tones
from foten.reference.innovation import phase_inputs

Floats = NDArray[np.float32]
PARTS = (
    *("recurrent.weight_ih_l0", "recurrent.weight_hh_l0", "recurrent.bias_ih_l0", "recurrent.bias_hh_l0"),
    *("head.weight", "head.bias", "out.weight", "out.bias"),
)
_LEAST_DENSITY = 1e-12
# Times the gradient of a sample by itself (root mean square) is the most that what came after a sample may add for one stream.
# Where the closed loop is chaotic, as rubber that squeals and blades of grass are, it grows without end on the way back: a few
# streams of 64 then say 10¹⁰ times as much as all others, and training goes astray. Of 0.3, 1, 3 and 10 the validation blocks
# were nearest with 1 or 3.
LARGEST_ADJOINT = 3.0


@dataclass(frozen=True)
class Surroundings:
    """What does not depend on the network in s roll-outs of n samples: all but the last three known from sample to sample."""

    reflections: Floats  # k of each sample's lattice, (s, n, p)
    level: Floats  # ℓ of each sample, (s, n)
    logs: Floats  # log speed and log force that go with each sample, (s, n, 2)
    gain_before_filter: bool
    largest: float  # innovation
    tones: Tones | None = None
    turned: Array | None = (
        None  # by how much the path moves the phase up to each sample and the one after [rad], (s, n + 1)
    )


@dataclass(frozen=True)
class Beginning:
    """Where roll-outs begin, s of them."""

    states: Floats  # of the lattice, (s, p)
    hidden: Floats  # of the network, (s, n_hidden)
    inputs: Floats  # of the network at the last sample, (s, 5 or more)
    phase: Array | None = None  # of tones at the first sample [rad], (s,)


class RollOut:
    """s streams of n samples in the closed loop, each of which the network has drawn.

    `residual` is what the lattice plays, (s, n), in scaled acceleration; `phase` that of the tones at each sample [rad], (s, n).
    """

    def __init__(
        self, weights: Mapping[str, Floats], around: Surroundings, begin: Beginning, rng: np.random.Generator
    ) -> None:
        self._w, self._around = weights, around
        w_ih, w_hh, b_ih, b_hh, w_1, b_1, w_2, b_2 = (weights[name] for name in PARTS)
        h, k = w_hh.shape[1], len(b_2) // 3
        s, n, p = around.reflections.shape
        chosen, normal = rng.random((n, s, 1), np.float32), rng.standard_normal((n, s, 1), np.float32)
        self._prepare()
        # What a step was given, and what it made of it, for the way back; the last are those after the last sample.
        self._hidden, self._inputs = (
            np.empty((n + 1, s, h), np.float32),
            np.empty((n + 1, s, w_ih.shape[1]), np.float32),
        )
        self._head, self._out = np.empty((n, s, len(b_1)), np.float32), np.empty((n, s, 3 * k), np.float32)
        self._gates, self._given = np.empty((n, s, 3 * h), np.float32), np.empty((n, s, h), np.float32)
        self.innovation, played = np.empty((n, s), np.float32), np.empty((n, s), np.float32)
        self.phase = np.zeros((n, s))
        states, self._hidden[0], self._inputs[0] = begin.states, begin.hidden, begin.inputs
        phase = path = begin.phase
        rate = np.zeros(s)
        both = np.concatenate([w_1[:, :h].T, w_1[:, h:].T])
        for i in range(n):
            hidden, inputs = self._hidden[i], self._inputs[i]
            head = self._head[i] = np.tanh(np.concatenate([hidden, inputs], axis=1) @ both + b_1)
            out = self._out[i] = head @ w_2.T + b_2
            share = np.exp(out[:, :k] - out[:, :k].max(axis=1, keepdims=True)).cumsum(axis=1)
            component = (chosen[i] * share[:, -1:] >= share[:, :-1]).sum(axis=1)[:, None]
            mean = np.take_along_axis(out[:, k : 2 * k], component, axis=1)
            log_scale = LOG_SCALE_LIMIT * np.tanh(
                np.take_along_axis(out[:, 2 * k :], component, axis=1) / LOG_SCALE_LIMIT
            )
            e = (mean + np.exp(log_scale) * normal[i])[:, 0].clip(-around.largest, around.largest)
            # The lattice: `dsp.lattice.predict` and `push`, both of sums over its sections.
            weighed = self._weighed[i] * states
            sums = weighed.cumsum(axis=1)
            y = self._gain[i] * e - sums[:, -1]
            after = np.empty_like(states)
            after[:, 0] = y
            after[:, 1:] = self._kept[i] * states[:, :-1]
            after[:, 1:2] += self._turned[i][:, :1] * y[:, None]
            after[:, 2:] += self._turned[i][:, 1:] * ((y[:, None] + sums[:, : p - 2]) * self._rise[i])
            states = after
            self.innovation[i], played[i] = e, y
            given = self._inputs[i + 1]
            given[:, 0], given[:, 1] = np.arcsinh(e), np.arcsinh(3 * np.abs(e)) - 1
            given[:, 2] = y / self._over[i]
            given[:, 3:5] = around.logs[:, i]
            if around.tones is not None:
                assert around.turned is not None
                assert phase is not None
                assert path is not None
                self.phase[i] = phase
                moved, kept = around.turned[:, i], np.exp(-around.turned[:, i] / np.pi)
                jitter = around.tones.jitter * np.clip(e, -LARGEST_JITTER, LARGEST_JITTER)
                rate = kept * rate + np.sqrt(1 - kept * kept) * jitter
                phase = phase - around.tones.drawn_back * (phase - path) + moved * rate + around.turned[:, i + 1]
                path = path + around.turned[:, i + 1]
                given[:, 5:] = phase_inputs(phase)
            # The recurrent unit.
            of_input, of_hidden = given @ w_ih.T + b_ih, hidden @ w_hh.T + b_hh
            gates = self._gates[i]
            gates[:, : 2 * h] = 0.5 + 0.5 * np.tanh(0.5 * (of_input[:, : 2 * h] + of_hidden[:, : 2 * h]))
            self._given[i] = of_hidden[:, 2 * h :]
            new = gates[:, 2 * h :] = np.tanh(of_input[:, 2 * h :] + gates[:, :h] * of_hidden[:, 2 * h :])
            self._hidden[i + 1] = new + gates[:, h : 2 * h] * (hidden - new)
        self.residual = (played * self._scale).T
        self.phase = self.phase.T

    def _prepare(self) -> None:
        """Lay out what multiplies what in the lattice, sample by sample, (n, s, …)."""
        around = self._around
        k = around.reflections.transpose(1, 0, 2)
        cosines = np.sqrt(1 - k * k)
        gains = cosines.cumprod(axis=2)
        level = around.level.T
        before = np.concatenate([np.ones_like(gains[..., :1]), gains[..., :-1]], axis=2)
        self._weighed = LEAK * k * before
        self._kept, self._turned = LEAK / cosines[..., :-1], k[..., :-1] / cosines[..., :-1]
        self._rise = 1 / gains[..., : k.shape[2] - 2]
        self._gain = gains[..., -1] * level if around.gain_before_filter else gains[..., -1]
        self._scale = np.ones_like(level) if around.gain_before_filter else level
        self._over = 2 * level if around.gain_before_filter else np.full_like(level, 2.0)

    def gradients(self, of_residual: Floats, largest: float = LARGEST_ADJOINT) -> dict[str, Floats]:
        """Return the gradient of a loss by each of the weights, from that by the residual (s, n); `largest` is as above."""
        w_ih, w_hh, _, _, w_1, _, w_2, _ = (self._w[name] for name in PARTS)
        n, s, h = self._given.shape
        of_played = of_residual.T * self._scale
        most = np.float32(largest * np.sqrt(np.square(of_played).mean()))
        drawn = self._of_draws()
        e, inside = self.innovation, np.abs(self.innovation) < self._around.largest
        of_first, of_second = 1 / np.sqrt(1 + e * e), 3 * np.sign(e) / np.sqrt(1 + 9 * e * e)
        by_given, by_kept = np.empty_like(self._gates), np.empty_like(self._gates)
        by_head, by_out = np.empty_like(self._head), np.empty_like(self._out)
        d_hidden, d_states = np.zeros((s, h), np.float32), np.zeros_like(self._weighed[0])
        d_inputs = np.zeros((s, w_ih.shape[1]), np.float32)
        p = d_states.shape[1]
        for i in range(n - 1, -1, -1):
            # The recurrent unit, whose inputs the head of the next step had as well.
            reset, update, new = np.split(self._gates[i], 3, axis=1)
            d_new = d_hidden * (1 - update) * (1 - new * new)
            d_update = d_hidden * (self._hidden[i] - new) * update * (1 - update)
            d_reset = d_new * self._given[i] * reset * (1 - reset)
            given, kept = by_given[i], by_kept[i]
            given[:, :h] = kept[:, :h] = d_reset
            given[:, h : 2 * h] = kept[:, h : 2 * h] = d_update
            given[:, 2 * h :], kept[:, 2 * h :] = d_new, d_new * reset
            d_inputs = d_inputs + given @ w_ih
            d_hidden = d_hidden * update + kept @ w_hh
            # The lattice.
            d_y = of_played[i] + d_inputs[:, 2] / self._over[i] + d_states[:, 0]
            d_f = self._turned[i] * d_states[:, 1:]
            d_y += d_f[:, :1].sum(axis=1)
            before = np.zeros_like(d_states)
            before[:, :-1] = self._kept[i] * d_states[:, 1:]
            d_sums = d_f[:, 1:] * self._rise[i]
            d_y += d_sums.sum(axis=1)
            d_weighed = np.broadcast_to(-d_y[:, None], before.shape).copy()
            d_weighed[:, : p - 2] += d_sums[:, ::-1].cumsum(axis=1)[:, ::-1]
            d_states = before + self._weighed[i] * d_weighed
            d_e = self._gain[i] * d_y + d_inputs[:, 0] * of_first[i] + d_inputs[:, 1] * of_second[i]
            # The draw, and the head that it is of.
            out = by_out[i] = drawn[i] * (d_e * inside[i])[:, None]
            head = by_head[i] = (out @ w_2) * (1 - self._head[i] ** 2)
            of_both = head @ w_1
            d_hidden, d_inputs = d_hidden + of_both[:, :h], of_both[:, h:]
            size = np.sqrt(np.square(d_hidden).sum(axis=1) + np.square(d_states).sum(axis=1))[:, None]
            held = np.minimum(1, most / np.maximum(size, np.finfo(np.float32).tiny))
            d_hidden, d_states, d_inputs = d_hidden * held, d_states * held, d_inputs * held
        of_given, of_kept, of_head, of_out = (one.reshape(n * s, -1) for one in (by_given, by_kept, by_head, by_out))
        hidden, inputs = self._hidden.reshape((n + 1) * s, -1), self._inputs.reshape((n + 1) * s, -1)
        sums = (
            of_given.T @ inputs[s:],
            of_kept.T @ hidden[:-s],
            of_given.sum(axis=0),
            of_kept.sum(axis=0),
            of_head.T @ np.concatenate([hidden[:-s], inputs[:-s]], axis=1),
            of_head.sum(axis=0),
            of_out.T @ self._head.reshape(n * s, -1),
            of_out.sum(axis=0),
        )
        return dict(zip(PARTS, sums, strict=True))

    def _of_draws(self) -> Floats:
        """Return ∂e/∂(what the network says) of every draw, (n, s, 3k)."""
        logit, mean, raw = np.split(self._out, 3, axis=2)
        weight = np.exp(logit - logit.max(axis=2, keepdims=True))
        weight /= weight.sum(axis=2, keepdims=True)
        bent = np.tanh(raw / LOG_SCALE_LIMIT)
        scale = np.exp(LOG_SCALE_LIMIT * bent)
        z = (self.innovation[..., None] - mean) / scale
        dense = weight / scale * np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi).astype(np.float32)
        density = dense.sum(axis=2, keepdims=True) + _LEAST_DENSITY
        share = dense / density
        # From the nearer end, for what is left of 1 far out is no number: Σ w Φ(±z).
        side = np.where(self.innovation[..., None] > 0, -1.0, 1.0).astype(np.float32)
        below = ndtr(side * z)
        missed = side * weight * (below - (weight * below).sum(axis=2, keepdims=True))
        return np.concatenate([-missed / density, share, share * z * scale * (1 - bent * bent)], axis=2)
