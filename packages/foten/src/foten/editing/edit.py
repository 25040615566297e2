"""A texture moved by figures that `editing.describe` measures: level, centroid, width, roughness, period, exponents."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.speed_force_table import FORCE_FLOOR
from foten.editing.describe import Description, describe, steady_figures
from foten.editing.envelope import EnvelopeCurve, with_envelope
from foten.editing.warp import Warp, warped_reflections, warped_tones
from foten.models.excitation import Scale
from foten.models.texture_file import Texture
from foten.runtime.proof import reproved

MAX_LEVEL_DB = 40.0
MAX_OCTAVES = 3.0
MAX_ROUGHER_DB = 6.0
MAX_PERIOD_RATIO = 10.0
MAX_EXPONENT = 2.0
N_STEPS = 6  # of the search for a centroid and a width
CLOSE_OCTAVES = 0.01  # enough of both
N_ROUGHNESS_STEPS = 3
CLOSE_ROUGHNESS_DB = 0.1
UNREACHED_OCTAVES = 0.05  # what is further off is said
UNREACHED_ROUGHNESS_DB = 0.25  # likewise
MIN_STRETCH, MAX_STRETCH = 0.1, 10.0
UNMEASURED = "not measured"  # what a card says of a texture that was not learned from a recording


@dataclass(frozen=True)
class Edit:
    """What to change of a texture; the defaults change nothing."""

    level_db: float = 0.0  # louder
    brighter: float = 0.0  # centroid, upwards [octave]
    wider: float = 0.0  # width [octave]
    rougher: float = 0.0  # envelope: standard deviation of the level in frames of 40 ms [dB]
    period_mm: float | None = None
    speed_exponent: float | None = None  # of the level
    force_exponent: float | None = None

    def __post_init__(self) -> None:
        for name, value, limit, unit in (
            ("level", self.level_db, MAX_LEVEL_DB, "dB"),
            ("brighter", self.brighter, MAX_OCTAVES, "octaves"),
            ("wider", self.wider, MAX_OCTAVES, "octaves"),
            ("rougher", self.rougher, MAX_ROUGHER_DB, "dB"),
        ):
            if not -limit <= value <= limit:
                raise ValueError(f"{name} is {value:g} {unit}, expected {-limit:g} to {limit:g}")
        if self.period_mm is not None and not 0 < self.period_mm < np.inf:
            raise ValueError(f"the period is {self.period_mm:g} mm, expected more than 0")
        for name, power in (("speed", self.speed_exponent), ("force", self.force_exponent)):
            if power is not None and not 0 <= power <= MAX_EXPONENT:
                raise ValueError(f"the exponent of {name} is {power:g}, expected 0 to {MAX_EXPONENT:g}")

    def in_words(self) -> str:
        """What it changes, for the card."""
        octaves = {"centroid": self.brighter, "width": self.wider}
        parts = [
            *([f"level {self.level_db:+g} dB"] if self.level_db else []),
            *(f"{name} {value:+g} octaves" for name, value in octaves.items() if value),
            *([f"roughness {self.rougher:+g} dB"] if self.rougher else []),
            *([f"period {self.period_mm:g} mm"] if self.period_mm is not None else []),
        ]
        exponents = {"speed": self.speed_exponent, "force": self.force_exponent}
        return ", ".join(parts + [f"level ~ {name}^{x:g}" for name, x in exponents.items() if x is not None])


@dataclass(frozen=True)
class Edited:
    """A texture that was edited, described before and after, and what was not reached."""

    texture: Texture
    before: Description
    after: Description
    unreached: tuple[str, ...] = ()


def edited(texture: Texture, edit: Edit, seed: int = 0) -> Edited:
    """The texture with an edit, proved; ValueError where the model cannot be edited so, or there is no period to change.

    Centroid and width are searched for on renderings, so that `describe` gives what was asked; the level stays there.
    """
    before = describe(texture, seed)
    moved = moved_by(texture, edit, before, seed)
    after = describe(moved, seed)
    return Edited(moved, before, after, tuple(_unreached(edit, before, after)))


def moved_by(
    texture: Texture,
    edit: Edit,
    before: Description,
    seed: int = 0,
    n_steps: int = N_STEPS,
    curve: EnvelopeCurve | None = None,
) -> Texture:
    """The texture with an edit, as `edited`, of a description and a curve that are measured; in one step it is near, and fast."""
    check_editable(texture, edit, before)
    moved = texture
    if edit.period_mm is not None:
        moved = with_period(moved, edit.period_mm)
    if edit.speed_exponent is not None or edit.force_exponent is not None:
        moved = with_exponents(moved, before, edit)
    if edit.brighter or edit.wider or edit.rougher:
        now = describe(moved, seed) if edit.period_mm is not None else before
        octaves, width = 2**edit.brighter, now.width_octaves + edit.wider
        target = replace(now, centroid_hz=now.centroid_hz * octaves, width_octaves=width)
        if edit.rougher:
            target = replace(target, roughness_db=now.roughness_db + edit.rougher)
            moved = with_roughness(moved, now, target, curve or EnvelopeCurve(texture, seed), seed, n_steps)
        else:
            moved = with_spectrum(moved, now, target, seed, n_steps)
    moved = with_level(moved, before.level_db + edit.level_db - steady_figures(moved, seed).level_db)
    done = f"edited: {edit.in_words()}, {UNMEASURED}" if edit.in_words() else ""
    return reproved(moved, {"evidence": evidence_of(texture, done)})


def evidence_of(texture: Texture, words: str) -> str:
    """What the card says of the evidence for a texture, with further words."""
    return "; ".join(part for part in (texture.evidence, words) if part)[:500]


def check_editable(texture: Texture, edit: Edit, before: Description) -> None:
    """Refuse what a texture's model cannot do."""
    model = texture.card["model"]
    if not texture.sizes.editable and edit != Edit(level_db=edit.level_db):
        raise ValueError(f"only the level of {model} can be edited, expected foten-plus for the rest")
    if edit.period_mm is not None:
        if before.period_mm is None:
            raise ValueError("the texture has no period to change: nothing in its recording repeated along the path")
        ratio = edit.period_mm / before.period_mm
        if not 1 / MAX_PERIOD_RATIO <= ratio <= MAX_PERIOD_RATIO:
            raise ValueError(
                f"the period is {edit.period_mm:g} mm, expected {before.period_mm / MAX_PERIOD_RATIO:.3g} to "
                f"{before.period_mm * MAX_PERIOD_RATIO:.3g} mm for a surface that repeats every {before.period_mm:.3g} mm"
            )
    if before.width_octaves + edit.wider <= 0.02:
        raise ValueError(f"wider is {edit.wider:g} octaves, the width is {before.width_octaves:.2f}: nothing is left")


