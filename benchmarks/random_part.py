"""What the network of innovations costs: foten-plus trained and rendered with noise in its place, with it, and on its own output.

    python benchmarks/random_part.py [--textures artificial-grass sawn-wood] [--seconds 64] [--threads 1] [--csv FILE]

Each is trained on the same simulated recording and split; times are wall times of the whole training, the median sample called
one by one from Python under a hand that moves, and the median sample of blocks of 10 ms. Ratios are to noise.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import numpy as np

from foten.datasets.simulate import simulate
from foten.families import sizes_of
from foten.runtime.bench import time_steps
from foten.runtime.native import NativeState, NativeTexture
from foten.train.config import recipe_of
from foten.train.job import TrainingJob
from foten.train.pipeline import train
from report import add_csv, report

METHODS = {"noise": {"epochs": 0}, "network": {"own_output": False}, "on its own output": {}}
N_STEPS, N_BLOCKS, BLOCK_S = 20_000, 1000, 0.01
HEADING = (
    "texture",
    "random part",
    "training [s]",
    "÷ noise",
    "one sample [µs]",
    "in blocks [µs]",
    "÷ noise in blocks",
    "file [kB]",
)


def block_us(path: Path) -> float:
    """Return the mean time of a sample in blocks of 10 ms [µs], the median of all blocks."""
    texture = NativeTexture(path.read_bytes())
    state = NativeState(texture)
    out = np.empty(round(BLOCK_S * texture.info.rate_hz), dtype=np.float32)
    times = []
    for speed in np.interp(np.sin(np.linspace(0, 20, N_BLOCKS)), [-1, 1], texture.info.trained_speed):
        state.set_condition(speed, float(np.mean(texture.info.trained_force)))
        begin = time.perf_counter_ns()
        state.render(out)
        times.append((time.perf_counter_ns() - begin) / 1000 / out.size)
    return float(np.median(times))


def main() -> None:
    """Train, time and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--textures", nargs="+", default=["artificial-grass", "sawn-wood"])
    parser.add_argument("--seconds", type=float, default=64.0, help="of each recording")
    parser.add_argument("--threads", type=int, default=1)
    add_csv(parser)
    asked = parser.parse_args()
    rows: list[tuple[str, ...]] = [HEADING]
    with tempfile.TemporaryDirectory() as folder:
        for key in asked.textures:
            recording = simulate(key, asked.seconds, seed=1)
            of_noise: tuple[float, float] | None = None
            for name, changed in METHODS.items():
                config = recipe_of("foten-plus", threads=asked.threads, seed=1, **changed)
                print(f"{key}: {name} …", file=sys.stderr, flush=True)
                began = time.perf_counter()
                job = TrainingJob(recording, "foten-plus", sizes_of("foten-plus", {}), config, split_seed=1)
                trained = train(job)
                seconds = time.perf_counter() - began
                path = Path(folder) / f"{key}.foten"
                path.write_bytes(trained.texture.to_bytes())
                one, in_blocks = time_steps(path, N_STEPS).p50_us, block_us(path)
                of_noise = of_noise or (seconds, in_blocks)
                ratios = seconds / of_noise[0], in_blocks / of_noise[1]
                size = path.stat().st_size / 1000
                rows.append(
                    (
                        *(key, name, f"{seconds:.0f}", f"{ratios[0]:.1f}", f"{one:.2f}", f"{in_blocks:.2f}"),
                        *(f"{ratios[1]:.1f}", f"{size:.0f}"),
                    )
                )
    report(rows, asked.csv)


if __name__ == "__main__":
    main()
