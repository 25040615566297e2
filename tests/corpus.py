"""The smallest texture files of each kind, for the fuzzer to begin with, and for tests of the kernel.

PYTHONPATH=tests python tests/corpus.py DIR
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from conftest import exported, recorded
from foten.models.texture_file import Texture
from foten.models.trainable import TRAINABLE

TINY = {"window": 3, "d_model": 1, "n_heads": 1, "n_layers": 1, "d_feedforward": 1, "head": (1, 1), "spectral_width": 1}
PLUS = {"window": 3, "n_hidden": 1, "head_width": 1, "n_components": 2, "excitation_width": 1, "order": 2}
TEN = {name: size for name, size in TINY.items() if name != "spectral_width"}
FNN = {"window": 24, "n_lags": 1, "first": 1, "second": 1}
EXCITED = {"excitation": True, "excitation_width": 1}
KINDS = {
    "foten": ("foten", TINY),
    "foten-wide": ("foten", {**TINY, "spectral_width": 2, "bins": "half"}),
    "foten-post": ("foten", {**TINY, "pre_norm": False, "n_layers": 2}),
    "ten": ("ten", TEN),
    "ar": ("ar", {"order": 3, "n_models": 4, "n_triangles": 3, "window": 4}),
    "ar-zeros": ("ar", {"order": 2, "ma": 3, "n_models": 5, "n_triangles": 4, "window": 9}),
    "plus": ("foten-plus", PLUS),
    "plus-table": ("foten-plus", {**PLUS, "n_speed": 2, "n_force": 2, "gain_before_filter": True}),
    "ten-excited": ("ten", {**TEN, **EXCITED}),
    "graph": ("fnn", FNN),
    "graph-excited": ("fnn", {**FNN, **EXCITED}),
    "graph-noise": ("dftnet", {"window": 8, "n_conditions": 1, "first": 1, "second": 1, "third": 1}),
    "plus-recorded": ("foten-plus", {**PLUS, "n_tones": 1, "recorded": True, "along_path": True, "equalised": True}),
    "plus-tones": ("foten-plus", {**PLUS, "n_tones": 1, "n_tone_speed": 2, "residual_order": 3}),
}


def write_corpus(folder: Path) -> list[Path]:
    """Write the files into a folder, and return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, (key, sizes) in KINDS.items():
        stored = recorded(n=40).tensors() if "recorded" in sizes else None
        texture = exported(key, TRAINABLE[key].sizes(**sizes), stored)
        if "graph" in texture.tensors:  # which the kernel does not read
            texture = Texture(texture.card, {**texture.tensors, "graph": np.zeros(4, dtype=np.uint8)})
        paths.append(folder / f"{name}.foten")
        paths[-1].write_bytes(texture.to_bytes())
    return sorted(paths)


if __name__ == "__main__":
    write_corpus(Path(sys.argv[1]))
