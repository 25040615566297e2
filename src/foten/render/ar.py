"""Piecewise AR in NumPy: local linear models over speed and force, in a lattice."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from foten.architecture import ArArchitecture
from foten.dsp.lattice import forecast, push, reflections_of
from foten.dsp.lsf import polynomial_of
from foten.dsp.mesh import Mesh
from foten.render.forecast import Forecast

Array = NDArray[np.float64]

FURTHEST = np.array([1e5, 1e4])  # mm/s and N that a model may stand at
LOUDEST = 1e4  # standard deviations, of what drives a model
LARGEST_INNOVATION = 100.0  # standard deviations, of those found in a recorded window
_QUIETEST = 1e-9  # scaled; what is told to vary by nothing at all has no likelihood
SETTLED_AFTER = 256  # samples that are played to begin with, where there are zeros


@dataclass
class ArState:
    """Streams of local models.

    Attributes:
        states: b₀ … b_{p−1} of the lattice, shape (p, s).
        past: the last q innovations, the youngest first, of unit variance, shape (q, s).
        condition: speed and force of the last sample, scaled, shape (s, 2).
        reflections, zeros, drive: as `NumpyAr.mixed` says, for the sample to come.
    """

    engine: NumpyAr
    states: Array
    past: Array
    condition: Array
    reflections: Array = field(init=False)
    zeros: Array = field(init=False)
    drive: Array = field(init=False)
    bounded: ClassVar[bool] = True

    def __post_init__(self) -> None:
        self.reflections, self.zeros, self.drive = self.engine.mixed(self.condition)

    def _heed(self, condition: Array) -> None:
        if np.array_equal(condition, self.condition):
            return
        self.condition = condition
        self.reflections, self.zeros, self.drive = self.engine.mixed(condition)

    @property
    def n_to_begin(self) -> int:
        """Return one number for each state and, with zeros, for each innovation before and each sample that is played."""
        q = len(self.past)
        return len(self.states) + (q + SETTLED_AFTER if q else 0)

    def begin(self, condition: Array, noise: Array) -> None:
        """Draw the states and the innovations; with zeros, which colour what drives the lattice, play until it has settled."""
        p, q = self.states.shape[0], self.past.shape[0]
        hand = condition[:, :2]
        self._heed(hand)
        self.states = self.drive * np.sqrt(1 + np.square(self.zeros).sum(axis=0)) * noise[:, :p].T
        self.past = noise[:, p : p + q].T.copy()
        for z in noise[:, p + q :].T:
            self.push(self.forecast().excited(z), hand, z)

    def forecast(self) -> Forecast:
        """Return what lattice and past innovations foretell."""
        sample, gain = forecast(self.states, self.reflections)
        return Forecast(sample + self.drive * gain * (self.zeros * self.past).sum(axis=0), self.drive * gain)

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        """Take in the samples that followed the last forecast; their innovations are those of the noise."""
        self.states, _ = push(self.states, self.reflections, sample)
        self._remember(0 * sample if noise is None else noise)
        self._heed(condition[:, :2])

    def hear(self, sample: Array, condition: Array, complete: bool) -> None:
        """Take in recorded samples, whose innovations have to be found, once all p samples before are known."""
        expected = self.forecast()
        assert expected.scale is not None
        missed = complete * (sample - expected.sample)
        innovation = np.divide(missed, expected.scale, out=np.zeros_like(missed), where=expected.scale > 0)
        self.states, _ = push(self.states, self.reflections, sample)
        self._remember(np.clip(innovation, -LARGEST_INNOVATION, LARGEST_INNOVATION))
        self._heed(condition)

    def _remember(self, innovation: Array) -> None:
        if len(self.past):
            self.past = np.concatenate([innovation[None], self.past[:-1]])


class NumpyAr:
    """Local models mixed by line spectral frequencies and by power, and run as a lattice that cannot run away.

    Between the three models around a hand their line spectral frequencies are mixed by barycentric weights; that is a stable
    filter, but stable filters in turn need not be. So it is run as a normalised lattice, in which they are (`dsp.lattice`);
    under the hand of a model it is the very filter, gain (1 + b₁z⁻¹ + …) / A. What drives a normalised lattice is as loud as
    what leaves it, whatever its colour: its power is what is mixed. No sample exceeds D N / √(1 − leak²), where D is the
    largest drive of a model, and N the largest noise times 1 + Σ|b_k|.

    Source: Culbertson, Unwin and Kuchenbecker, IEEE Trans. Haptics 7 (2014), [12] of the paper, as far as its abstract and
    the public texture files tell: our re-implementation. Differs from it: the lattice, where a direct form keeps its samples;
    and power, where the variance of innovations is mixed there: half-way from a loud noise to a soft tone that is louder than
    both, by 18 dB from a recording in which a sensor dropped out.
    """

    def __init__(self, architecture: ArArchitecture, tensors: Mapping[str, NDArray[Any]]) -> None:
        self.window = architecture.window
        self._p, self._q = architecture.order, architecture.ma
        values = {
            name.removeprefix("local."): np.asarray(tensor, dtype=np.float64)
            for name, tensor in tensors.items()
            if name.startswith("local.")
        }
        n = architecture.n_models
        self._mean, self._sd = values["mean"], values["sd"]
        triangles = values["triangles"]
        if not (triangles == np.round(triangles)).all():
            raise ValueError("a triangle of the mesh has a corner that no model is at: it is no whole number")
        scale, points = values["scale"], values["points"]
        sizes = np.stack([scale, self._sd, *points, np.abs(self._mean)])
        if not (sizes <= FURTHEST).all() or not (sizes >= 0).all() or not (sizes[:2] > 0).all():
            raise ValueError(
                "the local models stand at speeds or forces, or are scaled by some, that are of no hand"
            )
        self._mesh = Mesh(points, triangles.astype(np.int64), scale)
        gain, zeros = values.get("gain", np.ones(n)), values.get("ma_lsf", np.empty((n, 0)))
        for name, angles in (("lsf", values["lsf"]), ("ma_lsf", zeros)):
            edged = np.pad(angles, ((0, 0), (1, 1)), constant_values=((0, 0), (0.0, np.pi)))
            if angles.shape[1] and not (np.diff(edged, axis=1) > 0).all():
                raise ValueError(
                    f"tensor 'local.{name}' does not rise from 0 to π: the filter would not be stable"
                )
        if not (values["variance"] >= 0).all() or not (gain >= 0).all():
            raise ValueError("a local model has a negative variance or gain")
        reflections = reflections_of(polynomial_of(values["lsf"]))
        drive = np.sqrt(values["variance"]) * gain / np.sqrt(1 - reflections * reflections).prod(axis=1)
        if not (drive <= LOUDEST).all():
            raise ValueError(f"a local model is louder than {LOUDEST:g} standard deviations")
        self._table = np.concatenate([values["lsf"], zeros, drive[:, None] ** 2], axis=1)

    def mixed(self, condition: Array) -> tuple[Array, Array, Array]:
        """Return the model under a speed and force, scaled (b, 2).

        Returns:
            Reflections (p, b); b₁ … b_q (q, b); the standard deviation of what drives the lattice, scaled, (b,).
        """
        hand = np.maximum(condition * self._sd + self._mean, 0.0)
        chosen, weights = self._mesh.at(*hand.T)
        found = (self._table[chosen] * weights[:, :, None]).sum(axis=1)
        p, q = self._p, self._q
        reflections = reflections_of(polynomial_of(found[:, :p])).T
        zeros = polynomial_of(found[:, p : p + q])[:, 1:].T
        return reflections, zeros, np.sqrt(found[:, -1])

    def start(self, windows: Array) -> ArState:
        """Return the state of streams that have heard the given scaled windows, shape (s, m, 3)."""
        s = len(windows)
        state = ArState(self, np.zeros((self._p, s)), np.zeros((self._q, s)), windows[:, 0, 1:])
        for n in range(1, windows.shape[1]):
            state.hear(windows[:, n, 0], windows[:, n, 1:], n > self._p)
        return state

    def follow(self, blocks: Array) -> Forecast:
        """Return the forecast of every sample of recorded blocks from those before it in its block, from sample `window` on.

        Args:
            blocks: scaled, shape (s, n, 3).

        Returns:
            Each of shape (s, n − window), scaled.
        """
        state = self.start(blocks[:, : self.window])
        sample, scale = (np.empty((len(blocks), blocks.shape[1] - self.window)) for _ in range(2))
        for n in range(self.window, blocks.shape[1]):
            found = state.forecast()
            sample[:, n - self.window], scale[:, n - self.window] = found.sample, found.scale
            state.hear(blocks[:, n, 0], blocks[:, n, 1:], complete=True)
        return Forecast(sample, np.maximum(scale, _QUIETEST), np.zeros_like(scale))

    follow_heard = follow

    def predict(self, windows: Array) -> Array:
        """Return the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        return self.start(windows).forecast().sample
