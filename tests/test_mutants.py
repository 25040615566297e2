"""Every mutant of `mutants.py` fails a test: safety code that no test holds is found here."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mutants import MUTANTS, Mutant

ROOT = Path(__file__).parent.parent
# The copy's package and not the one that is installed, whose finder comes first.
RUN = (
    "import sys; sys.meta_path[:] = [one for one in sys.meta_path if 'ScikitBuild' not in type(one).__name__]; "
    "sys.path.insert(0, 'src'); import foten, pytest; assert 'copy' in foten.__file__; sys.exit(pytest.main(sys.argv[1:]))"
)


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a copy of the sources and tests, its kernel built."""
    folder = tmp_path_factory.mktemp("mutants") / "copy"
    folder.mkdir()
    for name in ("src", "native", "tests", "CMakeLists.txt", "pyproject.toml"):
        source = ROOT / name
        ignored = shutil.ignore_patterns("__pycache__", "kernel")
        shutil.copytree(source, folder / name, ignore=ignored) if source.is_dir() else shutil.copy(source, folder)
    subprocess.run(
        ["cmake", "-S", folder, "-B", folder / "build", "-D", "FOTEN_TRAINING=ON"], check=True, capture_output=True
    )
    built(folder)
    return folder


def built(folder: Path) -> None:
    """Build a copy's kernel beside its package."""
    subprocess.run(["cmake", "--build", folder / "build"], check=True, capture_output=True)
    library = next((folder / "build").glob("libfoten.*")).resolve()
    (folder / "src/foten/runtime/kernel").mkdir(exist_ok=True)
    shutil.copy(library, folder / "src/foten/runtime/kernel/libfoten.so")


def test_there_are_fifty_and_each_is_one_change() -> None:
    assert len(MUTANTS) >= 50
    for mutant in MUTANTS:
        assert (ROOT / mutant.path).read_text().count(mutant.before) == 1, mutant.what


@pytest.mark.slow
@pytest.mark.parametrize("mutant", MUTANTS, ids=[mutant.what for mutant in MUTANTS])
def test_a_mutant_does_not_survive(copy: Path, mutant: Mutant) -> None:
    path = copy / mutant.path
    original = path.read_text()
    tests = [name for name in mutant.tests if (copy / name).exists()]
    assert tests, "none of its tests exists"
    try:
        path.write_text(original.replace(mutant.before, mutant.after))
        if mutant.path.startswith("native"):
            built(copy)
        options = ["-q", "-x", "-p", "no:xdist", "-p", "no:cacheprovider"]
        done = subprocess.run(
            [sys.executable, "-c", RUN, *options, *tests], cwd=copy, capture_output=True, text=True, check=False
        )
    finally:
        path.write_text(original)
        if mutant.path.startswith("native"):
            built(copy)
    failed = done.returncode == 1 or done.returncode < 0  # a crash of the kernel ends the tests too
    assert failed, f"it survives:\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
