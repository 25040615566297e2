"""`foten study`: a perceptual study, from its file to its report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer
from typer import Option

from foten.console import say
from foten_study.data_commands import analyze, backup, correct, devices_file, export, forget, status, strokes
from foten_study.plan_commands import StudyFile, check, new, power, simulate

if TYPE_CHECKING:
    from foten.studio.access import Access

app = typer.Typer(
    help="Design, run and analyse a perceptual study (Sec. VII); 'simulate' tries it without people.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)


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
    from foten_study.loading import load_study
    from foten_study.markers import Markers
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
