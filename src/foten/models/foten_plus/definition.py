"""foten-plus as `models.foten_plus.sizes` describes it: lattice, tones, and innovations of a network or of an excitation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.lattice import check_reflections, predict, push
from foten.dsp.speed_force_table import SpeedForceTable
from foten.dsp.tones import MAX_JITTER_DRIVE, anti_alias_gain, fitted_phase, tone
from foten.models.excitation import Excitation, Scale
from foten.models.foten_plus.innovation_network import InnovationNetwork, innovation_inputs, phase_inputs
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.stream import Prediction, limit_of
from foten.models.weights import Weights


class Lattice:
    """A level ℓ and reflection coefficients k over speed and force."""

    def __init__(self, tensors: Mapping[str, NDArray[Any]], prefix: str, gain_before_filter: bool) -> None:
        w = Weights(tensors, prefix)
        check_reflections(w["reflections"])
        self.order, self.gain_before_filter = w["reflections"].shape[1], gain_before_filter
        self._table = SpeedForceTable(w["speed_knots"], w["force_knots"], w["reflections"])
        self.level = Scale.of(tensors, f"{prefix}level.")

    def reflections(self, condition: Array) -> Array:
        """k: speed and force (s, 2) scaled → (p, s)."""
        return self._table.at(*self.level.physical(condition).T).T

    def gains(self, level: Array) -> tuple[Array, Array]:
        """What multiplies the innovation before the filter, and what multiplies the sample after it."""
        ones = np.ones_like(level)
        return (level, ones) if self.gain_before_filter else (ones, level)


class Tones:
    """T(φ; v, f) = ℓ Σ_h A_h cos hφ + B_h sin hφ, and how φ moves: `dsp.tones`."""

    def __init__(self, tensors: Mapping[str, NDArray[Any]], level: Scale) -> None:
        w = Weights(tensors, "tones.")
        self._table = SpeedForceTable(w["speed_knots"], w["force_knots"], w["values"])
        self._level = level
        self._increment, self.period_jitter, self.phase_leak = (float(value) for value in w["phase_params"])

    def phase_increment(self, condition: Array) -> Array:
        """By how much the path moves the phase in a sample [rad]: (…, 3) → (…)."""
        return self._increment * condition[..., 2]

    def coefficients(self, condition: Array) -> Array:
        """ℓA and ℓB in turn, as far as the rate holds their frequencies: (s, 3) → (s, 2 n_tones)."""
        values = self._table.at(*self._level.physical(condition[:, :2]).T)
        gain = anti_alias_gain(values.shape[1] // 2, self.phase_increment(condition))
        return values * self._level(condition[:, :2])[:, None] * gain


class FotenPlus:
    """The model of a texture's tensors."""

    def __init__(self, sizes: FotenPlusSizes, tensors: Mapping[str, NDArray[Any]]) -> None:
        self.sizes, self.window = sizes, sizes.history
        self.excitation = Excitation.of(tensors)
        self.lattice = self.excited_lattice = Lattice(tensors, "lattice.", sizes.gain_before_filter)
        self.network = InnovationNetwork(tensors, "network.")
        self.network_in_loop = InnovationNetwork(tensors, "rendering_network.") if sizes.network_in_loop else None
        self.tones: Tones | None = None
        if sizes.n_tones:
            self.excited_lattice = Lattice(tensors, "residual.", sizes.residual_gain_before_filter)
            self.tones = Tones(tensors, self.lattice.level)

    def predict(self, windows: Array) -> Array:
        """The next samples: windows (b, m, 3) scaled → (b,) scaled, by the lattice and the network."""
        return self._analysed(windows, self.lattice, self.network, calibrated=False).predict().sample

    def start(self, windows: Array) -> FotenPlusStream:
        """Streams that go on from scaled windows, shape (s, m, 3).

        Their first sample is not what `predict` gives where the network is not in the loop, where there are tones, or where σ
        is not 1.
        """
        if self.tones is None:
            return self._analysed(windows, self.lattice, self.network_in_loop)
        condition = self.with_path(windows[:, :-1, 1:])
        flat = condition.reshape(-1, 3)
        level = self.lattice.level(flat[:, :2]).reshape(condition.shape[:2])
        coefficients = self.tones.coefficients(flat).reshape(*level.shape, -1) / level[..., None]
        travelled = np.cumsum(self.tones.phase_increment(condition), axis=1)
        phase = fitted_phase(windows[:, 1:, 0] / level, coefficients, travelled)
        residual = windows.copy()
        residual[:, 1:, 0] -= level * tone(coefficients, travelled + phase[:, None])
        follow = travelled + phase[:, None]
        last = follow[:, -1:] + self.tones.phase_increment(self.with_path(windows[:, -1:, 1:]))
        follow = np.concatenate([follow, last], axis=1)  # of each sample the phase of the next
        stream = self._analysed(residual, self.excited_lattice, self.network_in_loop, self.tones, follow)
        phase = follow[:, -1]
        phase = np.remainder(phase + np.pi, 2 * np.pi) - np.pi  # within half a turn
        stream.begin_path(self.tones, phase, np.zeros_like(phase))
        return stream

    def with_path(self, condition: Array) -> Array:
        """Conditions (…, 2) scaled with the speed that they stand for [mm/s], (…, 3)."""
        return np.concatenate([condition, self.lattice.level.physical(condition)[..., :1]], axis=-1)

    def _analysed(
        self,
        windows: Array,
        lattice: Lattice,
        network: InnovationNetwork | None,
        tones: Tones | None = None,
        phase: Array | None = None,
        calibrated: bool = True,
    ) -> FotenPlusStream:
        """Streams after windows of what a lattice is of, with the phase of tones after each sample (s, n).

        The network takes in the last samples.
        """
        conditions = self.with_path(windows[:, :, 1:])
        stream = FotenPlusStream(self, lattice, network, conditions[:, 0], tones, calibrated)
        n = windows.shape[1]
        for i in range(1, n):
            e = stream.analyse(windows[:, i, 0])
            if phase is not None:
                stream.phase = phase[:, i]
            stream.follow(
                e, windows[:, i, 0] / stream.level, conditions[:, i], update_network=i >= n - self.sizes.window
            )
        return stream


