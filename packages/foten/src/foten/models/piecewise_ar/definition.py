"""Piecewise AR: local linear models over speed and force, mixed by line spectral frequencies and power, run as a lattice.

The three models around a condition are mixed by barycentric weights, and a normalised lattice (`dsp.lattice`) is stable while
they change. At the condition of a model it is the very filter, gain (1 + b₁z⁻¹ + …) / A. No sample exceeds D N / √(1 − leak²),
with D the largest gain of a model before the lattice, and N the largest noise times 1 + Σ|b_k|.

Source: Culbertson, Unwin and Kuchenbecker, IEEE Trans. Haptics 7 (2014), [12] of the paper, by its abstract and public files.
Differs from it: a lattice, not a direct form; power is mixed, not the variance of innovations, which is louder half-way.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.ar import polynomial_of
from foten.dsp.lattice import predict, push, reflections_of
from foten.dsp.speed_force_table import Mesh
from foten.models.piecewise_ar.sizes import PiecewiseArSizes
from foten.models.stream import Prediction, Weights

MAX_INNOVATION = 100.0  # standard deviations, of those inferred from a recorded window
SETTLING_SAMPLES = 256  # samples that a stream begins with, where there are zeros


class PiecewiseAr:
    """The model of a texture's tensors."""

    def __init__(self, sizes: PiecewiseArSizes, tensors: Mapping[str, NDArray[Any]]) -> None:
        w = Weights(tensors, "piecewise_ar.")
        self.sizes = sizes
        self._mean, self._sd = w["mean"], w["sd"]
        self._mesh = Mesh(w["points"], w["triangles"].astype(np.int64), w["scale"])
        zeros = w["ma_lsf"] if sizes.ma else np.empty((sizes.n_models, 0))
        gain = w["gain"] if sizes.ma else np.ones(sizes.n_models)
        reflections = reflections_of(polynomial_of(w["lsf"]))
        before = np.sqrt(w["variance"]) * gain / np.sqrt(1 - reflections * reflections).prod(axis=1)
        self._table = np.concatenate([w["lsf"], zeros, before[:, None] ** 2], axis=1)

    def mixed(self, condition: Array) -> tuple[Array, Array, Array]:
        """Under (b, 2) scaled: reflection coefficients (p, b), b₁ … b_q (q, b), scaled gain before the lattice (b,)."""
        physical = np.maximum(condition * self._sd + self._mean, 0.0)
        chosen, weights = self._mesh.at(*physical.T)
        mixed = (self._table[chosen] * weights[:, :, None]).sum(axis=1)
        p, q = self.sizes.order, self.sizes.ma
        zeros = polynomial_of(mixed[:, p : p + q])[:, 1:].T
        return reflections_of(polynomial_of(mixed[:, :p])).T, zeros, np.sqrt(mixed[:, -1])

    def start(self, windows: Array) -> PiecewiseArStream:
        """Streams that go on from scaled windows (s, m, 3); innovations are inferred once p samples are known."""
        stream = PiecewiseArStream(self, windows[:, 0, 1:])
        for n in range(1, windows.shape[1]):
            stream.infer(windows[:, n, 0], windows[:, n, 1:], known=n > self.sizes.order)
        return stream

    def predict(self, windows: Array) -> Array:
        return self.start(windows).predict().sample


class PiecewiseArStream:
    """Streams of local models, after a sample under a condition (s, 2)."""

    bounded: ClassVar[bool] = True

    def __init__(self, model: PiecewiseAr, condition: Array) -> None:
        self._model, s = model, len(condition)
        self.states = np.zeros((model.sizes.order, s))  # b₀ … b_{p−1} of the lattice
        self._past = np.zeros((model.sizes.ma, s))  # the last innovations, the youngest first, of unit variance
        self._set_condition(condition)

    def _set_condition(self, condition: Array) -> None:
        self.reflections, self._zeros, self._gain = self._model.mixed(condition[:, :2])

    @property
    def n_initial(self) -> int:
        """A number for each state and, with zeros, for each past innovation and each sample until it has settled."""
        q = len(self._past)
        return len(self.states) + (q + SETTLING_SAMPLES if q else 0)

    def begin(self, condition: Array, noise: Array, fade: float = 1.0) -> None:
        """Draw states and innovations; with zeros, which colour what enters the lattice, run until it has settled."""
        p, q = len(self.states), len(self._past)
        self._set_condition(condition)
        self.states = self._gain * np.sqrt(1 + np.square(self._zeros).sum(axis=0)) * noise[:, :p].T
        self._past = noise[:, p : p + q].T.copy()
        for z in noise[:, p + q :].T:
            self.push(self.predict().excited(z), condition, z)

    def leave(self, sample: Array) -> Array:
        return sample

    def predict(self) -> Prediction:
        sample, cosines = predict(self.states, self.reflections)
        scale = self._gain * cosines
        return Prediction(sample + scale * (self._zeros * self._past).sum(axis=0), scale)

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        self._take_in(sample, condition, 0 * sample if noise is None else noise)

    def infer(self, sample: Array, condition: Array, known: bool) -> None:
        """Take in recorded samples (s,) and their innovations, where all samples before are known."""
        expected = self.predict()
        assert expected.scale is not None
        residual = known * (sample - expected.sample)
        innovation = np.divide(residual, expected.scale, out=np.zeros_like(residual), where=expected.scale > 0)
        self._take_in(sample, condition, np.clip(innovation, -MAX_INNOVATION, MAX_INNOVATION))

    def _take_in(self, sample: Array, condition: Array, innovation: Array) -> None:
        self.states, _ = push(self.states, self.reflections, sample)
        self._past = np.concatenate([innovation[None], self._past])[: len(self._past)]
        self._set_condition(condition)
