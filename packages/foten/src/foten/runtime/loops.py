"""Many streams of a texture over all cores: closed loops, and one-step predictions of recordings."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from foten.dsp import Array
from foten.runtime.binding import library
from foten.runtime.native import NativeState, NativeTexture, PredictionPart

Excluded = Sequence[tuple[int, int]]  # the first moment, and the one after the last, of each stream


def on_all_cores(work: Callable[[int], None], n: int) -> None:
    """Call a function with 0 … n − 1 over the cores; the kernel's calls release the interpreter's lock."""
    with ThreadPoolExecutor(min(n, os.cpu_count() or 1) or 1) as pool:
        list(pool.map(work, range(n)))  # raises what a call raised


def render_streams(
    texture: NativeTexture,
    windows: Array,
    condition: Array,
    noise: Array | None,
    limit: float = np.inf,
    excluded: Excluded = (),
) -> Array:
    """Render n samples of each stream of a texture's closed loop, shape (s, n), without fade and growth; all scaled.

    Args:
        windows: that the streams go on from, shape (s, window, 3); ValueError for NaN or infinity.
        condition: speed and force of each sample, and the speed that tones go by [mm/s], shape (s, n, 3).
        noise: standard normal, shape (s, n); None for the deterministic loop.
        limit: that samples are cut to.
        excluded: recorded moments that each stream does not play.
    """
    out = np.empty(condition.shape[:2])

    def run(i: int) -> None:
        window, conditions = (np.ascontiguousarray(part[i], dtype=np.float64) for part in (windows, condition))
        drawn = None if noise is None else np.ascontiguousarray(noise[i], dtype=np.float64).ctypes
        state = NativeState(texture)
        if excluded:
            state.exclude(*excluded[i])
        if library().foten_start_scaled(state.pointer, window.ctypes) != 0:
            raise ValueError("the windows to start from hold NaN or infinity")
        library().foten_run_scaled(state.pointer, conditions.ctypes, drawn, limit, len(conditions), out[i].ctypes)
        texture.raise_failed()

    on_all_cores(run, len(out))
    return out


def render_strokes(
    texture: NativeTexture,
    seed: int,
    speed: Array,
    force: Array,
    first_stream: int = 0,
    windows: Sequence[Array] = (),
    excitation: bool = True,
    excluded: Excluded = (),
) -> tuple[Array, int]:
    """Acceleration [m/s²] of strokes with noise of their own, shape (s, n), and how many samples the saturator cut.

    Args:
        seed: of the noise; stroke s draws that of stream `first_stream` + s.
        speed, force: at the texture's own rate [mm/s, N], each of shape (s, n).
        windows: acceleration, speed and force, each (s, window), that strokes go on from; by default the stored warm start.
        excluded: recorded moments that each stroke does not play.
    """
    rendered, n_saturated = np.empty(speed.shape), np.zeros(len(speed), dtype=np.int64)

    def render(stroke: int) -> None:
        state = NativeState(texture, seed=seed, stream=first_stream + stroke, excitation=excitation)
        if excluded:
            state.exclude(*excluded[stroke])
        if windows:
            state.start(*(window[stroke] for window in windows))
        rendered[stroke] = state.render_stroke(speed[stroke], force[stroke])
        n_saturated[stroke] = state.statistics.n_saturated

    on_all_cores(render, len(rendered))
    return rendered, int(n_saturated.sum())


class Prediction(NamedTuple):
    """Predicted samples and their likelihood, scaled, of one shape; all but the sample are 0 where no likelihood is known."""

    sample: Array
    scale: Array  # standard deviation of the random part
    standardised: Array  # recorded samples as standard normal numbers, if the distribution is right
    nll: Array  # negative log-likelihood of the recorded samples [nat, scaled]


def predict_blocks(texture: NativeTexture, blocks: Array, part: PredictionPart = "model") -> Prediction:
    """One-step predictions of recorded blocks, scaled (s, n, 3), from sample `window` on: (s, n − window) each.

    The "linear" part alone is what renderings of foten-plus excite: there it has the likelihood.
    """
    out = np.empty((len(blocks), blocks.shape[1] - texture.info.window, 4))

    def predict(i: int) -> None:
        NativeState(texture).predict(np.ascontiguousarray(blocks[i], dtype=np.float64), part, out[i])

    on_all_cores(predict, len(out))
    return Prediction(*np.moveaxis(out, 2, 0))
