"""Bootstrap intervals over blocks: samples within a block are correlated and do not count as independent."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

N_RESAMPLES = 400


def intervals(
    figures: Callable[[NDArray[np.int64]], Mapping[str, Any]], n_blocks: int, seed: int = 0
) -> dict[str, Any]:
    """Return the 95 % percentile interval of each figure, resampling blocks with replacement.

    Args:
        figures: block numbers → figures, each a number, a list of numbers, or None where a resample has none.
        n_blocks: blocks to resample; with fewer than 4 there are too few different resamples and the result is empty.
        seed: of the resamples.

    Returns:
        By figure [low, high]; for a list one such pair for each entry, None where no resample has a number.
    """
    if n_blocks < 4:
        return {}
    rng = np.random.default_rng(seed)
    drawn = [figures(rng.integers(0, n_blocks, n_blocks)) for _ in range(N_RESAMPLES)]
    bounds = {name: _interval([draw[name] for draw in drawn]) for name in drawn[0]}
    return {name: bound for name, bound in bounds.items() if bound is not None}


def _interval(values: Sequence[Any]) -> list[Any] | None:
    known = [value for value in values if value is not None]
    if known and isinstance(known[0], list | tuple):
        return [_interval(entry) for entry in zip(*known, strict=True)]
    return [float(bound) for bound in np.percentile(known, [2.5, 97.5])] if known else None
