"""`foten inspect`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from foten.atomic_write import atomic_write
from foten.cli.console import JsonOption, print_json, say


def inspect(
    recording_file: Annotated[Path, typer.Argument(metavar="REC.h5", help="A recording that foten import wrote.")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Write inspect.json, overview.png, coverage.png, psd.png."),
    ] = None,
    strict: Annotated[bool, typer.Option("--strict", help="Exit 1 where there is a problem.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Say what a recording holds and what is wrong with it: units, coverage, clipping, gaps, order."""
    from foten import __version__
    from foten.datasets.hdf5 import load_recording
    from foten.recording.inspection import inspect_recording

    recording = load_recording(recording_file)
    inspection = inspect_recording(recording)
    document = {"foten": __version__, "file": recording_file.name, **inspection.to_dict()}
    if output is not None:
        from foten.recording.inspection import write_pictures

        if output.exists() and not output.is_dir():
            raise ValueError(f"-o {output} is a file, expected a folder")
        output.mkdir(parents=True, exist_ok=True)
        with atomic_write(output / "inspect.json") as part:
            part.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n")
        for path in write_pictures(recording, inspection, output):
            say(f"wrote {path}")
    if as_json:
        print_json(document)
    else:
        print(inspection.to_text())
    if strict and inspection.problems:
        raise typer.Exit(1)
