"""Schema of a study's database: one SQLite file, to which answers are only added. Participants are numbers.

What participants say of themselves lies in tables of its own, which no export reads beside ratings.
"""

from __future__ import annotations

import contextlib
import sqlite3
import time
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from datetime import UTC, datetime
from pathlib import Path

from foten import __version__
from foten.atomic_write import atomic_write
from foten.study.orders import Trial

APPLICATION_ID = 0x666F7465  # "fote"
VERSION = 3  # of the file
TABLES = """
CREATE TABLE study (
    id INTEGER PRIMARY KEY CHECK (id = 1), title TEXT NOT NULL, design TEXT NOT NULL, folder TEXT NOT NULL, seed INTEGER NOT NULL,
    simulated INTEGER NOT NULL CHECK (simulated IN (0, 1)), created TEXT NOT NULL, software TEXT NOT NULL
) STRICT;
CREATE TABLE stimuli (
    texture INTEGER NOT NULL, method INTEGER NOT NULL, texture_key TEXT NOT NULL, method_key TEXT NOT NULL,
    sha256 TEXT NOT NULL, gain_db REAL NOT NULL, PRIMARY KEY (texture, method)
) STRICT;
CREATE TABLE trials (
    participant INTEGER NOT NULL, trial INTEGER NOT NULL, texture INTEGER NOT NULL, method INTEGER NOT NULL, other INTEGER,
    target INTEGER NOT NULL, PRIMARY KEY (participant, trial),
    FOREIGN KEY (texture, method) REFERENCES stimuli (texture, method),
    FOREIGN KEY (texture, other) REFERENCES stimuli (texture, method)
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
    scale TEXT NOT NULL, rating REAL NOT NULL CHECK (rating BETWEEN 0 AND 100), response_s REAL,
    switches INTEGER, measured TEXT NOT NULL,
    at TEXT NOT NULL, software TEXT NOT NULL, simulated INTEGER NOT NULL, corrects INTEGER REFERENCES ratings (id),
    reason TEXT NOT NULL, FOREIGN KEY (participant, trial) REFERENCES trials (participant, trial)
) STRICT;
CREATE UNIQUE INDEX one_rating ON ratings (participant, trial, scale) WHERE corrects IS NULL;
CREATE UNIQUE INDEX one_correction ON ratings (corrects) WHERE corrects IS NOT NULL;
CREATE TABLE strokes (
    participant INTEGER NOT NULL REFERENCES participants (number), trial INTEGER NOT NULL, part INTEGER NOT NULL,
    interval INTEGER NOT NULL, at TEXT NOT NULL, events BLOB NOT NULL, conditions BLOB NOT NULL,
    PRIMARY KEY (participant, trial, part)
) STRICT;
CREATE TABLE switches (
    id INTEGER PRIMARY KEY, participant INTEGER NOT NULL REFERENCES participants (number), trial INTEGER NOT NULL,
    side TEXT NOT NULL, marked_by TEXT NOT NULL, at TEXT NOT NULL
) STRICT;
CREATE TABLE shown (
    participant INTEGER NOT NULL REFERENCES participants (number), trial INTEGER NOT NULL, at REAL NOT NULL,
    PRIMARY KEY (participant, trial)
) STRICT;
CREATE TABLE log (id INTEGER PRIMARY KEY, at TEXT NOT NULL, what TEXT NOT NULL) STRICT;
"""

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
    """Write a new database: the study, its stimuli, and every participant's order.

    Raises:
        ValueError: there is a file already, which may hold answers.
    """
    if path.exists():
        raise ValueError(f"{path} is there already, and may hold answers: go on with it, or give another name")
    study = (title, text, str(folder.resolve()), seed, int(simulated), now(), __version__)
    trials = [(i + 1, *astuple(t)) for i, trials in enumerate(orders) for t in trials]
    with atomic_write(path) as part, contextlib.closing(sqlite3.connect(part)) as connection, connection:
        connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version = {VERSION}")
        connection.executescript(ALL)
        connection.execute("INSERT INTO study VALUES (1, ?, ?, ?, ?, ?, ?, ?)", study)
        connection.executemany("INSERT INTO stimuli VALUES (?, ?, ?, ?, ?, ?)", map(astuple, stimuli))
        connection.executemany("INSERT INTO trials VALUES (?, ?, ?, ?, ?, ?)", trials)
        connection.execute("INSERT INTO log (at, what) VALUES (?, ?)", (now(), f"made by foten {__version__}"))


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
