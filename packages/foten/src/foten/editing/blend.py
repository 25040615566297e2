"""A texture between two: levels, reflection coefficients and tones blended, each stretch of innovations from either side."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from foten.dsp import Array
from foten.dsp.equaliser import Equaliser
from foten.dsp.speed_force_table import FORCE_FLOOR, SpeedForceTable
from foten.editing.describe import Description, describe, steady_figures
from foten.editing.edit import N_STEPS, UNMEASURED, with_level, with_spectrum
from foten.models.excitation import Excitation, Scale
from foten.models.foten_plus.definition import lattice_tensors, table_tensors
from foten.models.foten_plus.recorded_innovations import MAX_CANDIDATES, RecordedInnovations, encoded
from foten.models.foten_plus.recorded_store import evenly_thinned, stored_noise
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import Texture
from foten.recording.scaling import Scaling
from foten.runtime.proof import Tensors, proved

OF_FILE = ("format_version", "model", "sizes", "window", "units", "scaling")  # entries of a card that `proved` writes
OF_ONE_TEXTURE = ("takes", "authors", "source", "doi", "photo")
N_PHASES = 720  # tried, to bring the tones of two surfaces into step


@dataclass(frozen=True)
class _Side:
    """One of two textures of foten-plus, under the scaling of their blend."""

    texture: Texture
    scaling: Scaling  # of the blend

    @property
    def sizes(self) -> FotenPlusSizes:
        sizes = self.texture.sizes
        assert isinstance(sizes, FotenPlusSizes)
        return sizes

    def scale(self, prefix: str) -> Scale:
        """A scale of its own, of the blend's speed and force."""
        return rescaled(Scale.of(self.texture.tensors, prefix), self.scaling)

    def level(self, prefix: str) -> Scale:
        """A level in the blend's unit of acceleration."""
        level = self.scale(f"{prefix}level.")
        louder = self.texture.scaling.sd[0] / self.scaling.sd[0]
        return replace(level, out_bias=level.out_bias + np.log(louder), sigma_max=level.sigma_max * louder)

    def table(self, prefix: str, values: str) -> SpeedForceTable:
        names = f"{prefix}speed_knots", f"{prefix}force_knots", f"{prefix}{values}"
        return SpeedForceTable(*(self.texture.tensors[name].astype(np.float64) for name in names))

    @property
    def residual(self) -> str:
        """The prefix of the lattice that a rendering excites."""
        return "residual." if self.sizes.n_tones else "lattice."

    def windows(self, name: str, history: int) -> Array:
        """Stored windows (…, m, 3) in the blend's scaling and of its length."""
        window = self.texture.tensors[name].astype(np.float64)
        own, blend = self.texture.scaling, self.scaling
        window = (window * own.sd + np.array(own.mean) - blend.mean) / np.array(blend.sd)
        n = window.shape[-2]
        before = [(0, 0)] * (window.ndim - 2) + [(max(0, history - n), 0), (0, 0)]
        return np.pad(window, before, mode="symmetric")[..., -history:, :]

    def innovations(self) -> RecordedInnovations:
        """What it plays; of noise, as if it were recorded over the trained range."""
        if self.sizes.recorded:
            return RecordedInnovations.of(self.texture.tensors, self.sizes.along_path)
        speed, force = (self.texture.trained_range(name) for name in ("speed", "force"))
        return stored_noise(self.texture.rate_hz, speed, force)

    def network(self) -> Tensors:
        """Tensors of its network, with inputs of the blend."""
        prefix = "network."
        own = {key: t.copy() for key, t in self.texture.tensors.items() if key.startswith(prefix)}
        before, now = Scale.of(self.texture.tensors, "lattice.level."), self.scale("lattice.level.")
        shift = np.log((now.mean + now.floor) / (before.mean + before.floor))
        recurrent = "recurrent.weight_ih_l0", "recurrent.bias_ih_l0", 0
        for weight, bias, first in (recurrent, ("head.weight", "head.bias", self.sizes.n_hidden)):
            columns = own[prefix + weight][:, first + 3 : first + 5].astype(np.float64)
            own[prefix + bias] = (own[prefix + bias] + columns @ shift).astype(np.float32)
        return own


