"""Many hands on one texture at once, rendered by the kernel."""

from __future__ import annotations

import numpy as np

from foten.families.texture_file import Texture
from foten.runtime.native import NativeState, NativeTexture


def rendered(texture: Texture, seed: int, speed: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the acceleration [m/s²] of hands of their own noise, and how many samples the saturator cut.

    Args:
        texture: what is touched.
        seed: of the noise; hand s draws that of stream s.
        speed, force: at the texture's own rate [mm/s, N], each of shape (s, n).

    Returns:
        Shape (s, n).
    """
    native = NativeTexture(texture.to_bytes())
    out, n_saturated = np.empty(speed.shape), 0
    for stream, hand in enumerate(zip(speed.astype(np.float32), force.astype(np.float32), strict=True)):
        state = NativeState(native, seed=seed, stream=stream)
        out[stream] = state.render_stroke(*hand)
        n_saturated += int(state.statistics.n_saturated)
    return out, n_saturated
