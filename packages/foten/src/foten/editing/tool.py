"""Another tool: a filter and a level by which its vibration differs from that of the tool that a texture was recorded with.

    one surface, both tools ─▶ spectra by speed and force ─▶ Transfer ─▶ a texture as that tool would feel it

The filter, of least delay, multiplies the spectra of lattices and the amplitudes of tones. Source: ours; measured on eight pens
(docs/less-than-a-recording.md).
"""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.atomic_write import write_json
from foten.dsp import Array
from foten.dsp.distance import MIN_SCORED_HZ, max_scored_hz
from foten.editing.edit import evidence_of, fundamental_hz, knots_of, largest_ratio, lattices
from foten.editing.warp import N_BINS, reflections_for, spectra_of
from foten.models.conditions import MOVING_FORCE, MOVING_SPEED
from foten.models.excitation import Scale, powers
from foten.models.texture_file import Texture
from foten.recording.trace import Trace
from foten.runtime.proof import reproved
from foten.untrusted import is_number, read_profile_json

FORMAT, VERSION = "foten-tool", 1
FRAME_S = 0.256  # of a spectrum
PER_OCTAVE = 6  # bands
SPEED_RATIO, FORCE_RATIO = 1.4, 1.6  # of the edges of a cell
MIN_FRAMES = 4  # of a cell, of each tool
MAX_GAIN_DB = 60.0
POWER_SD = 0.2  # prior of the powers of speed and force by which a gain grows
MAX_BANDS = 200
FRAME_SD_DB = 4.34  # of the power in one bin of one frame


@dataclass(frozen=True)
class Transfer:
    """How another tool differs from the one that textures were recorded with."""

    first: str  # tool of the textures
    second: str
    hz: tuple[float, ...]  # rising
    gain_db: tuple[float, ...]
    gain_sd_db: tuple[float, ...]  # standard error, from cell to cell
    speed_mm_s: float  # where the gain is as stated
    force_n: float
    speed_exponent: float = 0.0  # powers that the gain grows with, beyond those of the texture
    force_exponent: float = 0.0

    def __post_init__(self) -> None:
        sizes = {len(self.hz), len(self.gain_db), len(self.gain_sd_db)}
        numbers = [*self.hz, *self.gain_db, *self.gain_sd_db, self.speed_mm_s, self.force_n]
        numbers += [self.speed_exponent, self.force_exponent]
        if len(sizes) != 1 or not 2 <= len(self.hz) <= MAX_BANDS:
            raise ValueError(f"the filter has {len(self.hz)} frequencies, expected 2 to {MAX_BANDS}, and a gain each")
        if not all(map(is_number, numbers)):
            raise ValueError("a figure of the tool is no finite number")
        if not (np.diff(self.hz) > 0).all() or self.hz[0] <= 0:
            raise ValueError("the frequencies of the filter do not rise")
        if max(map(abs, self.gain_db)) > MAX_GAIN_DB or max(abs(self.speed_exponent), abs(self.force_exponent)) > 2:
            raise ValueError(f"a gain of the tool is beyond {MAX_GAIN_DB:g} dB, or a power beyond 2")
        if min(self.speed_mm_s, self.force_n) <= 1e-3:
            raise ValueError("the speed or the force of the tool is not above 0.001")

    def gain(self, hz: Array) -> Array:
        """Gain of power at frequencies [Hz], constant outside."""
        level = np.interp(np.log2(np.maximum(hz, 1e-3)), np.log2(self.hz), self.gain_db)
        return np.asarray(10 ** (level / 10))


