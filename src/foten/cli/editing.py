"""`foten describe`, `foten edit` and `foten blend`: measure a texture, change it, or blend two."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

from typer import Argument, Option

from foten.cli.render import for_user
from foten.cli.stroke_options import UserFile
from foten.console import JsonOption, TextureFile, check_output, print_result, say
from foten.editing.blend import blend as blended
from foten.editing.describe import Description
from foten.editing.describe import describe as described
from foten.editing.edit import Edit, edited
from foten.models.texture_file import Texture, read_texture, write_texture
from foten.reporting.table import Table

TextureOutput = Annotated[Path, Option("-o", "--output", help="Texture file to write (.foten).")]


def describe(texture_file: TextureFile, as_json: JsonOption = False) -> None:
    """Describe a texture in numbers: level, spectral centroid and width, roughness, period, exponents of speed and force.

    It is rendered and measured at 100 mm/s and 0.7 N, or the nearest that it was trained on. 'foten edit' changes the numbers.
    """
    texture = read_texture(texture_file)
    description = described(texture)
    print_result(description.to_json(), "\n".join(_lines(description, texture)), as_json)


def edit(
    texture_file: TextureFile,
    output: TextureOutput,
    level: float = Option(0.0, metavar="DB", help="Raise the level by this much (dB); a negative value lowers it."),
    brighter: float = Option(0.0, metavar="OCTAVES", help="Raise the spectral centroid by this much (octaves)."),
    wider: float = Option(0.0, metavar="OCTAVES", help="Widen the spectrum by this much (octaves)."),
    rougher: float = Option(
        0.0, metavar="DB", help="Make the level vary more at constant speed and force, by this much (dB)."
    ),
    period: float | None = Option(None, metavar="MM", help="New period of a surface that repeats (mm)."),
    speed_exponent: float | None = Option(None, help="Make the level grow as speed^x, with this exponent x (0 to 2)."),
    force_exponent: float | None = Option(None, help="Make the level grow as force^x, with this exponent x (0 to 2)."),
    user: UserFile = None,
    as_json: JsonOption = False,
) -> None:
    """Change a texture by the numbers that 'foten describe' measures.

    foten edit denim.foten --level +3 --brighter 0.5 --wider 0.2 -o bright.foten

    foten edit mesh.foten --period 1.2 -o fine.foten: a finer weave.

    foten edit mesh.foten --user me.json -o mine.foten: as a user's profile of 'foten adapt' has it.
    """
    change = Edit(level, brighter, wider, rougher, period, speed_exponent, force_exponent)
    if not change.in_words() and user is None:
        expected = "--level, --brighter, --wider, --rougher, --period, an exponent or --user"
        raise ValueError(f"nothing to change, expected {expected}")
    check_output(output, "a texture", ".foten")
    result = edited(for_user(read_texture(texture_file), user), change)
    write_texture(result.texture, output)
    for line in result.unreached:
        say(line)
    lines = [*_beside(result.texture, before=result.before, after=result.after), _wrote(output)]
    document = {"output": str(output), "before": result.before.to_json(), "after": result.after.to_json()}
    print_result({**document, "unreached": list(result.unreached)}, "\n".join(lines), as_json)


def blend(
    first: Annotated[Path, Argument(metavar="A.foten", help="First texture file.")],
    second: Annotated[Path, Argument(metavar="B.foten", help="Second texture file.")],
    output: TextureOutput,
    at: float = Option(0.5, help="Position between the two: 0 is the first texture, 1 the second."),
    as_json: JsonOption = False,
) -> None:
    """Blend two textures into one between them.

    foten blend denim.foten towel.foten --at 0.3 -o between.foten
    """
    check_output(output, "a texture", ".foten")
    sides = read_texture(first), read_texture(second)
    between = blended(*sides, at)
    write_texture(between, output)
    descriptions = {"first": described(sides[0]), f"at {at:g}": described(between), "second": described(sides[1])}
    lines = [*_beside(between, **descriptions), _wrote(output)]
    document = {"output": str(output), **{name: one.to_json() for name, one in descriptions.items()}}
    print_result(document, "\n".join(lines), as_json)


def write_described(
    texture: Texture,
    output: Path,
    as_json: bool,
    following: str | None = None,
    lines: Sequence[str] = (),
    document: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Write a texture and print what it measures, further lines and entries, and the command that may follow."""
    write_texture(texture, output)
    description = described(texture)
    text = "\n".join([*_lines(description, texture), *lines, _wrote(output, following)])
    print_result({"output": str(output), **description.to_json(), **document}, text, as_json)


def _wrote(output: Path, following: str | None = None) -> str:
    return f"wrote {output}; next: {following or f'foten serve {output}'}"


def _lines(description: Description, texture: Texture) -> list[str]:
    return [f"{name:11s}{figure}" for name, figure in description.figures(texture.unit).items()]


def _beside(texture: Texture, **descriptions: Description) -> list[str]:
    """Rows of figures, a column for each description."""
    rows = [description.figures(texture.unit) for description in descriptions.values()]
    return Table.of(("", *descriptions), [(name, *(row[name] for row in rows)) for name in rows[0]]).text()
