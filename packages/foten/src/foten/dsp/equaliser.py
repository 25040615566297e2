"""The equaliser: gains of eight bands, each a function of speed, of how speed has changed, and of force.

With x and y the logarithms of speed and force, x_i as x behind a first-order low-pass of 8, 32 and 80 ms, and d_i = x − x_i:

    φ = (1, x, y, x², xy, y², x³, x²y, x⁴,  d_i, d_i², d_i x, d_i y  for each i)
    log g_b = w_b · φ, at most `MAX_LOG_GAIN` in size          out = in + Σ_b (g_b − 1) · band-pass_b(in)

Neighbouring band-passes add up to about one. Only gains move, so that what leaves is bounded where what comes in is. A tool that
starts, stops or turns back vibrates otherwise than one that goes on, which no level over speed and force can say.

Source: ours. Band-passes: the bilinear transform of a resonance of the band's width.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.level import N_BANDS, envelope_edges

LOWPASS_MS = (8.0, 32.0, 80.0)  # behind which log speed is compared with itself
N_LOWPASSES = len(LOWPASS_MS)
N_TERMS = 9 + 4 * N_LOWPASSES
REFERENCE_SPEED, REFERENCE_FORCE = 100.0, 1.0  # mm/s and N, whose logarithms are zero
FLOOR_SPEED, FLOOR_FORCE = 5.0, 0.05  # mm/s and N, that a logarithm starts from
MAX_LOG_GAIN = 1.0  # 8.7 dB


def band_filters(rate_hz: float) -> Array:
    """Coefficients b, a₁, a₂ of each band's b (1 − z⁻²) / (1 + a₁ z⁻¹ + a₂ z⁻²), shape (N_BANDS, 3)."""
    edges = np.tan(np.pi * envelope_edges(rate_hz) / rate_hz)
    width, square = edges[1:] - edges[:-1], edges[1:] * edges[:-1]
    total = 1 + width + square
    return np.stack([width / total, 2 * (square - 1) / total, (1 - width + square) / total], axis=1)


def smoothing(rate_hz: float) -> Array:
    """Share of a new value that each low-pass takes, (3,), rounded as a texture file holds it."""
    return (1 - np.exp(-1000 / (rate_hz * np.array(LOWPASS_MS)))).astype(np.float32).astype(float)


def logarithms(speed: Array, force: Array) -> tuple[Array, Array]:
    """x and y: speed [mm/s] and force [N], none negative, shapes (…)."""
    x = np.log((speed + FLOOR_SPEED) / (REFERENCE_SPEED + FLOOR_SPEED))
    return x, np.log((force + FLOOR_FORCE) / (REFERENCE_FORCE + FLOOR_FORCE))


def terms(x: Array, y: Array, behind: Array) -> Array:
    """φ: x and y (…), and x behind each low-pass (3, …) → (N_TERMS, …)."""
    square = x * x
    steady = [np.ones_like(x), x, y, square, x * y, y * y, square * x, square * y, square * square]
    changes = [part for d in x - behind for part in (d, d * d, d * x, d * y)]
    return np.stack([*steady, *changes])


def terms_of(speed: Array, force: Array, rate_hz: float) -> Array:
    """φ of strokes, each as after a long time at its first speed: speed [mm/s] and force [N] (…, n) → (N_TERMS, …, n)."""
    from scipy.signal import lfilter

    x, y = logarithms(speed, force)
    behind = [
        lfilter([share], [1.0, share - 1], x, axis=-1, zi=(1 - share) * x[..., :1])[0] for share in smoothing(rate_hz)
    ]
    return terms(x, y, np.stack(behind))


def in_bands(signals: Array, filters: Array) -> Array:
    """Signals (…, n), from rest, through each band-pass: (N_BANDS, …, n)."""
    from scipy.signal import lfilter

    return np.stack([lfilter([b, 0.0, -b], [1.0, a1, a2], signals, axis=-1) for b, a1, a2 in filters])


@dataclass(frozen=True)
class Equaliser:
    """Weights and filters of an equaliser at one rate."""

    weights: Array  # w, (N_BANDS, N_TERMS)
    filters: Array  # `band_filters`, (N_BANDS, 3)
    smoothing: Array  # of each low-pass, (3,)

    @classmethod
    def of_weights(cls, weights: Array, rate_hz: float) -> Equaliser:
        """The equaliser at a rate, rounded as a texture file holds it."""
        return cls(*(x.astype(np.float32).astype(float) for x in (weights, band_filters(rate_hz), smoothing(rate_hz))))

    @classmethod
    def of(cls, tensors: Mapping[str, NDArray[Any]]) -> Equaliser:
        """That of a texture; ValueError where a filter is unstable."""
        weights, filters, shares = (tensors[f"equaliser.{name}"].astype(float) for name in cls.__annotations__)
        _, a1, a2 = filters.T
        if not ((np.abs(a2) < 1) & (np.abs(a1) < 1 + a2)).all() or not ((shares > 0) & (shares <= 1)).all():
            raise ValueError("a band-pass of the equaliser is unstable, expected poles within the unit circle")
        return cls(weights, filters, shares)

    def tensors(self) -> dict[str, NDArray[np.float32]]:
        """As a texture file holds it."""
        return {f"equaliser.{name}": value.astype(np.float32) for name, value in vars(self).items()}

    def gains(self, phi: Array) -> Array:
        """Gain of each band: φ (N_TERMS, …) → (N_BANDS, …)."""
        return np.exp(self.log_gains(phi))

    def log_gains(self, phi: Array) -> Array:
        """Their logarithms."""
        return np.clip(np.tensordot(self.weights, phi, 1), -MAX_LOG_GAIN, MAX_LOG_GAIN)

    def applied(self, signals: Array, phi: Array) -> Array:
        """Signals (…, n), from rest, under φ (N_TERMS, …, n), which broadcasts to them."""
        return self.mixed(signals, in_bands(signals, self.filters), phi)

    def mixed(self, signals: Array, bands: Array, phi: Array) -> Array:
        """The same, of signals whose `in_bands` are known."""
        more = self.gains(phi) - 1
        return signals + np.sum([g * band for g, band in zip(more, bands, strict=True)], axis=0)

    def bound(self) -> float:
        """What leaves is at most so many times as large as the largest sample that came in."""
        impulse = np.zeros(2**15)
        impulse[0] = 1.0
        return float(1 + (np.exp(MAX_LOG_GAIN) - 1) * np.abs(in_bands(impulse, self.filters)).sum())


class EqualiserStream:
    """s streams of an equaliser, sample by sample."""

    def __init__(self, equaliser: Equaliser, speed: Array, force: Array) -> None:
        """As after a long time at a speed and force, (s,) each, from silence."""
        self.equaliser = equaliser
        self.states = np.zeros((2, N_BANDS, len(speed)))
        self.behind = np.repeat(logarithms(speed, force)[0][None], N_LOWPASSES, axis=0)

    def push(self, sample: Array, speed: Array, force: Array) -> Array:
        """What leaves of the next sample, under its speed and force: (s,) each."""
        x, y = logarithms(speed, force)
        self.behind = self.behind + self.equaliser.smoothing[:, None] * (x - self.behind)
        more = self.equaliser.gains(terms(x, y, self.behind)) - 1
        b, a1, a2 = self.equaliser.filters.T[..., None]
        band = b * sample + self.states[0]
        self.states = np.stack([self.states[1] - a1 * band, -b * sample - a2 * band])
        return sample + (more * band).sum(axis=0)
