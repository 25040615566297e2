"""Three axes of vibration to one, with the energy of all three (DFT321)."""

from __future__ import annotations

import numpy as np

from foten.dsp import Array


def dft321(axes: Array) -> Array:
    """One signal whose energy spectrum is the sum of the axes' and whose phase is that of their sum.

        |A_s(f)| = √Σ_k |A_k(f)|²,   arg A_s(f) = arg Σ_k A_k(f)

    Call it on one block at a time: over a whole record it smears bursts across the borders of training and test.

    Args:
        axes: acceleration [m/s²], shape (…, n_axes, n); the result has (…, n).

    Source: Landin, Romano, McMahan, Kuchenbecker 2010; Sec. III-c.
    Differs from the paper: where the axes cancel (|Σ A_k| ≈ 0), the phase is the largest axis's; the mean (0 Hz) and,
    for even n, the Nyquist bin keep the sign of the sum.
    """
    spectra = np.fft.rfft(axes, axis=-1)
    magnitude = np.sqrt((np.abs(spectra) ** 2).sum(axis=-2))
    total = spectra.sum(axis=-2)
    largest = np.take_along_axis(spectra, np.abs(spectra).argmax(axis=-2)[..., None, :], axis=-2)[..., 0, :]
    cancelled = np.abs(total) <= 1e-9 * magnitude
    direction = np.where(cancelled, largest, total)
    size = np.abs(direction)
    unit = np.divide(direction, size, out=np.ones_like(direction), where=size > 0)
    return np.fft.irfft(magnitude * unit, n=axes.shape[-1], axis=-1)
