"""Tones of the path: a surface that repeats every λ mm vibrates at v/λ Hz and its multiples.

    T(φ; v, f) = ℓ(v, f) Σ_h A_h(v, f) cos hφ + B_h(v, f) sin hφ      φ = 2π/λ ∫ v dt

ℓ is the level. Periods differ by a share s: the phase's rate is off by r, correlated over half a period, from innovations e,

    r ← ρ r + √(1 − ρ²) s e      ρ = exp(−2 v / (λ rate))      φ ← φ + 2π v / (λ rate) · (1 + r)

so its variance grows by q = 4π² s²/λ a mm. It returns to the path's in half a second. A lattice renders the rest. Source: ours.
"""

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array

MAX_JITTER_DRIVE = 3.0  # standard deviations, of the innovation that drives the jitter
N_CANDIDATES = 32  # phases that a window is compared with


def tone(coefficients: Array, phase: Array) -> Array:
    """T, in the unit of the coefficients of cosine and sine in turn: (…, 2 n_tones), phase [rad] (…) → (…)."""
    cosine, sine, _ = _waves(coefficients, phase)
    return (coefficients[..., 0::2] * cosine + coefficients[..., 1::2] * sine).sum(axis=-1)


def anti_alias_gain(n_tones: int, phase_increment: Array) -> Array:
    """Gains of the multiples at a phase increment a sample [rad]: 1 up to 0.45 of the rate, 0 from half: (…) → (…, 2 n_tones)."""
    multiples = np.repeat(np.arange(1, n_tones + 1), 2)
    return np.clip(10.0 - 10.0 * multiples * phase_increment[..., None] / np.pi, 0.0, 1.0)


def tone_slope(coefficients: Array, phase: Array) -> Array:
    """Slope ∂T/∂φ, in the unit of the coefficients a radian: as `tone`."""
    cosine, sine, multiples = _waves(coefficients, phase)
    return (multiples * (coefficients[..., 1::2] * cosine - coefficients[..., 0::2] * sine)).sum(axis=-1)


def _waves(coefficients: Array, phase: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    multiples = np.arange(1, coefficients.shape[-1] // 2 + 1)
    angle = phase[..., None] * multiples
    return np.cos(angle), np.sin(angle), multiples


def fitted_phase(samples: Array, coefficients: Array, travelled: Array) -> Array:
    """Phase [rad] (s,) at which tones (s, n, 2 n_tones) along `travelled` [rad] (s, n) are nearest samples (s, n)."""
    candidates = 2 * np.pi * np.arange(N_CANDIDATES) / N_CANDIDATES
    errors = [np.square(samples - tone(coefficients, travelled + phase)).sum(axis=1) for phase in candidates]
    return candidates[np.argmin(errors, axis=0)]
