"""Butterworth low- and high-passes as biquads, streaming and offline with the same result."""

import math

import numpy as np

from foten.dsp import Array

Sections = tuple[tuple[float, float, float, float, float], ...]
"""A cascade of biquads, each (b0, b1, b2, a1, a2) with a0 = 1."""


def butterworth(kind: str, cutoff_hz: float, rate_hz: float, order: int = 2) -> Sections:
    """Butterworth `lowpass` or `highpass` by its −3 dB frequency; ValueError above half the rate or for an odd order.

    Bilinear, prewarped; one biquad for each pair of poles at angle θ from the negative real axis, whose damping is 1/Q = 2 cos θ.
    """
    if not 0 < cutoff_hz < rate_hz / 2:
        raise ValueError(f"cutoff is {cutoff_hz:g} Hz, expected between 0 and half the rate, {rate_hz / 2:g} Hz")
    if order < 2 or order % 2:
        raise ValueError(f"filter order is {order}, expected 2, 4, 6, …")
    warped = math.tan(math.pi * cutoff_hz / rate_hz)
    sections = []
    for pair in range(order // 2):
        damping = 2 * math.cos(math.pi * (2 * pair + 1) / (2 * order))
        norm = 1 + damping * warped + warped * warped
        a1, a2 = 2 * (warped * warped - 1) / norm, (1 - damping * warped + warped * warped) / norm
        b0, b1 = (warped * warped / norm, 2.0) if kind == "lowpass" else (1 / norm, -2.0)
        sections.append((b0, b1 * b0, b0, a1, a2))
    return tuple(sections)


def delay_s(sections: Sections, rate_hz: float) -> float:
    """Group delay of a low-pass at 0 Hz [s]: Σ k·b_k / Σ b_k − Σ k·a_k / Σ a_k samples, summed over the sections."""
    of_sections = ((b1 + 2 * b2) / (b0 + b1 + b2) - (a1 + 2 * a2) / (1 + a1 + a2) for b0, b1, b2, a1, a2 in sections)
    return sum(of_sections) / rate_hz


class Biquads:
    """A cascade of biquads that filters a signal piece by piece (direct form II transposed)."""

    def __init__(self, sections: Sections) -> None:
        self._sections = sections
        self.reset()

    def reset(self, value: float = 0.0) -> None:
        """Forget the past, as if the input had been constant at `value` for ever."""
        self._state: list[tuple[float, float]] = []
        for b0, b1, b2, a1, a2 in self._sections:
            settled = value * (b0 + b1 + b2) / (1 + a1 + a2)
            second = b2 * value - a2 * settled
            self._state.append((b1 * value - a1 * settled + second, second))
            value = settled

    def process(self, samples: Array) -> Array:
        """Filter the next piece, shape (n,), and keep the state."""
        values = np.asarray(samples, dtype=np.float64).tolist()
        for index, (b0, b1, b2, a1, a2) in enumerate(self._sections):
            first, second = self._state[index]
            for i, x in enumerate(values):
                y = b0 * x + first
                first = b1 * x - a1 * y + second
                second = b2 * x - a2 * y
                values[i] = y
            self._state[index] = (first, second)
        return np.array(values)


def filter_recorded(sections: Sections, samples: Array, *, zero_phase: bool = False) -> Array:
    """Recorded signal, filtered as by `Biquads`, shape (n,), settled on its first value; `zero_phase` filters both ways."""
    from scipy import signal

    sos = np.array([[b0, b1, b2, 1.0, a1, a2] for b0, b1, b2, a1, a2 in sections])
    if zero_phase:
        return np.asarray(signal.sosfiltfilt(sos, samples))
    return np.asarray(signal.sosfilt(sos, samples, zi=signal.sosfilt_zi(sos) * samples[0])[0])
