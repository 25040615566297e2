"""The networks in NumPy: windows (b, m, 3) → next samples (b,), from a texture's tensors alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from foten.architecture import GRAPHS, FotenArchitecture, FotenPlusArchitecture, TenArchitecture
from foten.dsp.lattice import analyse, check_reflections, forecast, push
from foten.dsp.noise import Swell
from foten.dsp.plane import Plane
from foten.dsp.spectrum import WEAKEST_BIN, dft_matrices, last_sample_row, position_encoding
from foten.dsp.tones import LARGEST_STRAY, fitted_phase, heard_of, tone
from foten.render.ar import NumpyAr
from foten.render.excitation import Excitation, Scale
from foten.render.forecast import Engine, Forecast, State
from foten.render.graph import GraphEngine, NoiseEngine
from foten.render.weights import Weights
from foten.render.window_state import WindowState, begun, followed
from foten.texture_file import Texture

Array = NDArray[np.float64]

_AT_ONCE = 8_000_000  # reflections held in memory


class NumpyNetwork:
    """The paper's network or TEN, pruned exactly as in training: one query row in the last layer, one row of Eq. 9.

    In float64: float32 takes half the time, but missed PyTorch in float64 by 1.7e-5 on four times a golden window of the
    simulated styrofoam, more than the file's own proof allows.
    """

    def __init__(
        self, architecture: TenArchitecture, tensors: Mapping[str, NDArray[Any]], prefix: str = ""
    ) -> None:
        self.window = architecture.window
        self._architecture = architecture
        self._w = Weights(tensors, prefix)
        self._positions = np.ascontiguousarray(position_encoding(self.window, architecture.d_model))
        self._spectral: _Spectral | None = None
        if isinstance(architecture, FotenArchitecture):
            self._spectral = _Spectral(architecture, self._w)
        alone = not isinstance(architecture, FotenPlusArchitecture)
        self.excitation = Excitation(tensors) if alone and architecture.excited else None

    def start(self, windows: Array) -> WindowState:
        """Return the state of streams that have heard the given scaled windows, shape (s, m, 3)."""
        return begun(self, windows)

    def follow_heard(self, blocks: Array) -> Forecast:
        """Return the forecast of every sample of recorded blocks, with its excitation: `ExcitedEngine`."""
        return followed(self, blocks)

    def predict(self, windows: Array) -> Array:
        """Return the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        seen = windows
        if self._architecture.n_inputs < 4:
            seen = np.concatenate([windows[:, :, :1], windows[:, :, 3:]], axis=2)
        tokens = self._w.linear("temporal.embedding", seen) + self._positions
        n_layers = self._architecture.n_layers
        for layer in range(n_layers):
            last_only = layer == n_layers - 1
            tokens = _layer(self._w, f"temporal.layers.{layer}", self._architecture, tokens, last_only)
        found = tokens[:, 0]
        if self._architecture.pre_norm:
            found = self._w.norm("temporal.norm", found)
        if self._spectral is not None:
            sample = self._spectral(np.ascontiguousarray(windows[:, :, 0]))[:, None]
            found = np.concatenate([found, self._w.linear("spectral_embedding", sample)], axis=1)
        if self._architecture.modulated:
            scale, shift = np.split(self._w.linear("modulation", windows[:, -1, 1:3]), 2, axis=1)
            found = found * (1 + scale) + shift
        hidden = np.concatenate([found, windows[:, -1, 1:3]], axis=1)
        hidden = np.maximum(self._w.linear("head_1", hidden), 0.0)
        hidden = np.maximum(self._w.linear("head_2", hidden), 0.0)
        return self._w.linear("head_3", hidden)[:, 0]


