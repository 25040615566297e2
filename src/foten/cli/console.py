"""Output of the subcommands: results on stdout, progress on stderr; `--json`; a check of output paths."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON on stdout.")]


def say(text: str) -> None:
    """Print progress, on stderr."""
    print(text, file=sys.stderr, flush=True)


def print_json(document: Any) -> None:
    """Print a result as JSON, on stdout."""
    print(json.dumps(document, indent=1, sort_keys=False, allow_nan=False))


def check_folders(paths: list[Path]) -> None:
    """Refuse an output whose folder does not exist, before any work is done."""
    for path in paths:
        if not path.parent.is_dir():
            raise ValueError(f"cannot write {path}: there is no folder {path.parent}")
        if path.is_dir() and path.suffix:
            raise ValueError(f"cannot write {path}: it is a folder")
