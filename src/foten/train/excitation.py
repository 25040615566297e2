"""The excitation of foten-plus: σ(speed, force) by maximum likelihood, its level settled in the closed loop."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from foten.dsp.level import frame_levels, frame_means
from foten.dsp.noise import gaussian
from foten.models.foten_plus import Excitation, FotenPlus
from foten.recording.scaling import Scaling
from foten.recording.trace import Trace
from foten.render.closed_loop import ClosedLoop
from foten.train.fit import Data

N_SETTLING = 3


def fit_excitation(
    excitation: Excitation, data: Data, scaling: Scaling, residual: NDArray[np.float64], seed: int
) -> float:
    """Fit σ(speed, force) to one-step residuals of the training blocks by Gaussian maximum likelihood.

    Args:
        excitation: fitted in place.
        data: the speed and force that go with each residual are those of the last sample of its window.
        scaling: of speed and force.
        residual: recorded minus predicted, scaled, shape (len(data.train),).
        seed: of the initial weights.

    Returns:
        The mean negative log-likelihood [nat].
    """
    device = excitation.out.weight.device
    condition = torch.from_numpy(data.samples[data.train - 1, 1:]).to(device, torch.float64)
    squared = torch.from_numpy(residual**2).to(device, torch.float64)
    torch.manual_seed(seed)
    excitation.hidden.reset_parameters()
    with torch.no_grad():
        excitation.mean.copy_(torch.tensor(scaling.mean[1:]))
        excitation.sd.copy_(torch.tensor(scaling.sd[1:]))
        excitation.out.weight.zero_()
        excitation.power_law.weight.zero_()
        excitation.highest.fill_(1e6)
        excitation.out.bias.fill_(0.5 * math.log(float(squared.mean()) + 1e-12))
    excitation.double().requires_grad_(True)
    optimiser = torch.optim.LBFGS(
        excitation.parameters(),
        max_iter=60,
        history_size=20,
        line_search_fn="strong_wolfe",
        tolerance_change=1e-7,
    )

    def closure() -> torch.Tensor:
        optimiser.zero_grad()
        sigma = excitation(condition)
        nll = (torch.log(sigma) + squared / (2 * sigma**2)).mean() + 0.5 * math.log(2 * math.pi)
        # Keeps σ smooth where the plane was hardly visited.
        loss = nll + 1e-4 * (excitation.hidden.weight.square().sum() + excitation.out.weight.square().sum())
        loss.backward()
        return loss

    optimiser.step(closure)
    excitation.float().requires_grad_(False)
    excitation.bound(condition.float())
    with torch.no_grad():
        sigma = excitation(condition.float()).double()
        return float((torch.log(sigma) + squared / (2 * sigma**2)).mean()) + 0.5 * math.log(2 * math.pi)


def settle_level(
    network: FotenPlus,
    engine_of: Callable[[FotenPlus], Any],
    data: Data,
    trace: Trace,
    blocks: tuple[int, ...],
    seed: int,
) -> list[float]:
    """Adjust σ until the closed loop is as loud as the recording, at every speed and force.

    A likelihood measures the error of one step. In the closed loop the predictor filters the excitation, and small errors
    of its resonances, or innovations that come in bursts, change the level by several dB (measured: +3.6 dB on the real fabric).
    The level in dB is nearly linear in log σ. So the frames' level errors are regressed on the logarithms of speed and force, and
    what is found is taken off σ's constant and exponents; three times over.

    Args:
        network: its excitation is adjusted in place.
        engine_of: what renders the network.
        data: scaled samples and window.
        trace: for block length and rate.
        blocks: training and validation blocks; the loop runs under their speed and force, the first fifth not counted.
        seed: of the excitation.

    Returns:
        The mean level error before each adjustment [dB].
    """
    m, picked, rate = data.window, list(blocks), trace.rate_hz
    by_block = data.samples.reshape(trace.n_blocks, trace.block, 3)[picked]
    settled = round(0.2 * trace.block)
    recorded = by_block[:, settled:, 0]
    reference = float(np.sqrt(np.square(recorded).mean()))
    level = frame_levels(recorded, rate, reference)
    noise = np.stack([gaussian(seed, stream, 0, trace.block - m) for stream in range(len(picked))])
    means = np.stack([frame_means(by_block[:, settled:, channel], rate) for channel in (1, 2)], axis=-1)
    logs = network.excitation.logarithms(torch.from_numpy(means.reshape(-1, 2)).float()).double().numpy()
    # Ridge: a recording at one condition has no slopes to adjust.
    design = np.concatenate([np.ones((len(logs), 1)), logs], axis=1)
    gram = design.T @ design + 0.01 * len(logs) * np.diag([0.0, 1.0, 1.0])
    errors = []
    for _ in range(N_SETTLING):
        engine = engine_of(network)
        loop = ClosedLoop(engine, engine.sigma, by_block[:, :m].copy())
        rendered = loop.run(by_block[:, m:, 1:], noise)[:, settled - m :]
        error = (frame_levels(rendered, rate, reference) - level).ravel()
        errors.append(float(error.mean()))
        step = -np.linalg.solve(gram, design.T @ error) * math.log(10) / 20
        step = np.clip(step, -1.0, 1.0)
        with torch.no_grad():
            network.excitation.out.bias += float(step[0])
            network.excitation.power_law.weight += torch.from_numpy(step[None, 1:]).float()
        network.excitation.bound(torch.from_numpy(data.samples[data.train - 1, 1:]).float())
    return errors
