"""`foten export`: a texture, or its vibration under one stroke, in other formats."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from typer import Argument, Option

from foten.cli.render import provenance, rendered_by
from foten.cli.stroke_options import Actuator, StrokeOptions
from foten.console import check_files, check_folder, options_from, print_result
from foten.export import ahap, android, c_header, haptic, hjif, onnx, samples, unity, web
from foten.export.clip import RATE_HZ, Clip, clip_of
from foten.models.texture_file import Texture, read_texture
from foten.recording.recording import RELATIVE, counted
from foten.runtime.actuator import read_profile
from foten.runtime.renderer import Renderer
from foten.studio.page_files import page_files
from foten.studio.shelf import Shelf

CLIPS: dict[str, tuple[Callable[[Clip, Path], None], str]] = {
    "wav": (samples.write_wav, samples.KEEPS_WAV),
    "csv": (samples.write_csv, samples.KEEPS),
    "npz": (samples.write_npz, samples.KEEPS),
    "ahap": (ahap.write_ahap, ahap.KEEPS),
    "haptic": (haptic.write_haptic, haptic.KEEPS),
    "hjif": (hjif.write_hjif, hjif.KEEPS),
    "hjif-parametric": (partial(hjif.write_hjif, parametric=True), hjif.KEEPS_PARAMETRIC),
    "android": (android.write_android, android.KEEPS),
}
"""Writer of each format of a clip, and what it keeps."""
FOLDERS = ("web", "unity")  # which are made with the folders above them
TEXTURES = ("c", "onnx", *FOLDERS)
SUFFIXES = {f".{name}": name for name in (*CLIPS, "onnx")} | {".json": "android", ".h": "c"}
"""The format that a name has."""


@dataclass(frozen=True, kw_only=True)
class ExportOptions(StrokeOptions):
    """Options of `foten export`."""

    output: Path = Option(..., "-o", "--output", help="File to write, e.g. denim.ahap; a folder for web and unity.")
    texture_files: list[Path] | None = Argument(
        None,
        metavar="[T.foten]…",
        help="Texture file; for web any number of files or folders, by default the textures that come with foten.",
    )
    to: str | None = Option(
        None,
        help="Format, by default that of the output's suffix. Clip of one stroke: wav (peak 1, 48 kHz, 16 bits), csv, "
        "npz, ahap (Apple), haptic (Meta), hjif or hjif-parametric (MPEG), android. Texture itself: c (header), "
        "onnx (one-step network), unity (package). Several textures: web (the page of 'foten serve' as files).",
    )
    full_scale: float | None = Option(
        None, help="Acceleration that becomes 1 in the clip (m/s²); by default the clip's peak."
    )
    actuator: Actuator = None

    def __post_init__(self) -> None:
        kind = self.kind
        if kind not in (*CLIPS, *TEXTURES):
            what = f"--to {self.to}" if self.to else f"the name {self.output.name}"
            raise ValueError(f"{what} gives no known format, expected --to {', '.join((*CLIPS, *TEXTURES))}")
        if kind in FOLDERS:
            check_folder(self.output)
        else:
            check_files([self.output])
        of_clip = self.seed or None, self.full_scale, self.actuator
        if kind in TEXTURES and (self.has_stroke or of_clip != (None, None, None)):
            raise ValueError(f"{kind} holds the texture itself: leave out the stroke and its options")

    @property
    def kind(self) -> str:
        """Format, by its name or the output's."""
        return self.to or SUFFIXES.get(self.output.suffix.lower(), "")


@options_from(ExportOptions)
def export(options: ExportOptions) -> None:
    """Export a texture, or its vibration under one stroke, to another format.

    foten export denim.foten --speed 80 --force 0.8 --seconds 2 -o denim.ahap

    foten export denim.foten denim-ar.foten mesh.foten --to web -o site: two methods of one texture to compare, and another.
    """
    kind, output, files = options.kind, options.output, options.texture_files or []
    if kind == "web":
        document, keeps = _write_site(files, output)
    elif len(files) != 1:
        raise ValueError(f"{kind} takes one texture file, got {len(files)}; --to web takes any number")
    elif kind in CLIPS:
        document, keeps = _write_clip(read_texture(files[0]), options)
    else:
        document, keeps = _write_texture(read_texture(files[0]), kind, output)
    text = f"wrote {output}: {keeps}"
    print_result({"output": str(output), "format": kind, **document}, text, options.as_json)


def _write_clip(texture: Texture, options: ExportOptions) -> tuple[dict[str, Any], str]:
    """Write the clip of a stroke; by default 2 s at 80 mm/s and 0.8 N."""
    profile = None if options.actuator is None else read_profile(options.actuator)
    renderer = Renderer(texture, rate=max(RATE_HZ, texture.rate_hz), seed=options.seed, actuator=profile)
    stroke = options if options.has_stroke else replace(options, speed=80.0, force=0.8, seconds=2.0)
    speed, force, source = stroke.conditions(texture)
    unit = texture.card["units"].get("acceleration", "m/s^2") if profile is None else profile.unit
    metadata = {**provenance(texture, source, options.seed, False), "unit": unit}
    clip = clip_of(rendered_by(renderer, speed, force), renderer.rate, metadata, options.full_scale)
    write, keeps = CLIPS[options.kind]
    write(clip, options.output)
    seconds, full_scale = clip.duration_s, clip.full_scale
    words = "times the recording's RMS" if unit == RELATIVE else unit.replace("^2", "²")
    document = {"seconds": seconds, "rate_hz": clip.rate_hz, "full_scale": full_scale, "unit": unit}
    return document, f"{seconds:g} s, full scale (1) is {full_scale:.3g} {words}; {keeps}"


def _write_texture(texture: Texture, kind: str, output: Path) -> tuple[dict[str, Any], str]:
    if kind == "onnx":
        from foten.models.graph import graph_of_texture

        onnx.write_onnx(texture, graph_of_texture(texture), output)
        return {}, onnx.KEEPS
    if kind == "c":
        name = c_header.write_c_header(texture, output)
        return {"name": name}, f"{name}, {output.stat().st_size / 1e3:.0f} kB of text; {c_header.KEEPS}"
    name = unity.write_unity(texture, output)
    return {"name": name}, f"{name}; {unity.KEEPS}; copy it into the Packages folder of a Unity project"


def _write_site(files: list[Path], output: Path) -> tuple[dict[str, Any], str]:
    shelf = Shelf(files)
    listed = shelf.listed()
    web.write_site(page_files(), listed, shelf.files(), output)
    document = {"textures": [texture["file"] for texture in listed["textures"]]}
    return document, f"{counted(len(shelf), 'texture')}; {web.KEEPS}; put it on any web host and open it over HTTPS"
