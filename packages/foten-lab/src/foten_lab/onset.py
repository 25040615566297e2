"""The first 100 ms of a stroke beside the same stroke from 1 s on: level, spectrum, clicks."""

from itertools import pairwise
from typing import Any

import numpy as np

from foten.dsp import Array
from foten.dsp.distance import welch
from foten.models.conditions import MOVING_FORCE, MOVING_SPEED
from foten.models.texture_file import Texture
from foten.runtime.loops import render_strokes
from foten.runtime.native import NativeTexture

WINDOW_MS = 40.0
STARTS_MS = (0.0, 100.0)
SETTLED_S, LASTS_S = 1.0, 2.0
CLICK_MS = 20.0
MORE_STREAMS = 16  # times as many for clicks
N_STROKES, N_STREAMS = 50, 8


def third_octaves(rate_hz: float) -> Array:
    """Edges of third-octave bands [Hz], from 50 Hz, the lowest that 40 ms resolve, to 0.45 of the rate or 1 kHz."""
    highest = min(1000.0, 0.45 * rate_hz)
    return 50.0 * 2 ** (np.arange(int(3 * np.log2(highest / 50.0)) + 1) / 3)


def band_powers(windows: Array, rate_hz: float) -> Array:
    """Power in each band, mean over windows (k, n) → (bands,)."""
    hertz, density = welch(windows, rate_hz, windows.shape[1])
    power, edges = density.mean(axis=0), third_octaves(rate_hz)
    return np.array([power[(hertz >= low) & (hertz < high)].sum() for low, high in pairwise(edges)])


def onset(texture: Texture, n_strokes: int = N_STROKES, n_streams: int = N_STREAMS, seed: int = 0) -> dict[str, Any]:
    """Levels and spectra of first strokes beside settled ones, and the share of clicks.

    Each stroke begins at once with a speed and a force of the trained range and holds them. Settled is the same from 1 s on.

    Returns:
        `level_db`, `spectrum_db`: power of a window of 40 ms over the settled power [dB], mean over strokes; the same in
        third-octave bands, root mean square; by where the window begins, `settled` the largest of ten settled windows;
        `click_share`: how often samples of the first 20 ms exceed the settled 99.9th percentile; `settled_share`: how often
        settled ones exceed that of the other streams; `click_standard_error`: of the difference.
    """
    rng = np.random.default_rng(seed)
    kernel, rate = NativeTexture(texture.to_bytes()), texture.rate_hz
    window, n = round(WINDOW_MS * rate / 1000), round(LASTS_S * rate)
    (slow, fast), (light, heavy) = (texture.trained_range(channel) for channel in ("speed", "force"))
    speeds = rng.uniform(max(slow, min(MOVING_SPEED, fast)), fast, n_strokes)
    forces = rng.uniform(max(light, min(MOVING_FORCE, heavy)), heavy, n_strokes)
    speed, force = (np.repeat(values, n_streams)[:, None] + np.zeros(n) for values in (speeds, forces))
    rendered = render_strokes(kernel, seed, speed, force)[0].reshape(n_strokes, n_streams, n)
    settled = rendered[:, :, round(SETTLED_S * rate) :]
    cut = settled[..., : settled.shape[2] // window * window].reshape(n_strokes, -1, window)
    loud = np.square(settled).mean(axis=(1, 2))
    colours = np.stack([band_powers(windows, rate) for windows in cut])
    present = (colours > 0).all(axis=0)

    def away(first: int) -> tuple[float, float]:
        part = rendered[:, :, first : first + window]
        level = 10 * np.log10(np.square(part).mean(axis=(1, 2)) / loud)
        powers = np.stack([band_powers(windows, rate) for windows in part])
        ratio = 10 * np.log10(powers[:, present] / colours[:, present])
        return float(level.mean()), float(np.sqrt(np.square(ratio.mean(axis=0)).mean()))

    limits = np.quantile(np.abs(settled), 0.999, axis=(1, 2))
    usual = np.mean(
        [
            np.abs(settled[:, k]) > np.quantile(np.abs(np.delete(settled, k, axis=1)), 0.999, axis=(1, 2))[:, None]
            for k in range(n_streams)
        ],
        axis=(0, 2),
    )
    first = np.ones(round(CLICK_MS * rate / 1000))
    streams = MORE_STREAMS * n_streams
    speed, force = (np.repeat(values, streams)[:, None] * first for values in (speeds, forces))
    at_once, _ = render_strokes(kernel, seed + 1, speed, force)
    loud_samples = np.abs(at_once.reshape(n_strokes, streams, -1)) > limits[:, None, None]
    begin = {f"{start:g}_ms": away(round(start * rate / 1000)) for start in STARTS_MS}
    later = [away(round(SETTLED_S * rate) + k * window) for k in range(10)]
    levels, spectra = ({start: figures[k] for start, figures in begin.items()} for k in (0, 1))
    return {
        "level_db": {**levels, "settled": max(abs(level) for level, _ in later)},
        "spectrum_db": {**spectra, "settled": max(spectrum for _, spectrum in later)},
        "click_share": float(loud_samples.mean()),
        "settled_share": float(usual.mean()),
        "click_standard_error": float((loud_samples.mean(axis=(1, 2)) - usual).std(ddof=1) / np.sqrt(n_strokes)),
    }
