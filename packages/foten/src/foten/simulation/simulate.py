"""Seeded recordings with a known truth: twelve textures under raw sensors, more of contact mechanics, and linear processes.

    path length s(t) ─▶ roughness w(s): a lattice and self-affine noise ─┐
    Poisson impacts of asperities, a number for each mm ─────────────────┴▶ × level fᵅ vᵝ ─┐
                                                sensors ◀─ two modes of the tool ◀─ contact ◀┘

This is the model of one of the twelve. Not fitted to any surface. A way back meets new roughness of the same kind.
"""

import json
import threading
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.recording.recording import AXES, Channel, Recording
from foten.simulation.contact_mechanics import (
    CONTACT,
    RATE_HZ,
    ContactParameters,
    contact_vibrations,
    mode_filter,
    surface_of,
)
from foten.simulation.linear_family import LINEAR_FAMILY, OTHER_LINEAR, REFERENCE_SPEED, LinearParameters, linear_signal
from foten.simulation.parameters import check_parameters, parameter_table
from foten.simulation.stroking import Stroking, stroking
from foten.simulation.two_mass_contact import TWO_MASS, TwoMassParameters, two_mass_surface, two_mass_vibrations

_LOCK = threading.Lock()
VERSION = 2  # of the model; a change that moves a sample raises it
LINEAR_RATE_HZ = 1000.0  # of the linear family by default
POSITION_HZ = 120.0  # Sec. III-c
GRAVITY = 9.81  # m/s²
ACCELEROMETER_RANGE = 3 * GRAVITY  # ADXL335
ACCELEROMETER_BAND_HZ = 1600.0  # ADXL335, x and y without an external capacitor
ACCELEROMETER_NOISE = 2e-3  # m/s²/√Hz, ADXL335 class: 0.04 m/s² rms up to 450 Hz, 0.08 up to 1600 Hz
FORCE_NOISE_N = 0.01
POSITION_NOISE_MM = 0.02
MARKER_HEIGHT_MM = 40.0
SETTLING = 1000  # samples of the first reading before the record, so that it begins without a filter's transient
GRID_MM = 0.02  # of the roughness
TIP_PER_MM = 4.0  # cycles/mm: the ball of 2 mm bridges finer structure
AXIS_GAINS = np.array([[0.45, 0.55], [0.35, -0.25], [0.82, 0.80]])
"""Share of the two tool modes in x, y, z; each column has about unit norm, so that DFT321 keeps the level."""

RANGES, _ROWS = parameter_table("twelve.csv", ("harmonics", "modes_hz", "damping", "phases"))


