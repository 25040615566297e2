"""Preprocessed, synchronised acceleration, speed and force at one rate."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from foten.dsp import Array

CHANNELS = ("acceleration", "speed", "force")
"""The three columns of a trace and of a window, in this order (Eq. 1)."""


@dataclass(frozen=True)
class Trace:
    """Whole blocks of acceleration, speed and force at one rate."""

    acceleration: Array  # single-axis tool vibration [m/s²], shape (n,), n a multiple of `block`
    speed: Array  # tangential scanning speed [mm/s], shape (n,)
    force: Array  # normal force [N], shape (n,)
    rate_hz: float
    block: int  # samples in a block, the unit of the split; windows never straddle blocks
    recording_sha256: str = ""
    preprocess: Mapping[str, Any] = field(default_factory=dict)  # the resolved configuration that made it
    n_dropped: int = 0  # samples at the end that did not fill a block
    n_uncovered: int = 0  # samples of the acceleration left out because speed or force does not cover them
    take_blocks: tuple[int, ...] = ()  # how many blocks each take has, where there are several; in time they are apart

    def __post_init__(self) -> None:
        n = self.acceleration.size
        if not n == self.speed.size == self.force.size:
            raise ValueError(f"lengths differ: {n}, {self.speed.size}, {self.force.size}")
        if self.block < 1 or n == 0 or n % self.block:
            raise ValueError(f"{n} samples are not whole blocks of {self.block}")
        if self.take_blocks and sum(self.take_blocks) != self.n_blocks:
            raise ValueError(f"the takes have {sum(self.take_blocks)} blocks, and the trace {self.n_blocks}")

    def __len__(self) -> int:
        return self.acceleration.size

    @property
    def n_blocks(self) -> int:
        """Number of blocks."""
        return len(self) // self.block

    def follows(self, block: int) -> bool:
        """Whether a block goes on where the one before it ended: not the first of a take."""
        return block not in (0, *np.cumsum(self.take_blocks))

    def blocks(self, channel: Array) -> Array:
        """One channel as shape (n_blocks, block), a view."""
        return channel.reshape(self.n_blocks, self.block)

    def picked(self, blocks: Sequence[int]) -> tuple[Array, Array, Array]:
        """Acceleration, speed and force of some blocks, shape (len(blocks), block) each."""
        which = list(blocks)
        return self.blocks(self.acceleration)[which], self.blocks(self.speed)[which], self.blocks(self.force)[which]

    def stacked(self) -> Array:
        """Acceleration, speed and force as columns, shape (n, 3)."""
        return np.stack([self.acceleration, self.speed, self.force], axis=1)
