"""Tones of a periodic surface: its wavelength, the tool's phase on it, and the amplitude of each multiple."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.signal import lfilter
from scipy.special import gammainccinv

from foten.dsp import Array
from foten.dsp.lattice import polynomial
from foten.dsp.speed_force_table import SpeedForceTable, spanning
from foten.dsp.tones import tone, tone_slope
from foten.models.excitation import Scale
from foten.models.foten_plus.config import FotenPlusConfig
from foten.models.foten_plus.definition import lattice_tensors, table_tensors
from foten.models.foten_plus.linear_model import (
    FittedReflections,
    LatticeData,
    LinearModel,
    counts_of,
    fit_level,
    fit_reflections,
    selected_lattices,
)
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.runtime.proof import Tensors
from foten.training.job import ScaledBlocks

MIN_WAVELENGTH_MM = 0.2
PHASE_LEAK_S = 0.5  # in which a rendering forgets the phase that it started with
MIN_PERIODS = 3.0  # of a wavelength in a stretch: fewer lie within the main lobe of the stretch's window
MIN_PEAK_RATIO = 3.0  # of a spectral peak to its surroundings; irregular cloth has 4, surfaces without a wavelength 1.3
MIN_CHANCE_RATIO = 2.0  # of a spectral peak to the largest that noise would reach
MIN_PATH_RATIO = 1.2  # of a peak over the path to one over time: a hum at a steady speed repeats over both
MAX_TONES = 6
N_SPEED, N_FORCE = 32, 2  # knots: the tool turns a tone's phase by π within 30 mm/s
N_ROUNDS = 8
SMOOTHNESS_PENALTY = 0.005  # of squared differences between neighbouring knots, as a share of a knot's information
SMOOTHING_WAVELENGTHS = 0.6  # over which a phase deviates evenly
PATH_PRECISION = 3.0  # of the prior that the phase follows the path [1/rad²]
WHITENING_ORDER = 20  # order
USABLE_BAND = 0.45  # of the rate, that tones keep to


def wavelength(data: LatticeData, rate_hz: float) -> float | None:
    """The length that a surface repeats itself after [mm], or None where none stands out.

    The power spectra of stretches of path are averaged over spatial frequencies and compared with their running median. A tone
    that stands out as much over time is a hum or a resonance, and is not treated as spatial.
    """
    path = np.cumsum(data.speed, axis=1) / rate_hz
    for span in (15.0, 5.0):
        stretches = [
            (path[b, n] - path[b, n.start], data.x[b, n]) for b in data.train for n in _stretches(path[b], span)
        ]
        if len(stretches) >= 20:
            break
    else:
        return None
    if len(stretches) > 200:
        stretches = [stretches[i] for i in np.linspace(0, len(stretches) - 1, 200).astype(int)]
    step = 0.25 / span
    cycles = np.arange(MIN_PERIODS / span, 1 / MIN_WAVELENGTH_MM, step)
    coarse = cycles[::16, None]  # e^(−2πi(c + d)w) is a product: exponentials of 16 + n/16 frequencies in place of n
    fine = step * np.arange(16)[:, None]
    usual_step = float(np.mean([travelled[-1] / (len(travelled) - 1) for travelled, _ in stretches]))
    powers = np.zeros((2, len(cycles)))
    for travelled, x in stretches:
        windowed = x * np.sin(np.pi * travelled / span) ** 2
        total = float(np.square(windowed).sum())
        if total > 0:
            for power, way in zip(powers, (travelled, usual_step * np.arange(len(x))), strict=True):
                sums = (np.exp(-2j * np.pi * coarse * way) * windowed) @ np.exp(-2j * np.pi * fine * way).T
                power += np.abs(sums.ravel()[: len(cycles)]) ** 2 / total
    ratio, over_time = (
        power / np.array([np.median(power[max(0, i - 20) : i + 21]) for i in range(len(cycles))]) for power in powers
    )
    # Peaks alone: at either end all surroundings lie on one side, and a slope stands out.
    rises = np.diff(powers[0]) > 0
    ratio[~np.array([False, *(rises[:-1] & ~rises[1:]), False])] = 0.0
    peak = int(np.argmax(ratio))
    # The largest of so many bins of noise, over their mean, exceeds this once in twenty recordings: a mean over half-overlapping
    # windowed stretches has about 1.2 degrees of freedom for each.
    half_freedom = 0.6 * len(stretches)
    largest_by_chance = float(gammainccinv(half_freedom, 0.05 / len(cycles)) / half_freedom)
    enough = max(MIN_PEAK_RATIO, MIN_CHANCE_RATIO * largest_by_chance)
    like_it = np.abs(cycles - cycles[peak]) <= 0.1 * cycles[peak]
    if ratio[peak] < max(enough, MIN_PATH_RATIO * over_time[like_it].max()):
        return None
    # The tool may make a multiple louder than the fundamental.
    half = int(np.argmin(np.abs(cycles - cycles[peak] / 2)))
    near = slice(max(0, half - 2), half + 3)
    if cycles[peak] / 2 >= cycles[0] and ratio[near].max() >= enough:
        peak = near.start + int(np.argmax(ratio[near]))
    return float(1 / cycles[peak])


def _stretches(path: Array, span: float) -> Iterator[slice]:
    """The samples of half-overlapping stretches of a path [mm], without those of 30 samples or fewer."""
    first = 0
    while (last := int(np.searchsorted(path, path[first] + span))) < len(path):
        if last - first > 30:
            yield slice(first, last)
        first = int(np.searchsorted(path, path[first] + span / 2))


def n_multiples(wavelength_mm: float, speed: Array, rate_hz: float) -> int:
    """Multiples that the rate holds at the median speed [mm/s], at least one."""
    fundamental_hz = float(np.median(speed)) / wavelength_mm
    return int(np.clip(USABLE_BAND * rate_hz / max(fundamental_hz, 1e-9), 1, MAX_TONES))


@dataclass(frozen=True)
class KnotWeights:
    """Weights of a table's k knots at n samples, (k, n), and products of knots i ≤ j in row i·k + j, (k², n); sparse."""

    by_knot: sparse.csc_array
    by_pair: sparse.csc_array


