"""Intervals by resampling blocks: samples within one are too alike to count as independent."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

N_RESAMPLES = 400


def intervals(
    figures: Callable[[NDArray[np.int64]], Mapping[str, Any]], n_blocks: int, seed: int = 0
) -> dict[str, list[float]]:
    """Return the 95 % percentile interval of each scalar figure, resampling blocks with replacement.

    Args:
        figures: block numbers → figures; those that are None or no number are left out.
        n_blocks: blocks to draw from; with fewer than 2 there is nothing to resample and the result is empty.
        seed: of the draw.
    """
    if n_blocks < 2:
        return {}
    rng = np.random.default_rng(seed)
    drawn = [figures(rng.integers(0, n_blocks, n_blocks)) for _ in range(N_RESAMPLES)]
    found: dict[str, list[float]] = {}
    for name in drawn[0]:
        values = [d[name] for d in drawn if isinstance(d[name], float)]
        if values:
            low, high = np.percentile(values, [2.5, 97.5])
            found[name] = [float(low), float(high)]
    return found
