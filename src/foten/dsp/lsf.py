"""Line spectral frequencies: p angles that give a polynomial, and whose means are those of a stable filter.

    P(z) = A(z) + z^−(p+1) A(1/z)        Q(z) = A(z) − z^−(p+1) A(1/z)        A = (P + Q) / 2

Where the zeros of A lie inside the unit circle, those of P and Q alternate on it, at angles 0 < ω₁ < … < ω_p < π. Any rising
angles are those of some such A, means too. In float64, order 20 with all within 1 rad has poles outside by rounding.

Source: Itakura, J. Acoust. Soc. Am. 57 (1975) S35; used between local models of a texture by Culbertson, Unwin and Kuchenbecker,
IEEE Trans. Haptics 7 (2014).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from foten.dsp import Array

MIN_GAP_RAD = 0.005  # rad between neighbours, and from 0 and π: nearer ones ring for seconds at 1 kHz


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