def knot_weights(table: SpeedForceTable, speed: Array, force: Array) -> KnotWeights:
    """The weights of a table's knots at the samples of blocks, speed and force (n_blocks, block) each."""
    by_block = [sparse.csr_array(table.weights(*block)) for block in zip(speed, force, strict=True)]
    by_pair = [_pairs(block) for block in by_block]
    return KnotWeights(sparse.vstack(by_block, format="csr").T, sparse.vstack(by_pair, format="csr").T)


def _pairs(weights: sparse.csr_array) -> sparse.csr_array:
    """The products of each row's weights, (n, k) → (n, k²): of knots i ≤ j, in column i·k + j."""
    n, k = weights.shape
    counts = np.diff(weights.indptr)
    rows = np.repeat(np.arange(n), counts)
    place = np.arange(weights.nnz) - weights.indptr[rows]
    knot, weight = np.zeros((2, n, int(counts.max())))
    knot[rows, place], weight[rows, place] = weights.indices, weights.data
    first, second = np.triu_indices(knot.shape[1])
    columns = knot[:, first] * k + knot[:, second]
    products = weight[:, first] * weight[:, second]
    nonzero = products != 0
    at = np.repeat(np.arange(n), nonzero.sum(axis=1))
    return sparse.csr_array((products[nonzero], (at, columns[nonzero].astype(np.int64))), shape=(n, k * k))


@dataclass(frozen=True)
class FittedTones:
    """Tones fitted to a recording."""

    wavelength_mm: float  # as the phase says, finer than a spectrum does
    table: SpeedForceTable  # coefficients over speed and force, in units of the vibration's level
    phase: Array  # of the fundamental at every sample [rad], shape (n_blocks, block)
    waveform: Array  # T at every sample, in units of the level, same shape
    period_jitter: float  # standard deviation of a period's length, as a share of it


