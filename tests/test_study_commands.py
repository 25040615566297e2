"""`foten study` from texture files to a report, and what runs until it is ended."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import re
import signal
import sqlite3
import subprocess
import sys
import threading
from pathlib import Path
from typing import IO

import numpy as np
import pytest

pytest.importorskip("starlette")
pytest.importorskip("statsmodels")
from foten.cli.command_line import _status
from foten.datasets.importing import read_stroke
from foten.runtime.stroke import tabled_stroke
from foten_study.languages import read_language
from foten_study.store import Store, Stroked
from foten_study.study_file import GUARDS
from test_study_server import study_file

STUDY = [sys.executable, "-c", "from foten.cli import main; main()", "study"]


def foten(*arguments: str | Path, ok: bool = True) -> str:
    out, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        status = _status(["study", *map(str, arguments)])
    assert status == (0 if ok else 2), errors.getvalue()
    assert ok or errors.getvalue().count("\n") == 1
    return out.getvalue() + errors.getvalue()


def test_from_texture_files_to_a_report_without_anyone(tmp_path: Path) -> None:
    study_file(tmp_path, 3, 2)
    study, database, results = tmp_path / "mine.toml", tmp_path / "mine.db", tmp_path / "results"
    textures = sorted(tmp_path.glob("*.foten"))
    assert "3 textures × 2 methods, 15 participants" in foten("new", study, *textures, "--participants", "15")
    checked = foten("check", study)
    assert "6 trials for each of 15 participants" in checked
    assert "about 11 minutes for each participant" in checked
    assert "the real surface: whether it is touched is not checked" in checked
    foten("simulate", study, "-o", database, "--difference", "12", "--better", "dstn", "--missing", "0.2")
    status = foten("status", database)
    assert "15 simulated raters" in status
    assert "the file is intact" in status
    said = foten("analyze", database, "-o", results, "--reference", "dstn")
    assert "The highest mean is that of dstn." in said
    assert re.search(r"Mean similarity: ar \d+\.\d\d ± \d+\.\d\d, dstn \d", said)
    assert "simulated raters rated 2 methods on 3 textures" in said
    page = (results / "report.html").read_text(encoding="utf-8")
    assert "Simulated ratings: of a model of raters, and not of people." in page
    assert "did not answer everything" in page
    with (results / "ratings-wide.csv").open(newline="", encoding="utf-8") as file:
        wide = list(csv.reader(file))
    assert wide[0][:3] == ["participant", "simulated", "ar.artificial-grass"]
    assert 12 <= len(wide) <= 16  # who left during practice has no row
    document = json.loads((results / "results.json").read_text(encoding="utf-8"))
    assert document["results"]["similarity"]["anova_one_way"][0]["p_corrected"] < 0.01
    assert document["results"]["similarity"]["mixed_model"]["n_participants"] == len(wide) - 1
    assert "already exists" in foten("simulate", study, "-o", database, ok=False)
    assert "expected one of ar, dstn" in foten("analyze", database, "--reference", "x", "-o", tmp_path / "r", ok=False)
    assert not (tmp_path / "r").exists()
    foten("backup", database, "-o", tmp_path / "copy.db")
    with Store(database) as store:
        store.add_strokes(1, 3, [Stroked(0, np.array([[0.4 * k, 0.0, 0.5, 7.0 + 0.005 * k] for k in range(100)]))])
    strokes = ("strokes", database, "--participant", "1", "-o", tmp_path / "stroke.csv")
    assert "100 events, 0.5 s" in foten(*strokes, "--trial", "3")
    stroke = tabled_stroke(read_stroke(tmp_path / "stroke.csv", {}), 1000.0)
    assert 0.5 < stroke.force.max() < 0.9
    assert "no stroke of participant 1 in trial 2" in foten(*strokes, "--trial", "2", ok=False)
    foten("correct", database, "--participant", "1", "--trial", "1", "--rating", "5", "--reason", "slipped")
    foten("forget", database, "--participant", "2", "--yes")
    assert "14 simulated raters" in foten("status", database)
    assert "15 simulated raters" in foten("status", tmp_path / "copy.db")
    with contextlib.closing(sqlite3.connect(database, isolation_level=None)) as edited:
        edited.executescript("""DROP TRIGGER ratings_stay_update; UPDATE ratings SET measured = '{"newtons": 1}'""")
        edited.execute(f"CREATE TRIGGER ratings_stay_update {GUARDS['ratings_stay_update']}")
    assert "rows that do not fit (KeyError('steepness')); were they edited?" in foten(
        *strokes, "--trial", "3", ok=False
    )


def test_what_a_command_refuses_is_a_line(tmp_path: Path) -> None:
    study = study_file(tmp_path)
    textures = sorted(tmp_path.glob("*.foten"))
    assert "already exists" in foten("new", study, *textures, ok=False)
    refused = foten("new", tmp_path / "x.toml", textures[0], ok=False)
    assert "has one method, expected two texture files or more" in refused
    assert not (tmp_path / "x.toml").exists()
    assert "no such file" in foten("status", tmp_path / "nothing.db", ok=False)


def test_a_study_of_one_texture_in_another_language(tmp_path: Path) -> None:
    study_file(tmp_path, 1, 2)
    study = tmp_path / "mine.toml"
    said = foten("new", study, *sorted(tmp_path.glob("*.foten")), "--participants", "1", "--language", "ko")
    assert "1 texture × 2 methods, 1 participant\n" in said
    assert read_language("ko").new["title"] in study.read_text(encoding="utf-8")
    checked = foten("check", study)
    assert "1 texture × 2 methods: 2 trials for each of 1 participant, after 2 for practice" in checked
    assert "the Korean texts have not been reviewed by a speaker" in checked
    refused = foten("new", tmp_path / "x.toml", *tmp_path.glob("*.foten"), "--language", "xx", ok=False)
    assert "language is 'xx', expected one of en, de" in refused


def test_power_says_how_many() -> None:
    sizes = ("--studies", "60", "--methods", "2", "--textures", "3")
    document = json.loads(foten("power", "--difference", "12", "--json", *sizes))
    assert 4 < document["participants"] < 60
    assert document["power"][0]["participants"] == 4


def started_study(path: Path, *options: str) -> tuple[subprocess.Popen[str], str, str]:
    """A study that runs, its operator's link and its participants'."""
    process = subprocess.Popen([*STUDY, "run", str(path), "--no-open", *options], stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    operator = next(line for line in process.stderr if line.startswith("operator: ")).split()[-1]
    participants = next(line for line in process.stderr if line.startswith("participants at ")).split()[-1]
    lines = SAID[process.pid] = []
    threading.Thread(
        target=_read_out, args=(process.stderr, lines), daemon=True
    ).start()  # so that it never waits for us
    return process, operator, participants


SAID: dict[int, list[str]] = {}  # by process, what it said after it began


def _read_out(stream: IO[str], lines: list[str]) -> None:
    with stream:
        for line in stream:
            lines.append(line)


def test_a_study_that_runs_ends_cleanly_and_goes_on(tmp_path: Path) -> None:
    study, database = study_file(tmp_path), tmp_path / "study.db"
    for n_before in (0, 1):
        process, operator, participants = started_study(study, "--port", "0")
        with Store(database) as store:
            assert len(store.codes()) == n_before
            assert len(store.ordered()) == 3 + 2  # and some for those who leave
            if n_before == 0:
                store.join("ABCDE")
                done = subprocess.run([*STUDY, "run", study], capture_output=True, text=True, check=False, timeout=60)
                assert "is in use: end the 'foten study run' of it" in done.stderr
                assert "is in use" in foten("forget", database, "--participant", "1", "--yes", ok=False)
        assert operator.startswith(f"{participants}operator?key=")
        assert participants.startswith("http://127.0.0.1:")
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=20) in (0, 130)
