"""`foten simulate` and `foten demo`: what needs neither data nor hardware."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from foten.cli.console import JsonOption, check_folders, folder_option, print_result, say


def simulate(
    key: Annotated[str | None, Argument(help="Texture or linear process; --list shows them.")] = None,
    output: Annotated[Path | None, Option("-o", "--output", help="HDF5 file to write.")] = None,
    seconds: Annotated[float, Option(help="Length (s).")] = 64.0,
    seed: Annotated[int, Option(help="Of everything random that the next two leave out.")] = 0,
    noise_seed: Annotated[
        int | None, Option(help="Of surface and sensors: another one, the same stroke again.")
    ] = None,
    stroke_seed: Annotated[int | None, Option(help="Of the hand.")] = None,
    accelerometer_hz: Annotated[
        float | None,
        Option(help="10000 over a whole number, by default 10000; for a linear process its rate, by default 1000."),
    ] = None,
    show_list: Annotated[bool, Option("--list", help="Show the keys and stop.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a simulated recording with a known truth: raw sensors over a texture, or a linear process."""
    from foten.datasets import simulate as simulator
    from foten.datasets.hdf5 import write_recording

    if show_list:
        known = {name: parameters.description for name, parameters in simulator.TEXTURES.items()}
        known |= {name: process.description for name, process in simulator.LINEAR_FAMILY.items()}
        print_result(known, "\n".join(f"{name:18s}{description}" for name, description in known.items()), as_json)
        return
    if key is None or output is None:
        raise ValueError("expected a key and -o FILE; --list shows the keys")
    check_folders([output])
    if output.suffix.lower() not in (".h5", ".hdf5"):
        raise ValueError(f"a recording is written as .h5, got -o {output.name}")
    recording = simulator.simulate(
        key, seconds, seed, noise_seed=noise_seed, stroke_seed=stroke_seed, accelerometer_hz=accelerometer_hz
    )
    write_recording(recording, output)
    result = {"output": str(output), "sha256": recording.sha256(), "simulation": dict(recording.simulation or {})}
    print_result(result, f"{output}: {key}, {recording.duration_s:g} s, {', '.join(recording.channels)}", as_json)


def demo(
    output: Annotated[Path, folder_option("Folder for everything it makes.")] = Path("demo"),
    key: Annotated[str, Option("--texture", help="Simulated texture; foten simulate --list.")] = "towel",
    seconds: Annotated[float, Option(help="Length of the recording (s).")] = 44.0,
    epochs: Annotated[int, Option(help="Of training.")] = 5,
    seed: Annotated[int, Option(min=0, max=2**31, help="Of everything.")] = 0,
    threads: Annotated[int, Option(help="Share each batch among so many cores (on a GPU there is one share).")] = 2,
    as_json: JsonOption = False,
) -> None:
    """Go once through everything without data or hardware: simulate, train, judge, render."""
    from foten.experiments.demo import run_demo

    paths = {name: str(path) for name, path in run_demo(output, key, seconds, epochs, seed, threads, say).items()}
    print_result(paths, "\n".join(f"{name:10s}{path}" for name, path in paths.items()), as_json)
