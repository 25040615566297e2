"""Dropout that a recipe switches on, and whose masks do not depend on which thread came first."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn

_THREAD = threading.local()


@contextmanager
def bits_from(source: Callable[[int, torch.device], Tensor]) -> Iterator[None]:
    """Take this thread's random bits from a source of (n,) numbers on a device, in place of `random_bits`."""
    _THREAD.source = source
    try:
        yield
    finally:
        _THREAD.source = random_bits


def random_bits(n: int, device: torch.device, generator: torch.Generator | None = None) -> Tensor:
    """Random numbers of 16 bits, as integers with a sign, (n,); four from 64 bits, for speed."""
    bits = torch.empty((n + 3) // 4, dtype=torch.int64, device=device)
    bits.random_(-(2**63), None, generator=generator)
    return bits.view(torch.int16)[:n]


def factors(p: float) -> tuple[int, float]:
    """The least of `random_bits` that is not dropped at a share p, and what is not dropped is multiplied by."""
    dropped = round(p * 2**16)
    return dropped - 2**15, 2**16 / (2**16 - dropped)


class Dropout(nn.Module):
    """Zero a share p of the values in training and scale up the rest; the identity otherwise.

    `torch.nn.Dropout` draws from one generator for all threads, so one seed would not give one network.
    """

    def __init__(self) -> None:
        super().__init__()
        self.p = 0.0

    def forward(self, values: Tensor) -> Tensor:
        bits = self.bits(values.numel(), values.device)
        if bits is None:
            return values
        least, factor = factors(self.p)
        return values * (bits.view(values.shape) >= least).to(values.dtype).mul_(factor)

    def bits(self, n: int, device: torch.device) -> Tensor | None:
        """Numbers of `random_bits`, (n,), which decide what is dropped of n values; None where nothing is."""
        if not self.training or self.p == 0:
            return None
        bits: Tensor = getattr(_THREAD, "source", random_bits)(n, device)
        return bits


def set_dropout(network: nn.Module, p: float) -> None:
    """Set the share p of its hidden values that a network drops in training, 0 before."""
    for module in network.modules():
        if isinstance(module, Dropout):
            module.p = p
