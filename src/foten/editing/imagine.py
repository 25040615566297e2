"""Words → vector → regression over a library → spectrum → texture; with few textures, words move the most alike of them.

    y = log spectrum in thirds of an octave, powers of speed and force        y(words) = ȳ + K(words, library) (K + λ)⁻¹ (Y − ȳ)

K is linear in the vectors or falls with their distance (a Gaussian process); kind, length and λ are chosen by leaving out one
name after another. The spread is the posterior's [dB]. Source: ours; measured on 100 models (docs/less-than-a-recording.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from foten.dsp import Array
from foten.editing.describe import REFERENCE
from foten.editing.edit import UNMEASURED, Edit, edited
from foten.editing.from_spectrum import Spectrum, texture_of_spectrum
from foten.editing.texture_library import BANDS_HZ, Entry, Library
from foten.editing.words import Encoder
from foten.models.texture_file import Texture, read_texture

MIN_TEXTURES = 15  # of a library, below which words only move sliders
LENGTHS = (0.0, 0.5, 0.8, 1.2, 2.0)  # of the Gaussian process, in distances of unit vectors; 0 for the linear kernel
NOISES = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 1e6)  # λ, re the kernel's own variance; the last is the mean of all
LAW = (0.95, 0.33)  # powers of speed and force where a library does not say
DEFAULT_RATE_HZ = 1000.0
SLIDERS = {
    "level_db": (4.0, "rough coarse bumpy jagged gritty", "smooth soft silky slick fine"),
    "brighter": (0.5, "fine sharp hard metal glass", "coarse soft thick fluffy bumpy"),
    "wider": (0.2, "random gritty sandy stony", "ribbed woven grooved regular"),
}
"""What each slider moves by at most, and the words of its two ends."""


@dataclass(frozen=True)
class Regression:
    """Spectra over vectors of words."""

    vectors: Array  # (n, d)
    values: Array  # (n, k)
    length: float
    noise: float

    def at(self, vector: Array) -> tuple[Array, float]:
        """The expected values (k,) of a vector (d,), and the share of their variance that is left."""
        mean = self.values.mean(axis=0)
        system = self._kernel(self.vectors, self.vectors) + self.noise * np.eye(len(self.vectors))
        towards = self._kernel(vector[None], self.vectors)[0]
        expected = mean + towards @ np.linalg.solve(system, self.values - mean)
        own = float(self._kernel(vector[None], vector[None])[0, 0])
        left = own - float(towards @ np.linalg.solve(system, towards))
        return np.asarray(expected), float(np.clip(left / max(own, 1e-9), 0.0, 1.0))

    def _kernel(self, a: Array, b: Array) -> Array:
        if not self.length:
            centre = self.vectors.mean(axis=0)
            return np.asarray((a - centre) @ (b - centre).T)
        square = np.square(a[:, None] - b[None]).sum(axis=2)
        return np.asarray(np.exp(-0.5 * square / self.length**2))


@dataclass(frozen=True)
class Fitted:
    """A regression that was chosen, and its error without namesakes."""

    regression: Regression
    error_db: float  # RMS over bands, mean over textures left out
    mean_error_db: float  # of the mean of the others, beside it
    names: tuple[str, ...]


def values_of(entries: Sequence[Entry]) -> Array:
    """Spectra [dB] and powers of speed and force, (n, 17 + 2)."""
    rows = []
    for entry in entries:
        one = entry.description
        powers = [
            law if power is None else power
            for power, law in zip((one.speed_exponent, one.force_exponent), LAW, strict=True)
        ]
        rows.append([*entry.bands_db, *powers])
    return np.array(rows)


def fit(entries: Sequence[Entry], encoder: Encoder) -> Fitted:
    """The regression over a library, chosen by leaving out one name after another.

    Raises:
        ValueError: fewer than `MIN_TEXTURES` have words that are known.
    """
    known, vectors = [], []
    for entry in entries:
        try:
            vectors.append(encoder.encode(entry.text))
            known.append(entry)
        except ValueError:
            continue
    if len(known) < MIN_TEXTURES:
        raise ValueError(f"the library has {len(known)} textures with known words, expected {MIN_TEXTURES} or more")
    values, matrix = values_of(known), np.array(vectors)
    stems = [entry.stem for entry in known]
    if len(set(stems)) < 2:
        raise ValueError(f"all {len(stems)} textures of the library are named {stems[0]!r}, expected others too")
    tried = []
    for length, noise in product(LENGTHS, NOISES):
        tried.append((left_out_error(matrix, values, stems, length, noise), length, noise))
    error, length, noise = min(tried)
    mean_error = left_out_error(matrix, values, stems, 1.0, 1e9)
    return Fitted(Regression(matrix, values, length, noise), error, mean_error, tuple(entry.name for entry in known))


def left_out_error(vectors: Array, values: Array, stems: Sequence[str], length: float, noise: float) -> float:
    """Mean over textures of the RMS error over bands [dB], each predicted without its namesakes."""
    errors = []
    for i, stem in enumerate(stems):
        others = np.array([other != stem for other in stems])
        expected, _ = Regression(vectors[others], values[others], length, noise).at(vectors[i])
        errors.append(np.sqrt(np.square(expected - values[i])[: len(BANDS_HZ)].mean()))
    return float(np.mean(errors))


@dataclass(frozen=True)
class Imagined:
    """A texture from words."""

    texture: Texture
    spread_db: float | None  # one standard deviation of its spectrum; None where it is a guess
    nearest: tuple[str, ...]  # the textures that it leans on
    guessed: bool


def imagine(
    text: str, library: Library, encoder: Encoder, rate_hz: float | None = None, base: Sequence[Texture] = ()
) -> Imagined:
    """A texture of a text.

    Args:
        rate_hz: of the texture, 1000 by default; of a small library, that of the texture that is moved.
        base: textures that words choose from and move where the library is small.

    Raises:
        ValueError: no word is known, there is nothing to choose from, or what is chosen has another rate.
    """
    vector = encoder.encode(text)
    if len(library.entries) < MIN_TEXTURES:
        made = _guessed(text, library, encoder, base)
        if rate_hz not in (None, made.texture.rate_hz):
            few = f"{made.nearest[0]}, which is adjusted as {len(library.entries)} textures are too few to learn from"
            raise ValueError(f"{few}, is of {made.texture.rate_hz:g} Hz: leave out the rate of {rate_hz:g} Hz")
        return made
    rate_hz = rate_hz or DEFAULT_RATE_HZ
    fitted = fit(library.entries, encoder)
    expected, left = fitted.regression.at(vector)
    bands, powers = expected[: len(BANDS_HZ)], np.clip(expected[len(BANDS_HZ) :], 0.0, 1.5)
    inside = 0.45 * rate_hz > BANDS_HZ
    of_bands = Spectrum(BANDS_HZ[inside], 10 ** (bands[inside] / 10), *REFERENCE, *powers.tolist())
    n = len(fitted.names)
    evidence = f'from the words "{text}" over a library of {n} textures, {UNMEASURED}'
    texture = texture_of_spectrum(of_bands, rate_hz, text, evidence[:500])
    nearest = tuple(entry.name for _, entry in library.search(text, encoder)[:3])
    spread = fitted.error_db * float(np.sqrt(np.clip(left, 0.25, 1.0)))
    return Imagined(texture, spread, nearest, guessed=False)


def _guessed(text: str, library: Library, encoder: Encoder, base: Sequence[Texture]) -> Imagined:
    vector = encoder.encode(text)
    textures = [*(read_texture(library.folder / entry.file) for entry in library.entries), *base]
    textures = [texture for texture in textures if texture.card["model"] == "foten-plus"]
    if not textures:
        raise ValueError("there is no texture of foten-plus to begin from: add some with 'foten library add'")

    def likeness(texture: Texture) -> float:
        try:
            return float(encoder.encode(str(texture.card["texture"]).replace("-", " ")) @ vector)
        except ValueError:
            return -1.0

    nearest = max(textures, key=likeness)
    moves = {}
    for name, (most, up, down) in SLIDERS.items():
        lean = float(encoder.encode(up) @ vector - encoder.encode(down) @ vector)
        moves[name] = round(most * float(np.tanh(2 * lean)), 2)
    moved = edited(nearest, Edit(**moves)).texture
    name = nearest.card["texture"]
    evidence = f'guessed from the words "{text}": {name} moved by sliders, {UNMEASURED}'
    card = {**moved.card, "texture": text, "evidence": evidence[:500]}
    return Imagined(Texture(card, moved.tensors), None, (str(name),), guessed=True)
