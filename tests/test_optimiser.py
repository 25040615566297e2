"""The optimisers: matrices by orthogonalised momentum, all else by AdamW."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from foten.training.config import RECIPES
from foten.training.loop import MIN_SIDE, Optimiser, orthogonalised

CONFIG = replace(RECIPES["default"], weight_decay=0.0)


def parameters(seed: int = 0) -> dict[str, nn.Parameter]:
    torch.manual_seed(seed)
    shapes = {"square": (12, 12), "tall": (24, 8), "narrow": (16, MIN_SIDE), "bias": (12,)}
    return {name: nn.Parameter(torch.randn(*shape)) for name, shape in shapes.items()}


@pytest.mark.parametrize("shape", [(16, 16), (40, 9), (7, 30), (3, 16, 12)])
def test_singular_values_come_near_one_and_directions_stay(shape: tuple[int, ...]) -> None:
    """Oracle: the orthogonal factor U Vᵀ of NumPy's singular value decomposition."""
    matrices = torch.from_numpy(np.random.default_rng(0).standard_normal(shape)).float()
    found = orthogonalised([matrices, matrices.mT])[0].double().numpy()
    u, _, vt = np.linalg.svd(matrices.double().numpy(), full_matrices=False)
    # The quintic ends between 0.68 and 1.14, whatever a singular value was, down to 1 % of their norm.
    assert np.linalg.svd(found, compute_uv=False) == pytest.approx(0.93, abs=0.27)
    overlap = np.sum(found * (u @ vt), axis=(-2, -1)) / u.shape[-1]
    assert (overlap > 0.68).all()


@pytest.mark.parametrize("kind", ["muon", "adamw"])
def test_matrices_move_alike_in_every_direction_and_the_rest_by_adam(kind: str) -> None:
    """A gradient with singular values a hundredfold apart moves a matrix about as far along each; AdamW alone has none."""
    of, config = parameters(), replace(CONFIG, optimiser=kind)
    before = {name: parameter.detach().clone() for name, parameter in of.items()}
    optimiser = Optimiser(of, config)
    u, _, v = torch.linalg.svd(torch.randn(12, 12))
    for parameter in of.values():
        parameter.grad = torch.ones_like(parameter)
    if kind == "muon":
        of["square"].grad = u @ torch.diag(torch.logspace(0, -2, 12)) @ v
    optimiser.step(1.0)
    if kind == "muon":
        moved = torch.linalg.svdvals((before["square"] - of["square"]).detach() / config.matrix_learning_rate)
        assert float(moved.max() / moved.min()) < 4
    for name in ("narrow", "bias", *(["square"] if kind == "adamw" else [])):
        step = (before[name] - of[name]).detach() / config.learning_rate
        torch.testing.assert_close(step, torch.ones_like(step), rtol=1e-3, atol=0)  # its first, whatever the gradient


def test_a_checkpoint_goes_on_as_if_nothing_had_been() -> None:
    def run(n: int, of: dict[str, nn.Parameter], optimiser: Optimiser, first: int = 0) -> None:
        for i in range(first, n):
            torch.manual_seed(100 + i)
            for parameter in of.values():
                parameter.grad = torch.randn_like(parameter)
            optimiser.step(1.0)

    straight, stopped = parameters(), parameters()
    run(4, straight, Optimiser(straight, CONFIG))
    first = Optimiser(stopped, CONFIG)
    run(2, stopped, first)
    second = Optimiser(stopped, CONFIG)
    second.load_state_dict(first.state_dict())
    run(4, stopped, second, first=2)
    for name, parameter in straight.items():
        torch.testing.assert_close(stopped[name], parameter, rtol=0, atol=0)