def fit_tones(data: LatticeData, wavelength_mm: float, rate_hz: float) -> FittedTones:
    """The tones of a surface that seems to repeat.

    In turn, least squares for the coefficients given the phases, and a Gauss–Newton step for the phases given the coefficients,
    smoothed over about a wavelength. Errors are whitened, so that the tool's resonance does not outweigh the high multiples.
    """
    chosen = list(data.train)
    speed, force = data.speed[chosen], data.force[chosen]
    path = np.cumsum(data.speed, axis=1) / rate_hz
    phase = _demodulated(data.x, path, wavelength_mm)
    table = spanning(speed, force, N_SPEED, N_FORCE)
    table = replace(table, values=np.zeros((len(table.values), 2 * n_multiples(wavelength_mm, speed, rate_hz))))
    fastest = USABLE_BAND * rate_hz * wavelength_mm
    whitener = np.ones(1)
    near = knot_weights(table, speed, force)
    for _ in range(N_ROUNDS):
        table = _fitted(data, table, phase, whitener, fastest, near)
        coefficients = _coefficients(data, table)
        x = data.x - tone(coefficients, phase)
        whitener = polynomial(fit_reflections(replace(data, x=x), WHITENING_ORDER, 1, 1).values[0])
        residual, slope = (lfilter(whitener, [1.0], signal) for signal in (x, tone_slope(coefficients, phase)))
        noise = float(np.square(residual[chosen]).mean())
        score, known = (
            _windowed_sums(path, slope * signal / noise, wavelength_mm, SMOOTHING_WAVELENGTHS)
            for signal in (residual, slope)
        )
        phase = phase + np.clip(score / (known + PATH_PRECISION), -0.4, 0.4)
    periods = (phase[chosen, -1] - phase[chosen, 0]).sum() / (2 * np.pi)
    length = float((path[chosen, -1] - path[chosen, 0]).sum() / periods)
    deviation = phase - 2 * np.pi * path / length
    period_jitter = _period_jitter(path[chosen], deviation[chosen], speed, length)
    table = _fitted(data, table, phase, whitener, fastest, near)
    return FittedTones(length, table, phase, tone(_coefficients(data, table), phase), period_jitter)


def _period_jitter(path: Array, deviation: Array, speed: Array, wavelength_mm: float) -> float:
    """The standard deviation of a period's length, as a share of it, from the growth of the phase's variance on the path.

    From 4 to 12 wavelengths, so that the error of a single phase drops out; over the quarter of places with the least change of
    speed, since the tool's response turns the phase with speed.
    """

    def variance(n_wavelengths: int) -> float:
        away, differences = n_wavelengths * wavelength_mm, []
        for place, *rows in zip(path, deviation, speed, strict=True):
            at = np.arange(place[0], place[-1] - away, wavelength_mm / 2)
            differences.append([np.interp(at + away, place, row) - np.interp(at, place, row) for row in rows])
        change, speed_change = np.abs(np.concatenate(differences, axis=1))
        if not speed_change.size:
            return 0.0
        return float(np.square(change[speed_change <= np.quantile(speed_change, 0.25)]).mean())

    near, far = 4, 12
    return math.sqrt(max(0.0, (variance(far) - variance(near)) / (far - near))) / (2 * math.pi)


def _demodulated(x: Array, path: Array, wavelength_mm: float) -> Array:
    """The phase of the fundamental at every sample: that of the path plus the smoothed residual phase."""
    carrier = 2 * np.pi * path / wavelength_mm
    carried = x * np.exp(-1j * carrier) * np.diff(path, axis=1, prepend=0.0)
    real, imaginary = (_windowed_sums(path, part, wavelength_mm, 1.0) for part in (carried.real, carried.imag))
    return carrier + np.unwrap(np.angle(real + 1j * imaginary), axis=1)


def _windowed_sums(path: Array, values: Array, wavelength_mm: float, width: float) -> Array:
    """Sums under a Gaussian of `width` wavelengths of path around every sample, each block by itself."""
    step = wavelength_mm / 8
    reach = int(4 * width * 8)
    bell = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (width * 8)) ** 2)
    out = np.empty_like(values)
    for block, (place, row) in enumerate(zip(path, values, strict=True)):
        n = int(place[-1] / step) + 2
        binned = np.bincount(np.clip((place / step).astype(int), 0, n - 1), weights=row, minlength=n)
        out[block] = np.interp(place, np.arange(n) * step, np.convolve(binned, bell)[reach : reach + n])
    return out


def _coefficients(data: LatticeData, table: SpeedForceTable) -> Array:
    return table.at(data.speed.ravel(), data.force.ravel()).reshape(*data.x.shape, -1)


