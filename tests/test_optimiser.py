from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from foten.training.config import RECIPES
from foten.training.optimiser import LEAST_SIDE, Optimiser, orthogonalised

CONFIG = replace(RECIPES["default"], weight_decay=0.0)


def parameters(seed: int = 0) -> dict[str, nn.Parameter]:
    torch.manual_seed(seed)
    shapes = {"square": (12, 12), "tall": (24, 8), "narrow": (16, LEAST_SIDE), "bias": (12,)}
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


def test_matrices_move_alike_in_every_direction_and_the_rest_by_adam() -> None:
    """A gradient with singular values a hundredfold apart moves a matrix about as far along each."""
    given = parameters()
    before = {name: one.detach().clone() for name, one in given.items()}
    optimiser = Optimiser(given, CONFIG)
    u, _, v = torch.linalg.svd(torch.randn(12, 12))
    for one in given.values():
        one.grad = torch.ones_like(one)
    given["square"].grad = u @ torch.diag(torch.logspace(0, -2, 12)) @ v
    optimiser.step(1.0)
    moved = torch.linalg.svdvals((before["square"] - given["square"]).detach() / CONFIG.matrix_learning_rate)
    assert float(moved.max() / moved.min()) < 4
    for name in ("narrow", "bias"):  # Adam's first step is its rate, whatever the gradient
        step = (before[name] - given[name]).detach() / CONFIG.learning_rate
        torch.testing.assert_close(step, torch.ones_like(step), rtol=1e-3, atol=0)


def test_a_stack_moves_as_its_networks_do_one_by_one() -> None:
    alone = [parameters(seed) for seed in (0, 1, 2)]
    stack = {name: nn.Parameter(torch.stack([one[name].detach() for one in alone])) for name in alone[0]}
    of_stack = Optimiser(stack, CONFIG, stacked=True)
    each = [Optimiser(one, CONFIG) for one in alone]

    def step(numbers: list[int], of: Optimiser, stacked: dict[str, nn.Parameter]) -> None:
        gradients = [{name: torch.randn_like(one) for name, one in alone[k].items()} for k in numbers]
        for name, one in stacked.items():
            one.grad = torch.stack([gradient[name] for gradient in gradients])
        of.step(0.5)
        for k, gradient in zip(numbers, gradients, strict=True):
            for name, one in alone[k].items():
                one.grad = gradient[name]
            each[k].step(0.5)

    step([0, 1, 2], of_stack, stack)
    kept = torch.tensor([0, 2])
    fewer = {name: nn.Parameter(one.data[kept]) for name, one in stack.items()}
    step([0, 2], of_stack.keep(fewer, kept), fewer)
    for i, k in enumerate(kept.tolist()):
        for name, one in alone[k].items():
            torch.testing.assert_close(fewer[name][i], one, rtol=1e-4, atol=1e-6)  # sums in another order


def test_a_checkpoint_goes_on_as_if_nothing_had_been() -> None:
    def run(n: int, given: dict[str, nn.Parameter], optimiser: Optimiser, first: int = 0) -> None:
        for i in range(first, n):
            torch.manual_seed(100 + i)
            for one in given.values():
                one.grad = torch.randn_like(one)
            optimiser.step(1.0)

    straight, stopped = parameters(), parameters()
    run(4, straight, Optimiser(straight, CONFIG))
    first = Optimiser(stopped, CONFIG)
    run(2, stopped, first)
    second = Optimiser(stopped, CONFIG)
    second.load_state_dict(first.state_dict())
    run(4, stopped, second, first=2)
    for name, one in straight.items():
        torch.testing.assert_close(stopped[name], one, rtol=0, atol=0)


def test_adamw_alone_has_no_matrices() -> None:
    given = parameters()
    config = replace(CONFIG, optimiser="adamw")
    before = given["square"].detach().clone()
    optimiser = Optimiser(given, config)
    for one in given.values():
        one.grad = torch.ones_like(one)
    optimiser.step(1.0)
    step = (before - given["square"]).detach() / config.learning_rate
    torch.testing.assert_close(step, torch.ones_like(step), rtol=1e-3, atol=0)
