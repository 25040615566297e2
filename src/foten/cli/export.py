"""`foten export`: a texture, or its vibration under one stroke, in other formats."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer import Argument, Option

from foten.cli.render import provenance, rendered_by
from foten.cli.stroke_options import Actuator, StrokeOptions
from foten.console import check_files, check_folder, options_from, print_result

if TYPE_CHECKING:
    from foten.export.clip import Clip
    from foten.models.texture_file import Texture

SUFFIXES = {f".{name}": name for name in ("ahap", "haptic", "hjif", "onnx", "wav", "csv", "npz")}
SUFFIXES |= {".json": "android", ".h": "c"}
"""The format that a name has."""
CLIPS = ("wav", "csv", "npz", "ahap", "haptic", "hjif", "hjif-parametric", "android")
FOLDERS = ("web", "unity")  # which are made with the folders above them
TEXTURES = ("c", "onnx", "web", "unity")


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
    elif kind in TEXTURES:
        document, keeps = _TEXTURE_WRITERS[kind](_only(files, kind), output)
    else:
        document, keeps = _write_clip(kind, _clip(_only(files, kind), options), output)
    text = f"wrote {output}: {keeps}"
    print_result({"output": str(output), "format": kind, **document}, text, options.as_json)


def _only(files: list[Path], kind: str) -> Texture:
    from foten.models.texture_file import read_texture

    if len(files) != 1:
        raise ValueError(f"{kind} takes one texture file, got {len(files)}; --to web takes any number")
    return read_texture(files[0])


def _clip(texture: Texture, options: ExportOptions) -> Clip:
    """Clip of a stroke; by default 2 s at 80 mm/s and 0.8 N."""
    from foten.export.clip import RATE_HZ, clip_of
    from foten.runtime.actuator import read_profile
    from foten.runtime.renderer import Renderer

    profile = None if options.actuator is None else read_profile(options.actuator)
    renderer = Renderer(texture, rate=max(RATE_HZ, texture.rate_hz), seed=options.seed, actuator=profile)
    stroke = options if options.has_stroke else replace(options, speed=80.0, force=0.8, seconds=2.0)
    speed, force, source = stroke.conditions(texture)
    unit = texture.card["units"].get("acceleration", "m/s^2") if profile is None else profile.unit
    about = {**provenance(texture, source, options.seed, False), "unit": unit}
    return clip_of(rendered_by(renderer, speed, force), renderer.rate, about, options.full_scale)


def _write_clip(kind: str, clip: Clip, output: Path) -> tuple[dict[str, Any], str]:
    from foten.export import ahap, android, haptic, hjif, samples
    from foten.recording.recording import RELATIVE

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
    seconds, full_scale, unit = clip.duration_s, clip.full_scale, clip.about["unit"]
    words = "times the recording's RMS" if unit == RELATIVE else unit.replace("^2", "²")
    document = {"seconds": seconds, "rate_hz": clip.rate_hz, "full_scale": full_scale, "unit": unit}
    return document, f"{seconds:g} s, full scale (1) is {full_scale:.3g} {words}; {keeps}"


def _write_header(texture: Texture, output: Path) -> tuple[dict[str, Any], str]:
    from foten.export import c_header

    name = c_header.write_c_header(texture, output)
    return {"name": name}, f"{name}, {output.stat().st_size / 1e3:.0f} kB of text; {c_header.KEEPS}"


def _write_onnx(texture: Texture, output: Path) -> tuple[dict[str, Any], str]:
    from foten.baselines.graph import graph_of_texture
    from foten.export import onnx

    onnx.write_onnx(texture, graph_of_texture(texture), output)
    return {}, onnx.KEEPS


def _write_site(files: list[Path], output: Path) -> tuple[dict[str, Any], str]:
    from foten.export import web
    from foten.recording.inspection.values import counted
    from foten.studio.page_files import page_files
    from foten.studio.shelf import Shelf

    shelf = Shelf(files)
    listed = shelf.listed()
    web.write_site(page_files(), listed, shelf.files(), output)
    document = {"textures": [texture["file"] for texture in listed["textures"]]}
    return document, f"{counted(len(shelf), 'texture')}; {web.KEEPS}; put it on any web host and open it over HTTPS"


def _write_unity(texture: Texture, output: Path) -> tuple[dict[str, Any], str]:
    from foten.export import unity

    name = unity.write_unity(texture, output)
    return {"name": name}, f"{name}; {unity.KEEPS}; copy it into the Packages folder of a Unity project"


_TEXTURE_WRITERS = {"c": _write_header, "onnx": _write_onnx, "unity": _write_unity}
