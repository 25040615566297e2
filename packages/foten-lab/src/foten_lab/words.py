"""A texture from words: vectors, a regression over a library, a spectrum; with few textures the most alike is moved.

    y = log spectrum in thirds of an octave, powers of speed and force        y(words) = ȳ + K(words, library) (K + λ)⁻¹ (Y − ȳ)

K is linear in the vectors or falls with their distance (a Gaussian process); kind, length and λ are chosen by leaving out one
name after another. The spread is the posterior's [dB]. Source: ours; measured on 100 models (docs/less-than-a-recording.md).
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from foten.dsp import Array
from foten.editing.describe import REFERENCE
from foten.editing.edit import UNMEASURED, Edit, edited
from foten.editing.texture_library import BANDS_HZ, Entry, Library
from foten.models.texture_file import Texture, read_texture
from foten_lab.from_spectrum import Spectrum, texture_of_spectrum

TABLE = Path(__file__).with_name("words.npz")
"""GloVe 6B of 50 numbers, 20,000 words and those of surfaces; public domain (PDDL 1.0), made by docs/make/words.py."""
_UNSAID = "a an and the of on in with like as very some made from surface texture textured sample"
UNSAID = frozenset(_UNSAID.split())
"""Words that say nothing of a surface."""
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


class Encoder(Protocol):
    """Text → vector."""

    name: str

    def encode(self, text: str) -> Array:
        """The vector of a text, (k,), of unit length; ValueError where no word of it is known."""


class WordTable:
    """The mean of the vectors of a text's words: of a, of `steel-mesh-1` and of "rough woven linen"."""

    name = "words"

    def __init__(self) -> None:
        with np.load(TABLE, allow_pickle=False) as table:
            words = bytes(table["words"]).decode().split("\n")
            vectors = table["vectors"].T.astype(np.float64) * table["scales"].astype(np.float64)[:, None]
        self._rows = {word: i for i, word in enumerate(words)}
        self._vectors = vectors - vectors.mean(axis=0)  # what all words share says nothing

    def known(self, text: str) -> list[str]:
        """The words of a text that have a vector; a plural counts as its singular where that alone is known."""
        known = []
        for word in re.findall("[a-z]+", text.lower()):
            candidates = (word, word.removesuffix("s"), word.removesuffix("es"))
            known += [one for one in candidates if one in self._rows][:1]
        return [word for word in known if word not in UNSAID] or known

    def encode(self, text: str) -> Array:
        words = self.known(text)
        if not words:
            raise ValueError(f"no word of {text!r} is known, expected English words such as rough, woven or linen")
        return unit(self._vectors[[self._rows[word] for word in words]].mean(axis=0))


class SentenceEncoder:
    """A sentence encoder of sentence-transformers (extra `words`): a folder, or a name that is fetched from its hub."""

    def __init__(self, model: str = "sentence-transformers/all-MiniLM-L6-v2") -> None:
        from sentence_transformers import SentenceTransformer

        try:
            self._model: Any = SentenceTransformer(model, device="cpu")
        except (OSError, ValueError) as error:
            raise ValueError(f"the encoder {model} cannot be loaded: {' '.join(str(error).split())[:200]}") from None
        self.name = Path(model).name

    def encode(self, text: str) -> Array:
        if not text.strip():
            raise ValueError("the text is empty, expected words")
        return unit(np.asarray(self._model.encode([text.replace("-", " ")])[0], dtype=np.float64))


@lru_cache(maxsize=2)
def encoder_of(name: str | None) -> Encoder:
    """The table of words that comes along, read once, or a sentence encoder by its folder or name."""
    return WordTable() if name is None else SentenceEncoder(name)


def text_of(entry: Entry) -> str:
    """What words are compared with."""
    return " ".join((entry.name, *entry.tags)).replace("-", " ").replace("_", " ")


def stem_of(entry: Entry) -> str:
    """The name that namesakes share: `steel-mesh` of `steel-mesh-1` and `Steel Mesh 2`."""
    words = entry.name.lower().replace("_", " ").replace("-", " ").split()
    return " ".join(word for word in words if not word.isdecimal())


def encoded(entries: Sequence[Entry], encoder: Encoder) -> Iterator[tuple[Entry, Array]]:
    """Entries whose words are known, each with its vector."""
    for entry in entries:
        try:
            vector = encoder.encode(text_of(entry))
        except ValueError:
            continue
        yield entry, vector


def search(entries: Sequence[Entry], text: str, encoder: Encoder) -> list[tuple[float, Entry]]:
    """Entries by how like their words are to a text, −1 to 1, the most alike first; those of unknown words are left out."""
    wanted = encoder.encode(text)
    return sorted(((float(v @ wanted), entry) for entry, v in encoded(entries, encoder)), key=lambda pair: -pair[0])


def unit(vector: Array) -> Array:
    """A vector of unit length."""
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-12))


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
        powers = entry.description.speed_exponent, entry.description.force_exponent
        known = [law if power is None else power for power, law in zip(powers, LAW, strict=True)]
        rows.append([*entry.bands_db, *known])
    return np.array(rows)


def fit(entries: Sequence[Entry], encoder: Encoder) -> Fitted:
    """The regression over a library, chosen by leaving out one name after another; ValueError for fewer than `MIN_TEXTURES`."""
    pairs = list(encoded(entries, encoder))
    if len(pairs) < MIN_TEXTURES:
        raise ValueError(f"the library has {len(pairs)} textures with known words, expected {MIN_TEXTURES} or more")
    known = [entry for entry, _ in pairs]
    values, vectors, stems = values_of(known), np.array([vector for _, vector in pairs]), list(map(stem_of, known))
    if len(set(stems)) < 2:
        raise ValueError(f"all {len(stems)} textures of the library are named {stems[0]!r}, expected others too")
    tried = [(left_out_error(vectors, values, stems, *kind), *kind) for kind in product(LENGTHS, NOISES)]
    error, length, noise = min(tried)
    mean_error = left_out_error(vectors, values, stems, 1.0, 1e9)
    names = tuple(entry.name for entry in known)
    return Fitted(Regression(vectors, values, length, noise), error, mean_error, names)


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
    nearest: tuple[str, ...]  # names that are most alike by words; of a small library, of the texture that is moved


def imagine(
    text: str, library: Library, encoder: Encoder, rate_hz: float | None = None, base: Sequence[Texture] = ()
) -> Imagined:
    """A texture of a text; ValueError where no word is known, there is nothing to choose from, or its rate is another.

    Args:
        rate_hz: of the texture, 1000 by default; of a small library, that of the texture that is moved.
        base: textures that words choose from and move where the library is small.
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
    nearest = tuple(entry.name for _, entry in search(library.entries, text, encoder)[:3])
    spread = fitted.error_db * float(np.sqrt(np.clip(left, 0.25, 1.0)))
    return Imagined(texture, spread, nearest)


def _guessed(text: str, library: Library, encoder: Encoder, base: Sequence[Texture]) -> Imagined:
    vector = encoder.encode(text)
    textures = [*(read_texture(library.folder / entry.file) for entry in library.entries), *base]
    textures = [texture for texture in textures if texture.sizes.editable]
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
    return Imagined(Texture(card, moved.tensors), None, (str(name),))
