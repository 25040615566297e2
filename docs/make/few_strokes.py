"""A surface recorded at one speed and force, judged at others: what the law of speed and force is worth.

    python docs/make/few_strokes.py [--textures a,b] [--data DIR]

Each simulated texture is recorded for 5 s under a hand at about 100 mm/s and 0.7 N, trained without a network, and rendered under
steady hands at twelve other speeds and forces, 8 s each. `before` fades below the recorded range and holds the level above;
`held` holds both; `law` follows v^0.95 f^0.33; `ours` shrinks the recording's own powers towards it, as training does; `full` is
trained on 64 s of a moving hand. Figures are means over conditions; dB. Of real recordings the level alone is judged: --hands, a
folder of .npz files (`speed`, `force`, `accel` at 10 kHz), the faster half from the slower; --pens, spectra at 15 conditions.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from foten.dsp.distance import log_spectral_distance, scored_bins, welch
from foten.dsp.level import frame_means
from foten.models.foten_plus.fit import LAW
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import Texture
from foten.models.trainable import recipe_of, train
from foten.recording.preprocess import PreprocessConfig, fitting_cut, preprocess
from foten.recording.recording import Channel, Recording
from foten.recording.trace import Trace
from foten.reporting.table import Table
from foten.runtime.renderer import Renderer
from foten.simulation.contact_mechanics import CONTACT, contact_vibration, surface_of
from foten.simulation.linear_family import LINEAR_FAMILY, linear_signal
from foten.simulation.simulate import ACCELEROMETER_NOISE, TEXTURES, vibration
from foten.simulation.stroking import Stroking, stroking
from foten.training.job import TrainingJob

CSV = Path(__file__).resolve().parents[1] / "results" / "few-strokes.csv"
RECORDED = (100.0, 0.7)  # mm/s and N
CONDITIONS = list(product((30.0, 60.0, 150.0, 200.0), (0.3, 1.0, 2.0)))
SECONDS, JUDGED_SECONDS, FULL_SECONDS = 5.0, 8.0, 64.0
WANDER = (0.04, 0.06)  # standard deviation of log speed and log force of a steady hand
POLICIES = ("before", "held", "law", "ours", "full")


def steady(speed: float, force: float, seconds: float, seed: int, rate_hz: float) -> Stroking:
    """A hand at one speed [mm/s] and force [N], as far as a hand is steady."""
    rng, n = np.random.default_rng([seed, 4]), round(seconds * rate_hz)
    at, knots = np.arange(n) / rate_hz, np.arange(0.0, seconds + 0.5, 0.25)
    logs = [np.interp(at, knots, sd * rng.standard_normal(knots.size)) for sd in WANDER]
    v, f = speed * np.exp(logs[0]), force * np.exp(logs[1])
    velocity = np.stack([v, np.zeros(n)], axis=1)
    return Stroking(rate_hz, np.cumsum(velocity, axis=0) / rate_hz, velocity, f, np.zeros((n, 2)))


def rate_of(key: str) -> float:
    """What a texture is simulated at [Hz]."""
    return 1000.0 if key in LINEAR_FAMILY else 10_000.0


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


def with_exponents(texture: Texture, exponents: Mapping[str, float]) -> Texture:
    return Texture({**texture.card, "extrapolation_exponents": dict(exponents)}, texture.tensors)


def variants(few: Texture) -> dict[str, Texture]:
    """The same texture outside its range, by policy."""
    law = {name: mean for name, (mean, _) in LAW.items()}
    return {
        "before": with_exponents(few, dict.fromkeys(LAW, 0.0)),
        "held": with_exponents(few, dict.fromkeys(LAW, 1e-9)),
        "law": with_exponents(few, law),
        "ours": few,
    }


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
    rate = rate_of(key)
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    every = [*TEXTURES, *CONTACT, *LINEAR_FAMILY]
    parser.add_argument("--textures", type=lambda text: text.split(","), default=every)
    parser.add_argument("--hands", type=Path, help="folder of real recordings under a moving hand")
    parser.add_argument("--pens", type=Path, help="spectra of pens on paper")
    arguments = parser.parse_args()
    heads = ["texture", "policy", "level_error_db", "lsd_db", "speed_exponent", "force_exponent"]
    cells = [heads]
    tasks = [(key, judged(key)) for key in arguments.textures]
    tasks += (
        [(path.stem, judged_hand(path)) for path in sorted(arguments.hands.glob("*.npz"))] if arguments.hands else []
    )
    tasks += [("pens on paper", judged_pens(arguments.pens))] if arguments.pens else []
    for key, rows in tasks:
        for policy, row in rows:
            cells.append([key, policy, *(f"{row[name]:.4f}" if name in row else "" for name in heads[2:])])
            print(*cells[-1], flush=True)
        Table.of(cells[0], cells[1:]).write(CSV)


if __name__ == "__main__":
    main()
