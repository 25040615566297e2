"""Trials of a change of foten-plus on surfaces of other physics: one half to choose by, the other kept, judged once.

    python benchmarks/trials.py APPROACH [--half choosing] [--fits 1 2] [--csv docs/results/trials.csv] [--folder build/trials]

A fit learns from 64 s of each surface at 1 kHz, with seeds of its own; it is judged under a hand of its own, 240 s, by the ideal
listener, by the one with a person's limits, by excerpts of 2 s, and under a hand that stands still in speed and force, each
beside a control of two true realisations; and by the ideal one where the rendering is told the truth's mean band levels
(`known_levels`). Bias of level by quarter of speed is of frames of 40 ms, of three renderings and three realisations; level error
and log-spectral distance are divided by those of two realisations.

A rendering does not use the network, which is not trained here. Axes of a block become one at once, as in the rows of before,
unless --dft321-ms says otherwise; --quickness has another hand listen.

Every row goes into one CSV, which keeps the rows of earlier approaches: what is there is not run again. Textures and strokes are
kept in a folder.

Seeds of recordings, hands and noise are those below, and were written down before the first trial. A kept half runs once: with
its first row in the CSV, another approach is refused; but for the default before recorded innovations on the new kept half.
"""

import argparse
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import numpy as np

from bench import parser_of, read_rows, stored, trained, write_rows
from foten.atomic_write import atomic_write
from foten.datasets.hdf5 import load_recording, write_recording
from foten.dsp import Array
from foten.dsp.distance import log_spectral_distance, scored_bins, segment_length, welch
from foten.dsp.equaliser import terms_of
from foten.dsp.level import BAND_FRAME_MS, ENERGY_FLOOR, N_BANDS, band_energies, frame_levels, frame_means, framed
from foten.evaluate.listener import rendering, vibrations
from foten.evaluate.listener_network import listener_auc
from foten.models.conditions import MOVING_FORCE, MOVING_SPEED
from foten.models.foten_plus import fit
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import Texture
from foten.models.trainable import recipe_of
from foten.recording.preprocess import PreprocessConfig, fitting_cut, preprocess
from foten.recording.recording import Recording
from foten.recording.trace import Trace
from foten.runtime.native import NativeTexture
from foten.simulation.contact_mechanics import RATE_HZ
from foten.simulation.linear_family import LINEAR_FAMILY, OTHER_LINEAR
from foten.simulation.simulate import LINEAR_RATE_HZ, TEXTURES, simulate, simulate_stroke
from foten.simulation.stroking import Stroking, stepped_stroking, stroking
from foten.simulation.two_mass_contact import TWO_MASS
from foten.training.job import TrainingJob, shortest_block

SECONDS, LONG_S = 64.0, 240.0
SURFACES = {
    "choosing": (*list(TWO_MASS)[:5], *LINEAR_FAMILY),
    "kept": (*list(TWO_MASS)[5:10], *OTHER_LINEAR),
    "simulated": tuple(TEXTURES),
    "new kept": ("denim", "latex", "spruce", "bark", "pumice"),
}
# Times as quick as the hand that recorded is the one that listens to these.
QUICKNESS = {"bark": 0.6, "pumice": 1.7}
# Parts that can be left out, and what functions of the fit do then. Without noise, recorded innovations are always played.
PARTS: Mapping[str, Mapping[str, Callable[..., Any]]] = {
    "recorded": {"recorded_candidates": lambda *_: []},
    "noise": {"is_distinguishable": lambda _: True, "best_random_part": lambda of: _BEST(of[1:] or of)},
    "equaliser": {"fit_equaliser": lambda *_: None},
}
_BEST = fit.best_random_part
BEFORE = "before recorded innovations"  # may be judged on the new kept half beside what stands at the end
# By half and fit: of the recording; of the hand that listens; of its first realisation; of the rendering and the listener.
SEEDS = {
    ("choosing", 1): (301, 4301, 5301, 61),
    ("choosing", 2): (302, 4302, 5302, 62),
    ("kept", 1): (701, 8701, 9701, 71),
    ("kept", 2): (702, 8702, 9702, 72),
    ("simulated", 1): (901, 9901, 10901, 91),
    ("simulated", 2): (902, 9902, 10902, 92),
    ("new kept", 1): (811, 12811, 13811, 81),
    ("new kept", 2): (812, 12812, 13812, 82),
}
N_TRUE, N_RENDERED = 3, 3  # realisations of a long stroke, and renderings under it
SEED_STEP = 1_000_003
N_QUARTERS = 4
LONG_EXCERPT = 250  # frames of 8 ms: 2 s
# Of the hand that stands still. DFT321 mixes what it is given in 2 s: as much is mixed as under a hand that moves.
HOLD_S, MOVE_S, HELD_SPEED, HELD_FORCE = 1.0, 0.15, (15.0, 250.0), (0.3, 3.0)
CHANNELS = ("acceleration", "speed", "force")
KEYS = ("approach", "half", "surface", "fit")


