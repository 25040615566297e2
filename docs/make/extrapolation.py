"""Speeds and forces that were not recorded: a surface recorded at one speed and force, or under a hand of half the range.

    python docs/make/extrapolation.py few-strokes [--textures a,b] [--hands DIR] [--pens FILE]
    python docs/make/extrapolation.py outside [--textures a,b]

`few-strokes`: what the law of speed and force is worth. Each simulated texture is recorded for 5 s under a hand at about 100 mm/s
and 0.7 N, trained without a network, and rendered under steady hands at twelve other speeds and forces, 8 s each. `before` fades
below the recorded range and holds the level above; `held` holds both; `law` follows v^0.95 f^0.33; `ours` shrinks the recording's
own powers towards it, as training does; `full` is trained on 64 s of a moving hand. Figures are means over conditions; dB. Of
real recordings the level alone is judged: --hands, a folder of .npz files (`speed`, `force`, `accel` at 10 kHz), the faster half
from the slower; --pens, spectra at 15 conditions.

`outside`: clamp, fade or grow, whichever is nearest the simulated truth. Each simulated texture is recorded under a hand that
uses half of the range (0 to 175 mm/s, 0.05 to 2 N), trained without a network, and rendered under another hand that uses all of
it and, once more, under speeds and forces that jump every half second. Frames of 40 ms of the rendering and of the truth are
compared where the hand was: level bias, level error and the distance of the pooled spectra. `grow` is what a rendering does;
`clamp` hands it the range's end, `fade` takes that down again by the factor that the range was exceeded by.
"""

import argparse
import dataclasses
import os
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from csv_records import RESULTS, parser_of
from foten.dsp.distance import log_spectral_distance, scored_bins, welch
from foten.dsp.level import FRAME_MS, frame_levels, frame_means
from foten.models.foten_plus.fit import LAW
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import Texture
from foten.models.trainable import recipe_of, train
from foten.recording.preprocess import PreprocessConfig, fitting_cut, preprocess
from foten.recording.recording import Channel, Recording
from foten.recording.trace import Trace
from foten.reporting.table import Table
from foten.runtime.loops import render_strokes
from foten.runtime.native import NativeTexture
from foten.runtime.renderer import Renderer
from foten.simulation.contact_mechanics import CONTACT, RATE_HZ, contact_vibration, surface_of
from foten.simulation.linear_family import LINEAR_FAMILY, linear_signal
from foten.simulation.simulate import ACCELEROMETER_NOISE, LINEAR_RATE_HZ, TEXTURES, vibration
from foten.simulation.stroking import Stroking, stroking
from foten.training.job import TrainingJob

RECORDED = (100.0, 0.7)  # mm/s and N
CONDITIONS = list(product((30.0, 60.0, 150.0, 200.0), (0.3, 1.0, 2.0)))
SECONDS, JUDGED_SECONDS, FULL_SECONDS = 5.0, 8.0, 64.0
WANDER = (0.04, 0.06)  # standard deviation of log speed and log force of a steady hand
N_STREAMS = 5
POLICIES = ("clamp", "fade", "grow")


def steady(speed: float, force: float, seconds: float, seed: int, rate_hz: float) -> Stroking:
    """A hand at one speed [mm/s] and force [N], as far as a hand is steady."""
    rng, n = np.random.default_rng([seed, 4]), round(seconds * rate_hz)
    at, knots = np.arange(n) / rate_hz, np.arange(0.0, seconds + 0.5, 0.25)
    logs = [np.interp(at, knots, sd * rng.standard_normal(knots.size)) for sd in WANDER]
    v, f = speed * np.exp(logs[0]), force * np.exp(logs[1])
    velocity = np.stack([v, np.zeros(n)], axis=1)
    return Stroking(rate_hz, np.cumsum(velocity, axis=0) / rate_hz, velocity, f, np.zeros((n, 2)))


