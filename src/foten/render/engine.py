"""The networks in NumPy: windows (b, m, 3) → next samples (b,), from a texture's tensors alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from foten.architecture import HEAVIEST_TAIL, FotenArchitecture, FotenPlusArchitecture
from foten.dsp.lattice import analyse, check_reflections, forecast, push
from foten.dsp.noise import gaussianised, heavy_tailed
from foten.dsp.plane import Plane
from foten.dsp.spectrum import WEAKEST_BIN, dft_matrices, last_sample_row, position_encoding
from foten.dsp.tones import LARGEST_INNOVATION, START_VARIANCE, corrected, fitted_phase, tone
from foten.texture_file import Texture

Array = NDArray[np.float64]

_AT_ONCE = 8_000_000  # reflections held in memory
N_GUESSES = 4  # of the phase, while a recording is followed
_MISFIT_TURNS = 0.5  # between two new guesses, that an innovation is remembered for


class Predictor(Protocol):
    """Windows in, next samples out; stateless. The linear references and a network being trained are predictors too."""

    @property
    def window(self) -> int:
        """Return m, the samples in a window."""
        ...

    def predict(self, windows: Array) -> Array:
        """Return the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        ...


class Engine(Predictor, Protocol):
    """A predictor that also runs streams sample by sample."""

    def start(self, windows: Array) -> State:
        """Return the state of streams that have heard the given scaled windows, shape (s, m, 3)."""
        ...


