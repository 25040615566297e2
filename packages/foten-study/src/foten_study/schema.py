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
from foten_study.orders import Trial

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
