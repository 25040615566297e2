"""`foten inspect`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Exit, Option

from foten.cli.console import JsonOption, RecordingFile, check_folder, folder_option, print_result, say, write_json


def inspect(
    recording_file: RecordingFile,
    output: Annotated[Path | None, folder_option("Write inspect.json, overview.png, coverage.png, psd.png.")] = None,
    strict: Annotated[bool, Option("--strict", help="Exit 1 where there is a problem.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Say what a recording holds and what is wrong with it: units, coverage, clipping, gaps, order."""
    from foten import __version__
    from foten.datasets.hdf5 import load_recording
    from foten.recording.inspection import inspect_recording, write_pictures

    check_folder(output)
    recording = load_recording(recording_file)
    inspection = inspect_recording(recording)
    document = {"foten": __version__, "file": recording_file.name, **inspection.to_dict()}
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        write_json(output / "inspect.json", document)
        for path in write_pictures(recording, inspection, output):
            say(f"wrote {path}")
    print_result(document, inspection.to_text(), as_json)
    if strict and inspection.problems:
        raise Exit(1)
