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
    bounds: dict[str, Any] = {}
    for name in drawn[0]:
        values = [draw[name] for draw in drawn if draw[name] is not None]
        if values and isinstance(values[0], float):
            bounds[name] = _percentiles(values)
        elif values and isinstance(values[0], list | tuple):
            entries = zip(*values, strict=True)
            bounds[name] = [_percentiles([v for v in entry if v is not None]) for entry in entries]
    return bounds


def _percentiles(values: Sequence[float]) -> list[float] | None:
    if not values:
        return None
    low, high = np.percentile(values, [2.5, 97.5])
    return [float(low), float(high)]
