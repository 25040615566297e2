"""The definition of any model that the kernel runs, and its rendering: NumPy, float64, written to be read.

Training makes golden samples with it, and tests hold the kernel against it; nothing that a user calls renders with it.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.noise import gaussian
from foten.models.conditions import EXTRAPOLATION_LIMIT, FADE_FORCE, FADE_SPEED, REACH_FORCE, REACH_SPEED
from foten.models.excitation import Excitation
from foten.models.foten.definition import Network
from foten.models.foten.sizes import TransformerSizes
from foten.models.foten_plus.definition import FotenPlus
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.model_sizes import ModelSizes
from foten.models.piecewise_ar.definition import PiecewiseAr
from foten.models.piecewise_ar.sizes import PiecewiseArSizes
from foten.models.stream import Model, run
from foten.models.texture_file import Texture
from foten.models.window_model import WindowModel


def model_of(sizes: ModelSizes, tensors: Mapping[str, NDArray[Any]]) -> Model:
    """The model of a texture's tensors."""
    if isinstance(sizes, FotenPlusSizes):
        return FotenPlus(sizes, tensors)
    if isinstance(sizes, PiecewiseArSizes):
        return PiecewiseAr(sizes, tensors)
    assert isinstance(sizes, TransformerSizes)
    return WindowModel(Network(sizes, tensors), sizes.window, Excitation.of(tensors) if sizes.excited else None)


FIRST_INITIAL = 2**63  # the first of the noise numbers that streams begin with: no rendering lasts that long


def render(
    texture: Texture,
    speed: Array,
    force: Array,
    seed: int = 0,
    n_streams: int = 1,
    excitation: bool = True,
    model: Model | None = None,
) -> Array:
    """Acceleration of a stroke from its beginning [m/s²], shape (n_streams, n).

    Outside the trained range the loop keeps to its end, tones go on with the path, and the level follows a power law of speed and
    force: below, down to 2 mm/s and 0.1 N, and above, up to twice the range, at least to 400 mm/s and 6 N. Below these it falls
    linearly to zero. Where the gain comes before the lattice it is what enters that fades, and what rang rings out. Where a card
    has an exponent of 0 the level is held above, and fades linearly from the trained range on.

    Differs from the paper: it keeps to the recorded range (Sec. VIII), and vibrates at rest if that is so below it too.

    Args:
        speed, force: at the texture's rate [mm/s, N], shape (n,).
        seed, n_streams: of the noise; stream k of it is stream k here.
        excitation: False runs the deterministic loop from the warm start.
        model: of a graph; the definition of the texture's own by default.
    """
    names = ("speed", "force")
    low, high = np.array([texture.trained_range(name) for name in names]).T
    exponents = np.array([texture.extrapolation_exponent(name) for name in names])
    scaling = texture.scaling
    physical = np.stack([speed, force], axis=1)
    extrapolated = np.minimum(physical, np.maximum(EXTRAPOLATION_LIMIT * high, [REACH_SPEED, REACH_FORCE]))
    scaled = (np.clip(physical, low, high) - scaling.mean[1:]) / np.array(scaling.sd[1:])
    condition = np.repeat(np.concatenate([scaled, extrapolated[:, :1]], axis=1)[None], n_streams, axis=0)
    model = model or model_of(texture.sizes, texture.tensors)
    warm_start = texture.tensors["warm_start"].astype(np.float64)
    stream = model.start(np.repeat(warm_start[None], n_streams, axis=0))
    random = excitation and texture.has_excitation
    low = np.maximum(low, [FADE_SPEED, FADE_FORCE])
    fades = np.array([texture.fades_below(channel) for channel in ("speed", "force")])
    fade = np.minimum(physical / fades, 1.0).prod(axis=1)

    def noise(first: int, n: int) -> Array:
        return np.stack([gaussian(seed, k, first, n) for k in range(n_streams)])

    if random and len(speed):
        stream.begin(condition[:, 0], noise(FIRST_INITIAL, stream.n_initial), float(fade[0]))
    drawn = noise(0, len(speed)) if random else None
    vibration = run(stream, condition, drawn, float(texture.card["saturation"]), fade)
    share = np.maximum(extrapolated / high, 1.0) * np.minimum(np.maximum(physical, fades) / low, 1.0)
    growth = (share**exponents).prod(axis=1)
    return (vibration * scaling.sd[0] + scaling.mean[0] * fade) * growth
