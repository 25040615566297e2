"""Seconds of an epoch in the training kernel in C beside PyTorch's own operations: an encoder, and the innovation network.

    python benchmarks/training.py [--texture towel] [--seconds 28] [--rounds 3] [--csv FILE]

The encoder is the paper's network; the innovation network is that of foten-plus, on innovations that are drawn: the time is the
same. Both on one simulated recording and one thread, in turn, so that a machine that slows down slows both; of all rounds the
quickest counts, and the ratio is what to read. What a training takes in all: `foten train` says so.
"""

import os
from collections.abc import Callable
from unittest.mock import patch

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch

from bench import parser_of, report
from efficiency import epoch_s, in_pytorch
from foten.models.foten_plus.config import FotenPlusConfig
from foten.models.foten_plus.network import InnovationNetwork, Innovations, fit_innovation_network
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.recording.preprocess import preprocess
from foten.recording.split import split_blocks
from foten.simulation.simulate import simulate
from foten.training.job import ScaledBlocks, scaled_blocks
from foten.training.loop import Monitor
from foten.training.reproducible import reproducible


def innovation_epoch_s(blocks: ScaledBlocks) -> float:
    """How long an epoch of the innovation network takes, with its validation [s]."""
    rng, speed = np.random.default_rng(0), blocks.trace.blocks(blocks.trace.speed)
    inputs = rng.standard_normal((*speed.shape, 5))
    data = Innovations(inputs, rng.standard_normal(speed.shape), np.ones(speed.shape), speed, 0, sign_symmetric=True)
    sizes, config = FotenPlusSizes(), FotenPlusConfig(epochs=1, threads=1)
    with reproducible():
        network = InnovationNetwork(sizes)
        return fit_innovation_network(network, data, blocks, sizes.window, config, Monitor()).epochs[-1].seconds


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--texture", default="towel")
    parser.add_argument("--seconds", type=float, default=28.0)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    trace = preprocess(simulate(arguments.texture, arguments.seconds + 4.0))
    blocks = scaled_blocks(trace, split_blocks(trace))
    without = "foten.models.foten_plus.network.hidden_states"
    networks: dict[str, Callable[[], float]] = {
        "encoder, the paper's network": lambda: epoch_s("foten", blocks),
        "innovation network": lambda: innovation_epoch_s(blocks),
    }
    cells = [["network", "in C [s an epoch]", "in PyTorch", "PyTorch's ÷ its"]]
    for name, epoch in networks.items():
        in_c, in_torch = [], []
        for _ in range(arguments.rounds):
            in_c.append(epoch())
            with in_pytorch(), patch(without, lambda unit, inputs: unit(inputs)[0]):
                in_torch.append(epoch())
        quickest, other = min(in_c), min(in_torch)
        cells.append([name, f"{quickest:.2f}", f"{other:.2f}", f"{other / quickest:.2f}"])
    report(cells, arguments.csv)


if __name__ == "__main__":
    main()
