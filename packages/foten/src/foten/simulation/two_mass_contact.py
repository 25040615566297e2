"""Textures of other physics: profiles by other laws, a tool of two masses in a compliant hand, friction with a memory.

A model that was tuned on `contact_mechanics` is judged here, which shares the strokes, the ball and the sensors alone. The
profile is fractional Brownian noise, filtered Poisson grains and uneven threads, in slow waves. The tip m₁ touches, the body m₂
carries the sensor, the hand's mass m₃ presses with the force P by the springs and dampers N and H. The tip slides at V:

    F = max(0, K (δ^1.5 + 1.5 τ √δ dδ/dt))      Kuwabara & Kono, Japanese Journal of Applied Physics 26 (1987)
    m₁ z̈₁ = F − N,  m₂ z̈₂ = N − H,  m₃ z̈₃ = H − P
    μ = a asinh(V / 2V₀ · exp((μ₀ + b ln(V₀ θ / d)) / a)),  dθ/dt = 1 − V θ / d      Dieterich (1979), Ruina (1983)

Where b > a the contact sticks and slips; the regularised form is that of Rice & Ben-Zion (1996). Not fitted to any surface.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.simulation.contact_mechanics import (
    DIRECTION,
    GRID_MM,
    LOOP_MM,
    RATE_HZ,
    SUBSTEPS,
    joined_pieces,
    passed,
    places_along,
    substeps,
    surface_height,
    under_ball,
)
from foten.simulation.parameters import check_parameters, parameter_table
from foten.simulation.stroking import Stroking

MAX_IMPACT_N = 40.0  # of an impact, for which steps must be short enough
LONGEST_MM = 40.0  # wavelength of the noise
REFERENCE_MM_S = 1.0  # V₀ of the friction
N_NEWTON = 6  # steps of Newton's method: it begins on the side from which it converges without a swing
RANGES, _ROWS = parameter_table("two_mass.csv")


@dataclass(frozen=True)
class TwoMassParameters:
    """What defines one texture: its profile, its material, its tool and hand, its friction."""

    description: str
    roughness_um: float  # RMS of fractional Brownian noise
    hurst: float  # its power falls as c^-(1 + 2 hurst)
    grains_per_mm: float  # 0 for none
    grain_um: float  # mean height; negative are pits
    grain_shape: float  # of the gamma distribution of heights: 1 is exponential, more are alike
    grain_mm: float  # over which one falls off
    thread_mm: float  # period of threads
    thread_um: float  # their height, 0 for none
    thread_spread: float  # standard deviation of the logarithm of heights and periods
    defects_per_mm: float  # missing or thick threads
    wave_mm: float  # mean length of the slow waves
    wave_nepers: float  # by how much the logarithm of all heights swings, 0 for none
    wave_spread: float  # standard deviation of the logarithm of lengths and swings
    tip_mm: float  # radius of the ball
    modulus_mpa: float  # E* of the contact
    relaxation_ms: float  # τ of its damping
    tip_g: float  # m₁
    body_g: float  # m₂
    hand_g: float  # m₃
    neck_hz: float  # of m₁ on the neck
    neck_damping: float
    flesh_hz: float  # of m₂ on the hand's flesh
    flesh_damping: float
    shaft_hz: float  # of m₁ on the bending shaft
    shaft_damping: float
    friction: float  # μ₀, at 1 mm/s
    direct: float  # a
    evolution: float  # b
    memory_mm: float  # d

    def __post_init__(self) -> None:
        check_parameters(self, RANGES)
        tangent = 1.5 * self.stiffness ** (2 / 3) * MAX_IMPACT_N ** (1 / 3) / (1e-3 * self.tip_g)
        step = 1 / (RATE_HZ * SUBSTEPS)
        if tangent * step * step > 0.25 or tangent * 1e-3 * self.relaxation_ms * step > 0.5:
            contact = f"{self.modulus_mpa:g} MPa and {self.relaxation_ms:g} ms under {self.tip_g:g} g"
            raise ValueError(f"a contact of {contact} is too stiff for steps of 25 µs")

    @property
    def stiffness(self) -> float:
        """Stiffness K of Hertz's contact [N/m^1.5]."""
        return float(4 / 3 * self.modulus_mpa * 1e6 * np.sqrt(self.tip_mm * 1e-3))


TWO_MASS: Mapping[str, TwoMassParameters] = {key: TwoMassParameters(**row) for key, row in _ROWS.items()}


