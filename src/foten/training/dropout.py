"""Dropout that a recipe switches on, and whose masks do not depend on which thread came first."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn

_THREAD = threading.local()


@contextmanager
def masks_from(source: Callable[[torch.Size, torch.device, float], Tensor]) -> Iterator[None]:
    """Take this thread's masks from a source in place of `mask`."""
    _THREAD.source = source
    try:
        yield
    finally:
        _THREAD.source = mask


def mask(shape: torch.Size, device: torch.device, p: float, generator: torch.Generator | None = None) -> Tensor:
    """Factors of dropout: 0 for a share p, 1 ÷ (1 − p) for the others; four from 64 random bits, for speed."""
    n = shape.numel()
    bits = torch.empty((n + 3) // 4, dtype=torch.int64, device=device)
    bits.random_(-(2**63), None, generator=generator)
    dropped = round(p * 2**16)
    retained = bits.view(torch.int16)[:n].view(shape) >= dropped - 2**15
    return retained.float().mul_(2**16 / (2**16 - dropped))


class Dropout(nn.Module):
    """Zero a share p of the values in training and scale up the rest; the identity otherwise.

    `torch.nn.Dropout` draws from one generator for all threads, so one seed would not give one network.
    """

    def __init__(self) -> None:
        super().__init__()
        self.p = 0.0

    def forward(self, values: Tensor) -> Tensor:
        if not self.training or self.p == 0:
            return values
        return values * getattr(_THREAD, "source", mask)(values.shape, values.device, self.p)


def set_dropout(network: nn.Module, p: float) -> None:
    """Set the share p of its hidden values that a network drops in training, 0 before."""
    for module in network.modules():
        if isinstance(module, Dropout):
            module.p = p
