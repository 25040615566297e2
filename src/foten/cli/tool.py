"""`foten tool`: adapt textures to another tool, measured by strokes on one surface with both."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from foten.cli.editing import TextureOutput, write_described
from foten.console import JsonOption, TextureFile, check_output, print_result
from foten.editing.tool import PER_OCTAVE, Transfer, fitted_transfer, read_transfer, transferred, write_transfer
from foten.models.texture_file import read_texture
from foten.reporting.table import Table

app = typer.Typer(help="Measure once how another tool differs, then apply it to any texture.", no_args_is_help=True)


@app.command()
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
    text = "\n".join([*_lines(transfer), f"wrote {output}; next: foten tool apply T.foten {output} -o T-b.foten"])
    print_result({"output": str(output), **vars(transfer)}, text, as_json)


def _lines(transfer: Transfer) -> list[str]:
    """A transfer for people: an octave a row."""
    rows = list(zip(transfer.hz, transfer.gain_db, transfer.gain_sd_db, strict=True))[::PER_OCTAVE]
    cells = [(f"{hz:.0f}", f"{gain:+.1f}", f"{sd:.1f}") for hz, gain, sd in rows]
    powers = f"with speed^{transfer.speed_exponent:+.2f} and force^{transfer.force_exponent:+.2f}"
    at = f"gain at {transfer.speed_mm_s:.0f} mm/s and {transfer.force_n:.2f} N; it grows {powers}"
    return [*Table.of(("Hz", "gain [dB]", "±"), cells).text(), at]


@app.command()
def apply(
    texture_file: TextureFile,
    tool: Annotated[Path, Argument(metavar="TOOL.json", help="Tool file, as written by 'foten tool measure'.")],
    output: TextureOutput,
    as_json: JsonOption = False,
) -> None:
    """Write a texture as it would feel through another tool, for a page, an app or a study."""
    check_output(output, "a texture", ".foten")
    write_described(transferred(read_texture(texture_file), read_transfer(tool)), output, as_json)
