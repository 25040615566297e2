"""A texture of a spectrum at one speed and force, and of the powers that its level follows elsewhere."""

from dataclasses import dataclass

import numpy as np

from foten.dsp import Array
from foten.dsp.noise import gaussian
from foten.dsp.speed_force_table import SpeedForceTable, log_force
from foten.editing.warp import N_BINS, reflections_for
from foten.models.definitions import FotenPlus
from foten.models.excitation import MAX_SIGMA, N_FEATURES, N_POWERS, Excitation, Scale
from foten.models.foten_plus.definition import lattice_tensors
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.stream import run
from foten.models.texture_file import Texture
from foten.recording.preprocess import PreprocessConfig
from foten.recording.scaling import Scaling
from foten.runtime.proof import Tensors, proved

ORDER = 40  # of the lattice
INNOVATION_LIMIT = 4.0  # standard deviations
SD = (60.0, 0.5)  # of speed [mm/s] and force [N]: units of the file, no more
FLOOR = (2.0, 0.05)  # mm/s and N, that a logarithm starts from
SATURATION = 12.0  # standard deviations
N_GOLDEN = 10  # windows
BELOW_DB_PER_OCTAVE = 12.0  # fall of a spectrum below its lowest band, and above its highest


@dataclass(frozen=True)
class Spectrum:
    """What a texture is made of."""

    hz: Array  # rising [Hz], (k,)
    density: Array  # (m/s²)²/Hz at the reference, (k,)
    speed_mm_s: float  # the reference
    force_n: float
    speed_exponent: float
    force_exponent: float


def texture_of_spectrum(spectrum: Spectrum, rate_hz: float, name: str, evidence: str) -> Texture:
    """A texture of foten-plus without tones and network, proved; its card says of what `evidence` it is made.

    Its trained range is the reference alone: elsewhere its level follows the powers, as `models.definitions.render` has it.
    """
    grid = np.linspace(0, rate_hz / 2, N_BINS + 1)
    density = interpolated(grid, spectrum)
    rms = float(np.sqrt(density.sum() * grid[1]))
    reflections = reflections_for(density[None], ORDER)
    scaling = Scaling(mean=(0.0, spectrum.speed_mm_s, spectrum.force_n), sd=(rms, *SD))
    table = SpeedForceTable(np.array([spectrum.speed_mm_s]), log_force(np.array([spectrum.force_n])), reflections)
    sizes = FotenPlusSizes(n_hidden=1, head_width=1, n_components=1, excitation_width=1, order=ORDER)
    one = _constant(scaling)
    tensors: Tensors = {**lattice_tensors("lattice.", one, table)}
    tensors |= Excitation(one, (INNOVATION_LIMIT, 1e3)).tensors()
    shapes = sizes.network_shapes()
    tensors |= {key: np.zeros([n or 1 for n in shape], dtype=np.float32) for key, shape in shapes.items()}
    windows = _windows(FotenPlus(sizes, tensors), sizes.history)
    preprocess = PreprocessConfig(rate_hz=rate_hz)
    condition = {"speed": spectrum.speed_mm_s, "force": spectrum.force_n}
    card = {
        "rate_hz": rate_hz,
        "trained_range": {channel: [value, value] for channel, value in condition.items()},
        "extrapolation_exponents": {"speed": spectrum.speed_exponent, "force": spectrum.force_exponent},
        "saturation": SATURATION,
        "lowpass_hz": preprocess.render_lowpass_hz,
        "delay_ms": preprocess.delay_ms,
        **dict.fromkeys(("tool", "sensors", "notes", "licence", "recording_sha256", "split_sha256"), ""),
        "texture": name,
        "evidence": evidence,
        "preprocess": vars(preprocess),
        "split": None,
        "training": {},
        "metrics": {},
        "warm_start": {"asked": condition, "recorded": condition},
    }
    return proved("foten-plus", sizes, tensors, scaling, windows[1:], windows[0], card).texture


def interpolated(grid: Array, spectrum: Spectrum) -> Array:
    """Density at frequencies [Hz], on straight lines of dB over octaves, falling by 12 dB an octave outside."""
    octave, known = np.log2(np.maximum(grid, 1e-3)), np.log2(spectrum.hz)
    level = np.interp(octave, known, 10 * np.log10(np.maximum(spectrum.density, 1e-30)))
    outside = np.maximum(0.0, known[0] - octave) + np.maximum(0.0, octave - known[-1])
    return np.asarray(10 ** ((level - BELOW_DB_PER_OCTAVE * outside) / 10))


def _constant(scaling: Scaling) -> Scale:
    """σ = 1 everywhere."""
    return Scale(
        hidden_weight=np.zeros((1, N_FEATURES)),
        hidden_bias=np.zeros(1),
        out_weight=np.zeros((1, 1)),
        out_bias=np.zeros(1),
        exponents=np.zeros(N_POWERS),
        sigma_max=np.array([MAX_SIGMA]),
        mean=np.array(scaling.mean[1:]),
        sd=np.array(scaling.sd[1:]),
        floor=np.array(FLOOR),
    )


def _windows(model: FotenPlus, history: int) -> Array:
    """Scaled windows of its own vibration at the reference, (1 + `N_GOLDEN`, history, 3)."""
    n, windows = 1 + N_GOLDEN, np.zeros((1 + N_GOLDEN, history, 3))
    stream = model.start(windows)
    noise = np.stack([gaussian(0, k, 0, stream.n_initial + history) for k in range(n)])
    stream.begin(windows[:, 0], noise[:, : stream.n_initial])
    vibration = run(stream, windows, noise[:, stream.n_initial :])
    return np.concatenate([vibration[..., None], np.zeros((n, history, 2))], axis=2)
