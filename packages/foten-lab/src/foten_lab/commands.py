"""`foten sweep`, and `foten tables` and `foten figures`, which read its results."""

import dataclasses
from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option

from foten.atomic_write import atomic_write
from foten.console import JsonOption, check_folder, folder_option, print_result, refuse, say

MixedOption = Annotated[bool, Option("--mixed", help="Accept results of different code or platforms.")]


def sweep(
    experiment_file: str | None = Argument(
        None,
        metavar="FILE.toml",
        help="Experiment file, or the name of an experiment that comes with foten (see --list).",
    ),
    output: Annotated[Path | None, folder_option("Folder for the results, one file per run.")] = None,
    workers: int | None = Option(
        None, min=1, help="Number of runs at a time on this machine, one thread each.", show_default="number of cores"
    ),
    address: str | None = Option(
        None, help="Address of a Ray cluster (HOST:PORT), or auto for the one that this machine is part of."
    ),
    gpus_per_run: float = Option(
        0.0, min=0.0, max=8.0, help="Share of a GPU for each run: 0.25 lets four runs share one; 0 uses none."
    ),
    recordings: Path | None = Option(
        None, metavar="DIR", help="Folder of the recordings.", show_default="the experiment file's folder"
    ),
    mixed: bool = Option(
        False, "--mixed", help="Keep results of other platforms, to continue a sweep on another machine."
    ),
    only: list[str] = Option(
        [], metavar="TEXT", help="Select the runs whose line in --dry-run contains this text; repeatable."
    ),
    dry_run: bool = Option(False, "--dry-run", help="List the runs and exit; needs no -o."),
    show_list: bool = Option(False, "--list", help="List the experiments that come with foten and exit."),
    as_json: JsonOption = False,
) -> None:
    """Train and evaluate every method of an experiment on every texture and split; continues where it stopped.

    A result is kept if code, data, configuration and platform are the same; otherwise the run is repeated.

    Ctrl-C or SIGTERM stops the sweep with exit status 130 and keeps the finished runs.

    On this machine, a run that was under way continues after the last epoch that it finished, with the same result.
    """
    from foten_lab.experiment import experiment_path, experiments, of_lines, read_experiment

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
    from foten_lab import sweep as sweeping

    try:
        n_done, n_failed = sweeping.sweep(experiment, output, workers, address, gpus_per_run, say, mixed, only)
    except sweeping.Stopped as stopped:
        raise Exit(130) from stopped
    result = {"output": str(output), "n_runs": len(runs), "n_done": n_done, "n_failed": n_failed}
    print_result(result, f"{len(runs)} runs: {n_done} new, {n_failed} failed; next: foten tables {output}", as_json)
    if n_failed:
        raise Exit(1)


def tables(
    results: list[Path] = Argument(
        ..., metavar="DIR|runs.csv...", help="Result folders of 'foten sweep', or a runs.csv that 'foten tables' wrote."
    ),
    output: Annotated[
        Path | None, folder_option("Folder for each table as .md, .csv and .tex, and for runs.csv.")
    ] = None,
    short: bool = Option(False, "--brief", help="Restrict runs.csv to the measures by which methods are compared."),
    digits: int | None = Option(
        None, min=1, max=9, help="Significant digits of the numbers in runs.csv; by default all."
    ),
    mixed: MixedOption = False,
    as_json: JsonOption = False,
) -> None:
    """Tabulate the results of a sweep beside reference methods and the paper's numbers."""
    from foten.reporting.table import FORMS
    from foten_lab.method_tables import brief, findings, tables_of
    from foten_lab.results import joined, read_records, runs_table, title_of

    if output is None:
        refuse("is for runs.csv, which is written with -o DIR", brief=short, digits=digits)
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
    results: Annotated[Path, Argument(metavar="DIR", help="Result folder of 'foten sweep'.")],
    output: Annotated[Path, folder_option("Folder for the figures, each as .png and .pdf.")],
    recordings: Path | None = Option(
        None,
        metavar="DIR",
        help="Folder of the recordings, which Fig. 4 shows.",
        show_default="the folder that the sweep used",
    ),
    mixed: MixedOption = False,
    as_json: JsonOption = False,
) -> None:
    """Draw the paper's figures from the results of a sweep: split, windows and losses, waveforms, spectra."""
    from foten.reporting.figure import write_figure
    from foten_lab.figures import figures as drawn
    from foten_lab.results import read_results

    records = read_results(results, mixed)
    check_folder(output)
    output.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in drawn(records, recordings, say):
        for form in ("png", "pdf"):
            write_figure(figure, output / f"{name}.{form}")
            paths.append(str(output / f"{name}.{form}"))
    print_result({"figures": paths}, "\n".join(paths), as_json)
