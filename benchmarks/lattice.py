"""What a sample of the lattice costs in NumPy, all sections at once beside section by section; a minute.

    python benchmarks/lattice.py [--order 240] [--samples 400]

Both run the same lattice on the same innovations, in turn, block by block; what they render is compared. Figures: the median over
blocks of the time of a sample, and of the ratio. The reflections differ from sample to sample, as under a hand.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from foten.dsp.lattice import LEAK, predict, push

N_STREAMS = (1, 60, 200)
N_BLOCKS = 9


def at_once(states: np.ndarray, reflections: np.ndarray, innovation: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the states after a sample, shape (p, s), and that sample, shape (s,)."""
    predicted, gain = predict(states, reflections)
    x = predicted + gain * innovation
    return push(states, reflections, x)[0], x


def by_section(states: np.ndarray, reflections: np.ndarray, innovation: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the same, from the recursion as it stands in `foten.dsp.lattice`."""
    after = np.empty_like(states)
    f = innovation
    for i in range(len(states) - 1, -1, -1):
        k, b = reflections[i], LEAK * states[i]
        cosine = np.sqrt(1 - k * k)
        if i + 1 < len(states):
            after[i + 1] = k * f + cosine * b
        f = cosine * f - k * b
    after[0] = f
    return after, f


def seconds_of(
    step: Callable[..., tuple[np.ndarray, ...]], states: np.ndarray, reflections: np.ndarray, noise: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the time of a sample [s], the states after the block and what was rendered, shape (n, s)."""
    rendered = np.empty_like(noise)
    begin = time.perf_counter()
    for n, innovation in enumerate(noise):
        states, rendered[n] = step(states, reflections[n % len(reflections)], innovation)
    return (time.perf_counter() - begin) / len(noise), states, rendered


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--order", type=int, default=240)
    parser.add_argument("--samples", type=int, default=400, help="in a block")
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    print("streams   section by section [µs]   at once [µs]   ratio")
    for n_streams in N_STREAMS:
        reflections = rng.uniform(-0.3, 0.3, (16, arguments.order, n_streams))
        states = np.zeros((arguments.order, n_streams))
        times = []
        for _ in range(N_BLOCKS):
            noise = rng.standard_normal((arguments.samples, n_streams))
            slow, after, expected = seconds_of(by_section, states, reflections, noise)
            fast, _, rendered = seconds_of(at_once, states, reflections, noise)
            np.testing.assert_allclose(rendered, expected, rtol=1e-7, atol=1e-9)
            states = after
            times.append((slow, fast))
        slow, fast = np.median(times, axis=0)
        ratio = np.median([a / b for a, b in times])
        print(f"{n_streams:7d} {1e6 * slow:25.1f} {1e6 * fast:14.1f} {ratio:7.1f}", flush=True)


if __name__ == "__main__":
    main()
