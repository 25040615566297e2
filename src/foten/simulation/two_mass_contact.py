"""Textures of other physics: profiles by other laws, a tool of two masses in a compliant hand, friction with a memory.

A model that was tuned on `contact_mechanics` is judged here, which shares the strokes, the ball and the sensors alone. The
profile is fractional Brownian noise, filtered Poisson grains and uneven threads, in slow waves. The tip m₁ touches, the body m₂
carries the sensor, the hand's mass m₃ presses with the force P by the springs and dampers N and H. The tip slides at V:

    F = max(0, K (δ^1.5 + 1.5 τ √δ dδ/dt))      Kuwabara & Kono, Japanese Journal of Applied Physics 26 (1987)
    m₁ z̈₁ = F − N,  m₂ z̈₂ = N − H,  m₃ z̈₃ = H − P
    μ = a asinh(V / 2V₀ · exp((μ₀ + b ln(V₀ θ / d)) / a)),  dθ/dt = 1 − V θ / d      Dieterich (1979), Ruina (1983)

Where b > a the contact sticks and slips; the regularised form is that of Rice & Ben-Zion (1996). Not fitted to any surface.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

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
from foten.simulation.linear_family import NOT_NEGATIVE, POSITIVE, check_parameters
from foten.simulation.stroking import Stroking

MAX_IMPACT_N = 40.0  # of an impact, for which steps must be short enough
LONGEST_MM = 40.0  # wavelength of the noise
REFERENCE_MM_S = 1.0  # V₀ of the friction
N_NEWTON = 6  # steps of Newton's method: it begins on the side from which it converges without a swing
RANGES: Mapping[str, tuple[float, float]] = {
    "roughness_um": NOT_NEGATIVE,
    "hurst": (-0.5, 1.0),
    "grains_per_mm": (0.0, 1 / GRID_MM),
    "grain_shape": (0.1, 20.0),
    "grain_mm": (4 * GRID_MM, 5.0),
    "thread_mm": (10 * GRID_MM, 100.0),
    "thread_um": NOT_NEGATIVE,
    "thread_spread": (0.0, 1.0),
    "defects_per_mm": (0.0, 10.0),
    "wave_mm": (0.5, 100.0),
    "wave_nepers": (0.0, 3.0),
    "wave_spread": (0.0, 1.0),
    "tip_mm": (1e-3, 10.0),
    "modulus_mpa": POSITIVE,
    "relaxation_ms": NOT_NEGATIVE,
    "tip_g": POSITIVE,
    "body_g": POSITIVE,
    "hand_g": POSITIVE,
    "neck_hz": POSITIVE,
    "flesh_hz": POSITIVE,
    "shaft_hz": POSITIVE,
    "friction": NOT_NEGATIVE,
    "direct": (1e-4, 1.0),
    "evolution": (0.0, 1.0),
    "memory_mm": (1e-4, 10.0),
}
"""Lowest and highest value of a texture's parameters."""


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


