"""Checks of a channel's values: units, spikes, clipping."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from foten.recording.inspection.hand import MOVING_MM_S
from foten.recording.inspection.values import NOTE, PROBLEM, Finding, counted, places, runs
from foten.recording.preprocess import times_of
from foten.recording.recording import UNITS, Channel, Recording

Array = NDArray[np.float64]


def check_units(name: str, channel: Channel, recording: Recording) -> Iterable[Finding]:
    """Yield a finding where a channel is constant, or its size is that of another unit."""
    x, unit = channel.samples, UNITS[name]
    if x.min() == x.max():
        severity = PROBLEM if name.startswith("acceleration") else NOTE
        text = f"{name} is {x[0]:g} {unit} throughout; is the right column mapped?"
        yield Finding(severity, "constant", name, text)
        return
    peak = float(np.quantile(np.abs(x), 0.999))
    guess = ""
    if name == "speed":
        if peak < 5:
            guess = f"speed peaks at {peak:.3g}, expected mm/s up to about 350; was it given in m/s?"
        elif peak > 1500:
            guess = f"speed peaks at {peak:.4g}, expected mm/s up to about 350; is it a raw reading?"
    elif name.startswith("position"):
        # A stroke along one axis leaves the others constant: only the one that moves most shows the unit.
        swing = _swing(channel)
        if swing < max(_swing(axis) for axis in recording.axes("position")):
            return
        if swing < 1:
            guess = f"{name} moves by {swing:.3g}, expected mm, tens to hundreds; was it given in m?"
        elif swing > 2000:
            guess = f"{name} moves by {swing:.4g}, expected mm, tens to hundreds; was it given in um?"
    elif name.startswith("force"):
        if peak > 30:
            guess = f"{name} peaks at {peak:.4g}, expected N up to about 10; was it given in mN or gf?"
        elif peak < 0.03 and name in ("force", "force_z"):
            guess = f"{name} peaks at {peak:.3g}, expected N up to about 10; was it given in kN or V?"
    else:
        mean, spread = abs(float(x.mean())), float(x.std())
        if 0.9 < mean < 1.1 and spread < mean:
            guess = f"{name} has a mean of {x.mean():.3g}, which is gravity in g; was it given in g?"
        elif peak < 0.02:
            guess = f"{name} peaks at {peak:.3g} m/s², which hardly any hand feels; was it given in g or V?"
        elif peak > 500:
            guess = f"{name} peaks at {peak:.4g} m/s², expected up to about 100; was it given in mm/s² or mg?"
    if guess:
        yield Finding(PROBLEM, "units", name, guess)


def _swing(channel: Channel) -> float:
    return float(np.subtract(*np.quantile(channel.samples, [0.999, 0.001])))


def check_spikes(name: str, channel: Channel) -> Iterable[Finding]:
    """Yield a problem where one or two samples stand alone, far from their neighbours.

    A median filter of five keeps steps and slopes. It removes single outliers and, in a fast signal, the peaks of the
    vibration, so an outlier is what exceeds a high percentile of the removed part by far.
    """
    from scipy.ndimage import median_filter

    x, fast = channel.samples, name.startswith("acceleration")
    if x.size < 10:
        return
    removed = np.abs(x - median_filter(x, 5, mode="nearest"))
    swing = float(np.subtract(*np.quantile(x, [0.99, 0.01])))
    # Ten times: on four real textures at 10 kHz the largest peak was 4.3 times the 99th percentile.
    usual = float(np.quantile(removed, 0.99 if fast else 0.95))
    spikes = np.flatnonzero(removed > max(10 * usual, (0.3 if fast else 0.1) * swing, 1e-9))
    if spikes.size:
        largest = int(spikes[np.argmax(removed[spikes])])
        text = (
            f"{name}: {counted(spikes.size, 'spike')} of one or two samples, the largest {x[largest]:.6g} {UNITS[name]} at "
            f"sample {largest} ({times_of(channel)[largest]:.3f} s)"
        )
        yield Finding(PROBLEM, "spikes", name, text, places(channel, spikes))


def check_clipping(name: str, channel: Channel) -> Iterable[Finding]:
    """Yield a problem where a channel stays at its highest or lowest value for several samples."""
    x = channel.samples
    starts, ends = runs(np.concatenate([[False], np.diff(x) == 0]))
    starts = starts - 1  # the first of the equal samples
    lengths = ends - starts
    if not lengths.size or x.min() == x.max():
        return
    values = x[starts]
    quantum = float(np.median(np.diff(np.unique(x))))
    # A coarse or slow sensor repeats every value; clipping makes its extremes much flatter than that.
    others = lengths[(values != x.max()) & (values != x.min())]
    usual = float(np.quantile(others, 0.99)) if others.size > 20 else 1.0
    for extreme, what in ((float(x.max()), "highest"), (float(x.min()), "lowest")):
        if extreme == 0 or (name == "speed" and extreme < MOVING_MM_S):
            continue  # a natural bound
        cut = np.array(
            [
                i
                for i in np.flatnonzero((values == extreme) & (lengths >= 3))
                if _leaves_steeply(x, starts[i], ends[i], quantum)
            ],
            dtype=np.int64,
        )
        flat = lengths[cut]
        if flat.size and flat.max() >= 3 * usual and (flat.size > 1 or flat.max() >= 5):
            text = (
                f"{name} is clipped: it stays at its {what} value, {extreme:.5g} {UNITS[name]}, for "
                f"{counted(int(flat.sum()), 'sample')} in {counted(flat.size, 'place')}: the sensor or its amplifier was at "
                "its limit"
            )
            yield Finding(PROBLEM, "clipping", name, text, places(channel, starts[cut]))


def _leaves_steeply(x: Array, start: int, end: int, quantum: float) -> bool:
    """Return whether a signal leaves a flat top x[start:end] more steeply than a smooth rounded one can.

    A smooth top is a parabola. Rounded to steps of q it is flat over n samples where it drops by less than q, over a half-width
    of at least (n−1)/2. Another n samples out it has dropped by at most q·((n−1)/2 + n)²/((n−1)/2)², and by one q more from
    rounding. A clipped top drops at the slope at which it was cut.
    """
    n = end - start
    most = quantum * (((3 * n - 1) / (n - 1)) ** 2 + 1)
    sides = [side for side in (x[max(0, start - n) : start], x[end : end + n]) if side.size]
    return all(float(np.abs(side - x[start]).max()) > most for side in sides)
