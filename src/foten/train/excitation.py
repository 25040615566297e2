"""The excitation of foten-plus: σ(speed, force) by maximum likelihood, its level settled in the closed loop."""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray

from foten.models.foten_plus import Excitation
from foten.train.fit import Data


def fit_excitation(excitation: Excitation, data: Data, residual: NDArray[np.float64], seed: int) -> float:
    """Fit σ(speed, force) to one-step residuals of the training blocks by Gaussian maximum likelihood.

    Args:
        excitation: fitted in place.
        data: the speed and force that go with each residual are those of the last sample of its window.
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
        excitation.out.weight.zero_()
        excitation.out.bias.fill_(0.5 * math.log(float(squared.mean()) + 1e-12))
    excitation.double().requires_grad_(True)
    optimiser = torch.optim.LBFGS(
        excitation.parameters(), max_iter=60, history_size=20, line_search_fn="strong_wolfe", tolerance_change=1e-7
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
    with torch.no_grad():
        sigma = excitation(condition.float()).double()
        return float((torch.log(sigma) + squared / (2 * sigma**2)).mean()) + 0.5 * math.log(2 * math.pi)
