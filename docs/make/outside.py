"""Above the trained range, towards rest and under jumps: clamp, fade or grow, whichever is nearest the simulated truth.

    python docs/make/outside.py [--textures a,b]

Each simulated texture is recorded under a hand that uses half of the range (0 to 175 mm/s, 0.05 to 2 N), trained without a
network, and rendered under another hand that uses all of it and, once more, under speeds and forces that jump every half
second. Frames of 40 ms of the rendering and of the truth are compared where the hand was: level bias, level error and the
distance of the pooled spectra. `grow` is what a rendering does; `clamp` hands it the range's end, `fade` takes that
down again by the factor that the range was exceeded by.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from foten.dsp.level import FRAME_MS, frame_levels, frame_means
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import Texture
from foten.models.trainable import recipe_of, train
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.recording import Channel, Recording
from foten.recording.trace import Trace
from foten.reporting.table import Table
from foten.runtime.loops import render_strokes
from foten.runtime.native import NativeTexture
from foten.simulation.simulate import ACCELEROMETER_NOISE, TEXTURES, vibration
from foten.simulation.stroking import Stroking, stroking
from foten.training.job import TrainingJob

CSV = Path(__file__).resolve().parents[1] / "results" / "outside.csv"
RATE_HZ = 10_000.0
N_STREAMS = 5
POLICIES = ("clamp", "fade", "grow")


def recorded(key: str, stroke: Stroking, seed: int) -> Recording:
    """What the sensors would have recorded of a hand, speed and force known exactly."""
    rng = np.random.default_rng([seed, *key.encode()])
    acceleration = vibration(TEXTURES[key], stroke, rng)
    acceleration += rng.normal(0, ACCELEROMETER_NOISE * np.sqrt(RATE_HZ / 2), acceleration.shape)
    channels = {
        f"acceleration_{axis}": Channel(np.ascontiguousarray(column), RATE_HZ)
        for axis, column in zip("xyz", acceleration.T, strict=True)
    }
    channels |= {"speed": Channel(stroke.speed, RATE_HZ), "force": Channel(stroke.force, RATE_HZ)}
    return Recording(channels, texture=key)


def halved(stroke: Stroking) -> Stroking:
    """Hand half as fast and half as firm."""
    return dataclasses.replace(
        stroke, position=0.5 * stroke.position, velocity=0.5 * stroke.velocity, force=0.5 * stroke.force
    )


def jumping(seconds: float, seed: int) -> Stroking:
    """Hand whose speed and force take another value every half second, in all of its range."""
    rng = np.random.default_rng(seed)
    n, held = round(seconds * RATE_HZ), round(0.5 * RATE_HZ)
    n_values = n // held + 1
    speed = np.repeat(rng.uniform(20, 340, n_values), held)[:n]
    force = np.repeat(rng.uniform(0.2, 3.0, n_values), held)[:n]
    velocity = np.stack([speed, np.zeros(n)], axis=1)
    return Stroking(RATE_HZ, np.cumsum(velocity, axis=0) / RATE_HZ, velocity, force, np.zeros((n, 2)))


def rendered(texture: Texture, trace: Trace) -> dict[str, np.ndarray]:
    """Renderings of a trace's hand by policy, each (N_STREAMS, n)."""
    speed, force = (
        np.minimum(channel, texture.trained_range(name)[1])
        for name, channel in (("speed", trace.speed), ("force", trace.force))
    )

    def streams(speed: np.ndarray, force: np.ndarray) -> np.ndarray:
        hands = (np.tile(channel, (N_STREAMS, 1)) for channel in (speed, force))
        return render_strokes(NativeTexture(texture.to_bytes()), 0, *hands)[0]

    clamped = streams(speed, force)
    exceeded = np.maximum(trace.speed, speed + 1e-9) / (speed + 1e-9)
    exceeded *= np.maximum(trace.force, force + 1e-9) / (force + 1e-9)
    grown = streams(trace.speed, trace.force)
    return dict(zip(POLICIES, (clamped, clamped / exceeded, grown), strict=True))


