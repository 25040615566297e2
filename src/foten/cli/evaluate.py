"""`foten evaluate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from foten.cli.console import JsonOption, TextureFile, check_folder, print_result, say, write_json


def evaluate(
    texture_file: TextureFile,
    recording_file: Annotated[Path, Argument(metavar="REC.h5", help="The recording it was trained on, or another.")],
    report: Annotated[Path | None, Option(metavar="DIR", help="Write DIR/report.html and DIR/evaluation.json.")] = None,
    seed: Annotated[int, Option(min=0, max=2**32 - 1, help="Of the excitation.")] = 0,
    trim: Annotated[
        float | None, Option(help="Of another recording, discarded at both ends (ms). [the trained one's]")
    ] = None,
    block: Annotated[
        float | None, Option(help="Of another recording, what is scored as one (ms). [the trained one's]")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Judge a texture on its test blocks: one-step and free-run, beside references and a ceiling."""
    from foten import __version__
    from foten.datasets.hdf5 import load_recording
    from foten.evaluate import evaluate as judge
    from foten.experiments.truth import truth_for
    from foten.families.texture_file import read_texture

    check_folder(report, "--report")
    texture, recording = read_texture(texture_file), load_recording(recording_file)
    truth = truth_for(recording, texture, trim, block)
    judgement = judge.evaluate(texture, recording, truth, seed, lambda stage: say(f"{stage} …"), trim, block)
    if report is not None:
        from foten.evaluate.report.page import write_report

        report.mkdir(parents=True, exist_ok=True)
        write_json(report / "evaluation.json", {"foten": __version__, **judgement.document})
        say(f"wrote {write_report(judgement, texture, report)}")
    print_result(judgement.document, judge.to_text(judgement.document), as_json)
