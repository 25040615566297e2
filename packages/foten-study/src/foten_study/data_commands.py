"""Commands of `foten study` on a database of answers."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from foten.console import JsonOption, check_files, check_folder, folder_option, print_result, say
from foten.recording.recording import counted

if TYPE_CHECKING:
    from foten_study.store import Store

Database = Annotated[
    Path, Argument(metavar="STUDY.db", help="Database with the answers of a study, as written by 'foten study run'.")
]
Participant = Annotated[int, Option("--participant", min=1, max=10**6, help="Number of the participant.")]
TrialNumber = Annotated[int, Option("--trial", min=0, max=10**6, help="Number of the trial.")]


def status(database: Database, as_json: JsonOption = False) -> None:
    """Print the progress of each participant, and check the database; works while the study runs."""

    with _store(database) as store:
        counts, faults, log = store.counts(), store.check(), store.log()
        kind, n = "simulated rater" if store.simulated else "participant", sum(count["n"] for count in counts.values())
        trials = sum(trial.number > 0 for first in store.ordered()[:1] for trial in store.trials(first))
        rows = [f"{store.study['title']}: {counted(len(counts), kind)}, {counted(n, 'rating')}"]
        for number, row in counts.items():
            last = (row["last"] or row["joined"])[:16].replace("T", " ")
            rows.append(f"{number:4d}  {row['code']}  {row['n']:3d} of {trials}  last {last}")
        rows += faults or ["the file is intact: it passes all checks of SQLite, and no trial is rated twice"]
        document = {
            "title": store.study["title"],
            "simulated": store.simulated,
            "participants": {str(n): count for n, count in counts.items()},
            "wrong": faults,
            "log": log,
        }
    print_result(document, "\n".join(rows), as_json)
    if faults:
        raise typer.Exit(1)


def analyze(
    database: Database,
    output: Annotated[Path, folder_option("Folder for report, figures and tables; created if missing.")] = Path(
        "results"
    ),
    reference: str | None = Option(
        None, metavar="METHOD", help="Compare the other methods with this one only; by default all pairs."
    ),
    correction: str = Option(
        "bonferroni", help="Correction for multiple tests of the stars in Fig. 9: bonferroni (as in the paper) or holm."
    ),
    as_json: JsonOption = False,
) -> None:
    """Analyse the answers of a study: statistics, figures, tidy tables and a report. Below three participants, only the tables.

    Ratings, thresholds: ANOVA, paired and rank tests, a mixed model, reliability. Paired comparisons: strengths. ABX, oddity: d′.

    foten study analyze similarity.db -o results
    """
    from foten_study.analysis import TooFewError, analyse, read_ratings
    from foten_study.report import write_data, write_report
    from foten_study.results import CORRECTIONS

    check_folder(output)
    if correction not in CORRECTIONS:
        raise ValueError(f"--correction is {correction!r}, expected {' or '.join(CORRECTIONS)}")
    with _store(database) as store:
        try:
            results = analyse(store, reference, correction)
        except TooFewError as error:
            written = write_data(read_ratings(store), output)
            say(f"wrote {', '.join(str(path) for path in written)}")
            say(f"no report: {error}")
            return
    written = write_report(results, output)
    say(f"wrote {', '.join(str(path) for path in written)}")
    document = {result.ratings.key: result.document for result in results}
    print_result(document, "\n".join(sentence for result in results for sentence in result.sentences), as_json)


def export(
    database: Database,
    output: Annotated[Path, folder_option("Folder for the data set; created if missing.")] = Path("dataset"),
    to: str = Option(
        "psych-ds",
        help="Format: psych-ds (tidy tables with the meaning of each column) or bids (events of each participant).",
    ),
) -> None:
    """Export a study as a data set for an archive; possible from the first answer on.

    foten study export similarity.db -o dataset
    """
    from foten_study.record import FORMATS, write_record

    check_folder(output)
    if to not in FORMATS:
        raise ValueError(f"--to is {to!r}, expected {' or '.join(FORMATS)}")
    with _store(database) as store:
        written = write_record(store, to, output)
    print(f"wrote {counted(len(written), 'file')} to {output}")


def strokes(
    database: Database,
    participant: Participant,
    trial: TrialNumber,
    surface: int | None = Option(None, min=1, max=3, help="Number of the surface, if the trial has several."),
    output: Path = Option(..., "-o", "--output", metavar="S.csv", help="Table to write (.csv): t, x, y, pressure."),
) -> None:
    """Write a participant's stroke on the virtual surface in a trial, as a table for 'foten render --stroke'.

    foten study strokes similarity.db --participant 3 --trial 7 -o stroke.csv
    """
    import csv

    import numpy as np

    from foten.atomic_write import atomic_write

    check_files([output])
    with _store(database) as store:
        parts = [part for part in store.parts(participant, trial) if len(part.events)]
        rows = [row for row in store.ratings() if (row["participant"], row["trial"]) == (participant, trial)]
        log = [row["measured"] for row in rows if "newtons" in row["measured"]]
        curve = [f"{measured['newtons']:g},{measured['steepness']:g}" for measured in log]
    surfaces = sorted({part.interval + 1 for part in parts})
    if surface is None and len(surfaces) > 1:
        raise ValueError(f"surfaces {', '.join(map(str, surfaces))} were stroked in that trial: which one? --surface 1")
    events = np.concatenate(
        [np.zeros((0, 4)), *(part.events for part in parts if surface in (None, part.interval + 1))]
    )
    if not len(events):
        of = "" if surface is None else f" on surface {surface}"
        raise ValueError(f"there is no stroke of participant {participant} in trial {trial}{of}")
    with atomic_write(output) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("t", "x", "y", "pressure"))
        writer.writerows([f"{value:.6f}" for value in (t - events[0, 3], x, y, p)] for x, y, p, t in events)
    print(f"wrote {output}: {counted(len(events), 'event')}, {events[-1, 3] - events[0, 3]:.1f} s")
    if curve:
        print(f"to render with this tablet's force: foten render --stroke {output} --pressure {curve[0]}")


def correct(
    database: Database,
    participant: Participant,
    trial: TrialNumber,
    rating: float | None = Option(None, help="Rating that was meant (0 to 100)."),
    choice: str | None = Option(None, help="Surface that was meant, if the task is to choose one: A, B, 1, 2 or 3."),
    scale: str | None = Option(None, metavar="KEY", help="Key of the rating's scale, if a trial has several."),
    reason: str = Option(..., help="Reason, stored with the correction."),
) -> None:
    """Replace a wrong answer by the right one. The old one stays in the file.

    foten study correct similarity.db --participant 3 --trial 7 --rating 40 --reason "read the scale the wrong way round"
    """
    from foten_study.design import task_of
    from foten_study.tasks.table import TASKS

    with _store(database) as store:
        kind = task_of(str(store.study["design"])).kind
        choices = TASKS[kind].choices
        if (rating is None) == (choice is None) or (choice is None) == bool(choices):
            raise ValueError(
                f"the task is {kind}, expected {'--choice ' + ', '.join(choices) if choices else '--rating'}"
            )
        if choice is not None and choice.upper() not in choices:
            raise ValueError(f"--choice is {choice!r}, expected one of {', '.join(choices)}")
        value = choices.index(choice.upper()) if choice is not None else rating
        assert value is not None
        store.correct(participant, trial, float(value), reason, scale)
    print(f"participant {participant}, trial {trial}: the answer is now {choice or f'{rating:g}'}")


def forget(
    database: Database,
    participant: Participant,
    yes: bool = Option(False, "--yes", help="Do not ask for confirmation."),
) -> None:
    """Remove all data of one participant from a study's database, permanently. Backups are not changed."""
    from foten.studio.access import Admitted

    with _store(database) as store:
        if not yes and not typer.confirm(f"Remove all data of participant {participant} permanently?", err=True):
            raise typer.Abort
        code = next((code for code, number in store.codes().items() if number == participant), None)
        store.forget(participant)
    if code is not None and (devices := devices_file(database)).exists():
        Admitted(devices).drop(f"{code} ")
    print(f"all data of participant {participant} was removed from {database}; backups still hold it")


def backup(
    database: Database, output: Path = Option(..., "-o", "--output", metavar="COPY.db", help="Copy to write (.db).")
) -> None:
    """Copy a study's database; works while the study runs."""

    check_files([output])
    with _store(database) as store:
        n = store.backup(output)
    print(f"wrote {output}: {counted(n, 'rating')}, all checks passed")


def devices_file(database: Path) -> Path:
    """File of the devices that were let in, by hashes, beside a study's database."""
    return database.with_suffix(".access") / "devices.json"


@contextlib.contextmanager
def _store(database: Path) -> Iterator[Store]:
    from foten_study.store import Store

    with Store(database) as store:
        try:
            yield store
        except (ArithmeticError, LookupError, TypeError) as error:
            raise ValueError(f"{database.name}: rows that do not fit ({error!r}); were they edited?") from error
