"""Gains that bring the methods of a texture to one level, so that not their levels are compared."""

import math
from collections.abc import Sequence
from itertools import product

import numpy as np

from foten.runtime.renderer import Renderer

# The page's own, in `surface.js`, for textures that no server has.
SETTLE_S, LEVEL_S = 0.5, 1.0  # of each condition: left out, and what the level is of
SHARES = (0.25, 0.5, 0.75)  # of the range of speed and force that all were recorded in: nine conditions
MAX_GAIN_DB = 30.0


def gains_db(renderers: Sequence[Renderer], scales: Sequence[float]) -> list[float]:
    """Gain of each method [dB], which 0 dB plays at a scale, to the median of their powers over nine conditions."""
    conditions, levels = _conditions(renderers), []
    for renderer, scale in zip(renderers, scales, strict=True):
        settle, n = round(SETTLE_S * renderer.rate), round(LEVEL_S * renderer.rate)
        powers = []
        for speed, force in conditions:
            renderer.reset(seed=1)
            samples = renderer.render(speed, force, settle + n)[settle:]
            powers.append(float(np.mean(samples.astype(np.float64) ** 2)))
        levels.append(10 * math.log10(max(1e-30, float(np.mean(powers)))) + 20 * np.log10(scale))
    gains: list[float] = np.clip(np.median(levels) - levels, -MAX_GAIN_DB, MAX_GAIN_DB).tolist()
    return gains


def _conditions(renderers: Sequence[Renderer]) -> list[tuple[float, float]]:
    """Nine speeds [mm/s] and forces [N] within the range that all were trained in."""
    infos = [renderer.native_texture.info for renderer in renderers]
    ranges = np.array([(info.trained_speed, info.trained_force) for info in infos])
    low, high = ranges[..., 0].max(0), ranges[..., 1].min(0)
    grid: list[tuple[float, float]] = (low + np.array([*product(SHARES, SHARES)]) * np.maximum(0, high - low)).tolist()
    return grid
