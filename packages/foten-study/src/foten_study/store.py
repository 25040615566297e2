"""A study's database while it is read and written. A commit that returned has reached the disk."""

import hashlib
import json
import sqlite3
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten import __version__
from foten.untrusted import brief, check_numbers, parse_json
from foten_study.orders import Trial
from foten_study.study_file import MAX_VALUE, VALID_RATINGS, Stimulus, StudyFile, as_stored, now
from foten_study.tasks.kind import Rated

RATED = "participant, trial, scale, rating, response_s, switches, measured, at, software, simulated, corrects, reason"
MAX_APART_S = 0.25  # of two events of one contact: a pen at rest sends few
NO_CONDITIONS: NDArray[np.float64] = np.zeros((0, 2))


@dataclass(frozen=True)
class Stroked:
    """Part of a trial's contact, on one of its surfaces."""

    interval: int
    events: NDArray[np.float64]  # of the pen: x, y [mm], pressure, t [s], shape (n, 4)
    # Speed [mm/s], force [N] at each block's end, shape (n, 2).
    conditions: NDArray[np.float64] = field(default_factory=lambda: NO_CONDITIONS)
    at_s: float = 0.0  # when it was stored, the system's clock


class Store(StudyFile):
    """An open study: who takes part, what they were asked, and what they answered."""

    def join(self, code: str) -> int:
        """Add a participant under a code; the next free number, or ValueError where all have begun."""
        with self._writing():
            taken = set(self.codes().values())
            number = next((n for n in self.ordered() if n not in taken), None)
            if number is None:
                raise ValueError(f"all {len(taken)} participants of the design have begun; a larger study is a new one")
            self._execute("INSERT INTO participants VALUES (?, ?, ?, ?)", number, code, now(), int(self.simulated))
        return number

    def return_place(self, participant: int) -> None:
        """Let the next one to join have the number of a participant without any data; with some, sqlite3.IntegrityError."""
        with self._writing():
            self._execute("DELETE FROM participants WHERE number = ?", participant)
            self._log(f"the place of participant {participant} was returned, without an answer")

    def ordered(self) -> list[int]:
        """Numbers for which an order of trials is stored."""
        return [row[0] for row in self._rows("SELECT DISTINCT participant FROM trials ORDER BY participant")]

    def codes(self) -> dict[str, int]:
        """Participants who have begun, by code."""
        return {row["code"]: row["number"] for row in self._rows("SELECT * FROM participants ORDER BY number")}

    def trials(self, participant: int) -> list[Trial]:
        """Trials of a participant in their order."""
        rows = self._rows(
            "SELECT trial, texture, method, other, target FROM trials WHERE participant = ? ORDER BY trial", participant
        )
        return [Trial(*row) for row in rows]

    def stimuli(self) -> dict[tuple[int, int], Stimulus]:
        """Stimuli by texture and method."""
        return {(row["texture"], row["method"]): Stimulus(*row) for row in self._rows("SELECT * FROM stimuli")}

    def done(self, participant: int) -> set[str]:
        """Steps that a participant has completed."""
        return {str(row[0]) for row in self._rows("SELECT step FROM steps WHERE participant = ?", participant)}

    def take_step(
        self,
        participant: int,
        step: str,
        rated: tuple[int, Rated] | None = None,
        answers: Mapping[str, str] | None = None,
        private: Mapping[str, str] | None = None,
        consent: str | None = None,
    ) -> bool:
        """Store a step with the outcome of its trial by number, answers by question, or the text that was agreed to.

        False where it was stored before, and nothing changes; FullError where the disk has no room.
        """
        at = now()
        with self._writing():
            if not self._execute("INSERT OR IGNORE INTO steps VALUES (?, ?, ?)", participant, step, at).rowcount:
                return False
            if rated is not None:
                self._add_rating(participant, *rated, at)
            for table, by_question in (("answers", answers), ("abouts", private)):
                for question, answer in (by_question or {}).items():
                    self._execute(f"INSERT INTO {table} VALUES (?, ?, ?, ?)", participant, question, answer, at)
            if consent is not None:
                digest = hashlib.sha256(consent.encode()).hexdigest()
                self._execute("INSERT INTO consents VALUES (?, ?, ?)", participant, at, digest)
        return True

    def take_steps(self, participant: int, rated: Mapping[str, Rated]) -> None:
        """Store many trials of a simulated rater at once, by step."""
        at = now()
        with self._writing():
            for step, outcome in rated.items():
                self._execute("INSERT INTO steps VALUES (?, ?, ?)", participant, step, at)
                self._add_rating(participant, int(step.removeprefix("trial:")), outcome, at)

    def _add_rating(self, participant: int, trial: int, rated: Rated, at: str) -> None:
        log = json.dumps(dict(rated.log), allow_nan=False)
        about = (rated.response_s, rated.switches, log, at, __version__, self.simulated)
        for scale, value in rated.values.items():
            self._execute(
                f"INSERT INTO ratings ({RATED}) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, NULL, '')",
                *(participant, trial, scale, value, *about),
            )

    def correct(self, participant: int, trial: int, rating: float, reason: str, scale: str | None = None) -> None:
        """Put another rating, of a scale where a trial has several, in the place of the valid one; the old row stays.

        ValueError where that trial has no rating, or several, the new one is out of range, or the reason is empty.
        """
        if not 0 <= rating <= 100:
            raise ValueError(f"the rating is {rating:g}, expected 0 to 100")
        if not reason.strip():
            raise ValueError("a correction needs a reason")
        rated = f"({VALID_RATINGS}) WHERE participant = ? AND trial = ?"
        scales = [str(row[0]) for row in self._rows(f"SELECT scale FROM {rated}", participant, trial)]
        if scale is None and len(scales) > 1:
            raise ValueError(f"trial {trial} has a rating on each of {', '.join(scales)}: which one?")
        with self._writing():
            corrected = self._execute(
                f"INSERT INTO ratings ({RATED}) SELECT participant, trial, scale, ?, response_s, switches, measured, ?, ?, "
                f"simulated, id, ? FROM {rated} AND scale = ?",
                *(rating, now(), __version__, reason, participant, trial, scale or "".join(scales)),
            )
            if not corrected.rowcount:
                of = f"trial {trial}" if scale is None else f"trial {trial} on the scale {scale!r}"
                raise ValueError(f"participant {participant} has no rating of {of}")
            self._log(f"participant {participant}, trial {trial}: corrected to {rating:g}: {reason}")

    def add_switch(self, participant: int, trial: int, side: str, marked_by: str, at_s: float) -> None:
        """Store that a hand went over to the real or the virtual surface, and when [s, the system's clock]."""
        at = as_stored(at_s)
        with self._writing():
            self._execute("INSERT INTO switches VALUES (NULL, ?, ?, ?, ?, ?)", participant, trial, side, marked_by, at)

    def add_shown(self, participant: int, trial: int, at: float) -> None:
        """Store since when a trial is shown [s, the system's clock], the first time."""
        with self._writing():
            self._execute("INSERT OR IGNORE INTO shown VALUES (?, ?, ?)", participant, trial, at)

    def shown(self, participant: int, trial: int) -> float | None:
        """Since when a trial has been shown [s, the system's clock]; None where it has not."""
        rows = self._rows("SELECT at FROM shown WHERE participant = ? AND trial = ?", participant, trial)
        return float(rows[0]["at"]) if rows else None

    def switches(self, participant: int, trial: int) -> list[str]:
        """Surfaces that a hand went over to in a trial, in order."""
        query = "SELECT side FROM switches WHERE participant = ? AND trial = ? ORDER BY id"
        return [str(row["side"]) for row in self._rows(query, participant, trial)]

    def add_strokes(self, participant: int, trial: int, parts: Sequence[Stroked]) -> None:
        """Store parts of a trial's contact, all or none."""
        with self._writing():
            for part in parts:
                self._execute(
                    "INSERT INTO strokes SELECT ?, ?, coalesce(max(part) + 1, 0), ?, ?, ?, ? FROM strokes "
                    "WHERE participant = ? AND trial = ?",
                    *(participant, trial, part.interval, now(), _packed(part.events), _packed(part.conditions)),
                    *(participant, trial),
                )

    def strokes(self, participant: int, trial: int) -> NDArray[np.float64]:
        """Events of a trial: x, y [mm], pressure, t [s], shape (n, 4)."""
        return np.concatenate([np.zeros((0, 4)), *(part.events for part in self.parts(participant, trial))])

    def parts(self, participant: int, trial: int) -> list[Stroked]:
        """Parts of a trial's contact, in their order."""
        parts, remaining_bytes = [], MAX_VALUE
        query = "SELECT * FROM strokes WHERE participant = ? AND trial = ? ORDER BY part"
        for row in self._rows(query, participant, trial):
            try:
                events = _unpacked(row["events"], 4, remaining_bytes)
                conditions = _unpacked(row["conditions"], 2, remaining_bytes - events.nbytes)
            except (ValueError, zlib.error) as error:
                where = f"{self.path.name}, participant {participant}, trial {trial}"
                raise ValueError(f"{where}: a stroke is damaged ({error})") from error
            remaining_bytes -= events.nbytes + conditions.nbytes
            parts.append(Stroked(int(row["interval"]), events, conditions, _seconds(row["at"])))
        return parts

    def moments(self, participant: int, table: str) -> list[dict[str, Any]]:
        """Rows of a participant in `ratings`, `switches` or `shown`, with `at_s` [s, system's clock]; of ratings the first."""
        first = " AND corrects IS NULL" if table == "ratings" else ""
        rows = self._rows(f"SELECT * FROM {table} WHERE participant = ?{first} ORDER BY at", participant)
        return [{**dict(row), "at_s": _seconds(row["at"])} for row in rows]

    def ratings(self) -> list[dict[str, Any]]:
        """Valid ratings without practice: participant, trial, scale, texture, method and other (as numbers and as keys), target,
        rating, response_s, switches, measured, simulated, sha256, corrected.
        """
        rows = self._rows(
            "SELECT r.*, t.texture, t.method, t.other, t.target, s.texture_key, s.method_key, s.sha256, "
            f"o.method_key AS other_key FROM ({VALID_RATINGS}) r "
            "JOIN trials t ON t.participant = r.participant AND t.trial = r.trial "
            "JOIN stimuli s ON s.texture = t.texture AND s.method = t.method "
            "LEFT JOIN stimuli o ON o.texture = t.texture AND o.method = t.other "
            "WHERE r.trial > 0 ORDER BY r.participant, r.trial, r.id"
        )
        return [{**dict(row), "measured": measured_of(row), "corrected": row["corrects"] is not None} for row in rows]

    def levels(self, participant: int, texture: int, method: int) -> list[tuple[float, bool]]:
        """Levels [dB] that a participant's threshold was asked at so far, and whether each answer was right."""
        rows = self._rows(
            "SELECT r.rating, r.measured, t.target FROM ratings r "
            "JOIN trials t ON t.participant = r.participant AND t.trial = r.trial "
            "WHERE r.corrects IS NULL AND r.participant = ? AND t.texture = ? AND t.method = ? AND r.trial > 0 ORDER BY r.trial",
            *(participant, texture, method),
        )
        return [(float(measured_of(row)["level_db"]), row["rating"] == row["target"]) for row in rows]

    def counts(self) -> dict[int, dict[str, Any]]:
        """By participant: code, number of rated trials, when they joined and when the last answer came."""
        rows = self._rows(
            "SELECT p.number, p.code, p.joined, "
            "(SELECT count(DISTINCT r.trial) FROM ratings r WHERE r.participant = p.number AND r.corrects IS NULL "
            "AND r.trial > 0) AS n, "
            "(SELECT max(at) FROM steps s WHERE s.participant = p.number) AS last, "
            "(SELECT count(*) FROM steps s WHERE s.participant = p.number AND s.step = 'end') AS ended "
            "FROM participants p ORDER BY p.number"
        )
        return {int(row["number"]): dict(row) for row in rows}

    def answers(self) -> list[dict[str, Any]]:
        """Answers to the questions that are not private."""
        return [dict(row) for row in self._rows("SELECT * FROM answers ORDER BY participant, rowid")]

    def abouts(self) -> list[dict[str, Any]]:
        """Answers to the private questions, in an order that is not the participants' and without their numbers."""
        return [dict(row) for row in self._rows("SELECT question, answer FROM abouts ORDER BY question, answer")]


