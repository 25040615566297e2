"""Every mutant of `mutants.py` fails a test that passes without it: safety code that no test holds is found here."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from functools import cache
from operator import itemgetter
from pathlib import Path

import pytest

from mutants import MUTANTS, Mutant
from random_mutants import Change, _digest, build, c_changes, copy_tree, drawn, judges, python_changes, python_path

ROOT = Path(__file__).parent.parent
RUN = "import foten, pytest, sys; assert 'copy' in foten.__file__; sys.exit(pytest.main(sys.argv[1:]))"


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the sources and tests, and of all that these read, its kernel built."""
    folder = tmp_path_factory.mktemp("mutants") / "copy"
    copy_tree(folder)
    build(folder)
    return folder


def run_tests(folder: Path, tests: tuple[str, ...]) -> subprocess.CompletedProcess[str]:
    """Run files of a copy's tests up to the first that fails."""
    options = ["-q", "-x", "-p", "no:xdist", "-p", "no:cacheprovider"]
    command = [sys.executable, "-c", RUN, *options, *tests]
    environment = os.environ | {"PYTHONPATH": python_path(folder)}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


@cache
def check_baseline(folder: Path, tests: tuple[str, ...]) -> None:
    """Check that tests pass without a mutant: those that fail anyway would let every mutant seem to die."""
    done = run_tests(folder, tests)
    assert done.returncode == 0, f"they fail without a mutant:\n{done.stdout[-2000:]}{done.stderr[-2000:]}"


def test_there_are_fifty_and_each_is_one_change() -> None:
    assert len(MUTANTS) >= 50
    for mutant in MUTANTS:
        source = (ROOT / mutant.path).read_text()
        unchanged = ast.unparse(ast.parse(source)) if mutant.path.endswith(".py") else source
        assert mutant.change(source) != unchanged, mutant.what
        assert all((ROOT / path).exists() for path in mutant.tests), mutant.what


@pytest.mark.slow
@pytest.mark.parametrize("mutant", MUTANTS, ids=[mutant.what for mutant in MUTANTS])
def test_a_mutant_does_not_survive(copy: Path, mutant: Mutant) -> None:
    path = copy / mutant.path
    original = path.read_text()
    check_baseline(copy, mutant.tests)
    try:
        path.write_text(mutant.change(original))
        if mutant.path.startswith("native"):
            build(copy)
        done = run_tests(copy, mutant.tests)
    finally:
        path.write_text(original)
        if mutant.path.startswith("native"):
            build(copy)
    failed = done.returncode == 1 or done.returncode < 0  # a crash of the kernel ends the tests too
    assert failed, f"it survives:\n{done.stdout[-2000:]}{done.stderr[-2000:]}"


def test_a_set_of_tests_that_fails_without_a_mutant_is_no_judge(tmp_path: Path) -> None:
    """A copy without `examples` failed `test_kernel_build.py`, and every mutant that named it seemed to die."""
    (tmp_path / "copy" / "src").mkdir(parents=True)
    (tmp_path / "copy" / "src" / "foten.py").touch()
    (tmp_path / "copy" / "shadow").mkdir()
    (tmp_path / "copy" / "shadow" / "_editable_skbc_foten.py").touch()
    (tmp_path / "copy" / "test_fails.py").write_text("def test_fails() -> None:\n    assert False\n")
    with pytest.raises(AssertionError, match="they fail without a mutant"):
        check_baseline(tmp_path / "copy", ("test_fails.py",))


PYTHON = """
LIMIT_S = 20.0
def fades(level: float, n: int = 3) -> float:
    '''Nothing here changes: 3 + 4.'''
    if level < LIMIT_S:
        report(level, n)
    return max(level, n) - numbers[1] + f"{n}"
"""
PYTHON_CHANGES = [
    ("", "constant", "20.0 → 40.0"),
    ("fades", "off by one", "3 → 4"),
    ("fades", "comparison", "level < LIMIT_S → level <= LIMIT_S"),
    ("fades", "dropped call", "report(level, n) → pass"),
    ("fades", "swapped arguments", "report(level, n) → report(n, level)"),
    ("fades", "plus or minus", "max(level, n) - numbers[1] → max(level, n) + numbers[1]"),
    ("fades", "off by one", "1 → 2"),
]
C_TEXT = """
#define NOT_HERE (1 + 2)
/* nor here: a < b */
static double fades(const double *level, int n) {
  if (n <= 0) report(level[n - 1], 2.5f, "a, b");
  return fmax(level[0], -n) + scale(level, (n));
}
"""
C_CHANGES = [
    ("comparison", "if (n < 0)"),
    ("off by one", "(n <= 1)"),
    ("swapped arguments", 'report(2.5f, level[n - 1], "a, b")'),
    ("dropped call", "if (n <= 0) (void)0;"),
    ("plus or minus", "level[n + 1]"),
    ("off by one", "level[n - 2]"),
    ("off by one", "level[1]"),
    ("plus or minus", "-n) - scale"),
    ("swapped arguments", "scale((n), level)"),
]


def test_operators_change_what_runs_and_nothing_else() -> None:
    """Not a text, a docstring or an annotation; nor what gives the same, as the arguments of a maximum."""
    assert [(scope, operator, what) for scope, _, operator, what, _ in python_changes(PYTHON)] == PYTHON_CHANGES
    unchanged = ast.unparse(ast.parse(PYTHON))
    for *_, what, apply in python_changes(PYTHON):
        before, after = what.split(" → ")
        assert apply().replace(after, before) == unchanged.replace(after, before) != apply()
    made = list(c_changes(C_TEXT))
    assert len(made) == len(C_CHANGES)
    for (scope, line, operator, _, apply), (expected, part) in zip(made, C_CHANGES, strict=True):
        assert (scope, operator) == ("fades", expected)
        assert part in apply().splitlines()[line - 1]
        assert part not in C_TEXT


def test_a_draw_stays_what_it_was_while_other_code_is_written() -> None:
    """Those of an operator keep their order; a new change takes its place among them."""

    def draw(source: str, seed: str) -> list[tuple[str, str]]:
        made = python_changes(source)
        changes = [Change("a.py", scope, line, kind, what, 0, apply) for scope, line, kind, what, apply in made]
        return [(change.operator, change.key) for change in drawn(changes, seed)]

    first = draw(PYTHON, "seed")
    assert len({tuple(draw(PYTHON, str(seed))) for seed in range(20)}) == 2  # of two changes of one operator
    more = draw(PYTHON + "\n\ndef other(a: int) -> int:\n    return a + 7\n", "seed")
    assert len(more) == len(first) + 2
    assert sorted(first, key=itemgetter(0)) == sorted((one for one in more if one in first), key=itemgetter(0))


def test_a_mutant_is_judged_by_tests_that_pass_without_it_and_execute_its_line() -> None:
    change = Change("packages/foten/src/foten/dsp/level.py", "rms", 12, "constant", "2.0 → 4.0", 0, str)
    digest = _digest((ROOT / change.path).read_bytes())
    lines = {"12": ["slow", "quick", "fails"], "14": ["other"]}
    seconds = {"slow": 3.0, "quick": 0.5, "fails": 0.1, "other": 0.2}
    record = {"seconds": seconds, "failed": ["fails"], "lines": {change.path: lines}, "sources": {change.path: digest}}
    (first, *files) = judges(change, {"tests/test_spectrum.py": record})
    assert first == (["quick", "slow"], 3.5)
    assert files == []  # since that file imports another module
    record["sources"] = {}  # the module was written anew: its lines are others
    assert judges(change, {"tests/test_spectrum.py": record})[0][0] == ["other", "quick", "slow"]
