"""Ten minutes of random strokes on texture files: the largest sample, what the saturator cut, silence at rest.

    python benchmarks/stability.py TEXTURE.foten... [--minutes 10] [--streams 60] [--save DIR]

The strokes are the simulator's hand, 0 to 350 mm/s and 0.1 to 4 N, whatever range the texture was trained in; besides,
the same with speed and force scaled into the trained range, so that narrow recordings are not mostly clamped. Samples are
counted in standard deviations of the training blocks. Fails where one is beyond 12 and beyond what was recorded, or where
the saturator had to cut.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from foten.datasets.stroking import stroking
from foten.render.synthesizer import Synthesizer
from foten.texture_file import read_texture
from foten.whole_file import whole_file


def strokes(rate_hz: float, seconds: float, n_streams: int) -> tuple[np.ndarray, np.ndarray]:
    """Return speed [mm/s] and force [N] of independent hands, shapes (n_streams, n)."""
    hands = [stroking(seconds, 10_000 + seed, rate_hz) for seed in range(n_streams)]
    return np.stack([hand.speed for hand in hands]), np.stack([hand.force for hand in hands])


def into(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return values stretched onto a range, each stream by itself."""
    least, most = values.min(axis=1, keepdims=True), values.max(axis=1, keepdims=True)
    return low + (values - least) / (most - least) * (high - low)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("textures", nargs="+", type=Path)
    parser.add_argument(
        "--minutes", type=float, default=10.0, help="in each of the two kinds of strokes together"
    )
    parser.add_argument("--streams", type=int, default=60)
    parser.add_argument("--save", type=Path, metavar="DIR", help="keep each result as JSON there")
    arguments = parser.parse_args()
    seconds = arguments.minutes * 60 / arguments.streams
    failed = False
    for path in arguments.textures:
        texture = read_texture(path)
        speed, force = strokes(texture.rate_hz, seconds, arguments.streams)
        half = arguments.streams // 2
        speed[half:] = into(speed[half:], *texture.trained_range("speed"))
        force[half:] = into(force[half:], *texture.trained_range("force"))
        synthesizer = Synthesizer(texture, 1, arguments.streams)
        started = time.perf_counter()
        rendered = synthesizer.render(speed, force)
        elapsed = time.perf_counter() - started
        statistics = synthesizer.statistics
        still = Synthesizer(texture, 1).render(np.zeros(1000), np.ones(1000))
        result = {
            "texture": path.stem,
            "rate_hz": texture.rate_hz,
            "samples": statistics.n,
            "finite": bool(np.isfinite(rendered).all()),
            "max_sd": float(np.abs(rendered).max() / texture.scaling.sd[0]),
            "rms_sd": float(np.sqrt(np.square(rendered).mean()) / texture.scaling.sd[0]),
            "n_saturated": statistics.n_saturated,
            "recorded_peak_sd": texture.card["metrics"]["recorded_peak_sd"],
            "rest_m_s2": float(np.abs(still).max()),
            "times_real_time": arguments.minutes * 60 / elapsed,
        }
        failed |= not result["finite"] or result["n_saturated"] > 0
        failed |= result["max_sd"] > max(12.0, result["recorded_peak_sd"])
        if arguments.save is not None:
            arguments.save.mkdir(parents=True, exist_ok=True)
            with whole_file(arguments.save / f"{path.stem}.json") as part:
                part.write_text(json.dumps(result, indent=1) + "\n")
        print(
            f"{result['texture']:36s} max {result['max_sd']:6.2f} sd (recorded {result['recorded_peak_sd']:.2f}), "
            f"rms {result['rms_sd']:.2f} sd, {result['n_saturated']} saturated, rest {result['rest_m_s2']:g} m/s², "
            f"{result['times_real_time']:.1f} × real time",
            flush=True,
        )
    sys.exit(int(failed))


if __name__ == "__main__":
    main()
