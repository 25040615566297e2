"""Intervals by resampling blocks: samples within one are too alike to count as independent."""

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
        figures: block numbers → figures, numbers or lists of numbers; what is None in a draw is left out of it.
        n_blocks: blocks to draw from; with fewer than 4 there are hardly any different draws and the result is empty.
        seed: of the draw.

    Returns:
        By figure [low, high]; for a list, one such pair for each entry, None where it never was a number.
    """
    if n_blocks < 4:
        return {}
    rng = np.random.default_rng(seed)
    drawn = [figures(rng.integers(0, n_blocks, n_blocks)) for _ in range(N_RESAMPLES)]
    found: dict[str, Any] = {}
    for name in drawn[0]:
        values = [draw[name] for draw in drawn if draw[name] is not None]
        if values and isinstance(values[0], float):
            found[name] = _percentiles(values)
        elif values and isinstance(values[0], list | tuple):
            entries = zip(*values, strict=True)
            found[name] = [_percentiles([v for v in entry if v is not None]) for entry in entries]
    return found


def _percentiles(values: Sequence[float]) -> list[float] | None:
    if not values:
        return None
    low, high = np.percentile(values, [2.5, 97.5])
    return [float(low), float(high)]
