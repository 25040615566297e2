"""`foten demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from foten.cli.console import JsonOption, print_json, say


def demo(
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for everything it makes.")
    ] = Path("demo"),
    key: Annotated[str, typer.Option("--texture", help="Simulated texture; foten simulate --list.")] = "towel",
    seconds: Annotated[float, typer.Option(help="Length of the recording (s).")] = 44.0,
    epochs: Annotated[int, typer.Option(help="Of training.")] = 5,
    seed: Annotated[int, typer.Option(min=0, max=2**31, help="Of everything.")] = 0,
    threads: Annotated[
        int, typer.Option(help="Share each batch among so many cores (on a GPU there is one share).")
    ] = 2,
    as_json: JsonOption = False,
) -> None:
    """Go once through everything without data or hardware: simulate, train, judge, render."""
    from foten.experiments.demo import run_demo

    paths = run_demo(output, key, seconds, epochs, seed, threads, say)
    if as_json:
        print_json({name: str(path) for name, path in paths.items()})
        return
    for name, path in paths.items():
        print(f"{name:10s}{path}")
