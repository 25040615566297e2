"""Linear prediction: least-squares fits, stability, reflections, and line spectral frequencies.

The latter are p angles that give a polynomial, and whose means are those of a stable filter:

    P(z) = A(z) + z^−(p+1) A(1/z)        Q(z) = A(z) − z^−(p+1) A(1/z)        A = (P + Q) / 2

Where the zeros of A lie inside the unit circle, those of P and Q alternate on it, at angles 0 < ω₁ < … < ω_p < π. Any rising
angles are those of some such A, means too. In float64, order 20 with all within 1 rad has poles outside by rounding.

Source: Itakura, J. Acoust. Soc. Am. 57 (1975) S35; used between local models of a texture by Culbertson, Unwin and Kuchenbecker,
IEEE Trans. Haptics 7 (2014).
"""

from collections.abc import Sequence

import numpy as np

from foten.dsp import Array

MAX_POLE = 0.9995  # a memory of 2000 samples
MIN_GAP_RAD = 0.005  # rad between neighbours, and from 0 and π: nearer ones ring for seconds at 1 kHz


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


def line_spectral_frequencies(a: Array) -> Array:
    """Angles of a polynomial: (p + 1,), 1 first → (p,), rising [rad]; ValueError where a zero is not inside the unit circle."""
    p = a.size - 1
    if p == 0:
        return np.empty(0)
    if not np.abs(np.roots(a)).max() < 1:
        raise ValueError("the polynomial has a zero outside the unit circle, expected a stable filter")
    padded = np.append(a, 0.0)
    both = [padded + padded[::-1], padded - padded[::-1]]
    zeros = [np.roots(np.polydiv(polynomial, known)[0]) for polynomial, known in zip(both, _known(p), strict=True)]
    angles = np.angle(np.concatenate(zeros))
    return np.sort(angles[angles > 0])


def _known(p: int) -> tuple[list[float], list[float]]:
    """Factors of P and Q whose zeros no frequency stands for: at −1 and 1, or both of Q."""
    return ([1.0], [1.0, 0.0, -1.0]) if p % 2 else ([1.0, 1.0], [1.0, -1.0])


def polynomial_of(frequencies: Array) -> Array:
    """Polynomial A of line spectral frequencies: (b, p) → (b, p + 1), 1 first."""
    b, p = frequencies.shape
    both = [np.ones((b, 1)), np.ones((b, 1))]
    for i in range(p):
        both[i % 2] = _times(both[i % 2], [1.0, -2 * np.cos(frequencies[:, i, None]), 1.0])
    first, second = (_times(polynomial, known) for polynomial, known in zip(both, _known(p), strict=True))
    return np.asarray((0.5 * (first + second))[:, : p + 1])


def _times(polynomials: Array, factor: Sequence[float | Array]) -> Array:
    out = np.zeros((len(polynomials), polynomials.shape[1] + len(factor) - 1))
    for lag, weight in enumerate(factor):
        out[:, lag : lag + polynomials.shape[1]] += weight * polynomials
    return out


def spread_out(frequencies: Array) -> Array:
    """The same angles, rising by at least `MIN_GAP_RAD` and as far from 0 and π: (…, p) → (…, p)."""
    steps = MIN_GAP_RAD * np.arange(1, frequencies.shape[-1] + 1)
    up = np.maximum.accumulate(frequencies - steps, axis=-1).clip(min=0.0) + steps
    down = up + steps[::-1] - np.pi
    highest = np.minimum.accumulate(down[..., ::-1], axis=-1)[..., ::-1].clip(max=0.0)
    return np.asarray(highest + np.pi - steps[::-1])
