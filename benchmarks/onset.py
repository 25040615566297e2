"""The first 100 ms of a stroke from the warm start: how near level and spectrum are to settled ones, and is there a click.

    python benchmarks/onset.py TEXTURE.foten... [--strokes 50] [--streams 8] [--save DIR]
    python benchmarks/onset.py --save DIR --page docs/fidelity.md

A first stroke begins at once with a speed and a force drawn from the trained range and holds them, rendered from the warm
start under several streams of noise. Settled is what the same streams are from 1 s on. Level: mean over strokes of the power in
a window of 40 ms over the settled power [dB], and mean of its size, which a start that is loud under one hand and soft under
another does not hide. Spectrum: mean over strokes of the same in third-octave bands (40 ms hold no finer), root mean square over
the bands. Settled windows scatter too: the last column has the largest of ten such windows. Click: how often samples of the first
20 ms exceed the settled 99.9th percentile, over more streams, since that is rare; and how often settled ones do, that of each
stream counted against the percentile of the others.
"""

from __future__ import annotations

import argparse
import json
import os
from itertools import pairwise
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from foten.families.conditions import FADE_FORCE, FADE_SPEED
from foten.families.texture_file import Texture, read_texture
from main_table import SOURCES, between, keep, made_earlier, name_of
from streams import rendered

WINDOW_MS = 40.0
STARTS_MS = (0.0, 20.0, 60.0, 100.0)
SETTLED_S, LASTS_S = 1.0, 2.0
CLICK_MS = 20.0
MORE_STREAMS = 16  # times as many for clicks


def third_octaves(rate_hz: float) -> np.ndarray:
    """Return the edges of third-octave bands from 50 Hz, the lowest that 40 ms tell apart, to 0.45 of the rate or 1 kHz [Hz]."""
    highest = min(1000.0, 0.45 * rate_hz)
    return 50.0 * 2 ** (np.arange(int(3 * np.log2(highest / 50.0)) + 1) / 3)


def band_powers(windows: np.ndarray, rate_hz: float) -> np.ndarray:
    """Return the power in each band, mean over windows (k, n) → (bands,)."""
    n = windows.shape[1]
    power = (np.abs(np.fft.rfft(windows * np.hanning(n), axis=1)) ** 2).mean(axis=0)
    hertz = np.fft.rfftfreq(n, 1 / rate_hz)
    edges = third_octaves(rate_hz)
    return np.array([power[(hertz >= low) & (hertz < high)].sum() for low, high in pairwise(edges)])


