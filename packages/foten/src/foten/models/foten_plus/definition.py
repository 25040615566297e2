"""foten-plus as `models.foten_plus.sizes` describes it: lattice, tones, excitation, and the network of a prediction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.equaliser import Equaliser, EqualiserStream
from foten.dsp.lattice import check_reflections, predict, push
from foten.dsp.speed_force_table import SpeedForceTable
from foten.dsp.tones import MAX_JITTER_DRIVE, anti_alias_gain, fitted_phase, tone
from foten.models.excitation import Excitation, Scale
from foten.models.foten_plus.recorded_innovations import Playback, RecordedInnovations
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.stream import Prediction, Weights


def innovation_inputs(innovation: Array, sample: Array, logs: Array) -> Array:
    """u: innovations (s,), samples over the level (s,), log speed and force re their means (s, 2) → (s, 5)."""
    size = np.arcsinh(3 * np.abs(innovation)) - 1
    return np.column_stack([np.arcsinh(innovation), size, sample / 2, logs])


class NetworkDefinition:
    """The innovation network of a texture's tensors.

    A gated recurrent unit takes in what each sample was; a head gives a mixture of Gaussians for the next innovation:

        u = (asinh e, asinh 3|e| − 1, x/2, log v/v̄, log f/f̄)      h ← GRU(u, h)
        (log w, μ, log s) = W₂ tanh(W₁ [h, u] + b₁) + b₂          p(e) = Σ w_k N(e; μ_k, s_k)

    The prediction is the mean; s serves its fit by likelihood.

    Source: ours; the unit is that of Cho et al., "Learning phrase representations using RNN encoder–decoder" (2014), with the
    reset gate after the product.
    """

    def __init__(self, tensors: Mapping[str, NDArray[Any]], prefix: str) -> None:
        self._w = Weights(tensors, prefix)
        self.n_hidden = self._w["recurrent.weight_hh_l0"].shape[1]

    def push(self, hidden: Array, inputs: Array) -> Array:
        """h after inputs (s, 5): (s, h) → (s, h)."""
        from_inputs = inputs @ self._w["recurrent.weight_ih_l0"].T + self._w["recurrent.bias_ih_l0"]
        from_hidden = hidden @ self._w["recurrent.weight_hh_l0"].T + self._w["recurrent.bias_hh_l0"]
        (r, z, n), (hr, hz, candidate_preactivation) = (np.split(x, 3, axis=1) for x in (from_inputs, from_hidden))
        reset, update = (0.5 + 0.5 * np.tanh(0.5 * gate) for gate in (r + hr, z + hz))  # the logistic function
        candidate = np.tanh(n + reset * candidate_preactivation)
        return (1 - update) * candidate + update * hidden

    def expected(self, hidden: Array, inputs: Array) -> Array:
        """The expected next innovations (s,), after h (s, h) and the last inputs (s, 5)."""
        out = self._w.linear("out", np.tanh(self._w.linear("head", np.concatenate([hidden, inputs], axis=1))))
        logit, mean, _ = np.split(out, 3, axis=1)
        weight = np.exp(logit - logit.max(axis=1, keepdims=True))
        return np.asarray((weight * mean).sum(axis=1) / weight.sum(axis=1))


class Lattice:
    """A level ℓ and reflection coefficients k over speed and force."""

    def __init__(self, tensors: Mapping[str, NDArray[Any]], prefix: str, gain_before_filter: bool) -> None:
        w = Weights(tensors, prefix)
        check_reflections(w["reflections"])
        self.order, self.gain_before_filter = w["reflections"].shape[1], gain_before_filter
        self.table = SpeedForceTable(w["speed_knots"], w["force_knots"], w["reflections"])
        self.level = Scale.of(tensors, f"{prefix}level.")

    def reflections(self, condition: Array) -> Array:
        """k: speed and force (s, 2) scaled → (p, s)."""
        return self.table.at(*self.level.physical(condition).T).T

    def gains(self, level: Array) -> tuple[Array, Array]:
        """Gains of the innovation before the filter, and of the sample after it."""
        ones = np.ones_like(level)
        return (level, ones) if self.gain_before_filter else (ones, level)


def lattice_tensors(prefix: str, level: Scale, table: SpeedForceTable) -> dict[str, NDArray[np.float32]]:
    """The tensors of a `Lattice`, as a texture file has them."""
    return {**table_tensors(prefix, table, "reflections"), **level.tensors(f"{prefix}level.")}


def table_tensors(prefix: str, table: SpeedForceTable, values: str) -> dict[str, NDArray[np.float32]]:
    """Tensors of a table, whose values go by a name."""
    tensors = {"speed_knots": table.speed_knots, "force_knots": table.force_knots, values: table.values}
    return {f"{prefix}{name}": tensor.astype(np.float32) for name, tensor in tensors.items()}


class Tones:
    """T(φ; v, f) = ℓ Σ_h A_h cos hφ + B_h sin hφ, and how φ moves: `dsp.tones`."""

    def __init__(self, tensors: Mapping[str, NDArray[Any]], level: Scale) -> None:
        w = Weights(tensors, "tones.")
        self._table = SpeedForceTable(w["speed_knots"], w["force_knots"], w["values"])
        self._level = level
        self._increment, self.period_jitter, self.phase_leak = (float(value) for value in w["phase_params"])

    def phase_increment(self, condition: Array) -> Array:
        """Phase that the path adds in a sample [rad]: (…, 3) → (…)."""
        return self._increment * condition[..., 2]

    def coefficients(self, condition: Array) -> Array:
        """ℓA and ℓB in turn, as far as the rate holds their frequencies: (s, 3) → (s, 2 n_tones)."""
        values = self._table.at(*self._level.physical(condition[:, :2]).T)
        gain = anti_alias_gain(values.shape[1] // 2, self.phase_increment(condition))
        return values * self._level(condition[:, :2])[:, None] * gain


class FotenPlus:
    """The model of a texture's tensors."""

    def __init__(self, sizes: FotenPlusSizes, tensors: Mapping[str, NDArray[Any]]) -> None:
        self.sizes = sizes
        self.excitation = Excitation.of(tensors)
        self.lattice = self.excited_lattice = Lattice(tensors, "lattice.", sizes.gain_before_filter)
        self.network = NetworkDefinition(tensors, "network.")
        self.equaliser = Equaliser.of(tensors) if sizes.equalised else None
        self.recorded = RecordedInnovations.of(tensors, sizes.along_path) if sizes.recorded else None
        self.tones: Tones | None = None
        if sizes.n_tones:
            self.excited_lattice = Lattice(tensors, "residual.", sizes.residual_gain_before_filter)
            self.tones = Tones(tensors, self.lattice.level)

    def predict(self, windows: Array) -> Array:
        """Next samples by the lattice and the network: windows (b, m, 3) scaled → (b,) scaled."""
        stream, inputs = self._analysed(windows, self.lattice)
        hidden = np.zeros((len(windows), self.network.n_hidden))
        for each in inputs[-self.sizes.window :]:
            hidden = self.network.push(hidden, each)
        sample, gain = stream.linear()
        return sample + gain * self.network.expected(hidden, inputs[-1])

    def start(self, windows: Array) -> FotenPlusStream:
        """Streams that go on from scaled windows, shape (s, m, 3)."""
        stream = self._started(windows)
        stream.settle_equaliser()
        stream.begin_playback(None)
        return stream

    def _started(self, windows: Array) -> FotenPlusStream:
        if self.tones is None:
            return self._analysed(windows, self.lattice)[0]
        condition = self.with_speed(windows[:, :-1, 1:])
        flat = condition.reshape(-1, 3)
        level = self.lattice.level(flat[:, :2]).reshape(condition.shape[:2])
        coefficients = self.tones.coefficients(flat).reshape(*level.shape, -1) / level[..., None]
        travelled = np.cumsum(self.tones.phase_increment(condition), axis=1)
        phase = fitted_phase(windows[:, 1:, 0] / level, coefficients, travelled)
        residual = windows.copy()
        residual[:, 1:, 0] -= level * tone(coefficients, travelled + phase[:, None])
        stream, _ = self._analysed(residual, self.excited_lattice)
        phase = travelled[:, -1] + phase + self.tones.phase_increment(stream.condition)
        phase = np.remainder(phase + np.pi, 2 * np.pi) - np.pi  # within half a turn
        stream.begin_phase(self.tones, phase, np.zeros_like(phase))
        return stream

    def with_speed(self, condition: Array) -> Array:
        """Conditions (…, 2) scaled with the speed that they stand for [mm/s], (…, 3)."""
        return np.concatenate([condition, self.lattice.level.physical(condition)[..., :1]], axis=-1)

    def _analysed(self, windows: Array, lattice: Lattice) -> tuple[FotenPlusStream, list[Array]]:
        """Streams after windows of what a lattice is of, and u of each sample but the first, (s, 5) each."""
        conditions = self.with_speed(windows[:, :, 1:])
        stream, inputs = FotenPlusStream(self, lattice, conditions[:, 0]), []
        for i in range(1, windows.shape[1]):
            x = windows[:, i, 0] / stream.level
            e = stream.analyse(windows[:, i, 0])
            stream.set_condition(conditions[:, i])
            inputs.append(innovation_inputs(e, x, lattice.level.logarithms(conditions[:, i, :2])))
        return stream, inputs