def recorded(key: str, stroke: Stroking, seed: int) -> Recording:
    """What sensors record of a hand, its speed and force known exactly."""
    rng = np.random.default_rng([seed, *key.encode()])
    force = stroke.force
    if key in LINEAR_FAMILY:
        axes = {"acceleration": linear_signal(LINEAR_FAMILY[key], stroke.speed, force, rng)}
    else:
        if key in CONTACT:
            vibrations, _ = contact_vibration(CONTACT[key], surface_of(CONTACT[key], key), stroke, rng)
        else:
            vibrations = vibration(TEXTURES[key], stroke, rng)
        vibrations = vibrations + rng.normal(0, ACCELEROMETER_NOISE * np.sqrt(stroke.rate_hz / 2), vibrations.shape)
        axes = {f"acceleration_{axis}": column for axis, column in zip("xyz", vibrations.T, strict=True)}
    signals = {**axes, "speed": stroke.speed, "force": force}
    return Recording(
        {name: Channel(np.ascontiguousarray(x), stroke.rate_hz) for name, x in signals.items()}, texture=key
    )


def learned(recording: Recording) -> Texture:
    """A texture without a network."""
    short = recording.duration_s < PreprocessConfig().shortest_s
    trim_ms, block_ms = (0.0, 200.0) if short else fitting_cut(recording)
    cut = PreprocessConfig(trim_ms=trim_ms, block_ms=block_ms)
    config = recipe_of("foten-plus", threads=1, epochs=0)
    return train(TrainingJob(recording, "foten-plus", FotenPlusSizes(), config, cut)).texture


def variants(few: Texture) -> dict[str, Texture]:
    """The same texture outside its range, by policy."""
    exponents = {
        "before": dict.fromkeys(LAW, 0.0),
        "held": dict.fromkeys(LAW, 1e-9),
        "law": {name: mean for name, (mean, _) in LAW.items()},
    }
    changed = {
        policy: Texture({**few.card, "extrapolation_exponents": powers}, few.tensors)
        for policy, powers in exponents.items()
    }
    return {**changed, "ours": few}


