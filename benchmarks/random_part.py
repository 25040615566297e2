"""What the innovation network costs: foten-plus with noise in its place, with it, and trained in the closed loop.

    python benchmarks/random_part.py [--textures artificial-grass sawn-wood] [--seconds 64] [--threads 1] [--csv FILE]

Each is trained on the same simulated recording and split; times are wall times of the whole training, the median sample called
one by one from Python under a hand that moves, and the median sample of blocks of 10 ms. Ratios are to noise.

A second table has what a step of training takes on one thread, medians of 20 in turn: of likelihood, the network's recurrent unit
being PyTorch's or the kernel's, and of closed-loop roll-outs, forward and back.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import numpy as np
import torch
from torch import Tensor

from foten.baselines.sizes import trainable_sizes
from foten.models.foten_plus.closed_loop_training import EXCERPT_S, N_EXCERPTS
from foten.models.foten_plus.network import CHUNK, InnovationNetwork, mixtures, negative_log_likelihood
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.runtime.bench import time_steps
from foten.runtime.native import NativeState, NativeTexture
from foten.simulation.simulate import simulate
from foten.training.config import recipe_of
from foten.training.job import TrainingJob
from foten.training.pipeline import train
from foten.training.training_kernel import WEIGHT_NAMES, Rollout, RolloutInputs, RolloutState
from result_table import add_csv, report

METHODS = {"noise": {"epochs": 0}, "network": {"closed_loop_training": False}, "closed loop": {}}
N_STEPS, N_BLOCKS, BLOCK_S = 20_000, 1000, 0.01
N_TIMED = 20
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
    """The mean time of a sample in blocks of 10 ms [µs], the median of all blocks."""
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


def step_ms() -> list[tuple[str, ...]]:
    """A table of what steps of training take [ms], in batches as training has them."""
    torch.set_num_threads(1)
    sizes, batch = trainable_sizes("foten-plus", {}), recipe_of("foten-plus").batch
    assert isinstance(sizes, FotenPlusSizes)
    network = InnovationNetwork(sizes)
    inputs, follows = torch.randn(batch, sizes.window + CHUNK, 5), torch.randn(batch, sizes.window + CHUNK)

    def likelihood(mixture: Callable[[], tuple[Tensor, Tensor, Tensor]]) -> None:
        torch.autograd.grad(negative_log_likelihood(mixture(), follows).mean(), list(network.parameters()))

    rng, s, n, p = np.random.default_rng(0), 2 * N_EXCERPTS, round(1000 * EXCERPT_S), 40
    parts = (rng.uniform(-0.5, 0.5, (n, p, s)), np.ones((s, n)), np.zeros((s, n, 2)))
    around = RolloutInputs(*(part.astype(np.float32) for part in parts), False, 20.0)
    begin = RolloutState(*(np.zeros((s, k), np.float32) for k in (p, sizes.n_hidden, 5)))
    weights = {name: dict(network.named_parameters())[name].detach().numpy() for name in WEIGHT_NAMES}
    loss = np.ones((s, n), np.float32)
    steps: dict[str, Callable[[], object]] = {
        "likelihood, PyTorch's unit": lambda: likelihood(lambda: network(inputs)),
        "likelihood, the kernel's": lambda: likelihood(lambda: mixtures(network, inputs)),
        "roll-outs": lambda: Rollout(weights, around, begin, rng).gradients(loss),
    }
    times: dict[str, list[float]] = {name: [] for name in steps}
    for _ in range(N_TIMED):
        for name, step in steps.items():
            began = time.perf_counter()
            step()
            times[name].append(1000 * (time.perf_counter() - began))
    peer = float(np.median(times["likelihood, PyTorch's unit"]))
    middle = {name: float(np.median(values)) for name, values in times.items()}
    rows = [(name, f"{us:.0f}", f"{us / peer:.2f}") for name, us in middle.items()]
    return [("step of training", "ms", "÷ PyTorch's unit"), *rows]


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
                job = TrainingJob(recording, "foten-plus", trainable_sizes("foten-plus", {}), config, split_seed=1)
                trained = train(job)
                seconds = time.perf_counter() - began
                path = Path(folder) / f"{key}.foten"
                path.write_bytes(trained.texture.to_bytes())
                step_us, block_sample_us = time_steps(path, N_STEPS).p50_us, block_us(path)
                of_noise = of_noise or (seconds, block_sample_us)
                ratios = seconds / of_noise[0], block_sample_us / of_noise[1]
                size = path.stat().st_size / 1000
                rows.append(
                    (
                        *(key, name, f"{seconds:.0f}", f"{ratios[0]:.1f}", f"{step_us:.2f}", f"{block_sample_us:.2f}"),
                        *(f"{ratios[1]:.1f}", f"{size:.0f}"),
                    )
                )
    report(rows, asked.csv)
    print()
    report(step_ms(), None)


if __name__ == "__main__":
    main()
