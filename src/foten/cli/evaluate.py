"""`foten evaluate`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from foten.atomic_write import atomic_write
from foten.cli.console import JsonOption, print_json, say


def evaluate(
    texture_file: Annotated[Path, typer.Argument(metavar="T.foten", help="A texture file.")],
    recording_file: Annotated[
        Path, typer.Argument(metavar="REC.h5", help="The recording it was trained on, or another.")
    ],
    report: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write DIR/report.html and DIR/evaluation.json.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Of the excitation.")] = 0,
    trim: Annotated[
        float | None, typer.Option(help="Of another recording, discarded at both ends (ms). [the trained one's]")
    ] = None,
    block: Annotated[
        float | None, typer.Option(help="Of another recording, what is scored as one (ms). [the trained one's]")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Judge a texture on its test blocks: one-step and free-run, beside references and a ceiling."""
    from foten import __version__
    from foten.datasets.hdf5 import load_recording
    from foten.evaluate import evaluate as judge
    from foten.experiments.truth import truth_for
    from foten.families.texture_file import read_texture

    texture, recording = read_texture(texture_file), load_recording(recording_file)
    if report is not None and report.exists() and not report.is_dir():
        raise ValueError(f"--report {report} is a file, expected a folder")
    judgement = judge.evaluate(
        texture,
        recording,
        truth_for(recording, texture, trim, block),
        seed,
        on_stage=lambda stage: say(f"{stage} …"),
        trim_ms=trim,
        block_ms=block,
    )
    if report is not None:
        from foten.evaluate.report import write_report

        report.mkdir(parents=True, exist_ok=True)
        document = {"foten": __version__, **judgement.document}
        with atomic_write(report / "evaluation.json") as part:
            part.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n")
        say(f"wrote {write_report(judgement, texture, report)}")
    if as_json:
        print_json(judgement.document)
    else:
        print(judge.to_text(judgement.document))