def measured_of(row: Mapping[str, Any] | sqlite3.Row) -> dict[str, Any]:
    """What was measured in a trial, of a row of `ratings`; ValueError where it is damaged."""
    try:
        measured = parse_json(row["measured"])
        check_numbers(measured, "it")
        return dict(measured.items())
    except (AttributeError, ValueError) as error:
        where = f"participant {row['participant']}, trial {row['trial']}"
        raise ValueError(f"{where}: what was measured is damaged ({brief(error)})") from error


def _seconds(at: str | float) -> float:
    """A stored time as seconds of the system's clock."""
    return at if isinstance(at, float) else datetime.fromisoformat(at).timestamp()


def _packed(array: NDArray[np.float64]) -> bytes:
    return zlib.compress(np.ascontiguousarray(array, dtype="<f8").tobytes())


def _unpacked(part: bytes, n_columns: int, max_bytes: int) -> NDArray[np.float64]:
    inflater = zlib.decompressobj()
    inflated = inflater.decompress(part, max_bytes + 1)
    if not inflater.eof:
        raise ValueError("it is too long, or cut off")
    rows = np.frombuffer(inflated, dtype="<f8").reshape(-1, n_columns)
    if not np.isfinite(rows).all():
        raise ValueError("its numbers are not finite")
    return rows
