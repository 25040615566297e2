"""Free-run scores: what is synthesized under recorded speed and force, against what was recorded."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.distance import earth_mover_octaves, log_spectral_distance, scored_bins, segment_length, welch
from foten.dsp.level import band_energies, frame_levels, rms
from foten.dsp.noise import gaussian
from foten.dsp.perception import LEVEL_JND_DB
from foten.evaluate import metrics
from foten.evaluate.one_step import Linear
from foten.models.foten_plus.recorded_innovations import neighbourhoods
from foten.recording.scaling import Scaling
from foten.recording.split import Split
from foten.recording.trace import Trace
from foten.runtime.loops import render_strokes
from foten.runtime.native import NativeTexture

N_SEEDS = 5
SETTLING = 0.2  # of each block, not scored


def scored(block: int, window: int = 0) -> slice:
    """Scored part of a block: all but the first fifth, in which the loop settles, and the recorded window that it starts from."""
    return slice(max(round(SETTLING * block), window), None)


def synthesize(
    texture: NativeTexture,
    trace: Trace,
    blocks: tuple[int, ...],
    excitation: bool,
    seed: int = 0,
    n_seeds: int = N_SEEDS,
    split: Split | None = None,
) -> tuple[Array, int]:
    """Free run under recorded speed and force [m/s²], (n_seeds, n_blocks, block), and how many samples the saturator cut.

    Rendered by the kernel; each block goes on from its own recorded window. Without excitation n_seeds is 1. With the `split` of
    the recording that was learned from, no innovations are played that were recorded within a second of a block.
    """
    m, channels = texture.info.window, trace.picked(blocks)
    _, speed, force = repeated = [np.tile(channel, (n_seeds if excitation else 1, 1)) for channel in channels]
    windows = [channel[:, :m] for channel in repeated]
    excluded = neighbourhoods(split, trace, blocks, n_seeds if excitation else 1)
    rendered, n_saturated = render_strokes(texture, seed, speed[:, m:], force[:, m:], 0, windows, excitation, excluded)
    return _after_recorded(channels[0][:, :m], rendered), n_saturated


def synthesize_linear(
    predictor: Linear, trace: Trace, blocks: tuple[int, ...], scaling: Scaling, seed: int = 0, n_seeds: int = N_SEEDS
) -> Array:
    """Free run of a linear predictor [m/s²], (n_seeds, n_blocks, block), from recorded windows: white noise through 1/A."""
    from scipy.signal import lfilter, lfiltic

    stable = predictor.stable()
    m, n = stable.window, trace.block - stable.window
    constant, a = stable.coefficients[-1], np.append(1.0, -stable.coefficients[-2::-1])
    history = trace.picked(blocks)[0][:, :m]
    initial = [lfiltic([1.0], a, window[::-1]) for window in scaling.scale_channel(0, history)]
    driven = [constant + stable.noise_sd * gaussian(seed, stream, 0, n) for stream in range(n_seeds * len(blocks))]
    rendered = [lfilter([1.0], a, x, zi=zi)[0] for x, zi in zip(driven, initial * n_seeds, strict=True)]
    return _after_recorded(history, scaling.unscale_acceleration(np.array(rendered)))


def _after_recorded(history: Array, rendered: Array) -> Array:
    """Whole blocks (n_seeds, n_blocks, block): recorded windows (n_blocks, m), then what went on from them."""
    by_seed = rendered.reshape(-1, len(history), rendered.shape[1])
    return np.concatenate([np.broadcast_to(history, (len(by_seed), *history.shape)), by_seed], axis=2)


def nearest_training_blocks(trace: Trace, blocks: tuple[int, ...], train: tuple[int, ...]) -> Array:
    """Acceleration of the training block nearest to each in mean speed and force, by their deviations: (1, n_blocks, block)."""
    _, *judged = trace.picked(blocks)
    acceleration, *known = trace.picked(train)
    distance = np.zeros((len(blocks), len(train)))
    for tested, trained in zip(judged, known, strict=True):
        distance += np.square(np.subtract.outer(tested.mean(axis=1), trained.mean(axis=1)) / (trained.std() or 1.0))
    return acceleration[distance.argmin(axis=1)][None]


def free_run(
    recorded: Array, synthesized: Array, rate_hz: float, sd: float, n_history: int = 0, window: int = 0
) -> dict[str, Any]:
    """Free-run figures of synthesized blocks beside recorded ones, as `report/figures.csv` explains them, and a few more.

    Args:
        recorded: [m/s²], shape (n_blocks, block), whole blocks, of which the part of `scored` counts.
        synthesized: [m/s²], shape (n_seeds, n_blocks, block).
        sd: training standard deviation of the acceleration [m/s²].
        n_history: samples at the start of each synthesized block that are the recorded window it started from.
        window: the longest of these of all runs that are compared.

    Returns:
        Also `band_errors_db`; `level_jnd`, the level error in just noticeable differences; `mae_scaled`, of the waveform in
        `sd`, and `mae_scaled_silence`; `kurtosis_recorded`; `intervals`. `max_sd` is of the first fifth too.
    """
    n_segment, part = segment_length(recorded.shape[-1]), scored(recorded.shape[-1], window)
    worst = np.abs(synthesized[:, :, n_history:]).max(axis=(0, 2)) / sd
    recorded, synthesized = recorded[..., part], synthesized[..., part]
    frequencies, p = welch(recorded, rate_hz, n_segment)
    _, q = welch(synthesized, rate_hz, n_segment)
    bins = scored_bins(frequencies, rate_hz)
    p, q = p[:, bins], q[:, :, bins]
    distance, octaves = log_spectral_distance(p[None], q), earth_mover_octaves(frequencies[bins], p[None], q)
    level_p, level_q = (frame_levels(x, rate_hz, rms(recorded)) for x in (recorded, synthesized))
    raw, smooth = metrics.goodness_of_fit(recorded, synthesized), metrics.cosine(np.sqrt(p), np.sqrt(q))
    envelope_p, envelope_q = (metrics.modulation_spectra(x, rate_hz) for x in (recorded, synthesized))
    energy_p, energy_q = (band_energies(x, rate_hz) for x in (recorded, synthesized))
    moments = metrics.moments(synthesized).mean(axis=1)

    def figures(index: NDArray[np.int64]) -> dict[str, Any]:
        difference = level_q[:, index] - level_p[index]
        framed = difference.size > 0
        pooled_p, pooled_q = _pooled(p, q, index)
        modulation = None
        if envelope_p is not None and envelope_q is not None:
            modulation = float(log_spectral_distance(*_pooled(envelope_p[1], envelope_q[1], index)))
        return {
            "lsd_db": float(distance[:, index].mean()),
            "lsd_long_db": float(log_spectral_distance(pooled_p, pooled_q)),
            "gfc_raw": float(raw[:, index].mean()),
            "gfc_welch": float(smooth[:, index].mean()),
            "level_bias_db": float(difference.mean()) if framed else None,
            "level_error_db": float(np.abs(difference).mean()) if framed else None,
            "level_corr": _correlation(level_p[index], level_q[:, index]) if framed else None,
            "kurtosis": metrics.kurtosis(moments[:, index].mean(axis=1)),
            "band_errors_db": metrics.band_errors(pooled_p, pooled_q, frequencies[bins], metrics.band_edges(rate_hz)),
            "modulation_db": modulation,
            "emd_octaves": float(octaves[:, index].mean()),
            "mae_scaled": float(np.abs(synthesized[:, index] - recorded[index]).mean() / sd),
            "mae_scaled_silence": float(np.abs(recorded[index]).mean() / sd),
            "level_jnd": float(np.abs(difference).mean()) / LEVEL_JND_DB if framed else None,
            "band_correlation_error": _correlation_error(energy_p[index], energy_q[:, index]),
        }

    return {
        **metrics.with_intervals(figures, len(recorded)),
        "max_sd": float(worst.max()),
        "kurtosis_recorded": metrics.kurtosis(metrics.moments(recorded).mean(axis=1)),
    }


def _pooled(recorded: Array, synthesized: Array, index: NDArray[np.int64]) -> tuple[Array, Array]:
    """Mean spectra of some blocks: recorded (n_blocks, k), synthesized (n_seeds, n_blocks, k) → (k,) each."""
    return recorded[index].mean(axis=0), synthesized[:, index].mean(axis=(0, 1))


def _correlation_error(recorded: Array, synthesized: Array) -> float | None:
    """RMS difference of the correlations between bands, mean over seeds; None without two frames."""
    if recorded.shape[0] * recorded.shape[2] < 2:
        return None
    target = metrics.band_correlations(recorded)
    errors = [np.sqrt(np.square(metrics.band_correlations(run) - target).mean()) for run in synthesized]
    return float(np.mean(errors))


def _correlation(recorded: Array, synthesized: Array) -> float | None:
    """Pearson's correlation of frame levels over all frames, mean over seeds; None where one does not vary."""
    a, b = recorded.ravel() - recorded.mean(), synthesized.reshape(len(synthesized), -1)
    b = b - b.mean(axis=1, keepdims=True)
    norms = np.sqrt((a @ a) * np.square(b).sum(axis=1))
    return float((b @ a / norms).mean()) if norms.min() > 1e-9 * a.size else None
