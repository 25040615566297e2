"""Stability of a texture file under random strokes and under attack: is it bounded, and does it forget."""

from typing import Any

import numpy as np

from foten.dsp import Array
from foten.dsp.equaliser import Equaliser
from foten.dsp.lattice import LEAK
from foten.models.definitions import model_of
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.registry import GRAPH
from foten.models.texture_file import Texture
from foten.runtime.loops import render_streams, render_strokes
from foten.runtime.native import NativeTexture
from foten.runtime.onnx_predictor import model_of_graph
from foten.simulation.stroking import stroking

MAX_NOISE = 5.68  # standard deviations, of the counter-based generator
COMPARED_S, COMPARED = 12.0, 30_000  # two streams that are to meet: seconds, and samples at most
MINUTES, N_STROKES = 10.0, 60  # of strokes in all, and into how many they are divided
N_ATTACK, N_ATTACKED = 1_000_000, 24  # steps in all, and streams


def stability(texture: Texture, minutes: float = MINUTES, n_attack: int = N_ATTACK) -> dict[str, Any]:
    """Largest samples of a texture under strokes and under attack [sd of the training blocks], and whether it forgets.

    The strokes are the simulator's, 0 to 350 mm/s and 0.1 to 4 N; half of them are scaled into the trained range.

    Returns:
        `max_sd`, `n_saturated`, `n_samples`: of the strokes; `recorded_max_sd`; and those of `attack`.
    """
    paths = [stroking(minutes * 60 / N_STROKES, 10_000 + seed, texture.rate_hz) for seed in range(N_STROKES)]
    speed, force = np.stack([path.speed for path in paths]), np.stack([path.force for path in paths])
    half = N_STROKES // 2
    speed[half:] = into(speed[half:], *texture.trained_range("speed"))
    force[half:] = into(force[half:], *texture.trained_range("force"))
    rendered, n_saturated = render_strokes(NativeTexture(texture.to_bytes()), 1, speed, force)
    return {
        "n_samples": rendered.size,
        "recorded_max_sd": texture.card["metrics"]["recorded_peak_sd"],
        "max_sd": float(np.abs(rendered).max() / texture.scaling.sd[0]),
        "n_saturated": n_saturated,
        **attack(texture, n_attack),
    }


def into(values: Array, low: float, high: float) -> Array:
    """Values stretched onto a range, each stream by itself."""
    lowest, highest = values.min(axis=1, keepdims=True), values.max(axis=1, keepdims=True)
    return low + (values - lowest) / (highest - lowest) * (high - low)


