"""Ten minutes of random strokes on texture files, and a million steps of an attack: is it bounded, and does it forget.

    python benchmarks/stability.py TEXTURE.foten... [--minutes 10] [--streams 60] [--attack 1000000] [--save DIR]
    python benchmarks/stability.py --save DIR --page docs/fidelity.md

The strokes are the simulator's hand, 0 to 350 mm/s and 0.1 to 4 N, whatever range the texture was trained in; besides, the same
with speed and force scaled into the trained range, so that narrow recordings are not mostly clamped. Samples are counted in
standard deviations of the training blocks. Fails where one is not finite, or where the saturator had to cut.

The attack: streams that begin from windows at ±50 standard deviations, the excitation's noise at ± the largest that the
generator can draw, in one half at random, in the other always outwards. A third of each switch speed and force to another
corner of the trained range at every sample, a third every 50 ms, a third stay at one corner. The saturator, which bounds
anything, is left out where the loop does not hear it. The largest sample of the second half, when the windows are forgotten,
stands beside the bound that docs/fidelity.md proves for any hand and noise; fails where it is larger. Afterwards they are given
ordinary noise and a steady hand for 12 s (3 s at 10 kHz): by how much the stream that differs most is louder or softer, in the
last fifth of it, than one that was never attacked and hears the same noise. Fails above 0.5 dB.

Besides, pairs of streams that began from such windows and hear the same noise, under a slow, a middling, a fast and a moving
hand: the time after which they differ by less than 1 % of what they play, and stay so. Fails where they do not within 12 s (3 s
at 10 kHz).
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from foten.architecture import HEAVIEST_TAIL
from foten.runtime.closed_loop import ClosedLoop
from foten.runtime.engine import ToneState, engine_for

from foten.datasets.stroking import stroking
from foten.dsp.lattice import LEAK
from foten.dsp.noise import LARGEST_VOLATILITY
from foten.families.texture_file import Texture, read_texture
from main_table import SOURCES, audible_share, between, keep, made_earlier, name_of
from streams import rendered

LARGEST_NOISE = 5.68  # standard deviations, of the counter-based generator
LISTENED_S, LISTENED = 12.0, 30_000  # to two streams that are to meet: seconds, and samples at most
MAY_DIFFER_DB = 0.5  # afterwards


def strokes(rate_hz: float, seconds: float, n_streams: int) -> tuple[np.ndarray, np.ndarray]:
    """Return speed [mm/s] and force [N] of independent hands, shapes (n_streams, n)."""
    hands = [stroking(seconds, 10_000 + seed, rate_hz) for seed in range(n_streams)]
    return np.stack([hand.speed for hand in hands]), np.stack([hand.force for hand in hands])


def into(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return values stretched onto a range, each stream by itself."""
    least, most = values.min(axis=1, keepdims=True), values.max(axis=1, keepdims=True)
    return low + (values - least) / (most - least) * (high - low)


