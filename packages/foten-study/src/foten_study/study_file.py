"""A study's database as a file: its schema, made, opened, locked, written to as a whole or not at all, checked and copied.

One SQLite file, to which answers are only added. Participants are numbers; what they say of themselves lies in tables of its own,
which no export reads beside ratings.
"""

import contextlib
import sqlite3
import time
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO, Self

from foten import __version__
from foten.atomic_write import atomic_write
from foten.untrusted import check_regular
from foten_study.design import MAX_FILES
from foten_study.orders import Trial

BUSY_S = 2.0  # to wait for another writer
MAX_VALUE = 64_000_000  # bytes; of a trial's strokes too
FULL = ("SQLITE_FULL", "SQLITE_IOERR", "SQLITE_READONLY", "SQLITE_CANTOPEN")  # how errors of a disk are called
HELD = ("SQLITE_BUSY", "SQLITE_LOCKED")  # and of another program that holds the file
APPLICATION_ID = 0x666F7465  # "fote"
VERSION = 3  # of the file
TABLES = Path(__file__).with_name("schema.sql").read_text(encoding="utf-8")

# Triggers by name; dropped by `forget` alone, within its transaction.
GUARDS = {
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
ALL = "".join([TABLES, *(f"CREATE TRIGGER {name} {guard};\n" for name, guard in GUARDS.items())])
TABLES_BY_PARTICIPANT = ("switches", "strokes", "shown", "ratings", "steps", "answers", "abouts", "consents", "trials")

# Ratings, of each chain of corrections the last.
VALID_RATINGS = "SELECT * FROM ratings WHERE NOT EXISTS (SELECT 1 FROM ratings later WHERE later.corrects = ratings.id)"


@dataclass(frozen=True)
class Stimulus:
    """A texture with a method, as it was when the study began; a row of `stimuli`."""

    texture: int
    method: int
    texture_key: str
    method_key: str
    sha256: str  # of the texture file
    gain_db: float  # to the level of the texture's other methods


def faults_of(connection: sqlite3.Connection) -> list[str]:
    """Lines that say what is wrong with a database: none, as a rule."""
    faults = [str(row[0]) for row in connection.execute("PRAGMA integrity_check") if row[0] != "ok"]
    faults += [
        f"a row of {row[0]} names something that is not there" for row in connection.execute("PRAGMA foreign_key_check")
    ]
    twice = connection.execute(
        "SELECT participant, trial FROM ratings WHERE corrects IS NULL GROUP BY participant, trial, scale HAVING count(*) > 1"
    )
    return faults + [f"participant {row[0]}, trial {row[1]}: rated twice" for row in twice]


def now() -> str:
    """Present time (UTC) as it is stored."""
    return as_stored(time.time())


def as_stored(system_s: float) -> str:
    """A time of the system's clock [s] as it is stored (UTC)."""
    return datetime.fromtimestamp(system_s, UTC).isoformat(timespec="milliseconds")


def create(
    path: Path,
    title: str,
    text: str,
    folder: Path,
    seed: int,
    stimuli: Sequence[Stimulus],
    orders: Sequence[Sequence[Trial]],
    simulated: bool = False,
) -> None:
    """Write a new database: the study, its stimuli, and every participant's order; ValueError where there is a file already."""
    if path.exists():
        raise ValueError(f"{path} is there already, and may hold answers: go on with it, or give another name")
    rows = {
        "study": [(1, title, text, str(folder.resolve()), seed, int(simulated), now(), __version__)],
        "stimuli": list(map(astuple, stimuli)),
        "trials": [(i + 1, *astuple(trial)) for i, trials in enumerate(orders) for trial in trials],
        "log": [(1, now(), f"made by foten {__version__}")],
    }
    with atomic_write(path) as part, contextlib.closing(sqlite3.connect(part)) as connection, connection:
        connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version = {VERSION}")
        connection.executescript(ALL)
        for table, values in rows.items():
            places = ", ".join("?" * len(values[0]))
            connection.executemany(f"INSERT INTO {table} VALUES ({places})", values)


class FullError(OSError):
    """The disk has no room for an answer, which was not taken."""


class StudyFile:
    """An open file, of one thread at a time; read-only as it is now. ValueError for no study, or a damaged one."""

    def __init__(self, path: Path, read_only: bool = False) -> None:
        check_regular(path)
        self.path = path
        self._lock: BinaryIO | None = None
        self._connection = sqlite3.connect(path, isolation_level=None, timeout=BUSY_S, check_same_thread=False)
        self._connection.row_factory = sqlite3.Row
        self._connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_VALUE)
        try:
            self._open()
            if read_only:
                self._execute("PRAGMA query_only = ON")
                self._execute("BEGIN")
                self._rows("SELECT 1 FROM study")  # the first query says what is now
        except BaseException as error:
            self._connection.close()
            if isinstance(error, sqlite3.OperationalError):
                raise OSError(f"{path} cannot be opened, though it may be sound: {error}") from error
            if isinstance(error, sqlite3.DatabaseError):
                raise ValueError(f"{path} is no study of foten, or is damaged: {error}") from error
            raise

    def _open(self) -> None:
        execute = self._execute
        if execute("PRAGMA application_id").fetchone()[0] != APPLICATION_ID:
            raise ValueError(f"{self.path} is no study of foten, expected a file that 'foten study run' made")
        if (version := execute("PRAGMA user_version").fetchone()[0]) != VERSION:
            why = f"expected {VERSION}: analyse it with the foten that made it"
            if version > VERSION:
                why = f"and this foten knows up to {VERSION}: update foten"
            raise ValueError(f"{self.path} is of version {version}, {why}")
        tables = "SELECT type, name, sql FROM sqlite_schema WHERE name NOT LIKE 'sqlite_%'"  # not SQLite's own
        with contextlib.closing(sqlite3.connect(":memory:")) as new:
            new.executescript(ALL)
            if set(map(tuple, execute(tables))) != set(new.execute(tables)):
                raise ValueError(f"{self.path}: tables or triggers are not as foten makes them; were they edited?")
        rows = execute("SELECT * FROM study").fetchall()
        if not rows or execute("SELECT count(*) FROM stimuli").fetchone()[0] > MAX_FILES:
            raise ValueError(f"{self.path} holds no study, or one of more than {MAX_FILES} textures")
        execute("PRAGMA journal_mode = WAL")
        execute("PRAGMA synchronous = FULL")  # of write-ahead logging: a commit waits for the disk
        execute("PRAGMA foreign_keys = ON")
        self.study = dict(rows[0])

    def hold(self) -> None:
        """Lock the study for this process until `close` or the process's end; OSError where another process runs it."""
        if self._lock is None:
            lock = self.path.with_name(self.path.name + ".lock").open("a+b")
            try:
                _lock(lock.fileno())
            except OSError as error:
                lock.close()
                raise OSError(f"{self.path.name} is in use: end the 'foten study run' of it first") from error
            self._lock = lock

    def close(self) -> None:
        """Close the file, and unlock it."""
        self._connection.close()
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    @property
    def simulated(self) -> bool:
        """Whether its ratings are of a model of raters."""
        return bool(self.study["simulated"])

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """One change, whole or not at all, on the disk when it returns."""
        try:
            self._execute("BEGIN IMMEDIATE")
            yield
            self._execute("COMMIT")
            self._execute(f"PRAGMA busy_timeout = {1000 * BUSY_S:.0f}")
        except BaseException as error:
            with contextlib.suppress(sqlite3.Error):
                self._execute("ROLLBACK")
            name = error.sqlite_errorname if isinstance(error, sqlite3.OperationalError) else ""
            if name.startswith(FULL):
                why = "the disk is full or cannot be written; what was there is there"
                raise FullError(f"{self.path.name}: {why}") from error
            if name.startswith(HELD):
                self._execute("PRAGMA busy_timeout = 0")  # until a change succeeds: many pages wait for this thread
                raise OSError(f"{self.path.name}: another program holds the file; what was there is there") from error
            raise

    def _execute(self, statement: str, *values: Any) -> sqlite3.Cursor:
        return self._connection.execute(statement, values)

    def _rows(self, query: str, *values: Any) -> list[sqlite3.Row]:
        try:
            return self._execute(query, *values).fetchall()
        except sqlite3.DatabaseError as error:
            raise OSError(f"{self.path.name} cannot be read, is it damaged or in use? {error}") from error

    def log(self) -> list[tuple[str, str]]:
        """Lines of the log, with times."""
        return [tuple(row) for row in self._rows("SELECT at, what FROM log ORDER BY id")]

    def _log(self, what: str) -> None:
        self._execute("INSERT INTO log (at, what) VALUES (?, ?)", now(), what)

    def check(self) -> list[str]:
        """Lines that say what is wrong with the file: none, as a rule."""
        return faults_of(self._connection)

    def backup(self, path: Path) -> int:
        """Copy the study to another file, while it is written to; the number of valid ratings in the copy.

        The copy is checked before it gets its name, and needs no files beside it. ValueError where there is such a file, or the
        copy is damaged; OSError where it cannot be written.
        """
        if any(path.with_name(path.name + end).exists() for end in ("", "-wal", "-shm")):
            raise ValueError(f"{path} is there already: give the copy another name")
        with atomic_write(path) as part:
            copy = sqlite3.connect(part)
            try:
                self._connection.backup(copy, pages=256, sleep=0.01)
                copy.execute("PRAGMA journal_mode = DELETE")
                faults = faults_of(copy)
                n = int(copy.execute(f"SELECT count(*) FROM ({VALID_RATINGS} AND trial > 0)").fetchone()[0])
            except sqlite3.OperationalError as error:
                raise OSError(f"cannot write {path}: {error}") from error
            finally:
                copy.close()
            if faults:
                raise ValueError(f"the copy {path} is damaged: {faults[0]}")
        return n

    def forget(self, participant: int) -> None:
        """Remove all of a participant's data, and log it; ValueError where there is none, OSError where the study is in use."""
        removed = f"all data of participant {participant} was removed, as asked"
        # Asked a second time, since the file was in use: what is left of the bytes goes now.
        begun = self._rows("SELECT 1 FROM participants WHERE number = ?", participant)
        if not begun and not any(what == removed for _, what in self.log()):
            raise ValueError(f"there is no participant {participant} who has begun")
        self.hold()
        self._execute("PRAGMA secure_delete = ON")
        try:
            with self._writing():
                for name in GUARDS:
                    self._execute(f"DROP TRIGGER {name}")
                self._execute("PRAGMA defer_foreign_keys = ON")
                for table in TABLES_BY_PARTICIPANT:
                    self._execute(f"DELETE FROM {table} WHERE participant = ?", participant)
                self._execute("DELETE FROM participants WHERE number = ?", participant)
                # Its corrections name the participant.
                self._execute("DELETE FROM log WHERE what LIKE ?", f"participant {participant},%")
                self._log(removed)
                for name, guard in GUARDS.items():
                    self._execute(f"CREATE TRIGGER {name} {guard}")
            self._execute("PRAGMA wal_checkpoint(TRUNCATE)")
            self._execute("VACUUM")
            busy = self._execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0]
        except sqlite3.OperationalError as error:
            raise OSError(f"{self.path.name} is in use ({error}): end 'foten study run' first") from error
        if busy:
            why = "in use, and parts of it may keep what was removed: end 'foten study run', do it again"
            raise OSError(f"{self.path.name} is {why}")


def _lock(file: int) -> None:
    """Lock a file until it is closed or the process ends, however that ends; OSError where another process has it."""
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
    else:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
