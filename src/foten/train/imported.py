"""Local models that others have fitted, as a texture file."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from foten.datasets.hatt import HattModels
from foten.dsp.ar import MAX_POLE, stabilised
from foten.dsp.lsf import line_spectral_frequencies, spread_out
from foten.families.piecewise_ar import HIGHEST_ORDER
from foten.families.texture_file import Texture
from foten.recording.preprocess import PreprocessConfig
from foten.recording.scaling import Scaling
from foten.train.job import versions
from foten.train.piecewise_ar_texture import LocalModels, local_texture

Array = NDArray[np.float64]

_LEAST_SD = np.array([1.0, 0.01])  # mm/s and N; models all at one force still have a scale
_SETTLING = 4096  # samples of an impulse response that a level is told from
_LICENCE = "as of the model file; Penn's toolkit: non-profit research, no distribution, see the notice in the file"


def texture_of(models: HattModels, digest: str, name: str = "", notes: str = "") -> tuple[Texture, list[str]]:
    """Return models of a file as a texture, and what was decided on the way.

    A pole that would ring for seconds, or grow, is pulled in, with the others of its model. Zeros outside the unit circle are
    reflected into it, which leaves the spectrum as it was. The recording behind the file is not known: there is no split, and a
    recording is judged as another's, on all of its blocks.

    Args:
        digest: SHA-256 of the file.
        name: of the texture; the material's by default.
        notes: for the card, after where the models came from.

    Raises:
        ValueError: they make no stable texture.
    """
    n, p, q = len(models.points), models.ar.shape[1] - 1, models.ma.shape[1] - 1
    for what, order in (("AR", p), ("MA", q)):
        if order > HIGHEST_ORDER:
            raise ValueError(f"the {what} order is {order}, expected at most {HIGHEST_ORDER}")
    reflected = [_reflected(row) for row in models.ma]
    gain = models.gain * np.array([size for _, size in reflected])
    ar = np.array([_pulled_in(row) for row in models.ar])
    ma = np.array([_pulled_in(row) for row, _ in reflected])
    decisions = []
    for what, before, after in (("pole", models.ar, ar), ("zero", models.ma, ma)):
        n_moved = int((before != after).any(axis=1).sum())
        if n_moved:
            decisions.append(f"{n_moved} of {n} models had a {what} further than {MAX_POLE} from the middle: pulled in")
    level = np.array([_level(*row) for row in zip(ar, ma, models.variance, gain, strict=True)])
    if not (level > 0).any():
        raise ValueError("every model is silent, expected a variance and a gain above 0")
    sd = float(np.median(level[level > 0]))
    mean, scale = models.points.mean(axis=0), np.maximum(models.points.std(axis=0), _LEAST_SD)
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
        "tool": "",
        "sensors": "",
        "notes": "; ".join(part for part in (source + friction, *decisions, notes) if part),
        "licence": _LICENCE,
        "recording_sha256": "",
        "preprocess": asdict(preprocess),
        "split": None,
        "split_sha256": "",
        "training": {"versions": versions()},
        "metrics": {"imported_sha256": digest},
    }
    return local_texture(local, scaling, card).texture, decisions


def _reflected(polynomial: Array) -> tuple[Array, float]:
    """Return a polynomial, 1 first, with its zeros reflected into the unit circle, and the gain that keeps its spectrum."""
    zeros = np.roots(polynomial)
    outside = np.abs(zeros) > 1
    if not outside.any():
        return polynomial, 1.0
    gain = float(np.abs(zeros[outside]).prod())
    zeros[outside] = 1 / np.conj(zeros[outside])
    return np.real(np.poly(zeros)), gain


def _pulled_in(polynomial: Array) -> Array:
    """Return a polynomial, 1 first, with its zeros within `MAX_POLE`."""
    return np.append(1.0, -stabilised(-polynomial[:0:-1], MAX_POLE)[::-1])


def _level(a: Array, b: Array, variance: float, gain: float) -> float:
    """Return the standard deviation of a model's vibration [m/s²]."""
    response = lfilter(b, a, np.eye(1, _SETTLING)[0])
    return float(gain * np.sqrt(variance) * np.linalg.norm(response))