def fitted_transfer(first: list[Trace], second: list[Trace], names: tuple[str, str] = ("", "")) -> Transfer:
    """The transfer between two tools, from traces of the same surfaces in turn; ValueError where they share no speed and force.

    Spectra are compared in cells of speed and force where both have been. The filter is the mean over cells of the ratio in
    bands; powers of speed and force follow the ratio of levels, weighed against a prior of 0 ± 0.2.
    """
    if len(first) != len(second):
        raise ValueError(f"{len(first)} recordings of one tool and {len(second)} of the other, expected as many")
    rates = {trace.rate_hz for trace in (*first, *second)}
    if len(rates) != 1:
        raise ValueError(f"recordings are at {', '.join(f'{rate:g}' for rate in sorted(rates))} Hz, expected one rate")
    (rate,) = rates
    centres = MIN_SCORED_HZ * 2 ** np.arange(0, np.log2(max_scored_hz(rate) / MIN_SCORED_HZ), 1 / PER_OCTAVE)
    ratios, logs, counts = [], [], []
    for a, b in zip(first, second, strict=True):
        cells = _cells(a, centres), _cells(b, centres)
        for key in cells[0].keys() & cells[1].keys():
            (power_a, log_a), (power_b, log_b) = cells[0][key], cells[1][key]
            n = min(len(power_a), len(power_b))
            if n < MIN_FRAMES:
                continue
            ratios.append(10 * np.log10(power_b.mean(axis=0) / power_a.mean(axis=0)))
            logs.append(0.5 * (log_a.mean(axis=0) + log_b.mean(axis=0)))
            counts.append(n)
    if not ratios:
        raise ValueError("the two tools were never at one speed and force for a second: stroke both over one range")
    ratio, weight, at = np.array(ratios), np.array(counts) / sum(counts), np.array(logs)
    centre = weight @ at
    exponents = _exponents(ratio.mean(axis=1), at - centre, np.array(counts))
    gain = weight @ ratio
    spread = np.sqrt(weight @ np.square(ratio - gain) / max(1, len(ratios) - 1))
    chance = FRAME_SD_DB * np.sqrt(2 / sum(counts))
    speed, force = np.exp(centre)
    return Transfer(
        *names,
        hz=tuple(np.round(centres, 3).tolist()),
        gain_db=tuple(np.round(gain, 3).tolist()),
        gain_sd_db=tuple(np.round(np.maximum(spread, chance), 3).tolist()),
        speed_mm_s=round(float(speed), 3),
        force_n=round(float(force), 4),
        speed_exponent=round(float(exponents[0]), 4),
        force_exponent=round(float(exponents[1]), 4),
    )


