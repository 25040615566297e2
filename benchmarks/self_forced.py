"""Fine-tuning of foten-plus on its own output, an ingredient of `fidelity.py`: a spectral and level loss through the closed loop.

The network is unrolled on its own output, excited but for the swell, under recorded speed and force, for `N_HEARD` samples after
`N_WARM` without gradient. Its spectrum and level are compared with those recorded there, pooled over streams of alike speed: two
single realisations differ by chance, and a network that is to hit one of them learns to have no scatter of its own. Its one-step
loss is added, so that it goes on predicting. Lattice and excitation stay, and the excitation is fitted anew afterwards.
"""

from __future__ import annotations

import copy
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import foten.train.train as train_module
import numpy as np
import torch
from foten.train.prepared import Prepared
from torch import Tensor

from foten.networks.foten_plus import FotenPlus
from foten.recording.windows import window_indices
from foten.train.config import TrainConfig
from foten.train.excitation import fit_excitation, free_run_distance
from foten.train.fit import Data, predict

N_UPDATES = 60
N_STREAMS, N_GROUPS = 32, 4
N_WARM, N_HEARD = 64, 128
RESOLUTIONS = (16, 32, 64, 128)  # samples of a transform
LEARNING_RATE = 3e-4
ONE_STEP_WEIGHT = 4.0  # over a neper of spectrum or level
LISTENED = 15  # updates between two looks at the validation blocks
MAY_LOSE = 1.005  # times the one-step error before


def fine_tune(
    network: FotenPlus, random: Data, prepared: Prepared, seed: int
) -> list[tuple[float, float, float]]:
    """Fine-tune a network in place, and leave it where its free run was nearest the validation blocks.

    Of those looks whose one-step error is at most `MAY_LOSE` of what it was. Returns (one-step mean absolute error [innovations],
    log-spectral distance [dB], level error [dB]) of the validation blocks at each look, the first before any update.
    """
    draw = np.random.default_rng(seed)
    torch.manual_seed(seed)
    by_block = torch.from_numpy(prepared.samples).float()
    m, train, block_length = (
        network.architecture.history,
        np.array(prepared.split.train),
        prepared.trace.block,
    )
    optimiser = torch.optim.Adam(network.network.parameters(), lr=LEARNING_RATE)
    flat, goal = torch.from_numpy(random.samples).float(), torch.from_numpy(random.target).float()
    offsets = torch.from_numpy(window_indices(np.zeros(1, dtype=np.int64), random.window))
    looks: list[tuple[float, float, float]] = []
    best = copy.deepcopy(network.network.state_dict())

    def look() -> tuple[float, float, float]:
        missed = random.target[random.validation] - predict(network.network, random, random.validation)
        free = free_run_distance(network, prepared, prepared.split.validation, seed)
        return float(np.abs(missed).mean()), *free

    looks.append(look())
    for update in range(1, N_UPDATES + 1):
        block = draw.choice(train, N_STREAMS)
        first = draw.integers(0, block_length - m - N_WARM - N_HEARD, N_STREAMS)
        cut = torch.stack(
            [by_block[b, f : f + m + N_WARM + N_HEARD] for b, f in zip(block, first, strict=True)]
        )
        cut = cut[torch.argsort(cut[..., 1].mean(dim=1))]
        played = _played(network, cut, m)
        loss = _distance(played, cut[:, -N_HEARD:, 0])
        chosen = torch.from_numpy(draw.choice(random.train, 256))
        ahead = network.network(flat[chosen[:, None] + offsets])
        loss = loss + ONE_STEP_WEIGHT * torch.nn.functional.huber_loss(ahead, goal[chosen], delta=1.6)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.network.parameters(), 1.0)
        optimiser.step()
        if update % LISTENED == 0:
            looks.append(look())
            print(f"  update {update}: {looks[-1]}", file=sys.stderr, flush=True)
            allowed = [seen for seen in looks if seen[0] <= MAY_LOSE * looks[0][0]]
            if looks[-1] in allowed and looks[-1][1] == min(seen[1] for seen in allowed):
                best = copy.deepcopy(network.network.state_dict())
    network.network.load_state_dict(best)
    return looks


def _played(network: FotenPlus, cut: Tensor, m: int) -> Tensor:
    """Return the last N_HEARD samples of the closed loop under recorded speed and force (s, m + warm + heard, 3)."""
    excitation = network.excitation
    with torch.no_grad():
        heard = network.start(cut[:, :m])
    out = []
    for n in range(m, cut.shape[1]):
        with torch.set_grad_enabled(n >= m + N_WARM):
            sample, scale = network.forecast(heard)
            noise = torch.randn(len(cut))
            shock = noise * torch.exp(0.5 * excitation.tails(heard.condition) * noise * noise)
            limit = torch.minimum(excitation.largest[0], excitation.largest[1] / scale)
            shock = torch.minimum(torch.maximum(shock, -limit), limit)
            sample = sample + scale * shock
            heard = network.push(heard, sample, cut[:, n, 1:])
            out.append(sample)
    return torch.stack(out[N_WARM:], dim=1)


def _distance(played: Tensor, recorded: Tensor) -> Tensor:
    """Return the mean absolute difference of log spectra and of log levels, pooled over groups of streams [neper]."""
    total = torch.zeros(())
    for n in RESOLUTIONS:
        powers = [
            torch.stft(signal, n, n // 2, window=torch.hann_window(n), center=False, return_complex=True)
            .abs()
            .square()
            .reshape(N_GROUPS, -1, n // 2 + 1, 1 + (N_HEARD - n) // (n // 2))
            .mean(dim=(1, 3))
            for signal in (played, recorded)
        ]
        total = total + (torch.log(powers[0] + 1e-8) - torch.log(powers[1] + 1e-8)).abs().mean()
    levels = [signal.reshape(N_GROUPS, -1).square().mean(dim=1) for signal in (played, recorded)]
    return total / len(RESOLUTIONS) + (torch.log(levels[0]) - torch.log(levels[1])).abs().mean()


@contextmanager
def fine_tuning() -> Iterator[list[tuple[float, float, float]]]:
    """Let `train_texture` fine-tune before it fits the excitation for good; yields what was seen on the way."""
    seen: list[tuple[float, float, float]] = []

    def fit_twice(
        network: FotenPlus, residual: Any, random: Data, prepared: Prepared, config: TrainConfig
    ) -> Any:
        found = fit_excitation(network, residual, random, prepared, config)
        # Neither while linear parts are compared nor where tones are rendered without the network.
        if not network.architecture.network_heard or not network.network.head_3.weight.any():
            return found
        seen[:] = fine_tune(network, random, prepared, config.seed)
        both = np.concatenate([random.train, random.validation])
        left = random.target[both] - predict(network.network, random, both)
        return fit_excitation(network, left, random, prepared, config)

    before = train_module.fit_excitation
    train_module.fit_excitation = fit_twice
    try:
        yield seen
    finally:
        train_module.fit_excitation = before
