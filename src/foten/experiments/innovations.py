"""What is left to chance: how likely innovations of validation blocks are under four distributions fitted on training blocks.

Innovations of the lattice over the scale that the texture gives them at their speed and force, less what the network adds where
it is in the loop. A Gaussian, a Student t, two Gaussians about zero, and z·exp(h z²/2) of a Gaussian z, which is rendered; each
with a constant scale and shape.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import optimize, stats

from foten.dsp import Array
from foten.dsp.noise import gaussianised
from foten.families import FotenPlusSizes
from foten.families.conditions import FADE_FORCE, FADE_SPEED
from foten.families.texture_file import Texture
from foten.recording.split import Split
from foten.recording.trace import Trace
from foten.runtime.loops import predict_blocks
from foten.runtime.native import NativeTexture


def normal(u: Array, log_scale: float) -> Array:
    return stats.norm.logpdf(u, scale=np.exp(log_scale))


def student(u: Array, log_scale: float, log_freedom: float) -> Array:
    return stats.t.logpdf(u, 2 + np.exp(log_freedom), scale=np.exp(log_scale))


def two_normals(u: Array, log_scale: float, log_wider: float, logit: float) -> Array:
    share, wider = 1 / (1 + np.exp(-logit)), np.exp(log_scale) * (1 + np.exp(log_wider))
    return np.logaddexp(
        np.log1p(-share) + stats.norm.logpdf(u, scale=np.exp(log_scale)),
        np.log(share) + stats.norm.logpdf(u, scale=wider),
    )


def heavy(u: Array, log_scale: float, log_h: float) -> Array:
    """Density of z·exp(h z²/2): that of z, over the derivative exp(h z²/2)(1 + h z²)."""
    h = np.exp(min(log_h, 2.0))
    z = gaussianised(u / np.exp(log_scale), np.full(u.shape, h))
    return stats.norm.logpdf(z) - 0.5 * h * z * z - np.log1p(h * z * z) - log_scale


KINDS: dict[str, tuple[Callable[..., Array], tuple[float, ...]]] = {
    "gaussian": (normal, (0.0,)),
    "student": (student, (-0.2, 1.0)),
    "two_gaussians": (two_normals, (-0.3, 0.0, -1.5)),
    "heavy_tailed": (heavy, (-0.2, -2.0)),
}


def innovations(texture: Texture, trace: Trace) -> dict[str, Any]:
    """Mean negative log-likelihood of each distribution [nat], by `KINDS`.

    Empty for a texture with tones, whose excitation belongs to what they leave, and for one without excitation.
    """
    if not texture.has_excitation or (isinstance(texture.sizes, FotenPlusSizes) and texture.sizes.n_tones):
        return {}
    split = Split.from_fields(texture.card["split"])
    samples = texture.scaling.scale(trace.stacked()).reshape(trace.n_blocks, trace.block, 3)
    kernel = NativeTexture(texture.to_bytes())
    asked = slice(texture.window, None)
    moving = (trace.blocks(trace.speed) >= FADE_SPEED) & (trace.blocks(trace.force) >= FADE_FORCE)

    def of(blocks: tuple[int, ...]) -> Array:
        chosen = list(blocks)
        some = samples[chosen]
        predicted = predict_blocks(kernel, some, "rendering")
        u = (some[:, asked, 0] - predicted.sample) / predicted.scale
        return np.asarray(u[moving[chosen][:, asked]])

    train, validation = of(split.train), of(split.validation)
    nats = {}
    for name, (density, start) in KINDS.items():
        fitted = optimize.minimize(
            lambda parameters, density=density: -float(density(train, *parameters).mean()),
            start,
            method="Nelder-Mead",
            options={"maxiter": 400, "xatol": 1e-3, "fatol": 1e-5},
        )
        nats[name] = -float(density(validation, *fitted.x).mean())
    return nats