class NumpyFoten:
    """The paper's network, pruned exactly as in training: one query row in the last layer, one row of Eq. 9.

    In float64: float32 takes half the time, but missed PyTorch in float64 by 1.7e-5 on four times a golden window of the
    simulated styrofoam, more than the file's own proof allows.
    """

    def __init__(
        self, architecture: FotenArchitecture, tensors: Mapping[str, NDArray[Any]], prefix: str = ""
    ) -> None:
        self.window = architecture.window
        self._architecture = architecture
        self._w = _Weights(tensors, prefix)
        m = architecture.window
        matrices = (
            position_encoding(m, architecture.d_model),
            *(matrix[:, : architecture.n_bins] for matrix in dft_matrices(m)),
            *last_sample_row(m, half=architecture.bins == "half"),
        )
        self._positions, self._real, self._imaginary, self._cosine, self._sine = (
            np.ascontiguousarray(matrix) for matrix in matrices
        )

    def start(self, windows: Array) -> WindowState:
        """Return the state of streams that have heard the given scaled windows, shape (s, m, 3)."""
        return WindowState(self, windows.copy())

    def predict(self, windows: Array) -> Array:
        """Return the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        acceleration = np.ascontiguousarray(windows[:, :, 0])
        seen = np.concatenate([windows[:, :, :1], windows[:, :, 3:]], axis=2)
        tokens = self._w.linear("temporal.embedding", seen) + self._positions
        n_layers = self._architecture.n_layers
        for layer in range(n_layers):
            tokens = self._layer(f"temporal.layers.{layer}", tokens, last_only=layer == n_layers - 1)
        temporal = tokens[:, 0]
        if self._architecture.pre_norm:
            temporal = self._w.norm("temporal.norm", temporal)
        spectral = self._w.linear("spectral_embedding", self._spectral(acceleration)[:, None])
        hidden = np.concatenate([temporal, spectral, windows[:, -1, 1:3]], axis=1)
        hidden = np.maximum(self._w.linear("head_1", hidden), 0.0)
        hidden = np.maximum(self._w.linear("head_2", hidden), 0.0)
        return self._w.linear("head_3", hidden)[:, 0]

    def _spectral(self, acceleration: NDArray[Any]) -> NDArray[Any]:
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
        tokens = self._layer(f"spectral.{name}_layer", tokens)
        return (self._w.linear(f"spectral.{name}_out", tokens) if lifted else tokens)[..., 0]

    def _layer(self, name: str, tokens: NDArray[Any], last_only: bool = False) -> NDArray[Any]:
        pre_norm = self._architecture.pre_norm
        normed = self._w.norm(f"{name}.norm_1", tokens) if pre_norm else tokens
        asked = slice(-1, None) if last_only else slice(None)
        hidden = tokens[:, asked] + self._attend(name, normed, asked)
        if not pre_norm:
            hidden = self._w.norm(f"{name}.norm_1", hidden)
        inner = self._w.norm(f"{name}.norm_2", hidden) if pre_norm else hidden
        inner = np.maximum(self._w.linear(f"{name}.feedforward_in", inner), 0.0)
        hidden = hidden + self._w.linear(f"{name}.feedforward_out", inner)
        return hidden if pre_norm else self._w.norm(f"{name}.norm_2", hidden)

    def _attend(self, name: str, normed: NDArray[Any], asked: slice) -> NDArray[Any]:
        b, _, width = normed.shape
        n_heads = self._architecture.n_heads if width % self._architecture.n_heads == 0 else 1
        projected = self._w.linear(f"{name}.attention_in", normed)
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
        return self._w.linear(f"{name}.attention_out", mixed.transpose(0, 2, 1, 3).reshape(b, -1, width))


class Forecast(NamedTuple):
    """The next sample without excitation, by how much a unit of excitation moves it, and how heavy its tails are; scaled."""

    sample: Array
    scale: Array | None = None
    tail: Array | None = None
    largest: float = np.inf

    def excited(self, noise: Array) -> Array:
        """Return the sample with excitation from standard normal noise, shape (s,)."""
        if self.scale is None:
            return self.sample
        return self.sample + self.scale * (
            noise if self.tail is None else heavy_tailed(noise, self.tail, self.largest)
        )


def excitation_fit(expected: Forecast, recorded: Array) -> tuple[Array, Array]:
    """Return the errors taken back to what should be standard normal, and their negative log-likelihood [nat, scaled].

    Args:
        expected: of the recorded samples, with scale and tail.
        recorded: scaled, any shape, the forecast's.
    """
    assert expected.scale is not None
    assert expected.tail is not None
    z = gaussianised((recorded - expected.sample) / expected.scale, expected.tail)
    spread = expected.tail * z * z
    nll = 0.5 * (z * z + spread) + np.log1p(spread) + np.log(expected.scale) + 0.5 * math.log(2 * math.pi)
    return z, nll


class State(Protocol):
    """What streams of a model remember, each stream by itself."""

    def forecast(self) -> Forecast:
        """Return the next samples, shape (s,)."""
        ...

    def push(self, sample: Array, condition: Array) -> None:
        """Take in the next samples (s,) and their speed and force (s, 2), all scaled."""
        ...


@dataclass
class WindowState:
    """Streams of a stateless predictor: the last m samples, shape (s, m, 3).

    Attributes:
        sigma: speed and force (s, 2) scaled → the excitation's scale (s,) scaled; None for none.
    """

    predictor: Predictor
    windows: Array
    sigma: Callable[[Array], Array] | None = None

    def forecast(self) -> Forecast:
        """Return the prediction from the windows."""
        scale = None if self.sigma is None else self.sigma(self.windows[:, -1, 1:])
        return Forecast(self.predictor.predict(self.windows), scale)

    def push(self, sample: Array, condition: Array) -> None:
        """Move the windows on by a sample."""
        self.windows[:, :-1] = self.windows[:, 1:]
        self.windows[:, -1, 0] = sample
        self.windows[:, -1, 1:] = condition


@dataclass
class LatticeState:
    """Streams of foten-plus.

    Attributes:
        states: b₀ … b_{p−1} of the lattice, shape (p, s).
        seen: what the network sees of the last m samples: x, speed, force, innovation; shape (s, m, 4).
        tone: where the streams are on the surface; None where it does not repeat.
    """

    engine: NumpyFotenPlus
    states: Array
    seen: Array
    tone: ToneState | None = None
    level: Array = field(init=False)
    reflections: Array = field(init=False)

    def __post_init__(self) -> None:
        self._heed(self.seen[:, -1, 1:3])
        if self.tone is not None:
            # The way to the first sample belongs to the recording, of which nothing is to be left.
            self.tone.path = np.zeros_like(self.tone.phase)

    def _heed(self, condition: Array) -> None:
        """Make ready for the sample after one at a speed and force (s, 2), scaled."""
        self.level, self.reflections = self.engine.level(condition), self.engine.reflections(condition).T
        if self.tone is not None:
            self.tone.move(condition)

    def forecast(self) -> Forecast:
        """Return tone, lattice's prediction and the network's correction of it."""
        condition = self.seen[:, -1, 1:3]
        x, gain = forecast(self.states, self.reflections)
        unit = gain * self.level
        sample = x * self.level + unit * self.engine.correction(self.seen)
        if self.tone is not None:
            sample = sample + self.tone.value
        scale = unit * self.engine.sigma(condition)
        return Forecast(sample, scale, self.engine.tail(condition), self.engine.largest)

    def push(self, sample: Array, condition: Array) -> None:
        """Take in the samples that followed the last forecast."""
        if self.tone is None:
            x = sample / self.level
            self.states, e = push(self.states, self.reflections, x)
        else:
            x = (sample - self.tone.value) / self.level
            self.states, e = push(self.states, self.reflections, x)
            self.tone.wander(e)
        self.seen[:, :-1] = self.seen[:, 1:]
        self.seen[:, -1, 0], self.seen[:, -1, 3] = x, e
        self.seen[:, -1, 1:3] = condition
        self._heed(condition)


@dataclass
class ToneState:
    """Where streams are on a surface that repeats.

    Attributes:
        phase, variance: of the fundamental [rad, rad²], shape (s,).
        slopes: the lattice's state for the tone's derivative, shape (p, s); heard of a recording, not kept up in a rendering.
        path: phase that the path alone would have, from zero at the first sample of its own, shape (s,).
        value, slope: T and ∂T/∂φ of the sample to come, shape (s,).
        grown: by how much the phase's variance grew on the way to it, shape (s,).
    """

    engine: NumpyFotenPlus
    phase: Array
    variance: Array
    slopes: Array
    path: Array = field(init=False)
    value: Array = field(init=False)
    slope: Array = field(init=False)
    grown: Array = field(init=False)

    def __post_init__(self) -> None:
        self.path = np.zeros_like(self.phase)
        self.value = self.slope = self.grown = self.path

    def move(self, condition: Array) -> None:
        """Move on by a sample at a speed and force (s, 2), scaled."""
        turn, jitter, _ = self.engine.motion
        speed = self.engine.physical(condition)[:, 0]
        self.phase, self.path = self.phase + turn * speed, self.path + turn * speed
        self.grown = jitter * speed
        self.variance = self.variance + self.grown
        self.value, self.slope = tone(self.engine.tones_at(condition), self.phase)

    def correct(self, reflections: Array, level: Array, e: Array) -> None:
        """Take in what the innovation e, shape (s,), says of the phase."""
        self.slopes, slope = push(self.slopes, reflections, self.slope / level)
        self.phase, self.variance = corrected(self.phase, self.variance, e, slope)

    def wander(self, e: Array) -> None:
        """Let the phase stray as the surface does, the innovation e for chance, and draw it towards that of the path alone.

        A rendering so forgets where it started: streams under the same noise meet.
        """
        _, _, forgetting = self.engine.motion
        away = self.phase - self.path
        self.phase = self.phase - forgetting * (away - 2 * np.pi * np.round(away / (2 * np.pi)))
        self.phase = self.phase + np.sqrt(self.grown) * np.clip(e, -LARGEST_INNOVATION, LARGEST_INNOVATION)


class _Search:
    """Streams of recorded samples whose phase is followed from several guesses at once, the best of them believed.

    A Kalman filter that starts at the wrong phase may stay there: what it hears fits half of the multiples. So in every
    twentieth of a second the worst guess is given up for one beside the best.
    """

    def __init__(self, engine: NumpyFotenPlus, phase: Array, n_guesses: int) -> None:
        self._engine, self._n_streams, self._n_guesses = engine, len(phase), n_guesses
        apart = 2 * np.pi * np.arange(n_guesses) / n_guesses
        n = n_guesses * len(phase)
        self._states = np.zeros((engine.order, n))
        start = (apart[:, None] + phase).ravel()
        self._where = ToneState(engine, start, np.full(n, START_VARIANCE), np.zeros((engine.order, n)))
        self._misfit = np.ones((n_guesses, len(phase)))
        self._n = 0

    def step(self, sample: Array, before: Array, level: Array, k: Array) -> tuple[Array, Array]:
        """Take in a sample of each stream and return x and e of the best guess, each (s,)."""
        guesses = self._n_guesses
        k, level = np.tile(k, guesses), np.tile(level, guesses)
        self._where.move(np.tile(before, (guesses, 1)))
        x = (np.tile(sample, guesses) - self._where.value) / level
        self._states, e = push(self._states, k, x)
        self._where.correct(k, level, e)
        chosen = self._chosen()
        if guesses > 1:
            squared = np.minimum(np.square(e).reshape(guesses, -1), LARGEST_INNOVATION**2)
            self._misfit += (squared - self._misfit) / (_MISFIT_TURNS * self._engine.search_every)
            self._n += 1
            if self._n % self._engine.search_every == 0:
                self._try_another()
        return x[chosen], e[chosen]

    def _chosen(self) -> NDArray[np.int64]:
        return self._misfit.argmin(axis=0) * self._n_streams + np.arange(self._n_streams)

    def _try_another(self) -> None:
        """Set the worst guess of each stream beside the best, a little behind it in what it has to its credit."""
        streams = np.arange(self._n_streams)
        best, worst = self._misfit.argmin(axis=0), self._misfit.argmax(axis=0)
        to, since = worst * self._n_streams + streams, best * self._n_streams + streams
        turn = 2 * np.pi * (0.5 + 0.381966 * (self._n // self._engine.search_every))  # never twice the same
        self._states[:, to], self._where.slopes[:, to] = self._states[:, since], self._where.slopes[:, since]
        self._where.phase[to] = self._where.phase[since] + turn
        self._where.variance[to] = START_VARIANCE
        self._misfit[worst, streams] = 1.2 * self._misfit[best, streams]

    def best(self) -> ToneState:
        """Return where the best guess of each stream is."""
        chosen, where = self._chosen(), self._where
        return ToneState(self._engine, where.phase[chosen], where.variance[chosen], where.slopes[:, chosen])

    def best_states(self) -> Array:
        """Return the lattice's state of the best guess of each stream, shape (p, s)."""
        return self._states[:, self._chosen()]


