"""Dropout that a recipe switches on, and whose masks do not depend on which thread came first."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import torch
from torch import Tensor, nn

_MASKS = threading.local()


@contextmanager
def masks_given(masks: Sequence[Tensor]) -> Iterator[None]:
    """Take this thread's masks, as `mask` makes them, in the order in which the network asks for them."""
    _MASKS.given = iter(masks)
    try:
        yield
    finally:
        _MASKS.given = None


@contextmanager
def mask_shapes() -> Iterator[list[torch.Size]]:
    """Give the shapes of the masks that the network asks for meanwhile."""
    _MASKS.shapes = []
    try:
        yield _MASKS.shapes
    finally:
        _MASKS.shapes = None


def mask(shape: torch.Size, p: float, generator: torch.Generator | None, device: torch.device) -> Tensor:
    """Return what values of a shape are multiplied by: 0 for a share p of them, and 1 ÷ (1 − p) for the others.

    Four from each 64 random bits: six times as fast as `bernoulli_`, which was a third of a training step.
    """
    n = shape.numel()
    bits = torch.empty((n + 3) // 4, dtype=torch.int64, device=device)
    bits.random_(-(2**63), None, generator=generator)
    dropped = round(p * 2**16)
    kept = bits.view(torch.int16)[:n].view(shape) >= dropped - 2**15
    return kept.float().mul_(2**16 / (2**16 - dropped))


@contextmanager
def masks_from(generator: torch.Generator | None) -> Iterator[None]:
    """Draw this thread's masks from a generator of its own; None stands for PyTorch's common one."""
    _MASKS.generator = generator
    try:
        yield
    finally:
        _MASKS.generator = None


class Dropout(nn.Module):
    """Zero a share p of the values in training and scale up the rest; the identity otherwise.

    As `torch.nn.Dropout`, which draws from one generator for all threads: threads that share out a batch
    would take its numbers in an order of their own, and one seed would not give one network.
    """

    def __init__(self) -> None:
        super().__init__()
        self.p = 0.0

    def forward(self, values: Tensor) -> Tensor:
        """Return the values with some of them zero: any shape → the same."""
        if not self.training or self.p == 0:
            return values
        given, shapes = getattr(_MASKS, "given", None), getattr(_MASKS, "shapes", None)
        if given is not None:
            return values * next(given)
        if shapes is not None:
            shapes.append(values.shape)
        return values * mask(values.shape, self.p, getattr(_MASKS, "generator", None), values.device)


def set_dropout(network: nn.Module, p: float) -> None:
    """Let a network drop a share p of its hidden values in training; none until then."""
    for module in network.modules():
        if isinstance(module, Dropout):
            module.p = p
