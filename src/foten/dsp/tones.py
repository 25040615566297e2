"""Tones that belong to the path: what a periodic texture plays however fast the hand goes.

A surface that repeats every λ mm plays v/λ Hz and its multiples. Its phase is a place on the surface, φ = 2π/λ ∫ v dt, give or
take how uneven the surface is, so a tone keeps its line through every change of speed and its level does not wander; a
filter that rings at v/λ, excited by noise, can do neither.

    T(φ; v, f) = Σ_h A_h(v, f) cos hφ + B_h(v, f) sin hφ

The phase is known from what was heard, by a Kalman filter of one state: between two samples its variance grows by q v/rate,
for the unevenness, and the innovation e of the lattice that predicts what is left of the vibration corrects it,

    K = V h / (h² V + 1)      φ ← φ + K e      V ← (1 − K h) V      h = −∂e/∂φ

with h the tone's derivative sent through the same lattice: so it follows a recorded surface. A rendering has no surface to
follow; its phase is the path's, strays by √(q v/rate) e, and is drawn back to the path within half a second.

Source: the extended Kalman filter; that it serves textures is ours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

START_VARIANCE = 0.3  # rad², of a phase that was fitted to a window
LARGEST_VARIANCE, LEAST_VARIANCE = 3.0, 1e-6
LARGEST_INNOVATION = 3.0  # an impact says nothing of the phase
LARGEST_STEP = 0.5  # rad
N_CANDIDATES = 16  # phases that a window is compared with


def tone(coefficients: Array, phase: Array) -> tuple[Array, Array]:
    """Return T and ∂T/∂φ, in the unit of the coefficients.

    Args:
        coefficients: of cosine and sine of each multiple in turn, shape (…, 2 n_tones).
        phase: [rad], shape (…).
    """
    multiples = np.arange(1, coefficients.shape[-1] // 2 + 1)
    angle = phase[..., None] * multiples
    cosine, sine = np.cos(angle), np.sin(angle)
    a, b = coefficients[..., 0::2], coefficients[..., 1::2]
    return (a * cosine + b * sine).sum(axis=-1), (multiples * (b * cosine - a * sine)).sum(axis=-1)


def corrected(phase: Array, variance: Array, e: Array, slope: Array) -> tuple[Array, Array]:
    """Return phase [rad] and variance [rad²] after an innovation e with ∂e/∂φ = −`slope` [1/rad], each of shape (s,)."""
    gain = variance * slope / (slope * slope * variance + 1)
    step = np.clip(gain * np.clip(e, -LARGEST_INNOVATION, LARGEST_INNOVATION), -LARGEST_STEP, LARGEST_STEP)
    return phase + step, np.clip((1 - gain * slope) * variance, LEAST_VARIANCE, LARGEST_VARIANCE)


def fitted_phase(samples: Array, coefficients: Array, travelled: Array) -> Array:
    """Return the phase, of a few candidates, at which the tone is nearest a window.

    Args:
        samples: acceleration, in any unit, shape (s, n).
        coefficients: in the same, shape (s, n, 2 n_tones).
        travelled: what the path alone adds to the phase up to each sample [rad], shape (s, n).

    Returns:
        Phase where `travelled` is zero [rad], shape (s,).
    """
    candidates = 2 * np.pi * np.arange(N_CANDIDATES) / N_CANDIDATES
    missed = [
        np.square(samples - tone(coefficients, travelled + phase)[0]).sum(axis=1) for phase in candidates
    ]
    return candidates[np.argmin(missed, axis=0)]
