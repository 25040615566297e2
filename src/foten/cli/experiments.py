"""`foten sweep`, `foten tables` and `foten figures`, which read its results, and `foten demo`."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option

from foten.atomic_write import atomic_write
from foten.console import JsonOption, check_folder, folder_option, print_result, say

ResultsFolder = Annotated[Path, Argument(metavar="DIR", help="Results of foten sweep.")]
MixedOption = Annotated[
    bool, Option("--mixed", help="Take results of different code or platform too, which are refused otherwise.")
]


def sweep(
    experiment_file: Annotated[
        str | None,
        Argument(
            metavar="FILE.toml",
            help="Which methods learn which textures; or the name of an experiment that comes with foten, as --list shows them.",
        ),
    ] = None,
    output: Annotated[Path | None, folder_option("Folder of the results, one file a run.")] = None,
    workers: Annotated[
        int | None, Option(min=1, help="Runs at a time on this machine, a thread each.", show_default="its cores")
    ] = None,
    address: Annotated[
        str | None, Option(help="Of a Ray cluster; auto for the one that this machine is part of.")
    ] = None,
    gpus_per_run: Annotated[
        float, Option(min=0.0, max=8.0, help="Share of a GPU that each run takes: 0.25 lets four share one.")
    ] = 0.0,
    recordings: Annotated[
        Path | None,
        Option(metavar="DIR", help="Folder of the experiment's recordings.", show_default="that of the file"),
    ] = None,
    dry_run: Annotated[bool, Option("--dry-run", help="List the runs and stop; needs no -o.")] = False,
    show_list: Annotated[bool, Option("--list", help="Show the experiments that come with foten and stop.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Train and judge every method of an experiment on every texture and split; goes on where it stopped.

    Results stay where code, data, configuration and platform are the same, and are made again otherwise.

    Ctrl-C or SIGTERM stops it with exit status 130 and keeps every run that is done.
    """
    from foten.experiments.experiment import experiment_path, experiments, read_experiment

    if show_list:
        titles = experiments()
        print_result(titles, "\n".join(f"{name:28s}{title}" for name, title in titles.items()), as_json)
        return
    if experiment_file is None or (output is None and not dry_run):
        raise ValueError("expected an experiment and -o DIR; --list shows those that come with foten")
    experiment = read_experiment(experiment_path(experiment_file), recordings)
    runs = experiment.runs()
    if output is None or dry_run:
        listed = "\n".join(f"{run.label}, {run.texture}, split {run.split_seed}" for run in runs)
        print_result([dataclasses.asdict(run) for run in runs], listed, as_json)
        if not as_json:
            say(f"{len(runs)} runs")
        return
    check_folder(output)
    from foten.experiments import sweep as sweeping

    try:
        n_done, n_failed = sweeping.sweep(experiment, output, workers, address, gpus_per_run, say)
    except sweeping.Stopped as stopped:
        raise Exit(130) from stopped
    result = {"output": str(output), "n_runs": len(runs), "n_done": n_done, "n_failed": n_failed}
    print_result(result, f"{len(runs)} runs, {n_done} now, {n_failed} failed; next: foten tables {output}", as_json)
    if n_failed:
        raise Exit(1)


def tables(
    results: Annotated[
        list[Path],
        Argument(
            metavar="DIR|runs.csv...",
            help="Results of foten sweep, or what this wrote of them; of several parts of one sweep.",
        ),
    ],
    output: Annotated[
        Path | None, folder_option("Write each table as .md, .csv and .tex, and every figure of every run as runs.csv.")
    ] = None,
    short: Annotated[
        bool,
        Option("--brief", help="Of runs.csv only the figures that methods are compared by, not those of references."),
    ] = False,
    digits: Annotated[
        int | None,
        Option(
            min=1,
            max=9,
            help="Significant digits in runs.csv: tables that are made of it again may differ in the last.",
            show_default="all, with which they do not",
        ),
    ] = None,
    mixed: MixedOption = False,
    as_json: JsonOption = False,
) -> None:
    """Set the results of a sweep beside references and beside the paper's figures."""
    from foten.experiments.method_tables import brief, findings, tables_of
    from foten.experiments.results import joined, read_records, runs_table, title_of
    from foten.reporting.table import FORMS

    records = joined([read_records(path) for path in results], mixed)
    check_folder(output)
    shown, title, sentences = tables_of(records), title_of(records), list(findings(records))
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        for name, table in shown.items():
            for form in FORMS:
                table.write(output / f"{name}.{form}")
        runs_table(brief(records) if short else records, digits).write(output / "runs.csv")
        with atomic_write(output / "findings.md") as part:
            part.write_text("\n\n".join([f"# {title}", *sentences]) + "\n", encoding="utf-8")
    printed = [
        dataclasses.replace(shown[name], title="", notes=()).markdown()
        for name in ("summary", "ratios")
        if name in shown
    ]
    document = {"title": title, "tables": {name: table.cells() for name, table in shown.items()}, "findings": sentences}
    print_result(document, "\n".join([f"{title}\n", *printed, *sentences]), as_json)


def figures(
    results: ResultsFolder,
    output: Annotated[Path, folder_option("Write each figure there, .png and .pdf.")],
    recordings: Annotated[
        Path | None,
        Option(
            metavar="DIR",
            help="Of the recordings, from which Fig. 4 is drawn.",
            show_default="where they were when the sweep was started",
        ),
    ] = None,
    mixed: MixedOption = False,
    as_json: JsonOption = False,
) -> None:
    """Draw the paper's figures from the results of a sweep: split, windows and losses, waveforms, spectra."""
    from foten.experiments.figures import figures as drawn
    from foten.experiments.results import read_results
    from foten.reporting.figure import write_figure

    records = read_results(results, mixed)
    check_folder(output)
    output.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in drawn(records, recordings, say):
        for form in ("png", "pdf"):
            write_figure(figure, output / f"{name}.{form}")
            paths.append(str(output / f"{name}.{form}"))
    print_result({"figures": paths}, "\n".join(paths), as_json)


def demo(
    output: Annotated[Path, folder_option("Folder for everything it makes.")] = Path("demo"),
    key: Annotated[str, Option("--texture", help="Simulated texture; foten simulate --list.")] = "towel",
    seconds: Annotated[float, Option(help="Length of the recording (s).")] = 44.0,
    epochs: Annotated[int, Option(help="Of training.")] = 5,
    seed: Annotated[int, Option(min=0, max=2**31, help="Of everything.")] = 0,
    threads: Annotated[int, Option(help="Share each batch among so many cores (on a GPU there is one share).")] = 2,
    as_json: JsonOption = False,
) -> None:
    """Go once through everything without data or hardware: simulate, train, judge, render."""
    from foten.experiments.demo import run_demo

    paths = {name: str(path) for name, path in run_demo(output, key, seconds, epochs, seed, threads, say).items()}
    print_result(paths, "\n".join(f"{name:10s}{path}" for name, path in paths.items()), as_json)
