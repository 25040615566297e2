"""`foten library`: keep textures in a folder, and search it by similarity and by words."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from foten.cli.commands import load
from foten.console import JsonOption, TextureFile, print_result, say
from foten.editing.texture_library import Entry, entry_of, open_library
from foten.models.texture_file import Texture, read_texture
from foten.reporting.table import Table

app = typer.Typer(
    help="Keep textures in a library, a folder that can be searched by similarity and by words.", no_args_is_help=True
)
Folder = Annotated[Path, Option("--library", metavar="DIR", help="Folder of the library.")]
DEFAULT = Path("library")
SHOWN = 12


@app.command()
def add(
    files: list[Path] = Argument(
        ...,
        metavar="T.foten|MODELS.xml…",
        help="Texture files, or model files (.xml) of the Penn Haptic Texture Toolkit.",
    ),
    library: Folder = DEFAULT,
    tag: list[str] | None = Option(None, help="Tag for all added textures, such as coarse or woven; repeatable."),
    name: str = Option("", help="Name of the texture, if only one is added."),
    as_json: JsonOption = False,
) -> None:
    """Copy textures into a library, and measure them for its index."""
    if name and len(files) != 1:
        raise ValueError(f"--name is for one texture, got {len(files)}")
    opened, added = open_library(library, make=True), []
    for i, file in enumerate(files, 1):
        stem = file.stem.removeprefix("Models_") if file.suffix.lower() == ".xml" else file.stem
        added.append(opened.add(_texture_in(file, stem), f"{stem}.foten", tag or [], name))
        say(f"{i}/{len(files)} {added[-1].name}")
    result = {"library": str(library), "added": [entry.file for entry in added], "textures": len(opened.entries)}
    text = f"{library}: {len(opened.entries)} textures; next: foten library list --library {library}"
    print_result(result, text, as_json)


def _texture_in(file: Path, stem: str) -> Texture:
    """The texture in a texture file, or of a model file of the Penn Haptic Texture Toolkit."""
    if file.suffix.lower() != ".xml":
        return read_texture(file)
    from foten.datasets.hatt import read_models
    from foten.models.piecewise_ar.local_models import imported_texture

    return imported_texture(read_models(file), hashlib.sha256(file.read_bytes()).hexdigest(), stem)[0]


@app.command(name="list")
def list_(library: Folder = DEFAULT, as_json: JsonOption = False) -> None:
    """List the textures of a library."""
    entries = open_library(library).entries
    print_entries([(None, entry) for entry in entries], "", as_json, len(entries))


@app.command()
def nearest(texture_file: TextureFile, library: Folder = DEFAULT, as_json: JsonOption = False) -> None:
    """Show the textures nearest to a given one, by level, centroid, width and roughness in just noticeable differences."""
    entry = entry_of(read_texture(texture_file), texture_file.name)
    print_entries(open_library(library).nearest(entry), "distance [JND]", as_json)


@app.command()
def search(
    text: str = Argument(..., help='Words to search for, such as "coarse denim".'),
    library: Folder = DEFAULT,
    encoder: str | None = Option(
        None, help="Sentence encoder, as a folder or a name.", show_default="built-in word vectors"
    ),
    as_json: JsonOption = False,
) -> None:
    """Show the textures whose names and tags best match some words."""
    load("library search")(text, library, encoder, as_json)


def print_entries(rows: Sequence[tuple[float | None, Entry]], measure: str, as_json: bool, shown: int = SHOWN) -> None:
    """Print entries of a library by some measure of likeness, the first `shown` of them for people."""
    figures = ("level [dB]", "centroid [Hz]", "width [oct]", "roughness [dB]")
    heads = ("texture", *([measure] if measure else []), *figures, "tags")
    cells = []
    for value, entry in rows[:shown]:
        one, likeness = entry.description, [] if value is None else [f"{value:.2f}"]
        level, centroid = f"{one.level_db:+.1f}", f"{one.centroid_hz:.0f}"
        width, roughness = f"{one.width_octaves:.2f}", f"{one.roughness_db:.2f}"
        cells.append((entry.name, *likeness, level, centroid, width, roughness, ", ".join(entry.tags)))
    lines = Table.of(heads, cells).text() if cells else ["no texture"]
    if len(rows) > shown:
        lines.append(f"and {len(rows) - shown} more")
    document = [
        {"file": entry.file, "name": entry.name, "tags": entry.tags, measure or "value": value} for value, entry in rows
    ]
    print_result(document, "\n".join(lines), as_json)