def with_level(texture: Texture, gain_db: float) -> Texture:
    """The texture louder by a gain: what it renders is multiplied, and nothing else changes."""
    gain = 10 ** (gain_db / 20)
    scaling = texture.card["scaling"]
    mean, sd = ([values[0] * gain, *values[1:]] for values in (scaling["mean"], scaling["sd"]))
    return Texture({**texture.card, "scaling": {"mean": mean, "sd": sd}}, texture.tensors)


def with_period(texture: Texture, period_mm: float) -> Texture:
    """The texture with another period of its tones."""
    params = texture.tensors["tones.phase_params"].copy()
    params[0] = 2 * np.pi / (period_mm * texture.rate_hz)
    return reproved(texture, {}, {"tones.phase_params": params})


def with_exponents(texture: Texture, at: Description, edit: Edit) -> Texture:
    """The texture whose level grows with other powers of speed and force, about the described condition."""
    tensors = dict(texture.tensors)
    extrapolation = dict(texture.card["extrapolation_exponents"])
    changes = (
        ("speed", edit.speed_exponent, at.speed_exponent, at.speed_mm_s),
        ("force", edit.force_exponent, at.force_exponent, at.force_n),
    )
    for prefix in lattices(texture):
        level = Scale.of(tensors, f"{prefix}level.")
        exponents = level.exponents.copy()
        for row, (name, power, now, value) in enumerate(changes):
            if power is not None:
                # d log ℓ / d log v = exponent · v / (v + floor)
                exponents[row] += (power - (now or 0.0)) * (value + level.floor[row]) / value
                extrapolation[name] = power
        free = replace(level, exponents=exponents, sigma_max=np.array([np.inf]))
        louder = largest_ratio(free, level, texture, 2)
        tensors |= replace(free, sigma_max=level.sigma_max * max(1.0, louder)).tensors(f"{prefix}level.")
    return reproved(texture, {"extrapolation_exponents": extrapolation}, tensors)


def lattices(texture: Texture) -> tuple[str, ...]:
    """Prefixes of a texture's lattices: of the whole signal and, where there are tones, of the residual."""
    return ("lattice.", "residual.") if texture.card["sizes"]["n_tones"] else ("lattice.",)


def largest_ratio(level: Scale, before: Scale, texture: Texture, n: int) -> float:
    """By how much a level exceeds another one at most, at n speeds and n forces of the trained range."""
    speeds, forces = (np.linspace(*texture.trained_range(name), n) for name in ("speed", "force"))
    scaled = (np.array([[v, f] for v in speeds for f in forces]) - level.mean) / level.sd
    return float((level(scaled) / before(scaled)).max())


