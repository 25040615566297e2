"""`foten sweep`, and `foten tables` and `foten figures`, which read its results."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import typer

from foten.atomic_write import atomic_write
from foten.cli.console import JsonOption, print_json, say


def sweep(
    experiment_file: Annotated[
        str,
        typer.Argument(
            metavar="FILE.toml",
            help="Which methods learn which textures; or one of ours: table-1, table-2, figure-5, figure-5-delta; reduced: "
            "table-1-small, and for a glance paper-small-table-1, -table-2, -figure-5, -figure-5-delta.",
        ),
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder of the results, one file a run.")
    ],
    workers: Annotated[
        int | None, typer.Option(min=1, help="Runs at a time on this machine, a thread each. [its cores]")
    ] = None,
    address: Annotated[
        str | None, typer.Option(help="Of a Ray cluster; auto for the one that this machine is part of.")
    ] = None,
    gpus_per_run: Annotated[
        float, typer.Option(min=0.0, max=8.0, help="Share of a GPU that each run takes: 0.25 lets four share one.")
    ] = 0.0,
    batched: Annotated[
        int,
        typer.Option(
            "--batched",
            min=1,
            max=64,
            help="Textures that a worker trains at once as one batched model: from six on faster with small batches, as of the "
            "paper's recipe. Weights differ from those of one by one in rounding.",
        ),
    ] = 1,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="List the runs and stop.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Train and judge every method of an experiment on every texture and split; goes on where it stopped."""
    from foten.experiments.experiment import experiment_path, read_experiment

    experiment = read_experiment(experiment_path(experiment_file))
    runs = experiment.runs()
    if dry_run:
        if as_json:
            print_json([dataclasses.asdict(run) for run in runs])
            return
        for run in runs:
            print(f"{run.label}, {run.texture}, split {run.split_seed}")
        say(f"{len(runs)} runs")
        return
    if output.exists() and not output.is_dir():
        raise ValueError(f"-o {output} is a file, expected a folder")
    from foten.experiments import sweep as sweeping

    n_done, n_failed = sweeping.sweep(experiment, output, workers, address, gpus_per_run, say, batched)
    if as_json:
        print_json({"output": str(output), "n_runs": len(runs), "n_done": n_done, "n_failed": n_failed})
    else:
        print(f"{len(runs)} runs, {n_done} now, {n_failed} failed; next: foten tables {output}")
    if n_failed:
        raise typer.Exit(1)


def tables(
    results: Annotated[Path, typer.Argument(metavar="DIR", help="Results of foten sweep.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="DIR",
            help="Write each table as .md, .csv and .tex, and every run with its intervals as runs.csv.",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Set the results of a sweep beside references and beside the paper's figures."""
    from foten.experiments.results import read_results, title_of
    from foten.experiments.tables import FIGURES, FORMATS, each_run, findings, table, written

    if not results.is_dir():
        raise ValueError(f"there is no folder {results}")
    records = read_results(results)
    cells = {name: table(records, name) for name in FIGURES}
    if output is not None:
        if output.exists() and not output.is_dir():
            raise ValueError(f"-o {output} is a file, expected a folder")
        output.mkdir(parents=True, exist_ok=True)
        for name, rows in cells.items():
            for form in FORMATS:
                with atomic_write(output / f"{name}.{form}") as part:
                    part.write_text(written(rows, form), encoding="utf-8")
        with atomic_write(output / "runs.csv") as part:
            part.write_text(written(each_run(records), "csv"), encoding="utf-8")
    title, sentences = title_of(records), list(findings(records))
    if output is not None:
        with atomic_write(output / "findings.md") as part:
            part.write_text("\n\n".join([f"# {title}", *sentences]) + "\n", encoding="utf-8")
    if as_json:
        print_json({"title": title, "tables": cells, "findings": sentences})
        return
    print(f"{title}\n")
    print("\n".join([*(written(rows, "md") for rows in cells.values()), *sentences]))


def figures(
    results: Annotated[Path, typer.Argument(metavar="DIR", help="Results of foten sweep.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Write each figure there, .png and .pdf.")
    ],
    recordings: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Of the recordings, from which Fig. 4 is drawn. [where they were when the sweep was started]",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Draw the paper's figures from the results of a sweep: split, windows and losses, waveforms, spectra."""
    from foten.experiments.figures import figures as drawn
    from foten.experiments.results import read_results

    if not results.is_dir():
        raise ValueError(f"there is no folder {results}")
    records = read_results(results)
    if output.exists() and not output.is_dir():
        raise ValueError(f"-o {output} is a file, expected a folder")
    output.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in drawn(records, recordings, say):
        for form in ("png", "pdf"):
            path = output / f"{name}.{form}"
            with atomic_write(path) as part:
                figure.savefig(part, format=form, dpi=140)
            paths.append(str(path))
    if as_json:
        print_json({"figures": paths})
    else:
        print("\n".join(paths))
