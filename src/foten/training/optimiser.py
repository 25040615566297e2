"""The optimisers of our recipe and the paper's: orthogonalised momentum for matrices, AdamW for the rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from foten.training.config import TrainConfig

MOMENTUM = 0.95
MIN_SIDE = 4  # a matrix is wider and taller than that: of what is narrower little is left by orthogonalisation


class Optimiser:
    """Steps of all parameters, at a share of their learning rates.

    Matrices move along the orthogonal factor of their momentum, so that no direction is slow: a network of 64 s of simulated mesh
    gained 7.6 % in 1200 steps, and 1.0 % by AdamW at the better of two rates (`benchmarks/training.py`).

    Source: Jordan et al., "Muon: an optimizer for hidden layers in neural networks" (2024), the iteration and its coefficients;
    for the paper's recipe Adam, Sec. IV-e.
    """

    def __init__(self, parameters: Mapping[str, nn.Parameter], config: TrainConfig) -> None:
        self._config = config
        self._matrices = {
            name: matrix
            for name, matrix in parameters.items()
            if config.optimiser == "muon" and matrix.ndim == 2 and min(matrix.shape) > MIN_SIDE
        }
        self._momentum = {name: torch.zeros_like(matrix) for name, matrix in self._matrices.items()}
        others = [parameter for name, parameter in parameters.items() if name not in self._matrices]
        self._adam = torch.optim.AdamW(others, lr=config.learning_rate, weight_decay=config.weight_decay, fused=True)

    def step(self, rate: float) -> None:
        """Take a step with the gradients that there are, at a share of the highest learning rates."""
        config = self._config
        self._adam.param_groups[0]["lr"] = config.learning_rate * rate
        self._adam.step()
        directions = []
        for name, matrix in self._matrices.items():
            momentum = self._momentum[name].mul_(MOMENTUM).add_(matrix.grad)
            directions.append(matrix.grad.add(momentum, alpha=MOMENTUM))
        with torch.no_grad():
            for matrix, direction in zip(self._matrices.values(), orthogonalised(directions), strict=True):
                tall = max(1.0, matrix.shape[-2] / matrix.shape[-1]) ** 0.5
                matrix.mul_(1 - config.learning_rate * rate * config.weight_decay)
                matrix.sub_(direction, alpha=config.matrix_learning_rate * rate * tall)

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint keeps."""
        return {"adam": self._adam.state_dict(), "momentum": self._momentum}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint."""
        self._adam.load_state_dict(state["adam"])
        for name, momentum in state["momentum"].items():
            self._momentum[name].copy_(momentum)


@torch.no_grad()
def orthogonalised(matrices: Sequence[Tensor]) -> list[Tensor]:
    """The orthogonal factors of matrices, roughly: (…, a, b) each → singular values of 0.7 to 1.2.

    A quintic in odd powers, five times over, which is Newton and Schulz's iteration with a steeper start. Matrices of one shape
    are one batched product.
    """
    a, b, c = 3.4445, -4.7750, 2.0315  # pushes singular values towards 1
    wide = [x.mT if x.shape[-2] > x.shape[-1] else x for x in matrices]
    out = [torch.empty(0)] * len(wide)
    for shape in {x.shape[-2:] for x in wide}:
        alike = [i for i, x in enumerate(wide) if x.shape[-2:] == shape]
        x = torch.cat([wide[i].reshape(-1, *shape) for i in alike])
        x = x / (x.norm(dim=(-2, -1), keepdim=True) + 1e-7)
        for _ in range(5):
            gram = x @ x.mT
            x = torch.baddbmm(x, torch.baddbmm(gram, gram, gram, beta=b, alpha=c), x, beta=a)
        for i, product in zip(alike, x.split([wide[i].numel() // shape.numel() for i in alike]), strict=True):
            factor = product.reshape(wide[i].shape)
            out[i] = factor.mT if wide[i].shape != matrices[i].shape else factor
    return out
