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
KEPT = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the fitted shape of log σ


def fit_excitation(
    excitation: Excitation, data: Data, scaling: Scaling, residual: NDArray[np.float64], seed: int
) -> float:
    """Fit σ(speed, force) to one-step residuals by Gaussian maximum likelihood.

    The shape of log σ over speed and force is fitted on the training blocks, and how much of it is kept, from none to all, is
    chosen by the likelihood of the validation blocks: in a recording of two seconds the differences between blocks are
    mostly chance. It did not cure the level errors of the real wood (−4.4 dB on one split before and after).

    Args:
        excitation: fitted in place.
        data: the speed and force that go with each residual are those of the last sample of its window.
        scaling: of speed and force.
        residual: recorded minus predicted at the training, then the validation indices, scaled,
            shape (len(data.train) + len(data.validation),).
        seed: of the initial weights.

    Returns:
        The mean negative log-likelihood of the validation blocks [nat].
    """
    device = excitation.out.weight.device
    n = np.concatenate([data.train, data.validation])
    condition = torch.from_numpy(data.samples[n - 1, 1:]).to(device, torch.float64)
    squared = torch.from_numpy(residual**2).to(device, torch.float64) + 1e-12
    train, validation = slice(0, len(data.train)), slice(len(data.train), None)
    torch.manual_seed(seed)
    excitation.hidden.reset_parameters()
    with torch.no_grad():
        excitation.mean.copy_(torch.tensor(scaling.mean[1:]))
        excitation.sd.copy_(torch.tensor(scaling.sd[1:]))
        excitation.out.weight.zero_()
        excitation.power_law.weight.zero_()
        excitation.highest.fill_(1e6)
        excitation.out.bias.copy_(0.5 * torch.log(squared[train].mean(dim=0, keepdim=True)))
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
        loss = _likelihood(excitation(condition[train]), squared[train])
        # Keeps σ smooth where the plane was hardly visited.
        loss = loss + 1e-4 * (excitation.hidden.weight.square().sum() + excitation.out.weight.square().sum())
        loss.backward()
        return loss

    optimiser.step(closure)
    excitation.requires_grad_(False)
    shape = torch.log(excitation(condition)) - excitation.out.bias
    found = []
    for kept in KEPT:
        # The scale that maximises the likelihood of a given shape, in closed form.
        scale = torch.sqrt((squared[train] * torch.exp(-2 * kept * shape[train])).mean())
        nll = _likelihood(scale * torch.exp(kept * shape[validation]), squared[validation])
        found.append((float(nll), kept, math.log(float(scale))))
    nll, kept, log_scale = min(found)
    excitation.out.weight.mul_(kept)
    excitation.power_law.weight.mul_(kept)
    excitation.out.bias.fill_(log_scale)
    excitation.float()
    excitation.bound(condition[train].float())
    return nll


def _likelihood(sigma: torch.Tensor, squared: torch.Tensor) -> torch.Tensor:
    """Return the mean Gaussian negative log-likelihood [nat] of squared residuals."""
    return (torch.log(sigma) + squared / (2 * sigma**2)).mean() + 0.5 * math.log(2 * math.pi)


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
    The level in dB is nearly linear in log σ. So the frames' level errors are regressed on the logarithms of speed and force and
    their squares, and what is found is taken off σ's; three times over.

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
    # Ridge: a recording at one condition has no slopes to adjust, one that varies (log-variance 0.5 and more) has.
    design = np.concatenate([np.ones((len(logs), 1)), logs], axis=1)
    gram = design.T @ design + 0.05 * len(logs) * np.diag([0.0, 1.0, 1.0, 1.0, 1.0, 1.0])
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
