"""Checks of the values of one channel: units, spikes, clipping, noise, whiteness, repeated patterns, narrow lines."""

from collections.abc import Iterable

import numpy as np

from foten.dsp import Array
from foten.dsp.distance import welch
from foten.recording.inspection.speed_force import CONTACT_N, HAND_HZ, MOVING_MM_S, SpeedForce
from foten.recording.inspection.values import NOTE, PROBLEM, UNUSABLE, ChannelReport, Finding, places, swing
from foten.recording.recording import UNITS, Channel, Recording, counted

MIN_FLAT, MIN_FLAT_ALONE = 3, 5  # equal samples at an extreme that are clipped: in several places, and in a single one
FEW = 1e-3  # of the samples, that may be clipped or a spike
SMOOTHED = 0.02  # of the range of a force or speed, that a spike may leave behind the low-pass of training
FRAME_S = 0.05  # in which the level of an acceleration is measured
_GUESSES = {
    "speed": (
        (5, "peaks at {:.3g}, expected mm/s up to about 350; was it given in m/s?"),
        (1500, "peaks at {:.4g}, expected mm/s up to about 350; is it a raw reading?"),
    ),
    "position": (
        (1, "moves by {:.3g}, expected mm, tens to hundreds; was it given in m?"),
        (2000, "moves by {:.4g}, expected mm, tens to hundreds; was it given in um?"),
    ),
    "force": (
        (0.03, "peaks at {:.3g}, expected N up to about 10; was it given in kN or V?"),
        (30, "peaks at {:.4g}, expected N up to about 10; was it given in mN or gf?"),
    ),
    "acceleration": (
        (0.02, "peaks at {:.3g} m/s², which hardly any hand feels; was it given in g or V?"),
        (500, "peaks at {:.4g} m/s², expected up to about 100; was it given in mm/s² or mg?"),
    ),
}
"""Smallest and largest usual size of a quantity in its unit, and the doubt beyond."""


def unit_doubt(kind: str, size: float) -> str:
    """Doubt about the unit of a quantity of this size: "peaks at 0.1, … was it given in m/s?"; or nothing."""
    (low, too_small), (high, too_large) = _GUESSES[kind]
    return too_small.format(size) if size < low else too_large.format(size) if size > high else ""


def check_units(name: str, channel: Channel, recording: Recording) -> Iterable[Finding]:
    """Yield a finding where a channel is constant, or its size is that of another unit."""
    x, unit = channel.samples, UNITS[name]
    if x.min() == x.max():
        severity = PROBLEM if name.startswith("acceleration") else NOTE
        text = f"{name} is {x[0]:g} {unit} throughout; is the right column mapped?"
        yield Finding(severity, "constant", name, text)
        return
    if x.size > 2 and name.startswith("acceleration") and (np.diff(x) > 0).all():
        yield Finding(UNUSABLE, "rises", name, f"{name} rises from begin to end: is it the time? Or the wrong column?")
        return
    kind, guess = name.split("_")[0], ""
    size = swing(x, 0.001) if kind == "position" else float(np.quantile(np.abs(x), 0.999))
    # A stroke along one axis leaves the others constant: only the one that moves most shows the unit.
    if kind == "position" and size < max(swing(axis.samples, 0.001) for axis in recording.axes("position")):
        return
    if kind == "acceleration" and 0.9 < abs(x.mean()) < 1.1 and x.std() < abs(x.mean()):
        guess = f"has a mean of {x.mean():.3g}, which is gravity in g; was it given in g?"
    elif name not in ("force_x", "force_y") or size > 1:  # across the normal there may be none
        guess = unit_doubt(kind, size)
    if guess:
        yield Finding(PROBLEM, "units", name, f"{name} {guess}")