def blend(
    first: Texture,
    second: Texture,
    at: float,
    seed: int = 0,
    descriptions: tuple[Description, Description] | None = None,
    n_steps: int = N_STEPS,
) -> Texture:
    """The texture at a share of the way from a first to a second, 0 to 1, proved.

    Level (in decibels), centroid (over log frequency) and width at the described condition lie between those of the two, and so
    do the level over speed and force (in decibels), reflection coefficients (linear: every point is stable), amplitudes of tones
    once in step, and their periods (over log length). Recorded innovations are drawn from either side, by its share.

    Args:
        descriptions: of both, where they are known.
        n_steps: of the search for centroid and width; 0 leaves them as they come.

    Raises:
        ValueError: `at` is out of range, the rates differ, or a model cannot be blended.
    """
    if not 0 <= at <= 1:
        raise ValueError(f"at is {at:g}, expected 0 (the first texture) to 1 (the second)")
    check_blendable(first, second)
    if at in (0.0, 1.0):
        return second if at else first
    target = between(*(descriptions or (describe(first, seed), describe(second, seed))), at)
    blended = _blended(first, second, at)
    if n_steps:
        now = describe(blended, seed)
        target_at = replace(target, speed_mm_s=now.speed_mm_s, force_n=now.force_n)
        blended = with_spectrum(blended, now, target_at, seed, n_steps)
    return with_level(blended, target.level_db - steady_figures(blended, seed).level_db)


def check_blendable(first: Texture, second: Texture) -> None:
    """Refuse two textures that have no blend."""
    for texture in (first, second):
        if not texture.sizes.editable:
            raise ValueError(f"a texture is of {texture.card['model']}, expected two of foten-plus")
    if first.rate_hz != second.rate_hz:
        rates = f"{first.rate_hz:g} and {second.rate_hz:g} Hz"
        raise ValueError(f"the textures are of {rates}, expected one rate: train one again with --rate")
    if first.unit != second.unit:
        raise ValueError(f"one texture is in {first.unit}, the other in {second.unit}: levels cannot be compared")


def between(first: Description, second: Description, at: float) -> Description:
    """The level, centroid and width between two descriptions; the rest is the first's."""
    level, octave, width = (
        (1 - at) * a + at * b
        for a, b in (
            (first.level_db, second.level_db),
            (np.log(first.centroid_hz), np.log(second.centroid_hz)),
            (first.width_octaves, second.width_octaves),
        )
    )
    return replace(first, level_db=level, centroid_hz=float(np.exp(octave)), width_octaves=width)


def _blended(first: Texture, second: Texture, at: float) -> Texture:
    weights, both = np.array([1 - at, at]), (first, second)
    means, sds = (np.array([getattr(t.scaling, name) for t in both]) for name in ("mean", "sd"))
    mean, sd = weights @ means, np.exp(weights @ np.log(sds))
    scaling = Scaling(mean=tuple(mean.tolist()), sd=tuple(sd.tolist()))
    sides = [_Side(t, scaling) for t in both]
    near = sides[at >= 0.5]
    level, lattice = _joined_lattice(sides, ["lattice.", "lattice."], weights)
    tensors: Tensors = {**lattice_tensors("lattice.", level, lattice), **near.network()}
    pairs = list(zip(weights, sides, strict=True))
    log_gains = [w * Equaliser.of(side.texture.tensors).weights for w, side in pairs if side.sizes.equalised]
    if log_gains:
        tensors |= Equaliser.of_weights(np.sum(log_gains, axis=0), first.rate_hz).tensors()
    limits = [[max(x, 1e-9) for x in Excitation.of(t.tensors).innovation_limit] for t in both]
    in_sigma, in_sd = np.exp(weights @ np.log(limits))
    in_acceleration = float(in_sd * np.exp(weights @ np.log(sds[:, 0])) / sd[0])
    recorded, along_path = any(side.sizes.recorded for side in sides), all(side.sizes.along_path for side in sides)
    if recorded:
        played = _joined_innovations([side.innovations() for side in sides], weights, along_path)
        tensors |= played.tensors()
        in_sigma = max(in_sigma, float(np.abs(played.values).max()))
    sigma = joined_scales([side.scale("excitation.") for side in sides], weights)
    tensors |= Excitation(sigma, (float(in_sigma), in_acceleration)).tensors()
    of_tones, tonal = _blended_tones(sides, near, weights)
    sizes = replace(
        near.sizes,
        equalised=bool(log_gains),
        recorded=recorded,
        along_path=along_path,
        excitation_width=level.hidden_bias.size,
        order=lattice.values.shape[1],
        **_grid(lattice, ""),
        **of_tones,
    )
    golden = near.windows("golden.windows", sizes.history)[:-2]
    start, card = near.windows("warm_start", sizes.history), _card(both, near.texture, weights)
    return proved("foten-plus", sizes, tensors | tonal, scaling, golden, start, card).texture


