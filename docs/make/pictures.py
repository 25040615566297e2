"""Make the pictures and sounds of README.md and docs/, each from measured figures or from a simulation made on the spot.

    python docs/make/pictures.py [--only NAME,...] [--recordings DIR] [--sweep DIR DIR]

Figures are read from docs/results. Textures that a picture shows are trained once, into build/pictures. DIR of `--recordings`
holds the real recordings, for the picture `rates`; those of `--sweep` are what `foten sweep table-1` and `foten sweep
table-1-tuned` wrote, for `compared` and the paper's Fig. 6 and 7.
"""

import argparse
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import drawing
import result_pictures as results
import simulated_pictures as simulated
from csv_records import parser_of

PICTURES: dict[str, Callable[[argparse.Namespace], Any]] = {
    "stroke": simulated.stroke,
    "foten": drawing.foten_diagram,
    "foten-plus": drawing.foten_plus_diagram,
    "one-step": simulated.one_step,
    "silence": simulated.silence,
    "ceiling": results.ceiling,
    "bound": simulated.bound,
    "limits": results.limits,
    "outside": results.outside,
    "abrupt": results.abrupt,
    "rates": simulated.rates,
    "listener": results.listener,
    "impact": simulated.impact,
    "lengths": results.lengths,
    "compared": results.compared,
    "figure-5": results.figure_5,
    "figure-6": results.figure_6,
    "figure-7": results.figure_7,
    "capture": simulated.capture,
}
"""What draws a picture, or writes a sound alone, by name."""
FEW_COLOURS = {**dict.fromkeys(("one-step", "impact", "figure-6", "capture"), 24), "listener": 12, "lengths": 12}


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--recordings", type=Path, default=Path("recordings"))
    tables = [Path("results") / name for name in ("table-1", "table-1-tuned")]
    parser.add_argument("--sweep", type=Path, nargs="+", default=tables)
    parser.add_argument("--only", type=lambda text: text.split(","), default=list(PICTURES))
    arguments = parser.parse_args()
    for name in arguments.only:
        if (picture := PICTURES[name](arguments)) is not None:
            drawing.save(picture, name, FEW_COLOURS.get(name, drawing.N_COLOURS))


if __name__ == "__main__":
    main()
