"""`foten demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from foten.cli.console import JsonOption, folder_option, print_result, say


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
