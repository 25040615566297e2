"""The envelope of a texture's random part made rougher or smoother: a slow unit that its network is given.

    h[n] = u h[n−1] + (1 − u) tanh(3 x[n])        log s = … + strength · h / sd(h) − strength²        u = exp(−1/(τ · rate))

Rougher, x is the innovation, and h a slow random walk. Smoother, x is its size and the strength negative: loud stretches become
softer, down to Gaussian noise. A texture without a network gets one that holds this unit alone. Tones keep their envelope.

Source: ours; volatility after Nelson, "Conditional heteroskedasticity in asset returns: a new approach", Econometrica 59 (1991).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.editing.describe import steady_figures
from foten.models.foten_plus.recorded_innovations import LEVELS_IN_OCTAVE, RecordedInnovations, encoded
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import Texture
from foten.runtime.proof import Tensors, proved

TIME_CONSTANT_S = 0.05  # τ: 0.02 s moves the level in frames of 40 ms less, at the same size
DRIVE = 3.0  # of the innovation into the unit: its mean square is then about 3/4
MEAN_SQUARE = 0.75
MEAN_SIZE = 0.45  # of asinh(3|e|) − 1, which a network is given, of Gaussian innovations
SIZE_STRENGTH = 4.0  # a unit on sizes is so much weaker than one on signs
STRENGTHS = (-1.0, -0.4, 0.0, 0.2, 0.4, 0.7, 1.0)  # that the roughness is measured at; beyond 1 it falls again
PEAKS = 1.5  # the largest innovation grows by exp(this · strength)


def with_envelope(texture: Texture, strength: float) -> Texture:
    """The texture with another slow unit in its network, proved.

    Args:
        strength: standard deviation of log s that is added, up to 1; below 0 smoother, down to −1.
    """
    if not strength:
        return texture
    before = texture.sizes
    assert isinstance(before, FotenPlusSizes)
    if before.recorded:
        return _with_recorded_envelope(texture, before, strength)
    sizes = replace(before, n_hidden=before.n_hidden + 1, head_width=before.head_width + 1, network_in_loop=True)
    tensors: Tensors = {
        name: tensor
        for name, tensor in texture.tensors.items()
        if not name.startswith(("golden.", "network.", "rendering_network.")) and name != "warm_start"
    }
    rendering = _part(texture, "rendering_network.") or _silent(before)
    widened = {"network.": _widened(_part(texture, "network."), before)}
    widened["rendering_network."] = _widened(rendering, before)
    _set_unit(widened["rendering_network."], before, strength, texture.rate_hz)
    for prefix, parts in widened.items():
        tensors |= {f"{prefix}{name}": tensor.astype(np.float32) for name, tensor in parts.items()}
    limit = texture.tensors["excitation.innovation_limit"].astype(np.float64) * np.exp(PEAKS * max(strength, 0.0))
    tensors["excitation.innovation_limit"] = limit.astype(np.float32)
    return _reproved(texture, sizes, tensors)


def _with_recorded_envelope(texture: Texture, sizes: FotenPlusSizes, strength: float) -> Texture:
    """Recorded innovations whose envelope, over `TIME_CONSTANT_S`, is taken to the power of 1 + strength, as loud as before."""
    recorded = RecordedInnovations.of(texture.tensors, sizes.along_path)
    e, n = recorded.innovations, max(1, round(TIME_CONSTANT_S * texture.rate_hz))
    power = np.convolve(np.square(e), np.full(n, 1 / n), mode="same")
    gain = np.sqrt(power / power.mean() + 1e-6) ** strength
    gain *= np.sqrt(np.square(e).mean() / np.square(gain * e).mean())
    changed, moments = gain * e, recorded.moments.astype(np.float64)
    moments[:, 2:4] += LEVELS_IN_OCTAVE * np.log2(gain[:: recorded.step])[:, None]
    stored = np.clip(np.round(moments), 0, 255).astype(np.uint8)
    largest = float(np.abs(changed).max())
    rougher = encoded(changed.reshape(recorded.codes.shape), stored, largest, sizes.along_path)
    kept = {
        name: tensor
        for name, tensor in texture.tensors.items()
        if not name.startswith("golden.") and name != "warm_start"
    }
    in_sigma, in_acceleration = texture.tensors["excitation.innovation_limit"]
    limit = np.array([max(largest, in_sigma), in_acceleration], dtype=np.float32)
    return _reproved(texture, sizes, {**kept, **rougher.tensors(), "excitation.innovation_limit": limit})


def _reproved(texture: Texture, sizes: FotenPlusSizes, tensors: Tensors) -> Texture:
    windows, start = (texture.tensors[name].astype(np.float64) for name in ("golden.windows", "warm_start"))
    cost = {"multiply_adds": sizes.multiply_adds()}
    known = {"format_version", "model", "sizes", "window", "units", "scaling", "split", "metrics"}
    card: dict[str, Any] = {name: value for name, value in texture.card.items() if name not in known}
    card |= {"split": None, "metrics": cost}
    return proved("foten-plus", sizes, tensors, texture.scaling, windows[:-2], start, card).texture


def _part(texture: Texture, prefix: str) -> dict[str, Array]:
    """Tensors under a prefix, in float64; {} where there are none."""
    named = texture.tensors.items()
    return {name.removeprefix(prefix): tensor.astype(np.float64) for name, tensor in named if name.startswith(prefix)}


def _silent(sizes: FotenPlusSizes) -> dict[str, Array]:
    """A network whose innovations are standard normal whatever it is given."""
    shapes = sizes.network_shapes("", sizes.n_rendering_inputs)
    return {name.removeprefix("."): np.zeros([n or 0 for n in shape]) for name, shape in shapes.items()}


def _widened(parts: dict[str, Array], sizes: FotenPlusSizes) -> dict[str, Array]:
    """A network with a hidden unit more, and one more in its head, that do nothing yet."""
    h, out = sizes.n_hidden, dict(parts)

    def rows(x: Array) -> Array:
        """A row of zeros behind each gate's."""
        return np.concatenate([np.pad(gate, [(0, 1)] + [(0, 0)] * (x.ndim - 1)) for gate in np.split(x, 3)])

    for name in ("weight_ih", "bias_ih", "bias_hh"):
        out[f"recurrent.{name}_l0"] = rows(parts[f"recurrent.{name}_l0"])
    out["recurrent.weight_hh_l0"] = rows(np.pad(parts["recurrent.weight_hh_l0"], [(0, 0), (0, 1)]))
    out["head.weight"] = np.pad(np.insert(parts["head.weight"], h, 0.0, axis=1), [(0, 1), (0, 0)])
    out["head.bias"] = np.pad(parts["head.bias"], (0, 1))
    out["out.weight"] = np.pad(parts["out.weight"], [(0, 0), (0, 1)])
    return out


def _set_unit(parts: dict[str, Array], before: FotenPlusSizes, strength: float, rate_hz: float) -> None:
    """Have the last unit follow innovations, and log s follow it."""
    unit, k = before.n_hidden, before.n_components
    update = np.exp(-1 / (TIME_CONSTANT_S * rate_hz))
    _, gate, candidate = (i * (unit + 1) + unit for i in range(3))
    parts["recurrent.bias_ih_l0"][gate] = np.log(update / (1 - update))
    if strength > 0:
        parts["recurrent.weight_ih_l0"][candidate, 0] = DRIVE
        parts["out.weight"][2 * k :, -1] = strength / np.sqrt(MEAN_SQUARE * (1 - update) / (1 + update))
        parts["out.bias"][2 * k :] -= strength**2
    else:
        parts["recurrent.weight_ih_l0"][candidate, 1] = 1.0
        parts["recurrent.bias_ih_l0"][candidate] = -MEAN_SIZE
        parts["out.weight"][2 * k :, -1] = SIZE_STRENGTH * strength
    parts["head.weight"][-1, unit] = 1.0  # tanh h is h, for what is small


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
