"""Abrupt changes of a simulated hand: level and spectrum in the 100 ms after, beside the truth and the paper's network.

    python benchmarks/abrupt.py [--surfaces ...] [--models foten-plus foten] [--again MODEL ...] [--csv docs/results/abrupt.csv]

Textures learn from 64 s of ordinary stroking at 1 kHz. Then speed and force change within milliseconds, steps, a reversal,
taps, and steps out of the recorded range, each between conditions that are held; so many times, from other places and with
other noise, that the mean power of each 10 ms is known. The hand's own acceleration along the stroke is left out: a hand that
strokes has it already. What contact mechanics and two masses give on a flat surface, the knock of a force that changes, is a row
of its own. Renderings get the conditions late by the low-pass, as live ones do; `aligned` without its delay, as in training; and
`unfiltered`. Level error: mean over the first ten frames of |mean level − that of the truth|. Log-spectral distance: of the mean
spectra of these 100 ms. `settled`: the same later, under the new condition held. A second realisation of the truth is the floor
of each. Levels and densities count from 30 dB below the truth's power over all changes, and from the sensor's noise.

Textures and truths stay in a folder and rows in the CSV: what is there is not run again. `--again MODEL` trains and measures one
anew.
"""

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from bench import parser_of, read_rows, stored, trained, write_rows
from foten.dsp import Array
from foten.dsp.distance import log_spectral_distance, scored_bins, welch
from foten.dsp.filters import butterworth, filter_recorded
from foten.dsp.level import FLOOR_DB
from foten.dsp.resample import decimate
from foten.evaluate.free_run import render_strokes
from foten.models.texture_file import Texture
from foten.models.trainable import recipe_of, trainable_sizes
from foten.recording.preprocess import PreprocessConfig, condition
from foten.recording.recording import AXES
from foten.runtime.native import NativeTexture
from foten.simulation.contact_mechanics import CONTACT, RATE_HZ, contact_vibrations, surface_of
from foten.simulation.linear_family import LINEAR_FAMILY, linear_signal
from foten.simulation.simulate import ACCELEROMETER_NOISE, TEXTURES, simulate, vibration
from foten.simulation.stroking import Stroking, stepped_stroking
from foten.simulation.two_mass_contact import TWO_MASS, two_mass_surface, two_mass_vibrations
from foten.training.job import TrainingJob

SURFACES = {
    **dict.fromkeys(("linear-hum", "linear-cloth"), "linear"),
    **dict.fromkeys(("steel-mesh-1", "cardboard", "artificial-grass"), "simulated"),
    **dict.fromkeys(("sawn-wood", "rubber-sheet"), "contact mechanics"),
    **dict.fromkeys(("sandstone", "linen"), "two masses"),
}
SECONDS, SEED, TRUTH_SEED, STREAM = 64.0, 401, 5001, 2**36
MODEL_HZ = 1000.0
DRAWN = "sandstone"  # whose levels by frame are in the table, for a picture
FRAME_S, AFTER_S, SPECTRUM_S = 0.01, 0.1, 0.05  # of levels, of what is judged, of a segment of its spectrum
SOFT_S, BEFORE_S, HELD_S = 0.1, 0.35, 0.45  # to the condition before, held before the change, and held after it
LEVELS_S = (-0.05, 0.35)  # around a change, in the table
LEVELS = f"levels from {1000 * LEVELS_S[0]:.0f} ms, each {1000 * FRAME_S:.0f} ms [dB]"  # in one column
NEAR_DB, NEAR_S = 2.0, 0.05  # the level has arrived where it stays so near for as long
LEAD_IN_S = 0.5  # at most, of the first condition, so that tones of a path begin anywhere
AT_ONCE = 32  # realisations in memory
HANDS = ("live", "aligned", "unfiltered")
KEYS = ("surface", "change", "rendering", "hand")
TRUTH, SECOND, FLAT = "truth", "second realisation", "flat surface"
MODELS = {"foten-plus": HANDS, "foten": ("live", "unfiltered")}
FOTEN_RECIPE = {"learning_rate": 2e-3, "epochs": 24}  # the best of its ten, as in the main tables
SILENT, N_SILENT = "foten, no random part", 8


@dataclass(frozen=True)
class Change:
    """Velocity [mm/s] and force [N] before and after, and how long it takes to change them [s]."""

    before: tuple[float, float]
    after: tuple[float, float]
    ramp_s: float = 0.01


