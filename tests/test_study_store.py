"""A study's database: answers are only added, nothing is there twice, what is removed is gone, and a full disk loses nothing."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import re
import signal
import sqlite3
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foten import __version__
from foten_study.analysis import read_ratings
from foten_study.orders import orders
from foten_study.participant_store import contact_s
from foten_study.store import Store, Stroked
from foten_study.study_file import GUARDS, MAX_VALUE, VERSION, FullError, Stimulus, create
from foten_study.tasks.kind import Rated

TEXTURES, METHODS = 3, 2
SECOND_RATING = (
    "INSERT INTO ratings (participant, trial, rating, measured, at, software, simulated, reason) "
    "VALUES (1, {trial}, 5, '', '', '', {simulated}, '')"
)


def made(path: Path, simulated: bool = False, participants: int = 5) -> Path:
    keys = [(t, m) for t in range(TEXTURES) for m in range(METHODS)]
    stimuli = [Stimulus(t, m, f"t{t}", f"m{m}", f"{t}{m}" * 8, 0.5 * m) for t, m in keys]
    trials = orders(participants, TEXTURES, METHODS, 7, 1, "balanced")
    create(path, "A study", "title = 1", path.parent, 7, stimuli, trials, simulated)
    return path


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(made(tmp_path / "study.db"))


def test_orders_and_stimuli_are_there_before_anyone_comes_and_are_not_written_over(store: Store) -> None:
    assert store.ordered() == [1, 2, 3, 4, 5]
    assert store.trials(2) == orders(5, TEXTURES, METHODS, 7, 1, "balanced")[1]
    assert store.stimuli()[2, 1].method_key == "m1"
    assert store.study["seed"] == 7
    with pytest.raises(ValueError, match="is there already, and may hold answers"):
        made(store.path)


def test_a_step_is_stored_once(store: Store) -> None:
    number = store.join("KXWQA")
    rated = 3, Rated({"similarity": 62.0}, 12.5, 4, {"contact_s": 9.0})
    assert store.take_step(number, "trial:3", rated)
    assert not store.take_step(number, "trial:3", (3, Rated({"similarity": 10.0})))
    (row,) = store.ratings()
    assert (row["rating"], row["response_s"], row["switches"], row["measured"]) == (62.0, 12.5, 4, {"contact_s": 9.0})
    digest = f"{row['texture']}{row['method']}" * 8
    assert (row["software"], row["simulated"], row["sha256"]) == (__version__, 0, digest)
    assert store.done(number) == {"trial:3"}
    store.take_step(number, "trial:0", (0, Rated({"similarity": 50.0})))  # practice, which is stored and not analysed
    assert len(store.ratings()) == store.counts()[number]["n"] == 1
    assert store.check() == []


def test_codes_and_numbers_are_given_once(store: Store) -> None:
    assert [store.join(code) for code in "ABC"] == [1, 2, 3]
    with pytest.raises(sqlite3.IntegrityError):
        store.join("A")
    assert [store.join(code) for code in "DE"] == [4, 5]
    with pytest.raises(ValueError, match="all 5 participants of the design have begun"):
        store.join("F")
    store.take_step(1, "consent", consent="I agree")
    with pytest.raises(sqlite3.IntegrityError):  # nothing that was answered goes
        store.return_place(1)
    store.return_place(3)
    assert store.join("F") == 3
    assert store.codes() == {"A": 1, "B": 2, "F": 3, "D": 4, "E": 5}
    assert [what for _, what in store.log()][1:] == ["the place of participant 3 was returned, without an answer"]
    assert store.check() == []


def test_ratings_are_only_added_and_corrected_by_new_rows(store: Store) -> None:
    number = store.join("A")
    store.take_step(number, "trial:1", (1, Rated({"similarity": 62.0})))
    for statement in ("UPDATE ratings SET rating = 0", "DELETE FROM ratings", "UPDATE trials SET method = 0"):
        with pytest.raises(sqlite3.IntegrityError, match="only added to"):
            store._connection.execute(statement)
    with pytest.raises(sqlite3.IntegrityError):  # nor a second one beside the step
        store._connection.execute(SECOND_RATING.format(trial=1, simulated=0))
    store.correct(number, 1, 26.0, "read the scale the wrong way round")
    store.correct(number, 1, 27.0, "once more")
    (row,) = store.ratings()
    assert (row["rating"], row["corrected"]) == (27.0, True)
    everything = store._connection.execute("SELECT rating FROM ratings ORDER BY id").fetchall()
    assert [one[0] for one in everything] == [62.0, 26.0, 27.0]
    assert "corrected to 26" in store.log()[1][1]
    for arguments, why in (
        ((1, 2, 5.0, "x"), "no rating of trial 2"),
        ((1, 1, 101.0, "x"), "0 to 100"),
        ((1, 1, 5.0, " "), "reason"),
    ):
        with pytest.raises(ValueError, match=why):
            store.correct(*arguments)


def test_simulated_and_real_ratings_do_not_mix(tmp_path: Path, store: Store) -> None:
    simulated = Store(made(tmp_path / "simulated.db", simulated=True))
    number = simulated.join("A")
    simulated.take_step(number, "trial:1", (1, Rated({"similarity": 5.0})))
    assert simulated.ratings()[0]["simulated"] == 1
    for one, kind in ((store, 1), (simulated, 0)):
        with pytest.raises(sqlite3.IntegrityError, match="do not go into one file"):
            one._connection.execute("INSERT INTO participants VALUES (4, 'Z', '', ?)", (kind,))
        with pytest.raises(sqlite3.IntegrityError, match="do not go into one file"):
            one._connection.execute(SECOND_RATING.format(trial=2, simulated=kind))
        with pytest.raises(sqlite3.IntegrityError, match="only added to"):
            one._connection.execute("UPDATE study SET simulated = 1 - simulated")


def test_what_people_say_of_themselves_lies_apart(store: Store) -> None:
    number = store.join("A")
    store.take_step(number, "questions:start", answers={"mood": "fine"}, private={"age": "34"}, consent="I agree")
    assert store.answers()[0]["answer"] == "fine"
    assert store.abouts() == [{"question": "age", "answer": "34"}]  # without a number
    assert len(store._connection.execute("SELECT text_sha256 FROM consents").fetchone()[0]) == 64


def test_strokes_come_back_as_they_went_in(store: Store) -> None:
    number = store.join("A")
    events = np.random.default_rng(0).normal(size=(500, 4))
    store.add_strokes(number, 1, [Stroked(0, events[:200])])
    store.add_strokes(number, 1, [Stroked(0, events[200:])])
    np.testing.assert_array_equal(store.strokes(number, 1), events)
    assert store.strokes(number, 2).shape == (0, 4)


def test_a_pen_is_in_contact_while_it_presses() -> None:
    """Two strokes of 0.1 s, and 0.1 s between them in the air, of events 10 ms apart."""
    t = np.arange(31) / 100
    pressure = np.where((t < 0.095) | (t > 0.195), 0.5, 0.0)
    assert contact_s(np.stack([t, t, pressure, t], axis=1)) == pytest.approx(0.2)


def test_the_next_level_follows_the_answers_that_count(store: Store) -> None:
    """Those of practice teach the task: neither a level of it nor a mistake moves the search."""
    trials = store.trials(store.join("A"))
    key = trials[0].texture, trials[0].method
    asked = [trial.number for trial in trials if (trial.texture, trial.method) == key]
    assert asked[0] == 0 < asked[1]
    for n in asked:
        store.take_step(1, f"trial:{n}", (n, Rated({"choice": 1.0}, log={"level_db": -20.0 - n})))
    assert [level for level, _ in store.levels(1, *key)] == [-20.0 - asked[1]]


def filled(store: Store) -> list[int]:
    numbers = [store.join(code) for code in ("FIRST", "SECOND", "THIRD")]
    for number in numbers:
        answers, private = {"q": f"SECRET-{number}"}, {"age": f"PRIVATE-{number}"}
        store.take_step(number, "questions:start", answers=answers, private=private)
        for trial in range(1, 7):
            store.add_strokes(number, trial, [Stroked(0, np.full((50, 4), float(number)))])
            store.add_switch(number, trial, "real", "operator", time.time())
            rated = Rated({"similarity": 10.0 * number}, 3.0, 1, {"note": f"MEASURED-{number}"})
            store.take_step(number, f"trial:{trial}", (trial, rated))
    return numbers


def test_a_participant_who_is_forgotten_is_gone_from_every_byte(store: Store) -> None:
    numbers = filled(store)
    store.correct(numbers[1], 2, 33.0, "PRIVATE-REASON")
    with store._writing():
        store._log("participant 20, trial 2: corrected to 3: slipped")
    store.forget(numbers[1])
    assert sorted(store.counts()) == [numbers[0], numbers[2]]
    assert {row["participant"] for row in store.ratings()} == {numbers[0], numbers[2]}
    assert store.check() == []
    corrected, removed = (what for _, what in store.log()[1:])
    assert corrected == "participant 20, trial 2: corrected to 3: slipped"
    assert removed == "all data of participant 2 was removed, as asked"
    store.close()
    for path in store.path.parent.glob("study.db*"):
        data = path.read_bytes()
        for word in (b"SECRET-2", b"PRIVATE-2", b"MEASURED-2", b"SECOND", b"PRIVATE-REASON"):
            assert word not in data
        assert b"SECRET-1" in data or path.suffix != ".db"
    again = Store(store.path)
    with pytest.raises(sqlite3.IntegrityError, match="only added to"):  # the guards are there again
        again._connection.execute("DELETE FROM ratings")
    again.forget(2)  # a second time, for bytes that were in use the first time
    with pytest.raises(ValueError, match="no participant 5 who has begun"):
        again.forget(5)
    again.close()


def test_a_backup_while_it_is_written_to_is_whole_and_one_file(tmp_path: Path, store: Store) -> None:
    filled(store)
    other = Store(store.path)
    number = other.join("LATER")
    for trial in (1, 2):
        other.take_step(number, f"trial:{trial}", (trial, Rated({"similarity": 1.0})))
        path = tmp_path / f"copy{trial}.db"
        assert store.backup(path) == 18 + trial
        assert path.read_bytes()[18:20] == b"\1\1"  # no write-ahead log, without which it could not be opened
        with Store(path) as copy:
            assert copy.check() == []
            assert len(copy.ratings()) == 18 + trial


def test_a_damaged_study_is_not_backed_up(tmp_path: Path, store: Store) -> None:
    store._connection.execute("PRAGMA foreign_keys = OFF")
    store._connection.execute("INSERT INTO steps VALUES (4, 'end', '')")
    assert store.check() == ["a row of steps names something that is not there"]
    with pytest.raises(ValueError, match=r"copy\.db is damaged: a row of steps"):
        store.backup(tmp_path / "copy.db")
    assert not (tmp_path / "copy.db").exists()


def test_statistics_of_sqlite_are_no_edit_and_strokes_are_read_up_to_a_bound(store: Store) -> None:
    store._connection.execute("ANALYZE")
    store.close()
    with Store(store.path) as again:
        number = again.join("A")
        again.add_strokes(number, 1, [Stroked(0, np.zeros((MAX_VALUE // 64, 4)))] * 2)
        assert len(again.strokes(number, 1)) == MAX_VALUE // 32
        again.add_strokes(number, 1, [Stroked(0, np.zeros((1, 4)))])
        with pytest.raises(ValueError, match="too long, or cut off"):
            again.strokes(number, 1)


NAN, BOMB = (zlib.compress(data).hex() for data in (np.full(4, np.nan).tobytes(), bytes(MAX_VALUE + 32)))


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("CREATE VIEW v AS SELECT 1", "tables or triggers are not as foten makes them"),
        ("DROP TABLE shown", "tables or triggers are not as foten makes them"),
        ("DELETE FROM study", "holds no study"),
        ("ALTER TABLE trials RENAME COLUMN other TO o", "tables or triggers are not as foten makes them"),
        (f"UPDATE study SET title = hex(zeroblob({MAX_VALUE // 2 + 1}))", "too big"),
        ("UPDATE study SET design = 'task.kind = \"paired\"'", "answers are not those of the design's task, 'paired'"),
        ("UPDATE stimuli SET texture_key = CAST(x'ff' AS TEXT)", "study.db cannot be read, is it damaged or in use?"),
        ("UPDATE ratings SET measured = '[{}]'", "participant 1, trial 1: what was measured is damaged"),
        ("UPDATE ratings SET measured = '{\"level_db\": 1e999}'", "what was measured is damaged (it holds a number"),
        ("UPDATE strokes SET events = x'ffff'", "study.db, participant 1, trial 1: a stroke is damaged (Error"),
        (f"UPDATE strokes SET events = x'{NAN}'", "a stroke is damaged (its numbers are not finite)"),
        (f"UPDATE strokes SET events = x'{BOMB}'", "a stroke is damaged (it is too long, or cut off)"),
    ],
)
def test_a_study_that_somebody_edited_is_refused_in_a_line(store: Store, statement: str, message: str) -> None:
    filled(store)
    store.add_strokes(1, 1, [Stroked(0, np.ones((3, 4)))])
    store.close()
    with contextlib.closing(sqlite3.connect(store.path, isolation_level=None)) as connection:
        for line in (*(f"DROP TRIGGER {name}" for name in GUARDS), statement):
            connection.execute(line)
        if "DROP TABLE" not in statement:
            connection.executescript("".join(f"CREATE TRIGGER {name} {guard};" for name, guard in GUARDS.items()))
    with pytest.raises((ValueError, OSError), match=re.escape(message)), Store(store.path) as edited:
        assert [read_ratings(edited), edited.parts(1, 1)] == []


@contextlib.contextmanager
def no_pages(store: Store) -> Iterator[None]:
    pages = store._connection.execute("PRAGMA page_count").fetchone()[0]
    store._connection.execute(f"PRAGMA max_page_count = {pages}")
    yield
    store._connection.execute("PRAGMA max_page_count = 1000000")


@contextlib.contextmanager
def no_bytes(store: Store) -> Iterator[None]:
    """An I/O error: no file of this process grows beyond what the write-ahead log has."""
    resource = pytest.importorskip("resource")
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    size = store.path.with_name(f"{store.path.name}-wal").stat().st_size
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, usual[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, usual)


@pytest.mark.parametrize(("refuses", "code"), [(no_pages, "SQLITE_FULL"), (no_bytes, "SQLITE_IOERR_WRITE")])
def test_a_disk_that_takes_no_more_is_said_and_nothing_is_lost(store: Store, refuses: Any, code: str) -> None:
    number = store.join("A")
    store.take_step(number, "trial:1", (1, Rated({"similarity": 62.0})))
    events = np.random.default_rng(0).normal(size=(9000, 4))
    message = "the disk is full or cannot be written; what was there is there"
    with refuses(store), pytest.raises(FullError, match=message) as full:
        store.add_strokes(number, 2, [Stroked(0, events)])
    assert full.value.__cause__.sqlite_errorname == code  # type: ignore[union-attr]
    assert [row["rating"] for row in store.ratings()] == [62.0]
    assert store.take_step(number, "trial:2", (2, Rated({"similarity": 30.0})))
    store.add_strokes(number, 2, [Stroked(0, events)])
    assert store.check() == []


def test_a_commit_waits_for_the_disk(store: Store) -> None:
    """A loss of power cannot be had in a test; SQLite promises its survival for these two."""
    pragmas = [store._connection.execute(f"PRAGMA {name}").fetchone()[0] for name in ("journal_mode", "synchronous")]
    assert pragmas == ["wal", 2]  # FULL


def test_a_newer_database_and_no_database_are_refused_in_a_line(tmp_path: Path, store: Store) -> None:
    store.close()
    connection = sqlite3.connect(store.path)
    connection.execute(f"PRAGMA user_version = {VERSION + 1}")
    connection.close()
    with pytest.raises(ValueError, match=r"is of version 4, and this foten knows up to 3: update foten"):
        Store(store.path)
    (tmp_path / "text.db").write_text("hello " * 1000)
    with pytest.raises(ValueError, match="is no study of foten, or is damaged"):
        Store(tmp_path / "text.db")
    sqlite3.connect(tmp_path / "other.db").execute("CREATE TABLE t (a)").connection.close()
    with pytest.raises(ValueError, match="is no study of foten, expected a file that 'foten study run' made"):
        Store(tmp_path / "other.db")
    with pytest.raises(FileNotFoundError):
        Store(tmp_path / "nothing.db")


def _writes_for_ever(path: str, said: object) -> None:
    store = Store(Path(path))
    number = store.join("KILL")
    for trial in range(1, 7):
        store.take_step(number, f"trial:{trial}", (trial, Rated({"similarity": float(trial)})))
        said.send(trial)  # type: ignore[attr-defined]
        time.sleep(0.01)


def test_what_was_taken_before_a_kill_is_there(tmp_path: Path) -> None:
    for killed_after in (1, 4):
        path = made(tmp_path / f"{killed_after}.db")
        hears, says = multiprocessing.get_context("spawn").Pipe(duplex=False)
        process = multiprocessing.get_context("spawn").Process(target=_writes_for_ever, args=(str(path), says))
        process.start()
        taken = 0
        while taken < killed_after:
            taken = hears.recv()
        assert process.pid is not None
        os.kill(process.pid, signal.SIGKILL)
        process.join()
        with Store(path) as store:
            ratings = [row["rating"] for row in store.ratings()]
            assert ratings[:taken] == [float(trial) for trial in range(1, taken + 1)]
            assert store.check() == []
            assert store.done(1) == {f"trial:{trial}" for trial in range(1, len(ratings) + 1)}
