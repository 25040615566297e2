"""`foten play`: vibration of a texture under a stroke, live."""

from dataclasses import asdict, dataclass
from math import inf
from pathlib import Path
from typing import Any

from typer import Argument, Exit, Option

from foten.cli import stroke_options
from foten.cli.render import for_user, print_rendered, provenance
from foten.console import JsonOption, check_files, options_from, refuse, say
from foten.models.texture_file import Texture, read_texture
from foten.recording.recording import counted
from foten.runtime.actuator import read_profile
from foten.runtime.live import play as playing
from foten.runtime.live.live import LEAD_MS
from foten.runtime.native import NativeInfo
from foten.runtime.renderer import EXAMPLE, Renderer
from foten.runtime.stroke import doubts_of


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
        help="Table of the stroke, as in 'foten render', played in a loop; by default a playing.circling stroke.",
    )
    units: stroke_options.Units = None
    pressure: stroke_options.Pressure = None
    speed: stroke_options.Speed = None
    force: stroke_options.Force = None
    seconds: float | None = Option(None, min=0.0, help="Duration (s); by default until Ctrl-C, or 10 s into a file.")
    rate: float | None = Option(
        None, help="Sampling rate of the output (Hz); by default 48000 for sound, else 8000 or more."
    )
    actuator: stroke_options.Actuator = None
    user: stroke_options.UserFile = None
    gain: stroke_options.Gain = None
    device: stroke_options.Device = None
    channel: stroke_options.Channel = None
    lead_ms: float | None = Option(None, help="How far ahead of playback to render (ms); 10 by default.")
    seed: int = Option(0, min=0, max=2**64 - 1, help="Seed of the random excitation.")
    deterministic: stroke_options.Deterministic = False
    as_json: JsonOption = False

    def __post_init__(self) -> None:
        stroke, speed, force = self.stroke, self.speed, self.force
        if (speed is None) != (force is None) or (stroke is not None and speed is not None):
            raise ValueError("expected --stroke, or --speed with --force, or neither for a playing.circling stroke")
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

    def conditions(self, texture: Texture, info: NativeInfo) -> tuple[playing.ConditionAt, str]:
        """Speed and force from sample to sample, and what the stroke is called."""
        if self.stroke is not None:
            stroke = stroke_options.stroke_from(self.stroke, self.units, self.pressure, texture.rate_hz)
            stroke_options.report(stroke)
            return playing.along(stroke, info.lowpass_hz), self.stroke.name
        if self.speed is not None and self.force is not None:
            for doubt in (*doubts_of("speed", self.speed), *doubts_of("force", self.force)):
                say(doubt)
            return playing.holding(self.speed, self.force), f"{self.speed:g} mm/s, {self.force:g} N"
        return playing.circling(info.trained_speed, info.trained_force, texture.rate_hz), "a circle"


@options_from(PlayOptions)
def play(options: PlayOptions) -> None:
    """Play a texture live: to the sound card, a file, an NI-DAQ or another program."""
    texture_file, to, seconds = options.texture_file or EXAMPLE, options.to, options.seconds
    profile = read_profile(options.actuator) if options.actuator is not None else None
    texture = for_user(read_texture(texture_file), options.user, options.actuator)
    rate, excitation = playing.rate_for(to, options.rate, texture.rate_hz), not options.deterministic
    renderer = Renderer(texture, rate, options.seed, excitation=excitation, actuator=profile)
    info = renderer.native_texture.info
    conditions, source = options.conditions(texture, info)
    scale = playing.gain_for(profile, options.gain, info.acceleration_sd, to)
    if options.into_file:
        metadata = provenance(texture, source, options.seed, options.deterministic)
        if profile is not None:
            metadata |= {"actuator": asdict(profile), "unit": profile.unit}
        document, lines, interrupted = _write_played(options, renderer, conditions, metadata)
        counts = renderer.counted()
    else:
        sink = playing.sink_of(to, renderer.rate, scale, options.device, options.channel)

        def on_start() -> None:
            name, long = info.texture or texture_file.name, "" if seconds is None else f" for {seconds:g} s"
            say(f"playing {name} to {to} at {renderer.rate:g} Hz{long}; Ctrl-C stops it")

        lead_ms = LEAD_MS if options.lead_ms is None else options.lead_ms
        played = playing.play(renderer, sink, conditions, seconds, lead_ms, on_start)
        interrupted, counts = played.interrupted, played.counted
        document, lines = {**_document_of(played), "gain": scale}, _lines_of(played, lead_ms, scale)
    print_rendered(document, lines, counts, texture, options.as_json)
    if interrupted:
        raise Exit(130)


def _write_played(
    options: PlayOptions, renderer: Renderer, conditions: playing.ConditionAt, metadata: dict[str, Any]
) -> tuple[dict[str, Any], list[str], bool]:
    """What was written to a file, for programs and for people, and whether Ctrl-C ended it."""
    path, seconds = Path(options.to), 10.0 if options.seconds is None else options.seconds
    check_files([path])
    samples, interrupted = playing.write_wav(renderer, conditions, seconds, path, metadata)
    document = {"output": str(path), "n_samples": samples.size, "interrupted": interrupted}
    return document, [f"wrote {path}, {samples.size / renderer.rate:g} s at {renderer.rate:g} Hz"], interrupted


def _document_of(played: playing.Played) -> dict[str, Any]:
    """What was played, for programs."""
    document = {**vars(played.statistics), **vars(played)}
    for name in ("statistics", "counted", "block"):
        del document[name]
    block, min_ms = played.statistics.block, document.pop("min_ms")
    document |= {
        f"block_p{name}_ms": 1000 * block.percentile_s(p) for name, p in (("50", 50), ("99", 99), ("999", 99.9))
    }
    return document | {"block_largest_ms": 1000 * block.largest_s, "ring_min_ms": min_ms if min_ms < inf else None}


def _lines_of(played: playing.Played, lead_ms: float, scale: float) -> list[str]:
    """What was played, for people, and what to do where something went wrong."""
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