class _Spectral:
    """Magnitude and phase through an encoder layer each, and back to time (Eq. 6–9)."""

    def __init__(self, architecture: FotenArchitecture, weights: Weights) -> None:
        self._architecture = architecture
        self._w = weights
        m = architecture.window
        matrices = (
            *(matrix[:, : architecture.n_bins] for matrix in dft_matrices(m)),
            *last_sample_row(m, half=architecture.bins == "half"),
        )
        self._real, self._imaginary, self._cosine, self._sine = map(np.ascontiguousarray, matrices)

    def __call__(self, acceleration: NDArray[Any]) -> NDArray[Any]:
        """Return Re a_spec[m−1]: (b, m) scaled → (b,)."""
        real, imaginary = acceleration @ self._real, acceleration @ self._imaginary + 0.0
        power = real * real + imaginary * imaginary
        heard = power > WEAKEST_BIN * power.sum(axis=1, keepdims=True)
        real, imaginary = np.where(heard, real, 0.0), np.where(heard, imaginary, 0.0)
        magnitude = np.sqrt(power + 1e-16)
        if self._architecture.phase_input == "cos_sin":
            phase = np.stack([real / magnitude, imaginary / magnitude], axis=-1)
        else:
            phase = np.arctan2(imaginary, real)[..., None]
        if self._architecture.magnitude_input == "log":
            magnitude = np.log1p(magnitude)
        encoded_phase = self._encode("phase", phase)
        turned = self._cosine * np.cos(encoded_phase) + self._sine * np.sin(encoded_phase)
        return (self._encode("magnitude", magnitude[..., None]) * turned).sum(axis=1)

    def _encode(self, name: str, tokens: NDArray[Any]) -> NDArray[Any]:
        lifted = self._architecture.spectral_width > 1
        if lifted:
            tokens = self._w.linear(f"spectral.{name}_in", tokens)
        if self._architecture.bin_embedding:
            tokens = tokens + self._w["spectral.bins"]
        tokens = _layer(self._w, f"spectral.{name}_layer", self._architecture, tokens)
        return (self._w.linear(f"spectral.{name}_out", tokens) if lifted else tokens)[..., 0]


def _layer(
    w: Weights, name: str, architecture: TenArchitecture, tokens: NDArray[Any], last_only: bool = False
) -> NDArray[Any]:
    """Return what an encoder layer makes of tokens (b, n, width), or of the last alone (Eq. 3–5)."""
    pre_norm = architecture.pre_norm
    normed = w.norm(f"{name}.norm_1", tokens) if pre_norm else tokens
    asked = slice(-1, None) if last_only else slice(None)
    hidden = tokens[:, asked] + _attended(w, name, architecture.n_heads, normed, asked)
    if not pre_norm:
        hidden = w.norm(f"{name}.norm_1", hidden)
    inner = w.norm(f"{name}.norm_2", hidden) if pre_norm else hidden
    inner = np.maximum(w.linear(f"{name}.feedforward_in", inner), 0.0)
    hidden = hidden + w.linear(f"{name}.feedforward_out", inner)
    return hidden if pre_norm else w.norm(f"{name}.norm_2", hidden)


