"""How loud methods of one texture are to each other, so that they can be compared and not their levels."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from foten.runtime.renderer import Renderer

# The page's own, in `surface.js`, for textures that no server has.
SETTLE_S, LEVEL_S = 0.5, 1.0  # of each condition: left out, and what the level is of
SHARES = (0.25, 0.5, 0.75)  # of the range of speed and force that all were recorded in: nine conditions
MOST_DB = 30.0  # that a method is made louder or quieter


def gains_db(renderers: Sequence[Renderer], scales: Sequence[float]) -> list[float]:
    """Return what each method has to be made louder by [dB] for all to have the median's power over nine conditions.

    Args:
        renderers: one for each method, at any rate.
        scales: what each is played with for one of what is rendered.
    """
    conditions = _conditions(renderers)
    levels = [_level_db(one, conditions) + 20 * math.log10(scale) for one, scale in zip(renderers, scales, strict=True)]
    usual = float(np.median(levels))
    return [min(MOST_DB, max(-MOST_DB, usual - level)) for level in levels]


def _conditions(renderers: Sequence[Renderer]) -> list[tuple[float, float]]:
    """Return speeds [mm/s] and forces [N]."""
    infos = [one.native_texture.info for one in renderers]
    axes = []
    for ranges in ([one.trained_speed for one in infos], [one.trained_force for one in infos]):
        low, high = max(one[0] for one in ranges), min(one[1] for one in ranges)
        axes.append([low + share * max(0.0, high - low) for share in SHARES])
    return [(speed, force) for speed in axes[0] for force in axes[1]]


def _level_db(renderer: Renderer, conditions: Sequence[tuple[float, float]]) -> float:
    settle, n = round(SETTLE_S * renderer.rate), round(LEVEL_S * renderer.rate)
    powers = []
    for speed, force in conditions:
        renderer.reset(seed=1)
        samples = renderer.render(speed, force, settle + n)[settle:]
        powers.append(float(np.mean(samples.astype(np.float64) ** 2)))
    return 10 * math.log10(max(1e-30, float(np.mean(powers))))
