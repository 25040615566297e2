"""Checks of what comes from outside: files, JSON, and text that is shown on a terminal."""

import json
import os
import tomllib
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

DEEPEST, MAX_TOML = 64, 100_000  # levels of JSON and TOML, of which a card has 5; characters of TOML
MAX_INFLATION = 32  # bytes of content for one in the file; recordings of noise have 2 to 8
MIN_CONTENT, MAX_CONTENT = 64 << 20, 1_600_000_000  # bytes of content that a file of any size may have; that none may
MAX_FILE, MAX_PROFILE = 1 << 27, 1 << 24  # bytes of a file that is read as a whole, such as a texture; of JSON
RAISED_BY = "FOTEN_MAX_MB"  # environment variable: MB of content that any file may have all the same
LONGEST_TEXT = 200  # of what a library says
MAX_LINE = 2000  # characters that a terminal is given at most: 25 rows of 80


def check_regular(path: Path) -> None:
    """Refuse a path that is no file (FileNotFoundError), or is a folder, a pipe or a device, which may not end (ValueError)."""
    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    if path.is_dir():
        raise ValueError(f"{path} is a folder, expected a file")
    if not path.is_file():
        raise ValueError(f"{path} is a pipe or a device, expected a file")


def read_whole(path: Path, largest: int = MAX_FILE) -> bytes:
    """Content of a file of a size [bytes] that is expected; otherwise ValueError, as where `check_regular` refuses it."""
    check_regular(path)
    if (size := path.stat().st_size) > max(largest, _raised()):
        sizes = f"{size / 1e6:,.1f} MB, expected {largest / 1e6:,.1f} at most"
        raise ValueError(f"{path} has {sizes}; {RAISED_BY}={size // 1_000_000 + 1} reads it all the same")
    return path.read_bytes()


def max_content(path: Path) -> int:
    """Bytes of content that are read of a file, 8 for a number: in proportion to its size, or as `FOTEN_MAX_MB` says."""
    return max(_raised(), min(MIN_CONTENT + MAX_INFLATION * path.stat().st_size, MAX_CONTENT))


def _raised() -> int:
    """Bytes that `FOTEN_MAX_MB` allows; 0 where it is not set."""
    raised = os.environ.get(RAISED_BY) or "0"
    if not raised.isdecimal() or len(raised) > 9:
        raise ValueError(f"{RAISED_BY} is {raised[:20]!r}, expected a whole number of MB, such as 500")
    return 10**6 * int(raised)


def too_much(n_bytes: int, limit: int) -> str:
    """Why so much content is not read, and how to raise the bound."""
    holds = f"holds {n_bytes / 1e6:,.0f} MB or more, expected {limit / 1e6:,.0f} at most by its file's size"
    return f"{holds}; is it damaged? {RAISED_BY}={n_bytes // 1_000_000 + 1} reads it all the same"


def check_content(path: Path, n_bytes: int) -> None:
    """Refuse a file with more content than `max_content`, before it is read."""
    if n_bytes > (limit := max_content(path)):
        raise ValueError(f"{path.name} {too_much(n_bytes, limit)}")


def parse_json(text: str | bytes) -> Any:
    """The value that JSON text holds; ValueError for none, more than `DEEPEST` levels, a name twice or too long an integer."""
    return _shallow(partial(json.loads, object_pairs_hook=_unique), text)


def parse_toml(text: str | bytes) -> dict[str, Any]:
    """The tables that TOML text holds; ValueError where it is none, nested more than `DEEPEST`, or as `check_numbers` says."""
    try:
        if len(text) > MAX_TOML:  # a name of so many parts takes seconds
            raise ValueError(f"it has {len(text):,} characters, expected {MAX_TOML:,} at most")
        tables: dict[str, Any] = _shallow(tomllib.loads, text if isinstance(text, str) else text.decode())
    except ValueError as error:
        raise ValueError(f"this is not TOML ({error})") from error
    check_numbers(tables, "it")
    return tables


def _shallow(parse: Callable[[Any], Any], text: str | bytes) -> Any:
    try:
        level = [value := parse(text)]
        # Writing and showing a value needs more of the stack than reading it does.
        for _ in range(DEEPEST):
            level = [inner for outer in level for inner in _inside(outer)]
        if level:
            raise RecursionError
    except RecursionError:
        raise ValueError(f"it is nested more than {DEEPEST} deep") from None
    return value


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(value := dict(pairs)) < len(pairs):
        raise ValueError("a name is in it twice")  # readers differ in which of the two counts
    return value


def read_profile_json(path: Path, kind: str, version: int, what: str) -> dict[str, Any]:
    """The entries of a JSON file of a kind, such as "foten-tool", and a version, without these two.

    ValueError where it is another; it says `what` was expected.
    """
    data = read_whole(path, MAX_PROFILE)
    try:
        content: Any = parse_json(data)
    except ValueError as error:
        raise ValueError(f"{path.name} is not JSON ({error}), expected {what}") from error
    if not isinstance(content, dict) or content.pop("format", None) != kind:
        raise ValueError(f"{path.name} is not {what}, expected 'format': {kind!r}")
    if (found := content.pop("version", None)) != version:
        raise ValueError(f"{path.name} has version {found}, expected {version}; update foten?")
    check_numbers(content, path.name)
    return content


def _inside(value: Any) -> Iterable[Any]:
    return value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()


def check_numbers(value: Any, what: str, entry: str = "") -> None:
    """Refuse parsed JSON with a number that is not finite, or that neither a float64 nor an int64 holds; name its entry."""
    for name, inner in value.items() if isinstance(value, dict) else ((entry, inner) for inner in _inside(value)):
        check_numbers(inner, what, name)
    if isinstance(value, int | float) and not abs(value) < 2**63:
        place = f", in {entry[:40]!r}" if entry else ""
        raise ValueError(f"{what} holds a number that is not finite, or not below 2^63{place}")


def is_number(value: Any) -> bool:
    """Whether parsed JSON is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < float("inf")


def printable(text: str) -> str:
    """Text with a question mark for each character that is not printable, such as an escape or a newline."""
    return "".join(mark if mark.isprintable() else "?" for mark in text)


def shown(line: str, longest: int = MAX_LINE) -> str:
    """Line for a terminal: without escapes, which it would obey, and cut where it is too long."""
    return printable(line) if len(line) <= longest else f"{printable(line[:longest])} …"


def brief(error: Exception) -> str:
    """Message of a library's error on one short line; some hold the file that they could not read."""
    if isinstance(error, ArithmeticError | AttributeError | IndexError | NameError | RecursionError | TypeError):
        return "its parts do not fit together"  # what such errors say is of the library's code
    return shown(" ".join(printable(str(error).replace("\n", " ")).split()) or type(error).__name__, LONGEST_TEXT)