def check_spikes(name: str, channel: Channel) -> Iterable[Finding]:
    """Yield a problem, or a note of what training smooths away, where one or two samples stand alone, far from their neighbours.

    A median filter of five removes single outliers and, in a fast signal, the peaks of the vibration, so an outlier is what
    exceeds a high percentile of the removed part by far.
    """
    from scipy.ndimage import median_filter

    x = channel.samples
    if x.size < 10:
        return
    removed = np.abs(x - median_filter(x, 5, mode="nearest"))
    usual, share = (0.99, 0.3) if name.startswith("acceleration") else (0.95, 0.1)
    # The largest peak of four real textures at 10 kHz is 4.3 times the 99th percentile.
    threshold = max(10 * float(np.quantile(removed, usual)), share * swing(x, 0.01), 1e-9)
    spikes = np.flatnonzero(removed > threshold)
    if spikes.size:
        largest = int(spikes[np.argmax(removed[spikes])])
        where = f"{x[largest]:.6g} {UNITS[name]} at sample {largest} ({channel.times[largest]:.3f} s)"
        text = f"{name}: {counted(spikes.size, 'spike')} of one or two samples, the largest {where}"
        # What a second-order low-pass leaves of a pulse of two samples: twice the largest value of its impulse response.
        few = spikes.size <= FEW * x.size
        left = float(removed.max()) * min(1.0, 0.92 * 2 * np.pi * HAND_HZ / channel.rate_hz)
        if name.startswith("acceleration"):
            severity, advice = (
                PROBLEM,
                "if they are no impacts, cut the table there and import the pieces with --append",
            )
        elif name.startswith(("force", "speed")) and few and left <= SMOOTHED * swing(x, 0.01):
            severity, advice = NOTE, f"nothing to do: the low-pass of training leaves {left:.2g} {UNITS[name]} of it"
        else:
            gap_ms = int(np.ceil(3000 / channel.rate_hz))
            severity, advice = PROBLEM, f"blank their cells in the table and import it with --fill-gaps {gap_ms}"
        yield Finding(severity, "spikes", name, f"{text}; {advice}", places(channel, spikes))


def check_clipping(name: str, channel: Channel) -> Iterable[Finding]:
    """Yield a problem, or a note of few samples, where a channel stays at its highest or lowest value."""
    x = channel.samples
    if x.min() == x.max():
        return
    changes = np.flatnonzero(np.diff(x)) + 1
    starts, ends = np.append(0, changes), np.append(changes, x.size)
    values, lengths = x[starts], ends - starts
    quantum = float(np.median(np.diff(np.unique(x))))
    # A coarse or slow sensor repeats every value, and a hand pauses; clipping makes extremes much flatter than that.
    others = lengths[(values != x.max()) & (values != x.min()) & ((lengths > 1) | name.startswith("acceleration"))]
    usual = float(np.quantile(others, 0.99)) if others.size > 20 else 1.0
    for extreme, what in ((x.max(), "highest"), (x.min(), "lowest")):
        if extreme == 0 or (name == "speed" and extreme < MOVING_MM_S):
            continue  # a natural bound
        at = np.flatnonzero((values == extreme) & (lengths >= MIN_FLAT))
        cut = [i for i in at if _leaves_steeply(x, starts[i], ends[i], quantum)]
        flat = lengths[cut]
        if flat.size and flat.max() >= MIN_FLAT * usual and (flat.size > 1 or flat.max() >= MIN_FLAT_ALONE):
            stays = f"stays at its {what} value, {extreme:.5g} {UNITS[name]}, for {counted(flat.sum(), 'sample')}"
            few = flat.sum() <= FEW * x.size
            advice = "so few change little: nothing to do" if few else "record again with a larger range"
            text = f"{name} is clipped: it {stays} in {counted(flat.size, 'place')}; {advice}"
            yield Finding(NOTE if few else PROBLEM, "clipping", name, text, places(channel, starts[cut]))


def _leaves_steeply(x: Array, start: int, end: int, quantum: float) -> bool:
    """Whether a signal leaves a flat top x[start:end] more steeply than a smooth rounded one can.

    A parabola, rounded to steps of q, is flat over n samples where it drops by less than q over (n−1)/2. Another n samples out
    it has dropped by at most q·((n−1)/2 + n)²/((n−1)/2)², and by one q more from rounding.
    """
    n = end - start
    flattest = quantum * (((3 * n - 1) / (n - 1)) ** 2 + 1)
    sides = [side for side in (x[max(0, start - n) : start], x[end : end + n]) if side.size]
    return all(float(np.abs(side - x[start]).max()) > flattest for side in sides)


def slow_noise(samples: Array) -> float:
    """RMS of white noise on a slow signal, from its third differences, of variance (1+9+9+1)·s² for noise of variance s²."""
    if samples.size < 4:
        return 0.0
    return float(1.4826 * np.median(np.abs(np.diff(samples, 3))) / np.sqrt(20))


def noise_floor(name: str, channel: Channel, speed_force: SpeedForce | None) -> tuple[float, str]:
    """RMS of a channel's noise, and how it was estimated: `rest`, `quietest 5 %` or `differences`."""
    x = channel.samples
    if not name.startswith("acceleration"):
        return slow_noise(x), "differences"
    frame = max(2, round(FRAME_S * channel.rate_hz))
    frames = x[: x.size - x.size % frame].reshape(-1, frame) if x.size >= frame else x[None, :]
    levels = frames.std(axis=1)  # about each frame's mean: gravity is no noise
    if speed_force is not None:
        starts = channel.times[:: frames.shape[1]][: levels.size]
        still = ((speed_force.speed < MOVING_MM_S) | (speed_force.force < CONTACT_N)).astype(np.float64)
        at_both = np.interp([starts, starts + FRAME_S / 2], speed_force.times_s, still, left=0, right=0) == 1
        quiet = at_both.all(axis=0)
        if quiet.sum() >= 4:
            return float(np.median(levels[quiet])), "rest"
    return float(np.quantile(levels, 0.05)), "quietest 5 %"