class _Heard(NamedTuple):
    """Recorded blocks through tone and lattice: x, e and unit (s, n); states (p, s); where the streams are in the end."""

    x: Array
    e: Array
    unit: Array
    states: Array
    tone: ToneState | None


class NumpyFotenPlus:
    """Tones of the path, a lattice that follows the hand, the network's bounded correction, and the scale of the excitation."""

    def __init__(self, architecture: FotenPlusArchitecture, tensors: Mapping[str, NDArray[Any]]) -> None:
        self.window = architecture.history
        self._m = architecture.window
        self.order = architecture.order
        self._limit = architecture.correction_limit
        self._network = NumpyFoten(architecture, tensors, "network.")
        self._w = _Weights(tensors, "")
        self.largest = float(self._w["excitation.largest"][0])
        check_reflections(self._w["reflections"])
        self._reflections = Plane(self._w["speed_knots"], self._w["force_knots"], self._w["reflections"])
        self._tones: Plane | None = None
        self.motion = (0.0, 0.0, 0.0)
        if architecture.n_tones:
            self._tones = Plane(self._w["tone_speed_knots"], self._w["tone_force_knots"], self._w["tones"])
            turn, jitter, forgetting = self._w["tone_motion"]
            self.motion = (float(turn), float(jitter), float(forgetting))
            # A twentieth of a second: a rendering forgets its phase in half of one.
            self.search_every = max(1, round(0.1 / float(forgetting)))

    def predict(self, windows: Array) -> Array:
        """Return the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        return self.start(windows).forecast().sample

    def start(self, windows: Array) -> LatticeState:
        """Return the state of streams that have heard the given scaled windows, shape (s, m, 3)."""
        heard = [self._analysed(part) for part in self._in_parts(windows)]
        x, e, states = (
            np.concatenate([getattr(part, name) for part in heard], axis=axis)
            for name, axis in (("x", 0), ("e", 0), ("states", 1))
        )
        seen = np.concatenate([x[..., None], windows[:, 1:, 1:], e[..., None]], axis=2)[:, -self._m :]
        where = None
        if self._tones is not None:
            tones = [part.tone for part in heard if part.tone is not None]
            where = ToneState(
                self,
                np.concatenate([part.phase for part in tones]),
                np.concatenate([part.variance for part in tones]),
                np.concatenate([part.slopes for part in tones], axis=1),
            )
        return LatticeState(self, states, seen, where)

    def _in_parts(self, blocks: Array) -> list[Array]:
        """Return blocks (s, n, 3) in parts whose reflections fit into memory."""
        n_at_once = max(1, _AT_ONCE // (blocks.shape[1] * self.order))
        return [blocks[i : i + n_at_once] for i in range(0, max(1, len(blocks)), n_at_once)]

    def _analysed(self, blocks: Array, n_guesses: int = 1) -> _Heard:
        """Return what recorded blocks leave for the network, of all samples but the first.

        A sample's level and reflections are those of the speed and force before it: a prediction knows no others (Eq. 1).
        """
        before = blocks[:, :-1, 1:]
        flat, shape = before.reshape(-1, 2), before.shape[:2]
        level = self.level(flat).reshape(shape)
        reflections = self.reflections(flat).reshape(*shape, -1)
        samples = blocks[:, 1:, 0]
        if self._tones is None:
            x = samples / level
            e, gain, states = analyse(x, reflections)
            return _Heard(x, e, gain * level, states, None)
        turned = self.motion[0] * self.physical(flat)[:, 0].reshape(shape)
        coefficients = self.tones_at(flat).reshape(*shape, -1)
        first = slice(0, self.window - 1)
        travelled = np.cumsum(turned[:, first], axis=1)
        phase = fitted_phase(
            samples[:, first] / level[:, first], coefficients[:, first] / level[:, first, None], travelled
        )
        search = _Search(self, phase, n_guesses)
        x, e = np.empty(shape), np.empty(shape)
        for n in range(shape[1]):
            x[:, n], e[:, n] = search.step(samples[:, n], before[:, n], level[:, n], reflections[:, n].T)
        gain = np.sqrt(1 - reflections * reflections).prod(axis=2)
        return _Heard(x, e, gain * level, search.best_states(), search.best())

    def innovations(self, blocks: Array) -> tuple[Array, Array, Array]:
        """Return x, the lattice's innovations, and what a unit of them is worth in scaled acceleration, each (s, n).

        Args:
            blocks: scaled, shape (s, n, 3); the first sample of each gives zeros, having nothing before it.
        """
        heard = [self._analysed(part, N_GUESSES) for part in self._in_parts(blocks)]
        x, e, unit = (
            np.pad(np.concatenate([getattr(part, name) for part in heard]), ((0, 0), (1, 0)))
            for name in ("x", "e", "unit")
        )
        return x, e, unit

    def follow(self, blocks: Array, corrected: bool = True) -> Forecast:
        """Return the forecast of every sample of recorded blocks from those before it in its block, from sample `window` on.

        Args:
            blocks: scaled, shape (s, n, 3).
            corrected: False leaves out what the network adds.

        Returns:
            Each of shape (s, n − window), scaled.
        """
        parts = [self._follow(part, corrected) for part in self._in_parts(blocks)]
        sample, scale, tail = (np.concatenate([part[k] for part in parts]) for k in range(3))
        return Forecast(sample, scale, tail, self.largest)

    def _follow(self, blocks: Array, corrected: bool) -> tuple[Array, Array, Array]:
        heard = self._analysed(blocks, N_GUESSES)
        x, e, unit = heard.x, heard.e, heard.unit
        asked = np.arange(self.window - 1, x.shape[1])
        innovation = -e[:, asked]  # predicted minus recorded
        if corrected:
            seen = np.stack([x, blocks[:, 1:, 1], blocks[:, 1:, 2], e], axis=2)
            windows = asked[:, None] + np.arange(-self._m, 0)
            flat = [
                seen[:, part].reshape(-1, self._m, 4)
                for part in np.array_split(windows, len(asked) * len(x) // 2048 + 1)
            ]
            pieces = [self.correction(part).reshape(len(x), -1) for part in flat]
            innovation = innovation + np.concatenate(pieces, axis=1)
        before = blocks[:, self.window - 1 : -1, 1:].reshape(-1, 2)
        scale = unit[:, asked] * self.sigma(before).reshape(len(x), -1)
        sample = blocks[:, self.window :, 0] + innovation * unit[:, asked]
        return sample, scale, self.tail(before).reshape(len(x), -1)

    def level(self, condition: Array) -> Array:
        """Return the level of the vibration: speed and force (b, 2) scaled → standard deviation (b,) scaled."""
        return self._scale("level", condition)

    def sigma(self, condition: Array) -> Array:
        """Return the excitation's scale in units of the lattice's innovation: speed and force (b, 2) scaled → (b,)."""
        return self._scale("excitation", condition)

    def tail(self, condition: Array) -> Array:
        """Return h of the excitation's tails: speed and force (b, 2) scaled → (b,)."""
        logs = self._logarithms("excitation", condition)
        return HEAVIEST_TAIL / (1 + np.exp(-self._w.linear("excitation.tail", _powers(logs))[:, 0]))

    def physical(self, condition: Array) -> Array:
        """Return speed [mm/s] and force [N], none negative: scaled (b, 2) → (b, 2)."""
        return np.maximum(condition * self._w["level.sd"] + self._w["level.mean"], 0.0)

    def reflections(self, condition: Array) -> Array:
        """Return the lattice's reflections: speed and force (b, 2) scaled → (b, p)."""
        return self._reflections.at(*self.physical(condition).T)

    def tones_at(self, condition: Array) -> Array:
        """Return the tones' coefficients: speed and force (b, 2) scaled → (b, 2 n_tones) scaled."""
        assert self._tones is not None
        return self._tones.at(*self.physical(condition).T)

    def correction(self, seen: Array) -> Array:
        """Return what the network adds, in units of the innovation: x, speed, force and e (b, m, 4) → (b,)."""
        return self._limit * np.tanh(self._network.predict(seen) / self._limit)

    def _scale(self, name: str, condition: Array) -> Array:
        logs = self._logarithms(name, condition)
        hidden = np.tanh(self._w.linear(f"{name}.hidden", np.concatenate([condition, logs], axis=1)))
        log_scale = self._w.linear(f"{name}.out", hidden)
        log_scale = log_scale + _powers(logs) @ self._w[f"{name}.power_law.weight"].T
        return np.minimum(np.exp(log_scale[:, 0]), self._w[f"{name}.highest"])

    def _logarithms(self, name: str, condition: Array) -> Array:
        mean, sd, floor = (self._w[f"{name}.{part}"] for part in ("mean", "sd", "floor"))
        physical = np.maximum(condition * sd + mean, 0.0)
        return np.log((physical + floor) / (mean + floor))


