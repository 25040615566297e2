"""Movement: slow signals at a higher rate, and speed from positions, the same way for recordings and strokes."""

import numpy as np

from foten.dsp import Array


def at_rate(values: Array, times_s: Array, rate_hz: float, n: int) -> Array:
    """Signal at `n` samples of a rate from time 0: values and rising times (k,) → (n,), linearly interpolated, ends held.

    Where the signal is denser than the rate, each sample is the mean over one period around it, which averages noise.
    """
    grid = np.arange(n) / rate_hz
    if times_s.size < 2 or np.median(np.diff(times_s)) >= 0.75 / rate_hz:
        return np.interp(grid, times_s, values)
    # The mean of the piecewise linear signal over [a, b] is the difference of its integral, over b − a.
    integral = np.concatenate([[0.0], np.cumsum(np.diff(times_s) * (values[1:] + values[:-1]) / 2)])
    edges = np.clip(np.append(grid, n / rate_hz) - 0.5 / rate_hz, times_s[0], times_s[-1])
    added, width = np.diff(np.interp(edges, times_s, integral)), np.diff(edges)
    return np.divide(added, width, out=np.interp(grid, times_s, values), where=width > 0)


def velocity(positions: Array, rate_hz: float) -> Array:
    """Velocity of each axis [mm/s] by central differences of positions [mm] at a rate: (n_axes, n) → (n_axes, n)."""
    if positions.shape[1] < 2:
        return np.zeros(positions.shape)
    return np.asarray(np.gradient(positions, 1 / rate_hz, axis=1))


def speed_of(velocity: Array) -> Array:
    """Speed [mm/s] (n,) of velocities (n_axes, n), low-passed since noise adds to a norm; a single row is a speed already."""
    if velocity.shape[0] == 1:
        return np.maximum(velocity[0], 0.0)  # a second-order low-pass undershoots by 4 %
    return np.sqrt(np.square(velocity).sum(axis=0))
