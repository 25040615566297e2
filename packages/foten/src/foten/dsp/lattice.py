"""The normalised lattice: a linear predictor that follows speed and force, and is stable however they move.

With reflection coefficients k₁ … k_p and the leak β, section i rotates (f_i, b_{i−1}) into (f_{i−1}, b_i):

    f_{i−1}[n] = c_i f_i[n] − k_i β b_{i−1}[n−1]        c_i = √(1 − k_i²),  e = f_p goes in
    b_i[n]     = k_i f_i[n] + c_i β b_{i−1}[n−1]        b₀[n] = f₀[n] = x[n] comes out

A rotation keeps f² + b², so for any k(v[n], f[n]) in (−1, 1) the sum of squares of the state b₀ … b_{p−1} is a Lyapunov
function: with |e| ≤ E it ends up below E²/(1 − β²). For constant k, β = 1 and white e of unit variance every f and b has unit
variance.

Source: Gray & Markel, "A normalized digital filter structure", IEEE Trans. ASSP 23 (1975), for the structure.
"""

import numpy as np

from foten.dsp import Array

LEAK = 0.9997  # a state without input falls by e in 3333 samples at most
MIN_GAIN_PRODUCT = 1e-150  # Π c_i below which section by section, since products of more would be no numbers
MAX_REFLECTION = 0.99999  # of a vertex; 1 would be an undamped oscillation


def check_reflections(reflections: Array) -> None:
    """Refuse reflections of which one is 1 or more in size."""
    largest = float(np.abs(reflections).max(initial=0.0))
    if not largest < 1:
        raise ValueError(f"a reflection is {largest:.6g} in size, expected less than 1 for a stable lattice")


def analyse(x: Array, reflections: Array) -> tuple[Array, Array, Array]:
    """Innovations (s, n) of signals x (s, n) that begin from rest, under the reflections (s, n, p) of each sample.

    They have unit variance where the reflections fit. Also Π c_i (s, n), with which the prediction of each sample from those
    before it is x − e · Π c_i; and b₀ … b_{p−1} after the last sample (p, s).
    """
    f, b, gain = x, x, np.ones_like(x)
    states = np.empty((reflections.shape[2], len(x)))
    for i in range(len(states)):
        states[i] = b[:, -1]
        f, b, cosine = rotate_back(f, delayed(b), reflections[:, :, i])
        gain = gain * cosine
    return f, gain, states


def delayed(b: Array) -> Array:
    """The states times the leak, β b[n−1], zero before the first sample: (…, n) → (…, n)."""
    out = np.zeros_like(b)
    out[..., 1:] = LEAK * b[..., :-1]
    return out


def rotate_back(f: Array, b: Array, k: Array) -> tuple[Array, Array, Array]:
    """F_i, b_i and c_i from f_{i−1} and the delayed b_{i−1}: a section run from output to innovation."""
    cosine = np.sqrt(1 - k * k)
    return (f + k * b) / cosine, (b + k * f) / cosine, cosine


def predict(states: Array, reflections: Array) -> tuple[Array, Array]:
    """The next sample without innovation, and by how much a unit of innovation moves it, (s,) each.

    From b₀ … b_{p−1} after the last sample and k₁ … k_p of the next, shapes (p, s), all sections at once: with f_p = 0,
    f₀ = −Σ k_i β b_{i−1} Π_{j<i} c_j.
    """
    cosines = np.sqrt(1 - reflections * reflections)
    gains = np.cumprod(cosines, axis=0)
    if not (gains[-1] > MIN_GAIN_PRODUCT).all():
        f = np.zeros(states.shape[1])
        for i in range(len(states) - 1, -1, -1):
            f = cosines[i] * f - reflections[i] * (LEAK * states[i])
        return f, gains[-1]
    weighed = reflections * states
    weighed[1:] *= gains[:-1]
    return -LEAK * weighed.sum(axis=0), gains[-1]


def push(states: Array, reflections: Array, x: Array) -> tuple[Array, Array]:
    """The states after a sample x, shape (s,), and its innovation: states and its reflections (p, s) → (p, s), (s,).

    All sections at once: f_i Π_{j≤i} c_j = x + Σ_{l≤i} k_l β b_{l−1} Π_{j<l} c_j.
    """
    b, cosines = LEAK * states, np.sqrt(1 - reflections * reflections)
    gains = np.cumprod(cosines, axis=0)
    f = np.empty((len(states) + 1, len(x)))
    f[0] = x
    if (gains[-1] > MIN_GAIN_PRODUCT).all():
        weighed = reflections * b
        weighed[1:] *= gains[:-1]
        f[1:] = (x + np.cumsum(weighed, axis=0)) / gains
    else:
        for i in range(len(states)):
            f[i + 1] = (f[i] + reflections[i] * b[i]) / cosines[i]
    after = np.empty_like(states)
    after[0] = x
    after[1:] = (b[:-1] + reflections[:-1] * f[:-2]) / cosines[:-1]
    return after, f[-1]


def polynomial(reflections: Array, leak: float = LEAK) -> Array:
    """A(z) of a lattice of constant reflections (p,), 1 first, shape (p + 1,); its all-pole filter is Π c_i / A."""
    a = np.ones(1)
    for k in reflections:
        a = np.append(a, 0.0) + k * np.append(0.0, a[::-1])
    return a * leak ** np.arange(a.size)


def reflections_of(polynomials: Array) -> Array:
    """Reflections with which a lattice, its leak included, is 1/A, stable or made so: (b, p + 1), 1 first → (b, p)."""
    b, p = polynomials.shape[0], polynomials.shape[1] - 1
    a = polynomials / LEAK ** np.arange(p + 1)
    reflections = np.empty((b, p))
    for i in range(p, 0, -1):
        k = np.clip(a[:, i], -MAX_REFLECTION, MAX_REFLECTION)
        reflections[:, i - 1] = k
        a = (a[:, :i] - k[:, None] * a[:, i:0:-1]) / (1 - k * k)[:, None]
    return reflections
