"""A version is written where each language looks for it, and is the same everywhere."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import foten
from foten.runtime.binding import ABI, library

ROOT = Path(__file__).parents[1]


def found(path: str, pattern: str) -> str:
    match = re.search(pattern, (ROOT / path).read_text(), re.MULTILINE)
    assert match is not None, f"{path} has no {pattern}"
    return match[1]


def test_the_version_is_the_same_everywhere() -> None:
    assert {
        foten.__version__,
        tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"],
        json.loads((ROOT / "src/foten/export/unity_package/package.json").read_text())["version"],
        found("native/include/foten.h", r'^#define FOTEN_VERSION "(.+)"'),
        library().foten_version().decode(),
        found("CMakeLists.txt", r"PROPERTIES VERSION (\S+) SOVERSION"),
        found("CITATION.cff", r"^version: (\S+)"),
    } == {foten.__version__}


def test_the_binary_interface_is_the_same_everywhere() -> None:
    assert {
        found("native/include/foten.h", r"^#define FOTEN_ABI (\d+)"),
        str(library().foten_abi()),
        str(ABI),
        found("CMakeLists.txt", r"SOVERSION (\d+)"),
        found("native/wasm/foten.mjs", r"^const ABI = (\d+)"),
        found("src/foten/export/unity_package/Runtime/Foten.cs", r"const int Abi = (\d+)"),
    } == {str(ABI)}
