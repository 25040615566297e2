"""The word vectors that come along, src/foten/editing/words.npz: GloVe 6B of 50 numbers, trimmed.

    python docs/make/word_vectors.py glove.6B.50d.txt

The file is in https://nlp.stanford.edu/data/glove.6B.zip (J. Pennington, R. Socher and C. D. Manning, "GloVe: Global vectors for
word representation", 2014), under the Public Domain Dedication and License 1.0. Kept are the most frequent words of letters, and
words of surfaces that are rarer; each vector as 8 bits and a scale.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import numpy as np

from foten.atomic_write import atomic_write
from foten.editing.words import TABLE

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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, help="glove.6B.50d.txt")
    wanted, table = set(SURFACES.split()), dict[str, list[float]]()
    with parser.parse_args().file.open(encoding="utf-8") as lines:
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


if __name__ == "__main__":
    main()