# fmt: off
TWO_MASS: Mapping[str, TwoMassParameters] = {
    key: TwoMassParameters(*row) for key, row in {
        #   description,
        #       roughness, hurst,  grains a mm, height, shape, length,  thread, height, spread, defects,  wave, nepers, spread,
        #       tip, modulus, relaxation,  masses of tip, body and hand,  neck, flesh, shaft, each with its damping,
        #       friction, direct, evolution, memory
        "sandstone": ("fractional Brownian, persistent, hard",
                14.0, 0.55,  0.0, 1.0, 1.0, 0.1,  1.0, 0.0, 0.0, 0.0,  5.0, 0.0, 0.0,
                0.6, 600.0, 0.02,  5.0, 45.0, 250.0,  210.0, 0.06, 32.0, 0.45, 260.0, 0.10,
                0.45, 0.012, 0.008, 0.02),
        "glitter-paper": ("grains in a Poisson process, few of them high, on a smooth ground",
                2.0, 0.5,  1.6, 9.0, 0.8, 0.18,  1.0, 0.0, 0.0, 0.0,  5.0, 0.0, 0.0,
                0.6, 500.0, 0.03,  6.0, 50.0, 250.0,  180.0, 0.08, 28.0, 0.50, 230.0, 0.12,
                0.40, 0.012, 0.008, 0.02),
        "linen": ("threads of 0.7 mm, uneven, with thick and missing ones",
                3.0, 0.4,  0.0, 1.0, 1.0, 0.1,  0.7, 16.0, 0.10, 0.05,  5.0, 0.0, 0.0,
                0.8, 40.0, 0.10,  7.0, 60.0, 300.0,  150.0, 0.10, 25.0, 0.60, 190.0, 0.15,
                0.45, 0.015, 0.010, 0.05),
        "ring-porous-wood": ("fibres and pits that swell and fade with the growth rings, every 3.5 mm or so",
                6.0, 0.35,  1.5, -10.0, 1.0, 0.15,  1.0, 0.0, 0.0, 0.0,  3.5, 0.75, 0.25,
                0.7, 250.0, 0.04,  6.0, 55.0, 280.0,  170.0, 0.08, 30.0, 0.50, 220.0, 0.12,
                0.35, 0.012, 0.009, 0.03),
        "varnish": ("smooth and tacky: it sticks and slips by rate and state where the hand is slow",
                2.5, 0.6,  0.0, 1.0, 1.0, 0.1,  1.0, 0.0, 0.0, 0.0,  9.0, 0.3, 0.3,
                0.9, 20.0, 0.20,  8.0, 60.0, 300.0,  130.0, 0.12, 22.0, 0.60, 75.0, 0.05,
                0.70, 0.020, 0.045, 0.01),
        "slate": ("fractional Brownian, rough in the small, hard and ringing",
                7.0, 0.25,  0.0, 1.0, 1.0, 0.1,  1.0, 0.0, 0.0, 0.0,  12.0, 0.25, 0.4,
                0.5, 900.0, 0.015,  5.5, 40.0, 220.0,  250.0, 0.05, 35.0, 0.40, 300.0, 0.08,
                0.35, 0.010, 0.006, 0.01),
        "roughcast": ("dense grains of exponential height",
                3.0, 0.5,  3.5, 12.0, 1.0, 0.30,  1.0, 0.0, 0.0, 0.0,  5.0, 0.0, 0.0,
                1.0, 400.0, 0.03,  7.0, 70.0, 320.0,  160.0, 0.07, 24.0, 0.55, 200.0, 0.10,
                0.55, 0.014, 0.009, 0.03),
        "window-screen": ("wires of 1.5 mm, even, some bent or broken",
                1.0, 0.5,  0.0, 1.0, 1.0, 0.1,  1.5, 30.0, 0.04, 0.03,  5.0, 0.0, 0.0,
                0.8, 300.0, 0.03,  6.5, 50.0, 260.0,  190.0, 0.07, 30.0, 0.50, 240.0, 0.10,
                0.30, 0.010, 0.006, 0.01),
        "planed-board": ("grain under the marks of a planer, waves of 7 mm that come and go",
                9.0, 0.45,  0.8, -8.0, 0.7, 0.25,  1.0, 0.0, 0.0, 0.0,  7.0, 0.6, 0.35,
                0.7, 350.0, 0.03,  5.5, 48.0, 260.0,  220.0, 0.07, 28.0, 0.45, 250.0, 0.10,
                0.40, 0.012, 0.008, 0.02),
        "soft-pvc": ("a skin that clings: rate and state, with a finer grain",
                3.0, 0.4,  0.5, 6.0, 1.0, 0.40,  1.0, 0.0, 0.0, 0.0,  6.0, 0.2, 0.3,
                0.8, 30.0, 0.15,  7.0, 55.0, 280.0,  140.0, 0.10, 26.0, 0.55, 95.0, 0.06,
                0.60, 0.018, 0.036, 0.008),
        "denim": ("twill of 0.9 mm, uneven, fibrous, pulled in places",
                4.0, 0.3,  0.0, 1.0, 1.0, 0.1,  0.9, 22.0, 0.15, 0.06,  8.0, 0.3, 0.4,
                0.7, 60.0, 0.08,  6.0, 52.0, 280.0,  165.0, 0.09, 27.0, 0.55, 205.0, 0.12,
                0.50, 0.014, 0.010, 0.04),
        "latex": ("a glove that clings: rate and state, hardly rough",
                2.0, 0.5,  0.3, 4.0, 1.0, 0.30,  1.0, 0.0, 0.0, 0.0,  7.0, 0.3, 0.4,
                0.8, 25.0, 0.18,  7.5, 58.0, 290.0,  145.0, 0.11, 24.0, 0.60, 85.0, 0.06,
                0.75, 0.020, 0.042, 0.012),
        "spruce": ("growth rings of 2.2 mm, early wood smooth, late wood hard",
                8.0, 0.5,  0.6, -6.0, 0.8, 0.20,  1.0, 0.0, 0.0, 0.0,  2.2, 0.9, 0.3,
                0.6, 180.0, 0.04,  5.5, 46.0, 260.0,  195.0, 0.07, 31.0, 0.50, 235.0, 0.10,
                0.38, 0.012, 0.008, 0.02),
        "bark": ("soft, with deep pits that crowd and thin out",
                5.0, 0.45,  1.2, -25.0, 0.6, 0.50,  1.0, 0.0, 0.0, 0.0,  4.0, 0.6, 0.4,
                0.8, 30.0, 0.10,  6.5, 54.0, 290.0,  155.0, 0.10, 26.0, 0.55, 195.0, 0.13,
                0.50, 0.014, 0.010, 0.05),
        "pumice": ("hard walls of bubbles of all sizes",
                8.0, 0.4,  2.0, -30.0, 0.7, 0.35,  1.0, 0.0, 0.0, 0.0,  3.0, 0.5, 0.5,
                0.6, 450.0, 0.03,  5.5, 47.0, 250.0,  205.0, 0.07, 29.0, 0.50, 245.0, 0.10,
                0.50, 0.012, 0.008, 0.02),
    }.items()
}
# fmt: on


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
    """Vibrations of the tool's body before any sensor [m/s²], axes x, y, z, (n, 3), and the contact's force [N], (n,).

    Of realisations of a stroke; as at rest where they are not `needed`, (n,). The surface is what the ball rests at, as of
    `two_mass_surface`.
    """
    rate = stroke.rate_hz

    def integrate(places: Array, speed: Array, force: Array) -> Array:
        return _integrate(parameters, surface, places, speed, force, rate)

    return [
        (
            np.column_stack([tangential[:, None] * DIRECTION, normal]),
            force if needed is None else np.where(needed, force, stroke.force),
        )
        for normal, tangential, force in joined_pieces(integrate, places_along(stroke, rngs), stroke, needed)
    ]


def _integrate(
    parameters: TwoMassParameters, surface: Array, place: Array, speed: Array, force: Array, rate_hz: float
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
