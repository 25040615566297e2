"""`foten train`."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated, Any

import typer

from foten.cli.console import JsonOption, check_folders, say
from foten.cli.training_result import print_training_result


def train(
    recording_file: Annotated[
        Path, typer.Argument(metavar="REC.h5", help="A recording that foten import wrote.")
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="T.foten", help="The texture file to write.")
    ],
    model: Annotated[
        str,
        typer.Option(
            help="foten-plus (ours), foten (the paper's); its variants ten, ten-mfcc, ten-wavelet, foten-d; the systems it is "
            "compared with, re-implemented: ar (piecewise AR), fnn, dstn, hapinf, ldhtd, ldhtd-hop, dftnet, gan."
        ),
    ] = "foten-plus",
    recipe: Annotated[
        str, typer.Option(help="default (ours) or paper (Adam 1e-3, batch 16, 100 epochs).")
    ] = "default",
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
    seed: Annotated[
        int, typer.Option(min=0, max=2**32 - 1, help="Of initial weights, order and dropout.")
    ] = 0,
    split: Annotated[
        str, typer.Option(help="regrouped by speed and force, or contiguous in time.")
    ] = "regrouped",
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
            "spectral_width (1 is the literal reading), pre_norm=false, bins=half, phase_input=cos_sin, "
            "magnitude_input=log, bin_embedding=true.",
        ),
    ] = None,
    zero_phase: Annotated[
        bool, typer.Option("--zero-phase", help="Filter forwards and backwards, as the paper offline.")
    ] = False,
    force_units: Annotated[
        bool,
        typer.Option("--force-units", help="Accept what no hand does: above 5 m/s, 1000 m/s² or 500 N."),
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
    from foten.architecture import ARCHITECTURES, ArArchitecture, architecture_from
    from foten.datasets.hdf5 import load_recording
    from foten.recording import felt
    from foten.recording.inspect import inspect_recording
    from foten.recording.preprocess import PreprocessConfig
    from foten.families.texture_file import write_texture
    from foten.train.config import OWN_RECIPES, RECIPES, check_used
    from foten.train.local import train_local
    from foten.train.run import RunFolder, TrainingDisplay
    from foten.train.train import train_texture

    if model not in ARCHITECTURES:
        raise ValueError(f"unknown model {model!r}, expected one of {', '.join(ARCHITECTURES)}")
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
            raise ValueError(
                f"--{given[0].replace('_', '-')} is for networks, and --model ar is none: leave it out"
            )
        fitted = train_local(
            recording,
            preprocess_config,
            split,
            split_seed,
            texture,
            licence,
            on_stage=lambda stage: say(f"{stage} …"),
        )
        write_texture(fitted.texture, output)
        print_training_result(fitted.texture, fitted.trace, output, recording_file, as_json)
        return
    if excitation and ARCHITECTURES[model].of_noise:
        raise ValueError(
            f"--excitation is for models that predict samples, and {model} is made of chance: leave it out"
        )
    check_used(model, [name for name, value in asked.items() if value is not None])
    architecture = architecture_from(model, own if window is None else {"window": window, **own})
    assert not isinstance(architecture, ArArchitecture)
    folder = RunFolder(run_folder or output.with_suffix(".run"))
    folder.open(
        {
            "model": model,
            "train": dataclasses.asdict(config),
            "preprocess": dataclasses.asdict(preprocess_config),
            "architecture": dataclasses.asdict(architecture),
            "split": split,
            "split_seed": split_seed,
            "recording_sha256": recording.sha256(),
        },
        resume,
    )
    inspection = inspect_recording(recording)
    problems, shares = inspection.problems, inspection.carried
    with TrainingDisplay(config.epochs, "nat" if architecture.of_noise else "sd") as display:

        def on_epoch(line: Any) -> None:
            # Only once the recording was taken: a refusal is one line.
            if line.epoch == 0 and problems:
                many = f"{len(problems)} problem{'s' * (len(problems) > 1)}"
                display.note(
                    f"foten inspect finds {many} in {recording_file.name}, the first: {problems[0].text}"
                )
            if line.epoch == 0 and shares and preprocess_config.rate_hz < felt.smallest_rate(shares):
                display.note(
                    f"of what a hand feels of {recording_file.name}, {felt.in_words(shares)}: "
                    f"--rate {felt.smallest_rate(shares):g} would hold more of it"
                )
            display.show(line)
            folder.log(line)

        trained = train_texture(
            recording,
            model,
            architecture,
            config,
            preprocess_config,
            split,
            split_seed,
            on_epoch,
            folder.checkpoint,
            resume,
            texture or recording.texture,
            licence,
            on_stage=display.stage,
        )
    write_texture(trained.texture, output)
    folder.close(trained)
    print_training_result(
        trained.texture,
        trained.trace,
        output,
        recording_file,
        as_json,
        trained.progress.interrupted,
        folder.path,
    )
    if trained.progress.interrupted:
        raise typer.Exit(130)


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
