"""The command line: one subcommand per stage; parse, call one function, write.

Exit status: 0; 1 for a result that fails a check; 2 for bad input or usage, one line on stderr; 130 after Ctrl-C.
Results go to stdout, progress to stderr. Heavy imports stay inside the subcommands.
"""

from __future__ import annotations

import dataclasses
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.exceptions import Abort, TyperException

from foten.atomic_write import atomic_write

if TYPE_CHECKING:
    from collections.abc import Mapping

    from foten.recording.trace import Trace
    from foten.render.stroke import Stroke
    from foten.texture_file import Texture

app = typer.Typer(
    name="foten",
    help="Haptic textures learned from a recording and given back as vibration.",
    add_completion=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

_EXTRAS = {
    "scipy": "data",
    "h5py": "data",
    "matplotlib": "data",
    "openpyxl": "data",
    "nptdms": "data",
    "pymatreader": "data",
    "torch": "train",
    "ray": "sweep",
    "onnx": "onnx",
    "onnxruntime": "onnx",
}
"""Which extra installs a package that may be missing."""

JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON on stdout.")]


def _say(text: str) -> None:
    """Print progress, on stderr."""
    print(text, file=sys.stderr, flush=True)


def _print_json(document: Any) -> None:
    print(json.dumps(document, indent=1, sort_keys=False, allow_nan=False))


def _print_version(wanted: bool) -> None:
    if wanted:
        from foten import __version__

        print(__version__)
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and stop."),
    ] = False,
) -> None:
    pass


