"""What comes from outside: only regular files are opened, and JSON is refused in one sentence where it cannot be read."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

DEEPEST = 64  # of JSON; a card has 5
LONGEST_TEXT = 200  # of what a library says
MAX_LINE = 2000  # characters that a terminal is given at most: 25 rows of 80


def check_regular(path: Path) -> None:
    """Check that a path is a file that can be read to its end: a pipe or a device may never end.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is a folder, a pipe, a device or a socket.
    """
    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    if path.is_dir():
        raise ValueError(f"{path} is a folder, expected a file")
    if not path.is_file():
        raise ValueError(f"{path} is a pipe or a device, expected a file")


def parse_json(text: str | bytes) -> Any:
    """The value that JSON text holds.

    Raises:
        ValueError: it is no JSON, is nested more than `DEEPEST`, or holds an integer of too many digits.
    """
    try:
        value = json.loads(text)
        level = [value]
        # What is read must be written and shown too, which needs more of the stack than reading does.
        for _ in range(DEEPEST):
            level = [inner for outer in level for inner in _inside(outer)]
        if level:
            raise RecursionError
    except RecursionError:
        raise ValueError(f"it is nested more than {DEEPEST} deep") from None
    return value


def _inside(value: Any) -> Iterable[Any]:
    return value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()


def check_numbers(value: Any, what: str) -> None:
    """Check that each number in a parsed JSON value is one that a float64 or an int64 holds: finite, and not too large."""
    for inner in _inside(value):
        check_numbers(inner, what)
    if isinstance(value, int | float) and not abs(value) < 2**63:
        raise ValueError(f"{what} holds a number that is not finite, or not below 2^63")


def printable(text: str) -> str:
    """Text with a question mark for each character that would not be printed as itself, such as an escape or a newline."""
    return "".join(mark if mark.isprintable() else "?" for mark in text)


def shown(line: str, longest: int = MAX_LINE) -> str:
    """Line as people may be shown it: without escapes, which a terminal would obey, and cut where it is too long."""
    return printable(line) if len(line) <= longest else f"{printable(line[:longest])} …"


def brief(error: Exception) -> str:
    """What an error of a library says, on one short line: some repeat the file that they could not read."""
    text = " ".join(printable(str(error).replace("\n", " ")).split()) or type(error).__name__
    return shown(text, LONGEST_TEXT)
