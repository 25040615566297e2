"""`foten render` and `foten play`: vibration of a texture under a stroke, into a file or live."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Exit, Option

from foten.console import JsonOption, TextureFile, check_files, options_from, print_result, refuse, say

if TYPE_CHECKING:
    from foten.dsp import Array
    from foten.editing.user import UserProfile
    from foten.models.texture_file import Texture
    from foten.runtime.live.play import ConditionAt, Played
    from foten.runtime.native import NativeInfo
    from foten.runtime.renderer import Renderer
    from foten.runtime.stroke import Stroke
    from foten.runtime.stylus import PressureCalibration

SAY_EVERY_S = 5.0  # how far a long rendering is

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
        from foten.runtime.stroke import constant_stroke, recorded_stroke

        constants = (self.speed, self.force, self.seconds)
        sources = [self.stroke is not None, self.recording_file is not None, constants != (None, None, None)]
        if sum(sources) != 1 or (sources[2] and None in constants):
            raise ValueError("expected one of --stroke, --recording, or --speed with --force and --seconds")
        if self.stroke is None:
            refuse("is for the columns of --stroke", unit=self.units, pressure=self.pressure)
        rate_hz = texture.rate_hz
        if self.recording_file is not None:
            from foten.datasets.hdf5 import load_recording

            recording = load_recording(self.recording_file)
            if recording.later_takes:
                say(f"the recording has {len(recording.takes)} takes: the stroke of the first is used{recording.named}")
            stroke, source = recorded_stroke(recording, rate_hz), recording.sha256()
        elif self.stroke is not None:
            stroke = _stroke_from(self.stroke, self.units, self.pressure, rate_hz)
            read_as = [f"unit {unit}" for unit in self.units or ()] + [f"pressure {self.pressure}"] * bool(
                self.pressure
            )
            source = ", ".join([self.stroke.name, *read_as])
        else:
            speed, force, seconds = (float(value or 0) for value in constants)
            stroke = constant_stroke(speed, force, seconds, rate_hz)
            source = f"{speed:g} mm/s, {force:g} N, {seconds:g} s"
        _report(stroke)
        return *stroke.conditioned(float(texture.card["lowpass_hz"])), source


@dataclass(frozen=True, kw_only=True)
class RenderOptions(StrokeOptions):
    """Options of `foten render`."""

    texture_file: TextureFile
    output: list[Path] = Option(
        ..., "-o", "--output", help="File to write: .wav (float, m/s²), .csv, .npz or .png (plots); repeatable."
    )
    audible: Path | None = Option(
        None, metavar="FILE.wav", help="Also write the vibration as audible sound (48 kHz, 16 bits)."
    )
    tool: Path | None = Option(
        None, metavar="TOOL.json", help="Render for another tool: file (.json) from 'foten tool measure'."
    )
    user: UserFile = None
    deterministic: Deterministic = False

    def __post_init__(self) -> None:
        if self.deterministic:
            refuse("sets the excitation, and --deterministic has none", seed=self.seed or None)


@options_from(RenderOptions)
def render(options: RenderOptions) -> None:
    """Render the vibration of a texture under a stroke, into files."""
    from foten.models.texture_file import read_texture
    from foten.runtime.live import sinks
    from foten.runtime.renderer import Renderer

    output, audible = options.output, options.audible
    for path in output:
        sinks.check_suffix(path)
    written = [*output] if audible is None else [*output, audible]
    check_files(written)
    texture = read_texture(options.texture_file)
    if options.tool is not None:
        from foten.editing.tool import read_transfer, transferred

        texture = transferred(texture, read_transfer(options.tool))
    texture = for_user(texture, options.user)
    rate = texture.rate_hz
    if audible is not None:
        sinks.audible_factor(rate)
        if audible.suffix.lower() != ".wav":
            raise ValueError(f"sound is written as .wav, got --audible {audible.name}")
    if len({os.path.realpath(path) for path in written}) < len(written):
        raise ValueError("two outputs have the same name")
    speed, force, source = options.conditions(texture)
    about = {**provenance(texture, source, options.seed, options.deterministic), "rate_hz": rate}
    renderer = Renderer(texture, seed=options.seed, excitation=not options.deterministic)
    acceleration = rendered_by(renderer, speed, force)
    for path in output:
        sinks.write_rendered(path, acceleration, speed, force, rate, about)
    counts = renderer.counted()
    gain = sinks.write_audible(audible, acceleration, rate) if audible is not None else None
    rms, peak, unit = float((acceleration**2).mean() ** 0.5), float(abs(acceleration).max()), texture.unit
    lines = [f"{acceleration.size / rate:g} s at {rate:g} Hz, {rms:.3g} {unit} rms, {peak:.3g} {unit} peak"]
    lines.append(f"wrote {', '.join(str(path) for path in output)}")
    if gain is not None:
        lines.append(f"wrote {audible}, where 1 {unit} is {gain:.3g} of full scale")
    levels = {"rms_m_s2": rms, "peak_m_s2": peak, "audible_gain": gain}
    document = {"outputs": [str(path) for path in output], **levels, **counts}
    _print_rendered(document, lines, counts, texture, options.as_json)
    if not texture.has_excitation and not options.deterministic:
        say(f"{texture.card['model']} has no excitation: its free run is deterministic and may fall silent")


@dataclass(frozen=True)
class PlayOptions:
    """Options of `foten play`."""

    texture_file: Path | None = Argument(
        None, metavar="T.foten", help="Texture file to play; by default one that comes with foten."
    )
    to: str = Option(
        "sound", help="Output: sound, FILE.wav, daq:Dev1/ao0, udp:HOST:PORT, osc:HOST:PORT, or null (no output)."
    )
    stroke: Path | None = Option(
        None,
        metavar="S.csv",
        help="Table of the stroke, as in 'foten render', played in a loop; by default a circling stroke.",
    )
    units: Units = None
    pressure: Pressure = None
    speed: Speed = None
    force: Force = None
    seconds: float | None = Option(None, min=0.0, help="Duration (s); by default until Ctrl-C, or 10 s into a file.")
    rate: float | None = Option(
        None, help="Sampling rate of the output (Hz); by default 48000 for sound, else 8000 or more."
    )
    actuator: Actuator = None
    user: UserFile = None
    gain: Gain = None
    device: Device = None
    channel: Channel = None
    lead_ms: float | None = Option(None, help="How far ahead of playback to render (ms); 10 by default.")
    seed: int = Option(0, min=0, max=2**64 - 1, help="Seed of the random excitation.")
    deterministic: Deterministic = False
    as_json: JsonOption = False

    def __post_init__(self) -> None:
        stroke, speed, force = self.stroke, self.speed, self.force
        if (speed is None) != (force is None) or (stroke is not None and speed is not None):
            raise ValueError("expected --stroke, or --speed with --force, or neither for a circling stroke")
        if stroke is None:
            refuse("is for the columns of --stroke", unit=self.units, pressure=self.pressure)
        for name, value, unit in (("speed", speed, " mm/s"), ("force", force, " N"), ("seconds", self.seconds, "")):
            if value is not None and not 0 <= value < inf:
                raise ValueError(f"--{name} is {value}{unit}, expected a finite number, 0 or more")
        if self.into_file:
            of_live = {"device": self.device, "channel": self.channel, "lead_ms": self.lead_ms}
            refuse(f"is for live output, and {self.to} is a file", **of_live)
        if self.deterministic:
            refuse("sets the excitation, and --deterministic has none", seed=self.seed or None)

    @property
    def into_file(self) -> bool:
        """Whether it is written to a file."""
        return self.to.lower().endswith(".wav")

    def conditions(self, texture: Texture, info: NativeInfo) -> tuple[ConditionAt, str]:
        """Speed and force from sample to sample, and what the stroke is called."""
        from foten.runtime.live.play import along, circling, holding
        from foten.runtime.stroke import doubts_of

        if self.stroke is not None:
            stroke = _stroke_from(self.stroke, self.units, self.pressure, texture.rate_hz)
            _report(stroke)
            return along(stroke, info.lowpass_hz), self.stroke.name
        if self.speed is not None and self.force is not None:
            for doubt in (*doubts_of("speed", self.speed), *doubts_of("force", self.force)):
                say(doubt)
            return holding(self.speed, self.force), f"{self.speed:g} mm/s, {self.force:g} N"
        return circling(info.trained_speed, info.trained_force, texture.rate_hz), "a circle"


@options_from(PlayOptions)
def play(options: PlayOptions) -> None:
    """Play a texture live: to the sound card, a file, an NI-DAQ or another program."""
    from foten.models.texture_file import read_texture
    from foten.runtime.actuator import read_profile
    from foten.runtime.live.live import LEAD_MS
    from foten.runtime.live.play import gain_for, rate_for, sink_of
    from foten.runtime.live.play import play as play_live
    from foten.runtime.renderer import EXAMPLE, Renderer

    texture_file, to, seconds = options.texture_file or EXAMPLE, options.to, options.seconds
    profile = read_profile(options.actuator) if options.actuator is not None else None
    texture = for_user(read_texture(texture_file), options.user, options.actuator)
    rate, excitation = rate_for(to, options.rate, texture.rate_hz), not options.deterministic
    renderer = Renderer(texture, rate, options.seed, excitation=excitation, actuator=profile)
    info = renderer.native_texture.info
    conditions, source = options.conditions(texture, info)
    scale = gain_for(profile, options.gain, info.acceleration_sd, to)
    about = provenance(texture, source, options.seed, options.deterministic)
    if profile is not None:
        about |= {"actuator": asdict(profile), "unit": profile.unit}
    if options.into_file:
        _write_played(options, texture, renderer, conditions, about)
        return
    sink = sink_of(to, renderer.rate, scale, options.device, options.channel)

    def on_start() -> None:
        name, long = info.texture or texture_file.name, "" if seconds is None else f" for {seconds:g} s"
        say(f"playing {name} to {to} at {renderer.rate:g} Hz{long}; Ctrl-C stops it")

    lead_ms = LEAD_MS if options.lead_ms is None else options.lead_ms
    played = play_live(renderer, sink, conditions, seconds, lead_ms, on_start)
    document = {**_document_of(played), "gain": scale, **played.counted}
    _print_rendered(document, _lines_of(played, lead_ms, scale), played.counted, texture, options.as_json)
    if played.interrupted:
        raise Exit(130)


def _write_played(
    options: PlayOptions, texture: Texture, renderer: Renderer, conditions: ConditionAt, about: dict[str, Any]
) -> None:
    from foten.runtime.live.play import write_wav

    path, seconds = Path(options.to), 10.0 if options.seconds is None else options.seconds
    check_files([path])
    samples, interrupted = write_wav(renderer, conditions, seconds, path, about)
    counts = renderer.counted()
    document = {"output": str(path), "n_samples": samples.size, "interrupted": interrupted, **counts}
    line = f"wrote {path}, {samples.size / renderer.rate:g} s at {renderer.rate:g} Hz"
    _print_rendered(document, [line], counts, texture, options.as_json)
    if interrupted:
        raise Exit(130)


def _document_of(played: Played) -> dict[str, Any]:
    """What was played, for programs."""
    statistics, of_run = vars(played.statistics), vars(played)
    block, min_ms = played.statistics.block, played.statistics.min_ms
    percentiles = (("50", 50), ("99", 99), ("999", 99.9))
    return {
        **{name: value for name, value in statistics.items() if name not in ("block", "min_ms")},
        **{f"block_p{name}_ms": 1000 * block.percentile_s(percent) for name, percent in percentiles},
        "block_largest_ms": 1000 * block.largest_s,
        "ring_min_ms": min_ms if min_ms < inf else None,
        **{name: value for name, value in of_run.items() if name not in ("statistics", "counted")},
    }


def _lines_of(played: Played, lead_ms: float, scale: float) -> list[str]:
    """What was played, for people, and what to do where something went wrong."""
    from foten.recording.recording import counted

    statistics = played.statistics
    delays = ", ".join(f"{ms:.1f} ms {name}" for name, ms in played.delays_ms.items())
    lines = [statistics.line(), f"delay from stroke to output: {delays}"]
    if n := played.counted["n_limited"]:
        lines.append(f"the actuator's limit compressed {counted(n, 'sample')}")
    if n := statistics.n_underruns:
        silence = f"{counted(statistics.n_lacking, 'sample')} of silence"
        lines.append(f"the buffer ran empty {counted(n, 'time')}, {silence}; a longer --lead-ms than {lead_ms:g} helps")
    if n := played.n_device_underruns:
        busy = "this machine is busy with other work"
        lines.append(f"the sound card got its samples too late {counted(n, 'time')}, whatever the buffer held: {busy}")
    if n := played.n_late:
        lines.append(f"this machine stalled for {counted(n, 'block')} of the output, which were skipped")
    if n := played.n_cut:
        lines.append(f"clipped at full scale: {counted(n, 'sample')}; a smaller --gain than {scale:.3g} avoids this")
    return lines


def for_user(texture: Texture, user: Path | None, actuator: Path | None = None) -> Texture:
    """The texture as a user's profile has it; as it is without one."""
    if user is None:
        return texture
    from foten.editing.user import adapted

    return adapted(texture, user_with(user, actuator))


