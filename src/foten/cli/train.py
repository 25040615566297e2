"""`foten train`."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from foten.cli.console import JsonOption, check_folders
from foten.cli.training_result import print_training_result

if TYPE_CHECKING:
    from foten.recording.recording import Recording


def train(
    recording_file: Annotated[Path, typer.Argument(metavar="REC.h5", help="A recording that foten import wrote.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="T.foten", help="The texture file to write.")],
    model: Annotated[
        str,
        typer.Option(
            help="foten-plus (ours), foten (the paper's); its variants ten, ten-mfcc, ten-wavelet, foten-d; the systems it is "
            "compared with, re-implemented: ar (piecewise AR), fnn, dstn, hapinf, ldhtd, ldhtd-hop, dftnet, gan."
        ),
    ] = "foten-plus",
    recipe: Annotated[str, typer.Option(help="default (ours) or paper (Adam 1e-3, batch 16, 100 epochs).")] = "default",
    rate: Annotated[
        float | None, typer.Option(help="Of the model (Hz); the acceleration's own at most. [1000]")
    ] = None,
    trim: Annotated[float | None, typer.Option(help="Discarded at both ends (ms). [2000]")] = None,
    block: Annotated[float | None, typer.Option(help="Unit of the split (ms). [2000]")] = None,
    window: Annotated[
        int | None,
        typer.Option(
            help="m, samples that a prediction sees. [20; ten 25, ten-mfcc and ten-wavelet 30, dstn 40, fnn 144]"
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Of initial weights, order and dropout.")] = 0,
    split: Annotated[str, typer.Option(help="regrouped by speed and force, or contiguous in time.")] = "regrouped",
    split_seed: Annotated[int, typer.Option(min=0, help="Of the regrouped split.")] = 0,
    epochs: Annotated[
        int | None, typer.Option(help="At most; the recipe's by default. (Of gan, of 50 steps each.)")
    ] = None,
    loss: Annotated[str | None, typer.Option(help="huber, mse or mae. [huber]")] = None,
    delta: Annotated[float | None, typer.Option(help="Huber threshold, scaled. [1.6]")] = None,
    batch: Annotated[int | None, typer.Option(help="Windows a step; the recipe's by default.")] = None,
    learning_rate: Annotated[float | None, typer.Option(help="Highest; the recipe's by default.")] = None,
    dropout: Annotated[
        float | None, typer.Option(help="Share of hidden values; the recipe's by default. [0; paper 0.2]")
    ] = None,
    excitation: Annotated[
        bool,
        typer.Option(
            "--excitation",
            help="Give a network the random part of foten-plus, which always has it: without one its free run falls silent.",
        ),
    ] = False,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="SIZE=VALUE",
            help="Another size or reading of the network; repeatable: d_model, n_heads, n_layers, d_feedforward, head=[256,64], "
            "spectral_width (1 is the literal reading), pre_norm=false, bins=half.",
        ),
    ] = None,
    zero_phase: Annotated[
        bool, typer.Option("--zero-phase", help="Filter forwards and backwards, as the paper offline.")
    ] = False,
    force_units: Annotated[
        bool, typer.Option("--force-units", help="Accept what no hand does: above 5 m/s, 1000 m/s² or 500 N.")
    ] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the run folder's checkpoint.")] = False,
    run_folder: Annotated[
        Path | None, typer.Option("--run", metavar="DIR", help="Log, curves, split, checkpoint. [T.run]")
    ] = None,
    texture: Annotated[str, typer.Option(help="Name in the card; the recording's by default.")] = "",
    licence: Annotated[str, typer.Option(help="Licence of the texture, for the card.")] = "",
    threads: Annotated[
        int | None,
        typer.Option(help="Share each batch among so many cores (on a GPU there is one share). [2; paper 1]"),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Learn a texture file from a recording. Ctrl-C keeps the best so far."""
    from foten.datasets.hdf5 import load_recording
    from foten.families import FAMILIES, sizes_of
    from foten.families.texture_file import Texture, write_texture
    from foten.recording.preprocess import PreprocessConfig
    from foten.train.config import OWN_RECIPES, RECIPES, check_used
    from foten.train.job import TrainingJob
    from foten.train.pipeline import train as train_texture
    from foten.train.run import RunFolder, TrainingDisplay

    if model not in FAMILIES:
        raise ValueError(f"unknown model {model!r}, expected one of {', '.join(FAMILIES)}")
    if recipe not in RECIPES:
        raise ValueError(f"unknown recipe {recipe!r}, expected one of {', '.join(RECIPES)}")
    if output.suffix != ".foten":
        raise ValueError(f"a texture file is written as .foten, got -o {output.name}")
    check_folders([output, run_folder or output])
    asked: dict[str, Any] = {
        "epochs": epochs,
        "loss": loss,
        "delta": delta,
        "batch": batch,
        "learning_rate": learning_rate,
        "dropout": dropout,
        "threads": threads,
    }
    changed = OWN_RECIPES.get(model, {}) | {k: v for k, v in asked.items() if v is not None}
    config = dataclasses.replace(RECIPES[recipe], seed=seed, **changed)
    # The paper trains with 25 Hz and renders with 20 Hz.
    cut: dict[str, Any] = {
        "rate_hz": rate,
        "trim_ms": trim,
        "block_ms": block,
        "lowpass_hz": 25.0 if recipe == "paper" else None,
    }
    preprocess_config = PreprocessConfig(
        zero_phase=zero_phase, force_units=force_units, **{k: v for k, v in cut.items() if v is not None}
    )
    own = _settings(settings or []) | ({"excitation": True} if excitation else {})
    recording = load_recording(recording_file)
    if model == "ar":
        of_networks = {**asked, "window": window, "set": settings, "run": run_folder}
        of_networks |= {
            "resume": resume or None,
            "seed": seed or None,
            "recipe": recipe if recipe != "default" else None,
            "excitation": excitation or None,
        }
        given = [name for name, value in of_networks.items() if value is not None]
        if given:
            raise ValueError(f"--{given[0].replace('_', '-')} is for networks, and --model ar is none: leave it out")
    if excitation and FAMILIES[model].from_noise:
        raise ValueError(f"--excitation is for models that predict samples, and {model} is made of noise: leave it out")
    check_used(model, [name for name, value in asked.items() if value is not None])
    sizes = sizes_of(model, own if window is None else {"window": window, **own})
    job = TrainingJob(
        recording, model, sizes, config, preprocess_config, split, split_seed, texture or recording.texture, licence
    )
    display = TrainingDisplay(config.epochs, "nat" if sizes.from_noise else "sd")
    folder = RunFolder(run_folder or output.with_suffix(".run"), display.note)
    if model != "ar":
        folder.open(
            {
                "model": model,
                "train": dataclasses.asdict(config),
                "preprocess": dataclasses.asdict(preprocess_config),
                "sizes": sizes.to_card(),
                "split": split,
                "split_seed": split_seed,
                "recording_sha256": recording.sha256(),
            },
            resume,
        )
    with display:

        def on_playable(playable: Texture) -> None:
            write_texture(playable, output)
            display.note(f"wrote {output}, playable without its network; it is replaced by a better one")

        def on_epoch(line: Any) -> None:
            if line.epoch == 0:  # once the recording was taken: a refusal is one line
                for note in _notes(recording, preprocess_config.rate_hz):
                    display.note(note)
            display.show(line)
            folder.log(line)

        trained = train_texture(job, on_epoch, folder.checkpoint, resume, display.stage, on_playable)
        for note in trained.progress.notes:
            display.note(note)
    write_texture(trained.texture, output)
    interrupted = trained.progress.interrupted
    if model != "ar":
        folder.close(trained)
    made = None if model == "ar" else folder.path
    print_training_result(trained.texture, trained.trace, output, recording_file, as_json, interrupted, made)
    if interrupted:
        raise typer.Exit(130)


def _notes(recording: Recording, rate_hz: float) -> Iterator[str]:
    """Return what the inspection of a recording has to say to its training."""
    from foten.dsp import perception
    from foten.recording.inspection import inspect_recording

    inspection = inspect_recording(recording)
    problems, shares = inspection.problems, inspection.carried
    if problems:
        many = f"{len(problems)} problem{'s' * (len(problems) > 1)}"
        yield f"foten inspect finds {many} in the recording, the first: {problems[0].text}"
    if shares and rate_hz < perception.smallest_rate(shares):
        yield (
            f"of what can be felt of it, {perception.in_words(shares)}: "
            f"--rate {perception.smallest_rate(shares):g} would hold more of it"
        )


def _settings(pairs: list[str]) -> dict[str, Any]:
    """Return SIZE=VALUE pairs as a mapping, values read as JSON where they are, else as words."""
    sizes: dict[str, Any] = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals or not name or not value:
            raise ValueError(f"--set {pair}: expected SIZE=VALUE, such as --set n_layers=2")
        try:
            sizes[name.strip()] = json.loads(value)
        except json.JSONDecodeError:
            sizes[name.strip()] = value.strip()
    return sizes
