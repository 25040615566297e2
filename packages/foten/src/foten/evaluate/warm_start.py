"""Free runs as the paper's: of a whole block, from one short window that does not belong to it (Sec. V-a, Figs. 6 and 7)."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from foten.dsp import Array
from foten.dsp.level import decibels, framed
from foten.dsp.noise import gaussian
from foten.evaluate.metrics import goodness_of_fit
from foten.evaluate.one_step import Linear
from foten.models.foten_plus.recorded_innovations import neighbourhoods
from foten.models.texture_file import Texture
from foten.recording.scaling import Scaling
from foten.recording.split import Split
from foten.recording.trace import Trace
from foten.runtime.loops import render_strokes
from foten.runtime.native import NativeTexture

CONVERGED_MS = 100.0  # in which the paper's network converges, 100 samples at 1 kHz; Sec. V-a
SHOWN_MS = 400.0  # Fig. 6
ERROR_FRAME_MS = 10.0  # in which the error and the level over time are drawn
SILENT_DB = -20.0  # level over the recording's, below which a run is called silent
FORGOTTEN = 0.01  # of the training standard deviation, that two runs differ by at most; our choice
N_DRAWS = 2  # of a run with an excitation: errors of a waveform hardly differ between them
_NEAR_SHARE = 100  # a hundredth of the training samples is near to the condition of the warm start
_SETTLE = 2000  # samples before a synthesised window, for the filter's start
_STREAM = 2**20  # of the synthesised window's noise: no rendering has as many


def stored_window(texture: Texture) -> list[Array]:
    """Warm start of a texture file: acceleration [m/s²], speed [mm/s] and force [N], shape (window,) each."""
    scaling: Scaling = texture.scaling
    return list((np.array(scaling.mean) + np.array(scaling.sd) * texture.tensors["warm_start"]).T)


def synthesised_window(linear: Linear, trace: Trace, train: tuple[int, ...], texture: Texture) -> list[Array]:
    """Window of noise through an AR filter, at the level of the training samples nearest to the warm start's condition.

    Deterministic: acceleration [m/s²], speed [mm/s] and force [N], shape (window,) each, the last two constant. `linear` is
    AR(20) of the training blocks `train`. Source: Sec. V-a, 45 mm/s and 0.8 N; what the paper's was synthesised from it does not
    say.
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
    split: Split | None = None,
) -> dict[str, Array]:
    """Free runs of whole blocks [m/s²], (n_seeds, n_blocks, block): from the `stored` window, and from the `synthesised` one.

    With the excitation where the texture has one. A rendering with an excitation does not start so, but from a state that is
    drawn for its first condition. A model that filters noise has no window: its `stored` run is such a rendering.
    """
    excitation = texture.has_excitation
    n_seeds = N_DRAWS if excitation else 1
    _, speed, force = (np.tile(channel, (n_seeds, 1)) for channel in trace.picked(blocks))
    excluded = neighbourhoods(split, trace, blocks, n_seeds)
    starts: dict[str, list[Array]] = {"stored": stored_window(texture) if texture.predicts_samples else []}
    if window is not None and texture.predicts_samples:
        starts["synthesised"] = window
    runs = {}
    for name, start in starts.items():
        windows = [np.tile(channel, (len(speed), 1)) for channel in start]
        rendered, _ = render_strokes(kernel, seed, speed, force, 0, windows, excitation, excluded)
        runs[name] = rendered.reshape(n_seeds, len(blocks), -1)
    return runs


def warm_start_scores(recorded: Array, runs: Mapping[str, Array], rate_hz: float, sd: float) -> dict[str, Any]:
    """Figures of whole blocks beside those of silence, whose GFC is undefined.

    Args:
        recorded: [m/s²], shape (n_blocks, block).
        runs: free runs by what they start from, and `ceiling`, true vibrations, shape (n_seeds, n_blocks, block); every sample is
            scored.
        sd: training standard deviation of the acceleration [m/s²].

    Returns:
        `silence_mae_scaled`; for each run `mae_scaled`, `gfc`, `error_to_silence_0_100_ms` and `…_100_400_ms`, None where blocks
        are shorter, and `level_db`, over the recorded one, from 100 ms on. `forgotten_ms`: after how long the runs from two
        windows differ by no more than `FORGOTTEN`, root mean square over blocks; None where never, or where the run is silent.
    """
    converged, shown = (round(ms * rate_hz / 1000) for ms in (CONVERGED_MS, SHOWN_MS))
    n = recorded.shape[-1]
    spans = {"0_100_ms": slice(0, converged), "100_400_ms": slice(converged, shown)}

    def to_silence(error: Array, span: slice) -> float | None:
        return float(error[..., span].mean() / np.abs(recorded[..., span]).mean()) if n >= span.stop else None

    scores: dict[str, Any] = {"silence_mae_scaled": float(np.abs(recorded).mean() / sd), "forgotten_ms": None}
    for name, run in runs.items():
        error = np.abs(run - recorded)
        settled = slice(min(converged, n // 2), None)
        power, of_recorded = (np.square(signal[..., settled]).mean() for signal in (run, recorded))
        scores[name] = {
            "mae_scaled": float(error.mean() / sd),
            "gfc": float(goodness_of_fit(recorded, run).mean()),
            **{f"error_to_silence_{key}": to_silence(error, span) for key, span in spans.items()},
            "level_db": float(decibels(power / of_recorded)),
        }
    if {"stored", "synthesised"} <= runs.keys() and scores["stored"]["level_db"] > SILENT_DB:
        difference = np.sqrt(np.square(runs["stored"] - runs["synthesised"]).mean(axis=(0, 1))) / sd
        later = np.flatnonzero(difference > FORGOTTEN)
        if not len(later) or later[-1] + 1 < n:
            scores["forgotten_ms"] = 1000 * (0 if not len(later) else int(later[-1]) + 1) / rate_hz
    return scores


def over_time(recorded: Array, run: Array, rate_hz: float) -> tuple[Array, Array]:
    """Error over that of silence, and level over the recorded one [dB], in frames of 10 ms of the first 400 ms, shape (k,) each.

    Of recorded blocks (n_blocks, block) and of runs (n_seeds, n_blocks, block) [m/s²].
    """
    n = round(SHOWN_MS * rate_hz / 1000)

    def of_frames(signal: Array) -> Array:
        frames = framed(signal[..., :n], ERROR_FRAME_MS, rate_hz)
        return frames.reshape(-1, *frames.shape[-2:])

    errors, silence = (np.abs(of_frames(signal)).mean(axis=(0, 2)) for signal in (run - recorded, recorded))
    power, of_recorded = (np.square(of_frames(signal)).mean(axis=(0, 2)) for signal in (run, recorded))
    return errors / silence, decibels(power / of_recorded)
