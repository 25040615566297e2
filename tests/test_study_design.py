"""Study files and orders of trials: what is refused in a line, and how evenly trials are spread."""

from __future__ import annotations

import re
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from foten_study import languages
from foten_study.design import read_design, task_of, titled
from foten_study.languages import read_language
from foten_study.orders import balance, orders, planned, square, williams
from foten_study.planning import study_text
from foten_study.tasks.table import TASKS

FILES = {
    "mesh": {"ar": "mesh-ar.foten", "foten": "mesh.foten"},
    "my towel": {"ar": "towel-ar.foten", "foten": "towel.foten"},
}
CODES = ("en", "de", "fr", "es", "ja", "ko", "zh")


@pytest.fixture
def study(tmp_path: Path) -> Path:
    for files in FILES.values():
        for file in files.values():
            (tmp_path / file).write_bytes(b"a texture")
    path = tmp_path / "study.toml"
    path.write_text(study_text("A “quoted” title \\ with\nlines", FILES, 12, 3), encoding="utf-8")
    return path


def test_a_new_study_file_reads_back(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = study.with_name("least.toml")
    path.write_text(study_text("Two trials", {"mesh": FILES["mesh"]}, 1, 0), encoding="utf-8")
    assert read_design(path)[0].n_trials == 2
    design, text = read_design(study)
    assert design.title == "A “quoted” title \\ with\nlines"
    assert (design.participants, design.seed, design.order, design.n_trials) == (12, 3, "balanced", 4)
    assert [texture.key for texture in design.textures] == ["mesh", "my towel"]
    assert design.methods == ("ar", "foten")
    assert design.textures[0].files["ar"] == study.parent / "mesh-ar.foten"
    assert design.task.min_seconds == 3.0
    assert [texture.name for texture in design.textures] == ["Mesh", "My towel"]
    assert [(q.private, q.at) for q in design.questions] == 4 * [(True, "start")] + [(False, "end")]
    assert text == study.read_text(encoding="utf-8")
    for name, most in (("MAX_FILES", 3), ("MAX_ALL_TRIALS", 47)):  # of which it has 4 and 48
        monkeypatch.setattr(f"foten_study.design.{name}", most)
        with pytest.raises(ValueError, match=f"expected [12] to {most}"):
            read_design(study)


BAD = [
    ("participants = 12", "participants = 0", "participants is 0, expected 1 to 1,000"),
    ("participants = 12", 'participants = "12"', "participants is '12', expected an integer"),
    ("participants = 12", "participants = true", "participants is True, expected an integer"),
    ('order = "balanced"', "order = 1", "order is 1, expected text"),
    ("min_seconds = 3", 'min_seconds = "3"', "min_seconds is '3', expected a number"),
    ('options = ["right", "left", "either"]', "options = [1]", r"options is \[1\], expected a list of texts"),
    ("seed = 3", "sed = 3", "the study has 'sed', expected some of title"),
    ('order = "balanced"', 'order = "latin"', "order is 'latin', expected balanced or random"),
    ("min_seconds = 3", "min_seconds = nan", "holds a number that is not finite, .* in 'min_seconds'"),
    ("participants = 12", f"participants = {10**400}", "not below 2.63, in 'participants'"),
    ('kind = "rating"', f'kind = "abx"\nrepeats = {10**12}', "repeats is 1e.12, expected 1 to 100"),
    ('kind = "rating"', f'kind = "abx"\nrepeats = {3 * 10**8}', "repeats is 300,000,000, expected 1 to 100"),
    ('foten = "mesh.foten"', 'foten = "mesh-ar.foten"', "two methods of mesh with one file"),
    ('foten = "mesh.foten"', 'Ar = "mesh.foten"', "one lacks"),
    ('foten = "mesh.foten"\n', "", "texture mesh has 1 method, expected two or more to compare"),
    ('name = "My towel"', 'name = "mesh"', "two textures with one name: 'mesh' and 'Mesh'"),
    ('at = "end"', 'at = "middle"', "question remarks: at is 'middle', expected start, end, or after how many trials"),
    ('key = "handedness"', 'key = "age"', "two questions with one key"),
    ('options = ["right", "left", "either"]', "", "question handedness: a choice has two options or more"),
    ("low = 0\nhigh = 120", "low = 120\nhigh = 0", "question age: low and high are 120 and 0, expected bounds"),
    ("low = 0\nhigh = 120", "low = nan", "not finite, .* in 'low'"),
    ('at = "end"', "low = 3", "question remarks: low and high are 3 and 1e.*, expected bounds of a number in order"),
    ("title =", "title", "study.toml: this is not TOML"),
    ('language = "en"', 'language = "tlh"', "language is 'tlh', expected one of en, de, fr, es, ja, ko, zh"),
    ('language = "en"', 'language = ["en"]', r"language is \['en'\], expected one of en"),
    ("[task]", '[words]\nnxt = "On"\n[task]', r"\[words\] has 'nxt', expected a key of .*: is 'next' meant\?"),
    ("[task]", "[words]\nnext = 3\n[task]", r"\[words\]: next is 3, expected text"),
    ("[task]", '[words]\nnext = " "\n[task]', r"\[words\]: next is ' ', expected text"),
    ("[task]", '[words]\nbreak = "{n}"\n[task]', r"\[words\]: break has {n}, expected {n}, {total}"),
    ("[task]", '[words]\nnext = "On {n}"\n[task]', r"\[words\]: next has {n}, expected none"),
    ("title =", "words = 3\ntitle =", r"\[words\] is 3, expected a table"),
]


@pytest.mark.parametrize(("given", "instead", "why"), BAD, ids=[bad[1] or "left out" for bad in BAD])
def test_a_bad_study_file_is_refused_in_a_line(study: Path, given: str, instead: str, why: str) -> None:
    text = study.read_text(encoding="utf-8")
    assert given in text
    study.write_text(text.replace(given, instead, 1), encoding="utf-8")
    with pytest.raises((ValueError, FileNotFoundError), match=why) as refused:
        read_design(study)
    assert len(str(refused.value).splitlines()) == 1 or "TOML" in why


@pytest.mark.parametrize("code", CODES)
def test_a_language_has_all_words_and_each_has_its_placeholders(code: str) -> None:
    """And nothing is the same as in English but a few words that are; those that a speaker has not read are said to be so."""
    language, english = read_language(code), read_language()
    assert language.reviewed == (code == "en")
    assert language.dir == "ltr"
    for texts, originals in ((language.words, english.words), (language.new, english.new)):
        assert texts.keys() == originals.keys()
        same = {key for key, text in texts.items() if text == originals[key]}
        assert code == "en" or same <= {"code", "volume", "force", "surface_n"}, same


def test_a_word_that_a_language_lacks_is_an_error_and_never_english(
    study: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    study.write_text(study.read_text(encoding="utf-8").replace('"en"', '"fr"'), encoding="utf-8")
    tables = languages.TABLES.read_text(encoding="utf-8")
    for given, instead, why in (
        ('next = "Suivant"', "", "languages.toml: French lacks 'next'"),
        ('next = "Suivant"', 'next = "Suivant"\nnext_one = ""', "languages.toml: French alone has 'next_one'"),
        ("terminé {n} sur", "terminé sur", "languages.toml: French: break has {total}, expected {n}, {total}"),
    ):
        changed = tmp_path / "languages.toml"
        changed.write_text(tables.replace(given, instead), encoding="utf-8")
        monkeypatch.setattr(languages, "TABLES", changed)
        languages._tables.cache_clear()
        with pytest.raises(ValueError, match=re.escape(why)):
            read_design(study)
    monkeypatch.undo()
    languages._tables.cache_clear()
    read_design(study)


def test_what_a_study_file_leaves_out_is_of_its_language(study: Path) -> None:
    """And what it says is its own; the minutes of the consent are those of as many trials."""
    text = study_text("Titel", FILES, 12, 3, "de")
    german = read_language("de")
    study.write_text(text, encoding="utf-8")
    design, _ = read_design(study)
    assert (design.language.code, design.task.question) == ("de", german.words["question"])
    assert design.questions[1].options == ("rechts", "links", "mit beiden")
    assert "Sie dauert etwa 8 Minuten;" in design.consent  # 90 / 48 minutes for each of 4 trials
    for name in ("question", "lowest", "highest"):
        text = re.sub(rf"^{name} = .*$", "", text, flags=re.M)
    text = re.sub(r'^instructions = """.*?"""', 'words.highest = "ganz gleich"', text, flags=re.M | re.S)
    study.write_text(text.replace('"de"', '"ja"'), encoding="utf-8")
    design, _ = read_design(study)
    japanese = read_language("ja")
    assert (design.task.lowest, design.task.highest) == (japanese.words["lowest"], "ganz gleich")
    assert design.instructions == japanese.words["instructions"]
    assert "Sie dauert" in design.consent


@pytest.mark.parametrize("kind", [kind for kind in TASKS if kind != "rating"])
def test_each_task_has_its_question_and_its_instructions_in_the_language(study: Path, kind: str) -> None:
    text = re.sub(r'^instructions = """.*?"""', "", study_text("제목", FILES, 12, 3, "ko"), flags=re.M | re.S)
    study.write_text(
        re.sub(r"^(question|lowest|highest) = .*$", "", text, flags=re.M).replace('"rating"', f'"{kind}"'),
        encoding="utf-8",
    )
    design, _ = read_design(study)
    words = read_language("ko").words
    assert design.instructions == words[f"instructions_{kind}"]
    questions = {"paired": "which_nearer", "abx": "which_x", "oddity": "which_odd", "threshold": "which_felt"}
    assert design.task.question == words[questions[kind]]
    assert task_of(study.read_text(encoding="utf-8")) == design.task


@pytest.mark.parametrize(
    ("name", "shown"), [("steel-mesh-1", "Steel mesh 1"), ("äcker__b", "Äcker b"), ("T1", "T1"), ("--", "--")]
)
def test_participants_read_a_name_as_people_write_it(name: str, shown: str) -> None:
    assert titled(name) == shown


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
