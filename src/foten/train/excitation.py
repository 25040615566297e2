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

Array = NDArray[np.float64]

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
    So the levels of frames are compared, and what they miss is taken off log σ, its constant and its terms in log speed and
    log force, by a ridge regression on how each frame answers to each term (`_answers`); three times over.

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
    # Streams of their own: the judge, who counts from 0, must not hear the noise that the level was settled on.
    noise = np.stack([gaussian(seed, 2**32 + k, 0, trace.block - m) for k in range(len(picked))])
    errors = []
    for _ in range(N_SETTLING):
        engine = engine_of(network)
        loop = ClosedLoop(engine, engine.sigma, by_block[:, :m].copy())
        rendered = loop.run(by_block[:, m:, 1:], noise)[:, settled - m :]
        error = (frame_levels(rendered, rate, reference) - level).ravel()
        errors.append(float(error.mean()))
        answers = _answers(network, by_block, settled, rate)
        # Ridge: a recording at one condition has no slopes to adjust, one that varies (log-variance 0.5 and more) has.
        ridge = 0.05 * len(error) * np.diag([0.0, 1.0, 1.0, 1.0, 1.0, 1.0])
        step = -np.linalg.solve(answers.T @ answers + ridge, answers.T @ error) * math.log(10) / 20
        step = np.clip(step, -1.0, 1.0)
        with torch.no_grad():
            network.excitation.out.bias += float(step[0])
            network.excitation.power_law.weight += torch.from_numpy(step[None, 1:]).float()
        network.excitation.bound(torch.from_numpy(data.samples[data.train - 1, 1:]).float())
    return errors


def _answers(network: FotenPlus, by_block: Array, settled: int, rate: float) -> Array:
    """Return by how many dB the level of each frame answers to a dB of each term of log σ, shape (frames, 6).

    Excitation of variance σ² goes through the shortcut as through a filter of impulse response h: the expected power is h² ∗ σ²,
    of which a term f of log σ moves h² ∗ (σ² f); what rings on from the start of a block is heard and answers to nothing. A
    frame at rest, that hears the stroke before, so answers to the speed that it had then. (Regressed on its own
    speed, a linear process kept 0.36 dB of error whatever was adjusted.)
    """
    from scipy import signal

    m = network.architecture.window
    taps = network.shortcut.double().numpy()
    recursion = np.concatenate([[1.0], -taps[::-1]])
    condition = torch.from_numpy(by_block[:, m - 1 : -1, 1:].reshape(-1, 2)).float()
    shape = (by_block.shape[0], by_block.shape[1] - m, -1)
    with torch.no_grad():
        variance = network.excitation(condition).double().numpy().reshape(shape) ** 2
        terms = network.excitation.logarithms(condition).double().numpy().reshape(shape)
    moved = variance * np.concatenate([np.ones_like(variance), terms], axis=-1)
    impulse = np.zeros(moved.shape[1])
    impulse[0] = 1.0
    heard = signal.lfilter([1.0], recursion, impulse)[None, :, None] ** 2
    power = signal.fftconvolve(moved, heard, axes=1)[:, : moved.shape[1]]
    ringing = np.stack(
        [
            signal.lfilter([1.0], recursion, 0 * impulse, zi=signal.lfiltic([1.0], recursion, start[::-1]))[0]
            for start in by_block[:, :m, 0]
        ]
    )
    by_frame = np.stack([frame_means(part[:, settled - m :], rate) for part in np.moveaxis(power, -1, 0)], -1)
    total = by_frame[..., :1] + frame_means(ringing[:, settled - m :] ** 2, rate)[..., None]
    return np.asarray((by_frame / total).reshape(-1, by_frame.shape[-1]))
