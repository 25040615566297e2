"""The innovation network: how the next innovation is distributed, from those before it, the samples and the hand.

A gated recurrent unit takes in what each sample was; a head gives a mixture of Gaussians for the next innovation:

    u = (asinh e, asinh 3|e| − 1, x/2, log v/v̄, log f/f̄ [, cos φ, sin φ, cos 2φ, sin 2φ])      h ← GRU(u, h)
    (log w, μ, log s) = W₂ tanh(W₁ [h, u] + b₁) + b₂           p(e) = Σ w_k N(e; μ_k, s_k),  log s = L tanh(· / L)

φ, where there are tones, is the phase of the sample to come. The mean is what of the next innovation can be predicted, the rest
is chance. In a rendering the innovation is the mixture's quantile at Φ(z), z one Gaussian number: it moves smoothly with the
weights, the state and the number.

Source: ours; the unit is that of Cho et al., "Learning phrase representations using RNN encoder–decoder" (2014), with the reset
gate after the product.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.models.foten_plus.sizes import LOG_SCALE_LIMIT
from foten.models.weights import Weights

_erfc = np.vectorize(math.erfc, otypes=[float])
MAX_NEWTON_STEPS = 60  # of Newton's method, which takes about six
NEWTON_PRECISION = 1e-14


@dataclass(frozen=True)
class Mixture:
    """Mixtures of k Gaussians, one for each of s streams: all (s, k)."""

    weight: Array
    mean: Array
    scale: Array

    def expected(self) -> Array:
        """Their means, (s,)."""
        return np.asarray((self.weight * self.mean).sum(axis=1))

    def sd(self) -> Array:
        """Their standard deviations, (s,)."""
        deviation = self.mean - self.expected()[:, None]
        return np.sqrt((self.weight * (deviation**2 + self.scale**2)).sum(axis=1))

    def log_density(self, values: Array) -> Array:
        """Log p of values (s,) [nat]."""
        z = (values[:, None] - self.mean) / self.scale
        terms = np.log(self.weight) - np.log(self.scale) - 0.5 * z * z
        largest = terms.max(axis=1)
        return largest + np.log(np.exp(terms - largest[:, None]).sum(axis=1)) - 0.5 * np.log(2 * np.pi)

    def quantile(self, noise: Array) -> Array:
        """The values below which lies Φ(z), for standard normal numbers z (s,).

        Newton's method on log F, within the smallest and the largest of the components' own quantiles, from their mean; the
        upper half by the mirror image, since only small probabilities are known to many digits.
        """
        sign = np.where(noise > 0, -1.0, 1.0)
        z, mean = -np.abs(noise), sign[:, None] * self.mean
        log_p = np.log(0.5 * _erfc(-z / np.sqrt(2)))
        quantiles = mean + self.scale * z[:, None]  # of each component by itself
        low, high, x = quantiles.min(axis=1), quantiles.max(axis=1), (self.weight * quantiles).sum(axis=1)
        for _ in range(MAX_NEWTON_STEPS):
            deviation = (x[:, None] - mean) / self.scale
            below = (self.weight * 0.5 * _erfc(-deviation / np.sqrt(2))).sum(axis=1)
            density = (self.weight * np.exp(-0.5 * deviation * deviation) / self.scale).sum(axis=1) / np.sqrt(2 * np.pi)
            with np.errstate(all="ignore"):
                error = np.log(below) - log_p
                low, high = np.where(error < 0, x, low), np.where(error < 0, high, x)
                step = x - error * below / density
            step = np.where((step >= low) & (step <= high), step, 0.5 * (low + high))
            converged, x = np.abs(step - x) <= NEWTON_PRECISION * (1 + np.abs(x)), step
            if converged.all():
                break
        return sign * x


def innovation_inputs(innovation: Array, sample: Array, logs: Array) -> Array:
    """u: innovations (s,), samples over the level (s,), log speed and force re their means (s, 2) → (s, 5)."""
    size = np.arcsinh(3 * np.abs(innovation)) - 1
    return np.column_stack([np.arcsinh(innovation), size, sample / 2, logs])


def phase_inputs(phase: Array) -> Array:
    """What a network is given of the phase of the next sample [rad]: cosine and sine, and of twice it: (…,) → (…, 4)."""
    return np.stack([np.cos(phase), np.sin(phase), np.cos(2 * phase), np.sin(2 * phase)], axis=-1)


class InnovationNetwork:
    """The network of a texture's tensors."""

    def __init__(self, tensors: Mapping[str, NDArray[Any]], prefix: str) -> None:
        self._w = Weights(tensors, prefix)
        self.n_hidden = self._w["recurrent.weight_hh_l0"].shape[1]

    def push(self, hidden: Array, inputs: Array) -> Array:
        """h after inputs (s, 5 or 9): (s, h) → (s, h)."""
        from_inputs = inputs @ self._w["recurrent.weight_ih_l0"].T + self._w["recurrent.bias_ih_l0"]
        from_hidden = hidden @ self._w["recurrent.weight_hh_l0"].T + self._w["recurrent.bias_hh_l0"]
        (r, z, n), (hr, hz, candidate_preactivation) = (np.split(x, 3, axis=1) for x in (from_inputs, from_hidden))
        reset, update = (0.5 + 0.5 * np.tanh(0.5 * gate) for gate in (r + hr, z + hz))  # the logistic function
        candidate = np.tanh(n + reset * candidate_preactivation)
        return (1 - update) * candidate + update * hidden

    def mixture(self, hidden: Array, inputs: Array) -> Mixture:
        """The distributions after h (s, h) and the last inputs (s, 5 or 9)."""
        out = self._w.linear("out", np.tanh(self._w.linear("head", np.concatenate([hidden, inputs], axis=1))))
        logit, mean, log_scale = np.split(out, 3, axis=1)
        weight = np.exp(logit - logit.max(axis=1, keepdims=True))
        scale = np.exp(LOG_SCALE_LIMIT * np.tanh(log_scale / LOG_SCALE_LIMIT))
        return Mixture(weight / weight.sum(axis=1, keepdims=True), mean, scale)