def _fitted(
    data: LatticeData, table: SpeedForceTable, phase: Array, whitener: Array, fastest: float, near: KnotWeights
) -> SpeedForceTable:
    """The coefficients of the least whitened error, with a penalty of differences between neighbouring knots.

    Waves are whitened first and weighted then, since weights change little within the whitener's length. Coefficients are zero
    where speed times multiple exceeds `fastest` [mm/s].
    """
    n_knots, n_columns = table.values.shape
    chosen = list(data.train)
    multiples = np.arange(1, n_columns // 2 + 1)
    angle = phase[chosen][:, None] * multiples[:, None]
    waves = np.stack([np.cos(angle), np.sin(angle)], axis=2).reshape(len(chosen), n_columns, -1)
    waves, target = (lfilter(whitener, [1.0], signal) for signal in (waves, data.x[chosen]))
    waves[..., : whitener.size] = 0.0
    waves = waves.transpose(1, 0, 2).reshape(n_columns, -1)
    row, column = np.triu_indices(n_columns)
    products = near.by_pair @ (waves[row] * waves[column]).T
    upper = np.zeros((n_knots, n_knots, n_columns, n_columns))
    upper[:, :, row, column] = upper[:, :, column, row] = products.reshape(n_knots, n_knots, -1)
    blocks = upper + upper.transpose(1, 0, 2, 3)
    blocks[range(n_knots), range(n_knots)] /= 2
    gram = blocks.transpose(0, 2, 1, 3).reshape((n_knots * n_columns,) * 2)
    moment = (near.by_knot @ (waves * target.ravel()).T).ravel()
    information = np.diag(gram).reshape(n_knots, n_columns).mean(axis=0)
    over_speed, over_force = (np.eye(len(knots)) for knots in (table.speed_knots, table.force_knots))
    steps = np.concatenate(
        [np.kron(np.diff(over_speed, axis=0), over_force), np.kron(over_speed, np.diff(over_force, axis=0))]
    )  # from each knot to its neighbours
    differences = steps.T @ steps
    gram += np.kron(SMOOTHNESS_PENALTY * differences + 1e-5 * np.eye(n_knots), np.diag(information))
    knot_speeds = np.repeat(table.speed_knots, len(table.force_knots))
    in_band = (knot_speeds[:, None] * np.repeat(multiples, 2) <= fastest).ravel()
    values = np.zeros(n_knots * n_columns)
    values[in_band] = np.linalg.solve(gram[np.ix_(in_band, in_band)], moment[in_band])
    return replace(table, values=values.reshape(n_knots, n_columns))


@dataclass(frozen=True)
class FittedResidual:
    """Tones, and the level and lattice of what they leave."""

    tones: FittedTones
    level: Scale
    reflections: FittedReflections


def fit_residual(
    data: LatticeData, sizes: FotenPlusSizes, blocks: ScaledBlocks, config: FotenPlusConfig
) -> FittedResidual | None:
    """Tones of levelled data and their residual; None where no wavelength stands out."""
    rate = blocks.trace.rate_hz
    length = wavelength(data, rate) if config.tones else None
    if length is None:
        return None
    tones = fit_tones(data, length, rate)
    # Of what the tones leave when the phase is known as well as it can be.
    residual = blocks.flat[:, 0] - (tones.waveform * data.gain).ravel()
    level, of_residual = fit_level(residual, sizes, blocks, config)
    return FittedResidual(tones, level, selected_lattices(of_residual, config)[0])


def tonal_model(linear: LinearModel, residual: FittedResidual, rate_hz: float) -> LinearModel:
    """The linear model with tones, and a lattice of their residual."""
    tones, fitted = residual.tones, residual.reflections
    counts = counts_of(fitted.table, "residual_order", "n_residual_speed", "n_residual_force")
    counts |= counts_of(tones.table, "n_tones", "n_tone_speed", "n_tone_force")
    counts["n_tones"] //= 2  # of which each has two coefficients
    sizes = replace(linear.sizes, **counts, residual_gain_before_filter=fitted.gain_before_filter)
    of_residual = lattice_tensors("residual.", residual.level, fitted.table)
    tensors = {**linear.tensors, **_tone_tensors(tones, rate_hz), **of_residual}
    report = {
        "lattices": linear.report["lattices"],
        "lattices_of_the_residual": fitted.tried,
        "wavelength_mm": tones.wavelength_mm,
        "period_jitter": tones.period_jitter,
    }
    return LinearModel(sizes, tensors, tones.phase, report)


def _tone_tensors(tones: FittedTones, rate_hz: float) -> Tensors:
    increment = 2 * np.pi / (tones.wavelength_mm * rate_hz)  # [rad] a sample at 1 mm/s
    phase = np.array([increment, tones.period_jitter, 1 / (PHASE_LEAK_S * rate_hz)])
    return {**table_tensors("tones.", tones.table, "values"), "tones.phase_params": phase}
