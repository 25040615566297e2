"""From nothing to the first sample: a wheel installed into a fresh environment without a compiler, beside NumPy alone.

    python benchmarks/install.py dist/foten-….whl [--repeats 3] [--csv FILE]

A wheel brings NumPy with it, so what NumPy costs alone is the least that it can cost. The time is the clock's: `pip install` from
the index that pip is set to, then the first import and the first sample (NumPy: the first import). Environments are made before.
The ratio is the median over pairs that follow each other.
"""

import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path

from bench import ROOT, parser_of, report

FIRST = {"numpy": "import numpy", "foten": "import foten; foten.Renderer(foten.EXAMPLE).render(80.0, 0.8, 1)"}


def run(environment: Path, *arguments: str | Path) -> str:
    """Run the environment's Python with nothing else in the path and return what it prints."""
    folder = environment / ("Scripts" if os.name == "nt" else "bin")
    found = [name for name in ("cc", "gcc", "clang", "zig", "cmake") if shutil.which(name, path=str(folder))]
    if found:
        sys.exit(f"{folder}: has {', '.join(found)}, expected no compiler")
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "CC")}
    command = [str(folder / "python"), *map(str, arguments)]
    done = subprocess.run(
        command, env={**environment, "PATH": str(folder)}, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        sys.exit(done.stderr.strip())
    return done.stdout


def seconds(environment: Path, wanted: str, first: str) -> float:
    """How long installing and the first use take."""
    venv.create(environment, with_pip=True)
    begin = time.perf_counter()
    pip = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--only-binary", ":all:")
    run(environment, *pip, "--constraint", ROOT / "constraints.txt", wanted)
    run(environment, "-c", first)
    return time.perf_counter() - begin


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("wheel", type=Path, help="this system's, of 'make wheels'")
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    wheel = arguments.wheel
    if not wheel.is_file():
        parser.error(f"{wheel}: no such file, expected a wheel of this system, of 'make wheels'")
    times: dict[str, list[float]] = {"numpy": [], "foten": []}
    with tempfile.TemporaryDirectory() as folder:
        for repeat in range(arguments.repeats):
            for name, wanted in (("numpy", "numpy"), ("foten", str(wheel.resolve()))):
                environment = Path(folder) / f"{name}-{repeat}"
                times[name].append(seconds(environment, wanted, FIRST[name]))
        sizes = json.loads(run(environment, ROOT / "packages/foten/native" / "tests" / "installed.py"))
    ratios = [ours / theirs for ours, theirs in zip(times["foten"], times["numpy"], strict=True)]
    cells = [["", "install to first use [s]", "÷ NumPy", "installed [MB]"]]
    rows = (("NumPy alone", "numpy", 1.0, "numpy_bytes"), ("foten with NumPy", "foten", statistics.median(ratios), ""))
    for title, name, ratio, size in rows:
        both = sizes[size] if size else sizes["bytes"] + sizes["numpy_bytes"]
        cells.append([title, f"{statistics.median(times[name]):.1f}", f"{ratio:.2f}", f"{both / 1e6:.1f}"])
    report(cells, arguments.csv)
    print(f"\nThe wheel: {wheel.stat().st_size / 1e6:.2f} MB, {sizes['bytes'] / 1e6:.1f} MB installed.")


if __name__ == "__main__":
    main()
