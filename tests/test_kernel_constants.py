"""Constants that the kernel shares with Python are equal: `native/src/constants.h` names the other of each."""

from __future__ import annotations

import ast
import importlib
import re
from pathlib import Path
from typing import Any

import pytest

HEADER = Path(__file__).parents[1] / "native" / "src" / "constants.h"
LINE = re.compile(r"#define (FOTEN_\w+) (\S+) /\* ([\w.]+)(?:\[(\d+)\])? \*/")
DEFINITIONS = [line for line in HEADER.read_text().splitlines() if line.startswith("#define FOTEN_")]
SHARED = [LINE.fullmatch(line) for line in DEFINITIONS if line != "#define FOTEN_CONSTANTS_H"]


def constant(path: str) -> Any:
    """Return what a dotted path names: a module, and attributes from there on."""
    names = path.split(".")
    for n in range(len(names), 0, -1):
        module = ".".join(names[:n])
        try:
            value = importlib.import_module(module)
        except ModuleNotFoundError as error:
            if error.name is None or not f"{module}.".startswith(f"{error.name}."):
                raise
            continue
        for name in names[n:]:
            assert hasattr(value, name), f"{path}: there is no {name!r}"
            value = getattr(value, name)
        return value
    raise AssertionError(f"{path}: there is no such module")


def test_every_line_names_a_python_constant() -> None:
    assert len(SHARED) > 40
    assert None not in SHARED, [
        line for line in DEFINITIONS if line != "#define FOTEN_CONSTANTS_H" and not LINE.fullmatch(line)
    ]


@pytest.mark.parametrize("match", [m for m in SHARED if m], ids=lambda m: m[1])
def test_the_kernel_and_python_agree(match: re.Match[str]) -> None:
    """Exactly: both languages round a decimal number to the nearest float64."""
    _, number, path, index = match.groups()
    value = constant(path)
    assert ast.literal_eval(number) == (value if index is None else value[int(index)])