def pooled(frames: np.ndarray) -> np.ndarray:
    """Mean power spectrum of frames (…, k), 25 to 450 Hz."""
    power = np.abs(np.fft.rfft(frames * np.hanning(frames.shape[-1]), axis=-1)) ** 2
    return power.reshape(-1, power.shape[-1]).mean(axis=0)[1:19]


def figures(truth: np.ndarray, ours: np.ndarray, where: np.ndarray, rate_hz: float) -> dict[str, float]:
    """Bias, error and spectral distance [dB] over the frames `where`: (n,), (streams, n), (frames,)."""
    frame = round(FRAME_MS * rate_hz / 1000)
    cut = [x[..., : len(where) * frame].reshape(*x.shape[:-1], -1, frame)[..., where, :] for x in (truth, ours)]
    levels = [frame_levels(x, rate_hz, 1.0)[..., : len(where)][..., where] for x in (truth, ours)]
    ratio = 10 * np.log10(pooled(cut[1]) / pooled(cut[0]))
    return {
        "frames": int(where.sum()),
        "level_bias_db": float((levels[1] - levels[0]).mean()),
        "level_error_db": float(np.abs(levels[1] - levels[0]).mean()),
        "lsd_db": float(np.sqrt(np.square(ratio).mean())),
    }


def judge(key: str) -> dict[str, Any]:
    """Figures of one texture by region and policy."""
    config = recipe_of("foten-plus", threads=1, epochs=0)
    half = recorded(key, halved(stroking(64.0, 100, RATE_HZ)), 1)
    texture = train(TrainingJob(half, "foten-plus", FotenPlusSizes(), config)).texture
    high = [texture.trained_range(channel)[1] for channel in ("speed", "force")]
    inside = preprocess(recorded(key, stroking(64.0, 101, RATE_HZ), 2), PreprocessConfig())
    jumps = preprocess(recorded(key, jumping(64.0, 3), 3), PreprocessConfig())
    speed, force = (frame_means(channel, inside.rate_hz) for channel in (inside.speed, inside.force))
    # The frames in which a jump is, every half second, and the next; every other jump falls within a frame.
    at = np.arange(len(frame_means(jumps.speed, jumps.rate_hz)))
    since_jump = (at * FRAME_MS) % 500
    regions = {
        "inside": (inside, (speed > 20) & (speed < high[0]) & (force < high[1])),
        "towards rest": (inside, (speed < 20) & (force < high[1])),
        "faster": (inside, (speed > high[0]) & (force < high[1])),
        "firmer": (inside, (speed > 20) & (speed < high[0]) & (force > high[1])),
        "both": (inside, (speed > high[0]) & (force > high[1])),
        "80 ms from a jump": (jumps, (since_jump < 2 * FRAME_MS) | (since_jump > 500 - FRAME_MS)),
        "later": (jumps, (since_jump >= 4 * FRAME_MS) & (since_jump <= 500 - 2 * FRAME_MS)),
    }
    result: dict[str, Any] = {
        "extrapolation_exponents": dict(texture.card["extrapolation_exponents"]),
        "trained_to": high,
    }
    signals = {id(trace): rendered(texture, trace) for trace in (inside, jumps)}
    for policy in POLICIES:
        result[policy] = {
            name: figures(trace.acceleration, signals[id(trace)][policy], where, trace.rate_hz)
            for name, (trace, where) in regions.items()
            if where.sum() >= 10
        }
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--textures", type=lambda text: text.split(","), default=list(TEXTURES))
    arguments = parser.parse_args()
    cells = [["texture", "policy", "where", "frames", "level_bias_db", "level_error_db", "lsd_db"]]
    for key in arguments.textures:
        figures = judge(key)
        for policy in POLICIES:
            for where, row in figures[policy].items():
                values = [f"{row[name]:.4f}" for name in cells[0][4:]]
                cells.append([key, policy, where, str(row["frames"]), *values])
        print(f"{key}: done", flush=True)
    Table.of(cells[0], cells[1:]).write(CSV)


if __name__ == "__main__":
    main()
