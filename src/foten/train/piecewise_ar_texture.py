"""Local linear models to a texture file, proved at every one of them before it is written."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter, lfiltic

from foten.dsp.lattice import LEAK
from foten.dsp.lsf import polynomial_of
from foten.dsp.noise import gaussian
from foten.families.piecewise_ar import PiecewiseArSizes
from foten.families.texture_file import MIN_GOLDEN
from foten.recording.scaling import Scaling
from foten.train.config import WARM_START
from foten.train.export import ProvedTexture, warm_start_entry, with_golden

Array = NDArray[np.float64]

_SETTLED = 1000  # samples before a golden window
_WITH_ZEROS = 256  # samples that innovations are inferred from, where there are zeros


@dataclass(frozen=True)
class LocalModels:
    """Linear models of one surface, each at a speed and a force.

    A model's vibration is y[n] = −Σ a_k y[n−k] + gain · (e[n] + Σ b_k e[n−k]), e white, Gaussian.

    Attributes:
        points: speed [mm/s] and force [N] of each, shape (n, 2).
        lsf: line spectral frequencies of 1 + a₁z⁻¹ + … [rad], shape (n, p).
        variance: of e [m²/s⁴], shape (n,); 0 is silence.
        triangles: three models each, shape (t, 3).
        scale: what speed and force are divided by before distances are compared, shape (2,).
        ma_lsf: those of 1 + b₁z⁻¹ + …, shape (n, q).
        gain: shape (n,).
    """

    points: Array
    lsf: Array
    variance: Array
    triangles: NDArray[np.int64]
    scale: Array
    ma_lsf: Array
    gain: Array

    def of_mesh(self) -> LocalModels:
        """Return those that a triangle has a corner at."""
        used, numbered = np.unique(self.triangles, return_inverse=True)
        per_model = {name: getattr(self, name)[used] for name in ("points", "lsf", "variance", "ma_lsf", "gain")}
        return replace(self, triangles=numbered.reshape(self.triangles.shape), **per_model)


def local_texture(models: LocalModels, scaling: Scaling, card: dict[str, Any]) -> ProvedTexture:
    """Return local models, in physical units, as a texture.

    The proof is each model's own difference equation in direct form, which the kernel, a lattice, has to reproduce.

    Args:
        scaling: of the trace that they were fitted to.
        card: what is known beyond model, sizes and scaling.

    Raises:
        ValueError: they make no stable texture, or the kernel does not reproduce them.
    """
    (n, p), q = models.lsf.shape, models.ma_lsf.shape[1]
    alone = sorted(set(range(n)) - set(models.triangles.ravel().tolist()))
    if alone:
        raise ValueError(f"model {alone[0]} is a corner of no triangle, expected a mesh of all {n} models")
    window = max(p, _WITH_ZEROS if q else 0) + 1
    sizes = PiecewiseArSizes(window, p, q, n, len(models.triangles))
    mean, sd = np.array(scaling.mean[1:]), np.array(scaling.sd[1:])
    tensors: dict[str, Array] = {
        "piecewise_ar.points": models.points,
        "piecewise_ar.lsf": models.lsf,
        "piecewise_ar.variance": models.variance / scaling.sd[0] ** 2,
        "piecewise_ar.triangles": models.triangles.astype(np.float64),
        "piecewise_ar.scale": models.scale,
        "piecewise_ar.mean": mean,
        "piecewise_ar.sd": sd,
    }
    if q:
        tensors |= {"piecewise_ar.ma_lsf": models.ma_lsf, "piecewise_ar.gain": models.gain}
    filters = [_Filter.of(models, i, scaling.sd[0]) for i in range(n)]
    hands = (models.points - mean) / sd
    chosen = np.arange(max(n, MIN_GOLDEN)) % n
    golden = [filters[i].played(window, stream) for stream, i in enumerate(chosen)]
    spread = np.abs(models.points - WARM_START) / models.scale
    warm = int(np.where(models.variance > 0, spread.sum(axis=1), np.inf).argmin())
    start = filters[warm].played(window, len(chosen))
    tensors |= {
        "golden.windows": np.stack([_window(samples, hands[i]) for samples, i in zip(golden, chosen, strict=True)]),
        "golden.one_step": np.array(
            [filters[i].after(samples, np.zeros(1))[0] for samples, i in zip(golden, chosen, strict=True)]
        ),
        "golden.sigma": np.array([filters[i].root * filters[i].b[0] for i in chosen]),
        "golden.condition": np.tile(hands[warm], (64, 1)),
        "golden.closed_loop": filters[warm].after(start, gaussian(0, 0, 0, 64)),
        "warm_start": _window(start, hands[warm]),
    }
    low, high = models.points.min(axis=0).tolist(), models.points.max(axis=0).tolist()
    own = {
        "trained_range": {"speed": [low[0], high[0]], "force": [low[1], high[1]]},
        "beyond_exponents": {"speed": 0.0, "force": 0.0},
        "warm_start": warm_start_entry(models.points[warm]),
    }
    return with_golden("ar", sizes, tensors, scaling, {**own, **card})


def _window(samples: Array, hand: Array) -> Array:
    return np.concatenate([samples[:, None], np.tile(hand, (len(samples), 1))], axis=1)


@dataclass(frozen=True)
class _Filter:
    """One model in direct form, scaled: y[n] = −Σ a_k y[n−k] + Σ b_k root z[n−k], z of unit variance."""

    a: Array
    b: Array
    root: float

    @staticmethod
    def of(models: LocalModels, i: int, sd: float) -> _Filter:
        a, b = (polynomial_of(lsf[i : i + 1])[0] for lsf in (models.lsf, models.ma_lsf))
        radius = float(np.abs(np.roots(a)).max())
        if not radius < LEAK:
            raise ValueError(
                f"local model {i} has a pole {radius:.6f} from the middle, expected less than {LEAK}: it would ring for too long"
            )
        gain = models.gain[i] if b.size > 1 else 1.0
        return _Filter(a, gain * b, float(np.sqrt(models.variance[i] / sd**2)))

    def played(self, n: int, stream: int) -> Array:
        """Return n samples of it under a stream of noise."""
        return np.asarray(lfilter(self.b, self.a, self.root * gaussian(1, stream, 0, _SETTLED + n))[-n:])

    def after(self, samples: Array, noise: Array) -> Array:
        """Return what follows samples under noise; their first is not looked at, and before them was rest."""
        if self.root * self.b[0] == 0:
            return np.zeros(noise.size)
        past = samples[1:]
        driven = lfilter(self.a, [1.0], past)
        driven[: self.a.size - 1] = 0.0
        innovations = lfilter([1.0], self.b, driven)
        state = lfiltic(self.b, self.a, past[::-1], innovations[::-1])
        return np.asarray(lfilter(self.b, self.a, self.root * noise, zi=state)[0])
