"""`foten render`; its last three functions serve `foten play` too."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from foten.cli.console import JsonOption, TextureFile, check_folders, print_json, say

if TYPE_CHECKING:
    from foten.families.texture_file import Texture
    from foten.runtime.stroke import Stroke


def render(
    texture_file: TextureFile,
    output: Annotated[list[Path], Option("-o", "--output", help=".wav (float, m/s²), .csv, .npz or .png; repeatable.")],
    stroke: Annotated[
        Path | None,
        Option(metavar="S.csv", help="Header t (s), speed (mm/s) or x, y (mm), force (N) or pressure (0 to 1)."),
    ] = None,
    recording_file: Annotated[
        Path | None, Option("--recording", metavar="REC.h5", help="Take the hand of a recording.")
    ] = None,
    speed: Annotated[float | None, Option(help="Constant speed (mm/s).")] = None,
    force: Annotated[float | None, Option(help="Constant force (N).")] = None,
    seconds: Annotated[float | None, Option(help="How long, with --speed and --force (s).")] = None,
    audible: Annotated[Path | None, Option(metavar="FILE.wav", help="Also as sound, 48 kHz, 16 bits.")] = None,
    seed: Annotated[int, Option(min=0, max=2**32 - 1, help="Of the excitation.")] = 0,
    deterministic: Annotated[bool, Option("--deterministic", help="Without excitation.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Render vibration from a texture and a stroke."""
    from foten.families.texture_file import read_texture
    from foten.runtime.live import sinks
    from foten.runtime.renderer import Renderer
    from foten.runtime.stroke import constant_stroke, read_stroke, recorded_stroke

    for path in output:
        sinks.check_suffix(path)
    written = [*output] if audible is None else [*output, audible]
    check_folders(written)
    texture = read_texture(texture_file)
    rate = texture.rate_hz
    if audible is not None:
        sinks.audible_factor(rate)
        if audible.suffix.lower() != ".wav":
            raise ValueError(f"sound is written as .wav, got --audible {audible.name}")
    if len({os.path.realpath(path) for path in written}) < len(written):
        raise ValueError("two outputs have the same name")
    constants = (speed, force, seconds)
    sources = [stroke is not None, recording_file is not None, any(value is not None for value in constants)]
    if sum(sources) != 1 or (sources[2] and None in constants):
        raise ValueError("expected one of --stroke, --recording, or --speed with --force and --seconds")
    if recording_file is not None:
        from foten.datasets.hdf5 import load_recording

        recording = load_recording(recording_file)
        rendered_stroke, source = recorded_stroke(recording, rate), recording.sha256()
    elif stroke is not None:
        rendered_stroke, source = read_stroke(stroke, rate), stroke.name
    else:
        rendered_stroke = constant_stroke(float(speed or 0), float(force or 0), float(seconds or 0), rate)
        source = f"{speed:g} mm/s, {force:g} N, {seconds:g} s"
    report_gaps(rendered_stroke)
    conditions = rendered_stroke.conditioned(float(texture.card["lowpass_hz"]))
    about = {**provenance(texture, source, seed, deterministic), "rate_hz": rate}
    renderer = Renderer(texture, seed=seed, excitation=not deterministic)
    acceleration = renderer.render(*conditions).astype(float)
    for path in output:
        sinks.write_rendered(path, acceleration, *conditions, rate, about)
    statistics = renderer.counted()
    gain = sinks.write_audible(audible, acceleration, rate) if audible is not None else None
    rms, peak = float((acceleration**2).mean() ** 0.5), float(abs(acceleration).max())
    if as_json:
        levels = {"rms_m_s2": rms, "peak_m_s2": peak, "audible_gain": gain}
        print_json({"outputs": [str(path) for path in output], **levels, **statistics})
        return
    print(f"{acceleration.size / rate:g} s at {rate:g} Hz, {rms:.3g} m/s² rms, {peak:.3g} m/s² peak")
    print(f"wrote {', '.join(str(path) for path in output)}")
    if gain is not None:
        print(f"wrote {audible}, where 1 m/s² is {gain:.3g} of full scale")
    print_outside_range(statistics, texture)
    if not texture.has_excitation and not deterministic:
        say(f"{texture.card['model']} carries no excitation, so the loop is deterministic and may fall silent")


def provenance(texture: Texture, source: str, seed: int, deterministic: bool) -> dict[str, Any]:
    """Return what made a rendering, as it is kept in the file that it is written to."""
    from foten import __version__

    return {
        "foten": __version__,
        "texture": texture.card["texture"],
        "texture_sha256": texture.sha256(),
        "stroke": source,
        "seed": seed,
        "deterministic": deterministic,
    }


def report_gaps(stroke: Stroke) -> None:
    """Say where a stroke had to be bridged, or the pen was taken as lifted."""
    if stroke.gap_s:
        say(f"the stroke has a hole of {stroke.gap_s:.3g} s, bridged in a straight line")
    if stroke.n_lifted:
        say(f"the pen was taken as lifted in holes or jumps of the stroke, {stroke.n_lifted} in all: silence there")


def print_outside_range(statistics: dict[str, int], texture: Texture) -> None:
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
        say(f"the saturator cut {statistics['n_saturated']} samples: the loop ran away there")
    if statistics["n_refused"]:
        say(f"the hand was negative or no number {statistics['n_refused']} times, taken as 0 or as it was before")
    if statistics["n_lost"]:
        say(f"{statistics['n_lost']} samples were no numbers, and silence instead; is the file foten's own?")