def user_with(user: Path, actuator: Path | None) -> UserProfile:
    """The profile in a file, or ValueError where it holds the response of an actuator that is compensated as well."""
    from foten.editing.user import read_user

    profile = read_user(user)
    if actuator is not None and profile.unit == "full scale":
        raise ValueError(
            f"{user} was measured without --actuator, so it holds the actuator's response: leave out --user or --actuator"
        )
    return profile


def provenance(texture: Texture, source: str, seed: int, deterministic: bool) -> dict[str, Any]:
    """Origin of a rendering, for the file that it is written to."""
    from foten import __version__

    return {
        "foten": __version__,
        "texture": texture.card["texture"],
        "texture_sha256": texture.sha256(),
        **({"credit": texture.credit} if texture.credit else {}),
        **({"made": texture.evidence} if texture.evidence else {}),
        "stroke": source,
        "seed": seed,
        "deterministic": deterministic,
    }


def _stroke_from(path: Path, units: list[str] | None, curve: str | None, rate_hz: float) -> Stroke:
    from foten.datasets.importing import read_stroke
    from foten.datasets.options import parse_pairs
    from foten.runtime.stroke import tabled_stroke

    calibration = None if curve is None else pressure_calibration(curve)
    return tabled_stroke(read_stroke(path, dict(parse_pairs(units or [], "--unit"))), rate_hz, calibration)