CHANGES = {
    "speed 40 → 200 mm/s": Change((40, 1), (200, 1)),
    "speed 200 → 40 mm/s": Change((200, 1), (40, 1)),
    "force 0.5 → 2 N": Change((100, 0.5), (100, 2)),
    "force 2 → 0.5 N": Change((100, 2), (100, 0.5)),
    "reversal at 120 mm/s": Change((120, 1), (-120, 1), 0.03),
    "tap of 1.5 N at 80 mm/s": Change((80, 0), (80, 1.5)),
    "tap of 1.5 N at rest": Change((0, 0), (0, 1.5)),
    "speed 100 → 450 mm/s": Change((100, 1), (450, 1)),
    "force 1 → 5 N": Change((100, 1), (100, 5)),
}
"""By name; the last two leave the recorded range."""


@dataclass(frozen=True)
class Measured:
    """Mean power of each frame around each change (changes, frames), and mean densities after it and settled (changes, k)."""

    power: Array
    after: Array
    settled: Array


def abrupt_stroke(rate_hz: float) -> tuple[Stroking, list[float]]:
    """Stroke through all changes, and when each of them begins [s]."""
    at, knots, begins = 0.0, [(0.0, *next(iter(CHANGES.values())).before)], []
    for change in CHANGES.values():
        begins.append(at + SOFT_S + BEFORE_S)
        held = (
            (SOFT_S, change.before),
            (begins[-1] - at, change.before),
            (begins[-1] - at + change.ramp_s, change.after),
        )
        knots += [(at + offset, *condition) for offset, condition in held]
        at = begins[-1] + HELD_S
        knots.append((at, *change.after))
    return stepped_stroking(knots, rate_hz), begins


def true_vibrations(key: str, seeds: Sequence[int], flat: bool = False) -> Array:
    """Realisations of the stroke as a model's rate has them [m/s²]: (n_seeds, axes, n); of contact without its profile."""
    rngs = [np.random.default_rng([seed, 2, *key.encode()]) for seed in seeds]
    linear = key in LINEAR_FAMILY
    stroke, _ = abrupt_stroke(MODEL_HZ if linear else RATE_HZ)
    config = PreprocessConfig()
    highpass = butterworth("highpass", config.highpass_hz, MODEL_HZ, config.highpass_order)
    if linear:
        signals = [linear_signal(LINEAR_FAMILY[key], stroke.speed, stroke.force, rng) for rng in rngs]
        return np.stack([filter_recorded(highpass, signal)[None] for signal in signals])
    if key in TEXTURES:
        vibrations = [vibration(TEXTURES[key], stroke, rng) for rng in rngs]
    elif key in CONTACT:
        surface = np.zeros(1000) if flat else surface_of(CONTACT[key], key)
        vibrations = [axes for axes, _ in contact_vibrations(CONTACT[key], surface, stroke, rngs)]
    else:
        surface = np.zeros(1000) if flat else two_mass_surface(TWO_MASS[key], key)
        vibrations = [axes for axes, _ in two_mass_vibrations(TWO_MASS[key], surface, stroke, rngs)]
    noise = ACCELEROMETER_NOISE * np.sqrt(RATE_HZ / 2)
    sensed = (axes + rng.normal(0, noise, axes.shape) for axes, rng in zip(vibrations, rngs, strict=True))
    return np.stack(
        [[filter_recorded(highpass, decimate(axis, RATE_HZ, MODEL_HZ)) for axis in axes.T] for axes in sensed]
    )


def measured(signals: Array, begins: Sequence[float]) -> Measured:
    """Powers and densities of realisations (s, axes, n), the axes' added: as of the one axis that a model learns."""
    frame, after, n_segment = (round(s * MODEL_HZ) for s in (FRAME_S, AFTER_S, SPECTRUM_S))
    powers, spectra = [], []
    for begin in begins:
        first, last = (round((begin + s) * MODEL_HZ) for s in (LEVELS_S[0], HELD_S))
        held = np.square(signals[..., first:last]).sum(axis=1).mean(axis=0)
        powers.append(held.reshape(-1, frame).mean(axis=1))
        at = round(begin * MODEL_HZ), last - after
        parts = np.stack([signals[..., start : start + after] for start in at])
        spectra.append(welch(parts, MODEL_HZ, n_segment)[1].sum(axis=2).mean(axis=1))
    densities = np.stack(spectra, axis=1)
    return Measured(np.stack(powers), *densities)


