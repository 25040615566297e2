"""Options of a stroke that several commands have, and the strokes that they stand for."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Option

from foten.console import JsonOption, refuse, say
from foten.dsp import Array
from foten.models.texture_file import Texture
from foten.runtime.stroke import Stroke, constant_stroke, recorded_stroke, tabled_stroke
from foten.runtime.stylus import PressureCalibration

Units = Annotated[
    list[str] | None,
    Option("--unit", help="Units of the columns of --stroke, e.g. speed=cm/s,force=gf, as in 'foten import'."),
]
Pressure = Annotated[
    str | None,
    Option(
        "--pressure",
        metavar="a,b",
        help="Convert the pressure p of --stroke to force (N) by a·exp(b·p).",
        show_default="0.13,3.32",
    ),
]
Speed = Annotated[float | None, Option(help="Constant speed (mm/s), with --force.")]
Force = Annotated[float | None, Option(help="Constant force (N), with --speed.")]
Deterministic = Annotated[bool, Option("--deterministic", help="Leave out the random excitation.")]
Actuator = Annotated[
    Path | None, Option(metavar="P.json", help="Profile of the actuator (.json), whose response is compensated.")
]
Gain = Annotated[
    float | None,
    Option(
        help="Output for 1 m/s², or 1 unit of drive with --actuator: share of full scale (sound), e.g. 0.02, or volts "
        "(daq)."
    ),
]
Device = Annotated[str | None, Option(help="Number or name of the sound card, as listed by 'foten devices'.")]
UserFile = Annotated[
    Path | None,
    Option("--user", metavar="U.json", help="Adapt textures to a user: profile (.json) from 'foten adapt'."),
]
Channel = Annotated[int | None, Option(min=1, help="Channel of the sound card to play on; 1 by default.")]


@dataclass(frozen=True, kw_only=True)
class StrokeOptions:
    """Options of a stroke."""

    stroke: Path | None = Option(
        None,
        metavar="S.csv",
        help="Table of the stroke: t (s), speed (mm/s) or x and y (mm), force (N) or pressure (0 to 1).",
    )
    units: Units = None
    pressure: Pressure = None
    recording_file: Path | None = Option(
        None, "--recording", metavar="REC.h5", help="Use the speed and force of a recording (.h5)."
    )
    speed: Speed = None
    force: Force = None
    seconds: float | None = Option(None, help="Duration of the stroke (s), with --speed and --force.")
    seed: int = Option(0, min=0, max=2**32 - 1, help="Seed of the random excitation.")
    as_json: JsonOption = False

    @property
    def has_stroke(self) -> bool:
        """Whether any of them is set."""
        hand = (self.speed, self.force, self.seconds)
        stroke = (self.stroke, self.units, self.pressure, self.recording_file, *hand)
        return any(option is not None for option in stroke)

    def conditions(self, texture: Texture) -> tuple[Array, Array, str]:
        """Speed [mm/s] and force [N] at a texture's rate, shapes (n,), and what the stroke is called."""
        constants = (self.speed, self.force, self.seconds)
        sources = [self.stroke is not None, self.recording_file is not None, constants != (None, None, None)]
        if sum(sources) != 1 or (sources[2] and None in constants):
            raise ValueError("expected one of --stroke, --recording, or --speed with --force and --seconds")
        if self.stroke is None:
            refuse("is for the columns of --stroke", unit=self.units, pressure=self.pressure)
        if self.recording_file is not None:
            from foten.datasets.hdf5 import load_recording

            recording = load_recording(self.recording_file)
            if recording.later_takes:
                say(f"the recording has {len(recording.takes)} takes: the stroke of the first is used{recording.named}")
            stroke, source = recorded_stroke(recording, texture.rate_hz), recording.sha256()
        elif self.stroke is not None:
            stroke = stroke_from(self.stroke, self.units, self.pressure, texture.rate_hz)
            read_as = [f"unit {unit}" for unit in self.units or ()]
            read_as += [f"pressure {self.pressure}"] if self.pressure else []
            source = ", ".join([self.stroke.name, *read_as])
        else:
            speed, force, seconds = (float(value or 0) for value in constants)
            stroke = constant_stroke(speed, force, seconds, texture.rate_hz)
            source = f"{speed:g} mm/s, {force:g} N, {seconds:g} s"
        report(stroke)
        return *stroke.conditioned(float(texture.card["lowpass_hz"])), source


def stroke_from(path: Path, units: list[str] | None, curve: str | None, rate_hz: float) -> Stroke:
    """The stroke in a table, at a rate, with `--unit` and `--pressure`."""
    from foten.datasets.importing import read_stroke
    from foten.datasets.options import parse_pairs

    calibration = None if curve is None else pressure_calibration(curve)
    return tabled_stroke(read_stroke(path, dict(parse_pairs(units or [], "--unit"))), rate_hz, calibration)


def pressure_calibration(curve: str | None) -> PressureCalibration:
    """Calibration of a tablet's pressure in `--pressure`; the paper's tablet's by default."""
    if curve is None:
        return PressureCalibration()
    try:
        a, b = map(float, curve.split(","))
    except ValueError:
        raise ValueError(f"--pressure is {curve!r}, expected a,b such as 0.13,3.32") from None
    return PressureCalibration(a, b)


def report(stroke: Stroke) -> None:
    """Say what is doubtful, bridged or taken as lifted in a stroke."""
    for doubt in stroke.doubts:
        say(doubt)
    if stroke.gap_s:
        say(f"the stroke has a gap of {stroke.gap_s:.3g} s, filled by linear interpolation")
    if stroke.n_lifted:
        say(f"gaps or jumps in the stroke: {stroke.n_lifted}; the pen is taken as lifted there, which gives silence")