@dataclass(frozen=True)
class TextureParameters:
    """What defines one simulated texture."""

    description: str
    level: float  # rms of the excitation at 100 mm/s and 1 N [m/s²], before the tool
    speed_exponent: float  # how the level grows
    force_exponent: float
    wavelength_mm: float  # cell of the lattice
    lattice_share: float  # of the roughness power, the rest is self-affine noise
    harmonics: tuple[float, ...]  # amplitudes of the lattice, any scale
    period_jitter: float  # standard deviation of a cell's length, relative
    corner_per_mm: float  # where the self-affine noise begins to fall [cycles/mm]
    hurst: float  # its fall, power ~ c^-(1 + 2 hurst)
    impacts_per_mm: float  # asperities struck on a path; few of them crackle, many hiss
    impacts_ratio: float  # rms of the impacts, relative to the roughness, at 100 mm/s
    contact_hz: float  # the contact's low-pass; soft surfaces have low ones
    modes_hz: tuple[float, float]  # of the tool; a firm grip on the surface (force) moves the weight to the second
    damping: tuple[float, float]
    friction: float  # coefficient
    phases: tuple[float, ...]  # of the harmonics along the lattice [rad]: the waveform of a cell

    def __post_init__(self) -> None:
        for name in ("harmonics", "modes_hz", "damping", "phases"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        check_parameters(self, RANGES)
        if len(self.phases) != len(self.harmonics):
            raise ValueError(f"{len(self.phases)} phases, expected one for each of {len(self.harmonics)} harmonics")
        for name in ("modes_hz", "damping"):
            if len(getattr(self, name)) != 2:
                raise ValueError(f"{name} is {getattr(self, name)}, expected two numbers")


TEXTURES: Mapping[str, TextureParameters] = {key: TextureParameters(**row) for key, row in _ROWS.items()}
Parameters = TextureParameters | ContactParameters | TwoMassParameters | LinearParameters
_ALL: Mapping[str, Parameters] = {**TEXTURES, **CONTACT, **TWO_MASS, **LINEAR_FAMILY, **OTHER_LINEAR}


def simulate(
    key: str,
    seconds: float = 64.0,
    seed: int = 0,
    *,
    noise_seed: int | None = None,
    stroke_seed: int | None = None,
    accelerometer_hz: float | None = None,
) -> Recording:
    """Simulated recording of one texture, of either simulator, or of one member of the linear family.

    A texture comes as raw sensors (Sec. III): acceleration with gravity, force and position, three axes each. A linear process
    comes as acceleration, speed and force at its rate, without noise. ValueError for an unknown key, or lengths, seeds and rates
    out of range.

    Args:
        seconds: length; the default leaves 60 s once 2 s are cut at each end.
        seed: of everything random that the next two leave out.
        noise_seed: of the surface, the impacts and the sensors; another one is a second realisation.
        stroke_seed: of the hand.
        accelerometer_hz: 10 000 (by default) divided by a whole number; for the linear family, its rate, 1000 by default.
    """
    if key not in _ALL:
        raise ValueError(f"unknown texture {key!r}, expected one of {', '.join(_ALL)}")
    default_hz = LINEAR_RATE_HZ if isinstance(_ALL[key], LinearParameters) else RATE_HZ
    simulation = {
        "key": key,
        "seconds": float(seconds),
        "seed": seed,
        "noise_seed": seed if noise_seed is None else noise_seed,
        "stroke_seed": seed if stroke_seed is None else stroke_seed,
        "accelerometer_hz": float(default_hz if accelerometer_hz is None else accelerometer_hz),
        "version": VERSION,
        "parameters": json.loads(json.dumps(asdict(_ALL[key]))),  # lists, as they come back from a file
    }
    return _simulated(simulation, [int(simulation["noise_seed"])])[0]


def simulate_stroke(key: str, stroke: Stroking, noise_seed: int) -> Recording:
    """Simulated recording under a stroke at 10 kHz, or at any rate for a linear process: raw sensors as of `simulate`."""
    parameters = _ALL[key]
    default_hz = stroke.rate_hz if isinstance(parameters, LinearParameters) else RATE_HZ
    if stroke.rate_hz != default_hz:
        raise ValueError(f"the stroke is at {stroke.rate_hz:g} Hz, expected {default_hz:g}")
    return _recordings(parameters, key, stroke, [noise_seed], None, default_hz)[0]


def second_realisation(recording: Recording, noise_seed: int) -> Recording:
    """Stroke and texture of a simulated recording with fresh surface and noise; its own seed gives the recording back."""
    return realisations(recording, [noise_seed])[0]


def realisations(
    recording: Recording,
    noise_seeds: Sequence[int],
    *,
    stroke_seed: int | None = None,
    seconds: float | None = None,
    spans_s: Sequence[tuple[float, float]] = (),
) -> list[Recording]:
    """`second_realisation` by several seeds, at once, under another stroke where one is given.

    With spans of time the vibration elsewhere may be left out. ValueError where it is not simulated by this version.
    """
    simulation = recording.simulation
    if simulation is None:
        raise ValueError("only a simulated recording has a second realisation; this one is not simulated")
    if simulation.get("version") != VERSION:
        raise ValueError(f"simulated by version {simulation.get('version')}, this is {VERSION}: simulate it again")
    try:
        changed = {"stroke_seed": stroke_seed, "seconds": seconds}
        changed = {name: value for name, value in changed.items() if value is not None}
        return _simulated({**simulation, **changed}, noise_seeds, spans_s)
    except (KeyError, TypeError) as error:
        raise ValueError(f"its parameters are those of another simulator ({error}): simulate it again") from error


def check_seconds(seconds: float) -> None:
    """Refuse, by a ValueError, a length that nothing is simulated for: it is not from 1 s to an hour."""
    if not 1 <= seconds <= 3600:
        raise ValueError(f"{seconds:g} s asked for, expected 1 to 3600")


def _simulated(
    simulation: Mapping[str, Any], noise_seeds: Sequence[int], spans_s: Sequence[tuple[float, float]] = ()
) -> list[Recording]:
    seconds, rate_hz = float(simulation["seconds"]), float(simulation["accelerometer_hz"])
    key = str(simulation["key"])
    _, stroke_seed = (int(simulation[name]) for name in ("seed", "stroke_seed"))
    parameters = type(_ALL[key])(**simulation["parameters"])
    check_seconds(seconds)
    if not 100 <= rate_hz <= RATE_HZ:
        raise ValueError(f"the accelerometer is at {rate_hz:g} Hz, expected 100 to {RATE_HZ:g}")
    if min(*noise_seeds, stroke_seed) < 0:
        raise ValueError("a seed is negative, expected 0 or more")
    with _LOCK:  # recordings of one stroke are simulated at once, and share it
        stroke = stroking(seconds, stroke_seed, rate_hz if isinstance(parameters, LinearParameters) else RATE_HZ)
    needed = None
    if spans_s:
        times = np.arange(len(stroke.force)) / stroke.rate_hz
        needed = np.logical_or.reduce([(start <= times) & (times < end) for start, end in spans_s])
    recordings = _recordings(parameters, key, stroke, noise_seeds, needed, rate_hz)
    return [
        replace(recording, simulation={**simulation, "noise_seed": noise_seed})
        for recording, noise_seed in zip(recordings, noise_seeds, strict=True)
    ]


def _recordings(
    parameters: Parameters,
    key: str,
    stroke: Stroking,
    noise_seeds: Sequence[int],
    needed: NDArray[np.bool_] | None,
    rate_hz: float,
) -> list[Recording]:
    """Recording of each realisation of a stroke, by raw sensors over a texture, free of noise for a linear process."""
    # The key's bytes keep two textures of one seed apart, under one stroke.
    rngs = [np.random.default_rng([noise_seed, 2, *key.encode()]) for noise_seed in noise_seeds]
    decimation = round(RATE_HZ / rate_hz)

    def of_process(rng: np.random.Generator) -> dict[str, Channel]:
        assert isinstance(parameters, LinearParameters)
        acceleration = linear_signal(parameters, stroke.speed, stroke.force, rng)
        signals = {"acceleration": acceleration, "speed": stroke.speed, "force": stroke.force}
        return {name: Channel(samples, rate_hz) for name, samples in signals.items()}

    def of_sensors(vibrated: tuple[Array, Array], rng: np.random.Generator) -> dict[str, Channel]:
        assert not isinstance(parameters, LinearParameters)
        own_motion = not isinstance(parameters, TwoMassParameters)
        return sensor_channels(*vibrated, parameters.friction, stroke, decimation, rng, own_motion)

    with ThreadPoolExecutor() as pool:  # filters and transforms release the interpreter's lock
        if isinstance(parameters, LinearParameters):
            return [
                Recording(channels, texture=key, sensors="noise-free, one axis", notes="simulated")
                for channels in pool.map(of_process, rngs)
            ]
        if RATE_HZ / decimation != rate_hz:
            raise ValueError(f"{rate_hz:g} Hz is not {RATE_HZ:g} Hz divided by a whole number")
        vibrations: Iterable[tuple[Array, Array]]
        if isinstance(parameters, ContactParameters):
            vibrations = contact_vibrations(parameters, surface_of(parameters, key), stroke, rngs, needed)
        elif isinstance(parameters, TwoMassParameters):
            vibrations = two_mass_vibrations(parameters, two_mass_surface(parameters, key), stroke, rngs, needed)
        else:
            vibrated = pool.map(partial(vibration, parameters, stroke), rngs)
            vibrations = ((acceleration, stroke.force) for acceleration in vibrated)
        sensors = "simulated ADXL335, force at 10 kHz, position at 120 Hz"
        return [
            Recording(channels, key, "simulated rigid tool, 2 mm steel ball", sensors, notes="simulated")
            for channels in pool.map(of_sensors, vibrations, rngs)
        ]


def _roughness(parameters: TextureParameters, length_mm: float, rng: np.random.Generator) -> Array:
    """Roughness along a path on a grid of GRID_MM, of unit expected power."""
    from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

    n = next_fast_len(int(length_mm / GRID_MM) + 2, real=True)
    c = rfftfreq(n, GRID_MM)
    tip = np.exp(-0.5 * (c / TIP_PER_MM) ** 2)
    amplitude = tip * (1 + (c / parameters.corner_per_mm) ** 2) ** (-(0.5 + parameters.hurst) / 2)
    power = (amplitude**2).sum() / amplitude.size
    noise = irfft(rfft(rng.standard_normal(n)) * amplitude, n) / np.sqrt(power)
    if parameters.lattice_share == 0:
        return noise

    n_cells = int(1.5 * n * GRID_MM / parameters.wavelength_mm) + 20
    cells = parameters.wavelength_mm * np.maximum(0.3, 1 + parameters.period_jitter * rng.standard_normal(n_cells))
    edges = np.concatenate([[0.0], np.cumsum(cells)]) - rng.uniform(0, parameters.wavelength_mm)
    phase = 2 * np.pi * np.interp(np.arange(n) * GRID_MM, edges, np.arange(n_cells + 1))
    harmonics = enumerate(zip(parameters.harmonics, parameters.phases, strict=True), start=1)
    lattice = sum(gain * np.cos(order * phase + start) for order, (gain, start) in harmonics)
    lattice /= np.sqrt(0.5 * sum(gain**2 for gain in parameters.harmonics))
    share = parameters.lattice_share
    return np.sqrt(share) * lattice + np.sqrt(1 - share) * noise


def vibration(parameters: TextureParameters, stroke: Stroking, rng: np.random.Generator) -> Array:
    """Vibration of the tool before any sensor [m/s²], axes x, y, z, shape (n, 3); none at rest."""
    from scipy.signal import butter, lfilter, sosfilt

    path_mm = np.cumsum(stroke.speed) / stroke.rate_hz
    roughness = _roughness(parameters, path_mm[-1], rng)
    excitation = np.interp(path_mm, np.arange(roughness.size) * GRID_MM, roughness)

    # Impacts are Poisson in the path: sparse when slow, dense when fast.
    counts = rng.poisson(parameters.impacts_per_mm * stroke.speed / stroke.rate_hz)
    at_reference = parameters.impacts_per_mm * REFERENCE_SPEED / stroke.rate_hz
    # White up to 5 kHz, of which the contact passes contact_hz; scaled so that this part has the stated rms.
    passed = parameters.contact_hz / (stroke.rate_hz / 2)
    strikes = np.sqrt(counts) * rng.standard_normal(counts.size)
    excitation += parameters.impacts_ratio / np.sqrt(at_reference * passed) * strikes

    grown = (stroke.speed / REFERENCE_SPEED) ** parameters.speed_exponent * stroke.force**parameters.force_exponent
    excitation *= parameters.level * grown
    excitation = sosfilt(butter(2, parameters.contact_hz, fs=stroke.rate_hz, output="sos"), excitation)
    firm = stroke.force / (stroke.force + 1.0)  # half at 1 N, where both modes weigh 1
    axes = np.zeros((excitation.size, 3))
    for mode, weight in enumerate((1.5 - firm, 2 * firm)):
        b, a = mode_filter(parameters.modes_hz[mode], parameters.damping[mode], stroke.rate_hz)
        axes += (weight * lfilter(b, a, excitation))[:, None] * AXIS_GAINS[:, mode]
    return axes


def sensor_channels(
    acceleration: Array,
    normal_force: Array,
    friction: float,
    stroke: Stroking,
    decimation: int,
    rng: np.random.Generator,
    own_motion: bool = True,
) -> dict[str, Channel]:
    """Raw channels of Sec. III, from the tool's vibration [m/s²], (n, 3), the surface's normal force [N], (n,), and the hand."""
    from scipy.signal import butter, sosfilt

    if own_motion:
        acceleration[:, :2] += np.gradient(stroke.velocity, axis=0) * stroke.rate_hz / 1000
    lean = np.sin(stroke.tilt)
    acceleration[:, :2] += GRAVITY * lean
    acceleration[:, 2] += GRAVITY * np.sqrt(1 - (lean**2).sum(axis=1))  # at rest it reads +g upwards
    acceleration += rng.normal(0, ACCELEROMETER_NOISE * np.sqrt(stroke.rate_hz / 2), acceleration.shape)
    band = butter(2, ACCELEROMETER_BAND_HZ, fs=stroke.rate_hz, output="sos")
    acceleration_hz = stroke.rate_hz / decimation
    if decimation > 1:  # the anti-alias filter of the slower converter: 450 Hz at 1 kHz
        band = np.vstack([band, butter(8, 0.45 * acceleration_hz, fs=stroke.rate_hz, output="sos")])
    settled = np.concatenate([np.tile(acceleration[:1], (SETTLING, 1)), acceleration])
    acceleration = sosfilt(band, settled, axis=0)[SETTLING::decimation]
    np.clip(acceleration, -ACCELEROMETER_RANGE, ACCELEROMETER_RANGE, out=acceleration)

    direction = stroke.velocity / (stroke.speed + 5.0)[:, None]  # 5 mm/s: friction turns over smoothly
    force = np.column_stack([-friction * normal_force[:, None] * direction, normal_force])
    force += rng.normal(0, FORCE_NOISE_N, force.shape)

    n_position = int(len(stroke.position) / stroke.rate_hz * POSITION_HZ)
    times = np.arange(n_position) / POSITION_HZ * stroke.rate_hz
    x, y = (np.interp(times, np.arange(len(stroke.position)), column) for column in stroke.position.T)
    position = np.column_stack([x, y, np.full(n_position, MARKER_HEIGHT_MM)])
    position += rng.normal(0, POSITION_NOISE_MM, position.shape)

    return {
        f"{quantity}_{axis}": Channel(np.ascontiguousarray(column), rate_hz)
        for quantity, samples, rate_hz in (
            ("acceleration", acceleration, acceleration_hz),
            ("force", force, stroke.rate_hz),
            ("position", position, POSITION_HZ),
        )
        for axis, column in zip(AXES, samples.T, strict=True)
    }
