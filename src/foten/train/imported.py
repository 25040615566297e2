"""Local models that others have fitted, as a texture file."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from foten.datasets.hatt import HattModels
from foten.dsp.ar import MAX_POLE, stabilised
from foten.dsp.lsf import line_spectral_frequencies, spread_out
from foten.families.piecewise_ar import HIGHEST_ORDER
from foten.families.texture_file import Texture
from foten.recording.preprocess import PreprocessConfig
from foten.recording.scaling import Scaling
from foten.train.card import versions
from foten.train.piecewise_ar_texture import LocalModels, local_texture

Array = NDArray[np.float64]

_LEAST_SD = np.array([1.0, 0.01])  # mm/s and N; models all at one force still have a scale
_SETTLING = 4096  # samples of an impulse response that a level is told from


LICENCE = "as of the model file; Penn's toolkit: non-profit research, no distribution, see the notice in the file"


def texture_of(
    models: HattModels, digest: str, name: str = "", licence: str = LICENCE, notes: str = ""
) -> tuple[Texture, list[str]]:
    """Return models of a file as a texture, and what was decided on the way.

    A pole that would ring for seconds, or grow, is pulled in, with the others of its model. Zeros outside the unit circle are
    reflected into it, which leaves the spectrum as it was. The recording behind the file is not known: there is no split, and a
    recording is judged as another's, on all of its blocks.

    Args:
        models: from `read_models`.
        digest: SHA-256 of the file.
        name: of the texture; the material's by default.
        licence: for the card.
        notes: for the card, after where the models came from.

    Raises:
        ValueError: they make no stable texture.
    """
    decisions = []
    for what, coefficients in (("AR", models.ar), ("MA", models.ma)):
        if coefficients.shape[1] - 1 > HIGHEST_ORDER:
            raise ValueError(f"the {what} order is {coefficients.shape[1] - 1}, expected at most {HIGHEST_ORDER}")
    reflected = [_reflected(row) for row in models.ma]
    gain = models.gain * np.array([size for _, size in reflected])
    ar = np.array([_pulled_in(row) for row in models.ar])
    ma = np.array([_pulled_in(row) for row, _ in reflected])
    for what, before, after in (("pole", models.ar, ar), ("zero", models.ma, ma)):
        n_moved = int((before != after).any(axis=1).sum())
        if n_moved:
            decisions.append(
                f"{n_moved} of {len(ar)} models had a {what} further than {MAX_POLE} from the middle: pulled in"
            )
    scale = np.maximum(models.points.std(axis=0), _LEAST_SD)
    lsf = spread_out(np.array([line_spectral_frequencies(row) for row in ar]))
    ma_lsf = spread_out(np.array([line_spectral_frequencies(row) for row in ma]))
    level = np.array([_level(*row) for row in zip(ar, ma, models.variance, gain, strict=True)])
    audible = level[level > 0]
    if not audible.size:
        raise ValueError("every model is silent, expected a variance and a gain above 0")
    sd = float(np.median(audible))
    (speed, force), (speed_sd, force_sd) = models.points.mean(axis=0), scale
    scaling = Scaling(mean=(0.0, float(speed), float(force)), sd=(sd, float(speed_sd), float(force_sd)))
    used, triangles = np.unique(models.triangles, return_inverse=True)
    if used.size < len(ar):
        decisions.append(f"{len(ar) - used.size} of {len(ar)} models are a corner of no triangle and were left out")
    local = LocalModels(
        models.points[used],
        lsf[used],
        models.variance[used],
        triangles.reshape(models.triangles.shape),
        scale,
        ma_lsf[used],
        gain[used],
    )
    preprocess = PreprocessConfig(rate_hz=models.rate_hz)
    zeros = f"ARMA({ar.shape[1] - 1}, {ma_lsf.shape[1]})" if ma_lsf.shape[1] else f"AR({ar.shape[1] - 1})"
    source = f"{zeros} models of a Penn Haptic Texture Toolkit file"
    friction = "" if np.isnan(models.friction) else f", whose coefficient of friction is {models.friction:g}"
    card = {
        "rate_hz": models.rate_hz,
        "saturation": max(12.0, 6.0 * float(level.max()) / sd),
        "lowpass_hz": preprocess.render_lowpass_hz,
        "delay_ms": preprocess.delay_ms,
        "texture": name or models.material,
        "tool": "",
        "sensors": "",
        "notes": "; ".join(part for part in (source + friction, *decisions, notes) if part),
        "licence": licence,
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
    inside = np.where(outside, 1 / np.conj(np.where(outside, zeros, 1.0)), zeros)
    return np.real(np.poly(inside)), float(np.abs(zeros[outside]).prod())


def _pulled_in(polynomial: Array) -> Array:
    """Return a polynomial, 1 first, with its zeros within `MAX_POLE`."""
    if polynomial.size == 1:
        return polynomial
    return np.append(1.0, -stabilised(-polynomial[:0:-1], MAX_POLE)[::-1])


def _level(a: Array, b: Array, variance: float, gain: float) -> float:
    """Return the standard deviation of a model's vibration [m/s²]."""
    from scipy.signal import lfilter

    response = lfilter(b, a, np.eye(1, _SETTLING)[0])
    return float(gain * np.sqrt(variance) * np.linalg.norm(response))
