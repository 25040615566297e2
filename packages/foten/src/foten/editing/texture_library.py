"""A folder of textures with an index: what each is like, its name and its tags; the nearest by figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from foten.atomic_write import write_json
from foten.dsp import Array
from foten.editing.describe import SECONDS, Description, describe, rendered, spectrum
from foten.models.texture_file import Texture, read_texture, write_texture
from foten.untrusted import MAX_PROFILE, parse_json, read_whole

INDEX = "library.json"
VERSION = 1
SUFFIX = ".foten"
BANDS_HZ = 20.0 * 2 ** (np.arange(17) / 3)  # centres of thirds of an octave, 20 to 806 Hz
MIN_DENSITY = 1e-18  # (m/s²)²/Hz
# Just noticeable differences, in which distances are counted: level and centroid or width (Israr & Tan 2006, 0.25 to 0.3 octave);
# roughness by our choice.
JND = {"level_db": 2.0, "centroid": 0.3, "width_octaves": 0.3, "roughness_db": 0.5}
MAX_TAGS, MAX_FIGURE = 100, 1e6
TEXTS = ["file", "name", "sha256", "unit", "evidence"]  # of an entry
MAX_TEXTURES = 10_000


@dataclass(frozen=True)
class Entry:
    """A texture of a library."""

    file: str
    name: str
    tags: tuple[str, ...]
    sha256: str
    rate_hz: float
    unit: str
    evidence: str
    description: Description
    bands_db: tuple[float, ...]  # density at the described condition, in `BANDS_HZ` [dB re 1 (m/s²)²/Hz]

    @property
    def figures(self) -> Array:
        """Level, centroid, width and roughness in just noticeable differences, (4,)."""
        one = self.description
        values = (one.level_db, np.log2(one.centroid_hz), one.width_octaves, one.roughness_db)
        return np.array(values) / np.array(list(JND.values()))

    def distance(self, other: Entry) -> float:
        """Distance of two textures, in just noticeable differences."""
        return float(np.sqrt(np.square(self.figures - other.figures).sum()))


def entry_of(texture: Texture, file: str, tags: Sequence[str] = (), name: str = "") -> Entry:
    """What a library notes of a texture; its name is by default the card's, or the file's."""
    description = describe(texture)
    at = description.speed_mm_s, description.force_n
    bands = bands_db(*spectrum(rendered(texture, *at, SECONDS), texture.rate_hz))
    return Entry(
        file=file,
        name=name or texture.card["texture"] or Path(file).stem,
        tags=tuple(tags),
        sha256=texture.sha256(),
        rate_hz=texture.rate_hz,
        unit=texture.unit,
        evidence=texture.evidence,
        description=description,
        bands_db=tuple(np.round(bands, 3).tolist()),
    )


def bands_db(hz: Array, density: Array) -> Array:
    """Mean densities in thirds of an octave [dB], (17,); of a band without a bin, or above the highest, the nearest below."""
    values, last = [], MIN_DENSITY
    for centre in BANDS_HZ:
        inside = (hz >= centre / 2 ** (1 / 6)) & (hz < centre * 2 ** (1 / 6)) & (hz <= 0.96 * hz[-1])
        last = float(density[inside].mean()) if inside.any() else last
        values.append(10 * np.log10(max(last, MIN_DENSITY)))
    return np.array(values)


@dataclass
class Library:
    """A folder of textures."""

    folder: Path
    entries: list[Entry]

    def add(self, texture: Texture, file: str, tags: Sequence[str] = (), name: str = "") -> Entry:
        """Write a texture to a file of the folder, in place of one of its name, and note what it is like; ValueError if full."""
        if len(tags) > MAX_TAGS or len(self.entries) >= MAX_TEXTURES:
            raise ValueError(f"expected {MAX_TAGS} tags at most, and {MAX_TEXTURES:,} textures")
        entry = entry_of(texture, file, tags, name)
        self.folder.mkdir(parents=True, exist_ok=True)
        write_texture(texture, self.folder / file)
        self.entries = [*(one for one in self.entries if one.file != file), entry]
        self.write()
        return entry

    def write(self) -> None:
        """Write the index."""
        write_json(self.folder / INDEX, {"version": VERSION, "textures": [asdict(entry) for entry in self.entries]})

    def nearest(self, to: Entry) -> list[tuple[float, Entry]]:
        """Other entries by distance, the nearest first."""
        others = [(to.distance(entry), entry) for entry in self.entries if entry.sha256 != to.sha256]
        return sorted(others, key=lambda pair: pair[0])


def open_library(folder: Path, make: bool = False) -> Library:
    """The library in a folder, or one that `make` begins; FileNotFoundError for no folder, ValueError for a damaged index."""
    path = folder / INDEX
    if not path.exists():
        if not folder.is_dir() and not make:
            raise FileNotFoundError(
                f"no such library: {folder}; 'foten library add T.foten --library {folder}' begins one"
            )
        files = sorted(folder.glob(f"*{SUFFIX}")) if folder.is_dir() else []
        return Library(folder, [entry_of(read_texture(file), file.name) for file in files])
    data = read_whole(path, MAX_PROFILE)
    try:
        document = parse_json(data)
        if document["version"] != VERSION:
            raise ValueError(f"version {document['version']}, expected {VERSION}: add its textures again")
        entries = [_entry(row) for row in document["textures"]]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: this is no index of a library ({error})") from None
    return Library(folder, entries)


def _entry(row: dict[str, Any]) -> Entry:
    """An entry of the index, checked."""
    description = Description(**row["description"])
    bands, tags = tuple(row["bands_db"]), tuple(row["tags"])
    numbers = [*bands, row["rate_hz"], *(value for value in vars(description).values() if value is not None)]
    are_numbers = all(isinstance(x, int | float) and abs(x) < MAX_FIGURE for x in numbers)
    if len(bands) != len(BANDS_HZ) or not are_numbers or description.centroid_hz <= 0:
        raise ValueError(f"the figures of {row['file']!r} are no numbers, or beyond {MAX_FIGURE:g}")
    if not all(isinstance(text, str) for text in (*tags, *(row[name] for name in TEXTS))):
        raise ValueError(f"the words of {row['file']!r} are no text")
    if Path(row["file"]).name != row["file"]:
        raise ValueError(f"{row['file']!r} is no file of its folder")
    return Entry(**{**row, "description": description, "bands_db": bands, "tags": tags})