def _powers(logs: Array) -> Array:
    x, y = logs.T
    return np.stack([x, y, x * x, x * y, y * y], axis=1)


class _Weights:
    """The tensors under one prefix, in float64."""

    def __init__(self, tensors: Mapping[str, NDArray[Any]], prefix: str) -> None:
        self._tensors = {
            name.removeprefix(prefix): np.asarray(tensor, dtype=np.float64)
            for name, tensor in tensors.items()
            if name.startswith(prefix)
        }

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._tensors:
            raise ValueError(f"the texture file has no tensor {name!r}")
        return self._tensors[name]

    def linear(self, name: str, values: NDArray[Any]) -> NDArray[Any]:
        weight, bias = self[f"{name}.weight"], self[f"{name}.bias"]
        if values.shape[-1] == 1:
            return values * weight[:, 0] + bias
        # One large product is faster than NumPy's loop over a stack of small ones.
        flat = values.reshape(-1, values.shape[-1]) @ weight.T + bias
        return flat.reshape(*values.shape[:-1], -1)

    def norm(self, name: str, values: NDArray[Any]) -> NDArray[Any]:
        centred = values - values.mean(axis=-1, keepdims=True)
        variance = np.square(centred).mean(axis=-1, keepdims=True)
        return centred / np.sqrt(variance + 1e-5) * self[f"{name}.weight"] + self[f"{name}.bias"]


ENGINES: dict[str, Callable[[Any, Mapping[str, NDArray[Any]]], Engine]] = {
    "foten": NumpyFoten,
    "foten-plus": NumpyFotenPlus,
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