def pressure_calibration(curve: str | None) -> PressureCalibration:
    """Calibration of a tablet's pressure in `--pressure`; the paper's tablet's by default."""
    from foten.runtime.stylus import PressureCalibration

    if curve is None:
        return PressureCalibration()
    try:
        a, b = map(float, curve.split(","))
    except ValueError:
        raise ValueError(f"--pressure is {curve!r}, expected a,b such as 0.13,3.32") from None
    return PressureCalibration(a, b)


def rendered_by(renderer: Renderer, speed: Array, force: Array) -> Array:
    """Acceleration [m/s²] under a stroke, second by second, so that Ctrl-C ends it, with progress where it takes long."""
    import numpy as np

    second = max(1, round(renderer.texture_rate))
    pieces, shown_s = [], time.monotonic()
    for start in range(0, speed.size, second):
        if time.monotonic() - shown_s >= SAY_EVERY_S:
            shown_s = time.monotonic()
            say(f"rendered {start / renderer.texture_rate:.0f} of {speed.size / renderer.texture_rate:.0f} s")
        pieces.append(renderer.render(speed[start : start + second], force[start : start + second]))
    return np.concatenate(pieces).astype(float)


def _report(stroke: Stroke) -> None:
    """Say what is doubtful, bridged or taken as lifted in a stroke."""
    for doubt in stroke.doubts:
        say(doubt)
    if stroke.gap_s:
        say(f"the stroke has a gap of {stroke.gap_s:.3g} s, filled by linear interpolation")
    if stroke.n_lifted:
        say(f"gaps or jumps in the stroke: {stroke.n_lifted}; the pen is taken as lifted there, which gives silence")