def _joined_lattice(sides: list[_Side], prefixes: list[str], weights: Array) -> tuple[Scale, SpeedForceTable]:
    """The level and the reflection coefficients of a lattice of each side."""
    pairs = list(zip(sides, prefixes, strict=True))
    level = joined_scales([side.level(prefix) for side, prefix in pairs], weights)
    return level, joined_tables([side.table(prefix, "reflections") for side, prefix in pairs], weights)


def _grid(table: SpeedForceTable, name: str) -> dict[str, Any]:
    """Sizes of a table."""
    return {f"n_{name}speed": len(table.speed_knots), f"n_{name}force": len(table.force_knots)}


def _card(both: tuple[Texture, Texture], near: Texture, weights: Array) -> dict[str, Any]:
    """The card of a blend, but for what `proved` writes."""

    def linear(*values: Any) -> Any:
        return (weights @ np.array(values)).tolist()

    names = [t.card["texture"] or "a texture" for t in both]
    parts = [f"{name} ({t.evidence})" if t.evidence else name for name, t in zip(names, both, strict=True)]
    licences = [t.card["licence"] for t in both]
    credits = [", ".join(str(t.card[key]) for key in ("authors", "source") if t.card.get(key)) for t in both]
    channels = ("speed", "force")
    return {key: value for key, value in near.card.items() if key not in OF_FILE + OF_ONE_TEXTURE} | {
        "texture": f"{names[0]}–{names[1]}",
        "evidence": f"blended: {weights[0]:.3g} {parts[0]}, {weights[1]:.3g} {parts[1]}, {UNMEASURED}"[:500],
        "source": "; ".join(dict.fromkeys(credit for credit in credits if credit))[:500],
        "licence": licences[0] if licences[0] == licences[1] else "",
        **({"microphone": True} if any(t.card.get("microphone") for t in both) else {}),
        "split": None,
        "metrics": {},
        "saturation": linear(*(t.card["saturation"] for t in both)),
        "trained_range": {c: linear(*(t.trained_range(c) for t in both)) for c in channels},
        "extrapolation_exponents": {c: linear(*(t.extrapolation_exponent(c) for t in both)) for c in channels},
    }


def _joined_innovations(sides: list[RecordedInnovations], weights: Array, along_path: bool) -> RecordedInnovations:
    """Innovations of two sides, of whose candidates as many are kept as its share says: so are the stretches that are played."""
    pairs = list(zip(sides, weights, strict=True))
    total = min(MAX_CANDIDATES, *(side.candidates.size / weight for side, weight in pairs))
    moments = [evenly_thinned(side.moments, max(1, int(total * weight))) for side, weight in pairs]
    e = np.concatenate([side.innovations for side in sides]).reshape(-1, sides[0].step)
    return encoded(e, np.concatenate(moments), float(np.abs(e).max()), along_path)


def rescaled(scale: Scale, scaling: Scaling) -> Scale:
    """The same σ over speed and force in mm/s and N, for conditions in another scaling."""
    mean, sd = np.array(scaling.mean[1:]), np.array(scaling.sd[1:])
    shift = np.log((mean + scale.floor) / (scale.mean + scale.floor))
    linear, logs = scale.hidden_weight[:, :2], scale.hidden_weight[:, 2:]
    bias = scale.hidden_bias + linear @ ((mean - scale.mean) / scale.sd) + logs @ shift
    (q1, q2, q3, q4, q5), (d, g) = scale.exponents, shift
    powers = np.array([q1 + 2 * q3 * d + q4 * g, q2 + 2 * q5 * g + q4 * d, q3, q4, q5])
    constant = q1 * d + q2 * g + q3 * d * d + q4 * d * g + q5 * g * g
    weight = np.concatenate([linear * (sd / scale.sd), logs], axis=1)
    moved = {"hidden_weight": weight, "hidden_bias": bias, "out_bias": scale.out_bias + constant, "exponents": powers}
    return replace(scale, **moved, mean=mean, sd=sd)


