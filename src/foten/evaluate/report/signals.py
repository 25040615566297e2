"""The signals of a judgement that figures and sound show: which run, which blocks, levels and densities."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foten.evaluate import metrics
from foten.evaluate.evaluate import Judgement
from foten.evaluate.free_run import scored

Array = NDArray[np.float64]

N_WAVEFORM = 400  # samples
N_BLOCKS_SHOWN = 12  # over time; more would be narrower than a frame
LABELS = {
    "recorded": "recorded",
    "free_run": "free run",
    "free_run_deterministic": "without excitation",
    "free_run_ar": "AR(20)",
    "ceiling": "ceiling",
}
"""Names of a judgement's runs in every figure and table, in the order they are drawn."""


def shown_run(judgement: Judgement) -> str | None:
    """Return the key of the run that stands for the texture: with excitation where there is one; None without any."""
    return next((name for name in ("free_run", "free_run_deterministic") if name in judgement.synthesized), None)


def scored_channels(judgement: Judgement) -> tuple[Array, Array, Array]:
    """Return recorded acceleration [m/s²], speed [mm/s] and force [N] of the scored samples, each (n_blocks, n)."""
    trace, part = judgement.trace, scored(judgement.trace.block)
    acceleration, speed, force = (
        trace.blocks(channel)[list(judgement.blocks), part]
        for channel in (trace.acceleration, trace.speed, trace.force)
    )
    return acceleration, speed, force


def shown_blocks(judgement: Judgement) -> NDArray[np.int64]:
    """Return which of the judged blocks are drawn over time: all, or 12 spread evenly."""
    n = len(judgement.blocks)
    return np.unique(np.linspace(0, n - 1, min(n, N_BLOCKS_SHOWN)).round().astype(np.int64))


def typical_block(judgement: Judgement) -> int:
    """Return which of the judged blocks has the median recorded level (the lower of two)."""
    levels = np.square(scored_channels(judgement)[0]).mean(axis=1)
    return int(np.argsort(levels, kind="stable")[(len(levels) - 1) // 2])


def level_errors(judgement: Judgement, name: str) -> Array:
    """Return a run's mean level error [dB] in each judged block, mean over frames of 40 ms and seeds, shape (n_blocks,)."""
    recorded, _, _ = scored_channels(judgement)
    reference = float(np.sqrt(np.square(recorded).mean()))
    synthesized = judgement.synthesized[name][:, :, scored(judgement.trace.block)]
    of = [metrics.frame_levels(x, judgement.trace.rate_hz, reference) for x in (recorded, synthesized)]
    return np.asarray((of[1] - of[0]).mean(axis=(0, 2)))


def densities(judgement: Judgement) -> tuple[Array, dict[str, Array]]:
    """Return the scored frequencies [Hz] and each run's density [(m/s²)²/Hz] there, pooled over blocks and seeds.

    The log-spectral distance of pooled spectra is computed on the same densities.
    """
    rate_hz, part = judgement.trace.rate_hz, scored(judgement.trace.block)
    recorded, _, _ = scored_channels(judgement)
    n_segment = metrics.segment_length(judgement.trace.block)
    frequencies, density = metrics.welch(recorded, rate_hz, n_segment)
    bins = metrics.scored_bins(frequencies, rate_hz)
    pooled = {"recorded": density.mean(axis=0)[bins]}
    for name in LABELS:
        if name in judgement.synthesized:
            of = metrics.welch(judgement.synthesized[name][:, :, part], rate_hz, n_segment)[1]
            pooled[name] = of.mean(axis=(0, 1))[bins]
    return frequencies[bins], pooled
