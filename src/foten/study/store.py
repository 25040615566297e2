"""A study's database: one SQLite file, to which answers are only ever added.

Participants are numbers. What they say of themselves, and that they agreed, lies in tables of its own, which no export reads
beside ratings. A rating that was wrong is corrected by a new row; the old one stays. Simulated ratings are those of a study that
was made for them, as the file itself says: a trigger refuses them in another, and others in it.

`synchronous=FULL` in write-ahead logging: a commit that returned has reached the disk.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import sqlite3
import time
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from foten.atomic_write import atomic_write
from foten.study.orders import Trial
from foten.untrusted import check_regular

APPLICATION_ID = 0x666F7465  # "fote"
BUSY_S = 10.0

# Each is run once, in its order; the number of those that were is the file's version.
MIGRATIONS = (
    """
CREATE TABLE study (
    id INTEGER PRIMARY KEY CHECK (id = 1), title TEXT NOT NULL, design TEXT NOT NULL, folder TEXT NOT NULL, seed INTEGER NOT NULL,
    simulated INTEGER NOT NULL CHECK (simulated IN (0, 1)), created TEXT NOT NULL, software TEXT NOT NULL
) STRICT;
CREATE TABLE stimuli (
    texture INTEGER NOT NULL, method INTEGER NOT NULL, texture_key TEXT NOT NULL, method_key TEXT NOT NULL,
    sha256 TEXT NOT NULL, gain_db REAL NOT NULL, PRIMARY KEY (texture, method)
) STRICT;
CREATE TABLE trials (
    participant INTEGER NOT NULL, trial INTEGER NOT NULL, texture INTEGER NOT NULL, method INTEGER NOT NULL,
    PRIMARY KEY (participant, trial), FOREIGN KEY (texture, method) REFERENCES stimuli (texture, method)
) STRICT;
CREATE TABLE participants (
    number INTEGER PRIMARY KEY, code TEXT NOT NULL UNIQUE, joined TEXT NOT NULL, simulated INTEGER NOT NULL
) STRICT;
CREATE TABLE consents (
    participant INTEGER PRIMARY KEY REFERENCES participants (number), at TEXT NOT NULL, text_sha256 TEXT NOT NULL
) STRICT;
CREATE TABLE abouts (
    participant INTEGER NOT NULL REFERENCES participants (number), question TEXT NOT NULL, answer TEXT NOT NULL, at TEXT NOT NULL,
    PRIMARY KEY (participant, question)
) STRICT;
CREATE TABLE answers (
    participant INTEGER NOT NULL REFERENCES participants (number), question TEXT NOT NULL, answer TEXT NOT NULL, at TEXT NOT NULL,
    PRIMARY KEY (participant, question)
) STRICT;
CREATE TABLE steps (
    participant INTEGER NOT NULL REFERENCES participants (number), step TEXT NOT NULL, at TEXT NOT NULL,
    PRIMARY KEY (participant, step)
) STRICT;
CREATE TABLE ratings (
    id INTEGER PRIMARY KEY, participant INTEGER NOT NULL REFERENCES participants (number), trial INTEGER NOT NULL,
    rating REAL NOT NULL CHECK (rating BETWEEN 0 AND 100), response_s REAL, switches INTEGER, measured TEXT NOT NULL,
    at TEXT NOT NULL, software TEXT NOT NULL, simulated INTEGER NOT NULL, corrects INTEGER REFERENCES ratings (id),
    reason TEXT NOT NULL, FOREIGN KEY (participant, trial) REFERENCES trials (participant, trial)
) STRICT;
CREATE UNIQUE INDEX one_rating ON ratings (participant, trial) WHERE corrects IS NULL;
CREATE UNIQUE INDEX one_correction ON ratings (corrects) WHERE corrects IS NOT NULL;
CREATE TABLE strokes (
    participant INTEGER NOT NULL REFERENCES participants (number), trial INTEGER NOT NULL, part INTEGER NOT NULL,
    at TEXT NOT NULL, events BLOB NOT NULL, PRIMARY KEY (participant, trial, part)
) STRICT;
CREATE TABLE switches (
    id INTEGER PRIMARY KEY, participant INTEGER NOT NULL REFERENCES participants (number), trial INTEGER NOT NULL,
    side TEXT NOT NULL, marked_by TEXT NOT NULL, at TEXT NOT NULL
) STRICT;
CREATE TABLE log (id INTEGER PRIMARY KEY, at TEXT NOT NULL, what TEXT NOT NULL) STRICT;
""",
)

# Dropped by `forget` alone, within its transaction.
_GUARDS = {
    **{
        f"{table}_stay_{verb.lower()}": f"BEFORE {verb} ON {table} BEGIN SELECT RAISE(ABORT, '{table} are only added to'); END"
        for table in ("ratings", "trials", "stimuli", "study", "switches", "strokes", "log")
        for verb in ("UPDATE", "DELETE")
    },
    **{
        f"{table}_of_one_kind": f"BEFORE INSERT ON {table} WHEN NEW.simulated != (SELECT simulated FROM study) BEGIN "
        "SELECT RAISE(ABORT, 'simulated and real ratings do not go into one file'); END"
        for table in ("ratings", "participants")
    },
}
_OF_PARTICIPANT = ("switches", "strokes", "ratings", "steps", "answers", "abouts", "consents", "participants", "trials")


class FullError(OSError):
    """The disk has no room for an answer, which was not taken."""


@dataclass(frozen=True)
class Stimulus:
    """A texture with a method, as it was when the study began."""

    texture: int
    method: int
    texture_key: str
    method_key: str
    sha256: str  # of the texture file
    gain_db: float  # that makes it as loud as the texture's other methods


@dataclass(frozen=True)
class Rated:
    """What a trial came to."""

    rating: float
    response_s: float | None = None  # from when the trial was shown
    switches: int | None = None  # between the real and the virtual surface
    measured: Mapping[str, Any] = field(
        default_factory=dict
    )  # contact_s, speed_mm_s, force_n, block_p99_ms, n_underruns, …


def create(
    path: Path,
    title: str,
    text: str,
    folder: Path,
    seed: int,
    stimuli: Sequence[Stimulus],
    orders: Sequence[Sequence[Trial]],
    software: str,
    simulated: bool = False,
) -> None:
    """Write a new database, whole or not at all: the study, its stimuli, and every participant's order.

    Raises:
        ValueError: there is a file already, which may hold answers.
    """
    if path.exists():
        raise ValueError(f"{path} is there already, and may hold answers: go on with it, or give another name")
    with atomic_write(path) as part:
        connection = sqlite3.connect(part, isolation_level=None)
        try:
            connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            _migrate(connection)
            connection.execute("BEGIN")
            connection.execute(
                "INSERT INTO study VALUES (1, ?, ?, ?, ?, ?, ?, ?)",
                (title, text, str(folder.resolve()), seed, int(simulated), _now(), software),
            )
            connection.executemany(
                "INSERT INTO stimuli VALUES (?, ?, ?, ?, ?, ?)",
                [(s.texture, s.method, s.texture_key, s.method_key, s.sha256, s.gain_db) for s in stimuli],
            )
            connection.executemany(
                "INSERT INTO trials VALUES (?, ?, ?, ?)",
                [(i + 1, t.number, t.texture, t.method) for i, trials in enumerate(orders) for t in trials],
            )
            connection.execute("INSERT INTO log (at, what) VALUES (?, ?)", (_now(), f"made by foten {software}"))
            connection.execute("COMMIT")
        finally:
            connection.close()


def _migrate(connection: sqlite3.Connection) -> None:
    version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    for number in range(version, len(MIGRATIONS)):
        connection.execute("BEGIN IMMEDIATE")
        for statement in MIGRATIONS[number].split(";\n"):
            if statement.strip():
                connection.execute(statement)
        connection.execute(f"PRAGMA user_version = {number + 1}")
        connection.execute("COMMIT")
    for name, guard in _GUARDS.items():
        connection.execute(f"CREATE TRIGGER IF NOT EXISTS {name} {guard}")


class Store:
    """An open study. It belongs to one thread at a time.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is no study, is damaged, or a newer foten made it.
    """

    def __init__(self, path: Path, software: str = "") -> None:
        check_regular(path)
        self.path, self._software = path, software
        self._lock: BinaryIO | None = None
        self._connection = sqlite3.connect(path, isolation_level=None, timeout=BUSY_S, check_same_thread=False)
        self._connection.row_factory = sqlite3.Row
        try:
            self._open()
        except sqlite3.OperationalError as error:
            self._connection.close()
            raise OSError(f"{path} cannot be opened, though it may be sound: {error}") from error
        except sqlite3.DatabaseError as error:
            self._connection.close()
            raise ValueError(f"{path} is no study of foten, or is damaged: {error}") from error
        except BaseException:
            self._connection.close()
            raise

    def _open(self) -> None:
        execute = self._connection.execute
        if execute("PRAGMA application_id").fetchone()[0] != APPLICATION_ID:
            raise ValueError(f"{self.path} is no study of foten, expected a file that 'foten study run' made")
        version = execute("PRAGMA user_version").fetchone()[0]
        if version > len(MIGRATIONS):
            newest = f"this foten knows up to {len(MIGRATIONS)}"
            raise ValueError(f"{self.path} is of version {version}, and {newest}: update foten")
        execute("PRAGMA journal_mode = WAL")
        execute("PRAGMA synchronous = FULL")
        execute("PRAGMA foreign_keys = ON")
        _migrate(self._connection)
        self.study = dict(execute("SELECT * FROM study").fetchone())

    def hold(self) -> None:
        """Be the one that runs the study, until the file is given back or this process ends.

        Raises:
            OSError: another process runs it.
        """
        if self._lock is not None:
            return
        lock = self.path.with_name(self.path.name + ".lock").open("a+b")
        try:
            _lock(lock.fileno())
        except OSError as error:
            lock.close()
            raise OSError(f"{self.path.name} is in use: end the 'foten study run' of it first") from error
        self._lock = lock

    def close(self) -> None:
        """Give the file back."""
        self._connection.close()
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    @property
    def simulated(self) -> bool:
        """Return whether its ratings are of a model of raters."""
        return bool(self.study["simulated"])

    @contextlib.contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        """One change, whole or not at all, on the disk when it returns."""
        try:
            self._connection.execute("BEGIN IMMEDIATE")
            yield self._connection
            self._connection.execute("COMMIT")
        except BaseException as error:
            with contextlib.suppress(sqlite3.Error):
                self._connection.execute("ROLLBACK")
            if isinstance(error, sqlite3.OperationalError) and _is_full(error):
                raise FullError(
                    f"{self.path.name}: the disk is full or cannot be written; what was there is there"
                ) from error
            raise

    def _rows(self, query: str, *values: Any) -> list[sqlite3.Row]:
        return self._connection.execute(query, values).fetchall()

    # Participants

    def join(self, code: str, number: int | None = None) -> int:
        """Add a participant under a code, and return the number: the next that nobody has had, or the one that is given.

        Raises:
            ValueError: there is no order for that number, or it is taken.
        """
        with self._writing() as connection:
            taken = {int(row[0]) for row in self._rows("SELECT number FROM participants")}
            free = [n for n in self.ordered() if n not in taken]
            if number is None:
                if not free:
                    raise ValueError(
                        f"all {len(taken)} participants of the design have begun; a larger study is a new one"
                    )
                number = free[0]
            elif number not in free:
                raise ValueError(f"participant {number} has begun already, or has no order of trials")
            row = (number, code, _now(), int(self.simulated))
            connection.execute("INSERT INTO participants VALUES (?, ?, ?, ?)", row)
        return number

    def ordered(self) -> list[int]:
        """Return the numbers for which an order of trials is stored."""
        return [int(row[0]) for row in self._rows("SELECT DISTINCT participant FROM trials ORDER BY participant")]

    def codes(self) -> dict[str, int]:
        """Return the participants that have begun, by code."""
        return {
            str(row["code"]): int(row["number"]) for row in self._rows("SELECT * FROM participants ORDER BY number")
        }

    def trials(self, participant: int) -> list[Trial]:
        """Return a participant's trials in their order."""
        rows = self._rows("SELECT trial, texture, method FROM trials WHERE participant = ? ORDER BY trial", participant)
        return [Trial(*row) for row in rows]

    def stimuli(self) -> dict[tuple[int, int], Stimulus]:
        """Return what is compared, by texture and method."""
        return {(row["texture"], row["method"]): Stimulus(*row) for row in self._rows("SELECT * FROM stimuli")}

    def done(self, participant: int) -> set[str]:
        """Return the steps that a participant has behind."""
        return {str(row[0]) for row in self._rows("SELECT step FROM steps WHERE participant = ?", participant)}

    # Answers

    def take_step(
        self,
        participant: int,
        step: str,
        rated: tuple[int, Rated] | None = None,
        answers: Mapping[str, str] | None = None,
        private: Mapping[str, str] | None = None,
        consent: str | None = None,
    ) -> bool:
        """Store a step with its answers; return False where it was stored before, and nothing changes.

        Args:
            rated: number of the trial, and what it came to.
            answers, private: of a questionnaire, by question.
            consent: the text that was agreed to.

        Raises:
            FullError: the disk has no room.
        """
        at = _now()
        with self._writing() as connection:
            new = connection.execute("INSERT OR IGNORE INTO steps VALUES (?, ?, ?)", (participant, step, at)).rowcount
            if not new:
                return False
            if rated is not None:
                self._add_rating(connection, participant, *rated, at)
            for table, given in (("answers", answers), ("abouts", private)):
                rows = [(participant, question, answer, at) for question, answer in (given or {}).items()]
                connection.executemany(f"INSERT INTO {table} VALUES (?, ?, ?, ?)", rows)
            if consent is not None:
                digest = hashlib.sha256(consent.encode()).hexdigest()
                connection.execute("INSERT INTO consents VALUES (?, ?, ?)", (participant, at, digest))
        return True

    def take_steps(self, participant: int, rated: Mapping[str, Rated]) -> None:
        """Store many trials of a simulated rater at once, by step."""
        at = _now()
        with self._writing() as connection:
            for step, one in rated.items():
                connection.execute("INSERT INTO steps VALUES (?, ?, ?)", (participant, step, at))
                self._add_rating(connection, participant, int(step.removeprefix("trial:")), one, at)

    def _add_rating(self, connection: sqlite3.Connection, participant: int, trial: int, rated: Rated, at: str) -> None:
        measured = json.dumps(dict(rated.measured), allow_nan=False)
        connection.execute(
            "INSERT INTO ratings (participant, trial, rating, response_s, switches, measured, at, software, simulated, reason) "
            "VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, '')",
            (
                participant,
                trial,
                rated.rating,
                rated.response_s,
                rated.switches,
                measured,
                at,
                self._software,
                self.simulated,
            ),
        )

    def correct(self, participant: int, trial: int, rating: float, reason: str) -> None:
        """Put another rating in the place of the one that holds; the old row stays.

        Raises:
            ValueError: that trial has no rating, the new one is out of range, or no reason is given.
        """
        if not 0 <= rating <= 100:
            raise ValueError(f"the rating is {rating:g}, expected 0 to 100")
        if not reason.strip():
            raise ValueError("a correction needs a reason")
        with self._writing() as connection:
            rows = self._rows(f"{_HOLDING} AND participant = ? AND trial = ?", participant, trial)
            if not rows:
                raise ValueError(f"participant {participant} has no rating of trial {trial}")
            connection.execute(
                "INSERT INTO ratings (participant, trial, rating, response_s, switches, measured, at, software, simulated, "
                "corrects, reason) SELECT participant, trial, ?, response_s, switches, measured, ?, ?, simulated, id, ? "
                "FROM ratings WHERE id = ?",
                (rating, _now(), self._software, reason, rows[0]["id"]),
            )
            self._log(connection, f"participant {participant}, trial {trial}: corrected to {rating:g}: {reason}")

    def add_switch(self, participant: int, trial: int, side: str, marked_by: str) -> None:
        """Store that a hand went over to the real or the virtual surface."""
        with self._writing() as connection:
            connection.execute(
                "INSERT INTO switches (participant, trial, side, marked_by, at) VALUES (?, ?, ?, ?, ?)",
                (participant, trial, side, marked_by, _now()),
            )

    def switches(self, participant: int, trial: int) -> int:
        """Return how often a hand went over in a trial."""
        rows = self._rows("SELECT count(*) FROM switches WHERE participant = ? AND trial = ?", participant, trial)
        return int(rows[0][0])

    def add_strokes(self, participant: int, trial: int, events: NDArray[np.float64]) -> None:
        """Store events of a pen: x, y [mm], pressure, t [s], shape (n, 4)."""
        packed = zlib.compress(np.ascontiguousarray(events, dtype="<f8").tobytes())
        with self._writing() as connection:
            connection.execute(
                "INSERT INTO strokes SELECT ?, ?, coalesce(max(part) + 1, 0), ?, ? FROM strokes "
                "WHERE participant = ? AND trial = ?",
                (participant, trial, _now(), packed, participant, trial),
            )

    def strokes(self, participant: int, trial: int) -> NDArray[np.float64]:
        """Return the events of a trial, shape (n, 4); none where there are none."""
        rows = self._rows(
            "SELECT events FROM strokes WHERE participant = ? AND trial = ? ORDER BY part", participant, trial
        )
        data = b"".join(zlib.decompress(row[0]) for row in rows)
        return np.frombuffer(data, dtype="<f8").reshape(-1, 4)

    # What is there

    def ratings(self) -> list[dict[str, Any]]:
        """Return the ratings that hold, one a trial, without practice: participant, trial, texture, method (as numbers and as
        keys), rating, response_s, switches, measured, simulated, sha256, corrected.
        """
        rows = self._rows(
            f"SELECT r.*, t.texture, t.method, s.texture_key, s.method_key, s.sha256 FROM ({_HOLDING}) r "
            "JOIN trials t ON t.participant = r.participant AND t.trial = r.trial "
            "JOIN stimuli s ON s.texture = t.texture AND s.method = t.method WHERE r.trial > 0 ORDER BY r.participant, r.trial"
        )
        return [
            {**dict(row), "measured": json.loads(row["measured"]), "corrected": row["corrects"] is not None}
            for row in rows
        ]

    def counts(self) -> dict[int, dict[str, Any]]:
        """Return by participant: code, how many ratings, when they joined and when the last answer came."""
        rows = self._rows(
            "SELECT p.number, p.code, p.joined, "
            "(SELECT count(*) FROM ratings r WHERE r.participant = p.number AND r.corrects IS NULL AND r.trial > 0) AS n, "
            "(SELECT max(at) FROM steps s WHERE s.participant = p.number) AS last, "
            "(SELECT count(*) FROM steps s WHERE s.participant = p.number AND s.step = 'end') AS ended "
            "FROM participants p ORDER BY p.number"
        )
        return {int(row["number"]): dict(row) for row in rows}

    def answers(self) -> list[dict[str, Any]]:
        """Return what questionnaires were answered with, but what is private."""
        return [dict(row) for row in self._rows("SELECT * FROM answers ORDER BY participant, at")]

    def abouts(self) -> list[dict[str, Any]]:
        """Return what participants said of themselves, in an order that is not theirs and without their numbers."""
        rows = self._rows("SELECT question, answer FROM abouts ORDER BY question, answer")
        return [dict(row) for row in rows]

    def log(self) -> list[tuple[str, str]]:
        """Return what was done to the study, with times."""
        return [(row["at"], row["what"]) for row in self._rows("SELECT * FROM log ORDER BY id")]

    def note(self, what: str) -> None:
        """Write a line into the log."""
        with self._writing() as connection:
            self._log(connection, what)

    def _log(self, connection: sqlite3.Connection, what: str) -> None:
        connection.execute("INSERT INTO log (at, what) VALUES (?, ?)", (_now(), what))

    def check(self) -> list[str]:
        """Return what is wrong with the file, in lines: nothing, as a rule."""
        wrong = [str(row[0]) for row in self._rows("PRAGMA integrity_check") if row[0] != "ok"]
        wrong += [
            f"a row of {row[0]} names something that is not there" for row in self._rows("PRAGMA foreign_key_check")
        ]
        twice = self._rows(
            "SELECT participant, trial FROM ratings WHERE corrects IS NULL GROUP BY participant, trial HAVING count(*) > 1"
        )
        return wrong + [f"participant {row[0]}, trial {row[1]}: rated twice" for row in twice]

    # The two exceptions

    def backup(self, path: Path) -> None:
        """Copy the study to another file, whole or not at all, while it is being written to."""
        if any(path.with_name(path.name + end).exists() for end in ("", "-wal", "-shm")):
            raise ValueError(f"{path} is there already: give the copy another name")
        with atomic_write(path) as part:
            copy = sqlite3.connect(part)
            try:
                self._connection.backup(copy, pages=256, sleep=0.01)
                copy.execute("PRAGMA journal_mode = DELETE")
            except sqlite3.OperationalError as error:
                raise OSError(f"cannot write {path}: {error}") from error
            finally:
                copy.close()

    def forget(self, participant: int) -> None:
        """Remove all of a participant's data from the file, and say in the log that it was done.

        Raises:
            ValueError: there is no such participant.
            OSError: the study is in use.
        """
        removed = f"all data of participant {participant} was removed, as asked"
        # Asked a second time, since the file was in use: what is left of the bytes goes now.
        if participant not in self.codes().values() and not any(what == removed for _, what in self.log()):
            raise ValueError(f"there is no participant {participant} who has begun")
        self.hold()
        connection = self._connection
        connection.execute("PRAGMA secure_delete = ON")
        try:
            with self._writing():
                for name in _GUARDS:
                    connection.execute(f"DROP TRIGGER {name}")
                connection.execute("PRAGMA defer_foreign_keys = ON")
                for table in _OF_PARTICIPANT:
                    column = "number" if table == "participants" else "participant"
                    connection.execute(f"DELETE FROM {table} WHERE {column} = ?", (participant,))
                # Its corrections name the participant.
                connection.execute("DELETE FROM log WHERE what LIKE ?", (f"participant {participant},%",))
                self._log(connection, removed)
                for name, guard in _GUARDS.items():
                    connection.execute(f"CREATE TRIGGER {name} {guard}")
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            connection.execute("VACUUM")
            busy = connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0]
        except sqlite3.OperationalError as error:
            raise OSError(f"{self.path.name} is in use ({error}): end 'foten study run' first") from error
        if busy:
            raise OSError(
                f"{self.path.name} is in use, and parts of it may keep what was removed: end 'foten study run', do it again"
            )


# The last in each chain of corrections.
_HOLDING = "SELECT * FROM ratings WHERE NOT EXISTS (SELECT 1 FROM ratings later WHERE later.corrects = ratings.id)"


def _lock(file: int) -> None:
    """Lock a file for this process alone, or raise OSError at once; the lock ends with the process, however that ends."""
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
    else:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _is_full(error: sqlite3.OperationalError) -> bool:
    return error.sqlite_errorname.startswith(("SQLITE_FULL", "SQLITE_IOERR", "SQLITE_READONLY", "SQLITE_CANTOPEN"))


def _now() -> str:
    return datetime.fromtimestamp(time.time(), UTC).isoformat(timespec="milliseconds")
