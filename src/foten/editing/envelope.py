"""The envelope of recorded innovations made rougher or smoother: over 50 ms, it is taken to the power of 1 + strength.

Noise keeps its envelope, and so do tones. Source: ours.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.editing.describe import steady_figures
from foten.models.foten_plus.recorded_innovations import LEVELS_IN_OCTAVE, RecordedInnovations, encoded
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import Texture
from foten.runtime.proof import proved

TIME_CONSTANT_S = 0.05  # 0.02 s moves the level in frames of 40 ms less, at the same size
STRENGTHS = (-0.5, -0.25, 0.0, 0.25, 0.5, 1.0, 2.0)  # that the roughness is measured at; below, it rises again


def with_envelope(texture: Texture, strength: float) -> Texture:
    """The texture with another envelope of its recorded innovations, proved; one of noise is left as it is.

    Args:
        strength: one of `STRENGTHS`, or between; below 0 smoother.
    """
    sizes = texture.sizes
    assert isinstance(sizes, FotenPlusSizes)
    if not strength or not sizes.recorded:
        return texture
    changed = _powered(RecordedInnovations.of(texture.tensors, sizes.along_path), texture.rate_hz, strength)
    tensors = {
        name: tensor
        for name, tensor in texture.tensors.items()
        if not name.startswith("golden.") and name != "warm_start"
    }
    in_sigma, in_acceleration = texture.tensors["excitation.innovation_limit"]
    largest = float(np.abs(changed.values).max())
    limit = [max(largest, in_sigma), in_acceleration * max(1.0, largest / in_sigma)]
    tensors |= {**changed.tensors(), "excitation.innovation_limit": np.array(limit, dtype=np.float32)}
    return _reproved(texture, sizes, tensors)


def _powered(recorded: RecordedInnovations, rate_hz: float, strength: float) -> RecordedInnovations:
    """Recorded innovations with the power of their envelope, as loud as before."""
    e, n = recorded.innovations, max(1, round(TIME_CONSTANT_S * rate_hz))
    power = np.convolve(np.square(e), np.full(n, 1 / n), mode="same")
    gain = np.sqrt(power / power.mean() + 1e-6) ** strength
    gain *= np.sqrt(np.square(e).mean() / np.square(gain * e).mean())
    changed, moments = gain * e, recorded.moments.astype(np.float64)
    moments[:, 2:4] += LEVELS_IN_OCTAVE * np.log2(gain[:: recorded.step])[:, None]
    in_file = np.clip(np.round(moments), 0, 255).astype(np.uint8)
    shaped = changed.reshape(recorded.codes.shape)
    return encoded(shaped, in_file, float(np.abs(changed).max()), recorded.along_path)


def _reproved(texture: Texture, sizes: FotenPlusSizes, tensors: dict[str, NDArray[Any]]) -> Texture:
    windows, start = (texture.tensors[name].astype(np.float64) for name in ("golden.windows", "warm_start"))
    cost = {"multiply_adds": sizes.multiply_adds()}
    known = {"format_version", "model", "sizes", "window", "units", "scaling", "split", "metrics"}
    card: dict[str, Any] = {name: value for name, value in texture.card.items() if name not in known}
    card |= {"split": None, "metrics": cost}
    return proved("foten-plus", sizes, tensors, texture.scaling, windows[:-2], start, card).texture


class EnvelopeCurve:
    """Roughness that a texture has at strengths, measured on renderings, and the strength for a roughness.

    Attributes:
        roughness_db: at `STRENGTHS`, (k,), rising.
    """

    def __init__(self, texture: Texture, seed: int = 0) -> None:
        found = [steady_figures(with_envelope(texture, strength), seed).roughness_db for strength in STRENGTHS]
        zero = STRENGTHS.index(0.0)
        up, down = np.maximum.accumulate(found[zero:]), np.minimum.accumulate(found[zero::-1])[::-1]
        self.roughness_db: NDArray[np.float64] = np.concatenate([down[:-1], up])

    def strength(self, rougher_db: float) -> float:
        """The strength that makes a texture rougher by so much [dB], or as nearly as it can."""
        zero = STRENGTHS.index(0.0)
        target = self.roughness_db[zero] + rougher_db
        side = slice(zero, None) if rougher_db > 0 else slice(None, zero + 1)
        known, strengths = self.roughness_db[side], np.array(STRENGTHS)[side]
        if known[-1] - known[0] < 1e-6:
            return 0.0
        power = 2 if rougher_db > 0 else 1  # of the strength, which the roughness goes with at first
        share = float(np.interp(target, known, np.sign(strengths) * np.abs(strengths) ** power))
        return float(np.copysign(abs(share) ** (1 / power), share))
