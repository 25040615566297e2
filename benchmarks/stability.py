"""Ten minutes of random strokes on texture files, and a million steps of an attack: is it bounded, and does it forget.

    python benchmarks/stability.py TEXTURE.foten... [--minutes 10] [--streams 60] [--attack 1000000] [--save DIR]

The strokes are the simulator's hand, 0 to 350 mm/s and 0.1 to 4 N, whatever range the texture was trained in; besides,
the same with speed and force scaled into the trained range, so that narrow recordings are not mostly clamped. Samples are
counted in standard deviations of the training blocks. Fails where one is not finite, or where the saturator had to cut.

The attack runs without the saturator: many streams, each from a window at ±50 standard deviations, speed and force at another
corner of the trained range at every sample, the excitation's noise at ± the largest that the generator can draw. Besides,
pairs of streams that began from such windows and hear the same noise under a steady hand: the time after which they
differ by less than 1 % of what they play, and stay so.
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
from foten.render.closed_loop import ClosedLoop
from foten.render.engine import engine_for
from foten.render.synthesizer import Synthesizer
from foten.texture_file import Texture, read_texture
from foten.whole_file import whole_file

LARGEST_NOISE = 5.68  # standard deviations, of the counter-based generator


def strokes(rate_hz: float, seconds: float, n_streams: int) -> tuple[np.ndarray, np.ndarray]:
    """Return speed [mm/s] and force [N] of independent hands, shapes (n_streams, n)."""
    hands = [stroking(seconds, 10_000 + seed, rate_hz) for seed in range(n_streams)]
    return np.stack([hand.speed for hand in hands]), np.stack([hand.force for hand in hands])


def into(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return values stretched onto a range, each stream by itself."""
    least, most = values.min(axis=1, keepdims=True), values.max(axis=1, keepdims=True)
    return low + (values - least) / (most - least) * (high - low)


def attack(texture: Texture, n_steps: int, n_streams: int = 250) -> dict[str, float | bool]:
    """Return the largest sample of an attack [sd], whether all were finite, and how long two windows are told apart [s]."""
    rng = np.random.default_rng(0)
    engine = engine_for(texture)
    scaling = texture.scaling
    corners = np.array(
        [[v, f] for v in texture.trained_range("speed") for f in texture.trained_range("force")]
    )
    corners = (corners - scaling.mean[1:]) / np.array(scaling.sd[1:])
    windows = rng.standard_normal((n_streams, texture.window, 3))
    windows[..., 0] = 50.0 * rng.choice([-1.0, 1.0], windows.shape[:2])
    loop = ClosedLoop(engine.start(windows))
    largest, finite = 0.0, True
    for _ in range(-(-n_steps // n_streams)):
        noise = LARGEST_NOISE * rng.choice([-1.0, 1.0], n_streams) if texture.has_excitation else None
        sample = loop.step(corners[rng.integers(0, len(corners), n_streams)], noise)
        finite &= bool(np.isfinite(sample).all())
        largest = max(largest, float(np.abs(sample).max()))
    n_pairs = 8
    n = round(6.0 * texture.rate_hz)
    hand = np.broadcast_to(corners.mean(axis=0), (2 * n_pairs, n, 2))
    drawn = rng.standard_normal((n_pairs, n))
    both = ClosedLoop(engine.start(windows[: 2 * n_pairs])).run(
        hand, np.concatenate([drawn, drawn]) if texture.has_excitation else None
    )
    played = both[:, n // 2 :].std()
    apart = np.abs(both[:n_pairs] - both[n_pairs:]).max(axis=0)
    told = np.flatnonzero(apart > 0.01 * played)
    return {
        "attack_steps": n_steps,
        "attack_max_sd": largest,
        "attack_finite": finite,
        "forgets_s": float((told[-1] + 1) / texture.rate_hz) if told.size else 0.0,
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("textures", nargs="+", type=Path)
    parser.add_argument(
        "--minutes", type=float, default=10.0, help="in each of the two kinds of strokes together"
    )
    parser.add_argument("--streams", type=int, default=60)
    parser.add_argument("--attack", type=int, default=1_000_000, help="steps, over all streams")
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
            **attack(texture, arguments.attack),
        }
        failed |= not result["attack_finite"]
        failed |= not result["finite"] or result["n_saturated"] > 0
        if arguments.save is not None:
            arguments.save.mkdir(parents=True, exist_ok=True)
            with whole_file(arguments.save / f"{path.stem}.json") as part:
                part.write_text(json.dumps(result, indent=1) + "\n")
        print(
            f"{result['texture']:36s} max {result['max_sd']:6.2f} sd (recorded {result['recorded_peak_sd']:.2f}), "
            f"rms {result['rms_sd']:.2f} sd, {result['n_saturated']} saturated, rest {result['rest_m_s2']:g} m/s², "
            f"{result['times_real_time']:.1f} × real time; attacked: max {result['attack_max_sd']:.3g} sd, "
            f"forgets in {result['forgets_s']:.2g} s",
            flush=True,
        )
    sys.exit(int(failed))


if __name__ == "__main__":
    main()
