"""Linear prediction: least-squares fits, stability, and what a linear process lets any predictor reach."""

from __future__ import annotations

import numpy as np

from foten.dsp import Array

MAX_POLE = 0.9995  # a memory of 2000 samples


def solved(gram: Array, moment: Array) -> Array:
    """Coefficients w that minimise |X w − y|², shape (k,), from XᵀX (k, k) and Xᵀy (k,)."""
    # Neighbouring samples at 10 kHz are nearly collinear.
    ridge = 1e-9 * np.trace(gram) / gram.shape[0] * np.eye(gram.shape[0])
    return np.asarray(np.linalg.solve(gram + ridge, moment), dtype=np.float64)


def spectral_radius(taps: Array) -> float:
    """Largest pole magnitude of x[n] = Σ taps[i]·x[n−m+i], `taps` oldest first as in a window."""
    return float(np.abs(np.roots(np.concatenate([[1.0], -taps[::-1]]))).max()) if taps.any() else 0.0


def stabilised(taps: Array, radius: float) -> Array:
    """Taps with every pole within `radius`: γ^k on the tap of lag k scales every pole by γ, and keeps its frequency."""
    largest = spectral_radius(taps)
    return taps if largest <= radius else taps * (radius / largest) ** np.arange(taps.size, 0, -1)


def levinson(moments: Array) -> tuple[Array, Array]:
    """Reflections of autoregressions (p, b), and the variance that orders 0 … p leave (p + 1, b).

    From autocovariances at lags 0 … p, (p + 1, b); biased ones give stable autoregressions. Source: Levinson and Durbin.
    """
    p, b = moments.shape[0] - 1, moments.shape[1]
    a, reflections, errors = np.zeros((p + 1, b)), np.zeros((p, b)), np.empty((p + 1, b))
    a[0], errors[0] = 1.0, moments[0]
    for i in range(1, p + 1):
        residual = (a[:i] * moments[i:0:-1]).sum(axis=0)
        k = np.divide(-residual, errors[i - 1], out=np.zeros(b), where=errors[i - 1] > 0).clip(-1.0, 1.0)
        a[1 : i + 1] = a[1 : i + 1] + k * a[i - 1 :: -1][:i]
        reflections[i - 1], errors[i] = k, errors[i - 1] * (1 - k * k)
    return reflections, errors


def burg(x: Array, p: int) -> tuple[Array, float]:
    """Reflections (p,) of an autoregression of order p, and the variance of its innovations: x (n,) of mean zero (Burg 1975)."""
    forward, backward = x[1:].copy(), x[:-1].copy()
    reflections, error = np.zeros(p), float(np.square(x).mean())
    for i in range(p):
        power = float(forward @ forward + backward @ backward)
        k = -2.0 * float(forward @ backward) / power if power > 0 else 0.0
        reflections[i] = k
        error *= 1 - k * k
        forward, backward = (forward + k * backward)[1:], (backward + k * forward)[:-1]
    return reflections, error
