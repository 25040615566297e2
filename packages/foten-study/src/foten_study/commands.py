"""`foten study`: a perceptual study, from its file to its answers; `data_commands` go on from there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from foten.console import JsonOption, check_files, print_result, refuse, say
from foten.recording.recording import counted
from foten_study.data_commands import analyze, backup, correct, devices_file, export, forget, status, strokes

if TYPE_CHECKING:
    from foten.studio.access import Access
    from foten_study.tasks.kind import TaskKind

app = typer.Typer(
    help="Design, run and analyse a perceptual study (Sec. VII); 'simulate' tries it without people.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)
StudyFile = Annotated[Path, Argument(metavar="STUDY.toml", help="Study file, as written by 'foten study new'.")]
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
    from foten_study.languages import read_language
    from foten_study.planning import files_by_method, participants_for, study_text
    from foten_study.tasks.kind import Task
    from foten_study.tasks.table import TASKS

    if task not in TASKS:
        raise ValueError(f"--task is {task!r}, expected one of {', '.join(TASKS)}")
    check_files([output])
    if output.exists():
        raise ValueError(f"{output} already exists: edit it, or give another name")
    texts = read_language(language)
    kind = TASKS[task]
    title = title or (texts.words[kind.question(Task(task))] if kind.choices else texts.new["title"])
    files, doubts = files_by_method(textures, output.parent, kind.min_methods)
    for doubt in doubts:
        say(doubt)
    methods = len(next(iter(files.values())))
    if participants is None:
        participants, enough = participants_for(task, methods, len(files))
        found = f"{enough or 'more than 60'} are needed to find {kind.effect_in_words} in 80 % of studies"
        squares = "" if enough is None or enough == participants else f"; {participants} fill complete Latin squares"
        say(f"{counted(participants, 'participant')}: {found}{squares}; details: foten study power")
    with atomic_write(output) as part:
        part.write_text(study_text(title, files, participants, seed, language, task), encoding="utf-8")
    sizes = f"{counted(len(files), 'texture')} × {counted(methods, 'method')}"
    print(f"wrote {output}: {sizes}, {counted(participants, 'participant')}")
    print(f"next: edit it, then foten study check {output}")


def check(study: StudyFile, as_json: JsonOption = False) -> None:
    """Check a study file: texture files, levels, balance of the trial orders, devices, and duration."""
    from foten_study.loading import load_study
    from foten_study.orders import balance

    loaded = load_study(study)
    loaded.check_devices()
    design, stimuli = loaded.design, loaded.stimuli
    shape = len(design.textures), len(design.methods)
    spread = balance(loaded.orders()[: design.participants], *shape, design.kind.order)
    order = design.kind.order
    of_each = f" in pairs × {design.repeats}" if order.pairs else ""
    if order.rounds:
        of_each = f" × {counted(design.repeats, 'answer')}"
    sizes = f"{counted(shape[0], 'texture')} × {counted(shape[1], 'method')}{of_each}"
    length = "if a choice takes 20 s" if design.kind.choices else "if a trial takes as long as in the paper"
    real = "must be touched before each rating" if design.setup.real_checked else "whether it is touched is not checked"
    rows = [
        f"{sizes}: {counted(design.n_trials, 'trial')} for each of {counted(design.participants, 'participant')}, "
        f"after {design.practice} for practice",
        *(f"{name}: {low} to {high} times" for name, (low, high) in spread.items()),
        *(f"{s.texture_key}, {s.method_key}: {s.gain_db:+.1f} dB" for s in stimuli),
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
        "gains_db": {f"{s.texture_key}/{s.method_key}": s.gain_db for s in stimuli},
        "doubts": loaded.doubts,
    }
    print_result(document, "\n".join(rows), as_json)


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
    from foten_study.loading import load_study
    from foten_study.planning import simulate_study

    if output.exists():
        raise ValueError(f"{output} already exists: give another name")
    loaded = load_study(study)
    methods = list(loaded.design.methods)
    if better is not None and better not in methods:
        raise ValueError(f"--better is {better!r}, expected one of {', '.join(methods)}")
    index = -1 if better is None else methods.index(better)
    kind = loaded.design.kind
    _refuse_other_effect(kind, effect=effect, difference=difference)
    if not kind.choices:
        effect = 10.0 if difference is None else difference
    people = {"effect": effect, "sd": sd, "correlation": correlation, "better": index}
    with loaded.open_store(output, simulated=True) as store:
        simulate_study(store, loaded.design, missing, seed, **people)
        n = len(store.ratings())
    print(f"wrote {output}: {counted(n, 'simulated answer')} from {counted(loaded.design.participants, 'rater')}")
    print(f"next: foten study analyze {output} -o results")


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
    from foten.reporting.table import Table
    from foten_study.design import read_design
    from foten_study.tasks.kind import PAPER_SD, Plan, Task
    from foten_study.tasks.table import TASKS

    if study is not None:
        refuse("is in the study file", methods=methods, textures=textures, task=task, repeats=repeats)
        design, _ = read_design(study)
        methods, textures, of_task = len(design.methods), len(design.textures), design.task
    elif task not in (None, *TASKS):
        *names, last = TASKS
        raise ValueError(f"--task is {task!r}, expected {', '.join(names)} or {last}")
    else:
        of_task = Task(task or "rating", repeats=repeats or 1)
    kind = TASKS[of_task.kind]
    _refuse_other_effect(kind, effect=effect, difference=difference, sd=sd)
    size = effect if kind.choices else difference
    plan = Plan(of_task, methods or 4, textures or 12, size, sd or PAPER_SD, correlation)
    answer = kind.power(plan, studies or kind.n_studies[0], seed)
    cells = [[f"{row['participants']:.0f}", *(f"{share:.2f}" for share in [*row.values()][1:])] for row in answer.table]
    needed = "more than 60" if answer.needed is None else answer.needed
    rows = [
        answer.heading,
        *Table.of(answer.table[0], cells).text(),
        f"participants needed to find a pair in 80 % of studies: {needed}",
        answer.note,
    ]
    print_result({"power": answer.table, "participants": answer.needed}, "\n".join(rows), as_json)


def _refuse_other_effect(kind: TaskKind, effect: float | None, **of_ratings: float | None) -> None:
    """Refuse what has no effect on a task: ratings differ by points, the others by an effect of their own."""
    if kind.choices:
        refuse("is of ratings; of choices and thresholds it is --effect", **of_ratings)
    else:
        refuse("is of choices and thresholds; of ratings it is --difference", effect=effect)


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

    from foten.studio.access import Admitted, private_folder
    from foten.studio.web_server import serve
    from foten_study.loading import Markers, load_study
    from foten_study.study_server import StudyServer

    loaded = load_study(study)
    loaded.check_devices()
    markers = Markers(loaded.design.title) if lsl else None
    database = output or study.with_suffix(".db")
    store = loaded.open_store(database, simulated)
    store.hold()
    folder = private_folder(devices_file(database).parent)
    server = StudyServer(store, loaded, Admitted(devices_file(database)), markers)
    server.participants.say = say

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


# In the order in which --help lists them.
for _command in (new, check, run, status, simulate, power, analyze, export, strokes, correct, forget, backup):
    app.command()(_command)