def truths(key: str, folder: Path, repeats: int) -> list[Measured]:
    """Two independent halves of the truth, `repeats` realisations each; simulated once."""

    def simulated() -> dict[str, Array]:
        _, begins = abrupt_stroke(MODEL_HZ)
        arrays: dict[str, Array] = {}
        for half in range(2):
            seeds = range(TRUTH_SEED + half * repeats, TRUTH_SEED + (half + 1) * repeats)
            parts = [seeds[first : first + AT_ONCE] for first in range(0, repeats, AT_ONCE)]
            some = [measured(true_vibrations(key, part), begins) for part in parts]
            weights = [len(part) for part in parts]
            for name in Measured.__dataclass_fields__:
                mean = np.average([getattr(each, name) for each in some], axis=0, weights=weights)
                arrays[f"{name}{half}"] = mean
        return arrays

    arrays = stored(folder / "truth" / f"{key}-{repeats}.npz", simulated)
    return [Measured(*(arrays[f"{name}{half}"] for name in Measured.__dataclass_fields__)) for half in range(2)]


def texture_of(key: str, model: str, folder: Path) -> Texture:
    """Texture of a surface by a model, trained once; a network with a random part, without which it falls silent."""
    settings, sizes = (FOTEN_RECIPE, {"excitation": True}) if model == "foten" else ({}, {})

    def job() -> TrainingJob:
        config = recipe_of(model, threads=1, seed=SEED, **settings)
        recording = simulate(key, SECONDS, SEED)
        return TrainingJob(recording, model, trainable_sizes(model, sizes), config, split_seed=SEED)

    return trained(folder / model / f"{key}.foten", job)


def hands() -> dict[str, tuple[Array, Array]]:
    """Speed [mm/s] and force [N] of the stroke as a rendering gets them, (n,) each."""
    stroke, config = abrupt_stroke(MODEL_HZ)[0], PreprocessConfig()
    late = condition(stroke.velocity.T, stroke.force, MODEL_HZ, config.render_lowpass_hz)
    delay = round(config.delay_ms * MODEL_HZ / 1000)
    aligned = tuple(np.concatenate([channel[delay:], np.repeat(channel[-1:], delay)]) for channel in late)
    return dict(zip(HANDS, (late, (aligned[0], aligned[1]), (stroke.speed, stroke.force)), strict=True))


def rendered(texture: Texture, hand: tuple[Array, Array], repeats: int, excitation: bool = True) -> Measured:
    """The same of renderings, each after a lead-in of its own."""
    lead = round(LEAD_IN_S * MODEL_HZ)
    first = np.random.default_rng(SEED).integers(0, lead, repeats)
    n = len(hand[0])
    at = np.arange(lead + n)[None] - first[:, None]
    speed, force = (channel[np.clip(at, 0, n - 1)] for channel in hand)
    signals, _ = render_strokes(NativeTexture(texture.to_bytes()), SEED, speed, force, STREAM, excitation=excitation)
    cut = np.stack([signal[start : start + n] for signal, start in zip(signals, first, strict=True)])
    return measured(cut[:, None], abrupt_stroke(MODEL_HZ)[1])


def rows_of(key: str, rendering: str, hand: str, ours: Measured, true: Sequence[Measured]) -> Iterator[dict[str, str]]:
    """Row of each change: figures beside the halves of the truth, their mean, and levels in dB re the truth's mean power."""
    reference = float(np.mean([half.power.mean() for half in true]))
    noise = 0.0 if key in LINEAR_FAMILY else len(AXES) * ACCELEROMETER_NOISE**2  # density
    density = max(10 ** (FLOOR_DB / 10) * reference / (MODEL_HZ / 2), noise)
    floor = density * MODEL_HZ / 2
    frequencies = np.fft.rfftfreq(round(SPECTRUM_S * MODEL_HZ), 1 / MODEL_HZ)
    bins = scored_bins(frequencies, MODEL_HZ)

    def levels(power: Array) -> Array:
        return np.asarray(10 * np.log10(np.maximum(power, floor) / reference))

    def distance(p: Array, q: Array) -> Array:
        return log_spectral_distance(*(np.maximum(each[:, bins], density) for each in (p, q)))

    start, n = round(-LEVELS_S[0] / FRAME_S), round(AFTER_S / FRAME_S)
    parts = {"": slice(start, start + n), "settled_": slice(-n, None)}
    others = true[1:] if ours is true[0] else true
    away = [levels(ours.power) - levels(other.power) for other in others]
    figures: dict[str, Array] = {}
    for name, part in parts.items():
        spectra = [(ours.settled, other.settled) if name else (ours.after, other.after) for other in others]
        figures |= {
            f"{name}level_error_db": np.mean([np.abs(each[:, part]).mean(axis=1) for each in away], axis=0),
            f"{name}level_bias_db": np.mean([each[:, part].mean(axis=1) for each in away], axis=0),
            f"{name}lsd_db": np.mean([distance(*pair) for pair in spectra], axis=0),
        }
    whole = levels(ours.power) - levels(np.mean([other.power for other in others], axis=0))
    for i, change in enumerate(CHANGES):
        yield {
            **dict(zip(KEYS, (key, change, rendering, hand), strict=True)),
            "family": SURFACES.get(key, ""),
            **{name: f"{values[i]:.3f}" for name, values in figures.items()},
            "arrives_ms": arrives_ms(whole[i, start:]),
            **({LEVELS: drawn_levels(levels(ours.power)[i])} if hand in ("", "live") and key == DRAWN else {}),
        }