@lru_cache(maxsize=2)
def two_mass_surface(parameters: TwoMassParameters, key: str) -> Array:
    """Height of the ball that rests on a texture's closed profile [mm], a point every `GRID_MM`, the same for every seed."""
    surface = under_ball(two_mass_profile(parameters, np.random.default_rng([7, *key.encode()])), parameters.tip_mm)
    surface.flags.writeable = False
    return surface


def two_mass_profile(parameters: TwoMassParameters, rng: np.random.Generator) -> Array:
    """Height of a profile along its loop [mm], one point every `GRID_MM`, zero on the mean."""
    from scipy.fft import irfft, rfft, rfftfreq

    n = round(LOOP_MM / GRID_MM)
    c = rfftfreq(n, GRID_MM)
    with np.errstate(divide="ignore"):
        amplitude = np.where(c < 1 / LONGEST_MM, 0.0, c ** -(0.5 + parameters.hurst))
    noise = irfft(rfft(rng.standard_normal(n)) * amplitude, n)
    height = parameters.roughness_um * noise / noise.std()
    if parameters.grains_per_mm:
        height += _grains(parameters, n, rng)
    if parameters.thread_um:
        height += _threads(parameters, n, rng)
    if parameters.wave_nepers:
        height = (height - height.mean()) * np.exp(_waves(parameters, n, rng))
    return np.asarray(1e-3 * (height - height.mean()))


def _grains(parameters: TwoMassParameters, n: int, rng: np.random.Generator) -> Array:
    """Filtered Poisson grains [µm]: heights of a gamma distribution, steep in front, overlapping ones added; (n,)."""
    from scipy.fft import irfft, rfft

    count = rng.poisson(parameters.grains_per_mm * LOOP_MM)
    heights = parameters.grain_um * rng.gamma(parameters.grain_shape, 1 / parameters.grain_shape, count)
    impulses = np.bincount(rng.integers(0, n, count), heights, n)
    along = np.arange(n) * GRID_MM / parameters.grain_mm
    pulse = np.exp(-np.minimum(along, 40.0)) - np.exp(-np.minimum(4 * along, 40.0))
    return np.asarray(irfft(rfft(impulses) * rfft(pulse / pulse.max()), n))


def _threads(parameters: TwoMassParameters, n: int, rng: np.random.Generator) -> Array:
    """Round threads [µm] of uneven height and period; a defect takes one away, or makes it twice as thick; (n,)."""
    n_threads = round(LOOP_MM / parameters.thread_mm)
    periods, heights = np.exp(parameters.thread_spread * rng.standard_normal((2, n_threads)))
    defect = rng.random(n_threads) < parameters.defects_per_mm * parameters.thread_mm
    thick = defect & (rng.random(n_threads) < 0.5)
    heights = np.where(defect, np.where(thick, 1.6, 0.0), heights)
    edges = np.concatenate([[0.0], np.cumsum(np.where(thick, 2.0, 1.0) * periods)])
    edges *= LOOP_MM / edges[-1]
    at = np.arange(n) * GRID_MM
    thread = np.searchsorted(edges, at, side="right") - 1
    across = 2 * (at - edges[thread]) / np.diff(edges)[thread] - 1
    return np.asarray(parameters.thread_um * heights[thread] * np.sqrt(np.maximum(0.0, 1 - across * across)))


def _waves(parameters: TwoMassParameters, n: int, rng: np.random.Generator) -> Array:
    """Slow waves of uneven length and swing [nepers], which rise slowly and fall fast; (n,)."""
    n_waves = round(LOOP_MM / parameters.wave_mm)
    lengths, swings = np.exp(parameters.wave_spread * rng.standard_normal((2, n_waves)))
    edges = np.concatenate([[0.0], np.cumsum(lengths)]) * LOOP_MM / lengths.sum()
    at = np.arange(n) * GRID_MM
    wave = np.searchsorted(edges, at, side="right") - 1
    share = (at - edges[wave]) / np.diff(edges)[wave]
    phase = np.where(share < 0.7, share / 0.7, (1 - share) / 0.3)
    return np.asarray(parameters.wave_nepers * (swings[wave] * (0.5 - 0.5 * np.cos(np.pi * phase)) - 0.5))


def two_mass_vibrations(
    parameters: TwoMassParameters,
    surface: Array,
    stroke: Stroking,
    rngs: Sequence[np.random.Generator],
    needed: NDArray[np.bool_] | None = None,
) -> list[tuple[Array, Array]]:
    """Vibrations and forces of realisations of a stroke, as of `contact_vibrations`, over what `two_mass_surface` gives."""
    integrate = partial(_integrate, parameters, surface, stroke.rate_hz)
    return [
        (np.column_stack([tangential[:, None] * DIRECTION, normal]), force)
        for normal, tangential, force in joined_pieces(integrate, places_along(stroke, rngs), stroke, needed)
    ]


