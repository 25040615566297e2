"""Cost of a sample of edited, rougher, transferred and blended textures, beside that of the textures that they were made from.

    python benchmarks/edited.py

One core, the textures' own rate, blocks of half a second in turn; medians of ratios.
"""

from __future__ import annotations

import itertools
import os
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from foten.editing.blend import blend
from foten.editing.edit import Edit, edited
from foten.editing.envelope import with_envelope
from foten.editing.tool import Transfer, transferred
from foten.models.texture_file import Texture, read_texture
from foten.reporting.table import Table
from foten.runtime.renderer import EXAMPLE, Renderer

N_ROUNDS, N = 60, 500
HZ = tuple(20.0 * 2 ** (np.arange(28) / 6))
TOOL = Transfer("a", "b", HZ, tuple(np.linspace(6.0, -12.0, 28).tolist()), (0.5,) * 28, 100.0, 0.7)


def costs(textures: dict[str, Texture]) -> dict[str, np.ndarray]:
    """Times of a sample [µs] of each texture, in turn, (N_ROUNDS,)."""
    renderers = {name: Renderer(texture) for name, texture in textures.items()}
    speed, force = 100 + 50 * np.sin(np.arange(N) / 60), 1 + 0.4 * np.sin(np.arange(N) / 90)
    times: dict[str, list[float]] = {name: [] for name in textures}
    for _ in range(N_ROUNDS):
        for name, renderer in renderers.items():
            before = time.perf_counter()
            renderer.render(speed, force)
            times[name].append(1e6 * (time.perf_counter() - before) / N)
    return {name: np.array(each) for name, each in times.items()}


def main() -> None:
    plain = {
        path.stem: read_texture(path)
        for path in sorted(EXAMPLE.parent.glob("*.foten"))
        if not path.stem.endswith("_ar")
    }
    cells = []
    for name, texture in plain.items():
        changed = {"plain": texture, "edited": edited(texture, Edit(level_db=3, brighter=0.3)).texture}
        changed["transferred"] = transferred(texture, TOOL)
        changed["rougher"] = with_envelope(texture, 0.5)
        each = costs(changed)
        ratios = (float(np.median(each[kind] / each["plain"])) for kind in ("edited", "transferred", "rougher"))
        cells.append((name, f"{np.median(each['plain']):.2f}", *(f"{ratio:.2f}" for ratio in ratios)))
    print(
        "\n".join(
            Table.of(
                ("texture", "plain [µs]", "edited ÷ plain", "transferred ÷ plain", "rougher ÷ plain"), cells
            ).text()
        )
    )
    cells = []
    for first, second in itertools.combinations(plain, 2):
        each = costs({"a": plain[first], "b": plain[second], "blend": blend(plain[first], plain[second], 0.4)})
        dearer = np.maximum(each["a"], each["b"])
        cells.append((f"{first}–{second}", f"{np.median(each['blend'] / dearer):.2f}"))
    print("\n".join(Table.of(("blend", "÷ the dearer of the two"), cells).text()))


if __name__ == "__main__":
    main()
