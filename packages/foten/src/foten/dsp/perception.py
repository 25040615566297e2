"""What a person can feel of a vibration: frequencies, levels, and the share of its power that a sampling rate keeps."""

from collections.abc import Mapping
from statistics import NormalDist

import numpy as np

from foten.dsp import Array
from foten.dsp.distance import MAX_SCORED_HZ, MIN_SCORED_HZ

BEST_FREQUENCY_HZ = 250.0
USABLE_BAND = 0.45  # of a rate
RATES_HZ = (1000.0, 2500.0, 10_000.0)
LEVEL_JND_DB = 2.3  # just noticeable difference 20 to 35 dB above threshold: 2.2 to 2.5 dB (Israr & Tan, 2006)
JND_CORRECT = 0.75  # share of pairs in which the stronger of two intervals is named, where they differ by that
THRESHOLD_M_S2 = 0.03  # RMS of a vibration that is just felt through a held tool, up to 250 Hz


def sensitivity(hertz: Array) -> Array:
    """Weight of acceleration power at frequencies [Hz] (k,): the inverse square of the threshold, 1 up to 250 Hz.

    The displacement threshold falls by 12 dB per octave from 40 Hz to 250 Hz, so that of acceleration is flat there. Above, it is
    taken to rise by the same 12 dB: 24 dB per octave of acceleration. Below 40 Hz, much of which is the hand's movement, the
    weight is 1 too; outside 20 to 1000 Hz 0. Source: Verrillo, J. Acoust. Soc. Am. 35 (1963), large contactors; above 250 Hz
    ours.
    """
    steep = np.minimum(BEST_FREQUENCY_HZ / np.maximum(hertz, 1e-9), 1.0) ** 8
    return np.where((hertz >= MIN_SCORED_HZ) & (hertz <= MAX_SCORED_HZ), steep, 0.0)


def band_thresholds(edges: Array) -> Array:
    """Mean squares [(m/s²)²] of vibrations that are just felt in bands between edges [Hz] (k + 1,): shape (k,).

    Of a tool held in the hand, at the middle of each band on a logarithmic scale: of a grasped cylinder lowest from 150 to 200
    Hz, some hundredths of a micrometre; 0.03 µm are 0.03 m/s². With a probe of 1 mm on the skin they are higher by 10 to 18 dB.
    Source: Brisben, Hsiao & Johnson, J. Neurophysiol. 81 (1999); that they are equal up to 250 Hz is `sensitivity`'s.
    """
    return np.asarray(THRESHOLD_M_S2**2 / sensitivity(np.sqrt(edges[1:] * edges[:-1])))


def internal_noise_db(n_bands: int) -> float:
    """Standard deviation of the internal noise of each band's level, and of that which all bands have in common [dB].

    With sd s of a band's own and c of the common noise, whoever weighs n bands at best has for a step of D in one of them
    d'² = D² (1/s² − c² / (s² (s² + n c²))), and for a step in all d'² = n D² / (s² + n c²). Both are d'² of the just noticeable
    difference where s² = c² = (D/d')² n / (n + 1).
    """
    d_prime = np.sqrt(2.0) * NormalDist().inv_cdf(JND_CORRECT)
    return float(LEVEL_JND_DB / d_prime * np.sqrt(n_bands / (n_bands + 1)))


def carried(densities: Mapping[str, tuple[Array, Array]], rate_hz: float) -> dict[float, float]:
    """Share of the perceived power, 0 to 1, that `RATES_HZ` up to the captured `rate_hz` keep, and `rate_hz`; {} of silence.

    `densities` are the frequencies [Hz] (k,) and power densities (k,) of each axis.
    """
    weighted = [(hertz, density * sensitivity(hertz)) for hertz, density in densities.values()]

    def power(highest_hz: float) -> float:
        below = [(hertz, density * (hertz <= highest_hz)) for hertz, density in weighted]
        return sum(float(0.5 * (density[1:] + density[:-1]) @ np.diff(hertz)) for hertz, density in below)

    total, rates = power(np.inf), {*(rate for rate in RATES_HZ if rate <= rate_hz), rate_hz}
    return {rate: power(USABLE_BAND * rate) / total for rate in sorted(rates)} if total > 0 else {}


def smallest_rate(shares: Mapping[float, float]) -> float:
    """Lowest rate that carries 95 % of what the highest carries [Hz]."""
    return min(rate for rate, share in shares.items() if share >= 0.95 * max(shares.values()))


def in_words(shares: Mapping[float, float]) -> str:
    """Shares as a clause: "1 kHz carries 81 %, 2.5 kHz 99 %"."""
    texts = [f"{rate / 1000:g} kHz {100 * share:.3g} %" for rate, share in shares.items()]
    return ", ".join(texts).replace(" kHz ", " kHz carries ", 1)
