"""Changing the rate of a signal: anti-aliased decimation offline, interpolation for listening."""

from fractions import Fraction

import numpy as np

from foten.dsp import Array

HALF_WIDTH = 24  # samples on each side of one that is interpolated


def rate_ratio(target_hz: float, source_hz: float, tolerance: float = 1e-9) -> Fraction:
    """Target over source rate as a fraction of integers up to 1000; ValueError beyond the relative tolerance."""
    ratio = Fraction(target_hz / source_hz).limit_denominator(1000)
    if ratio.numerator == 0 or abs(float(ratio) * source_hz - target_hz) > tolerance * target_hz:
        nearest = source_hz / max(1, round(source_hz / target_hz))
        rates = f"{source_hz:.9g} Hz to {target_hz:g} Hz"
        raise ValueError(f"cannot go from {rates}: not a ratio of small integers; ask for {nearest:.9g} Hz")
    return ratio


def decimate(samples: Array, source_hz: float, target_hz: float) -> Array:
    """Signal at a lower rate, aligned with the input (linear phase, no delay), shape (n,); ValueError at a higher one.

    The low-pass is flat to 0.45 of the new rate and 80 dB down at 0.55, so only frequencies above 0.45 of the rate hold
    aliases. It leaves no empty band below half the rate, which would make the signal predictable by the filter.
    """
    from scipy import signal

    if target_hz > source_hz * (1 + 1e-12):
        raise ValueError(f"asked for {target_hz:g} Hz from {source_hz:g} Hz: a recording is never upsampled")
    up, down = rate_ratio(target_hz, source_hz).as_integer_ratio()
    if up == down:
        return samples.copy()
    intermediate_hz = source_hz * up
    n_taps, beta = signal.kaiserord(80.0, 0.1 * target_hz / (intermediate_hz / 2))
    taps = signal.firwin(n_taps | 1, target_hz / 2, window=("kaiser", beta), fs=intermediate_hz)
    # Padding by the edge values keeps a constant constant up to both ends.
    return np.asarray(signal.resample_poly(samples, up, down, window=taps, padtype="line"))


def interpolate(samples: Array, factor: Fraction) -> Array:
    """Signal (n,) at `factor` times its rate, 1 or more, by a windowed sinc, shape (ceil(n × factor),).

    Polyphase: one of `factor.numerator` kernels, each normalised to sum 1, so that a constant is kept exactly.
    """
    if factor < 1:
        raise ValueError(f"interpolation by {float(factor):g}, expected 1 or more")
    up, down = factor.as_integer_ratio()
    n_out = -(-samples.size * up // down)
    base, phase = np.divmod(np.arange(n_out) * down, up)
    taps = np.arange(-HALF_WIDTH + 1, HALF_WIDTH + 1)
    away = taps - np.arange(up)[:, None] / up
    kernels = np.sinc(away) * np.i0(9.0 * np.sqrt(np.maximum(0.0, 1 - (away / HALF_WIDTH) ** 2)))
    kernels /= kernels.sum(axis=1, keepdims=True)
    padded = np.pad(samples, HALF_WIDTH)
    out = np.empty(n_out)
    for start in range(0, n_out, 65536):
        piece = slice(start, start + 65536)
        gathered = padded[base[piece, None] + HALF_WIDTH + taps]
        out[piece] = np.einsum("ij,ij->i", gathered, kernels[phase[piece]])
    return out