def attack(texture: Texture, n_steps: int, n_streams: int = 24) -> dict[str, Any]:
    """Return the largest sample of an attack [sd], whether all were finite, and what the streams are like afterwards."""
    rng = np.random.default_rng(0)
    engine = engine_for(texture)
    scaling = texture.scaling
    corners = np.array(
        [[v, f] for v in texture.trained_range("speed") for f in texture.trained_range("force")]
    )
    corners = (corners - scaling.mean[1:]) / np.array(scaling.sd[1:])
    windows = rng.standard_normal((n_streams, texture.window, 3))
    windows[..., 0] = 50.0 * rng.choice([-1.0, 1.0], windows.shape[:2])
    start, each = engine.start(windows), np.arange(n_streams)
    excited, rate = texture.has_excitation, texture.rate_hz
    where = rng.integers(0, len(corners), n_streams)
    n = -(-n_steps // n_streams)
    largest, finite = [0.0, 0.0], True
    loop = ClosedLoop(start, np.inf if start.bounded else float(texture.card["saturation"]))
    for i in range(n):
        switched = (each % 3 == 0) | ((each % 3 == 1) & (i % max(1, round(0.05 * rate)) == 0))
        where = np.where(switched, rng.integers(0, len(corners), n_streams), where)
        noise = None
        if excited:
            outwards = np.where(loop.state.forecast().sample >= 0, 1.0, -1.0)
            noise = LARGEST_NOISE * np.where(each % 2 == 0, rng.choice([-1.0, 1.0], n_streams), outwards)
        sample = loop.step(corners[where], noise)
        finite &= bool(np.isfinite(sample).all())
        half = int(i >= n // 2)
        largest[half] = max(largest[half], float(np.abs(sample).max()))
    listened = min(LISTENED, round(LISTENED_S * rate))
    middle = np.broadcast_to(corners.mean(axis=0), (n_streams, listened, 2))
    drawn = rng.standard_normal(middle.shape[:2]) if excited else None
    untouched = engine.start(np.tile(texture.tensors["warm_start"].astype(float), (n_streams, 1, 1)))
    if isinstance(untouched, ToneState) and isinstance(loop.state, ToneState):
        # At the same place of the surface, which repeats: the path is what the hand did, and is not to be forgotten.
        untouched.phase = untouched.phase + loop.state.path - untouched.path
        untouched.path = loop.state.path.copy()
        untouched._listen(untouched.condition)
    after, ordinary = (
        np.square(one.run(middle, drawn)[:, -listened // 5 :]).mean(axis=1)
        for one in (loop, ClosedLoop(untouched))
    )
    return {
        "attack_steps": n * n_streams,
        "attack_max_sd": largest[0],
        "attack_later_max_sd": largest[1],
        "attack_bound_sd": proven(texture),
        "attack_finite": finite,
        "attack_after_db": float(np.abs(10 * np.log10(after / ordinary)).max()) if excited else None,
        "forgets_s": forgetting(texture, windows[:8], corners, rng),
    }


def proven(texture: Texture) -> float | None:
    """Return what no sample of a closed loop exceeds [sd], whatever hand and noise: docs/fidelity.md; None for `foten`."""
    if texture.card["model"] != "foten-plus":
        return None
    tensors, architecture = texture.tensors, texture.architecture
    heard = architecture.network_heard and not architecture.n_tones
    _, swell = map(float, tensors["excitation.swell"])
    heaviest = LARGEST_NOISE * np.exp(0.5 * HEAVIEST_TAIL * LARGEST_NOISE**2)
    shock = float(tensors["excitation.highest"].item()) * min(
        heaviest, float(tensors["excitation.largest"][0])
    )
    driven = (architecture.correction_limit if heard else 0.0) + shock * np.exp(
        (LARGEST_VOLATILITY - swell) * swell
    )
    level = float(tensors[f"{'rest' if architecture.n_tones else 'lattice'}.level.highest"].item())
    bound = level * driven / np.sqrt(1 - LEAK**2)
    if architecture.n_tones:
        cosines, sines = np.moveaxis(tensors["tones.values"].reshape(-1, architecture.n_tones, 2), -1, 0)
        loudest = np.hypot(cosines, sines).sum(axis=-1).max()
        bound += float(tensors["lattice.level.highest"].item()) * float(loudest)
    return float(bound)


def forgetting(
    texture: Texture, windows: np.ndarray, corners: np.ndarray, rng: np.random.Generator
) -> float | None:
    """Return after how long streams under the same noise are the same to 1 %, whatever they began with [s]; None for never."""
    rate, n_pairs = texture.rate_hz, len(windows) // 2
    n = min(LISTENED, round(LISTENED_S * rate))
    turning = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(n) / rate)[:, None]
    slow, fast = corners.min(axis=0), corners.max(axis=0)
    hands = [slow + share * (fast - slow) * np.ones((n, 1)) for share in (0.1, 0.5, 1.0)]
    hands.append(slow + turning * (fast - slow))
    condition = np.tile(np.repeat(np.stack(hands), n_pairs, axis=0), (2, 1, 1))
    drawn = rng.standard_normal((len(hands) * n_pairs, n))
    begun = [np.tile(part, (len(hands), 1, 1)) for part in (windows[:n_pairs], windows[n_pairs:])]
    both = ClosedLoop(engine_for(texture).start(np.concatenate(begun))).run(
        condition, np.concatenate([drawn, drawn]) if texture.has_excitation else None
    )
    one, other = both.reshape(2, len(hands), n_pairs, n)
    played = other[:, :, n // 2 :].std(axis=(1, 2))
    told = np.flatnonzero((np.abs(one - other).max(axis=1) > 0.01 * played[:, None]).any(axis=0))
    if not told.size:
        return 0.0
    return None if told[-1] >= 0.95 * n else float((told[-1] + 1) / rate)


def _told(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.2g} {unit}"


def table(folder: Path) -> str:
    """Return what is saved as Markdown."""
    titles = (
        *("texture", "rate [kHz]", "network", "recorded peak", "strokes peak", "saturated samples"),
        *("attack peak", "later", "proven bound", "afterwards [dB]", "forgets [s]"),
    )
    lines = [f"| {' | '.join(titles)} |", "|" + "---|" * len(titles)]
    for path in sorted(folder.glob("*.json")):
        found = json.loads(path.read_text())
        after, forgets = found["attack_after_db"], found["forgets_s"]
        cells = [
            name_of(found, folder.name),
            f"{found['rate_hz'] / 1000:g}",
            "heard" if found["network_heard"] else "",
            f"{found['recorded_peak_sd']:.1f}",
            f"{found['max_sd']:.1f}",
            f"{found['n_saturated']} of {found['samples']:,}",
            f"{found['attack_max_sd']:.0f}",
            f"{found['attack_later_max_sd']:.0f}",
            "–" if found["attack_bound_sd"] is None else f"{found['attack_bound_sd']:.0f}",
            "–" if after is None else f"{after:.2f}",
            "never" if forgets is None else f"{forgets:.2f}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, *made_earlier(folder)])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("textures", nargs="*", type=Path)
    parser.add_argument(
        "--minutes", type=float, default=10.0, help="in each of the two kinds of strokes together"
    )
    parser.add_argument("--streams", type=int, default=60)
    parser.add_argument("--attack", type=int, default=1_000_000, help="steps, over all streams")
    parser.add_argument("--save", type=Path, metavar="DIR", help="keep each result as JSON there")
    parser.add_argument(
        "--page", type=Path, metavar="FILE", help="put what is saved between its markers in this file"
    )
    arguments = parser.parse_args()
    if not arguments.textures and arguments.page is None:
        parser.error("no texture file was given")
    seconds = arguments.minutes * 60 / arguments.streams
    failed = False
    for path in arguments.textures:
        texture = read_texture(path)
        speed, force = strokes(texture.rate_hz, seconds, arguments.streams)
        half = arguments.streams // 2
        speed[half:] = into(speed[half:], *texture.trained_range("speed"))
        force[half:] = into(force[half:], *texture.trained_range("force"))
        started = time.perf_counter()
        played, n_saturated = rendered(texture, 1, speed, force)
        elapsed = time.perf_counter() - started
        still, _ = rendered(texture, 1, np.zeros((1, 1000)), np.ones((1, 1000)))
        result = {
            "file": path.stem,
            "texture_sha256": texture.sha256(),
            "source_sha256": SOURCES,
            "rate_hz": texture.rate_hz,
            "network_heard": bool(audible_share(texture).get("network")),
            "samples": played.size,
            "finite": bool(np.isfinite(played).all()),
            "max_sd": float(np.abs(played).max() / texture.scaling.sd[0]),
            "rms_sd": float(np.sqrt(np.square(played).mean()) / texture.scaling.sd[0]),
            "n_saturated": n_saturated,
            "recorded_peak_sd": texture.card["metrics"]["recorded_peak_sd"],
            "rest_m_s2": float(np.abs(still).max()),
            "times_real_time": arguments.minutes * 60 / elapsed,
            **attack(texture, arguments.attack),
        }
        failed |= not result["attack_finite"]
        if texture.has_excitation:
            bound = result["attack_bound_sd"]
            failed |= bound is not None and result["attack_later_max_sd"] > bound
            failed |= result["forgets_s"] is None or result["attack_after_db"] > MAY_DIFFER_DB
        failed |= not result["finite"] or result["n_saturated"] > 0
        if arguments.save is not None:
            arguments.save.mkdir(parents=True, exist_ok=True)
            keep(arguments.save / f"{path.stem}.json", result)
        print(
            f"{result['file']:36s} max {result['max_sd']:6.2f} sd (recorded {result['recorded_peak_sd']:.2f}), "
            f"rms {result['rms_sd']:.2f} sd, {result['n_saturated']} saturated, rest {result['rest_m_s2']:g} m/s², "
            f"{result['times_real_time']:.1f} × real time; attacked: max {result['attack_max_sd']:.3g} sd, "
            f"later {result['attack_later_max_sd']:.3g}, "
            f"at most {_told(result['attack_bound_sd'], 'sd')} by proof, {_told(result['attack_after_db'], 'dB')} afterwards, "
            f"forgets in {_told(result['forgets_s'], 's')}",
            flush=True,
        )
    if arguments.page is not None:
        between(arguments.page, "stability", table(arguments.save))
    sys.exit(int(failed))


if __name__ == "__main__":
    main()
