"""Textures by contact mechanics: a ball on a rough profile, whose contact can be lost and whose friction can stick.

    place on the profile ─▶ height under the ball ─▶ Hertz contact, or none ─▶ force ─┐
    speed ─▶ the tip, on a spring, under Coulomb friction of that force ─▶ friction ──┴─▶ modes of the tool ─▶ acceleration

Height under a ball of radius R on the profile p: h(s) = maxᵤ [p(s + u) − u²/2R]. Normal force: F = K δ^1.5 (1 + D dδ/dt) ≥ 0,
with δ = h − z and K = 4/3 E* √R (Hertz; Hunt & Crossley, Journal of Applied Mechanics 42, 1975). The tip: m z̈ = F − P − c ż
under the hand's force P; along the stroke m q̈ = −k q − d q̇ ± μF, with μ(1 + s) at rest. Not fitted to any surface.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.simulation.parameters import check_parameters, parameter_table
from foten.simulation.stroking import Stroking

GRID_MM = 0.01  # of a profile
LOOP_MM = 4000.0  # after which a profile begins again: half a minute at the usual speed
RATE_HZ = 10_000.0  # of both simulators' physics, of the force sensor, and of the accelerometer by default
SUBSTEPS = 4  # of the mechanics in each sample of a stroke
MAX_IMPACT_N = 50.0  # of an impact, for which steps must be short enough
PIECE_S, OVERLAP_S, FADE_S = 0.25, 0.15, 0.01  # of pieces that are integrated side by side, settle and overlap
MAX_PIECES = 1500  # integrated at once: the more, the less each costs; 33 kB each in memory for every series
BODY_G = 80.0  # mass of the tool that the sensor sits on
MODES_HZ, MODES_DAMPING, MODES_SHARE = (120.0, 340.0), (0.30, 0.15), (1.0, 0.7)  # of the tool, that both forces ring
STIFF_SHARE = 0.15  # of the forces that moves the body at once
DIRECTION = np.array([0.8, 0.6])  # of tangential motion in the sensor's x and y
_SHARES = (np.arange(SUBSTEPS)[:, None] + 1.0) / SUBSTEPS  # of the way from a sample to the next
STRIBECK_MM_S = 15.0  # speed over which friction falls from static to kinetic

RANGES, _ROWS = parameter_table("contact.csv")


@dataclass(frozen=True)
class ContactParameters:
    """What defines one texture: its profile, its material, its friction, and how the tool is held."""

    description: str
    roughness_um: float  # RMS of self-affine noise
    corner_per_mm: float  # where its power begins to fall [cycles/mm]
    hurst: float  # how: power ~ c^-(1 + 2 hurst)
    grains_per_mm: float  # caps that stand out of the noise, or with a negative height pores; 0 for none
    grain_um: float  # their median height
    grain_spread: float  # standard deviation of its logarithm: how few stand out how far
    grain_mm: float  # their width
    wavelength_mm: float  # of the periodic part
    depth_um: float  # of it, 0 for none
    sharpness: float  # 1 is a sine; more are narrower crests, as of wires
    period_jitter: float  # standard deviation of a period, relative
    alternating: float  # share by which every second period is lower, as of a weave
    tip_mm: float  # radius of the ball
    modulus_mpa: float  # E* of the contact
    damping_s_m: float  # D: how much of an impact is lost
    tip_mass_g: float  # of the tool, as the surface feels it
    hand_damping_n_s_m: float  # c: damping of its normal motion by the hand
    friction: float  # μ, kinetic
    stick: float  # s: how much more at rest
    shaft_hz: float  # of the tip on its tangential spring
    shaft_damping: float  # of that

    def __post_init__(self) -> None:
        check_parameters(self, RANGES)
        stiffest = 1.5 * self.stiffness ** (2 / 3) * MAX_IMPACT_N ** (1 / 3)
        if stiffest / self.mass_kg > (0.5 * RATE_HZ * SUBSTEPS) ** 2:
            contact = f"{self.modulus_mpa:g} MPa under {self.tip_mass_g:g} g"
            raise ValueError(f"a contact of {contact} is too stiff for steps of 25 µs")

    @property
    def mass_kg(self) -> float:
        """Mass m [kg]."""
        return self.tip_mass_g * 1e-3

    @property
    def stiffness(self) -> float:
        """Stiffness K of Hertz's contact [N/m^1.5]."""
        return float(4 / 3 * self.modulus_mpa * 1e6 * np.sqrt(self.tip_mm * 1e-3))


