"""`foten sweep`, `foten tables` and `foten figures`, which read its results, and `foten demo`."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option

from foten.atomic_write import atomic_write
from foten.console import JsonOption, check_folder, folder_option, print_result, refuse, say

MixedOption = Annotated[bool, Option("--mixed", help="Take results of different code or platform too.")]


def sweep(
    experiment_file: str | None = Argument(
        None, metavar="FILE.toml", help="An experiment, or the name of one of foten's."
    ),
    output: Annotated[Path | None, folder_option("Folder of the results, one file a run.")] = None,
    workers: int | None = Option(None, min=1, help="Runs at a time, a thread each.", show_default="its cores"),
    address: str | None = Option(None, help="Of a Ray cluster; auto for the one that this machine is part of."),
    gpus_per_run: float = Option(0.0, min=0.0, max=8.0, help="Share of a GPU for each run: 0.25 lets four share one."),
    recordings: Path | None = Option(None, metavar="DIR", help="Of the recordings.", show_default="that of the file"),
    mixed: bool = Option(False, "--mixed", help="Keep results of other platforms: a sweep that goes on elsewhere."),
    only: list[str] = Option([], metavar="TEXT", help="Runs whose line of --dry-run contains it; may be repeated."),
    dry_run: bool = Option(False, "--dry-run", help="List the runs and stop; needs no -o."),
    show_list: bool = Option(False, "--list", help="Show the experiments that come with foten and stop."),
    as_json: JsonOption = False,
) -> None:
    """Train and judge every method of an experiment on every texture and split; goes on where it stopped.

    Results stay where code, data, configuration and platform are the same, and are made again otherwise.

    Ctrl-C or SIGTERM stops it with exit status 130 and keeps every run that is done.
    """
    from foten.experiments.experiment import experiment_path, experiments, of_lines, read_experiment

    if show_list:
        titles = experiments()
        print_result(titles, "\n".join(f"{name:28s}{title}" for name, title in titles.items()), as_json)
        return
    if experiment_file is None or (output is None and not dry_run):
        raise ValueError("expected an experiment and -o DIR; --list shows those that come with foten")
    experiment = read_experiment(experiment_path(experiment_file), recordings)
    runs = of_lines(experiment.runs(), only)
    if output is None or dry_run:
        print_result([dataclasses.asdict(run) for run in runs], "\n".join(run.line for run in runs), as_json)
        say(f"{len(runs)} runs")
        return
    check_folder(output)
    from foten.experiments import sweep as sweeping

    try:
        n_done, n_failed = sweeping.sweep(experiment, output, workers, address, gpus_per_run, say, mixed, only)
    except sweeping.Stopped as stopped:
        raise Exit(130) from stopped
    result = {"output": str(output), "n_runs": len(runs), "n_done": n_done, "n_failed": n_failed}
    print_result(result, f"{len(runs)} runs, {n_done} now, {n_failed} failed; next: foten tables {output}", as_json)
    if n_failed:
        raise Exit(1)


def tables(
    results: list[Path] = Argument(..., metavar="DIR|runs.csv...", help="Results of foten sweep, or runs.csv of it."),
    output: Annotated[Path | None, folder_option("Write .md, .csv and .tex of each table, and runs.csv.")] = None,
    short: bool = Option(False, "--brief", help="Only the figures in runs.csv that methods are compared by."),
    digits: int | None = Option(None, min=1, max=9, help="Significant digits in runs.csv; by default all."),
    mixed: MixedOption = False,
    as_json: JsonOption = False,
) -> None:
    """Set the results of a sweep beside references and beside the paper's figures."""
    from foten.experiments.method_tables import brief, findings, tables_of
    from foten.experiments.results import joined, read_records, runs_table, title_of
    from foten.reporting.table import FORMS

    if output is None:
        refuse("is of runs.csv, which is written with -o DIR", brief=short, digits=digits)
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
    brief_tables = [shown[name] for name in ("summary", "ratios") if name in shown]
    printed = [dataclasses.replace(table, title="", notes=()).markdown() for table in brief_tables]
    document = {"title": title, "tables": {name: table.cells() for name, table in shown.items()}, "findings": sentences}
    print_result(document, "\n".join([f"{title}\n", *printed, *sentences]), as_json)


def figures(
    results: Annotated[Path, Argument(metavar="DIR", help="Results of foten sweep.")],
    output: Annotated[Path, folder_option("Write each figure there, .png and .pdf.")],
    recordings: Path | None = Option(
        None, metavar="DIR", help="Recordings of Fig. 4.", show_default="where the sweep had them"
    ),
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
    key: str = Option("towel", "--texture", help="Simulated texture; foten simulate --list."),
    seconds: float = Option(44.0, help="Length of the recording (s)."),
    epochs: int = Option(5, help="Of training."),
    seed: int = Option(0, min=0, max=2**31, help="Of everything."),
    threads: int = Option(2, help="Share each batch among so many cores (on a GPU there is one share)."),
    as_json: JsonOption = False,
) -> None:
    """Go once through everything without data or hardware: simulate, train, judge, render."""
    from foten.experiments.demo import run_demo

    paths = {name: str(path) for name, path in run_demo(output, key, seconds, epochs, seed, threads, say).items()}
    print_result(paths, "\n".join(f"{name:10s}{path}" for name, path in paths.items()), as_json)
