"""`foten tool`: how another tool feels, from strokes on one surface with both."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer
from typer import Argument, Option

from foten.cli.editing import check_texture
from foten.console import JsonOption, RecordingFile, TextureFile, check_files, print_result

if TYPE_CHECKING:
    from foten.editing.tool import Transfer

app = typer.Typer(help="Another tool: measured once, then applied to any texture.", no_args_is_help=True)


@app.command()
def measure(
    first: RecordingFile,
    second: Path = Argument(..., metavar="B.h5", help="The same surface with the other tool."),
    output: Path = Option(..., "-o", "--output", help="The tool to write, .json."),
    rate: float = Option(1000.0, help="Of the textures that it is for (Hz)."),
    as_json: JsonOption = False,
) -> None:
    """Measure how a tool differs from that of your textures: stroke one surface with both, over the same speeds and forces.

    foten tool measure pen-a.h5 pen-b.h5 -o pen-b.json

    foten render denim.foten --tool pen-b.json --speed 80 --force 0.8 --seconds 3 -o denim-b.wav
    """
    from foten.datasets.hdf5 import load_recording
    from foten.editing.tool import fitted_transfer, write_transfer
    from foten.recording.preprocess import PreprocessConfig, fitting_cut, preprocess

    if output.suffix != ".json":
        raise ValueError(f"a tool is written as .json, got -o {output.name}")
    check_files([output])
    recordings = [load_recording(path) for path in (first, second)]
    traces = []
    for recording in recordings:
        _, block_ms = fitting_cut(recording)
        traces.append(preprocess(recording, PreprocessConfig(rate_hz=rate, trim_ms=0.0, block_ms=block_ms)))
    names = [recording.tool or path.stem for recording, path in zip(recordings, (first, second), strict=True)]
    transfer = fitted_transfer(traces[:1], traces[1:], (names[0], names[1]))
    write_transfer(transfer, output)
    text = "\n".join([*_lines(transfer), f"wrote {output}; next: foten tool apply T.foten {output} -o T-b.foten"])
    print_result({"output": str(output), **vars(transfer)}, text, as_json)


def _lines(transfer: Transfer) -> list[str]:
    """A transfer for people: an octave a row."""
    from foten.editing.tool import PER_OCTAVE
    from foten.reporting.table import Table

    rows = list(zip(transfer.hz, transfer.gain_db, transfer.gain_sd_db, strict=True))[::PER_OCTAVE]
    cells = [(f"{hz:.0f}", f"{gain:+.1f}", f"{sd:.1f}") for hz, gain, sd in rows]
    powers = f"with speed^{transfer.speed_exponent:+.2f} and force^{transfer.force_exponent:+.2f}"
    at = f"at {transfer.speed_mm_s:.0f} mm/s and {transfer.force_n:.2f} N, growing {powers}"
    return [*Table.of(("Hz", "gain [dB]", "±"), cells).text(), at]


@app.command()
def apply(
    texture_file: TextureFile,
    tool: Path = Argument(..., metavar="TOOL.json", help="As 'foten tool measure' writes it."),
    output: Path = Option(..., "-o", "--output", help="The texture to write, .foten."),
    as_json: JsonOption = False,
) -> None:
    """Write a texture as another tool would feel it: for a page, an app or a study."""
    from foten.editing.describe import describe
    from foten.editing.tool import read_transfer, transferred
    from foten.models.texture_file import read_texture, write_texture

    check_texture(output)
    texture = transferred(read_texture(texture_file), read_transfer(tool))
    write_texture(texture, output)
    description = describe(texture)
    lines = [f"{name:11s}{figure}" for name, figure in description.figures(texture.unit).items()]
    lines.append(f"wrote {output}; next: foten serve {output}")
    print_result({"output": str(output), **description.to_json()}, "\n".join(lines), as_json)
