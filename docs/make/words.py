"""What words are worth: each texture of a library predicted from its name, its namesakes left out.

    python docs/make/words.py --library DIR [--encoder NAME] [--csv FILE]

Spectra in thirds of an octave, at the described condition and, by the powers of speed and force that go with each, at twelve more
(30 to 200 mm/s, 0.3 to 2 N). `sliders` is a parabola in dB over octaves, down to 30 dB below its peak, with the truth's level,
centroid and width: what a user who knows them can set without a library. Figures are means over textures with 95 % intervals;
dB, and octaves.
"""

from __future__ import annotations

import argparse
import os
from itertools import product
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from foten.dsp.distance import earth_mover_octaves
from foten.editing.describe import REFERENCE, rendered, spectrum
from foten.editing.texture_library import BANDS_HZ, Entry, bands_db, open_library
from foten.editing.words import LAW, encoder_of, fit, stem_of, text_of, values_of
from foten.models.texture_file import read_texture
from foten.reporting.table import Table

CSV = Path(__file__).resolve().parents[1] / "results" / "words.csv"
CONDITIONS = [REFERENCE, *product((30.0, 60.0, 150.0, 200.0), (0.3, 1.0, 2.0))]
N_BANDS = len(BANDS_HZ)


def truth_of(folder: Path, entry: Entry) -> np.ndarray:
    """Spectra [dB] of a texture at all conditions, (13, 17)."""
    texture = read_texture(folder / entry.file)
    return np.array([bands_db(*spectrum(rendered(texture, *at, 8.0), texture.rate_hz)) for at in CONDITIONS])


def elsewhere(values: np.ndarray) -> np.ndarray:
    """Spectra at all conditions of one at the described condition and two powers, (19,) → (13, 17)."""
    logs = np.log10(np.array(CONDITIONS) / REFERENCE)
    return values[None, :N_BANDS] + 20 * (logs @ values[N_BANDS:])[:, None]


def parabola(entry: Entry) -> np.ndarray:
    """A spectrum of a level, a centroid and a width alone, and the law: (19,)."""
    one, octave = entry.description, np.log2(BANDS_HZ)
    shape = -0.5 * np.square((octave - np.log2(one.centroid_hz)) / one.width_octaves) - np.log(BANDS_HZ)
    power = np.maximum(np.exp(shape), 1e-3 * np.exp(shape).max())  # 30 dB below its peak it ends
    width_hz = BANDS_HZ * (2 ** (1 / 6) - 2 ** (-1 / 6))
    power *= 10 ** (one.level_db / 10) / (power * width_hz).sum()
    return np.append(10 * np.log10(np.maximum(power, 1e-18)), LAW)


def predictions(i: int, entries: list[Entry], values: np.ndarray, encoder: str | None) -> dict[str, np.ndarray]:
    """Figures of a texture by method, from the others without its namesakes."""
    others = np.array([j for j, one in enumerate(entries) if stem_of(one) != stem_of(entries[i])])
    known, rest = encoder_of(None), [entries[j] for j in others]
    vector = known.encode(text_of(entries[i]))
    likeness = [float(known.encode(text_of(one)) @ vector) for one in rest]
    rng = np.random.default_rng(i)
    errors = np.abs(values[others, :N_BANDS] - values[i, :N_BANDS]).mean(axis=1)
    return {
        "random other": values[rng.choice(others)],
        "mean of the others": values[others].mean(axis=0),
        "most alike by words": values[others[int(np.argmax(likeness))]],
        "words": fit(rest, known).regression.at(vector)[0],
        **({} if encoder is None else {"words, sentence encoder": _by_sentences(entries[i], rest, encoder)}),
        "sliders (truth known)": parabola(entries[i]),
        "nearest other (truth known)": values[others[int(np.argmin(errors))]],
    }


def _by_sentences(entry: Entry, rest: list[Entry], encoder: str) -> np.ndarray:
    known = encoder_of(encoder)
    return fit(rest, known).regression.at(known.encode(text_of(entry)))[0]


def interval(figures: np.ndarray) -> float:
    """Half of a 95 % interval of a mean, by Student's t."""
    from scipy.special import stdtrit

    return float(stdtrit(len(figures) - 1, 0.975) * figures.std(ddof=1) / np.sqrt(len(figures)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--library", dest="folder", metavar="DIR", type=Path, required=True)
    parser.add_argument("--encoder", help="a sentence encoder to compare, a folder or a name")
    parser.add_argument("--csv", type=Path, default=CSV)
    arguments = parser.parse_args()
    library = open_library(arguments.folder)
    entries = library.entries
    values = values_of(entries)
    rows: dict[str, list[tuple[float, float, float]]] = {}
    for i, entry in enumerate(entries):
        truth = truth_of(library.folder, entry)
        for method, predicted in predictions(i, entries, values, arguments.encoder).items():
            guess = elsewhere(predicted)
            lsd = np.sqrt(np.square(guess - truth).mean(axis=1)).mean()
            power = [10 ** (x / 10) for x in (truth, guess)]
            level = np.abs(np.diff([10 * np.log10((p * BANDS_HZ).sum(axis=1)) for p in power], axis=0)).mean()
            octaves = earth_mover_octaves(BANDS_HZ, *(p * BANDS_HZ for p in power)).mean()
            rows.setdefault(method, []).append((lsd, level, octaves))
        print(f"{i + 1}/{len(entries)} {entry.name}", flush=True)
    heads = [
        "method",
        "textures",
        "lsd_db",
        "lsd_interval",
        "level_error_db",
        "level_interval",
        "emd_octaves",
        "emd_interval",
    ]
    cells = []
    for method, each in rows.items():
        columns = np.array(each).T
        figures = [f"{x:.3f}" for column in columns for x in (column.mean(), interval(column))]
        cells.append([method, str(len(each)), *figures])
    Table.of(heads, cells).write(arguments.csv)
    print("\n".join(Table.of(heads, cells).text()))


if __name__ == "__main__":
    main()
