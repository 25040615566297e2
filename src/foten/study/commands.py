"""`foten study`: a perceptual study, from its file to its report."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from foten.console import JsonOption, check_files, check_folder, folder_option, print_result, refuse, say

if TYPE_CHECKING:
    from foten.study.store import Store

app = typer.Typer(
    help="Design, run and analyse a perceptual study (Sec. VII); 'simulate' tries it without people.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)

StudyFile = Annotated[Path, Argument(metavar="STUDY.toml", help="Study file, as written by 'foten study new'.")]
Database = Annotated[
    Path, Argument(metavar="STUDY.db", help="Database with the answers of a study, as written by 'foten study run'.")
]
Participant = Annotated[int, Option("--participant", min=1, max=10**6, help="Number of the participant.")]
TrialNumber = Annotated[int, Option("--trial", min=0, max=10**6, help="Number of the trial.")]
Sd = Annotated[float, Option(min=0.1, help="Standard deviation of ratings between raters (points).")]
Effect = Annotated[
    float | None,
    Option(
        help="Effect, unless the task is rating: share of choices for the better method (paired, 0.65), d′ (abx, "
        "oddity, 1), or dB that its threshold is lower (3).",
        show_default=False,
    ),
]
Correlation = Annotated[float, Option(min=0, max=0.99, help="Correlation between two ratings by one rater.")]


@app.command()
def new(
    output: Path = Argument(..., metavar="STUDY.toml", help="Study file to write (.toml)."),
    textures: list[Path] = Argument(
        ..., metavar="T.foten…", help="Texture files: two or more methods (models) of each texture."
    ),
    title: str | None = Option(None, help="Title shown to participants.", show_default="the question"),
    task: str = Option("rating", help="Task of each trial: rating, paired, abx, oddity or threshold."),
    language: str = Option("en", help="Language of the participants' pages: en, de, fr, es, ja, ko or zh."),
    participants: int | None = Option(
        None,
        min=1,
        help="Number of participants; by default enough to find the effect that is printed, rounded up to complete "
        "Latin squares.",
    ),
    seed: int = Option(1, min=0, help="Seed of the order of trials."),
) -> None:
    """Write a study file to edit, from texture files; each file's card says which texture and which method it is.

    foten study new similarity.toml denim-ar.foten denim.foten mesh-ar.foten mesh.foten
    """
    from foten.atomic_write import atomic_write
    from foten.recording.recording import counted
    from foten.study.choosers import EFFECTS, participants_for
    from foten.study.design import QUESTIONS, TASKS, files_by_method, study_text
    from foten.study.languages import read_language

    if task not in TASKS:
        raise ValueError(f"--task is {task!r}, expected one of {', '.join(TASKS)}")
    check_files([output])
    if output.exists():
        raise ValueError(f"{output} already exists: edit it, or give another name")
    texts = read_language(language)
    key = QUESTIONS.get("detection" if task == "threshold" else task)
    title = title or (texts.new["title"] if key is None else texts.words[key])
    files, doubts = files_by_method(textures, output.parent, 1 if task == "threshold" else 2)
    for doubt in doubts:
        say(doubt)
    methods = len(next(iter(files.values())))
    if participants is None:
        participants, enough = participants_for(task, methods, len(files))
        found = f"{enough or 'more than 60'} are needed to find {EFFECTS[task]} in 80 % of studies"
        squares = "" if enough is None or enough == participants else f"; {participants} fill complete Latin squares"
        say(f"{counted(participants, 'participant')}: {found}{squares}; details: foten study power")
    with atomic_write(output) as part:
        part.write_text(study_text(title, files, participants, seed, language, task), encoding="utf-8")
    sizes = f"{counted(len(files), 'texture')} × {counted(methods, 'method')}"
    print(f"wrote {output}: {sizes}, {counted(participants, 'participant')}")
    print(f"next: edit it, then foten study check {output}")


@app.command()
def check(study: StudyFile, as_json: JsonOption = False) -> None:
    """Check a study file: texture files, levels, balance of the trial orders, devices, and duration."""
    from foten.recording.recording import counted
    from foten.study.loading import load_study
    from foten.study.orders import balance

    loaded = load_study(study)
    loaded.check_devices()
    design, stimuli = loaded.design, loaded.stimuli
    shape = len(design.textures), len(design.methods)
    spread = balance(loaded.orders()[: design.participants], *shape, design.task.kind)
    of_each = {"rating": "", "threshold": f" × {counted(design.repeats, 'answer')}"}
    of_each |= {kind: f" in pairs × {design.repeats}" for kind in ("paired", "abx", "oddity")}
    sizes = f"{counted(shape[0], 'texture')} × {counted(shape[1], 'method')}{of_each[design.task.kind]}"
    length = "if a trial takes as long as in the paper" if design.task.kind == "rating" else "if a choice takes 20 s"
    real = "must be touched before each rating" if design.setup.real_checked else "whether it is touched is not checked"
    rows = [
        f"{sizes}: {counted(design.n_trials, 'trial')} for each of {counted(design.participants, 'participant')}, "
        f"after {design.practice} for practice",
        *(f"{name}: {low} to {high} times" for name, (low, high) in spread.items()),
        *(f"{s.texture_key}, {s.method_key}: {s.gain_db:+.1f} dB" for s in stimuli.listed),
        *loaded.doubts,
        f"plays through {design.output.to}",
        f"about {counted(design.minutes, 'minute')} for each participant, {length}",
        *([] if design.real_side == "none" else [f"the real surface: {real}"]),
    ]
    document = {
        "task": design.task.kind,
        "trials": design.n_trials,
        "participants": design.participants,
        "balance": spread,
        "gains_db": {f"{s.texture_key}/{s.method_key}": s.gain_db for s in stimuli.listed},
        "doubts": loaded.doubts,
    }
    print_result(document, "\n".join(rows), as_json)


@app.command()
def run(
    study: StudyFile,
    output: Path | None = Option(
        None, "-o", "--output", metavar="STUDY.db", help="Database for the answers; by default beside the study file."
    ),
    host: str = Option(
        "127.0.0.1", help="Address to listen on: 127.0.0.1 for this machine only, 0.0.0.0 for tablets on the network."
    ),
    port: int = Option(8000, min=0, max=65535, help="Port of the pages; 0 chooses a free one."),
    simulated: bool = Option(
        False, "--simulated", help="Programs answer, not people: mark the answers permanently as simulated."
    ),
    lsl: bool = Option(
        False, "--lsl", help="Send markers of trials, contacts and answers through Lab Streaming Layer."
    ),
    open_page: bool = Option(True, "--open/--no-open", help="Open the operator's page in this machine's browser."),
) -> None:
    """Run a study: serve the pages of participants and operator. Ctrl-C stops it; the same command continues it.

    foten study run similarity.toml --host 0.0.0.0
    """
    import webbrowser
    from functools import partial

    from foten.studio.access import Access, Admitted, private_folder
    from foten.studio.web_server import serve
    from foten.study.loading import load_study
    from foten.study.markers import Markers
    from foten.study.study_server import StudyServer

    loaded = load_study(study)
    loaded.check_devices()
    markers = Markers(loaded.design.title) if lsl else None
    database = output or study.with_suffix(".db")
    store = loaded.open_store(database, simulated)
    store.hold()
    folder = private_folder(_devices(database).parent)
    server = StudyServer(store, loaded, Admitted(_devices(database)), markers)
    server.say = say

    def announce(access: Access, host: str, joined: bool) -> None:
        server.link = partial(access.link, host)
        participants, operator = server.link(), server.operator_link
        if joined:
            say(f"a device connected; links for the next one: {participants} or, for the operator, {operator}")
            return
        say(
            f"{loaded.design.title}: {len(store.codes())} of {loaded.design.participants} have started; answers in {database}"
        )
        say("\n".join([*loaded.doubts, f"operator: {operator}", f"participants at {participants}"]))
        if access.token is not None:
            say("each link admits one device; then the next link is printed; the operator's page shows codes to scan")
            say(
                f"admitted devices stay admitted, as {folder} records: whoever reads that folder can impersonate this server"
            )
        say("Ctrl-C stops the study; the same command continues it")
        if open_page and access.token is None:
            webbrowser.open(operator)

    try:
        with loaded.noise() as server.noise:
            serve(server.app, host, port, announce, folder)
    finally:
        store.close()


@app.command()
def status(database: Database, as_json: JsonOption = False) -> None:
    """Print the progress of each participant, and check the database; works while the study runs."""
    from foten.recording.recording import counted

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


@app.command()
def simulate(
    study: StudyFile,
    output: Path = Option(
        ..., "-o", "--output", metavar="STUDY.db", help="New database to write, marked as simulated."
    ),
    difference: float | None = Option(
        None, help="Points (of 100) by which the better method is rated higher, for the task rating.", show_default="10"
    ),
    effect: Effect = None,
    better: str | None = Option(None, metavar="METHOD", help="Key of the better method; by default the last one."),
    sd: Sd = 10.67,
    correlation: Correlation = 0.3,
    missing: float = Option(0.0, min=0, max=0.9, help="Share of raters who leave before the end, e.g. 0.1."),
    seed: int = Option(0, min=0, help="Seed of the raters' answers."),
) -> None:
    """Simulate raters who take part, to try the analysis before inviting people. Their answers are marked as simulated.

    foten study simulate similarity.toml -o simulated.db --difference 10
    """
    from foten.recording.recording import counted
    from foten.study.choosers import DEFAULT_EFFECTS, simulate_study
    from foten.study.loading import load_study
    from foten.study.raters import raters_for

    if output.exists():
        raise ValueError(f"{output} already exists: give another name")
    loaded = load_study(study)
    methods = list(loaded.design.methods)
    if better is not None and better not in methods:
        raise ValueError(f"--better is {better!r}, expected one of {', '.join(methods)}")
    index = -1 if better is None else methods.index(better)
    if (kind := loaded.design.task.kind) == "rating":
        refuse("is of choices and thresholds; of ratings it is --difference", effect=effect)
    else:
        refuse("is of ratings; of choices and thresholds it is --effect", difference=difference)
    difference = 10.0 if difference is None else difference
    raters = raters_for(len(methods), len(loaded.design.textures), difference, sd, correlation, index)
    with loaded.open_store(output, simulated=True) as store:
        effect = DEFAULT_EFFECTS.get(kind, 0.0) if effect is None else effect
        simulate_study(store, loaded.design, raters, effect, index, missing, seed)
        n = len(store.ratings())
    print(f"wrote {output}: {counted(n, 'simulated answer')} from {counted(loaded.design.participants, 'rater')}")
    print(f"next: foten study analyze {output} -o results")


@app.command()
def power(
    study: Path | None = Argument(
        None,
        metavar="[STUDY.toml]",
        help="Study file that gives the task and the numbers of methods, textures and repeats.",
    ),
    methods: int | None = Option(None, min=2, help="Number of methods, without a study file.", show_default="4"),
    textures: int | None = Option(None, min=1, help="Number of textures, without a study file.", show_default="12"),
    difference: float | None = Option(
        None,
        help="Points by which the last method is rated higher; by default the paper's effects (4 methods × 12 "
        "textures), else 8.75.",
    ),
    sd: float | None = Option(
        None, min=0.1, help="Standard deviation of ratings between raters (points).", show_default="10.67"
    ),
    correlation: Correlation = 0.3,
    effect: Effect = None,
    task: str | None = Option(
        None, help="Task, without a study file: rating, paired, abx, oddity or threshold.", show_default="rating"
    ),
    repeats: int | None = Option(
        None, min=1, help="Trials of each pair of methods on each texture, without a study file.", show_default="1"
    ),
    studies: int | None = Option(
        None,
        min=50,
        help="Number of studies to simulate for each number of participants.",
        show_default="500, or 200 where surfaces are chosen",
    ),
    seed: int = Option(0, min=0, help="Seed of the simulation."),
    as_json: JsonOption = False,
) -> None:
    """Estimate how many participants a study needs, by simulating studies.

    foten study power --difference 9
    """
    from foten.recording.recording import counted
    from foten.reporting.table import Table
    from foten.study.choosers import DEFAULT_EFFECTS, threshold_raters
    from foten.study.design import Task, read_design
    from foten.study.raters import PAPER_SD, needed, paper_raters, raters_for

    if study is not None:
        refuse("is in the study file", methods=methods, textures=textures, task=task, repeats=repeats)
        design, _ = read_design(study)
        methods, textures = len(design.methods), len(design.textures)
        task, repeats, of_task = design.task.kind, design.repeats, design.task
    else:
        of_task = Task("threshold")
    methods, textures = methods or 4, textures or 12
    if task in (None, "rating"):
        refuse("is of choices and thresholds; of ratings it is --difference", effect=effect)
    else:
        refuse("is of ratings; of choices and thresholds it is --effect", difference=difference, sd=sd)
    if task not in (None, "rating", "threshold"):
        _print_power_of_choices(task, methods, textures * (repeats or 1), effect, studies or 200, seed, as_json)
        return
    studies = studies or 500
    if task == "threshold":
        db = DEFAULT_EFFECTS[task] if effect is None else effect
        raters, of = (
            threshold_raters(of_task, methods, textures, db, seed),
            f"a difference of {db:g} dB between thresholds",
        )
    elif difference is None and (methods, textures) == (4, 12):
        raters, of = paper_raters(sd or PAPER_SD, correlation), "the paper's effects (Sec. VII)"
    else:
        points = 8.75 if difference is None else difference
        raters = raters_for(methods, textures, points, sd or PAPER_SD, correlation)
        of = f"a difference of {points:g} point{'s' * (points != 1)}"
    table, smallest = needed(raters, studies, seed)
    cells = [[f"{row['participants']:.0f}", *(f"{share:.2f}" for share in list(row.values())[1:])] for row in table]
    sizes = f"{counted(methods, 'method')} × {counted(textures, 'texture')}"
    rows = [f"{of}, {sizes}, sd {raters.sd:.3g}, correlation {raters.correlation:.2g}, α = 0.05"]
    rows += Table.of(table[0], cells).text()
    rows += [
        f"participants needed to find a pair in 80 % of studies: {'more than 60' if smallest is None else smallest}",
        "pair: the last method differs from another on one texture (Holm's adjustment); all pairs: from all on every texture",
    ]
    print_result({"power": table, "participants": smallest}, "\n".join(rows), as_json)


def _print_power_of_choices(
    task: str, methods: int, per_pair: int, effect: float | None, studies: int, seed: int, as_json: bool
) -> None:
    from foten.recording.recording import counted
    from foten.reporting.table import Table
    from foten.study.choosers import DEFAULT_EFFECTS, Choosers, needed

    if task not in ("paired", "abx", "oddity"):
        raise ValueError(f"--task is {task!r}, expected rating, paired, abx, oddity or threshold")
    effect = DEFAULT_EFFECTS[task] if effect is None else effect
    table, smallest = needed(Choosers(task, methods, effect), per_pair, studies, seed)
    cells = [[f"{row['participants']:.0f}", f"{row['any']:.2f}", f"{row['pair']:.2f}"] for row in table]
    what = f"{100 * effect:.0f} % of choices for one method" if task == "paired" else f"d′ = {effect:g}"
    pair = "the better method from another one" if task == "paired" else "two methods"
    rows = [
        f"{what}, {methods} methods, {counted(per_pair, 'trial')} of each pair by each participant, α = 0.05",
        *Table.of(table[0], cells).text(),
        f"participants needed to find a pair in 80 % of studies: {'more than 60' if smallest is None else smallest}",
        f"any: the test of all methods; pair: {pair}, adjusted for all pairs",
    ]
    print_result({"power": table, "participants": smallest}, "\n".join(rows), as_json)


@app.command()
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
    from foten.study.analysis import CORRECTIONS, TooFewError, analyse, read_ratings
    from foten.study.report import write_data, write_report

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


@app.command()
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
    from foten.recording.recording import counted
    from foten.study.record import FORMATS, write_record

    check_folder(output)
    if to not in FORMATS:
        raise ValueError(f"--to is {to!r}, expected {' or '.join(FORMATS)}")
    with _store(database) as store:
        written = write_record(store, to, output)
    print(f"wrote {counted(len(written), 'file')} to {output}")


@app.command()
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
    from foten.recording.recording import counted

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


@app.command()
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
    from foten.study.design import CHOICES, task_of

    with _store(database) as store:
        kind = task_of(str(store.study["design"]))[0].kind
        choices = CHOICES.get(kind, ())
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


@app.command()
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
    if code is not None and (devices := _devices(database)).exists():
        Admitted(devices).drop(f"{code} ")
    print(f"all data of participant {participant} was removed from {database}; backups still hold it")


@app.command()
def backup(
    database: Database, output: Path = Option(..., "-o", "--output", metavar="COPY.db", help="Copy to write (.db).")
) -> None:
    """Copy a study's database; works while the study runs."""
    from foten.recording.recording import counted

    check_files([output])
    with _store(database) as store:
        n = store.backup(output)
    print(f"wrote {output}: {counted(n, 'rating')}, all checks passed")


def _devices(database: Path) -> Path:
    """File of the devices that were let in, by hashes, beside a study's database."""
    return database.with_suffix(".access") / "devices.json"


@contextlib.contextmanager
def _store(database: Path) -> Iterator[Store]:
    from foten.study.store import Store

    with Store(database) as store:
        try:
            yield store
        except (ArithmeticError, LookupError, TypeError) as error:
            raise ValueError(f"{database.name}: rows that do not fit ({error!r}); were they edited?") from error
