"""Local linear models to a texture file, proved at every one of them before it is written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp.lattice import LEAK
from foten.dsp.lsf import polynomial_of
from foten.dsp.noise import gaussian
from foten.families.piecewise_ar import PiecewiseArSizes
from foten.families.texture_file import FORMAT_VERSION, MIN_GOLDEN, Texture, texture_from_bytes
from foten.recording.scaling import Scaling
from foten.runtime.native import NativeTexture
from foten.train.config import WARM_START
from foten.train.export import ProvedTexture

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


def local_texture(models: LocalModels, scaling: Scaling, card: dict[str, Any]) -> ProvedTexture:
    """Return local models as a texture.

    The proof is each model's own difference equation in direct form, which the kernel, a lattice, has to reproduce.

    Args:
        models: in physical units.
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
    tensors: dict[str, Array] = {
        "piecewise_ar.points": models.points,
        "piecewise_ar.lsf": models.lsf,
        "piecewise_ar.variance": models.variance / scaling.sd[0] ** 2,
        "piecewise_ar.triangles": models.triangles.astype(np.float64),
        "piecewise_ar.scale": models.scale,
        "piecewise_ar.mean": np.array(scaling.mean[1:]),
        "piecewise_ar.sd": np.array(scaling.sd[1:]),
    }
    if q:
        tensors |= {"piecewise_ar.ma_lsf": models.ma_lsf, "piecewise_ar.gain": models.gain}
    filters = [_Filter.of(tensors, i) for i in range(n)]
    hands = (models.points - tensors["piecewise_ar.mean"]) / tensors["piecewise_ar.sd"]
    chosen = np.arange(max(n, MIN_GOLDEN)) % n
    proved = [filters[i].played(sizes.window, stream) for stream, i in enumerate(chosen)]
    spread = np.abs(models.points - WARM_START) / models.scale
    warm = int(np.where(models.variance > 0, spread.sum(axis=1), np.inf).argmin())
    samples, _ = filters[warm].played(sizes.window, len(chosen))
    noise = gaussian(0, 0, 0, 64)
    tensors |= {
        "golden.windows": np.stack(
            [_window(samples, hands[i]) for (samples, _), i in zip(proved, chosen, strict=True)]
        ),
        "golden.one_step": np.array([expected for _, expected in proved]),
        "golden.sigma": np.array([filters[i].root * filters[i].gain for i in chosen]),
        "golden.condition": np.tile(hands[warm], (64, 1)),
        "golden.closed_loop": filters[warm].after(samples, noise),
        "warm_start": _window(samples, hands[warm]),
    }
    low, high = models.points.min(axis=0).tolist(), models.points.max(axis=0).tolist()
    own = {
        "format_version": FORMAT_VERSION,
        "model": "ar",
        "sizes": sizes.to_card(),
        "window": sizes.window,
        "units": {"acceleration": "m/s^2", "speed": "mm/s", "force": "N"},
        "scaling": {"mean": list(scaling.mean), "sd": list(scaling.sd)},
        "trained_range": {"speed": [low[0], high[0]], "force": [low[1], high[1]]},
        "beyond_exponents": {"speed": 0.0, "force": 0.0},
        "warm_start": {
            "asked": dict(zip(("speed", "force"), WARM_START, strict=True)),
            "recorded": dict(zip(("speed", "force"), models.points[warm].tolist(), strict=True)),
        },
    }
    data = Texture(card={**own, **card}, tensors=tensors).to_bytes()
    return ProvedTexture(texture_from_bytes(data), NativeTexture(data))


def _window(samples: Array, hand: Array) -> Array:
    return np.concatenate([samples[:, None], np.tile(hand, (len(samples), 1))], axis=1)


@dataclass(frozen=True)
class _Filter:
    """One model in direct form, scaled: y[n] = −Σ a_k y[n−k] + gain · Σ b_k e[n−k]."""

    a: Array
    b: Array
    root: float
    gain: float

    @staticmethod
    def of(tensors: dict[str, Array], i: int) -> _Filter:
        row = slice(i, i + 1)
        a = polynomial_of(tensors["piecewise_ar.lsf"][row])[0]
        radius = float(np.abs(np.roots(a)).max())
        if not radius < LEAK:
            raise ValueError(
                f"local model {i} has a pole {radius:.6f} from the middle, expected less than {LEAK}: it would ring for too long"
            )
        zeros, gain = tensors.get("piecewise_ar.ma_lsf"), tensors.get("piecewise_ar.gain")
        b = np.ones(1) if zeros is None else polynomial_of(zeros[row])[0]
        root = float(np.sqrt(tensors["piecewise_ar.variance"][i]))
        return _Filter(a, b, root, 1.0 if gain is None else float(gain[i]))

    def played(self, n: int, stream: int) -> tuple[Array, float]:
        """Return n samples, and what the model expects after the last n − 1 of them, the first of which begin from rest."""
        from scipy.signal import lfilter

        e = self.root * gaussian(1, stream, 0, _SETTLED + n)
        samples = lfilter(self.gain * self.b, self.a, e)[-n:]
        expected, _ = self._known(samples)
        return samples, expected

    def _known(self, samples: Array) -> tuple[float, Array]:
        """Return what is expected after samples of which the first is not samples, and their innovations."""
        from scipy.signal import lfilter

        past = samples[1:]
        if self.gain * self.root == 0:
            return float(-self.a[1:] @ past[: -self.a.size : -1]), np.zeros(past.size)
        driven = lfilter(self.a, self.gain, past)
        driven[: self.a.size - 1] = 0.0
        innovations = lfilter([1.0], self.b, driven)
        recent = innovations[: -self.b.size : -1] if self.b.size > 1 else np.empty(0)
        return float(-self.a[1:] @ past[: -self.a.size : -1] + self.gain * self.b[1:] @ recent), innovations

    def after(self, samples: Array, noise: Array) -> Array:
        """Return the samples that follow others under noise."""
        _, innovations = self._known(samples)
        y, e = list(samples[1:]), list(innovations)
        for z in noise:
            e.append(self.root * z)
            driven = sum(b * value for b, value in zip(self.b, reversed(e), strict=False))
            y.append(self.gain * driven - sum(a * value for a, value in zip(self.a[1:], reversed(y), strict=False)))
        return np.array(y[-noise.size :])