def check_noise(reports: Iterable[ChannelReport]) -> Iterable[Finding]:
    """Yield a problem for an acceleration hardly above its noise, and a note where the noise has only a bound."""
    for report in (report for report in reports if report.name.startswith("acceleration")):
        vibration = float(np.sqrt(max(report.rms**2 - report.mean**2, 0.0)))
        if report.noise_floor_from != "rest":
            text = f"{report.name}: no rest was found; the noise floor is below {report.noise_floor:.3g} m/s²"
            yield Finding(NOTE, "noise", report.name, text)
        elif vibration < 2 * report.noise_floor:
            levels = f"its level, {vibration:.3g} m/s², is hardly above the {report.noise_floor:.3g} m/s² at rest"
            text = f"{report.name}: {levels}: most of it is sensor noise"
            yield Finding(PROBLEM, "noise", report.name, text)


def density(channel: Channel) -> tuple[Array, Array]:
    """Frequencies [Hz] without 0 and the power spectral density there, shape (k,) each; bins of about 4 Hz."""
    wanted = 2 ** round(np.log2(channel.rate_hz / 4))
    n = int(max(16, min(wanted, channel.samples.size // 4)))
    frequency, power = welch(channel.samples, channel.rate_hz, n)
    return frequency[1:], power[1:]


def check_whiteness(name: str, channel: Channel) -> Iterable[Finding]:
    """Yield findings on a vibration without autocorrelation, or with a pattern that repeats exactly."""
    x = channel.samples[:200_000]
    x = x - x.mean()
    power = float(np.mean(x**2))
    if x.size < 1000 or power == 0:
        return
    # Noise alone explains 1/n of the power by means of n periods.
    periods = range(2, min(250, x.size // 40))
    explained = {p: float(np.mean(_pattern(x, p) ** 2)) / power - 1 / (x.size // p) for p in periods}
    largest = max(explained.values())
    without, patterned = x, largest > 0.05
    if patterned:
        period = next(p for p, part in explained.items() if part >= 0.9 * largest)
        n = x.size // period
        without = x[: n * period] - np.tile(_pattern(x, period), n)
    lagged = [abs(np.mean(without[:-k] * without[k:])) / np.mean(without**2) for k in range(1, 6)]
    white = max(lagged) < 0.12
    if patterned:
        hz = channel.rate_hz / period
        mains = not white and min(abs(hz / m - round(hz / m)) for m in (50, 60)) < 1e-6
        guess = "mains hum?" if mains else "a processed or generated signal?"
        repeats = f"one pattern repeats exactly every {period} samples ({hz:.4g} Hz)"
        text = f"{name}: {repeats} and holds {largest:.0%} of the power: {guess}"
        yield Finding(PROBLEM if white else NOTE, "pattern", name, text)
    if white:
        where = f"at lags 1 to 5 at most {max(lagged):.2f}{', the pattern aside' if patterned else ''}"
        text = f"{name} has next to no autocorrelation ({where}): was it shuffled or generated, or is it noise alone?"
        yield Finding(PROBLEM, "white", name, text)


def _pattern(x: Array, period: int) -> Array:
    """Mean of all whole periods of a signal, shape (period,)."""
    n = x.size // period
    return np.asarray(x[: n * period].reshape(n, period).mean(axis=0))


def check_lines(name: str, frequency: Array, power: Array) -> Iterable[Finding]:
    """Yield a note on narrow lines, of an instrument or mains: 15 dB above the median of the bins around."""
    from scipy.ndimage import median_filter

    if power.size < 64:
        return
    ratio = power / np.maximum(median_filter(power, 31, mode="nearest"), 1e-30)
    peaks = np.flatnonzero((ratio[1:-1] > 30) & (ratio[1:-1] >= ratio[:-2]) & (ratio[1:-1] > ratio[2:])) + 1
    peaks = peaks[frequency[peaks] > HAND_HZ]
    if peaks.size:
        strongest = np.sort(peaks[np.argsort(ratio[peaks])[::-1][:6]])
        at = f"{', '.join(f'{frequency[i]:.4g}' for i in strongest)} Hz{' …' * (peaks.size > strongest.size)}"
        above = f"up to {10 * np.log10(ratio[peaks].max()):.0f} dB above their surroundings"
        text = f"{name}: narrow lines at {at}, {above}: instruments or mains?"
        yield Finding(NOTE, "lines", name, text)
