"""The fixed matrices of Eq. 6 and 9 and the positions of Eq. 2."""

import numpy as np

from foten.dsp import Array

WEAKEST_BIN = 1e-10  # of a window's energy; float32 rounding leaves about 1e-13 in a bin that should be empty


def dft_matrices(m: int) -> tuple[Array, Array]:
    """Real and imaginary part of Eq. 6 as matrices: Z = a @ real + i · a @ imaginary, each (m, m).

    Entries that are zero in exact arithmetic are exactly zero, so that the phase of a real bin is 0 or π and not ±π by rounding.
    """
    # Reducing k·n mod m before the division keeps the angles exact.
    turns = np.outer(np.arange(m), np.arange(m)) % m
    real, imaginary = np.cos(2 * np.pi * turns / m), -np.sin(2 * np.pi * turns / m)
    imaginary[(2 * turns) % m == 0] = 0.0
    real[((4 * turns) % m == 0) & ((2 * turns) % m != 0)] = 0.0
    return real, imaginary


def last_sample_row(m: int, half: bool = False) -> tuple[Array, Array]:
    """Rows (c, s) with Re a_spec[m−1] = Σ_k M̂_k·(c_k·cos φ̂_k + s_k·sin φ̂_k), shapes (m,) or (m // 2 + 1,).

    Only this row of Eq. 9 reaches the output: the head reads the last token alone. With
    e^{i2πk(m−1)/m} = e^{−i2πk/m}, c_k = cos(2πk/m)/m and s_k = sin(2πk/m)/m. With half of the bins, those
    between 0 and m/2 stand for their mirror images too.
    """
    k = np.arange(m // 2 + 1 if half else m)
    weight = np.where(half & (k > 0) & (2 * k < m), 2 / m, 1 / m)
    return weight * np.cos(2 * np.pi * k / m), weight * np.sin(2 * np.pi * k / m)


def position_encoding(m: int, d_model: int) -> Array:
    """Sinusoidal positions, shape (m, d_model). Source: Eq. 2."""
    angle = np.arange(m)[:, None] / 10000 ** (np.arange(0, d_model, 2) / d_model)
    encoding = np.zeros((m, d_model))
    encoding[:, 0::2], encoding[:, 1::2] = np.sin(angle), np.cos(angle)[:, : d_model // 2]
    return encoding
