"""Signals of a judgement that the report shows: runs, blocks, levels, densities and sound."""

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.distance import MIN_SCORED_HZ, scored_bins, segment_length, welch
from foten.dsp.level import frame_levels, rms
from foten.dsp.resample import decimate, interpolate
from foten.evaluate.evaluate import Judgement
from foten.runtime.live.sinks import pcm_wav

N_WAVEFORM = 400  # samples
N_BLOCKS_SHOWN = 12  # over time; more would be narrower than a frame
AUDIO_HZ = 8000
AUDIO_S = 8.0  # of each player, at most
WAV_HEADER = 44  # bytes
_FADE_S = 0.004  # at block borders, so that the joints do not click
_PEAK = 0.9  # of full scale
LABELS = {
    "recorded": "recorded",
    "free_run": "free run",
    "free_run_deterministic": "without excitation",
    "free_run_ar": "AR(20)",
    "ceiling": "ceiling",
}
"""Names of a judgement's runs in every figure and table, in the order they are drawn."""


def shown_run(judgement: Judgement) -> str | None:
    """Key of the run that stands for the texture: with excitation where there is one; None without any."""
    return next((name for name in ("free_run", "free_run_deterministic") if name in judgement.synthesized), None)


def scored_runs(judgement: Judgement) -> dict[str, Array]:
    """Scored samples of `recorded` and of each run [m/s²], (n_seeds, n_blocks, n), in the order of `LABELS`."""
    recorded = judgement.trace.picked(judgement.blocks)[0][None]
    runs = {"recorded": recorded, **judgement.synthesized}
    return {name: runs[name][:, :, judgement.scored] for name in LABELS if name in runs}


def scored_conditions(judgement: Judgement) -> tuple[Array, Array]:
    """Speed [mm/s] and force [N] of the scored samples, each (n_blocks, n)."""
    _, speed, force = judgement.trace.picked(judgement.blocks)
    return speed[:, judgement.scored], force[:, judgement.scored]


def shown_blocks(judgement: Judgement) -> NDArray[np.int64]:
    """Indices of the judged blocks that are drawn over time: all, or 12 spread evenly."""
    n = len(judgement.blocks)
    return np.unique(np.linspace(0, n - 1, min(n, N_BLOCKS_SHOWN)).round().astype(np.int64))


def typical_block(judgement: Judgement) -> int:
    """Index of the judged block with the median recorded level, the lower of two."""
    levels = np.square(scored_runs(judgement)["recorded"][0]).mean(axis=1)
    return int(np.argsort(levels, kind="stable")[(len(levels) - 1) // 2])


def frame_errors(judgement: Judgement, name: str) -> Array:
    """Level errors of a run [dB] in frames of 40 ms of the scored samples, shape (n_seeds, n_blocks, n_frames)."""
    runs, rate_hz = scored_runs(judgement), judgement.trace.rate_hz
    recorded, synthesized = (frame_levels(runs[key], rate_hz, rms(runs["recorded"])) for key in ("recorded", name))
    return np.asarray(synthesized - recorded)


def densities(judgement: Judgement, unscored: bool = False) -> tuple[Array, dict[str, Array]]:
    """Scored frequencies [Hz], with `unscored` up to half the rate, and pooled densities of each run [(m/s²)²/Hz]."""
    rate_hz, n_segment = judgement.trace.rate_hz, segment_length(judgement.trace.block)
    spectra = {name: welch(run, rate_hz, n_segment) for name, run in scored_runs(judgement).items()}
    frequencies, _ = spectra["recorded"]
    bins = frequencies >= MIN_SCORED_HZ if unscored else scored_bins(frequencies, rate_hz)
    return frequencies[bins], {name: density.mean(axis=(0, 1))[bins] for name, (_, density) in spectra.items()}


def sounds(judgement: Judgement, name: str) -> tuple[bytes, bytes, float]:
    """Scored blocks as recorded and as synthesized, two WAV files of up to 8 s, and the full scale of both [m/s²]."""
    runs, rate_hz = scored_runs(judgement), judgement.trace.rate_hz
    n_blocks = max(1, int(AUDIO_S * rate_hz / runs["recorded"].shape[2]))
    pair = [
        np.concatenate([_audible(block, rate_hz) for block in runs[key][0, :n_blocks]])[: int(AUDIO_S * AUDIO_HZ)]
        for key in ("recorded", name)
    ]
    peak = max(float(np.abs(samples).max()) for samples in pair)
    full_scale = peak / _PEAK if peak > 0 else 1.0
    first, second = (pcm_wav(samples / full_scale, AUDIO_HZ) for samples in pair)
    return first, second, full_scale


def _audible(block: Array, rate_hz: float) -> Array:
    """Block at 8 kHz, faded at its ends."""
    factor = Fraction(AUDIO_HZ / rate_hz).limit_denominator(1000)
    # The rate that the factor stands for: within a thousandth of the true one, for an odd rate too.
    source_hz = AUDIO_HZ / float(factor)
    samples = interpolate(block, factor) if factor >= 1 else decimate(block, source_hz, AUDIO_HZ)
    from_start = np.arange(len(samples)) + 0.5
    return samples * np.minimum(1.0, np.minimum(from_start, from_start[::-1]) / (_FADE_S * AUDIO_HZ))