class FotenPlusStream:
    """Streams of foten-plus: of a lattice, and of its model's tones or none."""

    bounded: ClassVar[bool] = True

    def __init__(self, model: FotenPlus, lattice: Lattice, condition: Array) -> None:
        s = len(condition)
        self.model, self.lattice = model, lattice
        self.states = np.zeros((lattice.order, s))  # b₀ … b_{p−1} of the lattice
        # Phase of the tones at the next sample [rad], the same without jitter, r of `dsp.tones`, and T; 0 without tones.
        self.phase = self.nominal_phase = self.rate = self.tone = np.zeros(s)
        self.set_condition(condition)
        self.equaliser: EqualiserStream | None = None
        self.playback: list[Playback] = []
        self.next_innovation = np.zeros(s)  # recorded, over σ

    def settle_equaliser(self) -> None:
        """Begin the equaliser, where there is one, as after a long time under the condition."""
        if self.model.equaliser is not None:
            self.equaliser = EqualiserStream(self.model.equaliser, *self._physical().T)

    def begin_playback(self, noise: Array | None) -> None:
        """Begin the recorded innovations, where there are any, from standard normal numbers (s,) or None."""
        if self.model.recorded is not None:
            self.playback = [Playback(self.model.recorded) for _ in self.condition]
            self._play(noise)

    def _play(self, noise: Array | None) -> None:
        for k, (playback, (speed, force)) in enumerate(zip(self.playback, self._physical(), strict=True)):
            self.next_innovation[k] = playback.advance(speed, force, None if noise is None else float(noise[k]))

    def _physical(self) -> Array:
        """Speed [mm/s] and force [N] of the last sample, (s, 2)."""
        return self.lattice.level.physical(self.condition[:, :2])

    def set_condition(self, condition: Array) -> None:
        """Set what the next sample is predicted under: the condition (s, 3) of the last."""
        self.condition = condition  # speed and force, scaled, and the speed that tones go by [mm/s]
        self.level = self.lattice.level(condition[:, :2])
        self.reflections = self.lattice.reflections(condition[:, :2])

    def begin_phase(self, tones: Tones, phase: Array, nominal_phase: Array) -> None:
        """Begin the tones at a phase of the next sample, and that without jitter, (s,) each."""
        self.phase, self.nominal_phase, self.rate = phase, nominal_phase, np.zeros_like(phase)
        self.tone = tone(tones.coefficients(self.condition), phase)

    @property
    def n_initial(self) -> int:
        """A number for each state; two for a phase; one for recorded innovations."""
        return len(self.states) + (2 if self.model.tones else 0) + (self.model.recorded is not None)

    def begin(self, condition: Array, noise: Array, fade: float = 1.0) -> None:
        """Draw the states, the phase of the tones, and where the recording begins.

        Under a constant condition the states of a normalised lattice are uncorrelated and as large as what enters it. So Gaussian
        states of that size are stationary, but for the leak.

        Differs from the paper: its recorded window rings on alike in every first stroke.
        """
        self.set_condition(condition)
        self.settle_equaliser()
        p = len(self.states)
        size = self.lattice.gains(self.level)[0] * self.model.excitation.sigma(condition[:, :2])
        if self.lattice.gain_before_filter:
            size = fade * size
        self.states = size * noise[:, :p].T
        if self.model.tones:
            phase = np.arctan2(noise[:, p], noise[:, p + 1])
            self.begin_phase(self.model.tones, phase, phase)
        self.begin_playback(noise[:, -1])

    def linear(self) -> tuple[Array, Array]:
        """The next sample by the lattice alone, and by how much an innovation of 1 moves it, (s,) each."""
        x, cosines = predict(self.states, self.reflections)
        return x * self.lattice.gains(self.level)[1], cosines * self.level

    def predict(self) -> Prediction:
        sample, innovation_gain = self.linear()
        prediction = self.model.excitation.added_to(sample + self.tone, innovation_gain, self.condition[:, :2])
        recorded = self.next_innovation.copy() if self.playback else None
        return prediction._replace(
            recorded=recorded, gain_before_filter=self.lattice.gain_before_filter, tone=self.tone
        )

    def leave(self, sample: Array) -> Array:
        """What leaves, through the equaliser, of a sample that was pushed and faded, (s,)."""
        return sample if self.equaliser is None else self.equaliser.push(sample, *self._physical().T)

    def analyse(self, sample: Array) -> Array:
        """Innovation of a sample (s,), which the states of the lattice take in."""
        before, after = self.lattice.gains(self.level)
        self.states, e = push(self.states, self.reflections, sample / after)
        return e / before

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        """Take in the next samples; the noise in them is known from their innovations.

        The phase of tones jitters with the innovation, and leaks towards that without jitter, full turns included: two streams
        under the same noise converge.
        """
        tones, e = self.model.tones, self.analyse(sample - self.tone)
        if tones is not None:
            increment = tones.phase_increment(self.condition)
            memory = np.exp(-increment / np.pi)
            jitter = tones.period_jitter * np.clip(e, -MAX_JITTER_DRIVE, MAX_JITTER_DRIVE)
            self.rate = memory * self.rate + np.sqrt(1 - memory * memory) * jitter
            self.phase = self.phase - tones.phase_leak * (self.phase - self.nominal_phase) + increment * self.rate
            self.phase = self.phase + tones.phase_increment(condition)
            self.nominal_phase = self.nominal_phase + tones.phase_increment(condition)
            self.tone = tone(tones.coefficients(condition), self.phase)
        self.set_condition(condition)
        if self.playback:
            self._play(noise)