def drawn_levels(levels: Array) -> str:
    """Levels around a change, of frame after frame."""
    n = round((LEVELS_S[1] - LEVELS_S[0]) / FRAME_S)
    return " ".join(f"{level:.2f}" for level in levels[:n])


def arrives_ms(away: Array) -> str:
    """When a level has come within `NEAR_DB` and stays there for `NEAR_S` [ms]; empty for never."""
    n = round(NEAR_S / FRAME_S)
    near = np.lib.stride_tricks.sliding_window_view(np.abs(away) <= NEAR_DB, n).all(axis=1)
    return f"{1000 * FRAME_S * near.argmax():.0f}" if near.any() else ""


def judged(key: str, model: str, folder: Path, repeats: int) -> Iterator[dict[str, str]]:
    """Rows of a surface by a model, or of its truth."""
    true = truths(key, folder, repeats)
    if model == TRUTH:
        yield from rows_of(key, SECOND, "", true[0], true)
        if key in {**CONTACT, **TWO_MASS}:
            knock = measured(true_vibrations(key, [TRUTH_SEED], flat=True), abrupt_stroke(MODEL_HZ)[1])
            yield from rows_of(key, FLAT, "", knock, true)
        return
    texture, channels = texture_of(key, model, folder), hands()
    for hand in MODELS[model]:
        yield from rows_of(key, model, hand, rendered(texture, channels[hand], repeats), true)
    if model == "foten":  # whose loop does not vary
        yield from rows_of(key, SILENT, "live", rendered(texture, channels["live"], N_SILENT, excitation=False), true)


def of_model(row: Mapping[str, str], key: str, model: str) -> bool:
    """Whether a row is of a surface and a model, or of its truth."""
    renderings = {TRUTH: (SECOND, FLAT), "foten": ("foten", SILENT)}.get(model, (model,))
    return row["surface"] == key and row["rendering"] in renderings


def main() -> None:
    """Measure what the table lacks, and print its means."""
    parser = parser_of(__doc__)
    parser.set_defaults(csv=Path("docs/results/abrupt.csv"))
    parser.add_argument("--surfaces", nargs="+", default=list(SURFACES), choices=list(SURFACES))
    parser.add_argument("--models", nargs="+", default=list(MODELS), choices=MODELS)
    parser.add_argument("--again", nargs="+", default=[], choices=MODELS, help="models to train and measure anew")
    parser.add_argument(
        "--repeats", type=int, default=64, help="realisations of each change, of the truth twice as many"
    )
    parser.add_argument("--folder", type=Path, default=Path("build/abrupt"))
    options = parser.parse_args()
    rows = read_rows(options.csv)
    for model in options.again:
        for key in options.surfaces:
            (options.folder / model / f"{key}.foten").unlink(missing_ok=True)
            rows = [row for row in rows if not of_model(row, key, model)]
    for key in options.surfaces:
        for model in (TRUTH, *options.models):
            if any(of_model(row, key, model) for row in rows):
                continue
            new = list(judged(key, model, options.folder, options.repeats))
            rows += new
            write(rows, options.csv)
            print(json.dumps({"surface": key, "model": model, **means(new[: len(CHANGES)])}), flush=True)
    for rendering, hand in dict.fromkeys((row["rendering"], row["hand"]) for row in rows):
        some = [row for row in rows if (row["rendering"], row["hand"]) == (rendering, hand)]
        print(f"{rendering:24s} {hand:10s}", *(f"{name} {value:.2f}" for name, value in means(some).items()))


def means(rows: Sequence[Mapping[str, str]]) -> dict[str, float]:
    """Means of the figures of some rows."""
    names = [name for name in rows[0] if name.endswith("_db")]
    return {name: round(float(np.mean([float(row[name]) for row in rows])), 3) for name in names}


def write(rows: list[dict[str, str]], path: Path) -> None:
    """Write the table by surface and change; rows of a change stay in the order in which they were measured."""
    order = {change: i for i, change in enumerate(CHANGES)}
    rows.sort(key=lambda row: (list(SURFACES).index(row["surface"]), order[row["change"]]))
    write_rows(rows, path)


if __name__ == "__main__":
    main()
