"""What comes from outside: only regular files are opened, and JSON is refused in one sentence where it cannot be read."""

from __future__ import annotations

import json
import stat
from pathlib import Path
from typing import Any


def check_regular(path: Path) -> None:
    """Check that a path is a file that can be read to its end: a pipe or a device may never end.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is a folder, a pipe, a device or a socket.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise FileNotFoundError(f"no such file: {path}") from None
    if stat.S_ISDIR(mode):
        raise ValueError(f"{path} is a folder, expected a file")
    if not stat.S_ISREG(mode):
        raise ValueError(f"{path} is a pipe or a device, expected a file")


def parse_json(text: str | bytes) -> Any:
    """Return the value that JSON text holds.

    Raises:
        ValueError: it is no JSON, is nested too deeply, or holds a number of too many digits.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def printable(text: str) -> str:
    """Return text with a question mark for each character that would not be printed as itself, such as an escape or a newline."""
    return "".join(mark if mark.isprintable() else "?" for mark in text)
