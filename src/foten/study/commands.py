"""`foten study`: a perceptual study, from its design to its report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from foten.console import JsonOption, check_folders, folder_option, print_result, say

if TYPE_CHECKING:
    from foten.study.design import Design
    from foten.study.store import Store

app = typer.Typer(
    help="A perceptual study (Sec. VII): new, check, run, analyze; simulate tries it without people.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)

MINUTES_A_TRIAL = 90 / 48  # Sec. VII: 90 minutes for 48 comparisons

StudyFile = Annotated[Path, Argument(metavar="STUDY.toml", help="A study file, as 'foten study new' writes it.")]
Database = Annotated[
    Path, Argument(metavar="STUDY.db", help="The ratings of a study, as 'foten study run' keeps them.")
]
Participant = Annotated[int, Option("--participant", min=1, help="Number of the participant.")]


@app.command()
def new(
    output: Annotated[Path, Argument(metavar="STUDY.toml", help="The study file to write.")],
    textures: Annotated[
        list[Path], Argument(metavar="T.foten…", help="Texture files: two methods or more of each texture.")
    ],
    title: Annotated[str, Option(help="Shown to participants.")] = "How similar are these surfaces?",
    participants: Annotated[
        int | None,
        Option(min=1, help="How many; by default as many as a difference of 8.75 points needs, in whole squares."),
    ] = None,
    seed: Annotated[int, Option(min=0, help="Of the order of trials.")] = 1,
) -> None:
    """Write a study file to edit, from texture files: which texture and which method each is, its card says.

    foten study new similarity.toml denim-ar.foten denim.foten mesh-ar.foten mesh.foten
    """
    from foten.atomic_write import atomic_write
    from foten.study.design import template
    from foten.study.orders import square
    from foten.study.raters import SMALLEST, needed, raters_for

    check_folders([output])
    if output.exists():
        raise ValueError(f"{output} is there already: edit it, or give another name")
    several = _by_method(textures, output.parent)
    methods = len(next(iter(several.values())))
    if participants is None:
        _, smallest = needed(raters_for(methods, len(several), SMALLEST), 300, 0)
        whole = square(len(several), methods)
        participants = -(-(smallest or 40) // whole) * whole if whole <= 48 else smallest or 40
        why = f"a difference of {SMALLEST:g} points on a texture is found in 80 % of studies of that size"
        say(f"{participants} participants: {why}; foten study power says more")
    with atomic_write(output) as part:
        part.write_text(template(title, several, participants, seed), encoding="utf-8")
    print(f"wrote {output}: {len(several)} textures × {methods} methods, {participants} participants")
    print(f"next: edit it, then foten study check {output}")


@app.command()
def check(study: StudyFile, as_json: JsonOption = False) -> None:
    """Check a study file: texture files, levels, balance of the orders, devices, and how long it takes."""
    from foten.study.orders import balance, planned

    design, _, stimuli, wired = _loaded(study)
    if wired is not None:
        wired.check()
    _check_noise(design)
    made = planned(
        design.participants, len(design.textures), len(design.methods), design.seed, design.practice, design.order
    )
    spread = balance(made[: design.participants], len(design.textures), len(design.methods))
    many = f"{len(design.textures)} textures × {len(design.methods)} methods: {design.n_trials} trials"
    rows = [
        f"{many} of each of {design.participants} participants, {design.practice} of practice before",
        *(f"{name}: {low} to {high} times" for name, (low, high) in spread.items()),
        *(f"{s.texture_key}, {s.method_key}: {s.gain_db:+.1f} dB" for s in stimuli.listed),
        *stimuli.doubts,
        f"plays through {design.output.to}",
        f"about {design.n_trials * MINUTES_A_TRIAL:.0f} minutes of each participant, where a trial is as long as the paper's",
    ]
    document = {
        "trials": design.n_trials,
        "participants": design.participants,
        "balance": spread,
        "gains_db": {f"{s.texture_key}/{s.method_key}": s.gain_db for s in stimuli.listed},
        "doubts": stimuli.doubts,
    }
    print_result(document, "\n".join(rows), as_json)


@app.command()
def run(
    study: StudyFile,
    output: Annotated[
        Path | None, Option("-o", "--output", metavar="STUDY.db", help="Where answers are kept; beside the study file.")
    ] = None,
    host: Annotated[
        str, Option(help="Address to listen at: 127.0.0.1 for this machine alone, 0.0.0.0 for tablets on the network.")
    ] = "127.0.0.1",
    port: Annotated[int, Option(min=0, max=65535, help="0 for any that is free.")] = 8000,
    simulated: Annotated[
        bool, Option("--simulated", help="Those who answer are programs: the ratings are marked as simulated for ever.")
    ] = False,
    open_page: Annotated[
        bool, Option("--open/--no-open", help="Open the operator's page in this machine's browser.")
    ] = True,
) -> None:
    """Run a study: participants' pages and the operator's. Ctrl-C ends it; the same command goes on where it was.

    foten study run similarity.toml --host 0.0.0.0
    """
    from foten.studio.access import Access
    from foten.studio.web_server import serve as serve_study
    from foten.study.study_server import StudyServer

    design, _, stimuli, wired = _loaded(study)
    database = output or study.with_suffix(".db")
    _check_noise(design)
    store = _opened(study, database, simulated)
    store.hold()
    server = StudyServer(store, design, stimuli, wired)

    def links(access: Access, shown: str) -> tuple[str, str]:
        base, _, token = access.link(shown).partition("?")

        def link(page: str, query: str) -> str:
            whole = "&".join(part for part in (token, query) if part)
            return base + page + (f"?{whole}" if whole else "")

        server.link = lambda query: link("", query)
        return link("", ""), link("operator", f"key={server.operator_key}")

    def on_start(access: Access, shown: str) -> None:
        participants, operator = links(access, shown)
        say(f"{design.title}: {len(store.codes())} of {design.participants} have begun; answers are kept in {database}")
        for doubt in stimuli.doubts:
            say(doubt)
        say(f"operator: {operator}")
        say(f"participants at {participants}")
        if access.token is not None:
            say("each link lets one device in; the next is printed then, and the operator's page shows codes to scan")
        say("Ctrl-C ends it; the same command goes on where it was")
        if open_page and access.token is None:
            import webbrowser

            webbrowser.open(operator)

    def on_joined(access: Access, shown: str) -> None:
        participants, operator = links(access, shown)
        say(f"a device came in; for the next one: {participants} or, for the operator, {operator}")

    try:
        with _noise(design):
            serve_study(server, host, port, on_start, on_joined)
    finally:
        store.close()


@app.command()
def status(database: Database, as_json: JsonOption = False) -> None:
    """Print who has rated how much, and whether the file is sound; also while the study runs."""
    with _store(database) as store:
        counts, wrong, log = store.counts(), store.check(), store.log()
        kind = "simulated raters" if store.simulated else "participants"
        trials = sum(trial.number > 0 for trial in store.trials(store.ordered()[0]))
        rows = [f"{store.study['title']}: {len(counts)} {kind}, {sum(one['n'] for one in counts.values())} ratings"]
        rows += [
            f"{number:4d}  {one['code']}  {one['n']:3d} of {trials}  last {(one['last'] or one['joined'])[:16].replace('T', ' ')}"
            for number, one in counts.items()
        ]
        rows += wrong or ["the file is sound: every check of SQLite holds, no trial is rated twice"]
        document = {
            "title": store.study["title"],
            "simulated": store.simulated,
            "participants": {str(n): one for n, one in counts.items()},
            "wrong": wrong,
            "log": log,
        }
    print_result(document, "\n".join(rows), as_json)
    if wrong:
        raise typer.Exit(1)


@app.command()
def simulate(
    study: StudyFile,
    output: Annotated[Path, Option("-o", "--output", metavar="STUDY.db", help="A new database, marked as simulated.")],
    difference: Annotated[
        float, Option(help="Points of the scale that one method is better by, to the raters.")
    ] = 10.0,
    better: Annotated[str | None, Option(metavar="METHOD", help="That is better; by default the last.")] = None,
    sd: Annotated[float, Option(min=0.1, help="Standard deviation of ratings between raters (points).")] = 10.67,
    correlation: Annotated[float, Option(min=0, max=0.99, help="Between two ratings of one rater.")] = 0.3,
    missing: Annotated[float, Option(min=0, max=0.9, help="Share of raters who leave before their end.")] = 0.0,
    seed: Annotated[int, Option(min=0, help="Of what the raters answer.")] = 0,
) -> None:
    """Let raters of a stated model take part, to try the analysis before anyone is invited. What comes is marked as simulated.

    foten study simulate similarity.toml -o simulated.db --difference 10
    """
    import numpy as np

    from foten.study.raters import raters_for
    from foten.study.store import Rated

    if output.exists():
        raise ValueError(f"{output} is there already: give another name")
    design, _, _, _ = _loaded(study)
    methods = list(design.methods)
    if better is not None and better not in methods:
        raise ValueError(f"--better is {better!r}, expected one of {', '.join(methods)}")
    raters = raters_for(len(methods), len(design.textures), difference, sd, correlation)
    rng = np.random.default_rng(seed)
    y = raters.draw(rng, design.participants)
    if better is not None:
        y[:, [methods.index(better), -1]] = y[:, [-1, methods.index(better)]]
    store = _opened(study, output, simulated=True)
    with store:
        for i in range(design.participants):
            number = store.join(f"SIM{i + 1:03d}")
            trials = store.trials(number)
            leaves = len(trials) if rng.random() >= missing else int(rng.integers(1, len(trials)))
            store.take_steps(
                number,
                {
                    f"trial:{trial.number}": Rated(
                        float(np.round(y[i, trial.method, trial.texture])), float(rng.gamma(9, 2.5)), 0
                    )
                    for trial in trials[:leaves]
                },
            )
        n = len(store.ratings())
    print(f"wrote {output}: {n} simulated ratings of {design.participants} raters")
    print(f"next: foten study analyze {output} -o results")


@app.command()
def power(
    study: Annotated[
        Path | None, Argument(metavar="[STUDY.toml]", help="For as many methods and textures as it has.")
    ] = None,
    methods: Annotated[int, Option(min=2, help="How many, without a study file.")] = 4,
    textures: Annotated[int, Option(min=1, help="How many, without a study file.")] = 12,
    difference: Annotated[
        float | None,
        Option(help="Points that the last method is better by; by default the paper's effects where there are 4 × 12."),
    ] = None,
    sd: Annotated[float, Option(min=0.1, help="Standard deviation of ratings between raters (points).")] = 10.67,
    correlation: Annotated[float, Option(min=0, max=0.99, help="Between two ratings of one rater.")] = 0.3,
    studies: Annotated[int, Option(min=50, help="That are simulated for each number of participants.")] = 500,
    seed: Annotated[int, Option(min=0, help="Of the simulation.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Print how many participants a study needs, by simulated studies.

    foten study power --difference 9
    """
    from foten.study.design import read_design
    from foten.study.raters import needed, paper_raters, raters_for

    if study is not None:
        design, _ = read_design(study)
        methods, textures = len(design.methods), len(design.textures)
    if difference is None and (methods, textures) == (4, 12):
        raters, of = paper_raters(correlation), "the paper's effects (Sec. VII)"
    else:
        points = 8.75 if difference is None else difference
        raters, of = raters_for(methods, textures, points, sd, correlation), f"a difference of {points:g} points"
    table, smallest = needed(raters, studies, seed)
    names = [name for name in table[0] if name != "participants"]
    rows = [f"{of}, {methods} methods × {textures} textures, sd {raters.sd:g}, correlation {correlation:g}, α = 0.05"]
    rows.append("participants  " + "  ".join(f"{name:>16s}" for name in names))
    rows += [f"{row['participants']:12.0f}  " + "  ".join(f"{row[name]:16.2f}" for name in names) for row in table]
    rows.append(
        "no number up to 60 finds a pair in 80 %"
        if smallest is None
        else f"{smallest} participants find a pair in 80 % of studies"
    )
    rows.append(
        "pair: the last method from another on one texture, after Holm's adjustment; all pairs: on every texture from every other"
    )
    print_result({"power": table, "participants": smallest}, "\n".join(rows), as_json)