@dataclass(frozen=True)
class Trial:
    """One fit of a surface."""

    approach: str
    half: str
    surface: str
    fit: int
    folder: Path
    without: tuple[str, ...] = ()  # of `PARTS`
    settings: str = "{}"  # of the training, as JSON
    seconds: float = SECONDS  # that it learns from
    dft321_ms: float = 0.0  # of `PreprocessConfig`
    quickness: float = 1.0  # of the hand that listens, times the surface's own

    @property
    def row(self) -> dict[str, str]:
        """What says which it is, as in the table."""
        return {name: str(getattr(self, name)) for name in KEYS}

    def path(self, kind: str, ending: str) -> Path:
        """Where what depends on surface, fit, cut and hand is kept."""
        window = f"-{self.dft321_ms:g}ms" if self.dft321_ms else ""
        hand = f"-{self.quickness:g}x" if self.quickness != 1 else ""
        path = self.folder / kind / f"{self.surface}-{self.fit}{window}{hand}{ending}"
        path.parent.mkdir(parents=True, exist_ok=True)
        return path


def recording_of(trial: Trial) -> Recording:
    """What a trial learns from, simulated once."""
    length = "" if trial.seconds == SECONDS else f"-{trial.seconds:g}"
    path = trial.folder / "recordings" / f"{trial.surface}-{trial.fit}{length}.h5"
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_recording(simulate(trial.surface, trial.seconds, SEEDS[trial.half, trial.fit][0]), path)
    return load_recording(path)


def quickened(trial: Trial, seed: int, rate_hz: float) -> Stroking:
    """Long stroke of a hand, on the same path at another speed on some surfaces."""
    quickness = QUICKNESS.get(trial.surface, 1.0) * trial.quickness
    stroke = stroking(LONG_S * quickness, seed, rate_hz / quickness)
    return replace(stroke, rate_hz=rate_hz, velocity=quickness * stroke.velocity)


def still_hand(seed: int, rate_hz: float) -> Stroking:
    """Long stroke that holds speed and force for `HOLD_S` at a time, each log-uniform."""
    rng = np.random.default_rng([seed, 3])
    knots, at = [], 0.0
    while at < LONG_S:
        held = [float(np.exp(rng.uniform(*np.log(ends)))) for ends in (HELD_SPEED, HELD_FORCE)]
        knots += [(at, *held), (at + HOLD_S - MOVE_S, *held)]
        at += HOLD_S
    return stepped_stroking(knots, rate_hz)


def strokes_of(trial: Trial, still: bool = False) -> list[Trace]:
    """The true realisations of the long stroke of a trial's hand, preprocessed; simulated once."""

    def simulated() -> dict[str, Any]:
        _, hand, noise, _ = SEEDS[trial.half, trial.fit]
        rate = LINEAR_RATE_HZ if trial.surface.startswith("linear-") else RATE_HZ
        stroke = still_hand(hand, rate) if still else quickened(trial, hand, rate)
        traces = [
            preprocess(simulate_stroke(trial.surface, stroke, seed), PreprocessConfig(dft321_ms=trial.dft321_ms))
            for seed in range(noise, noise + N_TRUE * SEED_STEP, SEED_STEP)
        ]
        arrays = {f"{name}{k}": getattr(trace, name) for k, trace in enumerate(traces) for name in CHANNELS}
        return {"rate_hz": traces[0].rate_hz, **arrays}

    arrays = stored(trial.path("held" if still else "strokes", ".npz"), simulated)
    channels = ([arrays[f"{name}{k}"] for name in CHANNELS] for k in range(N_TRUE))
    return [Trace(*channel, float(arrays["rate_hz"]), len(channel[0])) for channel in channels]


def control_of(trial: Trial, kind: str, true: Sequence[Trace]) -> float:
    """Area of a listener for two true realisations; listened to once."""
    path = trial.path("controls", f"-{kind}.json")
    if not path.is_file():
        with atomic_write(path) as part:
            part.write_text(json.dumps(listener_area(trial, kind, true[0], true[1])))
    return float(json.loads(path.read_text()))


LISTENERS = {"ideal": ("", None), "person": ("_person", None), "long": ("", LONG_EXCERPT), "still": ("", None)}
"""Kind of listener, and frames of its excerpts; the last one under a hand that stands still."""


def listener_area(trial: Trial, kind: str, true: Trace, other: Trace) -> float:
    """Area of a listener."""
    of_kind, excerpt = LISTENERS[kind]
    shown = vibrations(true, other, excerpt=excerpt)[of_kind]
    return listener_auc(*shown, seed=SEEDS[trial.half, trial.fit][-1])


