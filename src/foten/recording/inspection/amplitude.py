"""Checks of a channel's values: units, spikes, clipping."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from foten.recording.inspection.hand import MOVING_MM_S
from foten.recording.inspection.values import NOTE, PROBLEM, Finding, counted, places, runs, swing
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
            guess = f"peaks at {peak:.3g}, expected mm/s up to about 350; was it given in m/s?"
        elif peak > 1500:
            guess = f"peaks at {peak:.4g}, expected mm/s up to about 350; is it a raw reading?"
    elif name.startswith("position"):
        # A stroke along one axis leaves the others constant: only the one that moves most shows the unit.
        moved = _moved(channel)
        if moved < max(_moved(axis) for axis in recording.axes("position")):
            return
        if moved < 1:
            guess = f"moves by {moved:.3g}, expected mm, tens to hundreds; was it given in m?"
        elif moved > 2000:
            guess = f"moves by {moved:.4g}, expected mm, tens to hundreds; was it given in um?"
    elif name.startswith("force"):
        if peak > 30:
            guess = f"peaks at {peak:.4g}, expected N up to about 10; was it given in mN or gf?"
        elif peak < 0.03 and name in ("force", "force_z"):
            guess = f"peaks at {peak:.3g}, expected N up to about 10; was it given in kN or V?"
    elif 0.9 < abs(x.mean()) < 1.1 and x.std() < abs(x.mean()):
        guess = f"has a mean of {x.mean():.3g}, which is gravity in g; was it given in g?"
    elif peak < 0.02:
        guess = f"peaks at {peak:.3g} m/s², which hardly any hand feels; was it given in g or V?"
    elif peak > 500:
        guess = f"peaks at {peak:.4g} m/s², expected up to about 100; was it given in mm/s² or mg?"
    if guess:
        yield Finding(PROBLEM, "units", name, f"{name} {guess}")


def _moved(channel: Channel) -> float:
    return swing(channel.samples, 0.001)


def check_spikes(name: str, channel: Channel) -> Iterable[Finding]:
    """Yield a problem where one or two samples stand alone, far from their neighbours.

    A median filter of five keeps steps and slopes. It removes single outliers and, in a fast signal, the peaks of the
    vibration, so an outlier is what exceeds a high percentile of the removed part by far.
    """
    from scipy.ndimage import median_filter

    x = channel.samples
    if x.size < 10:
        return
    removed = np.abs(x - median_filter(x, 5, mode="nearest"))
    usual, share = (0.99, 0.3) if name.startswith("acceleration") else (0.95, 0.1)
    # Ten times: on four real textures at 10 kHz the largest peak was 4.3 times the 99th percentile.
    least = max(10 * float(np.quantile(removed, usual)), share * swing(x, 0.01), 1e-9)
    spikes = np.flatnonzero(removed > least)
    if spikes.size:
        largest = int(spikes[np.argmax(removed[spikes])])
        text = (
            f"{name}: {counted(spikes.size, 'spike')} of one or two samples, the largest {x[largest]:.6g} {UNITS[name]} at "
            f"sample {largest} ({channel.times[largest]:.3f} s)"
        )
        yield Finding(PROBLEM, "spikes", name, text, places(channel, spikes))


def check_clipping(name: str, channel: Channel) -> Iterable[Finding]:
    """Yield a problem where a channel stays at its highest or lowest value for several samples."""
    x = channel.samples
    starts, ends = runs(np.append(False, np.diff(x) == 0))
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
        at = np.flatnonzero((values == extreme) & (lengths >= 3))
        cut = at[np.array([_leaves_steeply(x, starts[i], ends[i], quantum) for i in at], dtype=bool)]
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
