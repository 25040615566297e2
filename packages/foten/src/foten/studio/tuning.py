"""Textures of the server moved by sliders, for the page that strokes them meanwhile."""

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

from foten.editing.blend import blend
from foten.editing.describe import Description, describe, period_of
from foten.editing.edit import N_STEPS, Edit, moved_by
from foten.editing.envelope import EnvelopeCurve
from foten.models.texture_file import Texture, read_texture

SLIDERS = {"level": 12.0, "brighter": 1.5, "wider": 0.6, "rougher": 3.0, "period": 1.0, "at": 1.0}
"""Largest size of each slider: dB, octaves, octaves, dB, octaves of the period, share of the way to another texture."""


@lru_cache(maxsize=16)
def _known(path: Path, modified_ns: int) -> tuple[Texture, Description]:
    """A texture and its description, until its file changes."""
    texture = read_texture(path)
    return texture, describe(texture)


@lru_cache(maxsize=16)
def _curve(path: Path, modified_ns: int) -> EnvelopeCurve:
    return EnvelopeCurve(_known(path, modified_ns)[0])


def moves_of(query: Mapping[str, str]) -> dict[str, float]:
    """The sliders of a request, those in the middle left out; ValueError where one is no number within its range."""
    moves = {}
    for name, high in SLIDERS.items():
        try:
            value = float(query.get(name, "0"))
        except ValueError:
            raise ValueError(f"{name} is no number") from None
        low = 0.0 if name == "at" else -high
        if not low <= value <= high:
            raise ValueError(f"{name} is {value:g}, expected {low:g} to {high:g}")
        if value:
            moves[name] = value
    return moves


def tuned(path: Path, other: Path | None, moves: Mapping[str, float], exact: bool) -> bytes:
    """A texture blended with another and moved, as a file's bytes; ValueError where it cannot be moved so.

    `exact` searches until centroid and width are what was asked; else one step is taken towards them, for a slider that moves.
    """
    file = path, path.stat().st_mtime_ns
    texture, description = _known(*file)
    curve = _curve(*file) if "rougher" in moves and not moves.get("at") else None
    if other is not None and moves.get("at"):
        towards, of_towards = _known(other, other.stat().st_mtime_ns)
        n_steps = N_STEPS if exact and not moves.keys() & {"brighter", "wider"} else 0  # which search by themselves
        texture = blend(texture, towards, moves["at"], 0, (description, of_towards), n_steps)
        description = describe(texture)
    period = period_of(texture)
    edit = Edit(
        level_db=moves.get("level", 0.0),
        brighter=moves.get("brighter", 0.0),
        wider=max(moves.get("wider", 0.0), 0.05 - description.width_octaves),
        rougher=moves.get("rougher", 0.0),
        period_mm=period * 2 ** moves["period"] if period is not None and "period" in moves else None,
    )
    if edit == Edit():
        return texture.to_bytes()
    return moved_by(texture, edit, description, 0, N_STEPS if exact else 1, curve).to_bytes()
