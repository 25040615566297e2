"""Render with the installed package, whatever system it is on, and print one line of JSON.

    python packages/foten/native/tests/installed.py

What is printed: seconds from the first import to the first sample, the instruction sets that this processor has and how far their
renderings are from one another over the largest sample, the bytes of the package and those of NumPy.
"""

import time

begin = time.perf_counter()

import json  # noqa: E402
import os  # noqa: E402
import subprocess  # noqa: E402
import sys  # noqa: E402
from importlib.metadata import files  # noqa: E402

import numpy as np  # noqa: E402

import foten  # noqa: E402
from foten.runtime.binding import isa, library  # noqa: E402
from foten.runtime.renderer import EXAMPLE  # noqa: E402

rendered = foten.Renderer(EXAMPLE).render(80.0, 0.8, 1)
first_s = time.perf_counter() - begin


def installed_bytes(package: str) -> int:
    """Size of a package's files, without those that Python compiled."""
    paths = [path.locate() for path in files(package) or [] if "__pycache__" not in path.parts]
    return sum(os.path.getsize(path) for path in paths)


if __name__ == "__main__":
    stroke = foten.Renderer(EXAMPLE).render(np.linspace(20.0, 200.0, 500), np.full(500, 0.8))
    if "--stroke" in sys.argv[1:]:
        print(json.dumps([isa(), stroke.tolist()]))
        sys.exit()
    sets, worst = set(), 0.0
    for name in ("avx512", "avx2", "neon", "portable"):
        command = [sys.executable, __file__, "--stroke"]
        out = subprocess.run(command, env={**os.environ, "FOTEN_ISA": name}, capture_output=True, text=True, check=True)
        used, samples = json.loads(out.stdout)
        sets.add(used)
        worst = max(worst, float(np.abs(np.array(samples) - stroke).max() / np.abs(stroke).max()))
    assert np.abs(stroke).max() > 0
    assert {"portable"} < sets, f"this processor's vectors are not used, only {sets}"
    result = {
        "version": foten.__version__,
        "library": str(library()._name),
        "isas": sorted(sets),
        "worst": worst,
        "first_s": first_s,
        "bytes": installed_bytes("foten"),
        "numpy_bytes": installed_bytes("numpy"),
    }
    print(json.dumps(result))