CONTACT: Mapping[str, ContactParameters] = {key: ContactParameters(**row) for key, row in _ROWS.items()}


@lru_cache(maxsize=2)
def profile(parameters: ContactParameters, key: str) -> Array:
    """Height of a texture along its loop [mm], one point every `GRID_MM`, zero on the mean, the same for every seed."""
    from scipy.fft import irfft, rfft, rfftfreq

    rng = np.random.default_rng([3, *key.encode()])
    n = round(LOOP_MM / GRID_MM)
    c = rfftfreq(n, GRID_MM)
    amplitude = (1 + (c / parameters.corner_per_mm) ** 2) ** (-(0.5 + parameters.hurst) / 2)
    amplitude[0] = 0.0
    noise = irfft(rfft(rng.standard_normal(n)) * amplitude, n)
    height = parameters.roughness_um * 1e-3 * noise / noise.std()
    if parameters.depth_um:
        height += parameters.depth_um * 1e-3 * _periodic(parameters, n, rng)
    if parameters.grains_per_mm:
        height = _with_grains(height, parameters, rng)
    height -= height.mean()
    height.flags.writeable = False
    return height


def _periodic(parameters: ContactParameters, n: int, rng: np.random.Generator) -> Array:
    """Crests of unit height with uneven periods, closed to a loop, (n,)."""
    n_periods = round(LOOP_MM / parameters.wavelength_mm / 2) * 2
    periods = np.maximum(0.3, 1 + parameters.period_jitter * rng.standard_normal(n_periods))
    edges = np.concatenate([[0.0], np.cumsum(periods)]) * LOOP_MM / periods.sum()
    phase = np.interp(np.arange(n) * GRID_MM, edges, np.arange(edges.size))
    crest = (0.5 - 0.5 * np.cos(2 * np.pi * phase)) ** parameters.sharpness
    return crest * np.where(phase.astype(np.int64) % 2, 1.0 - parameters.alternating, 1.0)


def _with_grains(height: Array, parameters: ContactParameters, rng: np.random.Generator) -> Array:
    """Profile with caps or pores; where they overlap, the higher cap or the deeper pore."""
    n, half = height.size, round(0.5 * parameters.grain_mm / GRID_MM)
    count = rng.poisson(parameters.grains_per_mm * LOOP_MM)
    at = rng.integers(0, n, count)
    sizes = abs(parameters.grain_um) * 1e-3 * np.exp(parameters.grain_spread * rng.standard_normal(count))
    cap = 1 - (np.arange(-half, half + 1) / (half + 1)) ** 2
    caps = np.zeros(n)
    for offset, share in zip(range(-half, half + 1), cap, strict=True):
        np.maximum.at(caps, (at + offset) % n, share * sizes)
    return height + np.sign(parameters.grain_um) * caps


@lru_cache(maxsize=2)
def surface_of(parameters: ContactParameters, key: str) -> Array:
    """Height of the ball that rests on a texture's profile [mm], for each of its points."""
    lifted = under_ball(profile(parameters, key), parameters.tip_mm)
    lifted.flags.writeable = False
    return lifted


def under_ball(height: Array, tip_mm: float) -> Array:
    """Height of a ball that rests on a closed profile [mm], (n,) each: a point every `GRID_MM`."""
    from scipy.ndimage import grey_dilation

    reach = min(tip_mm, np.sqrt(2 * tip_mm * float(np.ptp(height))))
    u = np.arange(-int(reach / GRID_MM), int(reach / GRID_MM) + 1) * GRID_MM
    return np.asarray(grey_dilation(height, structure=-(u**2) / (2 * tip_mm), mode="wrap"))