def attack(texture: Texture, n_steps: int, n_streams: int = N_ATTACKED) -> dict[str, Any]:
    """Figures of streams that begin from windows at ±50 standard deviations.

    The noise is ± the largest that the generator draws, in half of the streams with the sign of the prediction. A third of the
    streams switch to another corner of the trained range at every sample, a third every 50 ms. Then follows ordinary noise under
    a steady stroke, 12 s (3 s at 10 kHz).

    Returns:
        `attack_later_max_sd`: of the second half; `attack_bound_sd`: what is proven, or None; `attack_after_db`: level of the
        last fifth of the steady stroke beside that of streams that were not attacked; `forgets_s`: None for never.
    """
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
    path = with_path(texture, np.concatenate([corners[where.T], middle], axis=1))
    limit = np.inf if texture.sizes.bounded or not texture.predicts_samples else float(texture.card["saturation"])
    noise = ordinary = None
    if excited:
        ordinary = rng.standard_normal(path.shape[:2])
        noise = ordinary.copy()
        noise[:, :n] = outwards(texture, windows, path[:, :n], limit, rng)
    attacked = render_streams(kernel, windows, path, noise, limit)
    # Under the same path, so that it is at the same place of a surface that repeats.
    warm = np.tile(texture.tensors["warm_start"].astype(float), (n_streams, 1, 1))
    untouched = render_streams(kernel, warm, path, ordinary, limit)
    after, usual = (np.square(run[:, -(n_after // 5) :]).mean(axis=1) for run in (attacked, untouched))
    return {
        "attack_later_max_sd": float(np.abs(attacked[:, n // 2 : n]).max()),
        "attack_bound_sd": proven(texture),
        "attack_after_db": float(np.abs(10 * np.log10(after / usual)).max()) if excited else None,
        "forgets_s": forgetting(texture, windows[:8], corners, rng),
    }


def with_path(texture: Texture, condition: Array) -> Array:
    """Scaled speed and force (s, n, 2) with the speed that tones go by [mm/s], (s, n, 3)."""
    speed = condition[..., :1] * texture.scaling.sd[1] + texture.scaling.mean[1]
    return np.concatenate([condition, np.maximum(speed, 0.0)], axis=2)


def outwards(texture: Texture, windows: Array, path: Array, limit: float, rng: np.random.Generator) -> Array:
    """Largest noise that the generator draws, (s, n): of every other stream with the sign of the prediction, else at random."""
    model = model_of_graph(texture) if GRAPH in texture.tensors else model_of(texture.sizes, texture.tensors)
    stream = model.start(windows)
    noise = MAX_NOISE * rng.choice([-1.0, 1.0], path.shape[:2])
    for i in range(path.shape[1]):
        predicted = stream.predict()
        noise[1::2, i] = MAX_NOISE * np.where(predicted.sample[1::2] >= 0, 1.0, -1.0)
        sample = predicted.excited(noise[:, i])
        stream.push(sample if stream.bounded else np.clip(sample, -limit, limit), path[:, i], noise[:, i])
    return noise


def proven(texture: Texture) -> float | None:
    """Bound of every sample of a closed loop [sd], under any stroke and noise; None for a model without a proof."""
    sizes, tensors = texture.sizes, texture.tensors
    if not isinstance(sizes, FotenPlusSizes):
        return None
    largest = np.inf if sizes.recorded else MAX_NOISE
    entering = float(tensors["excitation.sigma_max"].item()) * min(
        largest, float(tensors["excitation.innovation_limit"][0])
    )
    level = float(tensors[f"{'residual' if sizes.n_tones else 'lattice'}.level.sigma_max"].item())
    bound = level * entering / np.sqrt(1 - LEAK**2)
    if sizes.n_tones:
        cosines, sines = np.moveaxis(tensors["tones.values"].reshape(-1, sizes.n_tones, 2), -1, 0)
        loudest = np.hypot(cosines, sines).sum(axis=-1).max()
        bound += float(tensors["lattice.level.sigma_max"].item()) * float(loudest)
    return float(bound) * (Equaliser.of(tensors).bound() if sizes.equalised else 1.0)


def forgetting(texture: Texture, windows: Array, corners: Array, rng: np.random.Generator) -> float | None:
    """Time after which pairs of streams under the same noise differ by less than 1 % of their level [s]; None for never.

    Under slow, middling, fast and moving strokes.
    """
    rate, n_pairs = texture.rate_hz, len(windows) // 2
    n = min(COMPARED, round(COMPARED_S * rate))
    turning = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(n) / rate)[:, None]
    slow, fast = corners.min(axis=0), corners.max(axis=0)
    paths = [slow + share * (fast - slow) * np.ones((n, 1)) for share in (0.1, 0.5, 1.0)]
    paths.append(slow + turning * (fast - slow))
    condition = np.tile(np.repeat(np.stack(paths), n_pairs, axis=0), (2, 1, 1))
    drawn = rng.standard_normal((len(paths) * n_pairs, n))
    starts = [np.tile(part, (len(paths), 1, 1)) for part in (windows[:n_pairs], windows[n_pairs:])]
    both = render_streams(
        NativeTexture(texture.to_bytes()),
        np.concatenate(starts),
        with_path(texture, condition),
        np.concatenate([drawn, drawn]) if texture.has_excitation else None,
    )
    first, other = both.reshape(2, len(paths), n_pairs, n)
    size = other[:, :, n // 2 :].std(axis=(1, 2))
    differ = np.flatnonzero((np.abs(first - other).max(axis=1) > 0.01 * size[:, None]).any(axis=0))
    if not differ.size:
        return 0.0
    return None if differ[-1] >= 0.95 * n else float((differ[-1] + 1) / rate)
