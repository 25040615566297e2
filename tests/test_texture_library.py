"""A library: what is noted is what is rendered, and likeness orders."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from foten.editing.describe import Description, describe
from foten.editing.texture_library import BANDS_HZ, INDEX, Entry, Library, open_library
from foten.models.texture_file import read_texture
from foten.runtime.renderer import EXAMPLE
from test_cli import foten

FOLDER = EXAMPLE.parent


def entry(name: str, level: float, slope: float = 0.0, tags: tuple[str, ...] = ()) -> Entry:
    """A texture of a library that has no file: a spectrum that is level [dB] and falls by a slope a band."""
    bands = tuple((level - slope * np.arange(len(BANDS_HZ))).tolist())
    description = Description(100.0, 0.7, level, 100.0, 0.6, 1.5, None, 0.9, 0.3)
    return Entry(f"{name}.foten", name, tags, f"{hash(name)}", 1000.0, "m/s²", "", description, bands)


def test_a_library_notes_finds_and_keeps(tmp_path: Path) -> None:
    folder = str(tmp_path / "surfaces")
    files = [str(FOLDER / f"{name}.foten") for name in ("towel", "jeans", "steel-mesh-1")]
    foten("library", "add", *files[:2], "--library", folder, "--tag", "woven")
    foten("library", "add", files[2], "--library", folder, "--name", "wire mesh", "--tag", "metal")
    out = foten("library", "list", "--library", folder)[0]
    assert all(name in out for name in ("towel", "jeans", "wire mesh", "woven", "metal"))
    found = json.loads(foten("library", "nearest", files[0], "--library", folder, "--json")[0])
    library = open_library(Path(folder))
    towel = next(one for one in library.entries if one.name == "towel")
    assert [one["name"] for one in found] == [one.name for _, one in library.nearest(towel)]
    nearest = min(towel.distance(one) for one in library.entries if one != towel)
    assert found[0]["distance [JND]"] == pytest.approx(nearest)
    assert towel.description == describe(read_texture(files[0]))
    foten("library", "add", files[0], "--library", folder)  # again: it replaces itself
    assert len(open_library(Path(folder)).entries) == 3
    assert (Path(folder) / "towel.foten").read_bytes() == Path(files[0]).read_bytes()


def test_a_folder_without_an_index_is_a_library(tmp_path: Path) -> None:
    (tmp_path / "towel.foten").write_bytes((FOLDER / "towel.foten").read_bytes())
    assert [one.name for one in open_library(tmp_path).entries] == ["towel"]
    with pytest.raises(FileNotFoundError, match="no such library"):
        open_library(tmp_path / "none")


@pytest.mark.parametrize(
    "damage",
    ["{", '{"version": 2, "textures": []}', '{"version": 1}', '{"version": 1, "textures": [{"file": "x"}]}', "[]"],
)
def test_a_damaged_index_is_refused_in_a_line(tmp_path: Path, damage: str) -> None:
    (tmp_path / INDEX).write_text(damage)
    assert "this is no index of a library" in foten("library", "list", "--library", tmp_path, status=2)[1]


@pytest.mark.parametrize("change", [{"level_db": "3"}, {"level_db": 1e308}, {"centroid_hz": -1.0}, {"name": 3}, {}])
def test_an_entry_is_checked(change, tmp_path: Path) -> None:
    one = replace(entry("towel", 0.0), file="t.foten" if change else "../t.foten")
    of_entry = change if "name" in change else {"description": replace(one.description, **change)}
    Library(tmp_path, [replace(one, **of_entry)]).write()
    with pytest.raises(ValueError, match="no text" if "name" in change else "no numbers" if change else "is no file"):
        open_library(tmp_path)
