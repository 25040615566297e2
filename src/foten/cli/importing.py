"""`foten import`: recordings, and models that others have fitted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from foten.cli.console import JsonOption, check_folders, print_result, say


def import_(
    files: Annotated[
        list[Path],
        Argument(
            help="CSV, TSV, .xlsx, .npz, .mat (v5 to v7.3), .tdms, .wav, .h5; or one .xml of linear models.",
            show_default=False,
        ),
    ],
    output: Annotated[
        Path,
        Option("-o", "--output", help="The recording to write, .h5; of models a texture, .foten.", show_default=False),
    ],
    mapping: Annotated[
        list[str] | None,
        Option(
            "--map",
            help="CHANNEL=COLUMN,… with channels time, acceleration, speed, force, or by axis acceleration_x, position_x, "
            "force_x and so on (z is the surface normal). A column is a header name, or a number from 0; with several files "
            "FILE:COLUMN. time may be given once per file and serves the channels of that file with as many rows; without "
            "FILE: it is that column of every file which has it. Default: by the header names, said on stderr.",
        ),
    ] = None,
    units: Annotated[
        list[str] | None,
        Option(
            "--unit",
            help="CHANNEL=UNIT,… of the file: acceleration m/s^2, g, mg, mm/s^2; speed mm/s, cm/s, m/s; position mm, cm, m, "
            "um; force N, mN, gf; time s, ms, us, ns. CHANNEL=V*FACTOR or *FACTOR multiplies, for a sensitivity: "
            "force=V*4.9 for 4.9 N per volt. Default: what the file states, else m/s^2, mm/s, mm, N, s.",
        ),
    ] = None,
    rate: Annotated[
        list[str] | None,
        Option(
            "--rate",
            help="HZ for the channels whose file states no rate and has no time column, or CHANNEL=HZ,…, which comes before "
            "what the file states.",
        ),
    ] = None,
    fill_gaps: Annotated[
        float, Option("--fill-gaps", metavar="MS", help="Fill gaps of up to MS ms in position, speed and force.")
    ] = 0.0,
    force_units: Annotated[
        bool,
        Option(
            "--force-units", help="Accept what no hand does, spikes for example: above 5 m/s, 1000 m/s², 500 N or 10 m."
        ),
    ] = False,
    texture: Annotated[str, Option(help="What was stroked; the file's name by default.")] = "",
    tool: Annotated[str, Option(help="What it was stroked with.")] = "",
    sensors: Annotated[str, Option(help="Sensors, amplifiers, ranges.")] = "",
    notes: Annotated[str, Option(help="Anything else.")] = "",
    as_json: JsonOption = False,
) -> None:
    """Turn files of any origin into one recording, converting units and changing nothing else.

    foten import denim.csv --map time=t,acceleration=ax,speed=v,force=fz --unit acceleration=g -o denim.h5

    foten import acc.wav rest.csv --map acceleration=acc.wav:0,speed=rest.csv:v,force=rest.csv:f
    --unit acceleration=*50 --rate 1000 -o denim.h5

    foten import Models_Denim.xml -o denim.foten: a model file of the Penn Haptic Texture Toolkit becomes a texture.
    """
    if any(file.suffix.lower() == ".xml" for file in files):
        of_recordings = {
            "map": mapping,
            "unit": units,
            "rate": rate,
            "fill-gaps": fill_gaps,
            "force-units": force_units,
        }
        for name, value in {**of_recordings, "tool": tool, "sensors": sensors}.items():
            if value:
                raise ValueError(
                    f"--{name} is for recordings, and an .xml holds models with units and rate: leave it out"
                )
        _import_models(files, output, texture, notes, as_json)
        return
    from foten.datasets.hdf5 import write_recording
    from foten.datasets.importing import import_recording
    from foten.datasets.options import ImportOptions, parse_pairs, parse_rates
    from foten.recording.recording import UNITS

    if output.suffix.lower() not in (".h5", ".hdf5"):
        raise ValueError(f"a recording is written as .h5, got -o {output.name}")
    check_folders([output])
    rate_hz, rates_hz = parse_rates(rate or [])
    units_of = dict(parse_pairs(units or [], "--unit"))
    pairs = tuple(parse_pairs(mapping or [], "--map"))
    options = ImportOptions(pairs, units_of, rate_hz, rates_hz, fill_gaps, force_units)
    imported, decisions = import_recording(files, options)
    for decision in decisions:
        say(decision)
    recording = replace(imported, texture=texture or output.stem, tool=tool, sensors=sensors, notes=notes)
    write_recording(recording, output)
    channels: dict[str, dict[str, Any]] = {
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
    }
    row = (
        "{:<15} {n_samples:>9} samples at {rate_hz:>8g} Hz, {duration_s:7.3f} s, {minimum:.4g} to {maximum:.4g} {unit}"
    )
    lines = [row.format(name, **of_channel) for name, of_channel in channels.items()]
    lines += [f"  {line}" for line in recording.history]
    document = {"file": str(output), "sha256": recording.sha256(), "channels": channels, "history": recording.history}
    print_result(document, "\n".join([*lines, f"wrote {output}; next: foten inspect {output}"]), as_json)


def _import_models(files: list[Path], output: Path, texture: str, notes: str, as_json: bool) -> None:
    import hashlib

    from foten.datasets.hatt import read_models
    from foten.families.texture_file import write_texture
    from foten.train.piecewise_ar_texture import imported_texture

    if len(files) != 1:
        raise ValueError(f"got {len(files)} files, expected one .xml of models by itself")
    if output.suffix != ".foten":
        raise ValueError(f"models are written as a texture file, .foten, got -o {output.name}")
    check_folders([output])
    models = read_models(files[0])
    digest = hashlib.sha256(files[0].read_bytes()).hexdigest()
    imported, decisions = imported_texture(models, digest, texture, notes=notes)
    for decision in decisions:
        say(decision)
    write_texture(imported, output)
    card, sizes = imported.card, imported.card["sizes"]
    of_card = {key: card[key] for key in ("texture", "rate_hz", "sizes", "trained_range", "notes")}
    document = {"file": str(output), "sha256": imported.sha256(), "imported_sha256": digest} | of_card
    speed, force = imported.trained_range("speed")[1], imported.trained_range("force")[1]
    text = (
        f"{card['texture'] or files[0].stem}: {sizes['n_models']} models of order {sizes['order']} at {card['rate_hz']:g} Hz, "
        f"{sizes['ma']} zeros each, up to {speed:.0f} mm/s and {force:.1f} N\n"
        "the licence of the model file holds for the texture too: see its notice before you pass it on\n"
        f"wrote {output}; next: foten render {output} --speed 80 --force 0.8 --seconds 3 -o {output.stem}.wav"
    )
    print_result(document, text, as_json)
