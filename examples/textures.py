"""Train the textures that come with foten, on simulated recordings, and write them where the package has them.

    python examples/textures.py [KEY]…

A minute each on one core. Their networks are two thirds as wide as usual, since the files come with every installation. One comes
a second time as the piecewise AR model has it, so that the page has two methods to compare.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import foten

OUT = Path(foten.EXAMPLE).parent
SMALL = ("--set", "n_hidden=32", "--set", "head_width=32")
CREDIT = ("--source", "simulated", "--licence", "CC0-1.0")
KEYS = ("artificial-grass", "jeans", "steel-mesh-1", "textured-rubber", "towel")
COMPARED, OTHER = "steel-mesh-1", "ar"
LARGEST = 500_000  # bytes


def main() -> None:
    for key in sys.argv[1:] or KEYS:
        with tempfile.TemporaryDirectory() as folder:
            recording, texture = Path(folder) / f"{key}.h5", OUT / f"{key}.foten"
            command = [Path(sys.executable).with_name("foten")]
            subprocess.run([*command, "simulate", key, "--seconds", "64", "--seed", "3", "-o", recording], check=True)
            run = ["--run", Path(folder) / "run"]
            subprocess.run([*command, "train", recording, "-o", texture, *SMALL, *run, *CREDIT], check=True)
            if key == COMPARED:
                other = OUT / f"{key}_{OTHER}.foten"
                subprocess.run([*command, "train", recording, "-o", other, "--model", OTHER, *CREDIT], check=True)
        if texture.stat().st_size > LARGEST:
            sys.exit(f"{texture.name} has {texture.stat().st_size} bytes, expected {LARGEST} at most")


if __name__ == "__main__":
    main()