def contact_vibration(
    parameters: ContactParameters, surface: Array, stroke: Stroking, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Vibration of the tool before any sensor [m/s²], axes x, y, z, (n, 3), and the force of the contact [N], (n,)."""
    return contact_vibrations(parameters, surface, stroke, [rng])[0]


def contact_vibrations(
    parameters: ContactParameters,
    surface: Array,
    stroke: Stroking,
    rngs: Sequence[np.random.Generator],
    needed: NDArray[np.bool_] | None = None,
) -> list[tuple[Array, Array]]:
    """`contact_vibration` of several realisations of a stroke, side by side; as at rest where it is not `needed`, (n,)."""
    from scipy.signal import lfilter

    rate = stroke.rate_hz
    integrate = partial(_integrate, parameters, surface, rate)
    vibrations = []
    for friction, force in joined_pieces(integrate, places_along(stroke, rngs), stroke, needed):
        pushed = np.stack([force - stroke.force, friction], axis=1) / (BODY_G * 1e-3)
        acceleration = STIFF_SHARE * pushed
        for hz, damping, share in zip(MODES_HZ, MODES_DAMPING, MODES_SHARE, strict=True):
            acceleration = acceleration + share * lfilter(*mode_filter(hz, damping, rate), pushed, axis=0)
        vibrations.append((np.column_stack([acceleration[:, 1:] * DIRECTION, acceleration[:, 0]]), force))
    return vibrations


def places_along(stroke: Stroking, rngs: Sequence[np.random.Generator]) -> Array:
    """Places of realisations along a stroke [mm], each from where its generator says: (n_realisations, n)."""
    path = np.cumsum(stroke.speed) / stroke.rate_hz
    return np.stack([rng.uniform(0, LOOP_MM) + path for rng in rngs])


def mode_filter(hz: float, damping: float, rate_hz: float) -> tuple[Array, Array]:
    """Numerator and denominator of a damped mode of unit gain at its centre, 2ζω₀s / (s² + 2ζω₀s + ω₀²), bilinear."""
    from scipy.signal import bilinear

    omega = 2 * rate_hz * np.tan(np.pi * hz / rate_hz)
    width = 2 * damping * omega
    b, a = bilinear([width, 0], [1, width, omega**2], rate_hz)
    return b, a


def joined_pieces(
    integrate: Callable[[Array, Array, Array], Array],
    places: Array,
    stroke: Stroking,
    needed: NDArray[np.bool_] | None = None,
) -> list[Array]:
    """Series of realisations of a stroke, (any, n) each, in pieces side by side, each settled when it takes over.

    Args:
        integrate: places [mm], speeds [mm/s] and forces [N] of pieces, (k, m) each → series from equilibrium (any, k, m), the
            force of the contact last.
        places: of each realisation, (n_realisations, n).
        needed: where series are, (n,), all by default; elsewhere they may be zero, and the force is the hand's.
    """
    n, piece, overlap, fade = len(stroke.force), *(round(s * stroke.rate_hz) for s in (PIECE_S, OVERLAP_S, FADE_S))
    starts = np.arange(0, n, piece)
    index = np.clip(starts[:, None] + np.arange(-overlap, piece + fade), 0, n - 1)
    chosen = slice(None) if needed is None else np.flatnonzero(needed[index].any(axis=1))
    ramp = (np.arange(fade) + 0.5) / fade
    n_at_once = max(1, MAX_PIECES // len(index[chosen]))
    joined = []
    for first in range(0, len(places), n_at_once):
        some = places[first : first + n_at_once]
        conditions = (np.tile(channel[index[chosen]], (len(some), 1)) for channel in (stroke.speed, stroke.force))
        parts = integrate(some[:, index[chosen]].reshape(-1, index.shape[1]), *conditions)
        for part in np.split(parts, len(some), axis=1):
            settled = np.zeros((len(parts), len(starts), piece + fade))
            settled[:, chosen] = part[:, :, overlap:]  # a piece, and how it would go on
            settled[:, 1:, :fade] = ramp * settled[:, 1:, :fade] + (1 - ramp) * settled[:, :-1, piece:]
            series = settled[:, :, :piece].reshape(len(parts), -1)[:, :n]
            if needed is not None:
                series[-1] = np.where(needed, series[-1], stroke.force)
            joined.append(series)
    return joined


def _integrate(
    parameters: ContactParameters, surface: Array, rate_hz: float, place: Array, speed: Array, force: Array
) -> Array:
    """Friction and contact force [N] of pieces (k, n), each from equilibrium at its first sample: (2, k, n).

    Semi-implicit steps; the friction of a step is at most what stops the tip in it, which is sticking.
    """
    p, dt = parameters, 1 / (rate_hz * SUBSTEPS)
    mass, stiffness = p.mass_kg, p.stiffness
    spring, shaft = mass * (2 * np.pi * p.shaft_hz) ** 2, 2 * p.shaft_damping * mass * 2 * np.pi * p.shaft_hz
    k, n = place.shape
    outputs = np.empty((2, n, k))
    places, forces = np.ascontiguousarray(place.T), np.ascontiguousarray(force.T)
    towards = np.ascontiguousarray(speed.T) * 1e-3
    z, w = surface_height(surface, places[0]) - (force[:, 0] / stiffness) ** (2 / 3), np.zeros(k)
    q, u, sliding = np.zeros(k), np.zeros(k), towards[0]
    for i, (heights, rates) in enumerate(passed(surface, places, dt)):
        total, held, presses = np.zeros(k), np.zeros(k), substeps(forces, i)
        for j in range(SUBSTEPS):
            depth = np.maximum(heights[j] - z, 0.0)
            contact = np.maximum(stiffness * depth * np.sqrt(depth) * (1 + p.damping_s_m * (rates[j] - w)), 0.0)
            w = w + dt / mass * (contact - presses[j] - p.hand_damping_n_s_m * w)
            z = z + dt * w
            # Along the stroke the tip slides over the surface at v + q̇, and friction is against that.
            if p.friction:
                sticking = 1 + p.stick * np.exp(-np.abs(sliding) * (1e3 / STRIBECK_MM_S))
                limit = dt / mass * p.friction * contact * sticking
                free = u - dt / mass * (spring * q + shaft * u)
                stopped = np.minimum(np.maximum(-limit, -(towards[i] + free)), limit)
                u = free + stopped
                q = q + dt * u
                sliding = towards[i] + u
                held += stopped
            total += contact
        outputs[0, i], outputs[1, i] = held * (mass / dt / SUBSTEPS), total / SUBSTEPS
    return outputs.transpose(0, 2, 1)


def passed(surface: Array, places: Array, dt: float) -> Iterator[tuple[Array, Array]]:
    """Yield height [m] and its rate [m/s] in the steps of dt [s] up to each sample, (SUBSTEPS, k), at places [mm] (n, k)."""
    last = surface_height(surface, places[:1])
    for i in range(len(places)):
        heights = surface_height(surface, substeps(places, i))
        yield heights, (heights - np.concatenate([last, heights[:-1]])) / dt
        last = heights[-1:]


def substeps(samples: Array, i: int) -> Array:
    """Values at the steps up to sample i, on straight lines from the one before: (n, k) → (SUBSTEPS, k)."""
    before = samples[max(i - 1, 0)]
    return np.asarray(before + _SHARES * (samples[i] - before))


def surface_height(surface: Array, place: Array) -> Array:
    """Height of a surface [m] at some places [mm], in their shape: straight lines between its points."""
    at = place / GRID_MM
    point = np.floor(at)
    first = point.astype(np.int64) % surface.size
    here, there = surface[first], surface[(first + 1) % surface.size]
    return np.asarray(1e-3 * (here + (at - point) * (there - here)))