def _print_rendered(
    document: dict[str, Any], lines: list[str], counts: dict[str, int], texture: Texture, as_json: bool
) -> None:
    """Print a result, with how much of it lay outside of the recorded range, and say what the kernel found wrong."""
    from foten.recording.recording import counted

    print_result(document, "\n".join([*lines, *_outside_range(counts, texture)]), as_json)
    if n := counts["n_saturated"]:
        say(f"the saturator cut {counted(n, 'sample')}: the closed loop was unstable there")
    if n := counts["n_refused"]:
        say(f"speed or force was negative or not a number {counted(n, 'time')}: 0 or the value before was used")
    if n := counts["n_lost"]:
        say(f"silence in place of {counted(n, 'sample')} that were not finite; was the texture file written by foten?")


def _outside_range(counts: dict[str, int], texture: Texture) -> Iterator[str]:
    """How much of a rendering lay outside of the recorded range, and what was done there."""
    from foten.models.conditions import EXTRAPOLATION_LIMIT, FADE_FORCE, FADE_SPEED, REACH_FORCE, REACH_SPEED

    share = {name: f"{100 * count / counts['n']:.1f} %" for name, count in counts.items() if count}
    for name, unit, reach in (("speed", "mm/s", REACH_SPEED), ("force", "N", REACH_FORCE)):
        if of_time := share.get(f"n_{name}_beyond"):
            high, power = texture.trained_range(name)[1], texture.extrapolation_exponent(name)
            grown = f"the level grew as {name}^{power:.2g} there" if power else "the level was held there"
            yield f"{name} was above the trained {high:.4g} {unit} for {of_time} of the time; {grown}"
        if of_time := share.get(f"n_{name}_clamped"):
            limit = max(EXTRAPOLATION_LIMIT * texture.trained_range(name)[1], reach)
            yield f"{name} was above {limit:.4g} {unit} for {of_time} of the time, and was limited to that"
    if of_time := share.get("n_below"):
        slow = max(texture.trained_range("speed")[0], FADE_SPEED)
        light = max(texture.trained_range("force")[0], FADE_FORCE)
        below = f"speed was below {slow:.4g} mm/s or force below {light:.3g} N for {of_time} of the time"
        held = (texture.fades_below("speed"), texture.fades_below("force")) == (slow, light)
        fades = "the vibration fades there" if held else f"the level falls there, and fades {texture.fading_in_words()}"
        yield f"{below}; {fades}, to silence at rest"
