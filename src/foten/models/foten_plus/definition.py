"""foten-plus as `models.foten_plus.sizes` describes it: lattice, tones, and innovations of a network or of an excitation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
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
from foten.models.foten_plus.sizes import LOG_SCALE_LIMIT, FotenPlusSizes
from foten.models.stream import Prediction, Weights, limit_of

_erfc = np.vectorize(math.erfc, otypes=[float])
MAX_NEWTON_STEPS = 60  # of Newton's method, which takes about four
NEWTON_PRECISION = 1e-7  # of the narrowest component: the step after one so small would be about its square


@dataclass(frozen=True)
class Mixture:
    """Mixtures of k Gaussians, one for each of s streams: all (s, k)."""

    weight: Array
    mean: Array
    scale: Array

    def expected(self) -> Array:
        """Their means, (s,)."""
        return np.asarray((self.weight * self.mean).sum(axis=1))

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
            converged, x = np.abs(step - x) <= NEWTON_PRECISION * self.scale.min(axis=1), step
            if converged.all():
                break
        return sign * x


def innovation_inputs(innovation: Array, sample: Array, logs: Array) -> Array:
    """u: innovations (s,), samples over the level (s,), log speed and force re their means (s, 2) → (s, 5)."""
    size = np.arcsinh(3 * np.abs(innovation)) - 1
    return np.column_stack([np.arcsinh(innovation), size, sample / 2, logs])


def phase_inputs(phase: Array) -> Array:
    """Cosine and sine of the phase of the next sample [rad], and of twice it: (…,) → (…, 4)."""
    return np.stack([np.cos(phase), np.sin(phase), np.cos(2 * phase), np.sin(2 * phase)], axis=-1)


class NetworkDefinition:
    """The innovation network of a texture's tensors.

    A gated recurrent unit takes in what each sample was; a head gives a mixture of Gaussians for the next innovation:

        u = (asinh e, asinh 3|e| − 1, x/2, log v/v̄, log f/f̄ [, cos φ, sin φ, cos 2φ, sin 2φ])      h ← GRU(u, h)
        (log w, μ, log s) = W₂ tanh(W₁ [h, u] + b₁) + b₂           p(e) = Σ w_k N(e; μ_k, s_k),  log s = L tanh(· / L)

    φ, where there are tones, is the phase of the next sample. The prediction is the mean. In a rendering the innovation is the
    mixture's quantile at Φ(z), z one Gaussian number: a smooth function of weights, state and number.

    Source: ours; the unit is that of Cho et al., "Learning phrase representations using RNN encoder–decoder" (2014), with the
    reset gate after the product.
    """

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
        self.rendering_network = NetworkDefinition(tensors, "rendering_network.") if sizes.network_in_loop else None
        self.equaliser = Equaliser.of(tensors) if sizes.equalised else None
        self.recorded = RecordedInnovations.of(tensors, sizes.along_path) if sizes.recorded else None
        self.tones: Tones | None = None
        if sizes.n_tones:
            self.excited_lattice = Lattice(tensors, "residual.", sizes.residual_gain_before_filter)
            self.tones = Tones(tensors, self.lattice.level)

    def predict(self, windows: Array) -> Array:
        """Next samples by the lattice and the network: windows (b, m, 3) scaled → (b,) scaled."""
        return self._analysed(windows, self.lattice, self.network, calibrated=False).predict().sample

    def start(self, windows: Array) -> FotenPlusStream:
        """Streams that go on from scaled windows, shape (s, m, 3).

        Their first sample is what `predict` gives where the network is in the loop, there are no tones nor equaliser, and σ is 1.
        """
        stream = self._started(windows)
        stream.settle_equaliser()
        stream.begin_playback(None)
        return stream

    def _started(self, windows: Array) -> FotenPlusStream:
        if self.tones is None:
            return self._analysed(windows, self.lattice, self.rendering_network)
        condition = self.with_speed(windows[:, :-1, 1:])
        flat = condition.reshape(-1, 3)
        level = self.lattice.level(flat[:, :2]).reshape(condition.shape[:2])
        coefficients = self.tones.coefficients(flat).reshape(*level.shape, -1) / level[..., None]
        travelled = np.cumsum(self.tones.phase_increment(condition), axis=1)
        phase = fitted_phase(windows[:, 1:, 0] / level, coefficients, travelled)
        residual = windows.copy()
        residual[:, 1:, 0] -= level * tone(coefficients, travelled + phase[:, None])
        last = travelled[:, -1:] + phase[:, None] + self.tones.phase_increment(self.with_speed(windows[:, -1:, 1:]))
        next_phase = np.concatenate([travelled + phase[:, None], last], axis=1)
        stream = self._analysed(residual, self.excited_lattice, self.rendering_network, self.tones, next_phase)
        phase = np.remainder(next_phase[:, -1] + np.pi, 2 * np.pi) - np.pi  # within half a turn
        stream.begin_phase(self.tones, phase, np.zeros_like(phase))
        return stream

    def with_speed(self, condition: Array) -> Array:
        """Conditions (…, 2) scaled with the speed that they stand for [mm/s], (…, 3)."""
        return np.concatenate([condition, self.lattice.level.physical(condition)[..., :1]], axis=-1)

    def _analysed(
        self,
        windows: Array,
        lattice: Lattice,
        network: NetworkDefinition | None,
        tones: Tones | None = None,
        next_phase: Array | None = None,
        calibrated: bool = True,
    ) -> FotenPlusStream:
        """Streams after windows of what a lattice is of, with the phase of tones at the sample after each (s, n)."""
        conditions = self.with_speed(windows[:, :, 1:])
        stream = FotenPlusStream(self, lattice, network, conditions[:, 0], tones, calibrated)
        n = windows.shape[1]
        for i in range(1, n):
            e = stream.analyse(windows[:, i, 0])
            if next_phase is not None:
                stream.phase = next_phase[:, i]
            warming_up = i >= n - self.sizes.window
            stream.advance(e, windows[:, i, 0] / stream.level, conditions[:, i], update_network=warming_up)
        return stream


class FotenPlusStream:
    """Streams of foten-plus: of a lattice, with a network or without, and of tones or none.

    Unless `calibrated`, σ does not scale what the network draws: as in the recording that it was trained on.
    """

    bounded: ClassVar[bool] = True

    def __init__(
        self,
        model: FotenPlus,
        lattice: Lattice,
        network: NetworkDefinition | None,
        condition: Array,
        tones: Tones | None = None,
        calibrated: bool = True,
    ) -> None:
        s = len(condition)
        self.model, self.lattice, self.network, self.tones, self.calibrated = model, lattice, network, tones, calibrated
        self.states = np.zeros((lattice.order, s))  # b₀ … b_{p−1} of the lattice
        self.hidden_state = np.zeros((s, network.n_hidden if network else 0))  # of the network, after the last sample
        # Phase of the tones at the next sample [rad], the same without jitter, r of `dsp.tones`, and T; 0 without tones.
        self.phase = self.nominal_phase = self.rate = self.tone = np.zeros(s)
        self.set_condition(condition)
        self.inputs = self._inputs(np.zeros(s), np.zeros(s))  # of the last sample
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
        self.logs = self.lattice.level.logarithms(condition[:, :2])
        self.reflections = self.lattice.reflections(condition[:, :2])

    def _inputs(self, innovation: Array, x: Array) -> Array:
        inputs = innovation_inputs(innovation, x, self.logs)
        return inputs if self.tones is None else np.concatenate([inputs, phase_inputs(self.phase)], axis=1)

    def begin_phase(self, tones: Tones, phase: Array, nominal_phase: Array) -> None:
        """Begin the tones at a phase of the next sample, and that without jitter, (s,) each."""
        self.phase, self.nominal_phase, self.rate = phase, nominal_phase, np.zeros_like(phase)
        self.tone = tone(tones.coefficients(self.condition), phase)

    @property
    def n_initial(self) -> int:
        """A number for each state; two for a phase; one for each sample of a network's window."""
        warm_up = self.model.sizes.window if self.network else 0
        return len(self.states) + (2 if self.tones else 0) + (self.model.recorded is not None) + warm_up

    def begin(self, condition: Array, noise: Array, fade: float = 1.0) -> None:
        """Draw the states and the phase of the tones; run the network for its window.

        Under a constant condition the states of a normalised lattice are uncorrelated and as large as what enters it. So Gaussian
        states of that size are stationary, but for the leak.

        Differs from the paper: its recorded window rings on alike in every first stroke.
        """
        self.set_condition(condition)
        self.settle_equaliser()
        p, excitation, known = len(self.states), self.model.excitation, condition[:, :2]
        before, _ = self.lattice.gains(self.level)
        size = before * excitation.sigma(known)
        if self.lattice.gain_before_filter:
            size = fade * size
        self.states = size * noise[:, :p].T
        if self.tones:
            phase = np.arctan2(noise[:, p], noise[:, p + 1])
            self.begin_phase(self.tones, phase, phase)
            p += 2
        if self.model.recorded is not None:
            self.begin_playback(noise[:, p])
            p += 1
        zero = np.zeros(len(noise))
        self.hidden_state, self.inputs = np.zeros_like(self.hidden_state), self._inputs(zero, zero)
        for z in noise[:, p:].T:
            leaving, sample = self.predict().faded(z, fade)
            self.push(sample, condition, z)
            self.leave(leaving)

    def predict(self) -> Prediction:
        x, cosines = predict(self.states, self.reflections)
        innovation_gain, known = cosines * self.level, self.condition[:, :2]
        sample = x * self.lattice.gains(self.level)[1] + self.tone
        if self.network is None:
            prediction = self.model.excitation.added_to(sample, innovation_gain, known)
            recorded = self.next_innovation.copy() if self.playback else None
            return self._fading(prediction._replace(recorded=recorded), sample)
        mixture = self.network.mixture(self.hidden_state, self.inputs)
        if not self.calibrated:
            return Prediction(sample + innovation_gain * mixture.expected(), innovation_gain, mixture=mixture)
        scale, bounds = innovation_gain * self.model.excitation.sigma(known), self.model.excitation.innovation_limit
        limit = limit_of(bounds, scale)
        expected = sample + scale * np.clip(mixture.expected(), -limit, limit)
        return self._fading(Prediction(expected, scale, bounds, mixture), sample)

    def _fading(self, prediction: Prediction, linear: Array) -> Prediction:
        before = self.lattice.gain_before_filter
        return prediction._replace(linear=linear - self.tone, tone=self.tone) if before else prediction

    def leave(self, sample: Array) -> Array:
        """What leaves, through the equaliser, of a sample that was pushed and faded, (s,)."""
        return sample if self.equaliser is None else self.equaliser.push(sample, *self._physical().T)

    def analyse(self, sample: Array) -> Array:
        """Innovation of a sample (s,), which the states of the lattice take in."""
        before, after = self.lattice.gains(self.level)
        self.states, e = push(self.states, self.reflections, sample / after)
        return e / before

    def advance(self, innovation: Array, x: Array, condition: Array, update_network: bool = True) -> None:
        """Go on to the condition (s, 3) of a sample; the network takes in its innovation and x, (s,) each."""
        self.set_condition(condition)
        if self.network is not None and update_network:
            self.inputs = self._inputs(innovation, x)
            self.hidden_state = self.network.push(self.hidden_state, self.inputs)

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        """Take in the next samples; the noise in them is known from their innovations.

        The phase of tones jitters with the innovation, and leaks towards that without jitter, full turns included: two streams
        under the same noise converge.
        """
        before, tones, sigma = self.condition, self.tones, self.model.excitation.sigma(self.condition[:, :2])
        level = self.level * sigma
        x = sample - self.tone
        e = self.analyse(x)
        if tones is not None:
            increment = tones.phase_increment(before)
            memory = np.exp(-increment / np.pi)
            jitter = tones.period_jitter * np.clip(e, -MAX_JITTER_DRIVE, MAX_JITTER_DRIVE)
            self.rate = memory * self.rate + np.sqrt(1 - memory * memory) * jitter
            self.phase = self.phase - tones.phase_leak * (self.phase - self.nominal_phase) + increment * self.rate
            self.phase = self.phase + tones.phase_increment(condition)
            self.nominal_phase = self.nominal_phase + tones.phase_increment(condition)
            self.tone = tone(tones.coefficients(condition), self.phase)
        self.advance(e / sigma, x / level, condition)
        if self.playback:
            self._play(noise)
