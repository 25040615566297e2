"""`foten bench`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from foten.cli.console import JsonOption, print_json


def bench(
    texture_file: Annotated[Path, typer.Argument(metavar="T.foten", help="A texture file.")],
    n: Annotated[int, typer.Option("-n", min=1000, help="Samples to time.")] = 20_000,
    as_json: JsonOption = False,
) -> None:
    """Time a sample of a texture in each instruction set of this processor."""
    from foten.runtime import bench as timing

    if not texture_file.exists():
        raise FileNotFoundError(f"no such file: {texture_file}")
    times = timing.time_all(texture_file, n)
    if as_json:
        print_json([asdict(one) for one in times])
    else:
        print(timing.as_table(times))