def joined_scales(scales: list[Scale], weights: Array) -> Scale:
    """The σ whose logarithm is a weighted mean of those of scales of one scaling: their networks side by side."""
    first = scales[0]
    if any(not np.allclose(scale.floor, first.floor) for scale in scales):
        raise ValueError("the textures' levels start from different floors of speed and force")
    pairs = list(zip(weights, scales, strict=True))
    return replace(
        first,
        hidden_weight=np.concatenate([scale.hidden_weight for scale in scales]),
        hidden_bias=np.concatenate([scale.hidden_bias for scale in scales]),
        out_weight=np.concatenate([w * scale.out_weight for w, scale in pairs], axis=1),
        out_bias=np.sum([w * scale.out_bias for w, scale in pairs], axis=0),
        exponents=np.sum([w * scale.exponents for w, scale in pairs], axis=0),
        sigma_max=np.exp(np.sum([w * np.log(scale.sigma_max) for w, scale in pairs], axis=0)),
    )


def joined_tables(tables: list[SpeedForceTable], weights: Array) -> SpeedForceTable:
    """The weighted mean of tables, exactly: at the knots of all, missing values 0."""
    knots = [_union([getattr(table, name) for table in tables]) for name in ("speed_knots", "force_knots")]
    grid = [axis.ravel() for axis in np.meshgrid(*knots, indexing="ij")]
    k = max(table.values.shape[1] for table in tables)
    values = np.zeros((len(grid[0]), k))
    for weight, table in zip(weights, tables, strict=True):
        at = table.at(grid[0], np.exp(grid[1]) - FORCE_FLOOR)
        values[:, : at.shape[1]] += weight * at
    return SpeedForceTable(knots[0], knots[1], values)


def _union(knots: list[Array]) -> Array:
    """Knots of several axes; one that a table is constant over needs none."""
    several = [axis for axis in knots if len(axis) > 1]
    return np.unique(np.concatenate(several).astype(np.float32)).astype(np.float64) if several else knots[0]


def _blended_tones(sides: list[_Side], near: _Side, weights: Array) -> tuple[dict[str, Any], Tensors]:
    """Sizes and tensors of the tones, with their period, its jitter and its leak, and of what they leave."""
    tonal = [(w, side) for w, side in zip(weights, sides, strict=True) if side.sizes.n_tones]
    if not tonal:
        names = "n_tone_speed n_tone_force residual_order n_residual_speed n_residual_force"
        return {"n_tones": 0, **dict.fromkeys(names.split(), 1)}, {}
    tables = [side.table("tones.", "values") for _, side in tonal]
    if len(tables) == 2:
        tables[1] = in_step(tables[1], tables[0])
    shares = np.array([w for w, _ in tonal])
    of_sides = np.array([side.texture.tensors["tones.phase_params"].astype(np.float64) for _, side in tonal])
    relative = shares / shares.sum()
    params = np.array([np.exp(relative @ np.log(of_sides[:, 0])), *(relative @ of_sides[:, 1:])])
    tones = joined_tables(tables, shares)
    level, residual = _joined_lattice(sides, [side.residual for side in sides], weights)
    sizes, before_filter = near.sizes, near.sizes.gain_before_filter
    counts = {
        "n_tones": max(side.sizes.n_tones for _, side in tonal),
        "residual_order": residual.values.shape[1],
        "residual_gain_before_filter": sizes.residual_gain_before_filter if sizes.n_tones else before_filter,
    }
    tensors = {**lattice_tensors("residual.", level, residual), **table_tensors("tones.", tones, "values")}
    tensors["tones.phase_params"] = params.astype(np.float32)
    return {**counts, **_grid(residual, "residual_"), **_grid(tones, "tone_")}, tensors


def in_step(table: SpeedForceTable, other: SpeedForceTable) -> SpeedForceTable:
    """Tones begun at the place of the path where they are most like others."""
    a, b = (_mean_amplitudes(t) for t in (other, table))
    n = min(len(a), len(b))
    phases = 2 * np.pi * np.arange(N_PHASES) / N_PHASES
    # A cos hφ + B sin hφ is Re((A − iB) e^{ihφ}).
    turns = np.exp(1j * np.outer(phases, np.arange(1, n + 1)))
    best = phases[np.argmax((turns * (b[:n] * np.conj(a[:n]))).real.sum(axis=1))]
    pairs = table.values.reshape(len(table.values), -1, 2)
    turned = (pairs[..., 0] - 1j * pairs[..., 1]) * np.exp(1j * best * np.arange(1, pairs.shape[1] + 1))
    return replace(table, values=np.stack([turned.real, -turned.imag], axis=2).reshape(table.values.shape))


def _mean_amplitudes(table: SpeedForceTable) -> Any:
    pairs = table.values.mean(axis=0).reshape(-1, 2)
    return pairs[:, 0] - 1j * pairs[:, 1]