def _cells(trace: Trace, centres: Array) -> dict[tuple[int, int], tuple[Array, Array]]:
    """Band powers (n, k), and log speed and log force (n, 2), of frames by cell; frames near rest are left out."""
    n = round(FRAME_S * trace.rate_hz)
    starts = np.arange(0, len(trace.acceleration) - n + 1, n // 2)
    index = starts[:, None] + np.arange(n)
    if trace.block > n:  # a frame within one block: blocks of different takes do not join
        index = index[index[:, 0] // trace.block == index[:, -1] // trace.block]
    frames = trace.acceleration[index]
    density: NDArray[Any] = np.abs(np.fft.rfft(frames * np.hanning(n), axis=1)) ** 2
    hz = np.asarray(np.fft.rfftfreq(n, 1 / trace.rate_hz), dtype=np.float64)
    bands = np.stack([density[:, _inside(hz, centre)].mean(axis=1) for centre in centres], axis=1)
    speed, force = trace.speed[index].mean(axis=1), trace.force[index].mean(axis=1)
    cells: dict[tuple[int, int], list[int]] = {}
    for i in np.flatnonzero((speed >= MOVING_SPEED) & (force >= MOVING_FORCE)):
        key = int(np.log(speed[i]) // np.log(SPEED_RATIO)), int(np.log(force[i]) // np.log(FORCE_RATIO))
        cells.setdefault(key, []).append(int(i))
    logs = np.log(np.maximum(np.stack([speed, force], axis=1), 1e-9))
    return {key: (np.maximum(bands[rows], 1e-30), logs[rows]) for key, rows in cells.items()}


def _inside(hz: Array, centre: float) -> NDArray[np.intp]:
    """Bins of a band, or the nearest where it holds none."""
    half = 2 ** (0.5 / PER_OCTAVE)
    inside = np.flatnonzero((hz >= centre / half) & (hz < centre * half))
    return inside if inside.size else np.array([int(np.argmin(np.abs(hz - centre)))])


def _exponents(level_db: Array, logs: Array, counts: Array) -> Array:
    """Powers (2,) by which a level [dB] grows over centred logarithms (n, 2), shrunk towards 0."""
    y = level_db * np.log(10) / 20
    y = y - np.average(y, weights=counts)
    noise = np.square(FRAME_SD_DB * np.log(10) / 20) / np.maximum(counts, 1) + 0.05**2  # and 0.4 dB from cell to cell
    precision = logs.T @ (logs / noise[:, None]) + np.eye(2) / POWER_SD**2
    return np.asarray(np.linalg.solve(precision, logs.T @ (y / noise)))


def transferred(texture: Texture, transfer: Transfer) -> Texture:
    """The texture as the other tool would feel it, proved; ValueError for one that is not of foten-plus."""
    words = f"for the tool {transfer.second or 'of a transfer'}, by a filter and a level"
    return filtered(texture, transfer, words, transfer.second or texture.card["tool"])


def filtered(texture: Texture, transfer: Transfer, words: str, tool: str) -> Texture:
    """The texture through a filter and with other powers, proved, with words for its card; otherwise as `transferred`."""
    if not texture.sizes.editable:
        raise ValueError(f"the texture is of {texture.card['model']}, expected one of foten-plus")
    card, tensors = texture.card, texture.tensors
    gain = transfer.gain(np.linspace(0, texture.rate_hz / 2, N_BINS + 1))
    changed: dict[str, NDArray[Any]] = {}
    levels, rise = {}, 1.0
    for prefix, order in zip(lattices(texture), ("order", "residual_order"), strict=False):
        density = spectra_of(tensors[f"{prefix}reflections"].astype(np.float64))
        through = density * gain
        changed[f"{prefix}reflections"] = reflections_for(through, card["sizes"][order]).astype(np.float32)
        log_gain = 0.5 * np.log(through.sum(axis=1) / density.sum(axis=1))
        level = Scale.of(tensors, f"{prefix}level.")
        levels[prefix] = _louder(level, log_gain, knots_of(tensors, prefix), transfer, texture)
        changed |= levels[prefix].tensors(f"{prefix}level.")
        rise = max(rise, float(levels[prefix].sigma_max[0] / level.sigma_max[0]))
    if card["sizes"]["n_tones"]:
        changed["tones.values"] = _tones(texture, levels["lattice."], transfer).astype(np.float32)
    limit = tensors["excitation.innovation_limit"].copy()
    limit[1] *= rise
    changed["excitation.innovation_limit"] = limit
    grown = {"speed": transfer.speed_exponent, "force": transfer.force_exponent}
    exponents = {name: texture.extrapolation_exponent(name) + power for name, power in grown.items()}
    entries = {
        "tool": tool,
        "evidence": evidence_of(texture, words),
        "extrapolation_exponents": {name: float(np.clip(power, 0.0, 2.0)) for name, power in exponents.items()},
        "saturation": float(card["saturation"] * rise),
    }
    return reproved(texture, entries, changed)


def _louder(level: Scale, log_gain: Array, knots: Array, transfer: Transfer, texture: Texture) -> Scale:
    """A level with the gain of a filter at knots (n,), over speed and force, and the powers of a tool."""
    terms: Array = np.zeros(5)
    constant = float(log_gain.mean())
    if len(knots) > 1:
        logs = level.logarithms((knots - level.mean) / level.sd)
        design = np.column_stack([np.ones(len(knots)), powers(logs)])
        ridge = 1e-3 * len(knots) * np.diag([0.0, 1.0, 1.0, 1.0, 1.0, 1.0])
        solved = np.linalg.solve(design.T @ design + ridge, design.T @ log_gain)
        constant, terms = float(solved[0]), np.asarray(solved[1:], dtype=np.float64)
    own = np.array([transfer.speed_exponent, transfer.force_exponent])
    reference = (np.array([[transfer.speed_mm_s, transfer.force_n]]) - level.mean) / level.sd
    terms[:2] += own
    constant -= float(own @ level.logarithms(reference)[0])
    out_bias, exponents = level.out_bias + constant, level.exponents + terms
    free = replace(level, out_bias=out_bias, exponents=exponents, sigma_max=np.array([np.inf]))
    return replace(free, sigma_max=level.sigma_max * max(largest_ratio(free, level, texture, 5), 1e-6))


def _tones(texture: Texture, level: Scale, transfer: Transfer) -> Array:
    """Amplitudes of tones over the new level, (n, 2 n_tones)."""
    before, knots = Scale.of(texture.tensors, "lattice.level."), knots_of(texture.tensors, "tones.")
    values = texture.tensors["tones.values"].astype(np.float64)
    multiples = np.repeat(np.arange(1, values.shape[1] // 2 + 1), 2)
    gain = np.sqrt(transfer.gain(fundamental_hz(texture)[:, None] * multiples))
    scaled = (knots - before.mean) / before.sd
    own = (knots / [transfer.speed_mm_s, transfer.force_n]) ** [transfer.speed_exponent, transfer.force_exponent]
    return np.asarray(values * gain * (own.prod(axis=1) * before(scaled) / level(scaled))[:, None])


def write_transfer(transfer: Transfer, path: Path) -> None:
    """Write a transfer as JSON, whole or not at all."""
    write_json(path, {"format": FORMAT, "version": VERSION, **asdict(transfer)})


def read_transfer(path: Path) -> Transfer:
    """The transfer in a file, or ValueError where it is none."""
    content = read_profile_json(path, FORMAT, VERSION, "a tool of 'foten tool measure'")
    try:
        lists: dict[str, Any] = {name: tuple(content.pop(name)) for name in ("hz", "gain_db", "gain_sd_db")}
        return Transfer(**content, **lists)
    except (TypeError, KeyError) as error:
        raise ValueError(f"{path.name} is no tool ({error})") from None