def texture_of(trial: Trial) -> Texture:
    """Texture of a trial, trained unless it is in the folder already."""

    def job() -> TrainingJob:
        seed, *_ = SEEDS[trial.half, trial.fit]
        config = recipe_of("foten-plus", **{"threads": 1, "seed": seed, "epochs": 0, **json.loads(trial.settings)})
        recording, sizes = recording_of(trial), FotenPlusSizes()
        trim_ms, block_ms = fitting_cut(recording, shortest_block(sizes.window))
        cut = PreprocessConfig(trim_ms=trim_ms, block_ms=block_ms, dft321_ms=trial.dft321_ms)
        return TrainingJob(recording, "foten-plus", sizes, config, cut, split_seed=seed)

    return trained(trial.folder / trial.approach / f"{trial.surface}-{trial.fit}.foten", job)


def judge(trial: Trial, kinds: Sequence[str]) -> dict[str, str]:
    """The row of a trial by kinds of listeners."""
    import torch

    torch.set_num_threads(1)  # of listeners too
    for part in trial.without:
        for name, instead in PARTS[part].items():
            setattr(fit, name, instead)
    texture, true = texture_of(trial), strokes_of(trial)
    kernel, seed = NativeTexture(texture.to_bytes()), SEEDS[trial.half, trial.fit][-1]

    def rendered(under: Trace, k: int = 0) -> Trace:
        return replace(under, acceleration=rendering(kernel, under, seed + 10 * k))

    runs = [rendered(true[0], k) for k in range(N_RENDERED)]
    figures = level_figures(true, runs)
    for kind in kinds:
        of_kind = strokes_of(trial, still=True) if kind == "still" else true
        run = rendered(of_kind[0]) if kind == "still" else runs[0]
        figures[kind] = listener_area(trial, kind, of_kind[0], run)
        figures[f"{kind}_control"] = control_of(trial, kind, of_kind)
    if set(kinds) == set(LISTENERS):
        figures["known_levels"] = known_levels(trial, true, runs)
    columns = {name: f"{value:.{2 if name.endswith('_db') else 3}f}" for name, value in figures.items()}
    sizes = texture.sizes
    assert isinstance(sizes, FotenPlusSizes)
    played = "no" if not sizes.recorded else "path" if sizes.along_path else "time"
    return {**trial.row, **columns, "recorded": played}


def known_levels(trial: Trial, true: Sequence[Trace], rendered: Sequence[Trace]) -> float:
    """Area of the ideal listener for a rendering with the truth's mean level in each band, by the terms of `foten.dsp.equaliser`.

    As of a model of the same memory that knows the envelope which is to be expected of a stroke, in place of what 64 s say of it.
    """
    first, second = vibrations(true[0], rendered[0])[""]
    moving = second.frames[:N_BANDS].any(axis=0)
    energies = [[band_energies(trace.acceleration, trace.rate_hz) for trace in some] for some in (true, rendered)]
    floor = ENERGY_FLOOR * np.mean([some[0].mean(axis=-1) for some in energies], axis=0)[:, None]
    logs = [[np.log(energy + floor) for energy in some] for some in energies]
    unit = (logs[1][0][:, moving].std(axis=1) / second.frames[:N_BANDS, moving].std(axis=1))[:, None]
    phi = framed(terms_of(true[0].speed, true[0].force, true[0].rate_hz), BAND_FRAME_MS, true[0].rate_hz).mean(axis=-1)
    missing = np.mean(logs[0][1:], axis=0) - np.mean(logs[1], axis=0)
    levels = missing[:, moving] @ np.linalg.pinv(phi[:, moving]) @ phi
    frames = second.frames.copy()
    frames[:N_BANDS] += np.where(moving, levels / unit, 0.0)
    return listener_auc(first, replace(second, frames=frames), seed=SEEDS[trial.half, trial.fit][-1])