@app.command()
def simulate(
    key: Annotated[str | None, typer.Argument(help="Texture or linear process; --list shows them.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="HDF5 file to write.")] = None,
    seconds: Annotated[float, typer.Option(help="Length (s).")] = 64.0,
    seed: Annotated[int, typer.Option(help="Of everything random that the next two leave out.")] = 0,
    noise_seed: Annotated[
        int | None, typer.Option(help="Of surface and sensors: another one, the same stroke again.")
    ] = None,
    stroke_seed: Annotated[int | None, typer.Option(help="Of the hand.")] = None,
    accelerometer_hz: Annotated[
        float | None,
        typer.Option(
            help="10000 over a whole number, by default 10000; for a linear process its rate, by default 1000."
        ),
    ] = None,
    show_list: Annotated[bool, typer.Option("--list", help="Show the keys and stop.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a simulated recording with a known truth: raw sensors over a texture, or a linear process."""
    from foten.datasets import simulate as simulator

    if show_list:
        known: dict[str, Any] = {**simulator.TEXTURES, **simulator.LINEAR_FAMILY}
        if as_json:
            _print_json({name: parameters.description for name, parameters in known.items()})
        else:
            print("\n".join(f"{name:18s}{parameters.description}" for name, parameters in known.items()))
        return
    if key is None or output is None:
        raise ValueError("expected a key and -o FILE; --list shows the keys")
    _check_folders([output])
    if output.suffix.lower() not in (".h5", ".hdf5"):
        raise ValueError(f"a recording is written as .h5, got -o {output.name}")
    recording = simulator.simulate(
        key, seconds, seed, noise_seed=noise_seed, stroke_seed=stroke_seed, accelerometer_hz=accelerometer_hz
    )
    from foten.datasets.hdf5 import write_recording

    write_recording(recording, output)
    if as_json:
        simulation = dict(recording.simulation or {})
        _print_json({"output": str(output), "sha256": recording.sha256(), "simulation": simulation})
    else:
        print(f"{output}: {key}, {recording.duration_s:g} s, {', '.join(recording.channels)}")


@app.command("import")
def import_(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="CSV, TSV, .xlsx, .npz, .mat (v5 to v7.3), .tdms, .wav, .h5; or one .xml of linear models.",
            show_default=False,
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help="The recording to write, .h5; of models a texture, .foten.",
            show_default=False,
        ),
    ],
    mapping: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            help="CHANNEL=COLUMN,… with channels time, acceleration, speed, force, or by axis "
            "acceleration_x, position_x, force_x and so on (z is the surface normal). A column is a header "
            "name, or a number from 0; with several files FILE:COLUMN. time may be given once per file and "
            "serves the channels of that file with as many rows; without FILE: it is that column of every "
            "file which has it. Default: by the header names, said on stderr.",
        ),
    ] = None,
    units: Annotated[
        list[str] | None,
        typer.Option(
            "--unit",
            help="CHANNEL=UNIT,… of the file: acceleration m/s^2, g, mg, mm/s^2; speed mm/s, cm/s, m/s; "
            "position mm, cm, m, um; force N, mN, gf; time s, ms, us, ns. CHANNEL=V*FACTOR or *FACTOR "
            "multiplies, for a sensitivity: force=V*4.9 for 4.9 N per volt. Default: what the file states, "
            "else m/s^2, mm/s, mm, N, s.",
        ),
    ] = None,
    rate: Annotated[
        list[str] | None,
        typer.Option(
            "--rate",
            help="HZ for the channels whose file states no rate and has no time column, or CHANNEL=HZ,…, "
            "which comes before what the file states.",
        ),
    ] = None,
    fill_gaps: Annotated[
        float,
        typer.Option(
            "--fill-gaps", metavar="MS", help="Fill gaps of up to MS ms in position, speed and force."
        ),
    ] = 0.0,
    force_units: Annotated[
        bool,
        typer.Option(
            "--force-units",
            help="Accept what no hand does, spikes for example: above 5 m/s, 1000 m/s², 500 N or 10 m.",
        ),
    ] = False,
    texture: Annotated[str, typer.Option(help="What was stroked; the file's name by default.")] = "",
    tool: Annotated[str, typer.Option(help="What it was stroked with.")] = "",
    sensors: Annotated[str, typer.Option(help="Sensors, amplifiers, ranges.")] = "",
    notes: Annotated[str, typer.Option(help="Anything else.")] = "",
    as_json: JsonOption = False,
) -> None:
    """Turn files of any origin into one recording, converting units and changing nothing else.

    foten import denim.csv --map time=t,acceleration=ax,speed=v,force=fz --unit acceleration=g -o denim.h5

    foten import acc.wav rest.csv --map acceleration=acc.wav:0,speed=rest.csv:v,force=rest.csv:f
    --unit acceleration=*50 --rate 1000 -o denim.h5

    foten import Models_Denim.xml -o denim.foten: a model file of the Penn Haptic Texture Toolkit becomes a texture.
    """
    if any(file.suffix.lower() == ".xml" for file in files):
        for_recordings = {
            "map": mapping,
            "unit": units,
            "rate": rate,
            "fill-gaps": fill_gaps,
            "force-units": force_units,
            "tool": tool,
            "sensors": sensors,
        }
        given = [name for name, value in for_recordings.items() if value]
        if given:
            raise ValueError(
                f"--{given[0]} is for recordings, and an .xml holds models with units and rate: leave it out"
            )
        _import_models(files, output, texture, notes, as_json)
        return
    from foten.datasets.hdf5 import write_recording
    from foten.datasets.importing import ImportOptions, import_recording, parse_pairs, parse_rates
    from foten.recording.recording import UNITS

    if output.suffix.lower() not in (".h5", ".hdf5"):
        raise ValueError(f"a recording is written as .h5, got -o {output.name}")
    if not output.parent.is_dir():
        raise ValueError(f"there is no folder {output.parent}")
    rate_hz, rates_hz = parse_rates(rate or [])
    unit_pairs = parse_pairs(units or [], "--unit")
    imported = import_recording(
        files,
        ImportOptions(
            mapping=tuple(parse_pairs(mapping or [], "--map")),
            units=dict(unit_pairs),
            rate_hz=rate_hz,
            rates_hz=rates_hz,
            fill_gaps_ms=fill_gaps,
            force_units=force_units,
            texture=texture or output.stem,
            tool=tool,
            sensors=sensors,
            notes=notes,
        ),
    )
    for decision in imported.decisions:
        _say(decision)
    recording = imported.recording
    write_recording(recording, output)
    if as_json:
        _print_json(
            {
                "file": str(output),
                "sha256": recording.sha256(),
                "channels": {
                    name: {
                        "unit": UNITS[name],
                        "rate_hz": channel.rate_hz,
                        "regular": channel.times_s is None,
                        "n_samples": channel.samples.size,
                        "duration_s": channel.duration_s,
                        "minimum": float(channel.samples.min()),
                        "maximum": float(channel.samples.max()),
                    }
                    for name, channel in recording.channels.items()
                },
                "history": list(recording.history),
            }
        )
        return
    for name, channel in recording.channels.items():
        print(
            f"{name:<15} {channel.samples.size:>9} samples at {channel.rate_hz:>8g} Hz, "
            f"{channel.duration_s:7.3f} s, {channel.samples.min():.4g} to {channel.samples.max():.4g} "
            f"{UNITS[name]}"
        )
    for line in recording.history:
        print(f"  {line}")
    print(f"wrote {output}; next: foten inspect {output}")


def _import_models(files: list[Path], output: Path, texture: str, notes: str, as_json: bool) -> None:
    import hashlib

    from foten.datasets.hatt import read_models
    from foten.texture_file import write_texture
    from foten.train.imported import texture_of

    if len(files) != 1:
        raise ValueError(f"got {len(files)} files, expected one .xml of models by itself")
    if output.suffix != ".foten":
        raise ValueError(f"models are written as a texture file, .foten, got -o {output.name}")
    _check_folders([output])
    models = read_models(files[0])
    digest = hashlib.sha256(files[0].read_bytes()).hexdigest()
    imported, decisions = texture_of(models, digest, texture, notes=notes)
    for decision in decisions:
        _say(decision)
    write_texture(imported, output)
    card, sizes = imported.card, imported.card["sizes"]
    if as_json:
        _print_json(
            {
                "file": str(output),
                "sha256": imported.sha256(),
                "imported_sha256": digest,
                "texture": card["texture"],
                "rate_hz": card["rate_hz"],
                "sizes": sizes,
                "trained_range": card["trained_range"],
                "notes": card["notes"],
            }
        )
        return
    ends = {channel: card["trained_range"][channel][1] for channel in ("speed", "force")}
    print(
        f"{card['texture'] or files[0].stem}: {sizes['n_models']} models of order {sizes['order']} at {card['rate_hz']:g} Hz, "
        f"{sizes['ma']} zeros each, up to {ends['speed']:.0f} mm/s and {ends['force']:.1f} N"
    )
    print("the licence of the model file holds for the texture too: see its notice before you pass it on")
    print(
        f"wrote {output}; next: foten render {output} --speed 80 --force 0.8 --seconds 3 -o {output.stem}.wav"
    )


@app.command()
def inspect(
    recording_file: Annotated[
        Path, typer.Argument(metavar="REC.h5", help="A recording that foten import wrote.")
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="DIR", help="Write inspect.json, overview.png, coverage.png, psd.png."
        ),
    ] = None,
    strict: Annotated[bool, typer.Option("--strict", help="Exit 1 where there is a problem.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Say what a recording holds and what is wrong with it: units, coverage, clipping, gaps, order."""
    from foten import __version__
    from foten.datasets.hdf5 import load_recording
    from foten.recording.inspect import inspect_recording

    recording = load_recording(recording_file)
    inspection = inspect_recording(recording)
    document = {"foten": __version__, "file": recording_file.name, **inspection.to_dict()}
    if output is not None:
        from foten.recording.pictures import write_pictures

        if output.exists() and not output.is_dir():
            raise ValueError(f"-o {output} is a file, expected a folder")
        output.mkdir(parents=True, exist_ok=True)
        with atomic_write(output / "inspect.json") as part:
            part.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n")
        for path in write_pictures(recording, inspection, output):
            _say(f"wrote {path}")
    if as_json:
        _print_json(document)
    else:
        print(inspection.to_text())
    if strict and inspection.problems:
        raise typer.Exit(1)


@app.command()
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
    from foten.texture_file import write_texture
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
    _check_folders([output, run_folder or output])
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
            on_stage=lambda stage: _say(f"{stage} …"),
        )
        write_texture(fitted.texture, output)
        _tell_trained(fitted.texture, fitted.trace, output, recording_file, as_json)
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
    _tell_trained(
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


def _tell_trained(
    texture: Texture,
    trace: Trace,
    output: Path,
    recording_file: Path,
    as_json: bool,
    interrupted: bool = False,
    folder: Path | None = None,
) -> None:
    """Print what a training has found."""
    card, metrics = texture.card, texture.card["metrics"]
    if as_json:
        _print_json(
            {
                "output": str(output),
                "sha256": texture.sha256(),
                "interrupted": interrupted,
                "n_blocks": trace.n_blocks,
                "n_samples_dropped": trace.n_dropped,
                "n_samples_uncovered": trace.n_uncovered,
                "split_sha256": card["split_sha256"],
                **metrics,
            }
        )
        return
    told = [f"validation blocks: {_validated(card)}"]
    if card["model"] == "ar":
        sizes = card["sizes"]
        told[0] += f", order {sizes['order']}"
        told.append(f"{sizes['n_models']} models from {metrics['n_pieces']} pieces, those around it counted")
        if metrics["n_pieces_left_out"]:
            told.append(f"{metrics['n_pieces_left_out']} pieces that do not vibrate left out")
    else:
        told[0] += f" (epoch {metrics['best_epoch']})"
    if metrics.get("validation_mae_scaled_lattice") is not None:
        told.append(f"{metrics['validation_mae_scaled_lattice']:.4f} sd without its network")
    print(", ".join(told))
    if trace.n_uncovered:
        print(f"{trace.n_uncovered} samples that not every channel covers were left out")
    if trace.n_dropped:
        print(f"{trace.n_dropped} samples at the end did not fill a block and were left out")
    condition = card["warm_start"]["found"]
    whence = "modelled" if card["model"] == "ar" else "recorded"
    print(
        f"warm start {whence} at {condition['speed']:.0f} mm/s and {condition['force']:.2f} N (asked: 45 mm/s, 0.8 N)"
    )
    made = f"{output} and {folder}" if folder is not None else f"{output}"
    print(f"wrote {made}; next: foten evaluate {output} {recording_file}")


@app.command()
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
        float | None,
        typer.Option(help="Of another recording, discarded at both ends (ms). [the trained one's]"),
    ] = None,
    block: Annotated[
        float | None,
        typer.Option(help="Of another recording, what is scored as one (ms). [the trained one's]"),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Judge a texture on its test blocks: one-step and free-run, beside references and a ceiling."""
    from foten import __version__
    from foten.datasets.hdf5 import load_recording
    from foten.evaluate import evaluate as judge
    from foten.experiments.truth import truth_for
    from foten.texture_file import read_texture

    texture, recording = read_texture(texture_file), load_recording(recording_file)
    if report is not None and report.exists() and not report.is_dir():
        raise ValueError(f"--report {report} is a file, expected a folder")
    judgement = judge.evaluate(
        texture,
        recording,
        truth_for(recording, texture, trim, block),
        seed,
        on_stage=lambda stage: _say(f"{stage} …"),
        trim_ms=trim,
        block_ms=block,
    )
    if report is not None:
        from foten.evaluate.report import write_report

        report.mkdir(parents=True, exist_ok=True)
        document = {"foten": __version__, **judgement.document}
        with atomic_write(report / "evaluation.json") as part:
            part.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n")
        _say(f"wrote {write_report(judgement, texture, report)}")
    if as_json:
        _print_json(judgement.document)
    else:
        print(judge.to_text(judgement.document))


def _about(texture: Texture, hand: str, seed: int, deterministic: bool) -> dict[str, Any]:
    """Return what made a rendering, as it is kept in the file that it is written to."""
    from foten import __version__

    return {
        "foten": __version__,
        "texture": texture.card["texture"],
        "texture_sha256": texture.sha256(),
        "stroke": hand,
        "seed": seed,
        "deterministic": deterministic,
    }


def _tell_of_holes(stroke: Stroke) -> None:
    if stroke.gap_s:
        _say(f"the stroke has a hole of {stroke.gap_s:.3g} s, bridged in a straight line")
    if stroke.n_lifted:
        _say(
            f"the pen was taken as lifted in holes or jumps of the stroke, {stroke.n_lifted} in all: silence there"
        )


def _tell_what_was_outside(statistics: dict[str, int], texture: Texture) -> None:
    """Print how much of a rendering lay outside of what was recorded, and what was done there; nothing where none did."""
    share = {name: f"{100 * count / statistics['n']:.1f} %" for name, count in statistics.items()}
    for name, unit in (("speed", "mm/s"), ("force", "N")):
        if statistics[f"n_{name}_beyond"]:
            high, power = texture.trained_range(name)[1], texture.beyond_exponent(name)
            grown = f"the level grew with {name}^{power:.2g} there" if power else "the level stayed there"
            print(f"{name} was above the trained {high:.4g} {unit} for {share[f'n_{name}_beyond']}; {grown}")
        if statistics[f"n_{name}_clamped"]:
            print(f"{name} was above twice that for {share[f'n_{name}_clamped']}, and taken as twice that")
    if statistics["n_below"]:
        print(f"speed or force was below the trained range for {share['n_below']}; the vibration fades there")
    if statistics["n_saturated"]:
        _say(f"the saturator cut {statistics['n_saturated']} samples: the loop ran away there")
    if statistics["n_refused"]:
        _say(
            f"the hand was negative or no number {statistics['n_refused']} times, taken as 0 or as it was before"
        )
    if statistics["n_lost"]:
        _say(f"{statistics['n_lost']} samples were no numbers, and silence instead; is the file foten's own?")


@app.command()
def render(
    texture_file: Annotated[Path, typer.Argument(metavar="T.foten", help="A texture file.")],
    output: Annotated[
        list[Path], typer.Option("-o", "--output", help=".wav (float, m/s²), .csv, .npz or .png; repeatable.")
    ],
    stroke: Annotated[
        Path | None,
        typer.Option(
            metavar="S.csv", help="Header t (s), speed (mm/s) or x, y (mm), force (N) or pressure (0 to 1)."
        ),
    ] = None,
    recording_file: Annotated[
        Path | None, typer.Option("--recording", metavar="REC.h5", help="Take the hand of a recording.")
    ] = None,
    speed: Annotated[float | None, typer.Option(help="Constant speed (mm/s).")] = None,
    force: Annotated[float | None, typer.Option(help="Constant force (N).")] = None,
    seconds: Annotated[float | None, typer.Option(help="How long, with --speed and --force (s).")] = None,
    audible: Annotated[
        Path | None, typer.Option(metavar="FILE.wav", help="Also as sound, 48 kHz, 16 bits.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Of the excitation.")] = 0,
    deterministic: Annotated[bool, typer.Option("--deterministic", help="Without excitation.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Render vibration from a texture and a stroke."""
    from foten.render import sinks
    from foten.render.renderer import Renderer
    from foten.render.stroke import constant_stroke, read_stroke, recorded_stroke
    from foten.texture_file import read_texture

    for path in output:
        sinks.check_suffix(path)
    _check_folders([*output, *([audible] if audible else [])])
    texture = read_texture(texture_file)
    rate = texture.rate_hz
    if audible is not None:
        sinks.audible_factor(rate)
        if audible.suffix.lower() != ".wav":
            raise ValueError(f"sound is written as .wav, got --audible {audible.name}")
    written = [os.path.realpath(path) for path in (*output, *([audible] if audible else []))]
    if len(set(written)) < len(written):
        raise ValueError("two outputs have the same name")
    constants = (speed, force, seconds)
    sources = [stroke is not None, recording_file is not None, any(value is not None for value in constants)]
    if sum(sources) != 1 or (sources[2] and None in constants):
        raise ValueError("expected one of --stroke, --recording, or --speed with --force and --seconds")
    if recording_file is not None:
        from foten.datasets.hdf5 import load_recording

        recording = load_recording(recording_file)
        given, told = recorded_stroke(recording, rate), recording.sha256()
    elif stroke is not None:
        given, told = read_stroke(stroke, rate), stroke.name
    else:
        given = constant_stroke(float(speed or 0), float(force or 0), float(seconds or 0), rate)
        told = f"{speed:g} mm/s, {force:g} N, {seconds:g} s"
    _tell_of_holes(given)
    hand = given.conditioned(float(texture.card["lowpass_hz"]))
    about = {**_about(texture, told, seed, deterministic), "rate_hz": rate}
    renderer = Renderer(texture, seed=seed, excitation=not deterministic)
    acceleration = renderer.render(*hand).astype(float)
    for path in output:
        sinks.write_rendered(path, acceleration, *hand, rate, about)
    statistics = renderer.counted()
    gain = sinks.write_audible(audible, acceleration, rate) if audible is not None else None
    rms, peak = float((acceleration**2).mean() ** 0.5), float(abs(acceleration).max())
    if as_json:
        _print_json(
            {
                "outputs": [str(p) for p in output],
                "rms_m_s2": rms,
                "peak_m_s2": peak,
                "audible_gain": gain,
                **statistics,
            }
        )
        return
    print(f"{acceleration.size / rate:g} s at {rate:g} Hz, {rms:.3g} m/s² rms, {peak:.3g} m/s² peak")
    print(f"wrote {', '.join(str(path) for path in output)}")
    if gain is not None:
        print(f"wrote {audible}, where 1 m/s² is {gain:.3g} of full scale")
    _tell_what_was_outside(statistics, texture)
    if not texture.has_excitation and not deterministic:
        _say(
            f"{texture.card['model']} carries no excitation, so the loop is deterministic and may fall silent"
        )


@app.command()
def play(
    texture_file: Annotated[
        Path | None,
        typer.Argument(metavar="T.foten", help="A texture file; by default one that comes with foten."),
    ] = None,
    to: Annotated[
        str, typer.Option(help="sound, null, FILE.wav, daq:Dev1/ao0, udp:HOST:PORT or osc:HOST:PORT.")
    ] = "sound",
    stroke: Annotated[
        Path | None,
        typer.Option(
            metavar="S.csv",
            help="As of 'foten render', over and over, without a pause; by default a circle.",
        ),
    ] = None,
    speed: Annotated[float | None, typer.Option(help="Constant speed (mm/s), with --force.")] = None,
    force: Annotated[float | None, typer.Option(help="Constant force (N), with --speed.")] = None,
    seconds: Annotated[
        float | None,
        typer.Option(min=0.0, help="How long (s); by default until Ctrl-C, and 10 s into a file."),
    ] = None,
    rate: Annotated[
        float | None, typer.Option(help="Of the output (Hz); by default 48000 for sound, else 8000 or more.")
    ] = None,
    actuator: Annotated[
        Path | None, typer.Option(metavar="P.json", help="Profile of the actuator that is driven.")
    ] = None,
    gain: Annotated[
        float | None,
        typer.Option(
            help="Full scale (sound) or volts (daq) for 1 m/s², or for 1 of the actuator's drive; of these alone."
        ),
    ] = None,
    device: Annotated[
        str | None,
        typer.Option(help="Number or name of the sound card, as 'python -m sounddevice' lists them."),
    ] = None,
    channel: Annotated[
        int | None, typer.Option(min=0, help="Of the sound card that is played on, from 0; 0 by default.")
    ] = None,
    lead_ms: Annotated[
        float | None, typer.Option(help="Rendered ahead of what is heard (ms); 10 by default.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the excitation.")] = 0,
    deterministic: Annotated[bool, typer.Option("--deterministic", help="Without excitation.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Play a texture live: to the sound card, a file, an NI-DAQ or another program."""
    from foten.render.actuator import read_profile
    from foten.render.example import EXAMPLE
    from foten.render.live import LEAD_MS
    from foten.render.play import along, circling, gain_for, holding, rate_for, sink_of
    from foten.render.play import play as play_live
    from foten.render.renderer import Renderer
    from foten.texture_file import read_texture

    texture_file = texture_file or EXAMPLE
    if not texture_file.exists():
        raise FileNotFoundError(f"no such file: {texture_file}")
    if (speed is None) != (force is None) or (stroke is not None and speed is not None):
        raise ValueError("expected --stroke, or --speed with --force, or neither for a circle")
    if seconds is not None and not 0 <= seconds < float("inf"):
        raise ValueError(f"--seconds is {seconds}, expected a finite number, 0 or more")
    profile = read_profile(actuator) if actuator is not None else None
    texture = read_texture(texture_file)
    own = texture.rate_hz
    renderer = Renderer(
        texture, rate_for(to, rate, own), seed, excitation=not deterministic, actuator=profile
    )
    info = renderer.native_texture.info
    if stroke is not None:
        from foten.render.stroke import read_stroke

        given = read_stroke(stroke, own)
        _tell_of_holes(given)
        hand, told = along(given, info.lowpass_hz), stroke.name
    elif speed is not None and force is not None:
        for name, value, unit in (("speed", speed, "mm/s"), ("force", force, "N")):
            if not 0 <= value < float("inf"):
                raise ValueError(f"--{name} is {value} {unit}, expected a finite number, 0 or more")
        hand, told = holding(speed, force), f"{speed:g} mm/s, {force:g} N"
    else:
        hand, told = circling(info.trained_speed, info.trained_force, own), "a circle"
    scale = gain_for(profile, gain, info.acceleration_sd, to)
    about = _about(texture, told, seed, deterministic)
    if profile is not None:
        about |= {"actuator": dataclasses.asdict(profile), "unit": profile.unit}
    if seconds is None and to.lower().endswith(".wav"):
        seconds = 10.0
    sink = sink_of(to, renderer.rate, scale, seconds, device, channel, about)

    def begun() -> None:
        name, long = info.texture or texture_file.name, "" if seconds is None else f" for {seconds:g} s"
        _say(f"{name} to {to} at {renderer.rate:g} Hz{long}; Ctrl-C ends it")

    lead_ms = LEAD_MS if lead_ms is None else lead_ms
    played = play_live(renderer, sink, hand, seconds, lead_ms, begun)
    statistics = played.statistics
    if as_json:
        _print_json(
            {
                "n_samples": statistics.n_samples,
                "block_ms": statistics.block_ms,
                **{
                    f"block_p{name}_ms": 1000 * statistics.block.percentile_s(percent)
                    for name, percent in (("50", 50), ("99", 99), ("999", 99.9))
                },
                "block_largest_ms": 1000 * statistics.block.largest_s,
                "n_missed": statistics.n_missed,
                "n_underruns": statistics.n_underruns,
                "n_device_underruns": played.n_device_underruns,
                "n_late": played.n_late,
                "n_lacking": statistics.n_lacking,
                "ring_least_ms": statistics.least_ms if statistics.least_ms < float("inf") else None,
                "gain": scale,
                "n_cut": played.n_cut,
                "delays_ms": played.delays_ms,
                "interrupted": played.interrupted,
                **played.counted,
            }
        )
    else:
        print(statistics.line())
        delays = ", ".join(f"{ms:.1f} ms {name}" for name, ms in played.delays_ms.items())
        print(f"delay from hand to output: {delays}")
        _tell_what_was_outside(played.counted, texture)
        if played.counted["n_limited"]:
            print(f"the actuator's limit bent {played.counted['n_limited']} samples")
        if statistics.n_underruns:
            print(
                f"the ring ran empty {statistics.n_underruns} times, {statistics.n_lacking} samples of silence; "
                f"a longer --lead-ms than {lead_ms:g} helps"
            )
        if played.n_device_underruns:
            print(
                f"the sound card got its samples too late {played.n_device_underruns} times, whatever the ring held: "
                "this machine is busy with something else"
            )
        if played.n_late:
            print(
                f"this machine stood still for {played.n_late} blocks of the sink, which were not made up for"
            )
        if played.n_cut:
            print(
                f"{played.n_cut} samples were beyond full scale and cut; a smaller --gain than {scale:.3g} keeps them"
            )
    if played.interrupted:
        raise typer.Exit(130)


@app.command()
def bench(
    texture_file: Annotated[Path, typer.Argument(metavar="T.foten", help="A texture file.")],
    n: Annotated[int, typer.Option("-n", min=1000, help="Samples to time.")] = 20_000,
    as_json: JsonOption = False,
) -> None:
    """Time a sample of a texture in each instruction set of this processor."""
    from foten.render import bench as timing

    if not texture_file.exists():
        raise FileNotFoundError(f"no such file: {texture_file}")
    times = timing.time_all(texture_file, n)
    if as_json:
        _print_json(timing.as_documents(times))
    else:
        print(timing.as_table(times))


@app.command()
def doctor(as_json: JsonOption = False) -> None:
    """Look at what this machine has for rendering, and say what is missing."""
    from foten.render import doctor as examination

    found = examination.checks()
    if as_json:
        _print_json(examination.as_documents(found))
    else:
        for check in found:
            mark = {True: "✓", False: "✗", None: " "}[check.fine]
            print(f"{mark} {check.name:14s}{check.found}")
    if any(check.fine is False for check in found):
        raise typer.Exit(1)


@app.command()
def sweep(
    experiment_file: Annotated[
        str,
        typer.Argument(
            metavar="FILE.toml",
            help="Which methods learn which textures; or one of ours: table-1, table-2, figure-5, figure-5-delta; reduced: "
            "table-1-small, and for a glance paper-small-table-1, -table-2, -figure-5, -figure-5-delta.",
        ),
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder of the results, one file a run.")
    ],
    workers: Annotated[
        int | None, typer.Option(min=1, help="Runs at a time on this machine, a thread each. [its cores]")
    ] = None,
    address: Annotated[
        str | None, typer.Option(help="Of a Ray cluster; auto for the one that this machine is part of.")
    ] = None,
    gpus_per_run: Annotated[
        float,
        typer.Option(min=0.0, max=8.0, help="Share of a GPU that each run takes: 0.25 lets four share one."),
    ] = 0.0,
    together: Annotated[
        int,
        typer.Option(
            min=1,
            max=64,
            help="Textures that a worker trains at once as one batched model: from six on faster with small batches, as of the "
            "paper's recipe. Weights differ from those of one by one in rounding.",
        ),
    ] = 1,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="List the runs and stop.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Train and judge every method of an experiment on every texture and split; goes on where it stopped."""
    from foten.experiments.experiment import find_experiment, read_experiment

    experiment = read_experiment(find_experiment(experiment_file))
    runs = experiment.runs()
    if dry_run:
        if as_json:
            _print_json([dataclasses.asdict(run) for run in runs])
            return
        for run in runs:
            print(f"{run.label}, {run.texture}, split {run.split_seed}")
        _say(f"{len(runs)} runs")
        return
    if output.exists() and not output.is_dir():
        raise ValueError(f"-o {output} is a file, expected a folder")
    from foten.experiments import sweep as sweeping

    def on_progress(progress: sweeping.Progress) -> None:
        run, n = progress.last, progress.n_done + progress.n_failed
        ended = f"failed: {progress.why}" if progress.why else f"{progress.seconds:.0f} s"
        left = f", about {progress.left_s / 60:.0f} min left" if progress.n_left else ""
        _say(f"{n}/{n + progress.n_left} {run.label}, {run.texture}, split {run.split_seed}: {ended}{left}")

    n_done, n_failed = sweeping.sweep(
        experiment, output, workers, address, gpus_per_run, on_progress, _say, together
    )
    if as_json:
        _print_json({"output": str(output), "n_runs": len(runs), "n_done": n_done, "n_failed": n_failed})
    else:
        print(f"{len(runs)} runs, {n_done} now, {n_failed} failed; next: foten tables {output}")
    if n_failed:
        raise typer.Exit(1)


@app.command()
def tables(
    results: Annotated[Path, typer.Argument(metavar="DIR", help="Results of foten sweep.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="DIR",
            help="Write each table as .md, .csv and .tex, and every run with its intervals as runs.csv.",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Set the results of a sweep beside references and beside the paper's figures."""
    from foten.experiments.tables import (
        FIGURES,
        FORMATS,
        each_run,
        findings,
        read_results,
        table,
        title_of,
        written,
    )

    if not results.is_dir():
        raise ValueError(f"there is no folder {results}")
    found = read_results(results)
    cells = {name: table(found, name) for name in FIGURES}
    if output is not None:
        if output.exists() and not output.is_dir():
            raise ValueError(f"-o {output} is a file, expected a folder")
        output.mkdir(parents=True, exist_ok=True)
        for name, one in cells.items():
            for form in FORMATS:
                with atomic_write(output / f"{name}.{form}") as part:
                    part.write_text(written(one, form), encoding="utf-8")
        with atomic_write(output / "runs.csv") as part:
            part.write_text(written(each_run(found), "csv"), encoding="utf-8")
    title, said = title_of(found), list(findings(found))
    if output is not None:
        with atomic_write(output / "findings.md") as part:
            part.write_text("\n\n".join([f"# {title}", *said]) + "\n", encoding="utf-8")
    if as_json:
        _print_json({"title": title, "tables": cells, "findings": said})
        return
    print(f"{title}\n")
    print("\n".join([*(written(one, "md") for one in cells.values()), *said]))


@app.command()
def figures(
    results: Annotated[Path, typer.Argument(metavar="DIR", help="Results of foten sweep.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Write each figure there, .png and .pdf.")
    ],
    recordings: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Of the recordings, from which Fig. 4 is drawn. [where they were when the sweep was started]",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Draw the paper's figures from the results of a sweep: split, windows and losses, waveforms, spectra."""
    from foten.experiments.figures import figures as drawn
    from foten.experiments.tables import read_results

    if not results.is_dir():
        raise ValueError(f"there is no folder {results}")
    found = read_results(results)
    if output.exists() and not output.is_dir():
        raise ValueError(f"-o {output} is a file, expected a folder")
    output.mkdir(parents=True, exist_ok=True)
    made = []
    for name, figure in drawn(found, recordings, _say):
        for form in ("png", "pdf"):
            path = output / f"{name}.{form}"
            with atomic_write(path) as part:
                figure.savefig(part, format=form, dpi=140)
            made.append(str(path))
    if as_json:
        _print_json({"figures": made})
    else:
        print("\n".join(made))


@app.command()
def info(
    texture_file: Annotated[Path, typer.Argument(metavar="T.foten", help="A texture file.")],
    as_json: JsonOption = False,
) -> None:
    """Show what a texture file holds, and prove it on its golden windows."""
    from foten.architecture import multiply_adds
    from foten.render.engine import engine_for
    from foten.render.synthesizer import prove
    from foten.texture_file import read_texture

    texture = read_texture(texture_file)
    prove(texture, engine_for(texture))
    if as_json:
        _print_json({"sha256": texture.sha256(), **texture.card})
        return
    card = texture.card
    own = {name: t for name, t in texture.tensors.items() if not name.startswith(("golden.", "warm_start"))}
    if texture.architecture.in_graph:
        cost, holds = card["metrics"]["multiply_adds"], f"{own['graph'].size:,} bytes for ONNX Runtime"
    else:
        cost = multiply_adds(texture.architecture)
        holds = f"{sum(t.size for t in own.values())} numbers"
    rows = {
        "texture": card["texture"] or "(unnamed)",
        "model": f"{card['model']}, {holds}, hears {card['window']} samples",
        **_linear_part(texture),
        "cost": f"{cost:,} multiply-adds a rendered sample",
        "rate": f"{texture.rate_hz:g} Hz",
        "trained speed": "{:.4g} to {:.4g} mm/s".format(*texture.trained_range("speed")),
        "trained force": "{:.3g} to {:.3g} N".format(*texture.trained_range("force")),
        "acceleration": f"{texture.scaling.sd[0]:.4g} m/s² standard deviation",
        "delay": f"{card['delay_ms']:.1f} ms, of the {card['lowpass_hz']:g} Hz low-pass of speed and force",
        "excitation": "yes" if texture.has_excitation else "no",
        "validation": _validated(card),
        "licence": card["licence"] or "(not stated)",
        "sha256": texture.sha256(),
        "proof": "golden windows replayed",
    }
    for name, value in rows.items():
        print(f"{name:14s}{value}")


def _validated(card: Mapping[str, Any]) -> str:
    """Return what `info` says of the validation blocks."""
    if card["split"] is None:
        return "none here: its models were imported"
    metrics = card["metrics"]
    if metrics["validation_mae_scaled"] is None:
        return _missed(card)
    told = f"{metrics['validation_mae_scaled']:.4f} sd one-step"
    if metrics.get("validation_mae_scaled_hop") is not None:
        told += f", {metrics['validation_mae_scaled_hop']:.4f} sd on the mean of a hop"
    return told


def _missed(card: Mapping[str, Any]) -> str:
    """Return what the validation blocks say of a model of spectra."""
    found = f"{card['metrics']['validation_spectrum_db']:.2f} dB"
    if card["model"] == "gan":
        return f"mean spectra missed by {found}"
    return f"spectra of single frames missed by {found}, of which chance alone is 4.3"


def _linear_part(texture: Texture) -> dict[str, str]:
    """Return what `info` says of the local models, or of the lattice and the tones; nothing of a model that has none."""
    sizes, metrics = texture.card["sizes"], texture.card["metrics"]
    if texture.card["model"] == "ar":
        zeros = f", {sizes['ma']} zeros" if sizes["ma"] else ""
        return {
            "models": f"{sizes['n_models']} of order {sizes['order']}{zeros}, in {sizes['n_triangles']} triangles"
        }
    if texture.card["model"] != "foten-plus":
        return {}
    vertices = sizes["n_speed"] * sizes["n_force"]
    over = "for all speeds and forces" if vertices == 1 else f"over {vertices} speeds and forces"
    driven = ", driven by the level" if sizes["level_drives"] else ""
    rows = {"lattice": f"{sizes['order']} samples, {over}{driven}", "tones": "none"}
    rows["network"] = (
        "is heard" if sizes["network_heard"] and not sizes["n_tones"] else "predicts, and is not heard"
    )
    if sizes["n_tones"]:
        length = (metrics.get("linear_part") or {}).get("wavelength_mm")
        every = f", the surface repeats every {length:.3g} mm" if length else ""
        rows["tones"] = (
            f"{sizes['n_tones']} multiples{every}; of the rest a lattice of {sizes['rest_order']} samples"
            f"{', driven by the level' if sizes['rest_level_drives'] else ''}"
        )
    return rows


@app.command()
def demo(
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for everything it makes.")
    ] = Path("demo"),
    key: Annotated[
        str, typer.Option("--texture", help="Simulated texture; foten simulate --list.")
    ] = "towel",
    seconds: Annotated[float, typer.Option(help="Length of the recording (s).")] = 44.0,
    epochs: Annotated[int, typer.Option(help="Of training.")] = 8,
    seed: Annotated[int, typer.Option(min=0, max=2**31, help="Of everything.")] = 0,
    threads: Annotated[
        int, typer.Option(help="Share each batch among so many cores (on a GPU there is one share).")
    ] = 2,
    as_json: JsonOption = False,
) -> None:
    """Go once through everything without data or hardware: simulate, train, judge, render."""
    from foten.experiments.demo import run_demo

    paths = run_demo(output, key, seconds, epochs, seed, threads, _say)
    if as_json:
        _print_json({name: str(path) for name, path in paths.items()})
        return
    for name, path in paths.items():
        print(f"{name:10s}{path}")


def _check_folders(paths: list[Path]) -> None:
    """Refuse an output whose folder does not exist, before any work is done."""
    for path in paths:
        if not path.parent.is_dir():
            raise ValueError(f"cannot write {path}: there is no folder {path.parent}")
        if path.is_dir() and path.suffix:
            raise ValueError(f"cannot write {path}: it is a folder")


def _settings(pairs: list[str]) -> dict[str, Any]:
    """Return SIZE=VALUE pairs as a mapping, values read as JSON where they are, else as words."""
    found: dict[str, Any] = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals or not name or not value:
            raise ValueError(f"--set {pair}: expected SIZE=VALUE, such as --set n_layers=2")
        try:
            found[name.strip()] = json.loads(value)
        except json.JSONDecodeError:
            found[name.strip()] = value.strip()
    return found


def main() -> None:
    """Run the command line and turn every expected failure into one line and an exit status."""
    # Read when NumPy and PyTorch load their libraries: small matrices only lose by more threads.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    sys.exit(_status(sys.argv[1:]))


def _status(arguments: list[str]) -> int:
    if os.environ.get("FOTEN_DEBUG"):  # the whole traceback, for people who mend foten
        return app(arguments, standalone_mode=False) or 0
    if not arguments:
        arguments = ["--help"]
    try:
        return app(arguments, standalone_mode=False) or 0
    except (Abort, KeyboardInterrupt):
        _say("foten: interrupted")
        return 130
    except TyperException as error:
        _say(f"foten: {' '.join(error.format_message().split())}")
    except ModuleNotFoundError as error:
        package = (error.name or "").split(".")[0]
        if package not in _EXTRAS:
            raise
        _say(f"foten: this needs {package}, which is not installed: pip install 'foten[{_EXTRAS[package]}]'")
    except (ValueError, OSError) as error:
        _say(f"foten: {' '.join(_told(error).split())}")
    return 2


def _told(error: Exception) -> str:
    """Return what went wrong: of the system's own errors the file first, and no number."""
    if isinstance(error, OSError) and error.strerror and error.filename is not None:
        return f"{error.filename}: {error.strerror[:1].lower()}{error.strerror[1:]}"
    return str(error) or type(error).__name__


if __name__ == "__main__":
    main()
