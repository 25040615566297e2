"""`foten demo`, `bench`, `doctor` and `devices`: all stages on this machine, its speed and equipment."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from typer import Exit, Option

from foten.console import JsonOption, TextureFile, folder_option, print_result, say
from foten.reporting.table import Table
from foten.runtime import bench as timing
from foten.runtime import doctor as examination
from foten.runtime.binding import c_flags as flags_of
from foten.runtime.live.devices import daq_channels, sound_devices


def bench(
    texture_file: TextureFile,
    n: int = Option(20_000, "-n", min=1000, help="Number of samples to time."),
    as_json: JsonOption = False,
) -> None:
    """Time the rendering of one sample with each instruction set of this processor."""
    times = timing.time_all(texture_file, n)
    print_result([asdict(time) for time in times], timing.as_table(times), as_json)


def devices(as_json: JsonOption = False) -> None:
    """List the outputs of this machine: sound cards for --device and --channel, and analogue outputs of NI-DAQs."""
    sound, daq, rows = sound_devices(), daq_channels(), []
    heads = ("--device", "name", "interface", "channels", "latency [ms]", "rate [Hz]", "")
    for one in sound:
        figures = f"{one.channels}", f"{one.latency_ms:.0f}", f"{one.rate_hz:g}"
        rows.append((f"{one.number}", one.name, one.host, *figures, "default" if one.default else ""))
    lines = Table.of(heads, rows).text() if rows else ["no sound output"]
    lines += [f"NI-DAQ: --to daq:{channel}" for channel in daq]
    lines.append("next: foten play --device NUMBER --channel 1")
    print_result({"sound": [asdict(device) for device in sound], "daq": daq}, "\n".join(lines), as_json)


def doctor(
    c_flags: bool = Option(
        False, "--c-flags", help="Print compiler flags, as in: cc stroke.c $(foten doctor --c-flags)"
    ),
    as_json: JsonOption = False,
) -> None:
    """Check what this machine has for rendering, and report what is missing."""
    if c_flags:
        print_result({"c_flags": flags_of()}, flags_of(), as_json)
        return

    checks, marks = examination.checks(), {True: "✓", False: "✗", None: " "}
    lines = [f"{marks[check.fine]} {check.name:14s}{check.result}" for check in checks]
    print_result([asdict(check) for check in checks], "\n".join(lines), as_json)
    if any(check.fine is False for check in checks):
        raise Exit(1)


def demo(
    output: Annotated[Path, folder_option("Folder for all files that the demo writes.")] = Path("demo"),
    key: str = Option("towel", "--texture", help="Key of the simulated texture; 'foten simulate --list' shows all."),
    seconds: float = Option(44.0, help="Length of the simulated recording (s)."),
    epochs: int = Option(5, help="Maximum number of training epochs."),
    seed: int = Option(0, min=0, max=2**31, help="Seed of simulation, training and rendering."),
    threads: int = Option(2, help="Number of CPU threads that share each batch; a GPU takes the whole batch."),
    as_json: JsonOption = False,
) -> None:
    """Run all stages once without data or hardware: simulate, train, evaluate, render."""
    from foten.cli.demo import run_demo

    paths = {name: str(path) for name, path in run_demo(output, key, seconds, epochs, seed, threads, say).items()}
    print_result(paths, "\n".join(f"{name:10s}{path}" for name, path in paths.items()), as_json)
