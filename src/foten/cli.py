"""The command line: one subcommand per stage; parse, call one function, write.

Exit status: 0; 1 for a result that fails a check; 2 for bad input or usage, one line on stderr; 130 after Ctrl-C.
Results go to stdout, progress to stderr. Heavy imports stay inside the subcommands.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.exceptions import Abort, TyperException

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
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    pass


@app.command()
def simulate(
    key: Annotated[str | None, typer.Argument(help="Texture or linear process; --list shows them.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="HDF5 file to write.")] = None,
    seconds: Annotated[float, typer.Option(help="Length [s].")] = 64.0,
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


def main() -> None:
    """Run the command line and turn every expected failure into one line and an exit status."""
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
        _say(f"foten: {' '.join(str(error).split()) or type(error).__name__}")
    return 2


@app.command("import")
def import_(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="CSV, TSV, .xlsx, .npz, .mat (v5 to v7.3), .tdms, .wav, .h5.", show_default=False
        ),
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="The recording to write, .h5.", show_default=False)
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
        typer.Option("--fill-gaps", metavar="MS", help="Fill gaps of up to MS ms in position and speed."),
    ] = 0.0,
    force_units: Annotated[
        bool,
        typer.Option(
            "--force-units",
            help="Accept what no hand does, spikes for example: above 5 m/s, 1000 m/s², 500 N or 10 m.",
        ),
    ] = False,
    texture: Annotated[str, typer.Option(help="What was stroked.")] = "",
    tool: Annotated[str, typer.Option(help="What it was stroked with.")] = "",
    sensors: Annotated[str, typer.Option(help="Sensors, amplifiers, ranges.")] = "",
    notes: Annotated[str, typer.Option(help="Anything else.")] = "",
    as_json: JsonOption = False,
) -> None:
    """Turn files of any origin into one recording, converting units and changing nothing else.

    foten import denim.csv --map time=t,acceleration=ax,speed=v,force=fz --unit acceleration=g -o denim.h5

    foten import acc.wav rest.csv --map acceleration=acc.wav:0,speed=rest.csv:v,force=rest.csv:f
    --unit acceleration=*50 --rate 1000 -o denim.h5
    """
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
            texture=texture,
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
        (output / "inspect.json").write_text(json.dumps(document, indent=1, allow_nan=False) + "\n")
        for path in write_pictures(recording, inspection, output):
            _say(f"wrote {path}")
    if as_json:
        _print_json(document)
    else:
        print(inspection.to_text())
    if strict and inspection.problems:
        raise typer.Exit(1)


if __name__ == "__main__":
    main()
