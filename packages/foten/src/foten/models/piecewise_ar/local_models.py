"""Local linear models, fitted or of a model file, as a texture that is proved at each of them."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter, lfiltic

from foten.datasets.hatt import HattModels
from foten.dsp import Array
from foten.dsp.ar import MAX_POLE, line_spectral_frequencies, polynomial_of, spread_out, stabilised
from foten.dsp.lattice import LEAK
from foten.dsp.noise import gaussian
from foten.models.piecewise_ar.sizes import MAX_AR_ORDER, PiecewiseArSizes
from foten.models.texture_file import MIN_GOLDEN, Texture
from foten.recording.preprocess import PreprocessConfig
from foten.recording.scaling import Scaling
from foten.runtime.proof import ProvedTexture, with_golden
from foten.training.job import versions
from foten.training.texture_builder import WARM_START, warm_start_entry

_SETTLED = 1000  # samples before a golden window
_WITH_ZEROS = 256  # samples that innovations are inferred from, where there are zeros
_MIN_SD = np.array([1.0, 0.01])  # mm/s and N; models all at one force still have a scale
_SETTLING = 4096  # samples of an impulse response that a level is computed from
_LICENCE = "as of the model file; Penn's toolkit: non-profit research, no distribution, see the notice in the file"


@dataclass(frozen=True)
class LocalModels:
    """Linear models of one surface, each at a speed and a force.

    A model's vibration is y[n] = −Σ a_k y[n−k] + gain · (e[n] + Σ b_k e[n−k]), e white, Gaussian.
    """

    points: Array  # speed [mm/s] and force [N] of each, shape (n, 2)
    lsf: Array  # line spectral frequencies of 1 + a₁z⁻¹ + … [rad], shape (n, p)
    variance: Array  # of e [m²/s⁴], shape (n,); 0 is silence
    triangles: NDArray[np.int64]  # three models each, shape (t, 3)
    scale: Array  # what speed and force are divided by before distances are compared, shape (2,)
    ma_lsf: Array  # line spectral frequencies of 1 + b₁z⁻¹ + … [rad], shape (n, q)
    gain: Array  # shape (n,)

    def of_mesh(self) -> LocalModels:
        """Those that a triangle has a corner at."""
        used, numbered = np.unique(self.triangles, return_inverse=True)
        per_model = {name: getattr(self, name)[used] for name in ("points", "lsf", "variance", "ma_lsf", "gain")}
        return replace(self, triangles=numbered.reshape(self.triangles.shape), **per_model)


def local_texture(models: LocalModels, scaling: Scaling, card: dict[str, Any]) -> ProvedTexture:
    """Local models, in physical units, as a texture.

    The proof is each model's own difference equation in direct form, which the kernel, a lattice, has to reproduce.

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
    filters = [_direct_form(models, i, scaling.sd[0]) for i in range(n)]
    conditions = (models.points - mean) / sd
    chosen = np.arange(max(n, MIN_GOLDEN)) % n
    golden = [(i, _played(filters[i], window, stream)) for stream, i in enumerate(chosen)]
    spread = np.abs(models.points - WARM_START) / models.scale
    warm = int(np.where(models.variance > 0, spread.sum(axis=1), np.inf).argmin())
    start = _played(filters[warm], window, len(chosen))
    tensors |= {
        "golden.windows": np.stack([_window(samples, conditions[i]) for i, samples in golden]),
        "golden.one_step": np.array([_after(filters[i], samples, np.zeros(1))[0] for i, samples in golden]),
        "golden.sigma": np.array([filters[i][0][0] for i in chosen]),
        "golden.condition": np.tile(conditions[warm], (64, 1)),
        "golden.closed_loop": _after(filters[warm], start, gaussian(0, 0, 0, 64)),
        "warm_start": _window(start, conditions[warm]),
    }
    low, high = models.points.min(axis=0).tolist(), models.points.max(axis=0).tolist()
    entries = {
        "trained_range": {"speed": [low[0], high[0]], "force": [low[1], high[1]]},
        "extrapolation_exponents": {"speed": 0.0, "force": 0.0},
        "warm_start": warm_start_entry(models.points[warm]),
    }
    return with_golden("ar", sizes, tensors, scaling, {**entries, **card})


def _window(samples: Array, condition: Array) -> Array:
    return np.concatenate([samples[:, None], np.tile(condition, (len(samples), 1))], axis=1)


def _direct_form(models: LocalModels, i: int, sd: float) -> tuple[Array, Array]:
    """B and a of a model in units of `sd` [m/s²]: y[n] = Σ b_k z[n−k] − Σ a_k y[n−k], z of unit variance."""
    a, b = (polynomial_of(lsf[i : i + 1])[0] for lsf in (models.lsf, models.ma_lsf))
    radius = float(np.abs(np.roots(a)).max())
    if not radius < LEAK:
        expected = f"expected less than {LEAK}: it would ring for too long"
        raise ValueError(f"local model {i} has a pole {radius:.6f} from the middle, {expected}")
    gain = models.gain[i] if b.size > 1 else 1.0
    return gain * np.sqrt(models.variance[i] / sd**2) * b, a