class FotenPlusStream:
    """Streams of foten-plus: of a lattice, with a network or without, and of tones or none.

    Where they are not `calibrated`, σ does not scale what the network draws: as in a recording, which it was trained on.
    """

    bounded: ClassVar[bool] = True

    def __init__(
        self,
        model: FotenPlus,
        lattice: Lattice,
        network: InnovationNetwork | None,
        condition: Array,
        tones: Tones | None = None,
        calibrated: bool = True,
    ) -> None:
        s = len(condition)
        self.model, self.lattice, self.network, self.tones, self.calibrated = model, lattice, network, tones, calibrated
        self.states = np.zeros((lattice.order, s))  # b₀ … b_{p−1} of the lattice
        self.hidden_state = np.zeros((s, network.n_hidden if network else 0))  # of the network, after the last sample
        # Phase of the tones at the next sample [rad], the same without jitter, r of `dsp.tones`, and T; 0 without tones.
        self.phase = self.path = self.rate = self.tone = np.zeros(s)
        self.set_condition(condition)
        self.inputs = self._inputs(np.zeros(s), np.zeros(s))  # of the last sample

    def set_condition(self, condition: Array) -> None:
        """Make ready for the sample after one under a condition (s, 3)."""
        self.condition = condition  # speed and force, scaled, and the speed that tones go by [mm/s]
        self.level = self.lattice.level(condition[:, :2])
        self.logs = self.lattice.level.logarithms(condition[:, :2])
        self.reflections = self.lattice.reflections(condition[:, :2])

    def _inputs(self, innovation: Array, x: Array) -> Array:
        """What the network is given of a sample: its innovation and x, (s,) each, and the phase of the next."""
        inputs = innovation_inputs(innovation, x, self.logs)
        return inputs if self.tones is None else np.concatenate([inputs, phase_inputs(self.phase)], axis=1)

    def begin_path(self, tones: Tones, phase: Array, path: Array) -> None:
        """Begin the path of tones at a phase of the next sample, and that without jitter, (s,) each."""
        self.phase, self.path, self.rate = phase, path, np.zeros_like(phase)
        self.tone = tone(tones.coefficients(self.condition), phase)

    @property
    def n_initial(self) -> int:
        """A number for each state; two for a phase; one for each sample of a network's window."""
        warm_up = self.model.sizes.window if self.network else 0
        return len(self.states) + (2 if self.tones else 0) + warm_up

    def begin(self, condition: Array, noise: Array, fade: float = 1.0) -> None:
        """Draw the states and where in its period a surface is touched; run the network for its window.

        Under a constant condition the states of a normalised lattice are uncorrelated and as large as what enters it, each a sum
        of many innovations, so Gaussian numbers of that size are a stream that was always there (but for the leak): level,
        colour and peaks are right from the first sample on. A recorded window, as the paper has it, rings on alike in every first
        stroke: linear cloth exceeded the settled 99.9th percentile in 0.212 ± 0.016 % of the first 20 ms from one, and in
        0.114 % settled.
        """
        self.set_condition(condition)
        p, excitation, known = len(self.states), self.model.excitation, condition[:, :2]
        before, _ = self.lattice.gains(self.level)
        size = before * excitation.sigma(known)
        if self.lattice.gain_before_filter:
            size = fade * size
        self.states = size * noise[:, :p].T
        if self.tones:
            phase = np.arctan2(noise[:, p], noise[:, p + 1])
            self.begin_path(self.tones, phase, phase)
            p += 2
        zero = np.zeros(len(noise))
        self.hidden_state, self.inputs = np.zeros_like(self.hidden_state), self._inputs(zero, zero)
        for z in noise[:, p:].T:
            self.push(self.predict().faded(z, fade)[1], condition, z)

    def predict(self) -> Prediction:
        """What lattice, tones and network predict, with the excitation."""
        x, cosines = predict(self.states, self.reflections)
        innovation_gain, known = cosines * self.level, self.condition[:, :2]
        sample = x * self.lattice.gains(self.level)[1] + self.tone
        if self.network is None:
            return self._fading(self.model.excitation.added_to(sample, innovation_gain, known), sample)
        mixture = self.network.mixture(self.hidden_state, self.inputs)
        if not self.calibrated:
            return Prediction(sample + innovation_gain * mixture.expected(), innovation_gain, mixture=mixture)
        scale, innovation_limit = (
            innovation_gain * self.model.excitation.sigma(known),
            self.model.excitation.innovation_limit,
        )
        limit = limit_of(innovation_limit, scale)
        expected = sample + scale * np.clip(mixture.expected(), -limit, limit)
        return self._fading(Prediction(expected, scale, innovation_limit, mixture), sample)

    def _fading(self, prediction: Prediction, linear: Array) -> Prediction:
        """A prediction that says what of it fades near rest, from its sample without innovation (s,)."""
        before = self.lattice.gain_before_filter
        return prediction._replace(linear=linear - self.tone, tone=self.tone) if before else prediction

    def analyse(self, sample: Array) -> Array:
        """Take a sample (s,) of what the lattice is of through it, and return its innovation."""
        before, after = self.lattice.gains(self.level)
        self.states, e = push(self.states, self.reflections, sample / after)
        return e / before

    def follow(self, innovation: Array, x: Array, condition: Array, update_network: bool = True) -> None:
        """Go on to the condition (s, 3) of a sample; the network takes in its innovation and x, (s,) each."""
        self.set_condition(condition)
        if self.network is not None and update_network:
            self.inputs = self._inputs(innovation, x)
            self.hidden_state = self.network.push(self.hidden_state, self.inputs)

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        """Take in the next samples.

        The phase of tones jitters as the surface does, by the innovation, and is drawn back to that of the path alone by a share
        of all that it is away, full turns included: two streams under the same noise come nearer by that share in every sample,
        so a rendering forgets where it started. Drawn to the nearest turn, two on either side of half a turn were drawn apart:
        on simulated jeans, whose periods are uneven, they had not met in 12 s.
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
            self.phase = self.phase - tones.phase_leak * (self.phase - self.path) + increment * self.rate
            self.phase = self.phase + tones.phase_increment(condition)
            self.path = self.path + tones.phase_increment(condition)
            self.tone = tone(tones.coefficients(condition), self.phase)
        self.follow(e / sigma, x / level, condition)
