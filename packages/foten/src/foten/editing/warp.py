"""Spectra moved and stretched over log frequency, as reflection coefficients and as amplitudes of tones."""

from dataclasses import dataclass

import numpy as np

from foten.dsp import Array
from foten.dsp.ar import levinson
from foten.dsp.lattice import MAX_REFLECTION, polynomial

N_BINS = 8192  # of a spectrum from 0 to half the rate
LOWEST_HZ = 5.0  # below it a density is that at this frequency
DENSITY_FLOOR = 1e-9  # of the largest: rounding of autocovariances is about 1e-12
AR_FLOOR = 1e-10  # white noise beside the spectrum of which reflections are taken, as a share of its power


@dataclass(frozen=True)
class Warp:
    """A map of log frequency, f → centre · 2^octaves · (f / centre)^stretch, that keeps the power of each stretch of it."""

    centre_hz: float
    octaves: float = 0.0  # upwards
    stretch: float = 1.0

    def source(self, frequency: Array) -> Array:
        """Which frequency comes to lie at each, [Hz] → [Hz]."""
        octaves = np.log2(np.maximum(frequency, 1e-9) / self.centre_hz) - self.octaves
        return np.asarray(self.centre_hz * 2 ** (octaves / self.stretch))

    def density(self, frequency: Array, density: Array) -> Array:
        """A power density at rising frequencies [Hz] (k,), warped: (…, k) → (…, k)."""
        at = np.maximum(frequency, LOWEST_HZ)
        source = self.source(at)
        floor = DENSITY_FLOOR * density.max(axis=-1, keepdims=True)
        logs = np.log(np.maximum(density, floor))
        moved = np.apply_along_axis(lambda row: np.interp(source, frequency, row), -1, logs)
        return np.asarray(np.exp(moved) * source / (self.stretch * at))


def spectra_of(reflections: Array) -> Array:
    """Power densities of all-pole lattices, any scale: reflections (b, p) → (b, `N_BINS` + 1)."""
    polynomials = np.stack([polynomial(k) for k in reflections])
    return 1 / np.square(np.abs(np.fft.rfft(polynomials, 2 * N_BINS, axis=1)))


def reflections_for(density: Array, order: int) -> Array:
    """Reflections of the lattices whose spectra are nearest densities: (b, k) on even bins from 0 to half the rate → (b, p).

    Stable for any density. Source: the autocorrelation method, by Levinson and Durbin.
    """
    moments = np.fft.irfft(density, axis=1)[:, : order + 1].T
    moments = np.pad(moments, ((0, max(0, order + 1 - len(moments))), (0, 0)))
    moments[0] *= 1 + AR_FLOOR
    reflections, _ = levinson(moments)
    return np.clip(reflections.T, -MAX_REFLECTION, MAX_REFLECTION)


def warped_reflections(reflections: Array, rate_hz: float, warp: Warp) -> Array:
    """Reflections (b, p) of the same lattices with their spectra warped."""
    frequency = np.linspace(0, rate_hz / 2, N_BINS + 1)
    return reflections_for(warp.density(frequency, spectra_of(reflections)), reflections.shape[1])


def warped_tones(amplitudes: Array, fundamental_hz: Array, warp: Warp) -> Array:
    """Amplitudes of multiples of fundamentals [Hz] (b,) with a warped envelope: (b, 2 n), cosine and sine in turn → (b, 2 n).

    Frequencies are those of the path and stay; loudness moves. The envelope falls by 12 dB an octave beyond both of its ends.
    """
    b, n = amplitudes.shape[0], amplitudes.shape[1] // 2
    pairs = amplitudes.reshape(b, n, 2)
    size = np.hypot(pairs[..., 0], pairs[..., 1])
    multiples = np.arange(1, n + 1)
    known, out = np.log(multiples), pairs.copy()
    for row, hz in enumerate(np.maximum(fundamental_hz, 1e-3)):
        if not size[row].any():
            continue
        envelope = np.maximum(size[row], 1e-6 * size[row].max())
        source = np.log(warp.source(hz * multiples) / hz)
        outside = np.maximum(0.0, source - known[-1]) + np.maximum(0.0, known[0] - source)
        moved = np.exp(np.interp(source, known, np.log(envelope)) - 2 * outside)
        out[row] *= (moved / envelope)[:, None]
    return out.reshape(b, 2 * n)
