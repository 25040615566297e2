"""Textures from words: what `foten imagine "words"` and `foten library search` do."""

from pathlib import Path

from foten.cli.editing import write_described
from foten.cli.texture_library import print_entries
from foten.console import check_output, say
from foten.editing.texture_library import Library, open_library
from foten.models.texture_file import read_texture
from foten.runtime.renderer import EXAMPLE
from foten_lab import words


def imagine(
    text: str, output: Path, folder: Path | None, encoder: str | None, rate_hz: float | None, as_json: bool
) -> None:
    """Write a texture of a text, by regression over the library in a folder, or moved from one that comes along."""
    check_output(output, "a texture", ".foten")
    own = [read_texture(path) for path in sorted(EXAMPLE.parent.glob("*.foten"))]
    library = open_library(folder) if folder else Library(EXAMPLE.parent, [])
    made = words.imagine(text, library, words.encoder_of(encoder), rate_hz, own)
    lines = []
    if made.spread_db is None:
        few = f"{len(library.entries)} textures are too few to learn from, expected {words.MIN_TEXTURES} or more"
        say(f"a guess: {few}; {made.nearest[0]} was adjusted instead")
    else:
        of_spectrum = f"± {made.spread_db:.1f} dB of the spectrum (1 sd)"
        lines = [f"spread     {of_spectrum}; most similar by words: {', '.join(made.nearest)}"]
    document = {"spread_db": made.spread_db, "guessed": made.spread_db is None, "nearest": list(made.nearest)}
    following = f"foten edit {output} --level … --brighter … -o {output}"
    write_described(made.texture, output, as_json, following, lines, document)


def search(text: str, folder: Path, encoder: str | None, as_json: bool) -> None:
    """Print the textures of a library by how like their words are to a text."""
    entries = open_library(folder).entries
    print_entries(words.search(entries, text, words.encoder_of(encoder)), "likeness", as_json)