def knots_of(tensors: Mapping[str, NDArray[Any]], prefix: str) -> Array:
    """Speeds and forces of a table's knots, (n, 2) [mm/s, N]."""
    speed, force = (tensors[f"{prefix}{name}"].astype(np.float64) for name in ("speed_knots", "force_knots"))
    grid = np.meshgrid(speed, np.exp(force) - FORCE_FLOOR, indexing="ij")
    return np.stack([axis.ravel() for axis in grid], axis=1)


def fundamental_hz(texture: Texture) -> Array:
    """Frequency of the first tone [Hz] at the knots of the table of tones, (n,)."""
    increment = float(texture.tensors["tones.phase_params"][0])
    return increment * knots_of(texture.tensors, "tones.")[:, 0] * texture.rate_hz / (2 * np.pi)


def with_roughness(
    texture: Texture, before: Description, target: Description, curve: EnvelopeCurve, seed: int, n_steps: int
) -> Texture:
    """The texture with roughness, centroid and width of a description; each changes the others a little."""
    rougher = target.roughness_db - before.roughness_db
    asked, best, error = rougher, texture, np.inf
    for _ in range(N_ROUGHNESS_STEPS if n_steps > 1 else 1):
        moved = with_spectrum(with_envelope(texture, curve.strength(asked)), before, target, seed, n_steps)
        if n_steps == 1:
            return moved
        missing = target.roughness_db - steady_figures(moved, seed).roughness_db
        if abs(missing) < error:
            best, error = moved, abs(missing)
        if error < CLOSE_ROUGHNESS_DB:
            break
        asked += missing
        if asked * rougher <= 0:  # rougher cannot be reached by smoother
            break
    return best


def with_spectrum(
    texture: Texture, before: Description, target: Description, seed: int, n_steps: int = N_STEPS
) -> Texture:
    """The texture with the centroid and the width of a description, as near as its tones let it come."""
    octaves = float(np.log2(target.centroid_hz / before.centroid_hz))
    stretch = target.width_octaves / before.width_octaves
    best, error = texture, np.inf
    for _ in range(n_steps):
        stretch = float(np.clip(stretch, MIN_STRETCH, MAX_STRETCH))
        moved = warped(texture, Warp(before.centroid_hz, octaves, stretch))
        now = steady_figures(moved, seed)
        missing = float(np.log2(target.centroid_hz / now.centroid_hz)), target.width_octaves - now.width_octaves
        if np.hypot(*missing) < error:
            best, error = moved, float(np.hypot(*missing))
        if error < CLOSE_OCTAVES:
            break
        octaves += missing[0]
        stretch *= target.width_octaves / now.width_octaves
    return best


def warped(texture: Texture, warp: Warp) -> Texture:
    """The texture with the spectra of its lattices and the envelope of its tones warped."""
    changed: dict[str, NDArray[Any]] = {}
    for prefix in lattices(texture):
        reflections = texture.tensors[f"{prefix}reflections"].astype(np.float64)
        moved = warped_reflections(reflections, texture.rate_hz, warp)
        changed[f"{prefix}reflections"] = moved.astype(np.float32)
    if texture.card["sizes"]["n_tones"]:
        values = texture.tensors["tones.values"].astype(np.float64)
        changed["tones.values"] = warped_tones(values, fundamental_hz(texture), warp).astype(np.float32)
    return reproved(texture, {}, changed)


def _unreached(edit: Edit, before: Description, after: Description) -> list[str]:
    """What a description lacks of an edit, in words."""
    if edit.period_mm is not None:
        return []
    centroid, width = before.centroid_hz * 2**edit.brighter, before.width_octaves + edit.wider
    roughness, messages = before.roughness_db + edit.rougher, []
    if edit.brighter or edit.wider:
        if abs(np.log2(after.centroid_hz / centroid)) > UNREACHED_OCTAVES:
            messages.append(f"the centroid is {after.centroid_hz:.0f} Hz, not {centroid:.0f}: tones stay on the path")
        if abs(after.width_octaves - width) > UNREACHED_OCTAVES:
            messages.append(f"the width is {after.width_octaves:.2f} octaves, {width:.2f} were asked")
    if edit.rougher and abs(after.roughness_db - roughness) > UNREACHED_ROUGHNESS_DB:
        why = "noise and tones have an envelope of their own"
        messages.append(f"the roughness is {after.roughness_db:.2f} dB, {roughness:.2f} were asked: {why}")
    return messages
