"""Constants that the kernel shares with Python are equal: `native/src/constants.h` names the Python one of each."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from pkgutil import resolve_name

import pytest

HEADER = Path(__file__).parents[1] / "native" / "src" / "constants.h"
DEFINED = re.findall(r"^#define (FOTEN_\w+) (.+)$", HEADER.read_text(), re.MULTILINE)
SHARED = re.compile(r"(\S+) /\* (foten[\w.]+)(?:\[(\d+)\])? \*/")


@pytest.mark.parametrize(("name", "definition"), DEFINED, ids=[name for name, _ in DEFINED])
def test_the_kernel_and_python_agree(name: str, definition: str) -> None:
    """Exactly: both languages round a decimal number to the nearest float64."""
    match = SHARED.fullmatch(definition)
    assert match, f"{name} is {definition!r}, expected a number and a comment that names a Python constant"
    number, path, index = match.groups()
    value = resolve_name(path)
    assert ast.literal_eval(number) == (value if index is None else value[int(index)])