def _integrate(
    parameters: TwoMassParameters, surface: Array, rate_hz: float, place: Array, speed: Array, force: Array
) -> Array:
    """Normal and tangential acceleration of the body [m/s²] and force of the contact [N] of pieces (k, n): (3, k, n).

    Each piece begins at equilibrium; semi-implicit steps, the friction of a step implicit in the sliding speed.
    """
    p, dt = parameters, 1 / (rate_hz * SUBSTEPS)
    tip, body, hand, stiffness = 1e-3 * p.tip_g, 1e-3 * p.body_g, 1e-3 * p.hand_g, p.stiffness
    (neck, neck_loss), (flesh, flesh_loss), (shaft, shaft_loss) = (
        (mass * omega**2, 2 * damping * mass * omega)
        for mass, omega, damping in (
            (tip, 2 * np.pi * p.neck_hz, p.neck_damping),
            (body, 2 * np.pi * p.flesh_hz, p.flesh_damping),
            (tip, 2 * np.pi * p.shaft_hz, p.shaft_damping),
        )
    )
    k, n = place.shape
    outputs = np.empty((3, n, k))
    places, forces = np.ascontiguousarray(place.T), np.ascontiguousarray(force.T)
    towards = np.ascontiguousarray(speed.T) * 1e-3
    z = np.empty((3, k))  # heights of tip, body and hand, and their speeds
    z[0] = surface_height(surface, places[0]) - (force[:, 0] / stiffness) ** (2 / 3)
    z[1] = z[0] - force[:, 0] / neck
    z[2] = z[1] - force[:, 0] / flesh
    w, q, u = np.zeros((3, k)), np.zeros(k), np.zeros(k)
    memory, slowest = p.memory_mm * 1e-3, 1e-6
    age = memory / np.maximum(towards[0], slowest)
    for i, (heights, rates) in enumerate(passed(surface, places, dt)):
        total, presses = np.zeros((3, k)), substeps(forces, i)
        for j in range(SUBSTEPS):
            depth = np.maximum(heights[j] - z[0], 0.0)
            root = np.sqrt(depth)
            contact = stiffness * root * (depth + 1.5e-3 * p.relaxation_ms * (rates[j] - w[0]))
            np.maximum(contact, 0.0, out=contact)
            by_neck = neck * (z[0] - z[1]) + neck_loss * (w[0] - w[1])
            by_flesh = flesh * (z[1] - z[2]) + flesh_loss * (w[1] - w[2])
            pushed = (by_neck - by_flesh) / body
            w[0] += dt / tip * (contact - by_neck)
            w[1] += dt * pushed
            w[2] += dt / hand * (by_flesh - presses[j])
            z += dt * w
            bends = shaft * q + shaft_loss * u
            free = u - dt / tip * bends
            sliding = _sliding(p, towards[i] + free, dt / tip * contact, age)
            u = sliding - towards[i]
            q = q + dt * u
            slid = np.maximum(np.abs(sliding), slowest)
            age = memory / slid + (age - memory / slid) * np.exp(-slid * dt / memory)
            total += (pushed, bends / body, contact)
        outputs[:, i] = total / SUBSTEPS
    return outputs.transpose(0, 2, 1)


def _sliding(parameters: TwoMassParameters, free: Array, impulse: Array, age: Array) -> Array:
    """Sliding speed V [m/s] after a step: V + impulse · μ(V, θ) = free, for speeds without friction and F dt/m, (k,) each.

    With y = asinh(V/2V₀ exp ψ) it is 2V₀ exp(−ψ) sinh y + impulse · a y = free, convex for y > 0.
    """
    p, rest = parameters, 2e-3 * REFERENCE_MM_S
    psi = (p.friction + p.evolution * np.log(REFERENCE_MM_S * age / p.memory_mm)) / p.direct
    scale, slope, towards = rest * np.exp(-psi), impulse * p.direct, np.abs(free)
    y = np.minimum(np.arcsinh(towards / scale), towards / np.maximum(slope, 1e-200))  # no contact, no slope
    for _ in range(N_NEWTON):
        grown = np.exp(y)
        sinh, cosh = 0.5 * scale * (grown - 1 / grown), 0.5 * scale * (grown + 1 / grown)
        y = y - (sinh + slope * y - towards) / (cosh + slope)
    return np.asarray(np.sign(free) * np.maximum(towards - slope * y, 0.0))