@app.command()
def analyze(
    database: Database,
    output: Annotated[Path, folder_option("A folder for report, figures and tables; made if there is none.")] = Path(
        "results"
    ),
    reference: Annotated[
        str | None, Option(metavar="METHOD", help="Compare the others with this one alone; by default all pairs.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Analyse ratings: analyses of variance, paired tests, ranks, a mixed model, reliability; figures, a report, tidy tables.

    foten study analyze similarity.db -o results
    """
    from foten.console import check_folder
    from foten.study.analysis import analysed
    from foten.study.report import write_report

    check_folder(output)
    with _store(database) as store:
        result = analysed(store, reference)
    written = write_report(result, output)
    say(f"wrote {', '.join(str(path) for path in written)}")
    print_result(result.document, "\n".join(result.sentences), as_json)


@app.command()
def strokes(
    database: Database,
    participant: Participant,
    trial: Annotated[int, Option(help="Number of the trial.")],
    output: Annotated[Path, Option("-o", "--output", metavar="S.csv", help="The table to write: t, x, y, pressure.")],
) -> None:
    """Write how a participant stroked the virtual surface in a trial, as 'foten render --stroke' reads it.

    foten study strokes similarity.db --participant 3 --trial 7 -o stroke.csv
    """
    import csv

    from foten.atomic_write import atomic_write

    check_folders([output])
    with _store(database) as store:
        events = store.strokes(participant, trial)
    if not len(events):
        raise ValueError(f"there is no stroke of participant {participant} in trial {trial}")
    with atomic_write(output) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("t", "x", "y", "pressure"))
        writer.writerows([f"{value:.6f}" for value in (t - events[0, 3], x, y, p)] for x, y, p, t in events)
    print(f"wrote {output}: {len(events)} events, {events[-1, 3] - events[0, 3]:.1f} s")


@app.command()
def correct(
    database: Database,
    participant: Participant,
    trial: Annotated[int, Option(help="Number of the trial.")],
    rating: Annotated[float, Option(help="What was meant, 0 to 100.")],
    reason: Annotated[str, Option(help="Why; kept with the correction.")],
) -> None:
    """Put another rating in the place of a wrong one. The old one stays in the file."""
    with _store(database) as store:
        store.correct(participant, trial, rating, reason)
    print(f"participant {participant}, trial {trial}: {rating:g} holds now")


@app.command()
def forget(
    database: Database, participant: Participant, yes: Annotated[bool, Option("--yes", help="Do not ask.")] = False
) -> None:
    """Remove all of one participant's data from a study's file, for good. Backups keep theirs."""
    with _store(database) as store:
        if not yes and not typer.confirm(f"Remove all data of participant {participant} for good?", err=True):
            raise typer.Abort
        store.forget(participant)
    print(f"all data of participant {participant} was removed from {database}; backups keep theirs")


@app.command()
def backup(
    database: Database, output: Annotated[Path, Option("-o", "--output", metavar="COPY.db", help="The copy to write.")]
) -> None:
    """Copy a study's file, also while the study runs."""
    check_folders([output])
    with _store(database) as store:
        store.backup(output)
    with _store(output) as copy:
        wrong, n = copy.check(), len(copy.ratings())
    if wrong:
        raise ValueError(f"the copy {output} is damaged: {wrong[0]}")
    print(f"wrote {output}: {n} ratings, and every check holds")


def _by_method(paths: list[Path], folder: Path) -> dict[str, dict[str, str]]:
    """Return texture files by texture and method, as seen from a folder: by what their cards say, or else by their names."""
    import os

    from foten.families.texture_file import read_texture

    found: dict[str, dict[Path, str]] = {}
    for path in paths:
        card = read_texture(path).card
        found.setdefault(str(card["texture"]) or path.stem, {})[path] = str(card["model"])
    if any(
        len(set(models.values())) < len(models) for models in found.values()
    ):  # two of one model: mesh-slow, mesh-quick
        found = {
            name: {path: path.stem.removeprefix(name).strip("-_. ") or model for path, model in models.items()}
            for name, models in found.items()
        }
    usual = max((frozenset(models.values()) for models in found.values()), key=len)
    if len(usual) < 2:
        one = next(iter(found))
        raise ValueError(f"{one} has one method, expected two texture files or more of each texture, to compare")
    for name in [name for name, models in found.items() if frozenset(models.values()) != usual]:
        say(f"left out {name}: it does not have each of {', '.join(sorted(usual))}")
        del found[name]
    return {
        name: {method: os.path.relpath(path, folder) for path, method in sorted(models.items(), key=lambda one: one[1])}
        for name, models in found.items()
    }


def _store(database: Path) -> Store:
    from foten import __version__
    from foten.study.store import Store

    return Store(database, __version__)


def _loaded(study: Path) -> tuple[Design, str, Any, Any]:
    """Return a study's design, its text, its stimuli, and what is wired here; None where the pages play."""
    from foten.runtime.actuator import read_profile
    from foten.studio.players import Wired
    from foten.study.design import read_design
    from foten.study.stimuli import load_stimuli

    design, text = read_design(study)
    out = design.output
    wired = None
    if out.to != "page":
        profile = None if out.actuator is None else read_profile(out.actuator)
        wired = Wired(out.to, profile, out.gain, out.device, out.channel)
    elif any(value is not None for value in (out.actuator, out.gain, out.device, out.channel)):
        raise ValueError(
            f"{study.name}: [output] plays in the page, which has no device, gain or actuator of this machine"
        )
    return design, text, load_stimuli(design, wired is not None and wired.calibrated), wired


def _opened(study: Path, database: Path, simulated: bool) -> Store:
    """Return a study's database: a new one, or the one that is there, where it is of this very study."""
    from foten import __version__
    from foten.study.orders import planned
    from foten.study.stimuli import changed
    from foten.study.store import Store, create

    design, text, stimuli, _ = _loaded(study)
    if not database.exists():
        check_folders([database])
        counts = len(design.textures), len(design.methods)
        made = planned(design.participants, *counts, design.seed, design.practice, design.order)
        create(database, design.title, text, study.parent, design.seed, stimuli.listed, made, __version__, simulated)
    store = Store(database, __version__)
    try:
        if store.simulated != simulated:
            has = "simulated" if store.simulated else "real"
            raise ValueError(f"{database} holds {has} ratings, which stay apart: give another name with -o")
        if store.study["design"] != text:
            raise ValueError(f"{study} has changed since {database} was begun: bring it back, or begin another with -o")
        others = changed(stimuli.listed, store.stimuli())
        if others:
            raise ValueError(
                f"{', '.join(others[:3])} is another file than when {database} was begun: bring it back, or begin another"
            )
    except BaseException:
        store.close()
        raise
    return store


def _check_noise(design: Design) -> None:
    if design.noise is not None:
        with _noise(design):
            pass


def _noise(design: Design) -> Any:
    """Return a context in which white noise plays, where the study asks for it."""
    import contextlib

    if design.noise is None:
        return contextlib.nullcontext()
    from foten.studio.players import white_noise

    return white_noise(design.noise.level_db, design.noise.device)