def _played(b_a: tuple[Array, Array], n: int, stream: int) -> Array:
    return lfilter(*b_a, gaussian(1, stream, 0, _SETTLED + n))[-n:]


def _after(b_a: tuple[Array, Array], samples: Array, noise: Array) -> Array:
    """The samples that follow others under noise, after rest; the first of these is not used."""
    b, a = b_a
    if b[0] == 0:
        return np.zeros(noise.size)
    past = samples[1:]
    driven = lfilter(a, [1.0], past)
    driven[: a.size - 1] = 0.0
    state = lfiltic(b, a, past[::-1], lfilter([1.0], b, driven)[::-1])
    return lfilter(b, a, noise, zi=state)[0]


def imported_texture(models: HattModels, digest: str, name: str = "", notes: str = "") -> tuple[Texture, list[str]]:
    """Models of a file as a texture, and notes of what was changed.

    Poles beyond `MAX_POLE` are pulled in, with the others of their model. Zeros outside the unit circle are reflected into it,
    which leaves the spectrum as it was. The recording behind the file is not known: there is no split.

    Args:
        digest: SHA-256 of the file.
        name: of the texture; the material's by default.
    """
    n, p, q = len(models.points), models.ar.shape[1] - 1, models.ma.shape[1] - 1
    for what, order in (("AR", p), ("MA", q)):
        if order > MAX_AR_ORDER:
            raise ValueError(f"the {what} order is {order}, expected at most {MAX_AR_ORDER}")
    reflected = [_reflected(row) for row in models.ma]
    gain = models.gain * np.array([size for _, size in reflected])
    ar = np.array([_pulled_in(row) for row in models.ar])
    ma = np.array([_pulled_in(row) for row, _ in reflected])
    decisions = []
    for what, before, after in (("pole", models.ar, ar), ("zero", models.ma, ma)):
        n_moved = int((before != after).any(axis=1).sum())
        if n_moved:
            decisions.append(f"{n_moved} of {n} models had a {what} further than {MAX_POLE} from the middle: pulled in")
    impulse = np.eye(1, _SETTLING)[0]
    ringing = np.array([np.linalg.norm(lfilter(b, a, impulse)) for a, b in zip(ar, ma, strict=True)])
    level = gain * np.sqrt(models.variance) * ringing  # standard deviations of the vibrations [m/s²]
    if not (level > 0).any():
        raise ValueError("every model is silent, expected a variance and a gain above 0")
    sd = float(np.median(level[level > 0]))
    mean, scale = models.points.mean(axis=0), np.maximum(models.points.std(axis=0), _MIN_SD)
    scaling = Scaling(mean=(0.0, *mean.tolist()), sd=(sd, *scale.tolist()))
    lsf, ma_lsf = (spread_out(np.array([line_spectral_frequencies(row) for row in rows])) for rows in (ar, ma))
    local = LocalModels(models.points, lsf, models.variance, models.triangles, scale, ma_lsf, gain).of_mesh()
    n_left_out = n - len(local.points)
    if n_left_out:
        decisions.append(f"{n_left_out} of {n} models are a corner of no triangle and were left out")
    source = f"{f'ARMA({p}, {q})' if q else f'AR({p})'} models of a Penn Haptic Texture Toolkit file"
    friction = "" if np.isnan(models.friction) else f", whose coefficient of friction is {models.friction:g}"
    preprocess = PreprocessConfig(rate_hz=models.rate_hz)
    card = {
        "rate_hz": models.rate_hz,
        "saturation": max(12.0, 6.0 * float(level.max()) / sd),
        "lowpass_hz": preprocess.render_lowpass_hz,
        "delay_ms": preprocess.delay_ms,
        "texture": name or models.material,
        "notes": "; ".join(part for part in (source + friction, *decisions, notes) if part),
        "licence": _LICENCE,
        **dict.fromkeys(("tool", "sensors", "recording_sha256", "split_sha256"), ""),
        "preprocess": asdict(preprocess),
        "split": None,
        "training": {"versions": versions()},
        "metrics": {"imported_sha256": digest},
    }
    return local_texture(local, scaling, card).texture, decisions


def _reflected(polynomial: Array) -> tuple[Array, float]:
    """A polynomial, 1 first, with its zeros reflected into the unit circle, and the gain that keeps its spectrum."""
    zeros = np.roots(polynomial)
    outside = np.abs(zeros) > 1
    if not outside.any():
        return polynomial, 1.0
    gain = float(np.abs(zeros[outside]).prod())
    zeros[outside] = 1 / np.conj(zeros[outside])
    return np.real(np.poly(zeros)), gain


def _pulled_in(polynomial: Array) -> Array:
    """A polynomial, 1 first, with its zeros within `MAX_POLE`."""
    return np.append(1.0, -stabilised(-polynomial[:0:-1], MAX_POLE)[::-1])