def _attended(w: Weights, name: str, n_heads: int, normed: NDArray[Any], asked: slice) -> NDArray[Any]:
    b, _, width = normed.shape
    n_heads = n_heads if width % n_heads == 0 else 1
    projected = w.linear(f"{name}.attention_in", normed)
    query, key, value = (
        part.reshape(b, -1, n_heads, width // n_heads).transpose(0, 2, 1, 3)
        for part in (
            projected[:, asked, :width],
            projected[..., width : 2 * width],
            projected[..., 2 * width :],
        )
    )
    scores = (query * (width // n_heads) ** -0.5) @ key.transpose(0, 1, 3, 2)
    scores = np.exp(scores - scores.max(axis=-1, keepdims=True))
    mixed = (scores @ value) / scores.sum(axis=-1, keepdims=True)
    return w.linear(f"{name}.attention_out", mixed.transpose(0, 2, 1, 3).reshape(b, -1, width))


@dataclass
class LatticeState:
    """Streams of foten-plus.

    Attributes:
        states: b₀ … b_{p−1} of the lattice, shape (p, s).
        seen: what the network sees of the last m samples: x, speed, force, innovation; shape (s, m, 4).
        swell: how much louder than usual the streams are.
        corrected: whether the network is heard.
    """

    engine: NumpyFotenPlus
    states: Array
    seen: Array
    swell: Swell
    corrected: bool
    level: Array = field(init=False)
    reflections: Array = field(init=False)
    bounded: ClassVar[bool] = True

    def __post_init__(self) -> None:
        self._heed(self.seen[:, -1, 1:3])

    def _heed(self, condition: Array) -> None:
        """Make ready for the sample after one at a speed and force (s, 2), scaled."""
        lattice = self.engine.lattice
        self.level, self.reflections = lattice.level(condition), lattice.reflections(condition).T

    @property
    def n_to_begin(self) -> int:
        """Return one number for each state, one for the swell, and one for each sample that the network is to have seen."""
        return len(self.states) + 1 + (self.seen.shape[1] if self.corrected else 0)

    def begin(self, condition: Array, noise: Array) -> None:
        """Draw the states, see `NumpyFotenPlus.drawn`, and play what the network is to have seen."""
        p, hand = len(self.states), condition[:, :2]
        self.states = self.engine.drawn(self.engine.lattice, hand, noise[:, :p])
        self.swell.draw(noise[:, p])
        self.seen = np.zeros_like(self.seen)
        self.seen[..., 1:3] = hand[:, None]
        self._heed(hand)
        for z in noise[:, p + 1 :].T:
            self.push(self.forecast().excited(z), condition, z)

    def forecast(self) -> Forecast:
        """Return the lattice's prediction and, where it is heard, the network's correction of it."""
        x, gain = forecast(self.states, self.reflections)
        unit = gain * self.level
        sample = x * self.engine.lattice.shares(self.level)[1]
        if self.corrected:
            sample = sample + unit * self.engine.correction(self.seen)
        return self.engine.excited(sample, unit * self.swell.factor(), self.seen[:, -1, 1:3])

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        """Take in the samples that followed the last forecast."""
        self.swell.push(noise)
        drive, behind = self.engine.lattice.shares(self.level)
        self.states, e = push(self.states, self.reflections, sample / behind)
        self.seen[:, :-1] = self.seen[:, 1:]
        self.seen[:, -1, 0], self.seen[:, -1, 3] = sample / self.level, e / drive
        self.seen[:, -1, 1:3] = condition[:, :2]
        self._heed(condition[:, :2])


class ToneMotion(NamedTuple):
    """How the phase of tones moves.

    Attributes:
        turn: phase for a mm/s and a sample [rad].
        unevenness: standard deviation of a period's length, as a share of it.
        forgetting: share of the stray which is taken back in a sample.
    """

    turn: float
    unevenness: float
    forgetting: float


@dataclass
class ToneState:
    """Streams of foten-plus on a surface that repeats: tones of the path, and a lattice for what they leave.

    Attributes:
        states: of the lattice of the rest, shape (p, s).
        condition: speed and force of the last sample, scaled, shape (s, 2).
        phase: of the fundamental at the last sample [rad], shape (s,).
        swell: how much louder than usual the streams are.
        path: the phase that the path alone would have, from zero where the rendering began, shape (s,).
        rate: by what share the phase turns faster than the path says, shape (s,).
        level, reflections, turned, value: for the sample to come: what the path turned the phase by [rad]; T, scaled.
    """

    engine: NumpyFotenPlus
    states: Array
    condition: Array
    phase: Array
    swell: Swell
    path: Array = field(init=False)
    rate: Array = field(init=False)
    level: Array = field(init=False)
    reflections: Array = field(init=False)
    turned: Array = field(init=False)
    value: Array = field(init=False)
    bounded: ClassVar[bool] = True

    def __post_init__(self) -> None:
        self.path = self.rate = np.zeros_like(self.phase)
        self._heed(self.condition)
        # The way to the first sample belongs to the recording, of which nothing is to be left: the path begins here, and the
        # phase within half a turn of it.
        self.path = np.zeros_like(self.phase)
        self.phase = np.remainder(self.phase + np.pi, 2 * np.pi) - np.pi

    def _heed(self, condition: Array) -> None:
        """Move on to the sample after one at a speed and force (s, 2 or 3), scaled."""
        turned = self.engine.turned(condition)
        self.phase, self.path = self.phase + turned, self.path + turned
        self._listen(condition)

    def _listen(self, condition: Array) -> None:
        """Make ready, at the phase that there is, for the sample after one at a speed and force (s, 2 or 3), scaled."""
        self.condition, rest = condition[:, :2], self.engine.rest
        self.level, self.reflections = rest.level(self.condition), rest.reflections(self.condition).T
        self.turned = self.engine.turned(condition)
        self.value = tone(self.engine.tones_at(self.condition, self.turned), self.phase)

    @property
    def n_to_begin(self) -> int:
        """Return one number for each state, one for the swell and two for the place on the surface."""
        return len(self.states) + 3

    def begin(self, condition: Array, noise: Array) -> None:
        """Draw the states, see `NumpyFotenPlus.drawn`, and where in its period the surface is touched."""
        p = len(self.states)
        self.states = self.engine.drawn(self.engine.rest, condition[:, :2], noise[:, :p])
        self.swell.draw(noise[:, p])
        self.phase = self.path = np.arctan2(noise[:, p + 1], noise[:, p + 2])
        self.rate = np.zeros_like(self.phase)
        self._listen(condition)

    def forecast(self) -> Forecast:
        """Return the tones and what the lattice predicts of the rest."""
        x, gain = forecast(self.states, self.reflections)
        unit = gain * self.level * self.swell.factor()
        sample = self.value + x * self.engine.rest.shares(self.level)[1]
        return self.engine.excited(sample, unit, self.condition)

    def push(self, sample: Array, condition: Array, noise: Array | None) -> None:
        """Take in the samples that followed the last forecast.

        The phase strays as the surface does, the innovation for chance, and is drawn towards that of the path alone by a share of
        all that it is away, whole turns included: two streams under the same noise come nearer by that share in every sample,
        whatever the hand does, so a rendering forgets where it started. Drawn to the nearest turn, two that strayed to either
        side of half a turn were drawn apart: on simulated jeans, whose periods are uneven, they had not met in 12 s.
        """
        self.swell.push(noise)
        drive, behind = self.engine.rest.shares(self.level)
        self.states, e = push(self.states, self.reflections, (sample - self.value) / behind)
        motion = self.engine.motion
        self.phase = self.phase - motion.forgetting * (self.phase - self.path)
        alike = np.exp(-self.turned / np.pi)
        chance = motion.unevenness * np.clip(e / drive, -LARGEST_STRAY, LARGEST_STRAY)
        self.rate = alike * self.rate + np.sqrt(1 - alike * alike) * chance
        self.phase = self.phase + self.turned * self.rate
        self._heed(condition)


class NumpyFotenPlus:
    """A lattice that follows the hand, the network's bounded correction, and the excitation; tones where it repeats."""

    def __init__(self, architecture: FotenPlusArchitecture, tensors: Mapping[str, NDArray[Any]]) -> None:
        self.window = architecture.history
        self.network_heard = architecture.network_heard and not architecture.n_tones
        self._m = architecture.window
        self._limit = architecture.correction_limit
        self._network = NumpyNetwork(architecture, tensors, "network.")
        self._w = Weights(tensors, "")
        self._excitation = Excitation(tensors)
        self.largest = self._excitation.largest
        self.sigma, self.tail, self.excited = (
            self._excitation.sigma,
            self._excitation.tail,
            self._excitation.forecast,
        )
        self.lattice = self.rest = _Lattice(tensors, "lattice.", architecture.level_drives)
        self._tones: Plane | None = None
        if architecture.n_tones:
            self.rest = _Lattice(tensors, "rest.", architecture.rest_level_drives)
            self._tones = Plane(
                *(self._w[f"tones.{part}"] for part in ("speed_knots", "force_knots", "values"))
            )
            self.motion = ToneMotion(*(float(value) for value in self._w["tones.motion"]))

    def predict(self, windows: Array) -> Array:
        """Return the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        return self._listening(windows, corrected=True).forecast().sample

    def start(self, windows: Array) -> State:
        """Return the state of renderings that go on from the given scaled windows, shape (s, m, 3).

        Their first sample is not what `predict` expects where the network is not heard, or where there are tones, whose phase
        `predict` has to infer.
        """
        if self._tones is None:
            return self._listening(windows, self.network_heard)
        before = windows[:, :-1, 1:]
        flat, shape = before.reshape(-1, 2), before.shape[:2]
        turned = self.turned(flat)
        travelled = np.cumsum(turned.reshape(shape), axis=1)
        level = self.lattice.level(flat).reshape(shape)
        coefficients = self.tones_at(flat, turned).reshape(*shape, -1) / level[..., None]
        phase = travelled + fitted_phase(windows[:, 1:, 0] / level, coefficients, travelled)[:, None]
        rest = windows[:, 1:, 0] - level * tone(coefficients, phase)
        states = [part[3] for part in self._analysed(self.rest, rest, before)]
        return ToneState(
            self,
            np.concatenate(states, axis=1),
            windows[:, -1, 1:],
            phase[:, -1],
            self._excitation.swell(len(windows)),
        )

    def _listening(self, windows: Array, corrected: bool) -> LatticeState:
        parts = self._analysed(self.lattice, windows[:, 1:, 0], windows[:, :-1, 1:])
        x, e = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
        seen = np.concatenate([x[..., None], windows[:, 1:, 1:], e[..., None]], axis=2)[:, -self._m :]
        states = np.concatenate([part[3] for part in parts], axis=1)
        return LatticeState(self, states, seen, self._excitation.swell(len(windows)), corrected)

    def drawn(self, lattice: _Lattice, condition: Array, noise: Array) -> Array:
        """Return states of streams that have been under one hand for long: speed and force (s, 2) scaled, normal (s, p) → (p, s).

        Under a constant hand the states of a normalised lattice are uncorrelated and as large as what drives it, each a sum of
        many innovations, so Gaussian numbers of that size are a stream that was always there (but for the leak, which leaves
        slowly fading tones a little softer): level, colour and peaks are right from the first sample on. A recorded window, as
        the paper has it, rings on alike in every first stroke, under another hand than its own: linear cloth exceeded the
        settled 99.9th percentile in 0.212 ± 0.016 % of the first 20 ms from one, and 0.114 % of settled sound does.
        """
        drive, _ = lattice.shares(lattice.level(condition))
        # The mean square of z·exp(h z²/2) is (1 − 2h)^(−3/2).
        size = drive * self.sigma(condition) * (1 - 2 * self.tail(condition)) ** -0.75
        return size * noise.T

    def _analysed(
        self, lattice: _Lattice, samples: Array, before: Array
    ) -> list[tuple[Array, Array, Array, Array]]:
        """Return what a lattice makes of recorded samples, in parts whose reflections fit into memory.

        A sample's level and reflections are those of the speed and force before it: a prediction knows no others (Eq. 1).

        Args:
            lattice: of what the samples are.
            samples: scaled, shape (s, n).
            before: speed and force before each, scaled, shape (s, n, 2).

        Returns:
            x, its innovations, what a unit of them is worth in scaled acceleration, each (s, n); the last states (p, s).
        """
        n_at_once = max(1, _AT_ONCE // (samples.shape[1] * lattice.order))
        parts = []
        for i in range(0, max(1, len(samples)), n_at_once):
            some, flat = samples[i : i + n_at_once], before[i : i + n_at_once].reshape(-1, 2)
            level = lattice.level(flat).reshape(some.shape)
            drive, behind = lattice.shares(level)
            e, gain, states = analyse(some / behind, lattice.reflections(flat).reshape(*some.shape, -1))
            parts.append((some / level, e / drive, gain * level, states))
        return parts

    def innovations(self, blocks: Array, phase: Array | None = None) -> tuple[Array, Array, Array]:
        """Return x, the lattice's innovations, and what a unit of them is worth in scaled acceleration, each (s, n).

        Args:
            blocks: scaled, shape (s, n, 3); the first sample of each gives zeros, having nothing before it.
            phase: of the tones at every sample [rad], shape (s, n), for what they leave; None for the whole vibration.
        """
        samples, before, lattice = blocks[:, 1:, 0], blocks[:, :-1, 1:], self.lattice
        if phase is not None:
            flat = before.reshape(-1, 2)
            coefficients = self.tones_at(flat, self.turned(flat)).reshape(*samples.shape, -1)
            samples, lattice = samples - tone(coefficients, phase[:, 1:]), self.rest
        parts = self._analysed(lattice, samples, before)
        x, e, unit = (np.pad(np.concatenate([part[k] for part in parts]), ((0, 0), (1, 0))) for k in range(3))
        return x, e, unit

    def follow(self, blocks: Array, corrected: bool = True) -> Forecast:
        """Return the forecast of every sample of recorded blocks from those before it in its block, from sample `window` on.

        Args:
            blocks: scaled, shape (s, n, 3).
            corrected: False leaves out what the network adds.

        Returns:
            Each of shape (s, n − window), scaled; the sample alone where the excitation is not that of such a forecast, but of a
            rendering with tones, or with or without the network.
        """
        x, e, unit = self.innovations(blocks)
        asked = np.arange(self.window, blocks.shape[1])
        innovation = -e[:, asked]  # predicted minus recorded
        if corrected:
            seen = np.stack([x, blocks[..., 1], blocks[..., 2], e], axis=2)
            windows = asked[:, None] + np.arange(-self._m, 0)
            flat = [
                seen[:, part].reshape(-1, self._m, 4)
                for part in np.array_split(windows, len(asked) * len(x) // 2048 + 1)
            ]
            pieces = [self.correction(part).reshape(len(x), -1) for part in flat]
            innovation = innovation + np.concatenate(pieces, axis=1)
        sample = blocks[:, self.window :, 0] + innovation * unit[:, asked]
        if self._tones is not None or corrected != self.network_heard:
            return Forecast(sample)
        before = blocks[:, self.window - 1 : -1, 1:].reshape(-1, 2)
        scale = unit[:, asked] * self.sigma(before).reshape(sample.shape)
        return Forecast(sample, scale, self.tail(before).reshape(sample.shape), self.largest)

    def follow_heard(self, blocks: Array) -> Forecast:
        """Return the same with the network or without, as a rendering hears it."""
        return self.follow(blocks, corrected=self.network_heard)

    def turned(self, condition: Array) -> Array:
        """Return by how much the path turns the tones' phase in a sample [rad]: (b, 2 or 3), as `ClosedLoop` has it, → (b,)."""
        speed = condition[:, 2] if condition.shape[1] > 2 else self.lattice.physical(condition)[:, 0]
        return self.motion.turn * speed

    def tones_at(self, condition: Array, turned: Array) -> Array:
        """Return the tones' coefficients: speed and force (b, 2) scaled and turns (b,) → (b, 2 n_tones) scaled."""
        assert self._tones is not None
        coefficients = self._tones.at(*self.lattice.physical(condition).T)
        level = self.lattice.level(condition)[:, None]
        return coefficients * level * heard_of(coefficients.shape[1] // 2, turned)

    def correction(self, seen: Array) -> Array:
        """Return what the network adds, in units of the innovation: x, speed, force and e (b, m, 4) → (b,)."""
        return self._limit * np.tanh(self._network.predict(seen) / self._limit)


class _Lattice:
    """Level and reflections over speed and force."""

    def __init__(self, tensors: Mapping[str, NDArray[Any]], prefix: str, level_drives: bool) -> None:
        weights = Weights(tensors, prefix)
        check_reflections(weights["reflections"])
        self.level_drives = level_drives
        self.order = weights["reflections"].shape[1]
        self._plane = Plane(weights["speed_knots"], weights["force_knots"], weights["reflections"])
        self._level = Scale(tensors, f"{prefix}level.")

    def level(self, condition: Array) -> Array:
        """Return the level of the vibration: speed and force (b, 2) scaled → standard deviation (b,) scaled."""
        return self._level(condition)

    def shares(self, level: Array) -> tuple[Array, Array]:
        """Return what of a level scales the innovation, and what scales that which leaves the lattice."""
        return (level, np.ones_like(level)) if self.level_drives else (np.ones_like(level), level)

    def reflections(self, condition: Array) -> Array:
        """Return the reflections: speed and force (b, 2) scaled → (b, p)."""
        return self._plane.at(*self.physical(condition).T)

    def physical(self, condition: Array) -> Array:
        """Return speed [mm/s] and force [N], none negative: scaled (b, 2) → (b, 2)."""
        return self._level.physical(condition)


ENGINES: dict[str, Callable[[Any, Mapping[str, NDArray[Any]]], Engine]] = {
    "foten-plus": NumpyFotenPlus,
    "foten": NumpyNetwork,
    "ten": NumpyNetwork,
    "ar": NumpyAr,
    **{key: NoiseEngine if of.of_noise else GraphEngine for key, of in GRAPHS.items()},
}
"""What runs each model of a texture file."""


def engine_for(texture: Texture) -> Engine:
    """Return the engine of a texture, not yet proved on its golden windows.

    Raises:
        ValueError: no engine runs its model.
    """
    key = texture.card["model"]
    if key not in ENGINES:
        raise ValueError(f"no engine runs model {key!r}, expected one of {', '.join(ENGINES)}")
    return ENGINES[key](texture.architecture, texture.tensors)
