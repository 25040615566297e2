"""What words are worth: each texture of a library predicted from its name, its namesakes left out.

    python docs/make/words.py --library DIR [--encoder NAME] [--csv FILE]
    python docs/make/words.py --vectors glove.6B.50d.txt

Spectra in thirds of an octave, at the described condition and, by the powers of speed and force that go with each, at twelve more
(30 to 200 mm/s, 0.3 to 2 N). `sliders` is a parabola in dB over octaves, down to 30 dB below its peak, with the truth's level,
centroid and width: what a user who knows them can set without a library. Figures are means over textures with 95 % intervals;
dB, and octaves.

With --vectors nothing is measured: the word vectors that come along, packages/foten-lab/src/foten_lab/words.npz, are trimmed from
GloVe 6B of 50 numbers. The file is in https://nlp.stanford.edu/data/glove.6B.zip (J. Pennington, R. Socher and C. D. Manning,
"GloVe: Global vectors for word representation", 2014), under the Public Domain Dedication and License 1.0. Kept are the most
frequent words of letters, and words of surfaces that are rarer; each vector as 8 bits and a scale.
"""

import os
import re
from itertools import product
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from csv_records import RESULTS, parser_of
from foten.atomic_write import atomic_write
from foten.dsp.distance import earth_mover_octaves
from foten.dsp.inference import standard_error, student_quantile
from foten.editing.describe import REFERENCE, rendered, spectrum
from foten.editing.texture_library import BANDS_HZ, Entry, bands_db, open_library
from foten.models.texture_file import read_texture
from foten.reporting.table import Table
from foten_lab.words import LAW, TABLE, encoder_of, fit, stem_of, text_of, values_of

CONDITIONS = [REFERENCE, *product((30.0, 60.0, 150.0, 200.0), (0.3, 1.0, 2.0))]
N_BANDS = len(BANDS_HZ)
N_FREQUENT = 20_000
SURFACES = """
acrylic asphalt bamboo bark barkcloth basketry birch bristly brocade brushed bubble bumpy burlap calico cambric canvas
cardboard carpet cashmere chenille chiffon clay coarse cobblestone coir concrete corduroy cork corrugated crepe damask denim
dimpled doormat emery engraved etched felt felted fibreboard fiberboard fibrous flannel fleece flocked fluffy foam fretted
fur furry fuzzy gauze gauzy glazed glossy grainy granite granular gravel gravelly gritty grooved hairy hardboard hemp hessian
jagged jeans jersey jute knit knitted knobby knurled lace laminate laminated leatherette limestone linen linoleum linty
loofah lumpy mahogany marble matte melamine mesh mohair mosaic mottled muslin napped neoprene netting nubby nylon oak organza
oxford parchment patterned pebble pebbled pebbly perforated pine pitted plaid plaster pleated plexiglass plush plywood
polished polyester porous prickly pumice quartz quilted ragged ramie rasp rattan ribbed ridged ripstop rubber rubbery rugged
rugose rusty sandpaper sandstone sandy satin sawn scabrous scaly scored scratchy screen scrubby seersucker serrated shag
shaggy sheepskin shiny sienna silicone silk silky sisal slate sleek slick slippery smooth spiky spongy sponge stipple
stippled straw stubbly stucco styrofoam suede tarpaulin tatami teak terracotta terry textured thorny tile timber towel turf
tweed twill uneven unpolished upholstery vellum velour velvet velveteen velvety veneer vinyl waffle walnut wavy waxed waxy
weave wicker wiry woollen woolen woolly worsted woven wrinkled wrinkly
"""


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
    return student_quantile(len(figures)) * (standard_error(figures) or 0.0)


def write_vectors(path: Path) -> None:
    """Write the vectors of the words that are kept."""
    wanted, table = set(SURFACES.split()), dict[str, list[float]]()
    with path.open(encoding="utf-8") as lines:
        for line in lines:  # the most frequent first
            word, _, numbers = line.partition(" ")
            if re.fullmatch("[a-z]+", word) and (len(table) < N_FREQUENT or word in wanted):
                table[word] = [float(number) for number in numbers.split()]
    words = sorted(table)  # which takes 15 kB less than by frequency, and number by number 6 kB less than word by word
    vectors = np.array([table[word] for word in words])
    scales = (np.abs(vectors).max(axis=1) / 127).astype(np.float16)
    rounded = np.round(vectors / scales[:, None].astype(np.float64)).clip(-127, 127).astype(np.int8)
    arrays = {
        "vectors": np.ascontiguousarray(rounded.T),
        "scales": scales,
        "words": np.frombuffer("\n".join(words).encode(), dtype=np.uint8),
    }
    with atomic_write(TABLE) as part, part.open("wb") as file:
        np.savez_compressed(file, **arrays)
    print(
        f"{len(words)} words, {TABLE.stat().st_size / 1e6:.2f} MB; of surfaces missing: {sorted(wanted - set(words))}"
    )


def main() -> None:
    parser = parser_of(__doc__)
    sources = parser.add_mutually_exclusive_group(required=True)
    sources.add_argument("--library", dest="folder", metavar="DIR", type=Path)
    sources.add_argument("--vectors", metavar="FILE", type=Path, help="glove.6B.50d.txt, to be trimmed")
    parser.add_argument("--encoder", help="a sentence encoder to compare, a folder or a name")
    parser.add_argument("--csv", type=Path, default=RESULTS / "words.csv")
    arguments = parser.parse_args()
    if arguments.vectors:
        return write_vectors(arguments.vectors)
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
    cells = []
    for method, each in rows.items():
        columns = np.array(each).T
        figures = [f"{x:.3f}" for column in columns for x in (column.mean(), interval(column))]
        cells.append([method, str(len(each)), *figures])
    names = ("lsd_db", "lsd_interval", "level_error_db", "level_interval", "emd_octaves", "emd_interval")
    table = Table.of(("method", "textures", *names), cells)
    table.write(arguments.csv)
    print("\n".join(table.text()))


if __name__ == "__main__":
    main()
