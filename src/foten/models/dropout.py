"""Dropout whose masks do not depend on which thread came first."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn

_MASKS = threading.local()


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

    def __init__(self, p: float) -> None:
        super().__init__()
        self.p = p

    def forward(self, values: Tensor) -> Tensor:
        """Return the values with some of them zero: any shape → the same."""
        if not self.training or self.p == 0:
            return values
        generator = getattr(_MASKS, "generator", None)
        kept = torch.empty_like(values).bernoulli_(1 - self.p, generator=generator)
        return values * kept.div_(1 - self.p)
