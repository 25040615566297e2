"""`foten play`."""

from __future__ import annotations

import dataclasses
from math import inf
from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option

from foten.cli.console import JsonOption, print_json, say
from foten.cli.render import print_outside_range, provenance, report_gaps


def play(
    texture_file: Annotated[
        Path | None, Argument(metavar="T.foten", help="A texture file; by default one that comes with foten.")
    ] = None,
    to: Annotated[str, Option(help="sound, null, FILE.wav, daq:Dev1/ao0, udp:HOST:PORT or osc:HOST:PORT.")] = "sound",
    stroke: Annotated[
        Path | None,
        Option(metavar="S.csv", help="As of 'foten render', over and over, without a pause; by default a circle."),
    ] = None,
    speed: Annotated[float | None, Option(help="Constant speed (mm/s), with --force.")] = None,
    force: Annotated[float | None, Option(help="Constant force (N), with --speed.")] = None,
    seconds: Annotated[
        float | None, Option(min=0.0, help="How long (s); by default until Ctrl-C, and 10 s into a file.")
    ] = None,
    rate: Annotated[
        float | None, Option(help="Of the output (Hz); by default 48000 for sound, else 8000 or more.")
    ] = None,
    actuator: Annotated[Path | None, Option(metavar="P.json", help="Profile of the actuator that is driven.")] = None,
    gain: Annotated[
        float | None,
        Option(help="Full scale (sound) or volts (daq) for 1 m/s², or for 1 of the actuator's drive; of these alone."),
    ] = None,
    device: Annotated[
        str | None, Option(help="Number or name of the sound card, as 'python -m sounddevice' lists them.")
    ] = None,
    channel: Annotated[
        int | None, Option(min=0, help="Of the sound card that is played on, from 0; 0 by default.")
    ] = None,
    lead_ms: Annotated[float | None, Option(help="Rendered ahead of what is heard (ms); 10 by default.")] = None,
    seed: Annotated[int, Option(min=0, help="Of the excitation.")] = 0,
    deterministic: Annotated[bool, Option("--deterministic", help="Without excitation.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Play a texture live: to the sound card, a file, an NI-DAQ or another program."""
    from foten.families.texture_file import read_texture
    from foten.runtime.actuator import read_profile
    from foten.runtime.live.live import LEAD_MS
    from foten.runtime.live.play import along, circling, gain_for, holding, rate_for, sink_of
    from foten.runtime.live.play import play as play_live
    from foten.runtime.renderer import EXAMPLE, Renderer
    from foten.runtime.stroke import read_stroke

    texture_file = texture_file or EXAMPLE
    if (speed is None) != (force is None) or (stroke is not None and speed is not None):
        raise ValueError("expected --stroke, or --speed with --force, or neither for a circle")
    if seconds is not None and not 0 <= seconds < inf:
        raise ValueError(f"--seconds is {seconds}, expected a finite number, 0 or more")
    profile = read_profile(actuator) if actuator is not None else None
    texture = read_texture(texture_file)
    own = texture.rate_hz
    renderer = Renderer(texture, rate_for(to, rate, own), seed, excitation=not deterministic, actuator=profile)
    info = renderer.native_texture.info
    if stroke is not None:
        looped_stroke = read_stroke(stroke, own)
        report_gaps(looped_stroke)
        conditions, source = along(looped_stroke, info.lowpass_hz), stroke.name
    elif speed is not None and force is not None:
        for name, value, unit in (("speed", speed, "mm/s"), ("force", force, "N")):
            if not 0 <= value < inf:
                raise ValueError(f"--{name} is {value} {unit}, expected a finite number, 0 or more")
        conditions, source = holding(speed, force), f"{speed:g} mm/s, {force:g} N"
    else:
        conditions, source = circling(info.trained_speed, info.trained_force, own), "a circle"
    scale = gain_for(profile, gain, info.acceleration_sd, to)
    about = provenance(texture, source, seed, deterministic)
    if profile is not None:
        about |= {"actuator": dataclasses.asdict(profile), "unit": profile.unit}
    if seconds is None and to.lower().endswith(".wav"):
        seconds = 10.0
    sink = sink_of(to, renderer.rate, scale, seconds, device, channel, about)

    def on_start() -> None:
        name, long = info.texture or texture_file.name, "" if seconds is None else f" for {seconds:g} s"
        say(f"{name} to {to} at {renderer.rate:g} Hz{long}; Ctrl-C ends it")

    lead_ms = LEAD_MS if lead_ms is None else lead_ms
    played = play_live(renderer, sink, conditions, seconds, lead_ms, on_start)
    statistics, counted = played.statistics, played.counted
    if as_json:
        block_ms = {
            f"block_p{name}_ms": 1000 * statistics.block.percentile_s(percent)
            for name, percent in (("50", 50), ("99", 99), ("999", 99.9))
        }
        print_json(
            {
                "n_samples": statistics.n_samples,
                "block_ms": statistics.block_ms,
                **block_ms,
                "block_largest_ms": 1000 * statistics.block.largest_s,
                "n_missed": statistics.n_missed,
                "n_underruns": statistics.n_underruns,
                "n_lacking": statistics.n_lacking,
                "ring_least_ms": statistics.least_ms if statistics.least_ms < inf else None,
                "gain": scale,
                **{name: value for name, value in vars(played).items() if name not in ("statistics", "counted")},
                **counted,
            }
        )
    else:
        print(statistics.line())
        delays = ", ".join(f"{ms:.1f} ms {name}" for name, ms in played.delays_ms.items())
        print(f"delay from hand to output: {delays}")
        print_outside_range(counted, texture)
        if n := counted["n_limited"]:
            print(f"the actuator's limit bent {n} samples")
        if n := statistics.n_underruns:
            silence = f"{statistics.n_lacking} samples of silence"
            print(f"the ring ran empty {n} times, {silence}; a longer --lead-ms than {lead_ms:g} helps")
        if n := played.n_device_underruns:
            busy = "this machine is busy with something else"
            print(f"the sound card got its samples too late {n} times, whatever the ring held: {busy}")
        if n := played.n_late:
            print(f"this machine stood still for {n} blocks of the sink, which were not made up for")
        if n := played.n_cut:
            print(f"{n} samples were beyond full scale and cut; a smaller --gain than {scale:.3g} keeps them")
    if played.interrupted:
        raise Exit(130)
