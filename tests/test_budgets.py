"""What the repository may grow to: `budgets.toml` at its top."""

import ast
import subprocess
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
BUDGETS = tomllib.loads((ROOT / "budgets.toml").read_text(encoding="utf-8"))
SOURCES = ("packages/*/src/**/*.py", "docs/make/*.py", "benchmarks/*.py")


def n_lines(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


@pytest.mark.parametrize("budget", BUDGETS["lines"], ids=lambda budget: ", ".join(budget["of"]))
def test_lines_are_within_their_budget(budget: dict[str, Any]) -> None:
    paths = {path for pattern in budget["of"] for path in ROOT.glob(pattern) if path.name != budget.get("without")}
    assert paths
    assert sum(map(n_lines, paths)) <= budget["most"]


def too_long(path: Path) -> Iterator[str]:
    """Names of what is longer than each may be: the file, its classes and functions."""
    limits = BUDGETS["each"]
    if n_lines(path) > limits["file"]:
        yield str(path)
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ClassDef) and node.end_lineno - node.lineno >= limits["class"]:  # type: ignore[operator]
            yield f"{path}: {node.name}"
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body[ast.get_docstring(node) is not None :] or node.body
            if node.end_lineno - body[0].lineno >= limits["body"]:  # type: ignore[operator]
                yield f"{path}: {node.name}"


def test_files_classes_and_functions_are_short() -> None:
    assert [name for pattern in SOURCES for path in ROOT.glob(pattern) for name in too_long(path)] == []


def test_the_repository_is_small() -> None:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False)
    if listed.returncode:
        pytest.skip("not a checkout")
    paths = [ROOT / name for name in listed.stdout.decode().split("\0") if name]
    paths, limits = [path for path in paths if path.exists()], BUDGETS["repository"]
    assert len([path for path in paths if not path.relative_to(ROOT).parts[0].startswith(".")]) <= limits["files"]
    assert sum(path.lstat().st_size for path in paths) <= limits["bytes"]
    assert all(path.stat().st_size <= limits["bytes_of_a_result"] for path in (ROOT / "docs/results").glob("*.csv"))
