"""`foten describe`, `foten edit`, `foten blend` and `foten tool`: measure a texture, change it, blend two, for another tool."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import typer
from typer import Argument, Option

from foten.cli.render import for_user
from foten.cli.stroke_options import UserFile
from foten.console import JsonOption, TextureFile, check_output, print_result, say
from foten.editing.blend import blend as blended
from foten.editing.describe import Description
from foten.editing.describe import describe as described
from foten.editing.edit import Edit, edited
from foten.editing.tool import PER_OCTAVE, Transfer, fitted_transfer, read_transfer, transferred, write_transfer
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


tool = typer.Typer(help="Measure once how another tool differs, then apply it to any texture.", no_args_is_help=True)


@tool.command()
def measure(
    recordings: list[Path] = Argument(
        ...,
        metavar="A.h5 B.h5 …",
        help="Recordings in pairs: one surface with your textures' tool, then with the other; more surfaces likewise.",
    ),
    output: Path = Option(..., "-o", "--output", help="Tool file to write (.json)."),
    rate: float = Option(1000.0, help="Sampling rate of the textures that the tool will be applied to (Hz)."),
    as_json: JsonOption = False,
) -> None:
    """Measure how a tool differs from that of your textures, by stroking one surface with both at the same speeds and forces.

    foten tool measure pen-a.h5 pen-b.h5 -o pen-b.json

    foten tool measure wood-a.h5 wood-b.h5 felt-a.h5 felt-b.h5 -o pen-b.json: on two surfaces

    foten render denim.foten --tool pen-b.json --speed 80 --force 0.8 --seconds 3 -o denim-b.wav
    """
    from foten.datasets.hdf5 import load_recording
    from foten.recording.preprocess import PreprocessConfig, fitting_cut, preprocess

    if len(recordings) % 2:
        raise ValueError(f"{len(recordings)} recordings, expected pairs: a surface with one tool, then with the other")
    check_output(output, "a tool", ".json")
    names, traces = [], []
    for path in recordings:
        recording = load_recording(path)
        names.append(recording.tool or path.stem)
        _, block_ms = fitting_cut(recording, 0.0)
        traces.append(preprocess(recording, PreprocessConfig(rate_hz=rate, trim_ms=0.0, block_ms=block_ms)))
    transfer = fitted_transfer(traces[::2], traces[1::2], (names[0], names[1]))
    write_transfer(transfer, output)
    text = "\n".join(
        [*_transfer_lines(transfer), f"wrote {output}; next: foten tool apply T.foten {output} -o T-b.foten"]
    )
    print_result({"output": str(output), **vars(transfer)}, text, as_json)


def _transfer_lines(transfer: Transfer) -> list[str]:
    """A transfer for people: an octave a row."""
    rows = list(zip(transfer.hz, transfer.gain_db, transfer.gain_sd_db, strict=True))[::PER_OCTAVE]
    cells = [(f"{hz:.0f}", f"{gain:+.1f}", f"{sd:.1f}") for hz, gain, sd in rows]
    powers = f"with speed^{transfer.speed_exponent:+.2f} and force^{transfer.force_exponent:+.2f}"
    at = f"gain at {transfer.speed_mm_s:.0f} mm/s and {transfer.force_n:.2f} N; it grows {powers}"
    return [*Table.of(("Hz", "gain [dB]", "±"), cells).text(), at]


@tool.command()
def apply(
    texture_file: TextureFile,
    tool_file: Annotated[Path, Argument(metavar="TOOL.json", help="Tool file, as written by 'foten tool measure'.")],
    output: TextureOutput,
    as_json: JsonOption = False,
) -> None:
    """Write a texture as it would feel through another tool, for a page, an app or a study."""
    check_output(output, "a texture", ".foten")
    write_described(transferred(read_texture(texture_file), read_transfer(tool_file)), output, as_json)