def compared(texture: Texture, truths: list[Trace]) -> dict[str, float]:
    """Level error and log-spectral distance [dB] of renderings of traces, means."""
    levels, distances = [], []
    for i, truth in enumerate(truths):
        ours = Renderer(texture, seed=i).render(truth.speed, truth.force).astype(np.float64)
        levels.append(abs(20 * np.log10(max(ours.std(), 1e-12) / truth.acceleration.std())))
        (hz, p), (_, q) = (welch(x, truth.rate_hz, min(256, len(x) // 4)) for x in (truth.acceleration, ours))
        bins = scored_bins(hz, truth.rate_hz)
        distances.append(float(log_spectral_distance(p[bins], q[bins])))
    return {"level_error_db": float(np.mean(levels)), "lsd_db": float(np.mean(distances))}


def judged(key: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Figures of a simulated texture by policy."""
    rate = LINEAR_RATE_HZ if key in LINEAR_FAMILY else RATE_HZ
    few = learned(recorded(key, steady(*RECORDED, SECONDS, 1, rate), 1))
    full = learned(recorded(key, stroking(FULL_SECONDS, 100, rate), 1))
    cut = PreprocessConfig(trim_ms=0.0)
    truths = [preprocess(recorded(key, steady(*at, JUDGED_SECONDS, 7, rate), 9), cut) for at in CONDITIONS]
    for policy, texture in {**variants(few), "full": full}.items():
        exponents = {f"{name}_exponent": texture.extrapolation_exponent(name) for name in LAW}
        yield policy, {**compared(texture, truths), **exponents}


def judged_hand(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Level errors of a real recording: the faster half of its frames of 40 ms from the slower, and the other way round."""
    arrays = np.load(path)
    logs = np.log(np.stack([frame_means(arrays[name], 10_000.0) for name in ("speed", "force")], axis=1))
    levels = 0.5 * np.log(frame_means(np.square(arrays["accel"]), 10_000.0))
    slow = logs[:, 0] < np.median(logs[:, 0])
    steps = logs[~slow].mean(axis=0) - logs[slow].mean(axis=0)
    yield from by_level(np.array([levels[~slow].mean() - levels[slow].mean()]), steps[None])


def judged_pens(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Level errors of eight pens on paper, twice each: 14 conditions from that of 100 mm/s and 1.5 N.

    The file does not say how its conditions are ordered; they are taken as force by force, speeds sorted as text, under which
    levels rise with both.
    """
    pens = np.load(path)
    levels = np.array([0.5 * np.log(np.square(pens[name].astype(np.float64)).sum(axis=-1)) for name in pens.files])
    speed, force = np.tile([100.0, 120.0, 140.0, 60.0, 80.0], 3), np.repeat([100.0, 150.0, 200.0], 5)
    logs, at = np.log(np.stack([speed, force], axis=1)), 5
    others = np.arange(15) != at
    steps = np.broadcast_to((logs - logs[at])[others], (*levels.shape[:2], 14, 2))
    yield from by_level((levels - levels[..., at : at + 1])[..., others], steps)


def by_level(levels: np.ndarray, steps: np.ndarray) -> Iterator[tuple[str, dict[str, Any]]]:
    """Errors of levels [log] held, and by the law, for steps of log speed and log force (…, 2)."""
    law = np.array([mean for mean, _ in LAW.values()])
    for policy, powers in (("held", 0 * law), ("law", law)):
        yield policy, {"level_error_db": float(np.abs(levels - steps @ powers).mean()) * 20 / np.log(10)}


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


def rendered_by_policy(texture: Texture, trace: Trace) -> dict[str, np.ndarray]:
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


def frame_figures(truth: np.ndarray, ours: np.ndarray, where: np.ndarray, rate_hz: float) -> dict[str, float]:
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


def judged_outside(key: str) -> Iterator[tuple[str, str, dict[str, float]]]:
    """Figures of one texture by policy and region."""
    texture = learned(recorded(key, halved(stroking(64.0, 100, RATE_HZ)), 1))
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
    signals = {id(trace): rendered_by_policy(texture, trace) for trace in (inside, jumps)}
    for policy, (name, (trace, where)) in product(POLICIES, regions.items()):
        if where.sum() >= 10:
            yield policy, name, frame_figures(trace.acceleration, signals[id(trace)][policy], where, trace.rate_hz)


def few_strokes(arguments: argparse.Namespace) -> None:
    """Write figures of each texture, recording and policy."""
    tasks = [(key, judged(key)) for key in arguments.textures]
    if arguments.hands:
        tasks += [(path.stem, judged_hand(path)) for path in sorted(arguments.hands.glob("*.npz"))]
    if arguments.pens:
        tasks.append(("pens on paper", judged_pens(arguments.pens)))
    figures = ("level_error_db", "lsd_db", "speed_exponent", "force_exponent")
    cells: list[list[str]] = []
    for key, rows in tasks:
        for policy, row in rows:
            cells.append([key, policy, *(f"{row[name]:.4f}" if name in row else "" for name in figures)])
            print(*cells[-1], flush=True)
        Table.of(["texture", "policy", *figures], cells).write(RESULTS / "few-strokes.csv")


def outside(arguments: argparse.Namespace) -> None:
    """Write figures of each texture, policy and region."""
    names = ("level_bias_db", "level_error_db", "lsd_db")
    cells: list[list[str]] = []
    for key in arguments.textures:
        for policy, where, row in judged_outside(key):
            cells.append([key, policy, where, f"{row['frames']:.0f}", *(f"{row[name]:.4f}" for name in names)])
        print(f"{key}: done", flush=True)
    Table.of(["texture", "policy", "where", "frames", *names], cells).write(RESULTS / "outside.csv")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("what", choices=("few-strokes", "outside"))
    parser.add_argument("--textures", type=lambda text: text.split(","), help="by default all")
    parser.add_argument("--hands", type=Path, help="folder of real recordings under a moving hand")
    parser.add_argument("--pens", type=Path, help="spectra of pens on paper")
    arguments = parser.parse_args()
    if arguments.what == "outside":
        arguments.textures = arguments.textures or list(TEXTURES)
        return outside(arguments)
    arguments.textures = arguments.textures or [*TEXTURES, *CONTACT, *LINEAR_FAMILY]
    return few_strokes(arguments)


if __name__ == "__main__":
    main()
