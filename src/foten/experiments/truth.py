"""What the simulator knows of a recording it made, in the form that the judge takes."""

from __future__ import annotations

import numpy as np

from foten.datasets.linear_family import LINEAR_FAMILY, linear_truth, one_step_bounds
from foten.datasets.simulate import second_realisation
from foten.dsp.filters import butterworth
from foten.evaluate.evaluate import Truth, trace_for
from foten.evaluate.free_run import N_SEEDS
from foten.recording.preprocess import PreprocessConfig
from foten.recording.recording import Recording
from foten.texture_file import Texture


def truth_for(
    recording: Recording, texture: Texture, trim_ms: float | None = None, block_ms: float | None = None
) -> Truth:
    """Return further realisations of a simulated stroke and, for the linear family, the bounds of any predictor.

    A recording that was not simulated, or by another version of the simulator, has no truth; neither bound holds at another
    rate than the simulated one or with another high-pass than order 2.
    """
    if recording.simulation is None:
        return Truth()
    try:
        used = int(recording.simulation["noise_seed"])
        realisations = [
            trace_for(texture, second_realisation(recording, used + 1_000_003 * (k + 1)), trim_ms, block_ms)
            for k in range(N_SEEDS)
        ]
    except (KeyError, TypeError, ValueError) as error:
        return Truth(why_no_bound=f"the simulator's parameters in the recording cannot be used ({error})")
    config = PreprocessConfig(**texture.card["preprocess"])
    if recording.simulation["key"] not in LINEAR_FAMILY:
        return Truth(realisations)
    if recording["acceleration"].rate_hz != config.rate_hz:
        return Truth(realisations, why_no_bound="known at the simulated rate alone")
    if config.highpass_order != 2 or config.zero_phase:
        return Truth(realisations, why_no_bound="known with a causal high-pass of order 2 alone")
    trace = trace_for(texture, recording, trim_ms, block_ms)
    (b0, b1, b2, a1, a2), *_ = butterworth("highpass", config.highpass_hz, config.rate_hz)
    bound, bound_window = one_step_bounds(
        linear_truth(recording),
        trace.speed,
        trace.force,
        config.rate_hz,
        np.array([b0, b1, b2]),
        np.array([1.0, a1, a2]),
        texture.window,
    )
    return Truth(realisations, bound, bound_window)
