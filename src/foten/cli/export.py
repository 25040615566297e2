"""`foten export`: a texture, or a stroke of it, in the formats of other worlds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from foten.cli.console import JsonOption, TextureFile, check_folders, print_result
from foten.cli.render import (
    ConstantForce,
    ConstantSpeed,
    HandOfRecording,
    Seconds,
    Seed,
    StrokeUnits,
    provenance,
    rendered_by,
    stroke_given,
)

if TYPE_CHECKING:
    from foten.export.clip import Clip
    from foten.families.texture_file import Texture

SUFFIXES = {
    ".ahap": "ahap",
    ".haptic": "haptic",
    ".hjif": "hjif",
    ".json": "android",
    ".h": "c",
    ".onnx": "onnx",
    ".wav": "wav",
    ".csv": "csv",
    ".npz": "npz",
}
"""The format that a name has."""
CLIPS = ("wav", "csv", "npz", "ahap", "haptic", "hjif", "hjif-parametric", "android")
WHOLE = ("c", "onnx", "web", "unity")


def export(
    texture_file: TextureFile,
    output: Annotated[Path, Option("-o", "--output", help="File to write; a folder for web and unity.")],
    to: Annotated[
        str | None,
        Option(
            help="A clip of one stroke: wav (driven, 48 kHz, 16 bits), csv, npz, ahap (Apple), haptic (Meta), hjif or "
            "hjif-parametric (MPEG), android. The texture itself: c (a header), onnx (its one-step network), web (the page of "
            "'foten serve' as files), unity (a package for it). By the output's name where that says it."
        ),
    ] = None,
    stroke: Annotated[
        Path | None, Option(metavar="S.csv", help="As of 'foten render', a stroke that the page recorded for example.")
    ] = None,
    units: StrokeUnits = None,
    recording_file: HandOfRecording = None,
    speed: ConstantSpeed = None,
    force: ConstantForce = None,
    seconds: Seconds = None,
    full_scale: Annotated[
        float | None, Option(help="m/s² that is 1 in the clip, for clips that are to compare; by default its peak.")
    ] = None,
    actuator: Annotated[Path | None, Option(metavar="P.json", help="Profile of the actuator that is driven.")] = None,
    seed: Seed = 0,
    as_json: JsonOption = False,
) -> None:
    """Write a texture, or a stroke of it, in another format.

    foten export denim.foten --speed 80 --force 0.8 --seconds 2 -o denim.ahap

    foten export denim.foten --to web -o site
    """
    from foten.families.texture_file import read_texture

    kind = to or SUFFIXES.get(output.suffix.lower())
    if kind is None or kind not in (*CLIPS, *WHOLE):
        what = f"--to {to}" if to else f"the name {output.name}"
        raise ValueError(f"{what} is no format, expected --to {', '.join((*CLIPS, *WHOLE))}")
    check_folders([output])
    texture = read_texture(texture_file)
    given = (stroke, units, recording_file, speed, force, seconds, full_scale, actuator)
    if kind in WHOLE:
        if any(option is not None for option in given):
            raise ValueError(f"{kind} holds the texture itself: leave out the stroke and its options")
        document, keeps = _WHOLE[kind](texture, texture_file, output)
    else:
        clip = _clip(texture, given, seed)
        keeps = _write_clip(kind, clip, output)
        document = {"seconds": clip.duration_s, "rate_hz": clip.rate_hz, "full_scale": clip.full_scale}
        keeps = f"{clip.duration_s:g} s, 1 is {clip.full_scale:.3g} {clip.about['unit']}; {keeps}"
    print_result({"output": str(output), "format": kind, **document}, f"wrote {output}: {keeps}", as_json)


def _clip(texture: Texture, given: tuple[Any, ...], seed: int) -> Clip:
    from foten.export.clip import RATE_HZ, clip_of
    from foten.runtime.actuator import read_profile
    from foten.runtime.renderer import Renderer

    stroke, units, recording_file, speed, force, seconds, full_scale, actuator = given
    if all(option is None for option in (stroke, recording_file, speed, force, seconds)):
        speed, force, seconds = 80.0, 0.8, 2.0
    taken, source = stroke_given(stroke, units, recording_file, speed, force, seconds, texture.rate_hz)
    profile = None if actuator is None else read_profile(actuator)
    renderer = Renderer(texture, rate=max(RATE_HZ, texture.rate_hz), seed=seed, actuator=profile)
    samples = rendered_by(renderer, *taken.conditioned(float(texture.card["lowpass_hz"])))
    about = {**provenance(texture, source, seed, False), "unit": "m/s²" if profile is None else profile.unit}
    return clip_of(samples.astype(float), renderer.rate, about, full_scale)


def _write_clip(kind: str, clip: Clip, output: Path) -> str:
    """Write a clip and return what its format keeps."""
    from foten.export import ahap, android, haptic, hjif, samples

    writers: dict[str, tuple[Callable[[Clip, Path], None], str]] = {
        "ahap": (ahap.write_ahap, ahap.KEEPS),
        "haptic": (haptic.write_haptic, haptic.KEEPS),
        "hjif": (hjif.write_hjif, hjif.KEEPS),
        "hjif-parametric": (lambda clip, path: hjif.write_hjif(clip, path, parametric=True), hjif.KEEPS_PARAMETRIC),
        "android": (android.write_android, android.KEEPS),
        "wav": (samples.write_wav, samples.KEEPS_WAV),
        "csv": (samples.write_csv, samples.KEEPS),
        "npz": (samples.write_npz, samples.KEEPS),
    }
    write, keeps = writers[kind]
    write(clip, output)
    return keeps


def _write_header(texture: Texture, _file: Path, output: Path) -> tuple[dict[str, Any], str]:
    from foten.export import c_header

    name = c_header.write_c_header(texture, output)
    return {"name": name}, f"{name}, {output.stat().st_size / 1e3:.0f} kB of text; {c_header.KEEPS}"


def _write_onnx(texture: Texture, _file: Path, output: Path) -> tuple[dict[str, Any], str]:
    from foten.export import onnx
    from foten.train.export import graph_of_texture

    onnx.write_onnx(texture, graph_of_texture(texture), output)
    return {}, onnx.KEEPS


def _write_site(_texture: Texture, file: Path, output: Path) -> tuple[dict[str, Any], str]:
    from foten.export import web
    from foten.studio.server import page_files
    from foten.studio.shelf import Shelf

    shelf = Shelf([file])
    web.write_site(page_files(), shelf.listed(), shelf.files(), output)
    return {}, f"{web.KEEPS}; put the folder on any host, and open it by HTTPS"


def _write_unity(texture: Texture, _file: Path, output: Path) -> tuple[dict[str, Any], str]:
    from foten.export import unity

    name = unity.write_unity(texture, output)
    return {"name": name}, f"{name}; {unity.KEEPS}; put the folder into the Packages of a project"


_WHOLE = {"c": _write_header, "onnx": _write_onnx, "web": _write_site, "unity": _write_unity}
