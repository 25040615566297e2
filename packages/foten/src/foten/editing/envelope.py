"""The envelope of recorded innovations made rougher or smoother: over 50 ms, it is taken to the power of 1 + strength.

Noise keeps its envelope, and so do tones. Source: ours.
"""

import numpy as np
from numpy.typing import NDArray

from foten.editing.describe import steady_figures
from foten.models.foten_plus.recorded_innovations import LEVELS_IN_OCTAVE, RecordedInnovations, encoded
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import Texture
from foten.runtime.proof import reproved

TIME_CONSTANT_S = 0.05  # 0.02 s moves the level in frames of 40 ms less, at the same size
STRENGTHS = (-0.5, -0.25, 0.0, 0.25, 0.5, 1.0, 2.0)  # that the roughness is measured at; below, it rises again
ZERO = STRENGTHS.index(0.0)


def with_envelope(texture: Texture, strength: float) -> Texture:
    """The texture with another envelope of its recorded innovations, by a strength of `STRENGTHS` or between, proved."""
    sizes = texture.sizes
    assert isinstance(sizes, FotenPlusSizes)
    if not strength or not sizes.recorded:
        return texture
    changed = _powered(RecordedInnovations.of(texture.tensors, sizes.along_path), texture.rate_hz, strength)
    in_sigma, in_acceleration = texture.tensors["excitation.innovation_limit"]
    largest = float(np.abs(changed.values).max())
    limit = [max(largest, in_sigma), in_acceleration * max(1.0, largest / in_sigma)]
    tensors = {**changed.tensors(), "excitation.innovation_limit": np.array(limit, dtype=np.float32)}
    return reproved(texture, {"metrics": {"multiply_adds": sizes.multiply_adds()}}, tensors)


def _powered(recorded: RecordedInnovations, rate_hz: float, strength: float) -> RecordedInnovations:
    """Recorded innovations with the power of their envelope, as loud as before."""
    e, n = recorded.innovations, max(1, round(TIME_CONSTANT_S * rate_hz))
    power = np.convolve(np.square(e), np.full(n, 1 / n), mode="same")
    gain = np.sqrt(power / power.mean() + 1e-6) ** strength
    gain *= np.sqrt(np.square(e).mean() / np.square(gain * e).mean())
    changed, moments = gain * e, recorded.moments.astype(np.float64)
    moments[:, 2:4] += LEVELS_IN_OCTAVE * np.log2(gain[:: recorded.step])[:, None]
    stored = np.clip(np.round(moments), 0, 255).astype(np.uint8)
    return encoded(changed.reshape(recorded.codes.shape), stored, float(np.abs(changed).max()), recorded.along_path)


class EnvelopeCurve:
    """Roughness that a texture has at `STRENGTHS`, (k,), rising [dB], measured on renderings; the strength for a roughness."""

    def __init__(self, texture: Texture, seed: int = 0) -> None:
        measured = [steady_figures(with_envelope(texture, strength), seed).roughness_db for strength in STRENGTHS]
        up, down = np.maximum.accumulate(measured[ZERO:]), np.minimum.accumulate(measured[ZERO::-1])[::-1]
        self.roughness_db: NDArray[np.float64] = np.concatenate([down[:-1], up])

    def strength(self, rougher_db: float) -> float:
        """The strength that makes a texture rougher by so much [dB], or as nearly as it can."""
        target = self.roughness_db[ZERO] + rougher_db
        side = slice(ZERO, None) if rougher_db > 0 else slice(None, ZERO + 1)
        known, strengths = self.roughness_db[side], np.array(STRENGTHS)[side]
        if known[-1] - known[0] < 1e-6:
            return 0.0
        power = 2 if rougher_db > 0 else 1  # of the strength, which the roughness goes with at first
        share = float(np.interp(target, known, np.sign(strengths) * np.abs(strengths) ** power))
        return float(np.copysign(abs(share) ** (1 / power), share))
