"""Textures whose best possible prediction is known: autoregressions scaled by speed and force."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from foten.dsp import Array
from foten.recording.recording import Recording
from foten.simulation.parameters import POSITIVE, check_parameters

REFERENCE_SPEED = 100.0  # mm/s
BURN_IN = 4000  # samples; a pole of radius 0.99 has decayed to 1e-17


def from_poles(*poles: tuple[float, float]) -> tuple[float, ...]:
    """Coefficients a of y[n] = Σ aᵢ y[n-i] for conjugate pole pairs of (angle in cycles a sample, radius)."""
    roots = [radius * np.exp(2j * np.pi * sign * angle) for angle, radius in poles for sign in (1, -1)]
    return tuple((-np.poly(roots).real[1:]).tolist())


@dataclass(frozen=True)
class LinearParameters:
    """What defines one member of the linear family.

    y[n] = Σ aᵢ y[n-i] + σ(v, f) e[n], e standard normal, with
    σ = level (standstill_share + v / 100 mm/s)^speed_exponent (f / 1 N)^force_exponent.
    """

    description: str
    coefficients: tuple[float, ...]  # a₁ … a_p, for each sample whatever the rate
    level: float  # σ at 100 mm/s and 1 N [m/s²], but for the share at standstill
    speed_exponent: float = 0.8
    force_exponent: float = 0.4
    standstill_share: float = 0.01  # added to the speed, in reference speeds, so that σ is never zero

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", tuple(self.coefficients))
        check_parameters(self, {"level": POSITIVE, "standstill_share": POSITIVE})
        radius = np.abs(np.roots(self.denominator)).max()
        if not radius < 0.995:
            raise ValueError(f"the largest pole has radius {radius:.4f}, expected less than 0.995")

    @property
    def denominator(self) -> Array:
        """A(z) = 1 − Σ aᵢ z⁻ⁱ, shape (p + 1,)."""
        return np.array([1.0, *(-a for a in self.coefficients)])

    def sigma(self, speed: Array, force: Array) -> Array:
        """Standard deviation of the innovation [m/s²] at speeds [mm/s] and forces [N]."""
        stroked = self.standstill_share + np.maximum(speed, 0) / REFERENCE_SPEED
        return self.level * stroked**self.speed_exponent * np.maximum(force, 0) ** self.force_exponent


# fmt: off
_MEMBERS: Mapping[str, LinearParameters] = {
    key: LinearParameters(description, from_poles(*poles), *numbers) for key, description, poles, *numbers in (
        #   key, description, pole pairs, level, speed and force exponent
        ("linear-hum", "AR(2), one resonance at 80 Hz (at 1 kHz)", [(0.08, 0.95)], 0.25),
        ("linear-twin", "AR(4), two narrow peaks at 120 and 300 Hz", [(0.12, 0.985), (0.3, 0.98)], 0.3),
        ("linear-cloth", "AR(8), broadband, four weak resonances",
                [(0.06, 0.6), (0.17, 0.75), (0.27, 0.8), (0.4, 0.7)], 0.6),
        ("linear-drone", "AR(4), a low resonance at 45 Hz and a weak one at 210 Hz",
                [(0.045, 0.93), (0.21, 0.85)], 0.35, 0.6, 0.5),
        ("linear-hiss", "AR(6), broadband, rising to 350 Hz", [(0.09, 0.5), (0.24, 0.7), (0.35, 0.86)], 0.7, 1.0, 0.3),
        ("linear-bell", "AR(6), three narrow peaks at 70, 165 and 280 Hz",
                [(0.07, 0.97), (0.165, 0.975), (0.28, 0.97)], 0.2, 0.9, 0.4),
    )
}
# fmt: on
LINEAR_FAMILY = dict(list(_MEMBERS.items())[:3])
OTHER_LINEAR = dict(list(_MEMBERS.items())[3:])  # reported by no published table


def linear_signal(parameters: LinearParameters, speed: Array, force: Array, rng: np.random.Generator) -> Array:
    """One realisation y [m/s²], shape (n,), already stationary at its first sample."""
    from scipy.signal import lfilter

    sigma = parameters.sigma(speed, force)
    scale = np.concatenate([np.full(BURN_IN, sigma[0]), sigma])
    return lfilter([1.0], parameters.denominator, scale * rng.standard_normal(scale.size))[BURN_IN:]


def linear_truth(recording: Recording) -> LinearParameters:
    """Process that made a simulated recording, at its rate; ValueError where it is no member of the linear family."""
    simulation = recording.simulation
    if simulation is None or "coefficients" not in simulation["parameters"]:
        source = "no simulator" if simulation is None else f"the texture {simulation['key']!r}"
        raise ValueError(f"the truth is known for {', '.join(LINEAR_FAMILY)}; this recording comes from {source}")
    return LinearParameters(**simulation["parameters"])


def one_step_bounds(
    truth: LinearParameters, speed: Array, force: Array, highpass_b: Array, highpass_a: Array, window: int
) -> tuple[Array, Array]:
    """Least expected absolute one-step errors [m/s²] of the high-passed signal, from its infinite past and from a window.

    The high-passed signal is x = B(z) / (A_h(z) A(z)) σe. Its zeros lie on the unit circle at worst, so the whole past
    predicts all of x[n] but b₀ σ e[n], however σ varies. A window of m leaves s_m > b₀, the residual of the best linear
    predictor of m samples, for a σ that is constant over the window; that of a stroke costs 0.1 to 0.4 % (six seeds).

    Speed [mm/s] and force [N] are at the predicted samples, (n,), as both errors are; the high-pass, b and a with a₀ = 1, is that
    of preprocessing. ValueError where it is not minimum-phase or not stable.
    """
    from scipy.linalg import solve_toeplitz
    from scipy.signal import lfilter

    if np.abs(np.roots(highpass_b)).max(initial=0) > 1 + 1e-4:  # 1e-4: a double root computed to 1e-8
        raise ValueError("the high-pass has a zero outside the unit circle, expected minimum phase")
    # The autocovariance is that of the impulse response, cut off where its square has fallen to 1e-18.
    denominator = np.convolve(truth.denominator, highpass_a)
    radius = np.abs(np.roots(denominator)).max()
    if radius >= 1:
        raise ValueError("the high-pass is not stable")
    impulse = np.zeros(window + 64 + int(np.log(1e-9) / np.log(radius)) * 2)
    impulse[0] = 1
    response = lfilter(highpass_b, denominator, impulse)
    r = np.array([response[: response.size - lag] @ response[lag:] for lag in range(window + 1)])
    s_m = float(np.sqrt(r[0] - solve_toeplitz(r[:-1], r[1:]) @ r[1:]))
    mean_absolute = np.sqrt(2 / np.pi) * truth.sigma(speed, force)  # of a normal innovation
    return abs(float(highpass_b[0])) * mean_absolute, s_m * mean_absolute
