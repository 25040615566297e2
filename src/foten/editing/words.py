"""Words as vectors: a table of words that comes along, or a sentence encoder that a user has."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from foten.dsp import Array

TABLE = Path(__file__).with_name("words.npz")
"""GloVe 6B of 50 numbers, 20,000 words and those of surfaces; public domain (PDDL 1.0), made by docs/make/words.py."""
_UNSAID = "a an and the of on in with like as very some made from surface texture textured sample"
UNSAID = frozenset(_UNSAID.split())
"""Words that say nothing of a surface."""


class Encoder(Protocol):
    """Text → vector."""

    name: str

    def encode(self, text: str) -> Array:
        """The vector of a text, (k,), of unit length.

        Raises:
            ValueError: no word of it is known.
        """


class WordTable:
    """The mean of the vectors of a text's words: of a, of `steel-mesh-1` and of "rough woven linen"."""

    name = "words"

    def __init__(self, path: Path = TABLE) -> None:
        with np.load(path, allow_pickle=False) as table:
            words = bytes(table["words"]).decode().split("\n")
            vectors = table["vectors"].T.astype(np.float64) * table["scales"].astype(np.float64)[:, None]
        self._rows = {word: i for i, word in enumerate(words)}
        self._vectors = vectors - vectors.mean(axis=0)  # what all words share says nothing

    def known(self, text: str) -> list[str]:
        """The words of a text that have a vector; a plural counts as its singular where that alone is known."""
        found = []
        for word in re.findall("[a-z]+", text.lower()):
            candidates = (word, word.removesuffix("s"), word.removesuffix("es"))
            found += [next((one for one in candidates if one in self._rows), "")]
        known = [word for word in found if word]
        return [word for word in known if word not in UNSAID] or known

    def encode(self, text: str) -> Array:
        words = self.known(text)
        if not words:
            raise ValueError(f"no word of {text!r} is known, expected English words such as rough, woven or linen")
        return unit(self._vectors[[self._rows[word] for word in words]].mean(axis=0))


class SentenceEncoder:
    """A sentence encoder of the package sentence-transformers: a folder, or a name that is fetched from its hub.

    Raises:
        ModuleNotFoundError: the package is missing (`pip install 'foten[words]'`).
        ValueError: there is no such model.
    """

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


@lru_cache(maxsize=1)
def word_table() -> WordTable:
    """The table that comes along, read once."""
    return WordTable()


def encoder_of(name: str | None) -> Encoder:
    """The table of words, or a sentence encoder by its folder or name."""
    return word_table() if name is None else SentenceEncoder(name)


def unit(vector: Array) -> Array:
    """A vector of unit length."""
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-12))
