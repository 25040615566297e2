"""Ten minutes of random strokes on texture files, and a million steps of an attack: is it bounded, and does it forget.

    python benchmarks/stability.py TEXTURE.foten... [--minutes 10] [--streams 60] [--attack 1000000] [--save DIR]
    python benchmarks/stability.py --save DIR --page docs/fidelity.md

The strokes are the simulator's hand, 0 to 350 mm/s and 0.1 to 4 N, whatever range the texture was trained in; besides, the same
with speed and force scaled into the trained range, so that narrow recordings are not mostly clamped. Samples are counted in
standard deviations of the training blocks. Fails where one is not finite, or where the saturator had to cut.

The attack: streams that begin from windows at ±50 standard deviations, the excitation's noise at ± the largest that the
generator can draw, in one half at random, in the other always outwards. A third of each switch speed and force to another
corner of the trained range at every sample, a third every 50 ms, a third stay at one corner. The saturator, which bounds
anything, is left out where the loop goes on from the uncut sample. The largest sample of the second half, when the windows are
forgotten, stands beside the bound that docs/fidelity.md proves for any hand and noise; fails where it is larger. Afterwards they
are given ordinary noise and a steady hand for 12 s (3 s at 10 kHz): by how much the stream that differs most is louder or softer,
in the last fifth of it, than one under the same hand and noise that was never attacked. Fails above 0.5 dB. Which way is outwards
is asked of the reference in NumPy; all that is judged is rendered by the kernel, of the same noise.

Besides, pairs of streams that began from such windows, under the same noise, under a slow, a middling, a fast and a moving
hand: the time after which they differ by less than 1 % of what they play, and stay so. Fails where they do not within 12 s (3 s
at 10 kHz).
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from foten.datasets.stroking import stroking
from foten.dsp.lattice import LEAK
from foten.dsp.noise import LARGEST_VOLATILITY
from foten.families import FotenPlusSizes
from foten.families.excitation import HEAVIEST_TAIL
from foten.families.texture_file import Texture, read_texture
from foten.reference import model_of
from foten.runtime.loops import run_loops
from foten.runtime.native import NativeTexture
from foten.runtime.onnx_predictor import OnnxPredictor
from main_table import SOURCES, between, keep, made_earlier, name_of, read, validation_free_run
from streams import rendered

BOUNDED = ("foten-plus", "ar", "gan", "dftnet")  # models that no sample of their own drives further than their bound
LARGEST_NOISE = 5.68  # standard deviations, of the counter-based generator
COMPARED_S, COMPARED = 12.0, 30_000  # two streams that are to meet: seconds, and samples at most
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
    kernel, excited, rate = NativeTexture(texture.to_bytes()), texture.has_excitation, texture.rate_hz
    corners = np.array([[v, f] for v in texture.trained_range("speed") for f in texture.trained_range("force")])
    corners = (corners - texture.scaling.mean[1:]) / np.array(texture.scaling.sd[1:])
    windows = rng.standard_normal((n_streams, texture.window, 3))
    windows[..., 0] = 50.0 * rng.choice([-1.0, 1.0], windows.shape[:2])
    n, each = -(-n_steps // n_streams), np.arange(n_streams)
    where = np.empty((n, n_streams), dtype=int)
    at = rng.integers(0, len(corners), n_streams)
    for i in range(n):
        switched = (each % 3 == 0) | ((each % 3 == 1) & (i % max(1, round(0.05 * rate)) == 0))
        where[i] = at = np.where(switched, rng.integers(0, len(corners), n_streams), at)
    n_after = min(COMPARED, round(COMPARED_S * rate))
    middle = np.broadcast_to(corners.mean(axis=0), (n_streams, n_after, 2))
    hand = with_path(texture, np.concatenate([corners[where.T], middle], axis=1))
    # What goes on from its own samples whatever they are needs no saturator, and is attacked without one.
    limit = np.inf if texture.card["model"] in BOUNDED else float(texture.card["saturation"])
    noise = ordinary = None
    if excited:
        ordinary = rng.standard_normal(hand.shape[:2])
        noise = ordinary.copy()
        noise[:, :n] = outwards(texture, windows, hand[:, :n], limit, rng)
    attacked = run_loops(kernel, windows, hand, noise, limit)
    largest = [float(np.abs(part).max()) for part in (attacked[:, : n // 2], attacked[:, n // 2 : n])]
    # Under the same hand all the time, so that it is at the same place of a surface that repeats.
    warm = np.tile(texture.tensors["warm_start"].astype(float), (n_streams, 1, 1))
    untouched = run_loops(kernel, warm, hand, ordinary, limit)
    after, usual = (np.square(one[:, -(n_after // 5) :]).mean(axis=1) for one in (attacked, untouched))
    return {
        "attack_steps": n * n_streams,
        "attack_max_sd": largest[0],
        "attack_later_max_sd": largest[1],
        "attack_bound_sd": proven(texture),
        "attack_finite": bool(np.isfinite(attacked).all()),
        "attack_after_db": float(np.abs(10 * np.log10(after / usual)).max()) if excited else None,
        "forgets_s": forgetting(texture, windows[:8], corners, rng),
    }


def with_path(texture: Texture, condition: np.ndarray) -> np.ndarray:
    """Return scaled speed and force (s, n, 2) with the speed that tones go by [mm/s], (s, n, 3)."""
    speed = condition[..., :1] * texture.scaling.sd[1] + texture.scaling.mean[1]
    return np.concatenate([condition, np.maximum(speed, 0.0)], axis=2)


def outwards(
    texture: Texture, windows: np.ndarray, hand: np.ndarray, limit: float, rng: np.random.Generator
) -> np.ndarray:
    """Return the largest noise that the generator draws, of every other stream with the sign of what is predicted, (s, n)."""
    sizes = texture.sizes
    network = OnnxPredictor(sizes, texture.tensors).ahead if sizes.in_graph else None
    stream = model_of(sizes, texture.tensors, network).start(windows)
    noise = LARGEST_NOISE * rng.choice([-1.0, 1.0], hand.shape[:2])
    for i in range(hand.shape[1]):
        predicted = stream.predict()
        noise[1::2, i] = LARGEST_NOISE * np.where(predicted.sample[1::2] >= 0, 1.0, -1.0)
        sample = predicted.excited(noise[:, i])
        stream.push(sample if stream.bounded else np.clip(sample, -limit, limit), hand[:, i], noise[:, i])
    return noise


def proven(texture: Texture) -> float | None:
    """Return what no sample of a closed loop exceeds [sd], whatever hand and noise: docs/fidelity.md; None for other models."""
    sizes, tensors = texture.sizes, texture.tensors
    if not isinstance(sizes, FotenPlusSizes):
        return None
    _, volatility = map(float, tensors["excitation.volatility"])
    heaviest = LARGEST_NOISE * np.exp(0.5 * HEAVIEST_TAIL * LARGEST_NOISE**2)
    shock = float(tensors["excitation.highest"].item()) * min(heaviest, float(tensors["excitation.largest"][0]))
    entering = (sizes.correction_limit if sizes.renders_with_network else 0.0) + shock * np.exp(
        (LARGEST_VOLATILITY - volatility) * volatility
    )
    level = float(tensors[f"{'residual' if sizes.n_tones else 'lattice'}.level.highest"].item())
    bound = level * entering / np.sqrt(1 - LEAK**2)
    if sizes.n_tones:
        cosines, sines = np.moveaxis(tensors["tones.values"].reshape(-1, sizes.n_tones, 2), -1, 0)
        loudest = np.hypot(cosines, sines).sum(axis=-1).max()
        bound += float(tensors["lattice.level.highest"].item()) * float(loudest)
    return float(bound)


def forgetting(texture: Texture, windows: np.ndarray, corners: np.ndarray, rng: np.random.Generator) -> float | None:
    """Return after how long streams under the same noise are the same to 1 %, whatever they began with [s]; None for never."""
    rate, n_pairs = texture.rate_hz, len(windows) // 2
    n = min(COMPARED, round(COMPARED_S * rate))
    turning = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(n) / rate)[:, None]
    slow, fast = corners.min(axis=0), corners.max(axis=0)
    hands = [slow + share * (fast - slow) * np.ones((n, 1)) for share in (0.1, 0.5, 1.0)]
    hands.append(slow + turning * (fast - slow))
    condition = np.tile(np.repeat(np.stack(hands), n_pairs, axis=0), (2, 1, 1))
    drawn = rng.standard_normal((len(hands) * n_pairs, n))
    starts = [np.tile(part, (len(hands), 1, 1)) for part in (windows[:n_pairs], windows[n_pairs:])]
    both = run_loops(
        NativeTexture(texture.to_bytes()),
        np.concatenate(starts),
        with_path(texture, condition),
        np.concatenate([drawn, drawn]) if texture.has_excitation else None,
    )
    one, other = both.reshape(2, len(hands), n_pairs, n)
    size = other[:, :, n // 2 :].std(axis=(1, 2))
    differ = np.flatnonzero((np.abs(one - other).max(axis=1) > 0.01 * size[:, None]).any(axis=0))
    if not differ.size:
        return 0.0
    return None if differ[-1] >= 0.95 * n else float((differ[-1] + 1) / rate)


def _with_unit(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.2g} {unit}"


def table(folder: Path) -> str:
    """Return what is saved as Markdown."""
    titles = (
        *("texture", "rate [kHz]", "network", "recorded peak", "strokes peak", "saturated samples"),
        *("attack peak", "later", "proven bound", "afterwards [dB]", "forgets [s]"),
    )
    lines = [f"| {' | '.join(titles)} |", "|" + "---|" * len(titles)]
    for path in sorted(folder.glob("*.json")):
        result = read(path)
        after, forgets = result["attack_after_db"], result["forgets_s"]
        cells = [
            name_of(result, folder.name),
            f"{result['rate_hz'] / 1000:g}",
            "in the loop" if result["network_in_loop"] else "",
            f"{result['recorded_peak_sd']:.1f}",
            f"{result['max_sd']:.1f}",
            f"{result['n_saturated']} of {result['samples']:,}",
            f"{result['attack_max_sd']:.0f}",
            f"{result['attack_later_max_sd']:.0f}",
            "–" if result["attack_bound_sd"] is None else f"{result['attack_bound_sd']:.0f}",
            "–" if after is None else f"{after:.2f}",
            "never" if forgets is None else f"{forgets:.2f}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, *made_earlier(folder)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("textures", nargs="*", type=Path)
    parser.add_argument("--minutes", type=float, default=10.0, help="of strokes of both kinds")
    parser.add_argument("--streams", type=int, default=60)
    parser.add_argument("--attack", type=int, default=1_000_000, help="steps, over all streams")
    parser.add_argument("--save", type=Path, metavar="DIR", help="keep each result as JSON there")
    parser.add_argument("--page", type=Path, metavar="FILE", help="put what is saved between its markers in this file")
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
            "network_in_loop": bool(validation_free_run(texture).get("network_in_loop")),
            "samples": played.size,
            "finite": bool(np.isfinite(played).all()),
            "max_sd": float(np.abs(played).max() / texture.scaling.sd[0]),
            "rms_sd": float(np.sqrt(np.square(played).mean()) / texture.scaling.sd[0]),
            "n_saturated": n_saturated,
            "recorded_peak_sd": texture.card["metrics"]["recorded_peak_sd"],
            "still_m_s2": float(np.abs(still).max()),
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
            f"rms {result['rms_sd']:.2f} sd, {result['n_saturated']} saturated, still {result['still_m_s2']:g} m/s², "
            f"{result['times_real_time']:.1f} × real time; attacked: max {result['attack_max_sd']:.3g} sd, "
            f"later {result['attack_later_max_sd']:.3g}, at most {_with_unit(result['attack_bound_sd'], 'sd')} by proof, "
            f"{_with_unit(result['attack_after_db'], 'dB')} afterwards, "
            f"forgets in {_with_unit(result['forgets_s'], 's')}",
            flush=True,
        )
    if arguments.page is not None:
        between(arguments.page, "stability", table(arguments.save))
    sys.exit(int(failed))


if __name__ == "__main__":
    main()
