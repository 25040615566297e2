"""`foten simulate`, `foten import` and `foten inspect`: make, import and check recordings."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Exit, Option

from foten.atomic_write import write_json
from foten.cli.stroke_options import pressure_calibration
from foten.cli.train import Anyway, check_usable, unusable
from foten.console import (
    JsonOption,
    RecordingFile,
    check_files,
    check_folder,
    check_output,
    folder_option,
    print_result,
    refuse,
    say,
)

if TYPE_CHECKING:
    from foten.datasets.options import ImportOptions
    from foten.recording.recording import Recording


def simulate(
    key: str | None = Argument(None, help="Key of a simulated texture or linear process; --list shows all."),
    output: Path | None = Option(None, "-o", "--output", help="Recording to write (.h5); with --capture a folder."),
    seconds: float = Option(64.0, help="Length of the recording (s)."),
    seed: int | None = Option(
        None, help="Seed of all random parts that --noise-seed and --stroke-seed do not set.", show_default="0"
    ),
    noise_seed: int | None = Option(
        None, help="Seed of the surface and the sensor noise; change it alone to repeat the same stroke."
    ),
    stroke_seed: int | None = Option(None, help="Seed of the stroke."),
    accelerometer_hz: float | None = Option(
        None,
        help="Sampling rate of the accelerometer (Hz): 10000 divided by a whole number.",
        show_default="10000; linear 1000",
    ),
    capture: bool = Option(
        False, "--capture", help="Simulate a microphone on a pen instead: write sound.wav and pen.csv to the folder -o."
    ),
    show_list: bool = Option(False, "--list", help="List the keys and exit."),
    as_json: JsonOption = False,
) -> None:
    """Simulate a recording with known ground truth: raw sensors over a texture, or a linear process."""
    from foten.datasets.hdf5 import write_recording
    from foten.simulation import simulate as simulator

    if show_list:
        linear: dict[str, Any] = {**simulator.LINEAR_FAMILY, **simulator.OTHER_LINEAR}
        sources: dict[str, Any] = {**simulator.TEXTURES, **simulator.CONTACT, **simulator.TWO_MASS, **linear}
        known = {name: source.description for name, source in sources.items()}
        print_result(known, "\n".join(f"{name:18s}{description}" for name, description in known.items()), as_json)
        return
    if key is None or output is None:
        raise ValueError("expected a key and -o FILE; --list shows the keys")
    of_sensors = dict[str, Any](noise_seed=noise_seed, stroke_seed=stroke_seed, accelerometer_hz=accelerometer_hz)
    if capture:
        refuse("is for recordings, and --capture writes a sound", **of_sensors)
        check_files([output])
        _simulate_capture(key, seconds, seed or 0, output, as_json)
        return
    if noise_seed is not None and stroke_seed is not None:
        refuse("has no effect beside --noise-seed and --stroke-seed", seed=seed)
    check_output(output, "a recording", ".h5", ".hdf5", ".H5", ".HDF5")
    recording = simulator.simulate(key, seconds, seed or 0, **of_sensors)
    write_recording(recording, output)
    result = {"output": str(output), "sha256": recording.sha256(), "simulation": dict(recording.simulation or {})}
    print_result(result, f"{output}: {key}, {recording.duration_s:g} s, {', '.join(recording.channels)}", as_json)


def _simulate_capture(key: str, seconds: float, seed: int, folder: Path, as_json: bool) -> None:
    import numpy as np

    from foten.simulation.simulated_capture import DELAY_S, DRIFT, FULL_SCALE, simulate_capture

    sound, pen = simulate_capture(key, seconds, seed).write(folder, np.random.default_rng([seed, 8]))
    what = f"{key}, {seconds:g} s of strokes between taps, full scale is {FULL_SCALE:g} m/s²"
    clock = f"the pen's clock is {1000 * DELAY_S:g} ms late and {1e6 * DRIFT:g} ppm fast"
    text = f"{sound} and {pen}: {what}; {clock}\nnext: foten import {sound} --pen {pen} -o {key}.h5"
    print_result({"sound": str(sound), "pen": str(pen), "full_scale_m_s2": FULL_SCALE}, text, as_json)


def import_(
    files: list[Path] = Argument(
        ...,
        help="Files to import (CSV, TSV, .xlsx, .npz, .mat, .tdms, .wav, .h5), one .xml of models, or the folder of a "
        "public dataset.",
    ),
    output: Path = Option(
        ..., "-o", "--output", help="Recording to write (.h5); for an .xml of models, texture file to write (.foten)."
    ),
    mapping: list[str] | None = Option(
        None,
        "--map",
        help="Columns of the channels: CHANNEL=COLUMN,… with channels time, acceleration, speed, force, or by axis "
        "acceleration_x, position_x, force_x and so on (z is the surface normal). COLUMN is a header or a number "
        "from 0; with several files FILE:COLUMN. time may be given once per file, for the channels of that file "
        "with as many rows; without FILE: it is that column of every file that has it. Channels that are not "
        "mapped are taken from the headers and reported on stderr.",
    ),
    units: list[str] | None = Option(
        None,
        "--unit",
        help="Units, as CHANNEL=UNIT,… of the file: acceleration m/s^2, g, mg, mm/s^2, in/s^2, ft/s^2; speed mm/s, "
        "cm/s, m/s, in/s, ft/s, mm/min, km/h; position mm, cm, m, um, in, ft; force N, cN, mN, kN, gf, kgf, lbf, "
        "ozf, dyn; time s, ms, us, ns, min. CHANNEL=V*FACTOR or CHANNEL=*FACTOR multiplies by a sensitivity, e.g. "
        "force=V*4.9 for 4.9 N per volt. Default: the units that the file states, else m/s^2, mm/s, mm, N, s.",
    ),
    rate: list[str] | None = Option(
        None,
        help="Sampling rate (Hz) of channels without a rate or times, e.g. 10000; or of any channel, e.g. force=1000.",
    ),
    fill_gaps: float = Option(
        0.0, metavar="MS", help="Fill gaps up to this long (ms) in position, speed and force by straight lines."
    ),
    force_units: bool = Option(
        False, "--force-units", help="Accept values above 5 m/s, 1000 m/s², 500 N or 10 m, e.g. spikes."
    ),
    normal: str | None = Option(
        None,
        metavar="x,y,z",
        help="Surface normal in the axes of force_x, force_y, force_z, for a tilted force sensor.",
        show_default="0,0,1",
    ),
    pen: Path | None = Option(
        None,
        metavar="E.csv",
        help="Pen events (t, x, y, pressure) to join to the sound of a microphone on the pen, by taps before and after "
        "the strokes. Units are relative without --unit acceleration=*FACTOR.",
    ),
    pressure: str | None = Option(
        None,
        help="Convert the pressure p of --pen to force (N) by a·exp(b·p); give a,b as fitted by 'foten serve'; default "
        "0.13,3.32 (Eq. 12).",
    ),
    texture: str = Option("", help="Name of the surface; by default the name of the first file."),
    tool: str = Option("", help="Tool that the surface was stroked with."),
    sensors: str = Option("", help="Description of the sensors, amplifiers and ranges."),
    notes: str = Option("", help="Further notes."),
    surface: int | None = Option(None, help="Number of the surface to import from a dataset's folder."),
    append: bool = Option(
        False, "--append", help="Add the files to the existing recording -o as another take of the same surface."
    ),
    anyway: Anyway = False,
    as_json: JsonOption = False,
) -> None:
    """Import files of any origin into one recording; units are converted, nothing else is changed.

    foten import denim.csv --map time=t,acceleration=ax,speed=v,force=fz --unit acceleration=g -o denim.h5

    foten import acc.wav rest.csv --map acceleration=acc.wav:0,speed=rest.csv:v,force=rest.csv:f
    --unit acceleration=*50 --rate 1000 -o denim.h5

    foten import sound.wav --pen events.csv -o denim.h5: a microphone on a pen, joined to its events by taps.

    foten import texture_dataset --surface 12 -o cork.h5: a surface of the Cluster Haptic Texture Dataset, all its clips.

    foten import Models_Denim.xml -o denim.foten: a model file of the Penn Haptic Texture Toolkit becomes a texture.
    """
    of_table = dict[str, Any](map=mapping, unit=units, rate=rate, fill_gaps=fill_gaps or None, force_units=force_units)
    of_table |= {"pen": pen, "pressure": pressure, "normal": normal}
    if any(file.suffix.lower() == ".xml" for file in files):
        of_recording = dict[str, Any](tool=tool, sensors=sensors, surface=surface, append=append, anyway=anyway)
        refuse("is for recordings, and an .xml file holds models with their units and rate", **of_table, **of_recording)
        _import_models(files, output, texture, notes, as_json)
        return
    from foten.datasets.cluster import read_cluster
    from foten.datasets.hdf5 import load_recording, write_recording
    from foten.datasets.importing import import_recording
    from foten.datasets.options import ImportOptions, parse_normal, parse_pairs, parse_rates
    from foten.recording.inspection import inspect_recording
    from foten.recording.recording import joined_takes

    check_output(output, "a recording", ".h5", ".hdf5", ".H5", ".HDF5")
    if any(os.path.realpath(file) == os.path.realpath(output) for file in (*files, *([pen] if pen else []))):
        raise ValueError(f"-o {output} is a file to import, which it would replace: give another name")
    rate_hz, rates_hz = parse_rates(rate or [])
    pairs, units_of = parse_pairs(mapping or [], "--map"), dict(parse_pairs(units or [], "--unit"))
    along = None if normal is None else parse_normal(normal)
    options = ImportOptions(tuple(pairs), units_of, rate_hz, rates_hz, fill_gaps, force_units, along)
    stated = {"texture": texture, "tool": tool, "sensors": sensors, "notes": notes}
    if append:
        refuse("comes from the recording that is extended", **stated)
    if any(file.is_dir() for file in files):
        refuse("is for tables, and a dataset's format is known", **of_table)
        if len(files) != 1:
            raise ValueError(f"got {len(files)} files, expected only the folder of a dataset")
        imported, decisions = read_cluster(files[0], surface)
    elif pen is None:
        refuse("is for use with --pen", pressure=pressure)
        refuse("is for the folder of a dataset", surface=surface)
        imported, decisions = import_recording(files, options)
    else:
        refuse("is for a force in three axes, and a pen measures pressure", normal=normal)
        imported, decisions = _import_capture(files, pen, pressure, options)
    inspection = inspect_recording(imported)
    refusals = () if anyway else unusable(inspection, decisions)
    for decision in decisions:
        if decision not in refusals:
            say(decision)
    check_usable(refusals)
    recording = _named(imported, files, stated)
    whole = joined_takes([load_recording(output), recording]) if append else recording
    write_recording(whole, output)
    _print_imported(recording, output, len(whole.takes), as_json)


def _named(imported: Recording, files: list[Path], stated: dict[str, str]) -> Recording:
    """The recording with what is stated of it, and otherwise the names of its files."""
    for field in ("texture", "tool"):
        if (text := getattr(imported, field)) and not stated[field] and not files[0].is_dir():
            say(f"{field}: {text}, read from the lines above the table; --{field} overrides it")
    folder = files[0].resolve().parent.name
    stem = folder if files[0].stem == "sound" and folder else files[0].stem  # of a `sound.wav` its folder's
    name = imported.name or ", ".join(file.name for file in files)
    named = {"texture": imported.texture or stem, "name": name} | {key: text for key, text in stated.items() if text}
    return replace(imported, **named)  # type: ignore[arg-type]


def _print_imported(recording: Recording, output: Path, n_takes: int, as_json: bool) -> None:
    """Print what was imported: rates, lengths and ranges of the channels, and what was done to them."""
    channels: dict[str, dict[str, Any]] = {}
    lines = []
    for name, channel in recording.channels.items():
        low, high, unit = float(channel.samples.min()), float(channel.samples.max()), recording.unit(name)
        n, rate_hz, seconds = channel.samples.size, channel.rate_hz, channel.duration_s
        channels[name] = {"unit": unit, "rate_hz": rate_hz, "regular": channel.times_s is None, "n_samples": n}
        channels[name] |= {"duration_s": seconds, "minimum": low, "maximum": high}
        range_of = f"{low:.4g} to {high:.4g} {unit}"
        lines.append(f"{name:<15} {n:>9} samples at {rate_hz:>8g} Hz, {seconds:7.3f} s, {range_of}")
    lines += [f"  {line}" for line in recording.history]
    document = {"file": str(output), "sha256": recording.sha256(), "channels": channels, "history": recording.history}
    takes = f", which has {n_takes} takes" if n_takes > 1 else ""
    text = "\n".join([*lines, f"wrote {output}{takes}; next: foten inspect {output}"])
    print_result({**document, "n_takes": n_takes}, text, as_json)


def _import_capture(
    files: list[Path], pen: Path, curve: str | None, options: ImportOptions
) -> tuple[Recording, list[str]]:
    from foten.datasets.importing import import_capture

    if len(files) != 1 or options.mapping:
        raise ValueError("--pen expects one sound file, whose first channel is the acceleration: leave out --map")
    recording, _, decisions = import_capture(files[0], pen, options, pressure_calibration(curve).force)
    return recording, decisions


def _import_models(files: list[Path], output: Path, texture: str, notes: str, as_json: bool) -> None:
    import hashlib

    from foten.datasets.hatt import read_models

    if len(files) != 1:
        raise ValueError(f"got {len(files)} files, expected a single .xml of models")
    if output.suffix != ".foten":
        raise ValueError(f"models are written as a texture file, .foten, got -o {output.name}")
    check_files([output])
    models, digest = read_models(files[0]), hashlib.sha256(files[0].read_bytes()).hexdigest()
    from foten.models.piecewise_ar.local_models import imported_texture  # with PyTorch, which takes seconds
    from foten.models.texture_file import write_texture

    imported, decisions = imported_texture(models, digest, texture, notes=notes)
    for decision in decisions:
        say(decision)
    write_texture(imported, output)
    card, sizes = imported.card, imported.card["sizes"]
    of_card = {key: card[key] for key in ("texture", "rate_hz", "sizes", "trained_range", "notes")}
    document = {"file": str(output), "sha256": imported.sha256(), "imported_sha256": digest, **of_card}
    speed, force = imported.trained_range("speed")[1], imported.trained_range("force")[1]
    holds = f"{sizes['n_models']} models of order {sizes['order']} at {card['rate_hz']:g} Hz, {sizes['ma']} zeros each"
    text = (
        f"{card['texture'] or files[0].stem}: {holds}, up to {speed:.0f} mm/s and {force:.1f} N\n"
        "the licence of the model file also applies to the texture: read its notice before you share it\n"
        f"wrote {output}; next: foten render {output} --speed 80 --force 0.8 --seconds 3 -o {output.stem}.wav"
    )
    print_result(document, text, as_json)


def inspect(
    recording_file: RecordingFile,
    output: Annotated[
        Path | None, folder_option("Folder for inspect.json, overview.png, coverage.png and psd.png.")
    ] = None,
    strict: bool = Option(
        False, "--strict", help="Exit with status 1 on any problem, not only if nothing can be learned."
    ),
    as_json: JsonOption = False,
) -> None:
    """Report what a recording holds and what is wrong with it: units, coverage, clipping, gaps, order of rows."""
    from foten import __version__
    from foten.datasets.hdf5 import load_recording
    from foten.recording.inspection import inspect_recording
    from foten.reporting.recording_pictures import write_pictures

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
    if inspection.unusable or (strict and inspection.problems):
        raise Exit(1)
