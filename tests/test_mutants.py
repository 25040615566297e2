"""Every mutant of `mutants.py` fails a test that passes without it: safety code that no test holds is found here."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from mutants import MUTANTS, Mutant
from test_kernel_build import CMAKE

ROOT = Path(__file__).parent.parent
# The copy's package and not the one that is installed, whose finder comes first.
RUN = (
    "import sys; sys.meta_path[:] = [one for one in sys.meta_path if 'ScikitBuild' not in type(one).__name__]; "
    "sys.path.insert(0, 'src'); import foten, pytest; assert 'copy' in foten.__file__; sys.exit(pytest.main(sys.argv[1:]))"
)


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the sources and tests, and of all that these read, its kernel built."""
    folder = tmp_path_factory.mktemp("mutants") / "copy"
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    for name in listed.splitlines():
        if (ROOT / name).is_file():  # and not removed since
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / name)
    assert CMAKE is not None
    subprocess.run(
        [CMAKE, "-S", folder, "-B", folder / "build", "-D", "FOTEN_TRAINING=ON"], check=True, capture_output=True
    )
    build(folder)
    return folder


def build(folder: Path) -> None:
    """Build a copy's kernel beside its package."""
    assert CMAKE is not None
    subprocess.run([CMAKE, "--build", folder / "build", "--parallel", "2"], check=True, capture_output=True)
    kernel = folder / "src/foten/runtime/kernel"
    kernel.mkdir(exist_ok=True)
    for name in ("libfoten", "libfoten_training"):
        shutil.copy(next((folder / "build").glob(f"{name}.*")).resolve(), kernel / f"{name}.so")
    for path in ("include/foten.h", "wasm/foten.mjs", "wasm/foten.wasm"):
        shutil.copy(folder / "native" / path, kernel)


def run_tests(folder: Path, tests: tuple[str, ...]) -> subprocess.CompletedProcess[str]:
    """Run files of a copy's tests up to the first that fails."""
    options = ["-q", "-x", "-p", "no:xdist", "-p", "no:cacheprovider"]
    return subprocess.run(
        [sys.executable, "-c", RUN, *options, *tests], cwd=folder, capture_output=True, text=True, check=False
    )


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
    (tmp_path / "copy" / "test_fails.py").write_text("def test_fails() -> None:\n    assert False\n")
    with pytest.raises(AssertionError, match="they fail without a mutant"):
        check_baseline(tmp_path / "copy", ("test_fails.py",))
