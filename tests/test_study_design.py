"""Study files and orders of trials: what is refused in a line, and how evenly trials are spread."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from foten.study.design import read_design, study_text
from foten.study.orders import balance, orders, planned, square, williams

FILES = {
    "mesh": {"ar": "mesh-ar.foten", "foten": "mesh.foten"},
    "my towel": {"ar": "towel-ar.foten", "foten": "towel.foten"},
}


@pytest.fixture
def study(tmp_path: Path) -> Path:
    for files in FILES.values():
        for file in files.values():
            (tmp_path / file).write_bytes(b"a texture")
    path = tmp_path / "study.toml"
    path.write_text(study_text("A “quoted” title \\ with\nlines", FILES, 12, 3), encoding="utf-8")
    return path


def test_a_new_study_file_reads_back(study: Path) -> None:
    design, text = read_design(study)
    assert design.title == "A “quoted” title \\ with\nlines"
    assert (design.participants, design.seed, design.order, design.n_trials) == (12, 3, "balanced", 4)
    assert [texture.key for texture in design.textures] == ["mesh", "my towel"]
    assert design.methods == ("ar", "foten")
    assert design.textures[0].files["ar"] == study.parent / "mesh-ar.foten"
    assert design.task.min_seconds == 3.0
    assert [(q.private, q.at) for q in design.questions] == 4 * [(True, "start")] + [(False, "end")]
    assert text == study.read_text(encoding="utf-8")


BAD = [
    ("participants = 12", "participants = 0", "participants is 0, expected 1 to 1000"),
    ("participants = 12", 'participants = "12"', "participants is '12', expected an integer"),
    ("participants = 12", "participants = true", "participants is True, expected an integer"),
    ('order = "balanced"', "order = 1", "order is 1, expected text"),
    ("min_seconds = 3", 'min_seconds = "3"', "min_seconds is '3', expected a number"),
    ('options = ["right", "left", "either"]', "options = [1]", r"options is \[1\], expected a list of texts"),
    ("seed = 3", "sed = 3", "the study has 'sed', expected some of title"),
    ('order = "balanced"', 'order = "latin"', "order is 'latin', expected balanced or random"),
    ("min_seconds = 3", "min_seconds = nan", "min_seconds is nan, expected 0 to 600"),
    ('foten = "mesh.foten"', 'foten = "mesh2.foten"', r"no such file: .*mesh2\.foten"),
    ('foten = "mesh.foten"', 'foten = "mesh-ar.foten"', "two methods of mesh with one file"),
    ('foten = "mesh.foten"', 'Ar = "mesh.foten"', "one lacks"),
    ('foten = "mesh.foten"\n', "", "texture mesh has 1 method, expected two or more to compare"),
    ('name = "my towel"', 'name = "Mesh"', "two textures with one name: 'Mesh' and 'mesh'"),
    ('at = "end"', 'at = "middle"', "question remarks: at is 'middle', expected start, end, or after how many trials"),
    ('key = "handedness"', 'key = "age"', "two questions with one key"),
    ('options = ["right", "left", "either"]', "", "question handedness: a choice has two options or more"),
    ("title =", "title", "study.toml is no TOML"),
]


@pytest.mark.parametrize(("given", "instead", "why"), BAD, ids=[bad[1] or "left out" for bad in BAD])
def test_a_bad_study_file_is_refused_in_a_line(study: Path, given: str, instead: str, why: str) -> None:
    text = study.read_text(encoding="utf-8")
    assert given in text
    study.write_text(text.replace(given, instead, 1), encoding="utf-8")
    with pytest.raises((ValueError, FileNotFoundError), match=why) as refused:
        read_design(study)
    assert len(str(refused.value).splitlines()) == 1 or "TOML" in why


def test_a_study_without_textures_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text('title = "x"\n')
    with pytest.raises(ValueError, match="there is no texture, expected"):
        read_design(path)
    path.write_text('title = "x"\n[textures.mesh]\nname = "mesh"\n')
    with pytest.raises(ValueError, match=r"\[textures\.mesh\] has no methods"):
        read_design(path)
    with pytest.raises(FileNotFoundError):
        read_design(tmp_path / "nothing.toml")


@pytest.mark.parametrize("k", [1, 2, 3, 12])
def test_a_williams_square_is_balanced_for_place_and_for_what_comes_before(k: int) -> None:
    rows = williams(k)
    assert len(rows) == (k if k % 2 == 0 or k == 1 else 2 * k)
    assert all(sorted(row) == list(range(k)) for row in rows.tolist())
    for column in rows.T:
        assert set(Counter(column.tolist()).values()) == {len(rows) // k}
    if k > 1:
        neighbours = Counter((a, b) for row in rows.tolist() for a, b in pairwise(row))
        assert len(neighbours) == k * (k - 1)
        assert len(set(neighbours.values())) == 1


@pytest.mark.parametrize(("textures", "methods"), [(12, 4), (5, 3), (1, 2), (2, 2), (7, 4)])
def test_balanced_orders_are_balanced_after_a_whole_square(textures: int, methods: int) -> None:
    n = len(williams(textures)) * len(williams(methods))
    made = orders(n, textures, methods, 5, 2, "balanced")
    for name, (low, high) in balance(made, textures, methods).items():
        assert low == high, name
    for trials in made:
        counted = [trial for trial in trials if not trial.practice]
        assert [trial.number for trial in trials] == [-1, 0, *range(1, textures * methods + 1)]
        assert len({(trial.texture, trial.method) for trial in counted}) == textures * methods
        if textures > 1:
            assert all(a.texture != b.texture for a, b in pairwise(counted))


@pytest.mark.parametrize("n", [7, 21, 24])
def test_the_orders_that_a_study_stores_are_balanced_over_its_participants(n: int) -> None:
    """Whatever is stored for those who leave: exactly after whole squares, else as evenly as can be."""
    assert square(12, 4) == 12
    for seed in range(3):
        stored = planned(n, 12, 4, seed, 2, "balanced")
        assert len(stored) == n + max(2, n // 4)
        assert len({tuple((t.texture, t.method) for t in trials) for trials in stored[:n]}) >= min(n, 12)
        for name, (low, high) in balance(stored[:n], 12, 4).items():
            if n % 12 == 0:
                assert low == high, name
            elif name == "method in round":
                assert high - low <= 1
    assert balance(orders(21, 12, 4, 1, 2, "random"), 12, 4)["method in round"][1] > 8


def test_a_seed_is_an_order() -> None:
    for order in ("balanced", "random"):
        one, same, other = (orders(9, 5, 3, seed, 1, order) for seed in (4, 4, 5))
        assert one == same
        assert one != other
    practised = [trials[0] for trials in orders(200, 5, 3, 4, 1, "random")]
    assert len({(trial.texture, trial.method) for trial in practised}) == 15
    assert np.bincount([trial.method for trial in practised]).min() > 40