def level_figures(true: Sequence[Trace], rendered: Sequence[Trace]) -> dict[str, float]:
    """Bias of level by quarter of speed [dB], and level error and log-spectral distance over those of two realisations."""
    rate, first = true[0].rate_hz, true[0]
    reference = float(np.sqrt(np.square(first.acceleration).mean()))

    def levels(traces: Sequence[Trace]) -> Array:
        return np.stack([frame_levels(trace.acceleration, rate, reference) for trace in traces])

    speed, force = frame_means(first.speed, rate), frame_means(first.force, rate)
    moving = (speed >= 2 * MOVING_SPEED) & (force >= 2 * MOVING_FORCE)
    of_true, of_rendered = levels(true)[:, moving], levels(rendered)[:, moving]
    bias = of_rendered.mean(axis=0) - of_true.mean(axis=0)
    quarter = np.searchsorted(np.quantile(speed[moving], [0.25, 0.5, 0.75]), speed[moving])
    figures = {f"bias_{k + 1}_db": float(bias[quarter == k].mean()) for k in range(N_QUARTERS)}
    ceiling = np.abs(of_true[1:] - of_true[0]).mean()
    figures["level_error_ratio"] = float(np.abs(of_rendered - of_true[0]).mean() / ceiling)
    block = round(2 * rate)

    def spectra(trace: Trace) -> tuple[Array, Array]:
        n = len(trace) // block
        return welch(trace.acceleration[: n * block].reshape(n, block), rate, segment_length(block))

    frequencies, p = spectra(first)
    bins = scored_bins(frequencies, rate)

    def distance(traces: Iterable[Trace]) -> float:
        return float(
            np.mean([log_spectral_distance(p[:, bins], spectra(trace)[1][:, bins]).mean() for trace in traces])
        )

    figures["lsd_ratio"] = distance(rendered) / distance(true[1:])
    return figures


def trials_of(options: argparse.Namespace, rows: Sequence[Mapping[str, str]]) -> list[Trial]:
    """The trials that the rows lack.

    Raises:
        ValueError: the half was judged already.
    """
    changes = {
        f"hand of {options.quickness:g} times the speed": options.quickness != 1,
        f"DFT321 in windows of {options.dft321_ms:g} ms": options.dft321_ms,
        f"{options.seconds:g} s": options.seconds != SECONDS,
    }
    name = ", ".join([options.approach, *(text for text, is_changed in changes.items() if is_changed)])
    judged = {row["approach"] for row in rows if row["half"] == options.half} - {name}
    if options.half == "new kept":
        judged = judged - {BEFORE} if name != BEFORE else set()
    if options.half.endswith("kept") and judged:
        raise ValueError(f"the {options.half} half was judged already, with {', '.join(judged)}: it can be judged once")
    changed = tuple(options.without), options.settings, options.seconds, options.dft321_ms, options.quickness
    surfaces = options.surfaces or SURFACES[options.half]
    trials = (Trial(name, options.half, key, n, options.folder, *changed) for n in options.fits for key in surfaces)
    done = [{key: row[key] for key in KEYS} for row in rows]
    return [trial for trial in trials if trial.row not in done]


def main() -> None:
    """Run the trials that the table lacks, and print its means."""
    parser = parser_of(__doc__)
    parser.set_defaults(csv=Path("docs/results/trials.csv"))
    parser.add_argument("approach", help="its name in the table")
    parser.add_argument("--half", choices=tuple(SURFACES), default="choosing")
    parser.add_argument("--fits", type=int, nargs="+", default=[1, 2], choices=(1, 2))
    parser.add_argument("--surfaces", nargs="+", help="some of the half's")
    parser.add_argument("--folder", type=Path, default=Path("build/trials"))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--without", nargs="+", default=[], choices=tuple(PARTS))
    parser.add_argument("--settings", default="{}", help="of the training, as JSON")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="that a fit learns from")
    parser.add_argument(
        "--dft321-ms", type=float, default=0.0, help="windows in which three axes become one; 0: blocks"
    )
    parser.add_argument("--quickness", type=float, default=1.0, help="of the hand that listens")
    parser.add_argument("--listeners", nargs="+", default=list(LISTENERS), choices=tuple(LISTENERS))
    options = parser.parse_args()
    rows = read_rows(options.csv)
    try:
        trials = trials_of(options, rows)
    except ValueError as error:
        parser.error(str(error))
    with ProcessPoolExecutor(options.workers, get_context("spawn")) as pool:
        for n, ready in enumerate(as_completed([pool.submit(judge, one, options.listeners) for one in trials]), 1):
            rows.append(ready.result())
            print(f"{n}/{len(trials)} {json.dumps(rows[-1])}", flush=True)
            write_rows(rows, options.csv)
    print_means([row for row in rows if row["half"] == options.half])


def print_means(rows: Sequence[Mapping[str, str]]) -> None:
    """Print the means of the figures of each approach, over surfaces of contact and over linear processes."""
    named = [name for name in (rows[0] if rows else ()) if name not in (*KEYS, "recorded")]
    for approach, linear in product(dict.fromkeys(row["approach"] for row in rows), (False, True)):
        of_it = [row for row in rows if row["approach"] == approach and row["surface"].startswith("linear-") == linear]
        if of_it:
            means = (f"{name} {np.mean([float(row[name]) for row in of_it if row[name]]):.3f}" for name in named)
            print(f"{approach:24s} {'linear' if linear else 'contact':8s} n {len(of_it):2d}", *means)


if __name__ == "__main__":
    main()
