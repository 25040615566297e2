"""The textures that a server has: those that come along, and files or folders that were named."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foten.models.texture_file import read_texture
from foten.recording.recording import RELATIVE
from foten.runtime.renderer import EXAMPLE

SUFFIX = ".foten"
PICTURES = (".jpg", ".jpeg", ".webp")  # photographs; `foten render` writes .png beside a texture


@dataclass(frozen=True)
class Entry:
    """A texture on the shelf."""

    key: str  # what the page asks for: a file name, once
    path: Path
    name: str  # of the texture, by its card
    method: str  # the model's key
    picture: Path | None  # a photograph beside the file, of the same name
    relative: bool = False  # its acceleration is in units of the recording's RMS

    def listed(self) -> dict[str, Any]:
        """Entry, as the page gets it."""
        photo = None if self.picture is None else f"pictures/{self.key}{self.picture.suffix}"
        return {"file": self.key, "name": self.name, "method": self.method, "picture": photo, "relative": self.relative}


class Shelf:
    """Texture files by key. Only these are ever read: a name in a request is looked up, and is no path."""

    def __init__(self, paths: Sequence[Path] = ()) -> None:
        self._entries: dict[str, Entry] = {}
        for path in texture_files(paths):
            self.put(path)

    def __len__(self) -> int:
        return len(self._entries)

    def put(self, path: Path) -> Entry:
        """Put a texture file on the shelf, or read it again; its entry, or ValueError where it is no texture file."""
        texture = read_texture(path)
        key, n = path.name, 2
        while key in self._entries and self._entries[key].path != path:
            key, n = f"{path.stem}-{n}{SUFFIX}", n + 1
        picture = next((file for end in PICTURES if (file := path.with_suffix(end)).is_file()), None)
        name, method = str(texture.card["texture"]) or path.stem, str(texture.card["model"])
        relative = texture.card["units"].get("acceleration") == RELATIVE
        self._entries[key] = Entry(key, path, name, method, picture, relative)
        return self._entries[key]

    def get(self, key: str) -> Entry | None:
        """Entry, or None where there is none."""
        return self._entries.get(key)

    @property
    def n_names(self) -> int:
        """How many textures the page shows; several methods of one are one."""
        return len({entry.name for entry in self._entries.values()})

    def files(self) -> dict[str, Path]:
        """Texture files and their pictures by the names that the page asks for."""
        files = {f"textures/{entry.key}": entry.path for entry in self._entries.values()}
        return files | {
            str(entry.listed()["picture"]): entry.picture for entry in self._entries.values() if entry.picture
        }

    def listed(self) -> dict[str, Any]:
        """All entries, as the page gets them."""
        return {"textures": [entry.listed() for entry in self._entries.values()], "server": True}


def texture_files(paths: Sequence[Path]) -> Iterator[Path]:
    """Texture files of paths, those in folders among them; without paths those that come along."""
    if not paths:
        yield from sorted(EXAMPLE.parent.glob(f"*{SUFFIX}"))
    for path in paths:
        if path.is_dir():
            inside = sorted(path.glob(f"*{SUFFIX}"))
            if not inside:
                raise ValueError(f"{path} holds no texture file ({SUFFIX})")
            yield from inside
        elif path.exists():
            yield path
        else:
            raise FileNotFoundError(f"no such file: {path}")