def judge(texture: Texture, n_strokes: int, n_streams: int, seed: int = 0) -> dict[str, Any]:
    """Return the figures of one texture."""
    rng = np.random.default_rng(seed)
    rate = texture.rate_hz
    window, n = round(WINDOW_MS * rate / 1000), round(LASTS_S * rate)
    (slow, fast), (light, heavy) = (texture.trained_range(channel) for channel in ("speed", "force"))
    speeds = rng.uniform(max(slow, min(FADE_SPEED, fast)), fast, n_strokes)
    forces = rng.uniform(max(light, min(FADE_FORCE, heavy)), heavy, n_strokes)
    hand = (np.repeat(values, n_streams)[:, None] + np.zeros(n) for values in (speeds, forces))
    played = rendered(texture, seed, *hand)[0].reshape(n_strokes, n_streams, n)
    settled = played[:, :, round(SETTLED_S * rate) :]
    cut = settled[..., : settled.shape[2] // window * window].reshape(n_strokes, -1, window)
    loud = np.square(settled).mean(axis=(1, 2))
    colours = np.stack([band_powers(windows, rate) for windows in cut])
    present = (colours > 0).all(axis=0)

    def away(first: int) -> tuple[float, float, float]:
        part = played[:, :, first : first + window]
        level = 10 * np.log10(np.square(part).mean(axis=(1, 2)) / loud)
        powers = np.stack([band_powers(windows, rate) for windows in part])
        ratio = 10 * np.log10(powers[:, present] / colours[:, present])
        spectrum = np.sqrt(np.square(ratio.mean(axis=0)).mean())
        return float(level.mean()), float(spectrum), float(np.abs(level).mean())

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
    hand = (np.repeat(values, streams)[:, None] * first for values in (speeds, forces))
    at_once, _ = rendered(texture, seed + 1, *hand)
    loud_samples = np.abs(at_once.reshape(n_strokes, streams, -1)) > limits[:, None, None]
    begin = [away(round(start * rate / 1000)) for start in STARTS_MS]
    later = [away(round(SETTLED_S * rate) + k * window) for k in range(10)]
    return {
        "texture_sha256": texture.sha256(),
        "source_sha256": SOURCES,
        "rate_hz": rate,
        "n_strokes": n_strokes,
        "starts_ms": STARTS_MS,
        "level_db": [one[0] for one in begin],
        "spectrum_db": [one[1] for one in begin],
        # Of each stroke by itself, over several streams of noise: what chance does is in the settled one as well.
        "level_abs_db": [one[2] for one in begin],
        "settled_level_db": max(abs(one[0]) for one in later),
        "settled_spectrum_db": max(one[1] for one in later),
        "settled_level_abs_db": max(one[2] for one in later),
        "click_share": float(loud_samples.mean()),
        "settled_share": float(usual.mean()),
        # Of their difference, over strokes.
        "click_standard_error": float((loud_samples.mean(axis=(1, 2)) - usual).std(ddof=1) / np.sqrt(n_strokes)),
    }


def table(folder: Path) -> str:
    """Return what is saved as Markdown: level, its size and spectrum [dB] in 40 ms from each start on and settled; the clicks."""
    head = [
        "texture",
        "rate [kHz]",
        *(f"{start:g} ms" for start in STARTS_MS),
        "settled, at most",
        "first 20 ms over the settled 99.9th percentile",
        "settled sound",
    ]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for path in sorted(folder.glob("*.json")):
        result = json.loads(path.read_text())
        cells = [name_of(result, folder.name), f"{result['rate_hz'] / 1000:g}"]
        names = ("level_db", "level_abs_db", "spectrum_db")
        cells += [f"{a:+.2f} / {b:.2f} / {c:.2f}" for a, b, c in zip(*(result[name] for name in names), strict=True)]
        cells.append(" / ".join(f"{result[f'settled_{name}']:.2f}" for name in names))
        cells.append(f"{100 * result['click_share']:.3f} ± {100 * result['click_standard_error']:.3f} %")
        cells.append(f"{100 * result['settled_share']:.3f} %")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, *made_earlier(folder)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("textures", nargs="*", type=Path)
    parser.add_argument("--strokes", type=int, default=50)
    parser.add_argument("--streams", type=int, default=8, help="of noise, for each stroke")
    parser.add_argument("--save", type=Path, metavar="DIR", help="keep each result as JSON there")
    parser.add_argument("--page", type=Path, metavar="FILE", help="put what is saved between its markers in this file")
    arguments = parser.parse_args()
    if not arguments.textures and arguments.page is None:
        parser.error("no texture file was given")
    if arguments.textures:
        print(
            "texture, then level / its size in single strokes / spectrum [dB] in the 40 ms from 0, 20, 60, 100 ms on, settled; "
            "over the 99.9th percentile in the first 20 ms, and in settled sound"
        )
    for path in arguments.textures:
        result = {"file": path.stem, **judge(read_texture(path), arguments.strokes, arguments.streams)}
        if arguments.save is not None:
            arguments.save.mkdir(parents=True, exist_ok=True)
            keep(arguments.save / f"{path.stem}.json", result)
        names = ("level_db", "level_abs_db", "spectrum_db")
        cells = [f"{a:+.2f}/{b:.2f}/{c:.2f}" for a, b, c in zip(*(result[name] for name in names), strict=True)]
        cells.append("/".join(f"{result[f'settled_{name}']:.2f}" for name in names))
        click = f"{100 * result['click_share']:.3f} ± {100 * result['click_standard_error']:.3f} %"
        click += f", {100 * result['settled_share']:.3f} %"
        print(f"{path.stem:36s} {'  '.join(cells)}  {click}", flush=True)
    if arguments.page is not None:
        between(arguments.page, "onset", table(arguments.save))


if __name__ == "__main__":
    main()
