"""Free-run scores: what is synthesized under a recorded hand, against what was recorded."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp.noise import gaussian
from foten.evaluate import metrics
from foten.evaluate.bootstrap import intervals
from foten.evaluate.references import Linear
from foten.recording.scaling import Scaling
from foten.recording.trace import Trace
from foten.runtime.loops import on_all_cores
from foten.runtime.native import NativeState, NativeTexture

Array = NDArray[np.float64]

N_SEEDS = 5
SETTLING = 0.2  # of each block, not scored


def scored(block: int) -> slice:
    """Return the scored part of a block: all but the first fifth, in which the loop settles."""
    return slice(round(SETTLING * block), None)


def synthesize(
    texture: NativeTexture,
    trace: Trace,
    blocks: tuple[int, ...],
    excitation: bool,
    seed: int = 0,
    n_seeds: int = N_SEEDS,
) -> tuple[Array, int]:
    """Return the free run under recorded speed and force, and how often the saturator cut it.

    Rendered as for a user, by the kernel; each block goes on from its own recorded window.

    Returns:
        Acceleration [m/s²], shape (n_seeds, n_blocks, block); without excitation n_seeds is 1.
    """
    n_seeds, m = n_seeds if excitation else 1, texture.info.window
    channels = [trace.blocks(c)[list(blocks)] for c in (trace.acceleration, trace.speed, trace.force)]
    rendered = np.empty((n_seeds * len(blocks), trace.block - m))
    n_saturated = np.zeros(len(rendered), dtype=np.int64)

    def render(stream: int) -> None:
        acceleration, speed, force = (channel[stream % len(blocks)] for channel in channels)
        state = NativeState(texture, seed=seed, stream=stream, excitation=excitation)
        state.start(acceleration[:m], speed[:m], force[:m])
        rendered[stream] = state.render_stroke(speed[m:], force[m:])
        n_saturated[stream] = state.statistics.n_saturated

    on_all_cores(render, len(rendered))
    return _after_recorded(trace, blocks, m, rendered), int(n_saturated.sum())


def synthesize_linear(
    predictor: Linear, trace: Trace, blocks: tuple[int, ...], scaling: Scaling, seed: int = 0, n_seeds: int = N_SEEDS
) -> Array:
    """Return the free run of a linear predictor with white noise of one scale: the anchor to beat.

    The filter 1/A, started from the recorded window of each block.

    Returns:
        Acceleration [m/s²], shape (n_seeds, n_blocks, block).
    """
    from scipy.signal import lfilter, lfiltic

    stable = predictor.stable()
    m, n = stable.window, trace.block - stable.window
    constant, a = stable.coefficients[-1], np.append(1.0, -stable.coefficients[-2::-1])
    recorded = scaling.scale(trace.stacked())[:, 0].reshape(-1, trace.block)[list(blocks)]
    initial = [lfiltic([1.0], a, block[m - 1 :: -1]) for block in recorded[:, :m]]
    rendered = [
        lfilter([1.0], a, constant + stable.noise_sd * gaussian(seed, stream, 0, n), zi=initial[stream % len(blocks)])[
            0
        ]
        for stream in range(n_seeds * len(blocks))
    ]
    return _after_recorded(trace, blocks, m, scaling.unscale_acceleration(np.array(rendered)))


def _after_recorded(trace: Trace, blocks: tuple[int, ...], m: int, rendered: Array) -> Array:
    """Return whole blocks (n_seeds, n_blocks, block): recorded windows of m, and the streams that went on from them."""
    by_seed = rendered.reshape(-1, len(blocks), rendered.shape[1])
    recorded = trace.blocks(trace.acceleration)[list(blocks), :m]
    return np.concatenate([np.broadcast_to(recorded, (len(by_seed), *recorded.shape)), by_seed], axis=2)


def nearest_training_blocks(trace: Trace, blocks: tuple[int, ...], train: tuple[int, ...]) -> Array:
    """Return for each block the recorded one of the training blocks nearest in mean speed and force, (1, n_blocks, block).

    Distances are in standard deviations of the training blocks' samples.
    """
    means = np.stack([trace.blocks(trace.speed).mean(axis=1), trace.blocks(trace.force).mean(axis=1)], axis=1)
    spread = np.array([trace.blocks(c)[list(train)].std() for c in (trace.speed, trace.force)])
    spread = np.where(spread > 0, spread, 1.0)
    distance = np.linalg.norm((means[list(blocks), None] - means[None, list(train)]) / spread, axis=2)
    nearest = np.array(train)[distance.argmin(axis=1)]
    return trace.blocks(trace.acceleration)[nearest][None]


def free_run(
    recorded: Array, synthesized: Array, speed: Array, force: Array, rate_hz: float, sd: float, n_given: int = 0
) -> dict[str, Any]:
    """Return the free-run figures of synthesized blocks beside recorded ones.

    Args:
        recorded: [m/s²], shape (n_blocks, block), whole blocks; the first fifth of each is not scored.
        synthesized: [m/s²], shape (n_seeds, n_blocks, block).
        speed: [mm/s], shape (n_blocks, block); force: [N], likewise.
        rate_hz: samples a second.
        sd: training standard deviation of the acceleration [m/s²].
        n_given: samples at the start of each synthesized block that are the recorded window it started from.

    Returns:
        `lsd_db`: log-spectral distance, mean over blocks and seeds; `lsd_long_db`: the same on spectra pooled over all
        of them; `gfc_raw`, `gfc_welch`: Eq. 13 on raw and on Welch amplitudes, means; `level_bias_db`,
        `level_error_db`, `level_corr`: of levels in frames of 40 ms; `kurtosis` of all samples, and `kurtosis_recorded`;
        `max_sd`: largest synthesized sample over `sd`, the first fifth included; `band_errors_db`; `level_slopes` and
        `level_slopes_recorded` [dB per decade of speed, of force]; `modulation_db`: distance of envelope spectra, 2 to 50 Hz;
        `intervals`.
    """
    n_segment = metrics.segment_length(recorded.shape[-1])
    part = scored(recorded.shape[-1])
    worst = np.abs(synthesized[:, :, n_given:]).max(axis=(0, 2)) / sd
    recorded, synthesized, speed, force = (recorded[:, part], synthesized[:, :, part], speed[:, part], force[:, part])
    frequencies, p = metrics.welch(recorded, rate_hz, n_segment)
    _, q = metrics.welch(synthesized, rate_hz, n_segment)
    bins = metrics.scored_bins(frequencies, rate_hz)
    p, q = p[:, bins], q[:, :, bins]
    reference = float(np.sqrt(np.square(recorded).mean()))
    level_p = metrics.frame_levels(recorded, rate_hz, reference)
    level_q = metrics.frame_levels(synthesized, rate_hz, reference)
    distance = metrics.log_spectral_distance(p[None], q)
    raw = np.array([[metrics.goodness_of_fit(a, b) for a, b in zip(recorded, run, strict=True)] for run in synthesized])
    smooth = np.array([[metrics._cosine(np.sqrt(a), np.sqrt(b)) for a, b in zip(p, run, strict=True)] for run in q])

    frame_speed, frame_force = metrics.frame_means(speed, rate_hz), metrics.frame_means(force, rate_hz)
    envelope_p = metrics.modulation_spectra(recorded, rate_hz)
    envelope_q = metrics.modulation_spectra(synthesized, rate_hz)

    moments = np.stack([np.power(synthesized, k).mean(axis=(0, 2)) for k in range(1, 5)])

    def figures(index: NDArray[np.int64]) -> dict[str, Any]:
        difference = level_q[:, index] - level_p[index]
        framed = difference.size > 0
        pooled = metrics.log_spectral_distance(p[index].mean(axis=0), q[:, index].mean(axis=(0, 1)))
        return {
            "lsd_db": float(distance[:, index].mean()),
            "lsd_long_db": float(pooled),
            "gfc_raw": float(raw[:, index].mean()),
            "gfc_welch": float(smooth[:, index].mean()),
            "level_bias_db": float(difference.mean()) if framed else None,
            "level_error_db": float(np.abs(difference).mean()) if framed else None,
            "level_corr": _correlation(level_p[index], level_q[:, index]) if framed else None,
            "kurtosis": _kurtosis(moments[:, index].mean(axis=1)),
            "max_sd": float(worst[index].max()),
            "band_errors_db": metrics.band_errors(
                p[index].mean(axis=0), q[:, index].mean(axis=(0, 1)), frequencies[bins], rate_hz
            ),
            "level_slopes": metrics.level_slopes(
                level_q[:, index].mean(axis=0), frame_speed[index], frame_force[index]
            ),
            "modulation_db": None
            if envelope_p is None or envelope_q is None
            else float(
                metrics.log_spectral_distance(
                    envelope_p[1][index].mean(axis=0), envelope_q[1][:, index].mean(axis=(0, 1))
                )
            ),
        }

    every = np.arange(len(recorded))
    return {
        **figures(every),
        "kurtosis_recorded": metrics.kurtosis(recorded),
        "level_slopes_recorded": metrics.level_slopes(level_p, frame_speed, frame_force),
        "intervals": intervals(figures, len(recorded)),
    }


def _kurtosis(moments: Array) -> float:
    """Return Pearson's kurtosis from the means of a signal's first to fourth powers, shape (4,); 0 for silence."""
    mean, second, third, fourth = (float(moment) for moment in moments)
    variance = second - mean**2
    central = fourth - 4 * mean * third + 6 * mean**2 * second - 3 * mean**4
    return central / variance**2 if variance > 0 else 0.0


def _correlation(recorded: Array, synthesized: Array) -> float | None:
    """Return Pearson's correlation of frame levels over all frames, mean over seeds; None where one does not vary."""
    a = recorded.ravel() - recorded.mean()
    values = []
    for run in synthesized:
        b = run.ravel() - run.mean()
        norm = np.sqrt((a @ a) * (b @ b))
        if norm <= 1e-9 * a.size:
            return None
        values.append(float(a @ b / norm))
    return float(np.mean(values))
