"""Free runs as the paper's: of a whole block, from one short window that does not belong to it (Sec. V-a, Figs. 6 and 7)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from foten.dsp import Array
from foten.dsp.noise import gaussian
from foten.evaluate.metrics import goodness_of_fit
from foten.evaluate.one_step import Linear
from foten.models.texture_file import Texture
from foten.recording.scaling import Scaling
from foten.recording.trace import Trace
from foten.runtime.loops import render_strokes
from foten.runtime.native import NativeTexture

CONVERGED_MS = 100.0  # in which the paper's network converges; Sec. V-a
SHOWN_MS = 400.0  # Fig. 6
ERROR_FRAME_MS = 10.0  # in which the error over time is drawn
STARTS = ("stored", "synthesised")
N_SEEDS = 2  # of a run with an excitation: errors of a waveform hardly differ between them
FORGOTTEN = 0.01  # of the training standard deviation, that two runs differ by at most
_NEAR_SHARE = 100  # a hundredth of the training samples is near to the condition of the warm start
_SETTLE = 2000  # samples before a synthesised window, for the filter's start
_STREAM = 2**20  # of the synthesised window's noise: no rendering has as many


def synthesised_window(linear: Linear, trace: Trace, train: tuple[int, ...], texture: Texture) -> list[Array]:
    """Window of noise through an AR filter, at the level of the training samples nearest to the warm start's condition.

    Deterministic: acceleration [m/s²], speed [mm/s] and force [N], shape (window,) each, the last two constant.

    Args:
        linear: AR(20) of the training blocks.
        train: numbers of the training blocks.

    Source: Sec. V-a, 45 mm/s and 0.8 N. The paper does not say what it synthesised the window from: the filter is our choice.
    """
    from scipy.signal import lfilter

    m, asked = texture.window, texture.card["warm_start"]["asked"]
    condition = np.array([asked["speed"], asked["force"]])
    stable = linear.stable()
    noise = gaussian(0, _STREAM, 0, _SETTLE + m)
    window = lfilter([1.0], np.append(1.0, -stable.coefficients[-2::-1]), noise)[-m:]
    acceleration, speed, force = (channel.ravel() for channel in trace.picked(train))
    scaling: Scaling = texture.scaling
    distance = np.hypot((speed - condition[0]) / scaling.sd[1], (force - condition[1]) / scaling.sd[2])
    near = np.argsort(distance, kind="stable")[: max(1, len(distance) // _NEAR_SHARE)]
    level = np.sqrt(np.square(acceleration[near]).mean() / np.square(window).mean())
    return [level * window, np.full(m, condition[0]), np.full(m, condition[1])]


def warm_start_runs(
    texture: Texture,
    kernel: NativeTexture,
    trace: Trace,
    blocks: tuple[int, ...],
    window: list[Array] | None,
    seed: int,
) -> dict[str, Array]:
    """Free runs of whole blocks [m/s²], (n_seeds, n_blocks, block), by what they start from: the stored or a synthesised window.

    With the excitation where the texture has one. Only the stored window's where `window` is None.
    """
    excitation = texture.has_excitation
    n_seeds = N_SEEDS if excitation else 1
    _, speed, force = (np.tile(channel, (n_seeds, 1)) for channel in trace.picked(blocks))
    starts = (
        {"stored": []}
        if window is None
        else {"stored": [], "synthesised": [np.tile(x, (len(speed), 1)) for x in window]}
    )
    return {
        name: render_strokes(kernel, seed, speed, force, 0, start, excitation)[0].reshape(n_seeds, len(blocks), -1)
        for name, start in starts.items()
    }


def warm_start_scores(recorded: Array, runs: Mapping[str, Array], rate_hz: float, sd: float) -> dict[str, Any]:
    """Figures of free runs from a warm start, beside those of silence.

    Args:
        recorded: [m/s²], shape (n_blocks, block).
        runs: by what they start from, shape (n_seeds, n_blocks, block); of all samples every one is scored.
        sd: training standard deviation of the acceleration [m/s²].

    Returns:
        `silence_mae_scaled`: error of silence, whose `gfc` is undefined; for each start `mae_scaled`; `gfc`, mean of Eq. 13
        on raw bins of blocks; `mae_100_ms` and `mae_400_ms`, errors of the first 100 ms and of the 300 ms after them, over
        those of silence, None of shorter blocks; `level_db`, over the recorded one, after 100 ms. `forgotten_ms`: after how
        long the runs from both starts differ by no more than a hundredth of `sd`, root mean square over blocks; None where
        that is never.
    """
    converged, shown = (round(ms * rate_hz / 1000) for ms in (CONVERGED_MS, SHOWN_MS))
    spans = {"mae_100_ms": slice(0, converged), "mae_400_ms": slice(converged, shown)}
    scores: dict[str, Any] = {"silence_mae_scaled": float(np.abs(recorded).mean() / sd), "forgotten_ms": None}
    for name, run in runs.items():
        error = np.abs(run - recorded)
        power, of_recorded = (
            np.square(signal[..., min(converged, signal.shape[-1] // 2) :]).mean() for signal in (run, recorded)
        )
        scores[name] = {
            "mae_scaled": float(error.mean() / sd),
            "gfc": float(goodness_of_fit(recorded, run).mean()),
            **{
                key: float(error[..., span].mean() / np.abs(recorded[..., span]).mean())
                if recorded[..., span].size
                else None
                for key, span in spans.items()
            },
            "level_db": float(10 * np.log10(max(power / of_recorded, 1e-30))),
        }
    if len(runs) == len(STARTS):
        difference = np.sqrt(np.square(runs["stored"] - runs["synthesised"]).mean(axis=(0, 1))) / sd
        later = np.flatnonzero(difference > FORGOTTEN)
        if not len(later) or later[-1] + 1 < len(difference):
            scores["forgotten_ms"] = 1000 * (0 if not len(later) else int(later[-1]) + 1) / rate_hz
    return scores
